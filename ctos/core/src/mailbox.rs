//! A task's bounded queue: a high-priority lane and a normal one, and senders that wait for a credit.
//!
//! First in, first out per lane, so also per pair of sender and receiver. Each lane has its own credits
//! and its own line of waiting senders: a flood of normal messages cannot keep an urgent one out.
//! Messages of the runtime itself (phases, stop, a dead chassis) travel in the high-priority lane and
//! are never refused.
//!
//! The queue itself (`queue::TaskQueue`) belongs to the task's processor and needs no lock. What everybody
//! else sees of it is the [`Mailbox`]: its credits, and the processor to bring messages to.

mod gate;
pub(crate) mod queue;

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use crate::{
    credits::Credits,
    delivery::{Delivery, NotTaken, is_urgent},
    envelope::Message,
    processor::{Item, Processor, ProcessorHandle},
    reply::ReplySlot,
};
use ctos_message::{ChassisNumber, fault::Fault};

/// The queue of one task, for everybody.
pub struct Mailbox {
    /// Of each priority.
    capacity: u32,
    home: Arc<ProcessorHandle>,
    slot: u32,
    closed: AtomicBool,
    credits: LaneCredits,
}

/// The credits of both priorities. Senders write them for each message, while the task reads the rest of its mailbox.
/// On one cache line, the two would wait for one another.
#[derive(Default)]
#[repr(align(64))]
struct LaneCredits {
    urgent: Credits,
    normal: Credits,
}

impl Mailbox {
    /// The queue of the task in `slot` of the processor `home`, with credits for `capacity` messages of
    /// each priority.
    pub(crate) fn new(capacity: usize, home: Arc<ProcessorHandle>, slot: u32) -> Self {
        Self {
            // More messages than that have no memory to be in.
            capacity: u32::try_from(capacity.max(1)).unwrap_or(u32::MAX),
            home,
            slot,
            closed: AtomicBool::new(false),
            credits: LaneCredits::default(),
        }
    }

    /// How many messages of each priority there are credits for.
    fn capacity(&self) -> usize {
        self.capacity as usize
    }

    /// Whether the task takes nothing more.
    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    fn credits(&self, urgent: bool) -> &Credits {
        if urgent {
            &self.credits.urgent
        } else {
            &self.credits.normal
        }
    }

    /// Messages of high and of normal priority in it, and senders that wait for a credit, as senders on other
    /// threads see it.
    pub fn lengths(&self) -> [usize; 3] {
        let waiting = self.credits.urgent.waiting() + self.credits.normal.waiting();
        [
            self.credits.urgent.taken(),
            self.credits.normal.taken(),
            waiting,
        ]
    }

    /// How many messages are in it, on their way to it or wait for a credit, and how many of each priority
    /// it holds.
    pub fn depth(&self) -> (usize, usize) {
        let depth = |credits: &Credits| credits.taken() + credits.waiting();
        (
            depth(&self.credits.urgent) + depth(&self.credits.normal),
            self.capacity(),
        )
    }

    /// Why a message finds no place.
    pub(crate) fn full(&self) -> Fault {
        Fault::Full {
            capacity: self.capacity(),
        }
    }

    /// Takes a credit for a message, if there is one for it now, and if the task takes anything.
    pub(super) fn take_credit(&self, message: Message) -> Result<Message, NotTaken> {
        if self.is_closed() {
            return Err(NotTaken::Closed(message));
        }
        let (urgent, system) = is_urgent(&message);
        let credits = self.credits(urgent);
        if system {
            credits.take_always();
        } else if !credits.take(self.capacity()) {
            return Err(NotTaken::Full(message));
        }
        Ok(message)
    }

    /// Puts a message in if there is a credit for it now.
    pub(crate) fn offer(&self, message: Message) -> Result<(), NotTaken> {
        let message = self.take_credit(message)?;
        self.bring(Delivery::Message(message));
        Ok(())
    }

    /// Puts a message in or lets it wait for a credit. A sender that waits for that hears when it is in. A
    /// refused message is answered with the reason.
    pub fn put(&self, message: Message) {
        match self.take_credit(message) {
            Ok(mut message) => {
                let sender = message.take_acceptance();
                self.bring(Delivery::Message(message));
                sender.into_iter().for_each(ReplySlot::accept);
            }
            Err(NotTaken::Full(message)) => self.line_up(message),
            Err(NotTaken::Closed(message)) => message.refuse(Fault::Stopping),
        }
    }

    /// Lets a message for which there was no credit wait for one.
    pub(crate) fn line_up(&self, message: Message) {
        let (urgent, _) = is_urgent(&message);
        if !self.credits(urgent).line_up(self.capacity()) {
            return message.refuse(self.full());
        }
        self.bring(Delivery::Waits(message));
    }

    /// Brings something to the queue behind what was brought before: straight if this thread runs the task's
    /// processor.
    fn bring(&self, delivery: Delivery) {
        match Processor::at_hand(&self.home) {
            Some(processor) => processor.deliver(self.slot, delivery),
            None => self.home.send(Item::Delivery(self.slot, delivery)),
        }
    }

    fn shut(&self, shut: bool) {
        self.credits.urgent.shut(shut);
        self.credits.normal.shut(shut);
    }

    /// Its queue is about to be made, with gates that are closed.
    pub(crate) fn close_gates(&self) {
        self.shut(true);
    }

    /// Lets in what came straight from `chassis`, in its order, and whatever comes from there later.
    pub fn open_gate(&self, chassis: ChassisNumber) {
        self.bring(Delivery::OpenGate(chassis));
    }

    /// Drops what came straight from `chassis`, which is gone: no sender has heard that it was taken.
    pub fn forget_gate(&self, chassis: ChassisNumber) {
        self.bring(Delivery::ForgetGate(chassis));
    }

    /// Takes nothing more; everything inside is answered with [`Fault::Stopping`].
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
        match Processor::here_if(&self.home) {
            Some(processor) => processor.close_queue(self.slot),
            None => self.home.send(Item::Close(self.slot)),
        }
    }
}

#[cfg(test)]
mod tests;
