//! Which transitions may fire at a marking.

use std::{mem, ops::Range};

use super::super::{
    compare::{Bits, Compare, Marked, Sum, enabling, room},
    layout::{Layout, Packed},
    model::{Model, PlaceNumber, TransitionNumber},
    tables::{self, CONDITIONS, Tables},
};

/// The transitions against a layout, and where to look for enabled ones.
pub struct Rules {
    pub(in crate::analysis) layout: Layout,
    pub(in crate::analysis) packed: Vec<Packed>,
    /// What enables each transition, ordered by the place of its needs that is the one to look at first;
    /// last those that need nothing.
    conditions: Vec<Condition>,
    /// The same where for every transition it is enough to look at some bits of one word.
    bits: Option<Vec<(TransitionNumber, Bits)>>,
    /// Per place, which of them it is looked at for; and for those that need nothing.
    by_place: Vec<Range<usize>>,
    free: Range<usize>,
    /// Finds the places that are looked at first, where it does not pay to try all transitions.
    marked: Option<Marked>,
    /// The conditions looked up, once that pays.
    tables: Option<Looked>,
    /// Whether it was tried.
    looks_up: bool,
    pub(in crate::analysis) sum: Sum,
    /// What each transition adds to a packed marking and to its [`linear`] sum, where markings are one word
    /// and nothing is emptied.
    ///
    /// [`linear`]: crate::analysis::layout::linear
    pub(in crate::analysis) steps: Option<Vec<(u64, u64)>>,
    /// Per transition, what holds where its gains fit.
    room: Vec<Vec<Compare>>,
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

/// Transitions up to which all are tried at every marking.
const ALL: usize = 64;

/// By bits, in the order of the conditions: which transitions are enabled, and whose gains fit.
struct Looked {
    enabling: Tables,
    room: Tables,
}

/// What enables a transition. Nearly always one comparison is all.
struct Condition {
    transition: TransitionNumber,
    first: Compare,
    others: Vec<Compare>,
}

impl Condition {
    fn bits(&self) -> Option<(TransitionNumber, Bits)> {
        let bits = self.others.is_empty().then(|| self.first.bits());
        Some((self.transition, bits.flatten()?))
    }

    #[inline]
    fn holds(&self, packed: &[u64]) -> bool {
        self.first.holds(packed) && self.others.iter().all(|compare| compare.holds(packed))
    }
}

/// Memory of one thread for looking at one marking.
#[derive(Default)]
pub struct Scratch {
    pub(in crate::analysis) marking: Vec<u32>,
    pub(in crate::analysis) enabled: Vec<TransitionNumber>,
    /// Per enabled transition, whether nothing can keep it from firing; empty where there are no enabling
    /// functions, so that all are sure.
    pub(in crate::analysis) sure: Vec<bool>,
    /// The same as `enabled`, a bit for each condition, where conditions are looked up.
    pub(in crate::analysis) bits: Option<u64>,
    most: Vec<u32>,
    /// Per enabling function, the highest priority at which it, and its negation, is asked.
    sides: Vec<[Option<u32>; 2]>,
    polarities: Vec<[bool; 2]>,
}

impl Rules {
    pub(in crate::analysis) fn new(model: &Model, layout: Layout) -> Self {
        let packed: Vec<Packed> = (0..model.transitions.len())
            .map(|number| Packed::new(model, number, &layout))
            .collect();
        let firsts = firsts(model, &packed);
        let (mut conditions, mut by_place) = (Vec::new(), Vec::new());
        // By first place, those without one last.
        let mut of: Vec<Vec<TransitionNumber>> = vec![Vec::new(); model.places.len() + 1];
        for (transition, first) in (0..).zip(&firsts) {
            let at = first.map_or(model.places.len(), |place| place as usize);
            of[at].push(transition);
        }
        for transitions in of {
            let start = conditions.len();
            conditions.extend(transitions.into_iter().map(|transition| {
                let t = &packed[transition as usize];
                let mut all = enabling(&layout, &t.needs, &t.forbids).into_iter();
                Condition {
                    transition,
                    first: all.next().unwrap_or_default(),
                    others: all.collect(),
                }
            }));
            by_place.push(start..conditions.len());
        }
        let free = by_place.pop().unwrap_or_default();
        let bits = conditions.iter().map(Condition::bits).collect();
        let marked = (conditions.len() > ALL)
            .then(|| Marked::new(&layout, firsts.iter().copied().flatten()));
        let plain = layout.words == 1 && packed.iter().all(|t| t.resets.is_empty());
        let steps = plain.then(|| packed.iter().map(Packed::step).collect());
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
            conditions,
            bits,
            by_place,
            free,
            marked,
            sum: Sum::new(&layout),
            steps,
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
            room: packed
                .iter()
                .map(|t| enabling(&layout, &[], &room(&layout, &t.gains)))
                .collect(),
            tables: None,
            looks_up: false,
            packed,
            layout,
        }
    }

    /// Looks the conditions up from here on, where that is possible. To get ready for it takes as long as some
    /// hundred markings.
    pub(super) fn look_up(&mut self) {
        if mem::replace(&mut self.looks_up, true) || self.conditions.len() > CONDITIONS {
            return;
        }
        let each = self.conditions.iter();
        let each = each.map(|condition| &self.packed[condition.transition as usize]);
        let enabling = each.clone().map(|t| {
            Some(tables::Condition {
                at_least: t.needs.clone(),
                below: t.forbids.clone(),
            })
        });
        let room = each.map(|t| {
            t.resets.is_empty().then(|| tables::Condition {
                at_least: Vec::new(),
                below: room(&self.layout, &t.gains),
            })
        });
        let new = |conditions: Vec<_>| Tables::new(&self.layout, &conditions);
        let both = new(enabling.collect()).zip(new(room.collect()));
        self.tables = both.map(|(enabling, room)| Looked { enabling, room });
    }

    /// The transitions that may fire at a packed marking, and whether each is sure to stay possible. One
    /// with an enabling function is only sure when its negation is enabled as well: one of the two must
    /// be allowed.
    pub(in crate::analysis) fn enabled(&self, packed: &[u64], scratch: &mut Scratch) {
        scratch.enabled.clear();
        scratch.bits = None;
        match (&self.tables, &self.marked) {
            (Some(tables), _) => {
                let met = tables.enabling.met(packed);
                scratch.enabled.extend(self.of_bits(met));
                scratch.bits = (!self.has_priorities).then_some(met);
            }
            (None, None) => self.try_all(0..self.conditions.len(), packed, &mut scratch.enabled),
            (None, Some(marked)) => {
                let places = marked.of(packed);
                let tried = places.map(|place| self.by_place[place as usize].clone());
                for range in tried.chain([self.free.clone()]) {
                    self.try_all(range, packed, &mut scratch.enabled);
                }
            }
        }
        if self.has_priorities {
            self.drop_low_priorities(scratch);
        }
        if self.has_whens {
            scratch.sure.clear();
            self.find_sure(scratch);
        }
    }

    /// The transitions of some bits, in order.
    #[inline]
    fn of_bits(&self, mut bits: u64) -> impl ExactSizeIterator<Item = TransitionNumber> {
        (0..bits.count_ones()).map(move |_| {
            let bit = bits.trailing_zeros();
            bits &= bits - 1;
            self.conditions[bit as usize].transition
        })
    }

    /// Adds those of some transitions that are enabled.
    fn try_all(&self, range: Range<usize>, packed: &[u64], enabled: &mut Vec<TransitionNumber>) {
        match &self.bits {
            Some(bits) => add_all(&bits[range], enabled, |(number, bits)| {
                (*number, bits.holds(packed))
            }),
            None => add_all(&self.conditions[range], enabled, |condition| {
                (condition.transition, condition.holds(packed))
            }),
        }
    }

    /// Whether what a transition puts fits; it empties nothing.
    pub(in crate::analysis) fn has_room(&self, number: TransitionNumber, packed: &[u64]) -> bool {
        let mut room = self.room[number as usize].iter();
        room.all(|compare| compare.holds(packed))
    }

    /// Whether what each of the enabled transitions puts fits, as far as that can be looked up.
    pub(in crate::analysis) fn all_have_room(&self, packed: &[u64], scratch: &Scratch) -> bool {
        let tables = self.tables.as_ref().zip(scratch.bits);
        tables.is_some_and(|(tables, enabled)| enabled & !tables.room.met(packed) == 0)
    }

    /// Whether none of the transitions that were found enabled is sure.
    pub(in crate::analysis) fn is_dead(&self, scratch: &Scratch) -> bool {
        match self.has_whens {
            true => !scratch.sure.contains(&true),
            false => scratch.enabled.is_empty(),
        }
    }

    /// A net never starts a transition while a more urgent one may fire. The answers of its enabling
    /// functions are not known, only that each gives all transitions the same answer. So a transition
    /// waits for a more urgent one if that has no enabling function, or the same. It also waits where
    /// the two sides of one function are both more urgent.
    pub(in crate::analysis) fn drop_low_priorities(&self, scratch: &mut Scratch) {
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

/// Per transition, the place of its needs that is looked at first: one that few transitions need says most.
fn firsts(model: &Model, packed: &[Packed]) -> Vec<Option<PlaceNumber>> {
    let mut users = vec![0_usize; model.places.len()];
    for (place, _) in packed.iter().flat_map(|t| &t.needs) {
        users[*place as usize] += 1;
    }
    let rarity = |place: &PlaceNumber| {
        let tokens = model.places[*place as usize].tokens;
        (tokens > 0, users[*place as usize])
    };
    let first = |t: &Packed| t.needs.iter().map(|need| need.0).min_by_key(rarity);
    packed.iter().map(first).collect()
}

/// Adds those that are enabled. Which they are cannot be foreseen, so nothing is jumped over.
fn add_all<T>(
    conditions: &[T],
    enabled: &mut Vec<TransitionNumber>,
    holds: impl Fn(&T) -> (TransitionNumber, bool),
) {
    let mut count = enabled.len();
    enabled.resize(count + conditions.len(), 0);
    for condition in conditions {
        let (number, holds) = holds(condition);
        enabled[count] = number;
        count += usize::from(holds);
    }
    enabled.truncate(count);
}
