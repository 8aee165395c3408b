//! Who has arrived at one barrier: the rules, without time, threads or messages.

use super::{Passage, ledger::Claim};

/// A barrier. `W` wakes somebody who waits.
#[derive(Debug)]
pub(super) struct Gathering<W> {
    parties: u32,
    /// In the order in which they arrived.
    arrived: Vec<(Claim, W)>,
    generation: u64,
}

impl<W> Gathering<W> {
    pub(super) fn new(parties: u32) -> Self {
        Self {
            parties,
            arrived: Vec::new(),
            generation: 0,
        }
    }

    pub(super) fn parties(&self) -> u32 {
        self.parties
    }

    /// Arrives; the last one makes everybody pass.
    pub fn arrive(&mut self, claim: Claim, waiter: W) -> Vec<(Claim, W, Passage)> {
        self.arrived.push((claim, waiter));
        if self.arrived.len() < self.parties as usize {
            return Vec::new();
        }
        self.generation += 1;
        let generation = self.generation;
        let all = std::mem::take(&mut self.arrived);
        let last = all.len() - 1;
        let passing = all.into_iter().enumerate();
        passing
            .map(|(index, (claim, waiter))| {
                let last = index == last;
                (claim, waiter, Passage { generation, last })
            })
            .collect()
    }

    /// Those whom `gone` names have not arrived.
    pub(super) fn leave(&mut self, gone: impl Fn(&Claim) -> bool) -> Vec<W> {
        let all = std::mem::take(&mut self.arrived);
        let (left, stayed) = all.into_iter().partition(|(claim, _)| gone(claim));
        self.arrived = stayed;
        let left: Vec<(Claim, W)> = left;
        left.into_iter().map(|(_, waiter)| waiter).collect()
    }

    /// The tasks that have arrived.
    pub(super) fn arrived(&self) -> Vec<String> {
        let arrived = self.arrived.iter();
        arrived.map(|(claim, _)| claim.task.to_string()).collect()
    }

    /// Forgets those who wait; they are told by dropping what is returned.
    pub(super) fn close(&mut self) -> Vec<(Claim, W)> {
        std::mem::take(&mut self.arrived)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::semaphore::ledger::Hold;
    use ctos_message::Tid;

    proptest! {
        #[test]
        fn everybody_passes_together_and_only_when_all_are_there(
            parties in 1_u32..6,
            steps in proptest::collection::vec((any::<bool>(), any::<prop::sample::Index>()), 1..100),
        ) {
            let mut gathering = Gathering::new(parties);
            let mut there: Vec<u64> = Vec::new();
            let mut generations = 0;
            for (number, (arrives, index)) in steps.into_iter().enumerate() {
                let number = number as u64;
                if arrives || number == 0 {
                    let hold = Hold { chassis: 0, number };
                    let claim = Claim { hold, task: "t".into(), tid: Tid::default() };
                    there.push(number);
                    let passing = gathering.arrive(claim, number);
                    if there.len() < parties as usize {
                        prop_assert!(passing.is_empty());
                        continue;
                    }
                    generations += 1;
                    let all: Vec<u64> = passing.iter().map(|(_, number, _)| *number).collect();
                    prop_assert_eq!(&all, &there);
                    for (claim, _, passage) in &passing {
                        prop_assert_eq!(passage.generation, generations);
                        prop_assert_eq!(passage.last, claim.hold.number == number);
                    }
                    there.clear();
                } else {
                    // Somebody who is there, was there, or never was.
                    let gone = index.index(number as usize) as u64;
                    let left = gathering.leave(|claim| claim.hold.number == gone);
                    prop_assert_eq!(left.len(), usize::from(there.contains(&gone)));
                    there.retain(|number| *number != gone);
                }
                prop_assert_eq!(gathering.arrived().len(), there.len());
            }
        }
    }
}
