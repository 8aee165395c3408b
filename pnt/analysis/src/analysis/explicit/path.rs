//! Shortest firing sequences. No marking remembers where it came from: a way back is found by firing
//! backwards, from each level to the one before.

use super::{
    super::{
        layout::{Layout, Packed, linear},
        model::TransitionNumber,
        store::Store,
    },
    Explored,
    levels::Levels,
    reached::Reached,
    rules::{Rules, Scratch},
};

/// All that was found, to look markings up in.
pub(super) struct Lookup<'a> {
    pub(super) rules: &'a Rules,
    pub(super) store: &'a Store,
    pub(super) levels: &'a Levels,
}

impl Lookup<'_> {
    /// The distance of a marking, if it was found.
    fn distance(&self, marking: &[u32], packed: &mut Vec<u64>) -> Option<usize> {
        if !fits(&self.rules.layout, marking) {
            return None;
        }
        self.rules.layout.pack(marking, packed);
        let number = self.store.find(packed, linear(packed))?;
        self.levels.of(number)
    }

    /// A shortest sequence from the initial marking, with all markings on the way, the given one last;
    /// nothing when the marking was not found.
    pub(super) fn way(&self, to: &[u32]) -> Option<(Vec<TransitionNumber>, Vec<Vec<u32>>)> {
        let mut packed = Vec::new();
        let mut distance = self.distance(to, &mut packed)?;
        let mut marking = to.to_vec();
        let (mut sequence, mut markings) = (Vec::new(), vec![marking.clone()]);
        let mut scratch = Scratch::default();
        while distance > 0 {
            distance -= 1;
            let step = self.step_before(&marking, distance, &mut scratch, &mut packed);
            let (number, before) = step.or_else(|| self.searched_before(&marking, distance))?;
            sequence.push(number);
            markings.push(before.clone());
            marking = before;
        }
        sequence.reverse();
        markings.reverse();
        Some((sequence, markings))
    }

    /// A firing, of a transition that empties nothing, that leads here from a marking at this distance.
    fn step_before(
        &self,
        marking: &[u32],
        distance: usize,
        scratch: &mut Scratch,
        packed: &mut Vec<u64>,
    ) -> Option<(TransitionNumber, Vec<u32>)> {
        // Of several, the one that is declared last: what can be done in any order is then done in that of
        // the transitions.
        for (number, transition) in self.rules.packed.iter().enumerate().rev() {
            if !transition.resets.is_empty() {
                continue;
            }
            // Transitions are numbered with 32 bits.
            let number = number as TransitionNumber;
            let Some(before) = unfired(transition, marking) else {
                continue;
            };
            if !transition.is_enabled(&before) || self.distance(&before, packed) != Some(distance) {
                continue;
            }
            self.rules.enabled(packed, scratch);
            if scratch.enabled.contains(&number) {
                return Some((number, before));
            }
        }
        None
    }

    /// The same for any transition, by looking at the whole level.
    fn searched_before(
        &self,
        marking: &[u32],
        distance: usize,
    ) -> Option<(TransitionNumber, Vec<u32>)> {
        let layout = &self.rules.layout;
        let (mut scratch, mut wanted) = (Scratch::default(), Vec::new());
        layout.pack(marking, &mut wanted);
        let (mut from, mut target) = (wanted.clone(), wanted.clone());
        let mut best: Option<(TransitionNumber, Vec<u32>)> = None;
        for number in self.levels.level(distance) {
            self.store.read(number, &mut from);
            self.rules.enabled(&from, &mut scratch);
            layout.unpack(&from, &mut scratch.marking);
            for number in &scratch.enabled {
                let transition = &self.rules.packed[*number as usize];
                transition.fire(layout, &from, linear(&from), &mut target);
                if target != wanted {
                    continue;
                }
                let found = (*number, &scratch.marking);
                if best
                    .as_ref()
                    .is_none_or(|(n, marking)| found < (*n, marking))
                {
                    best = Some((*number, scratch.marking.clone()));
                }
            }
        }
        best
    }
}

/// Whether the tokens fit into the fields.
fn fits(layout: &Layout, marking: &[u32]) -> bool {
    let fields = layout.fields.iter();
    fields
        .zip(marking)
        .all(|(field, tokens)| *tokens <= field.most())
}

/// The marking before a firing of a transition that empties nothing.
fn unfired(transition: &Packed, marking: &[u32]) -> Option<Vec<u32>> {
    let mut before = marking.to_vec();
    for (place, gain) in &transition.gains {
        let tokens = &mut before[*place as usize];
        *tokens = tokens.checked_sub(*gain)?;
    }
    for (place, loss) in &transition.losses {
        let tokens = &mut before[*place as usize];
        *tokens = tokens.checked_add(*loss)?;
    }
    Some(before)
}

impl Explored<'_> {
    fn lookup(&self) -> Lookup<'_> {
        Lookup {
            rules: &self.rules,
            store: &self.store,
            levels: &self.levels,
        }
    }

    /// A shortest sequence of firings from the initial marking to one that was found.
    #[must_use]
    pub fn path(&self, to: &[u32]) -> Option<Vec<TransitionNumber>> {
        self.lookup().way(to).map(|(sequence, _)| sequence)
    }

    /// Whether a marking was found.
    #[must_use]
    pub fn contains(&self, marking: &[u32]) -> bool {
        self.lookup().distance(marking, &mut Vec::new()).is_some()
    }

    /// The nearest marking that is as wanted; of those, the first in the order of place and tokens.
    #[must_use]
    pub fn nearest(&self, wanted: impl Fn(&[u32]) -> bool) -> Option<Reached> {
        self.nearest_of(|_| true, wanted)
    }

    /// The same of markings whose numbers are as wanted.
    pub(in crate::analysis) fn nearest_number(
        &self,
        wanted: impl Fn(u32) -> bool,
    ) -> Option<Vec<u32>> {
        let found = self.nearest_of(wanted, |_| true)?;
        Some(found.marking)
    }

    fn nearest_of(
        &self,
        number_wanted: impl Fn(u32) -> bool,
        wanted: impl Fn(&[u32]) -> bool,
    ) -> Option<Reached> {
        let (mut packed, mut marking) = (Vec::new(), Vec::new());
        let mut best: Option<Reached> = None;
        for (distance, number) in self.levels.nearest_first() {
            // What comes now is farther.
            if best.as_ref().is_some_and(|best| best.distance < distance) {
                break;
            }
            if !number_wanted(number) {
                continue;
            }
            self.store.read(number, &mut packed);
            self.rules.layout.unpack(&packed, &mut marking);
            let least = best.as_ref().is_none_or(|best| marking < best.marking);
            if least && wanted(&marking) {
                best = Some(Reached {
                    distance,
                    marking: marking.clone(),
                });
            }
        }
        best
    }

    /// The nearest marking at which a transition may fire.
    #[must_use]
    pub fn nearest_enabled(&self, transition: TransitionNumber) -> Option<Reached> {
        let memory = std::cell::RefCell::new((Scratch::default(), Vec::new()));
        self.nearest(|marking| {
            let (scratch, packed) = &mut *memory.borrow_mut();
            self.rules.layout.pack(marking, packed);
            self.rules.enabled(packed, scratch);
            scratch.enabled.contains(&transition)
        })
    }
}
