//! The queues of a processor's tasks, and those of its tasks that have none yet.

use std::{
    cell::{Cell, RefCell},
    rc::{Rc, Weak},
    sync::Arc,
};

use super::{Processor, drop_contained, prepare};
use crate::{
    chassis::{Chassis, TaskRecord},
    mailbox::TaskQueue,
    message::Tid,
    runner::Built,
};

/// The tasks of a processor, by slot.
#[derive(Default)]
pub(super) struct Queues {
    made: RefCell<Vec<Option<Rc<TaskQueue>>>>,
    /// Tasks to which nothing has come yet. In place and not each behind a pointer: a chassis may have very many.
    built: RefCell<Vec<Option<Built>>>,
    /// What their contexts are made of.
    home: RefCell<Option<Home>>,
    /// How many queues were made for tasks that had none.
    late: Cell<u32>,
}

/// Where the tasks of a processor are.
#[derive(Clone)]
struct Home {
    chassis: Arc<Chassis>,
    processor: Weak<Processor>,
    /// The id of one of them: those of the others have other slots.
    one: Tid,
}

impl Home {
    fn task(&self, slot: u16) -> Option<Arc<TaskRecord>> {
        let tid = Tid::new(self.one.chassis(), self.one.processor(), slot);
        self.chassis.task(tid)
    }
}

impl Queues {
    #[inline(always)]
    fn made(&self, slot: u16) -> Option<Rc<TaskQueue>> {
        self.made.borrow().get(usize::from(slot))?.clone()
    }

    fn take_built(&self, slot: u16) -> Option<Built> {
        self.built.borrow_mut().get_mut(usize::from(slot))?.take()
    }

    /// Takes all out; none, if there was nothing.
    pub(super) fn clear(&self) -> Option<Vec<Rc<TaskQueue>>> {
        let made = std::mem::take(&mut *self.made.borrow_mut());
        let built = std::mem::take(&mut *self.built.borrow_mut());
        self.home.take();
        if made.is_empty() && built.is_empty() {
            return None;
        }
        built.into_iter().for_each(drop_contained);
        Some(made.into_iter().flatten().collect())
    }
}

fn put<T>(into: &RefCell<Vec<Option<T>>>, slot: u16, one: T) {
    let mut places = into.borrow_mut();
    let slot = usize::from(slot);
    if places.len() <= slot {
        places.resize_with(slot + 1, || None);
    }
    if let Some(place) = places.get_mut(slot) {
        *place = Some(one);
    }
}

impl Processor {
    /// Makes the queue of the task in `slot` known.
    pub(crate) fn add_queue(&self, slot: u16, queue: Rc<TaskQueue>) {
        put(&self.queues.made, slot, queue);
    }

    /// Keeps the task `one` until something comes to it: its queue is made then.
    pub(crate) fn add_built(self: &Rc<Self>, chassis: &Arc<Chassis>, one: Tid, built: Built) {
        let mut home = self.queues.home.borrow_mut();
        home.get_or_insert_with(|| Home {
            chassis: chassis.clone(),
            processor: Rc::downgrade(self),
            one,
        });
        put(&self.queues.built, one.slot(), built);
    }

    /// The queue of the task in `slot`.
    #[inline(always)]
    pub(crate) fn queue(&self, slot: u16) -> Option<Rc<TaskQueue>> {
        match self.queues.made(slot) {
            Some(queue) => Some(queue),
            None => self.make_queue(slot),
        }
    }

    /// Whether the task in `slot` has a queue already.
    #[cfg(test)]
    pub(crate) fn has_queue(&self, slot: u16) -> bool {
        self.queues.made(slot).is_some()
    }

    /// Makes the queue of the task in `slot`, if there is such a task.
    #[cold]
    fn make_queue(&self, slot: u16) -> Option<Rc<TaskQueue>> {
        let built = self.queues.take_built(slot)?;
        let home = self.queues.home.borrow().clone()?;
        let (Some(task), Some(processor)) = (home.task(slot), home.processor.upgrade()) else {
            // It was taken out.
            drop_contained(built);
            return None;
        };
        // With the loop and what is counted some kilobytes.
        prepare(&self.queues.late, 32);
        let queue = built.rest(task, home.chassis, processor).wait();
        self.add_queue(slot, queue.clone());
        Some(queue)
    }

    /// Forgets the queue of the task in `slot` and refuses what is in it; a task that has none only goes.
    pub(crate) fn close_queue(&self, slot: u16) {
        let Some(queue) = self.queue(slot) else {
            return;
        };
        let mut made = self.queues.made.borrow_mut();
        if let Some(place) = made.get_mut(usize::from(slot)) {
            *place = None;
        }
        drop(made);
        queue.close(self);
    }
}
