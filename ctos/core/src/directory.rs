//! What one chassis knows of the places of tasks: known names, ids that others replaced, and the
//! slots of its processors that it gave away.
//!
//! A task id is given away once in a run. When a task moves, or its chassis is started again, its name
//! gets a new id. The old id is kept and leads to the new one. So a holder of the old id still reaches
//! the task of that name, and never another one.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, PoisonError, RwLock,
        atomic::{AtomicBool, Ordering},
    },
};

use ctos_message::{ChassisNumber, Tid};
use ctos_time::lock::lock;

/// The directory of one chassis. Shared by its threads.
#[derive(Default)]
pub struct TaskDirectory {
    known: Mutex<BTreeMap<Arc<str>, Tid>>,
    /// From each id that was replaced straight to the present one.
    rebound: RwLock<BTreeMap<Tid, Tid>>,
    /// Whether there is anything in `rebound`: most runs never replace an id, and then a message costs
    /// one load.
    any: AtomicBool,
    /// The next free slot of each processor, by its number.
    slots: Mutex<BTreeMap<u8, u32>>,
}

impl TaskDirectory {
    /// Whether no id was ever replaced: then each is the present one.
    #[inline]
    pub(crate) fn is_as_begun(&self) -> bool {
        !self.any.load(Ordering::Acquire)
    }

    /// The id that a message to `tid` goes to.
    pub fn current(&self, tid: Tid) -> Tid {
        if self.is_as_begun() {
            return tid;
        }
        let rebound = self.rebound.read().unwrap_or_else(PoisonError::into_inner);
        rebound.get(&tid).copied().unwrap_or(tid)
    }

    /// The task `name`, if this chassis was told; with the name, which all who ask share.
    pub fn known(&self, name: &str) -> Option<(Arc<str>, Tid)> {
        let known = lock(&self.known);
        let (name, tid) = known.get_key_value(name)?;
        Some((Arc::clone(name), *tid))
    }

    /// Remembers an answer of the task identification service, which may be older than a change that
    /// arrived since.
    pub fn learn(&self, name: &str, tid: Tid) -> Tid {
        let tid = self.current(tid);
        lock(&self.known).insert(name.into(), tid);
        tid
    }

    /// The task `name` has the id `new` now, if it is still there, and had `old` before.
    pub fn rebind(&self, name: &str, old: Tid, new: Option<Tid>) {
        if let Some(new) = new.filter(|new| *new != old) {
            let mut rebound = self.rebound.write().unwrap_or_else(PoisonError::into_inner);
            for target in rebound.values_mut().filter(|target| **target == old) {
                *target = new;
            }
            rebound.insert(old, new);
            self.any.store(true, Ordering::Release);
        }
        // The name is asked for again: its task may not have passed its phases yet.
        let mut known = lock(&self.known);
        if known.get(name) == Some(&old) {
            known.remove(name);
        }
    }

    /// The task with this name does not answer: the name is looked up again.
    pub fn forget(&self, name: &str) {
        lock(&self.known).remove(name);
    }

    /// Chassis `peer` is gone, and with it what was known of its tasks.
    pub(crate) fn forget_chassis(&self, peer: ChassisNumber) {
        lock(&self.known).retain(|_, tid| tid.chassis() != peer);
    }

    /// Slots below these were given away before; by the number of the processor.
    pub fn start_slots_at(&self, first: &BTreeMap<u8, u32>) {
        let mut slots = lock(&self.slots);
        for (processor, first) in first {
            let slot = slots.entry(*processor).or_default();
            *slot = (*slot).max(*first);
        }
    }

    /// A slot of `processor` that no task of this run ever had; `None` when there is none left.
    pub fn free_slot(&self, processor: u8) -> Option<u32> {
        let mut slots = lock(&self.slots);
        let slot = slots.entry(processor).or_default();
        let free = *slot;
        let is_one = free <= Tid::LAST_SLOT;
        *slot += u32::from(is_one);
        is_one.then_some(free)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn known(directory: &TaskDirectory) -> Option<Tid> {
        directory.known("arm").map(|(_, tid)| tid)
    }

    #[test]
    fn an_answer_that_is_older_than_a_move_leads_to_the_new_place() {
        let directory = TaskDirectory::default();
        let (old, new) = (Tid::new(1, 1, 0), Tid::new(2, 1, 0));
        directory.rebind("arm", old, Some(new));
        assert_eq!(directory.learn("arm", old), new);
        assert_eq!(known(&directory), Some(new));
    }

    #[test]
    fn a_name_that_was_freed_is_forgotten_and_a_newer_one_is_not() {
        let directory = TaskDirectory::default();
        let (old, new) = (Tid::new(1, 1, 0), Tid::new(2, 1, 0));
        directory.learn("arm", old);
        directory.rebind("arm", old, None);
        assert_eq!(known(&directory), None);
        directory.learn("arm", new);
        directory.rebind("arm", old, None);
        assert_eq!(known(&directory), Some(new));
    }

    proptest! {
        #[test]
        fn every_id_that_a_task_ever_had_leads_to_the_one_it_has(places in proptest::collection::vec((0_u16..4, 0_u8..3), 1..40)) {
            let directory = TaskDirectory::default();
            let other = Tid::new(9, 9, 9);
            let ids: Vec<Tid> = places
                .iter()
                .enumerate()
                .map(|(slot, (chassis, processor))| Tid::new(*chassis, *processor, slot as u32))
                .collect();
            for pair in ids.windows(2) {
                directory.rebind("arm", pair[0], Some(pair[1]));
            }
            for id in &ids {
                prop_assert_eq!(directory.current(*id), ids[ids.len() - 1]);
            }
            prop_assert_eq!(directory.current(other), other);
        }

        #[test]
        fn no_slot_is_given_away_twice(first in proptest::collection::btree_map(0_u8..4, 0_u32..50, 0..4), draws in proptest::collection::vec(0_u8..4, 0..60)) {
            let directory = TaskDirectory::default();
            directory.start_slots_at(&first);
            let mut given = std::collections::BTreeSet::new();
            for processor in draws {
                let slot = directory.free_slot(processor).unwrap();
                prop_assert!(slot >= first.get(&processor).copied().unwrap_or(0));
                prop_assert!(given.insert((processor, slot)));
            }
        }
    }

    #[test]
    fn a_processor_whose_slots_are_used_up_says_so() {
        let directory = TaskDirectory::default();
        directory.start_slots_at(&BTreeMap::from([(1, Tid::LAST_SLOT)]));
        assert_eq!(directory.free_slot(1), Some(Tid::LAST_SLOT));
        assert_eq!(directory.free_slot(1), None);
        assert_eq!(directory.free_slot(0), Some(0));
    }
}
