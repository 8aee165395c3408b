//! Shortest firing sequences. No marking remembers where it came from: a way back is found by firing
//! backwards, from each level to the one before.

use super::{
    super::{
        layout::{Layout, Packed, linear, mix},
        model::TransitionNumber,
    },
    Explored, Reached, Rules, Scratch,
    worker::{Worker, owner},
};

/// The shares of all workers, to look markings up in.
pub(super) struct Lookup<'a> {
    pub(super) rules: &'a Rules,
    pub(super) workers: &'a [Worker],
}

impl Lookup<'_> {
    /// Which worker has a marking, and its number there.
    pub(super) fn find(&self, marking: &[u32], packed: &mut Vec<u64>) -> Option<(usize, u32)> {
        if !fits(&self.rules.layout, marking) {
            return None;
        }
        self.rules.layout.pack(marking, packed);
        let sum = linear(packed);
        let at = match self.workers.len() {
            1 => 0,
            count => owner(sum, count),
        };
        let id = self.workers.get(at)?.store().find(packed, sum)?;
        Some((at, id))
    }

    fn distance(&self, at: (usize, u32)) -> usize {
        self.workers[at.0].level_of(at.1)
    }

    /// A shortest sequence from the initial marking, with all markings on the way, the given one last;
    /// nothing when the marking was not found.
    pub(super) fn way(&self, to: &[u32]) -> Option<(Vec<TransitionNumber>, Vec<Vec<u32>>)> {
        let mut packed = Vec::new();
        let at = self.find(to, &mut packed)?;
        let mut distance = self.distance(at);
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
        // Of several, the marking that was found first: the way is then the one that a search in the
        // order of the transitions would take.
        let mut best: Option<((usize, u32), TransitionNumber, Vec<u32>)> = None;
        for (number, transition) in (0..).zip(&self.rules.packed) {
            if !transition.resets.is_empty() {
                continue;
            }
            let Some(before) = unfired(transition, marking) else {
                continue;
            };
            if !transition.is_enabled(&before) {
                continue;
            }
            let Some(at) = self.find(&before, packed) else {
                continue;
            };
            if self.distance(at) != distance || best.as_ref().is_some_and(|best| best.0 <= at) {
                continue;
            }
            scratch.marking.clone_from(&before);
            self.rules.enabled(scratch);
            if scratch.enabled.contains(&number) {
                best = Some((at, number, before));
            }
        }
        best.map(|(_, number, before)| (number, before))
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
        let mut target = wanted.clone();
        for worker in self.workers {
            for id in worker.level(distance) {
                let from = worker.store().get(id);
                layout.unpack(from, &mut scratch.marking);
                self.rules.enabled(&mut scratch);
                for number in &scratch.enabled {
                    let transition = &self.rules.packed[*number as usize];
                    transition.fire(layout, from, linear(from), &mut target);
                    if target == wanted {
                        return Some((*number, scratch.marking));
                    }
                }
            }
        }
        None
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
            workers: &self.workers,
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
        self.lookup().find(marking, &mut Vec::new()).is_some()
    }

    /// The nearest marking that is as wanted; of those, the first in the order of place and tokens.
    #[must_use]
    pub fn nearest(&self, wanted: impl Fn(&[u32]) -> bool) -> Option<Reached> {
        let mut marking = Vec::new();
        let mut best: Option<Reached> = None;
        for worker in &self.workers {
            for id in 0..u32::try_from(worker.len()).unwrap_or(u32::MAX) {
                let distance = || worker.level_of(id);
                self.rules
                    .layout
                    .unpack(worker.store().get(id), &mut marking);
                if !wanted(&marking) {
                    continue;
                }
                let found = Reached {
                    distance: distance(),
                    marking: marking.clone(),
                };
                // The levels follow each other: what comes after the nearest level is farther.
                if best
                    .as_ref()
                    .is_some_and(|best| best.distance < found.distance)
                {
                    break;
                }
                best = Some(best.map_or(found.clone(), |best| best.min(found)));
            }
        }
        best
    }

    /// The nearest marking at which a transition may fire.
    #[must_use]
    pub fn nearest_enabled(&self, transition: TransitionNumber) -> Option<Reached> {
        let scratch = std::cell::RefCell::new(Scratch::default());
        self.nearest(|marking| {
            let scratch = &mut *scratch.borrow_mut();
            scratch.marking.clear();
            scratch.marking.extend_from_slice(marking);
            self.rules.enabled(scratch);
            scratch.enabled.contains(&transition)
        })
    }

    pub(in crate::analysis) fn stores(&self) -> &[Worker] {
        &self.workers
    }

    /// Which worker has the marking with this packed form and [`linear`] sum.
    pub(in crate::analysis) fn owner(&self, sum: u64) -> usize {
        match self.workers.len() {
            1 => 0,
            count => (mix(sum) >> 40) as usize % count,
        }
    }
}
