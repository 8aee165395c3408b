//! Firings between start and end, in the order of their starts, and their time limits. Allocates only
//! to grow: one that ends leaves its room to those that follow.

use std::{
    cmp::Reverse,
    collections::{BinaryHeap, VecDeque},
};

use serde::{Deserialize, Serialize};

use crate::net::TransitionId;

/// Number of one firing of a transition, counted from the start of the execution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FiringId(pub(super) u64);

impl FiringId {
    /// The number.
    #[must_use]
    pub fn number(self) -> u64 {
        self.0
    }
}

/// A firing between start and end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Running {
    pub(super) firing: FiringId,
    pub(super) transition: TransitionId,
    /// The command that it read from the tape.
    pub(super) command: Option<u64>,
    /// When its action's time is over.
    pub(super) deadline_ns: Option<u64>,
    ended: bool,
}

/// Ended firings and forgotten deadlines that are kept before they are cleared away.
const SPARE: usize = 64;

#[derive(Debug, Clone, Default)]
pub(super) struct AllRunning {
    /// By number; those that have ended are taken out when they come to the front or are many.
    firings: VecDeque<Running>,
    going_on: usize,
    /// Limits, the next one on top; some belong to firings that have ended.
    limits: BinaryHeap<Reverse<(u64, FiringId)>>,
}

impl AllRunning {
    /// Numbers must grow.
    pub(super) fn push(
        &mut self,
        firing: FiringId,
        transition: TransitionId,
        command: Option<u64>,
        deadline_ns: Option<u64>,
    ) {
        self.firings.push_back(Running {
            firing,
            transition,
            command,
            deadline_ns,
            ended: false,
        });
        self.going_on += 1;
        if let Some(deadline_ns) = deadline_ns {
            if self.limits.len() > 2 * self.going_on + SPARE {
                let (firings, limits) = (&self.firings, &mut self.limits);
                limits.retain(|Reverse((_, firing))| find(firings, *firing).is_some());
            }
            self.limits.push(Reverse((deadline_ns, firing)));
        }
    }

    pub(super) fn get(&self, firing: FiringId) -> Option<&Running> {
        self.firings.get(find(&self.firings, firing)?)
    }

    pub(super) fn remove(&mut self, firing: FiringId) -> Option<Running> {
        let index = find(&self.firings, firing)?;
        let running = self.firings.get_mut(index)?;
        running.ended = true;
        let removed = *running;
        self.going_on -= 1;
        while self.firings.front().is_some_and(|running| running.ended) {
            self.firings.pop_front();
        }
        if self.firings.len() > 2 * self.going_on + SPARE {
            self.firings.retain(|running| !running.ended);
        }
        Some(removed)
    }

    /// Those that go on, oldest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Running> {
        self.firings.iter().filter(|running| !running.ended)
    }

    /// The next time limit of one that goes on.
    pub(super) fn next_limit(&mut self) -> Option<(u64, FiringId)> {
        loop {
            let Reverse((deadline_ns, firing)) = *self.limits.peek()?;
            if self.get(firing).is_some() {
                return Some((deadline_ns, firing));
            }
            self.limits.pop();
        }
    }
}

fn find(firings: &VecDeque<Running>, firing: FiringId) -> Option<usize> {
    let index = firings
        .binary_search_by_key(&firing, |running| running.firing)
        .ok()?;
    firings
        .get(index)
        .filter(|running| !running.ended)
        .map(|_| index)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_agrees_with_an_ordered_map(steps in prop::collection::vec((0_u8..4, any::<prop::sample::Index>(), 0_u64..50), 0..400)) {
            let mut ours = AllRunning::default();
            let mut theirs: BTreeMap<FiringId, u64> = BTreeMap::new();
            for (number, (kind, pick, deadline)) in (0..).zip(steps) {
                if kind < 2 {
                    ours.push(FiringId(number), TransitionId(0), None, Some(deadline));
                    theirs.insert(FiringId(number), deadline);
                } else if !theirs.is_empty() {
                    let keys: Vec<FiringId> = theirs.keys().copied().collect();
                    let firing = *pick.get(&keys);
                    theirs.remove(&firing);
                    prop_assert_eq!(ours.remove(firing).map(|running| running.firing), Some(firing));
                    prop_assert!(ours.remove(firing).is_none());
                }
                prop_assert!(ours.iter().map(|running| running.firing).eq(theirs.keys().copied()));
                let next = theirs.iter().map(|(firing, deadline)| (*deadline, *firing)).min();
                prop_assert_eq!(ours.next_limit(), next);
                prop_assert!(ours.firings.len() <= 2 * theirs.len() + SPARE + 1);
            }
        }
    }
}
