//! The part of a processor that other threads may touch, and what they bring to it.

use std::{
    rc::Rc,
    sync::{
        Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use crossbeam_channel::{Receiver, Sender};

use super::core::Processor;
use crate::processor::wake::FutureId;
use crate::{
    asleep::Asleep,
    contain::drop_contained,
    delivery::Delivery,
    reply::{CallKey, Returned},
};
use ctos_time::{lock::lock, park::Parker};

/// Work brought to a processor from another thread.
pub(crate) type Job = Box<dyn FnOnce(&Rc<Processor>) + Send>;

/// What other threads bring to a processor.
pub(crate) enum Item {
    /// Something for the queue of the task in a slot.
    Delivery(u32, Delivery),
    /// The answer to a call that a task of the processor waits for.
    Answer(CallKey, Returned),
    /// A future is ready.
    Wake(FutureId),
    /// The task in a slot takes nothing more.
    Close(u32),
    Job(Job),
    /// Nothing but a reason to look up.
    Nudge,
}

impl Item {
    /// The processor, or the task, takes nothing more: senders that wait for a credit or an answer are
    /// told.
    pub(super) fn refuse(self) {
        match self {
            Self::Delivery(_, delivery) => delivery.refuse(),
            item => drop_contained(item),
        }
    }
}

/// The part of a processor that other threads may touch.
pub struct ProcessorHandle {
    inbox: Sender<Item>,
    /// The other end, until the processor takes it.
    outlet: Mutex<Option<Receiver<Item>>>,
    pub(super) asleep: Asleep,
    /// Where its thread sleeps.
    pub(crate) parker: Parker,
    pub(super) stop: AtomicBool,
    /// How long the thread looks for work before it sleeps, ns.
    pub(super) spin_ns: AtomicU64,
    /// Whether the thread lets others have its core before it sleeps.
    pub(super) shares_core: AtomicBool,
}

impl Default for ProcessorHandle {
    /// That of a processor that has no thread yet.
    fn default() -> Self {
        let (inbox, outlet) = crossbeam_channel::unbounded();
        Self {
            inbox,
            outlet: Mutex::new(Some(outlet)),
            asleep: Asleep::default(),
            parker: Parker::default(),
            stop: AtomicBool::new(false),
            spin_ns: AtomicU64::new(0),
            shares_core: AtomicBool::new(false),
        }
    }
}

impl ProcessorHandle {
    /// Where what is brought comes out; nothing ever does for a second processor of the same handle.
    pub(super) fn take_outlet(&self) -> Receiver<Item> {
        let outlet = lock(&self.outlet).take();
        outlet.unwrap_or_else(crossbeam_channel::never)
    }

    /// Runs `job` on the processor's thread, soon.
    pub fn inject(&self, job: impl FnOnce(&Rc<Processor>) + Send + 'static) {
        self.send(Item::Job(Box::new(job)));
    }

    /// Ends [`Processor::run`] after the present step.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Release);
        self.unpark();
    }

    /// Wakes the processor, if it sleeps.
    pub(crate) fn unpark(&self) {
        self.send(Item::Nudge);
    }

    /// How long the thread looks for work before it sleeps. Worth it only where those who bring work
    /// run on other cores.
    pub(crate) fn set_spin(&self, spin: Duration) {
        let spin_ns = u64::try_from(spin.as_nanos()).unwrap_or(u64::MAX);
        self.spin_ns.store(spin_ns, Ordering::Relaxed);
    }

    /// Whether another processor runs on the same core: then the thread lets it have that before it sleeps.
    pub(crate) fn set_shares_core(&self, shares: bool) {
        self.shares_core.store(shares, Ordering::Relaxed);
    }

    /// Brings something. When the processor is gone, it is refused here, outside of all locks.
    pub(crate) fn send(&self, item: Item) {
        if let Err(refused) = self.inbox.send(item) {
            return refused.0.refuse();
        }
        if self.asleep.must_be_woken() {
            self.parker.unpark();
        }
    }
}
