//! A task's bounded queue: a high-priority lane and a normal one, and senders that wait for room.
//!
//! First in, first out per lane, so also per pair of sender and receiver. Each lane has its own room
//! and its own line of waiting senders: a flood of normal messages cannot keep an urgent one out.
//! Messages of the runtime itself (phases, stop, a dead chassis) travel in the high-priority lane and
//! are never refused.
//!
//! The queue itself ([`TaskQueue`]) belongs to the task's processor and needs no lock. What everybody
//! else sees of it is the [`Mailbox`]: how much room there is, and the processor to bring messages to.
//! A sender on another thread claims its place as it brings the message, while nobody else does.

mod gate;
mod queue;

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use once_cell::race::OnceBox;

pub(crate) use self::{gate::Order, queue::TaskQueue};
use crate::{
    call::{Fault, ReplySlot},
    inbox::Refused,
    message::{Data, Flags, Message, SYSTEM_COMMANDS},
    processor::{Processor, ProcessorHandle},
    room::Room,
    survey::QueueReport,
};

/// Whom to tell that a one-way message has been taken.
pub(crate) enum Acceptance {
    /// Nobody: the sender waits for the reply instead, or for nothing.
    Silent,
    /// Who waits for it.
    Told(ReplySlot),
}

impl Acceptance {
    pub(crate) fn tell(self, result: Result<(), Fault>) {
        if let Self::Told(slot) = self {
            slot.answer(result.map(|()| Data::Bytes(Vec::new())));
        }
    }

    /// Whether the sender has been told already that its message was not taken.
    pub(crate) fn is_abandoned(&self) -> bool {
        match self {
            Self::Silent => false,
            Self::Told(slot) => slot.is_abandoned(),
        }
    }
}

/// What became of a message that does not wait for room.
pub(crate) enum Offered {
    /// It is in the queue.
    Taken,
    /// There is no room now.
    NoRoom(Message),
    /// The task takes nothing more.
    Closed(Message),
}

/// A message from another thread.
pub(crate) struct Delivery {
    message: Message,
    place: Place,
}

/// Where a message from another thread goes.
enum Place {
    /// To the place in the queue that its sender claimed.
    Claimed,
    /// To the queue, whether there is room or not.
    Always,
    /// To the queue, or to the line of those who wait for room there.
    Waits(Box<Acceptance>),
}

impl Delivery {
    /// Tells the sender that the task takes nothing more.
    pub(crate) fn refuse(self) {
        let acceptance = match self.place {
            Place::Waits(acceptance) => *acceptance,
            Place::Claimed | Place::Always => Acceptance::Silent,
        };
        refuse(self.message, acceptance, &Fault::Stopping);
    }
}

/// The queue of one task, for everybody.
pub(crate) struct Mailbox {
    /// Of each priority.
    capacity: u32,
    home: Arc<ProcessorHandle>,
    slot: u16,
    closed: AtomicBool,
    /// Made for the first message: of very many tasks most may be idle.
    rooms: OnceBox<Rooms>,
}

/// Of each priority one. In a line of their own, because the owner writes to them for each message and whoever
/// made them has other things beside them.
#[derive(Default)]
#[repr(align(64))]
struct Rooms {
    urgent: Room,
    normal: Room,
}

/// Whether a message goes to the high-priority lane, and whether it is one of the runtime's.
fn is_urgent(message: &Message) -> (bool, bool) {
    let system = message.command() >= SYSTEM_COMMANDS;
    let flagged = message.header().flags.contains(Flags::HIGH_PRIORITY);
    (system || flagged, system)
}

impl Mailbox {
    /// The queue of the task in `slot` of the processor `home`, with room for `capacity` messages of
    /// each priority.
    pub(crate) fn new(capacity: usize, home: Arc<ProcessorHandle>, slot: u16) -> Self {
        Self {
            // More messages than that have no memory to be in.
            capacity: u32::try_from(capacity.max(1)).unwrap_or(u32::MAX),
            home,
            slot,
            closed: AtomicBool::new(false),
            rooms: OnceBox::new(),
        }
    }

    /// How many messages of each priority it has room for.
    #[inline]
    fn capacity(&self) -> usize {
        self.capacity as usize
    }

    /// Whether the task takes nothing more.
    #[inline]
    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    #[inline]
    fn room(&self, urgent: bool) -> &Room {
        let rooms = self.rooms();
        if urgent { &rooms.urgent } else { &rooms.normal }
    }

    #[inline]
    fn rooms(&self) -> &Rooms {
        self.rooms.get_or_init(Box::default)
    }

    /// How much is in it, as senders on other threads see it.
    pub(crate) fn lengths(&self) -> QueueReport {
        let capacity = self.capacity() as u64;
        let length = |room: &Room| room.len().saturating_sub(room.waiting()) as u64;
        let report = |rooms: &Rooms| QueueReport {
            urgent: length(&rooms.urgent),
            normal: length(&rooms.normal),
            waiting: (rooms.urgent.waiting() + rooms.normal.waiting()) as u64,
            capacity,
        };
        let nothing = QueueReport {
            capacity,
            ..QueueReport::default()
        };
        self.rooms.get().map_or(nothing, report)
    }

    /// How many messages are in it, on their way to it or wait for room, and how many of each priority
    /// it holds.
    pub(crate) fn depth(&self) -> (usize, usize) {
        let rooms = self.rooms.get();
        let depth = rooms.map_or(0, |rooms| rooms.urgent.len() + rooms.normal.len());
        (depth, self.capacity())
    }

    /// Why a message finds no place.
    pub(crate) fn full(&self) -> Fault {
        Fault::Full {
            capacity: self.capacity(),
        }
    }

    /// Puts a message in if there is room now.
    pub(crate) fn offer(&self, message: Message) -> Offered {
        match Processor::at_hand(&self.home) {
            Some(processor) => match processor.queue(self.slot) {
                Some(queue) => queue.offer(&processor, message),
                None => Offered::Closed(message),
            },
            None => self.offer_from_afar(message),
        }
    }

    /// [`Self::offer`] from another thread than the task's.
    pub(crate) fn offer_from_afar(&self, message: Message) -> Offered {
        if self.is_closed() {
            return Offered::Closed(message);
        }
        let (urgent, system) = is_urgent(&message);
        let room = self.room(urgent);
        let place = if system {
            Place::Always
        } else if room.looks_free(self.capacity()) {
            Place::Claimed
        } else {
            return Offered::NoRoom(message);
        };
        let delivery = Delivery { message, place };
        let may = || system || room.claim(self.capacity());
        match self.home.bring_message(self.slot, delivery, may) {
            Ok(()) => Offered::Taken,
            Err(Refused::NotNow(delivery)) => Offered::NoRoom(delivery.message),
            Err(Refused::Closed(delivery)) => Offered::Closed(delivery.message),
        }
    }

    /// Puts a message in or lets it wait for room; `acceptance` is told when it is in, or why not. A
    /// refused message that waits for a reply is answered with the reason.
    pub(crate) fn put(&self, message: Message, acceptance: Acceptance) {
        match self.offer(message) {
            Offered::Taken => acceptance.tell(Ok(())),
            Offered::NoRoom(message) => self.line_up(message, acceptance),
            Offered::Closed(message) => refuse(message, acceptance, &Fault::Stopping),
        }
    }

    /// Lets a message for which there was no room wait for some.
    pub(crate) fn line_up(&self, message: Message, acceptance: Acceptance) {
        let (urgent, _) = is_urgent(&message);
        if !self.room(urgent).line_up(self.capacity()) {
            return refuse(message, acceptance, &self.full());
        }
        let delivery = Delivery {
            message,
            place: Place::Waits(Box::new(acceptance)),
        };
        match Processor::at_hand(&self.home)
            .and_then(|here| here.queue(self.slot).map(|queue| (here, queue)))
        {
            Some((processor, queue)) => {
                queue.take_in(&processor, delivery);
                queue.end_batch();
            }
            None => {
                let brought = self.home.bring_message(self.slot, delivery, || true);
                if let Err(Refused::NotNow(delivery) | Refused::Closed(delivery)) = brought {
                    delivery.refuse();
                }
            }
        }
    }

    fn shut(&self, shut: bool) {
        let rooms = self.rooms();
        rooms.urgent.shut(shut);
        rooms.normal.shut(shut);
    }

    /// Its queue is about to be made, with gates that are closed.
    pub(crate) fn close_gates(&self) {
        self.shut(true);
    }

    /// Lets in what came straight from `chassis`, in its order, and whatever comes from there later.
    pub(crate) fn open_gate(&self, chassis: u8) {
        self.order(Order::OpenGate(chassis));
    }

    /// Drops what came straight from `chassis`, which is gone: nobody was told that it was taken.
    pub(crate) fn forget_gate(&self, chassis: u8) {
        self.order(Order::ForgetGate(chassis));
    }

    /// Brings an order to the queue, behind the messages that were brought before it.
    fn order(&self, order: Order) {
        match Processor::here_if(&self.home) {
            Some(processor) => {
                if let Some(queue) = processor.queue(self.slot) {
                    queue.obey(&processor, order);
                }
            }
            None => self.home.bring_order(self.slot, order),
        }
    }

    /// Takes nothing more; everything inside is answered with [`Fault::Stopping`].
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
        match Processor::here_if(&self.home) {
            Some(processor) => processor.close_queue(self.slot),
            None => self.home.bring_close(self.slot),
        }
    }
}

fn refuse(message: Message, acceptance: Acceptance, fault: &Fault) {
    message.refuse(fault.clone());
    acceptance.tell(Err(fault.clone()));
}

#[cfg(test)]
mod tests;
