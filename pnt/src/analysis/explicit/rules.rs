//! Which transitions may fire at a marking.

use super::super::{
    layout::{Layout, Packed},
    model::{Model, TransitionNumber},
};

/// The transitions against a layout, and where to look for enabled ones.
pub struct Rules {
    pub(in crate::analysis) layout: Layout,
    pub(in crate::analysis) packed: Vec<Packed>,
    /// Per place, the transitions that need it and of whose needs it is the one to look at first.
    triggers: Vec<Vec<TransitionNumber>>,
    /// Transitions that need nothing.
    free: Vec<TransitionNumber>,
    /// Group and priority of each transition.
    priorities: Vec<(u32, Option<u32>)>,
    pub(in crate::analysis) has_priorities: bool,
    /// Enabling function of each transition.
    whens: Vec<Option<(u32, bool)>>,
    pub(in crate::analysis) has_whens: bool,
    functions: usize,
    groups: usize,
    /// Places that some transition is inhibited by.
    pub(in crate::analysis) inhibiting: Vec<bool>,
}

/// Memory of one thread for looking at one marking.
#[derive(Default)]
pub struct Scratch {
    pub(in crate::analysis) marking: Vec<u32>,
    pub(in crate::analysis) enabled: Vec<TransitionNumber>,
    /// Per enabled transition, whether nothing can keep it from firing.
    pub(in crate::analysis) sure: Vec<bool>,
    most: Vec<u32>,
    /// Per enabling function, the highest priority at which it, and its negation, is asked.
    sides: Vec<[Option<u32>; 2]>,
    polarities: Vec<[bool; 2]>,
}

impl Rules {
    pub(super) fn new(model: &Model, layout: Layout) -> Self {
        let packed: Vec<Packed> = (0..model.transitions.len())
            .map(|number| Packed::new(model, number, &layout))
            .collect();
        // A place that few transitions need says most.
        let mut users = vec![0_usize; model.places.len()];
        for (place, _) in packed.iter().flat_map(|t| &t.needs) {
            users[*place as usize] += 1;
        }
        let mut triggers = vec![Vec::new(); model.places.len()];
        let mut free = Vec::new();
        for (number, transition) in (0..).zip(&packed) {
            let rarity = |place: u32| {
                let tokens = model.places[place as usize].tokens;
                (tokens > 0, users[place as usize])
            };
            match transition
                .needs
                .iter()
                .map(|need| need.0)
                .min_by_key(|p| rarity(*p))
            {
                Some(place) => triggers[place as usize].push(number),
                None => free.push(number),
            }
        }
        let mut inhibiting = vec![false; model.places.len()];
        for (place, _) in packed.iter().flat_map(|t| &t.forbids) {
            inhibiting[*place as usize] = true;
        }
        let whens: Vec<_> = model.transitions.iter().map(|t| t.when).collect();
        let functions = whens
            .iter()
            .flatten()
            .map(|(function, _)| *function as usize + 1);
        let groups = model.transitions.iter().map(|t| t.group as usize + 1);
        Self {
            triggers,
            free,
            priorities: model
                .transitions
                .iter()
                .map(|t| (t.group, t.priority))
                .collect(),
            has_priorities: model.has_priorities(),
            has_whens: whens.iter().any(Option::is_some),
            functions: functions.max().unwrap_or(0),
            whens,
            groups: groups.max().unwrap_or(0),
            inhibiting,
            packed,
            layout,
        }
    }

    /// The transitions that may fire at `scratch.marking`, and whether each is sure to stay possible: one
    /// with an enabling function is only sure when its negation is enabled as well, so that one of the
    /// two must be allowed.
    pub(in crate::analysis) fn enabled(&self, scratch: &mut Scratch) {
        scratch.enabled.clear();
        let all = self.triggers.iter().zip(&scratch.marking);
        for (transitions, tokens) in all {
            if *tokens == 0 {
                continue;
            }
            for number in transitions {
                if self.packed[*number as usize].is_enabled(&scratch.marking) {
                    scratch.enabled.push(*number);
                }
            }
        }
        for number in &self.free {
            if self.packed[*number as usize].is_enabled(&scratch.marking) {
                scratch.enabled.push(*number);
            }
        }
        if self.has_priorities {
            self.drop_low_priorities(scratch);
        }
        scratch.sure.clear();
        if self.has_whens {
            self.find_sure(scratch);
        } else {
            scratch.sure.resize(scratch.enabled.len(), true);
        }
    }

    /// A net never starts a transition while a more urgent one may fire. What its enabling functions say
    /// is not known, only that each says one thing to all that ask it: so a transition waits for a more
    /// urgent one without enabling function, for one with the same, and where the two sides of one
    /// function are both more urgent.
    fn drop_low_priorities(&self, scratch: &mut Scratch) {
        scratch.most.clear();
        scratch.most.resize(self.groups, 0);
        scratch.sides.clear();
        scratch.sides.resize(self.functions, [None; 2]);
        for number in &scratch.enabled {
            let (group, priority) = self.priorities[*number as usize];
            let most = match self.whens[*number as usize] {
                None => priority.unwrap_or(0),
                Some((function, negated)) => {
                    let sides = &mut scratch.sides[function as usize];
                    let side = &mut sides[usize::from(negated)];
                    *side = (*side).max(priority);
                    // One of the two sides can fire, whatever the function says.
                    sides[0].min(sides[1]).unwrap_or(0)
                }
            };
            let all = &mut scratch.most[group as usize];
            *all = most.max(*all);
        }
        let (most, sides) = (&scratch.most, &scratch.sides);
        scratch.enabled.retain(|number| {
            let (group, priority) = self.priorities[*number as usize];
            let side = self.whens[*number as usize]
                .and_then(|(function, negated)| sides[function as usize][usize::from(negated)]);
            priority
                .is_none_or(|priority| priority >= most[group as usize] && side <= Some(priority))
        });
    }

    fn find_sure(&self, scratch: &mut Scratch) {
        scratch.polarities.clear();
        scratch.polarities.resize(self.functions, [false; 2]);
        let when = |number: &TransitionNumber| self.whens[*number as usize];
        for (function, negated) in scratch.enabled.iter().filter_map(when) {
            scratch.polarities[function as usize][usize::from(negated)] = true;
        }
        for number in &scratch.enabled {
            let both =
                |(function, _): (u32, bool)| scratch.polarities[function as usize] == [true; 2];
            scratch.sure.push(when(number).is_none_or(both));
        }
    }
}
