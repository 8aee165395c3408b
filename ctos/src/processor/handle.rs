//! The part of a processor that other threads may touch, and what they bring to it.

use std::{
    rc::Rc,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    time::Duration,
};

use super::{FutureId, Processor};
use crate::{
    exchange::{Brought, CallKey, Ticket},
    inbox::{Inbox, Refused},
    mailbox::{Delivery, Order},
    park::Parker,
};

/// Work brought to a processor from another thread.
pub(super) type Job = Box<dyn FnOnce(&Rc<Processor>) + Send>;

/// What other threads bring to a processor.
pub(super) enum Item {
    /// A message for the task in a slot.
    Message(u16, Delivery),
    /// The answer to a call that a task of the processor waits for.
    Answer(Ticket, Brought),
    /// The same from somebody who no longer has the ticket.
    AnswerByKey(CallKey, Brought),
    /// A future is ready.
    Wake(FutureId),
    /// The task in a slot takes nothing more.
    Close(u16),
    /// An order to the queue of the task in a slot.
    Order(u16, Order),
    Job(Job),
    /// Nothing but a reason to look up.
    Nudge,
}

/// The part of a processor that other threads may touch.
#[derive(Default)]
pub(crate) struct ProcessorHandle {
    index: u8,
    pub(super) inbox: Inbox<Item>,
    /// Where its thread sleeps.
    pub(crate) parker: Parker,
    pub(super) stop: AtomicBool,
    /// How long the thread looks for work before it sleeps, ns.
    pub(super) spin_ns: AtomicU64,
    /// Whether the thread lets others have its core before it sleeps.
    pub(super) shares_core: AtomicBool,
}

impl ProcessorHandle {
    /// The handle of the `index`-th processor of a chassis.
    pub(crate) fn new(index: u8) -> Self {
        Self {
            index,
            ..Self::default()
        }
    }

    /// Its number on its chassis.
    pub(crate) fn index(&self) -> u8 {
        self.index
    }

    /// Runs `job` on the processor's thread, soon.
    pub(crate) fn inject(&self, job: impl FnOnce(&Rc<Processor>) + Send + 'static) {
        // What is refused is dropped here, outside of all locks: the processor is gone.
        drop(self.bring(Item::Job(Box::new(job))));
    }

    /// Ends [`Processor::run`] after the present step.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Release);
        self.unpark();
    }

    /// Wakes the processor, if it sleeps.
    pub(crate) fn unpark(&self) {
        drop(self.bring(Item::Nudge));
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

    /// Brings a message for the task in `slot` if `may` says so, which runs while nobody else brings anything.
    ///
    /// # Errors
    /// The message, when it was not brought.
    #[inline]
    pub(crate) fn bring_message(
        &self,
        slot: u16,
        delivery: Delivery,
        may: impl FnOnce() -> bool,
    ) -> Result<(), Refused<Delivery>> {
        match self.inbox.push_if(Item::Message(slot, delivery), may) {
            Err(Refused::NotNow(Item::Message(_, delivery))) => Err(Refused::NotNow(delivery)),
            Err(Refused::Closed(Item::Message(_, delivery))) => Err(Refused::Closed(delivery)),
            // What was refused is what was to be brought.
            Ok(false) | Err(_) => Ok(()),
            Ok(true) => {
                self.parker.unpark();
                Ok(())
            }
        }
    }

    /// Tells the processor that the task in `slot` takes nothing more.
    pub(crate) fn bring_close(&self, slot: u16) {
        drop(self.bring(Item::Close(slot)));
    }

    /// Brings an order to the queue of the task in `slot`.
    pub(crate) fn bring_order(&self, slot: u16, order: Order) {
        drop(self.bring(Item::Order(slot, order)));
    }

    /// Brings the answer to a call. Without a processor nobody waits for it.
    pub(crate) fn bring_answer(&self, ticket: Ticket, answer: Brought) {
        drop(self.bring(Item::Answer(ticket, answer)));
    }

    /// [`Self::bring_answer`] without the ticket.
    pub(crate) fn bring_answer_by_key(&self, key: CallKey, answer: Brought) {
        drop(self.bring(Item::AnswerByKey(key, answer)));
    }

    pub(super) fn bring(&self, item: Item) -> Result<(), Item> {
        if self.inbox.push(item)? {
            self.parker.unpark();
        }
        Ok(())
    }
}
