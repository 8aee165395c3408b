//! Who is told what becomes of a message on its way to a queue.

use crate::{envelope::Message, reply::ReplySlot};
use ctos_message::{Data, Flags, SYSTEM_COMMANDS, fault::Fault};

/// Whom to tell that a one-way message has been taken.
pub enum Acceptance {
    /// Nobody: the sender waits for the reply instead, or for nothing.
    Silent,
    /// Who waits for it.
    Told(ReplySlot),
}

impl From<Option<ReplySlot>> for Acceptance {
    fn from(slot: Option<ReplySlot>) -> Self {
        slot.map_or(Self::Silent, Self::Told)
    }
}

impl Acceptance {
    pub(crate) fn tell(self, result: Result<(), Fault>) {
        if let Self::Told(slot) = self {
            slot.answer(result.map(|()| Data::NOTHING));
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

/// What became of a message that does not wait for a credit.
pub enum Offered {
    /// It is in the queue.
    Taken,
    /// There is no credit now.
    Full(Message),
    /// The task takes nothing more.
    Closed(Message),
}

/// Whether a message goes to the high-priority lane, and whether it is one of the runtime's.
pub(crate) fn is_urgent(message: &Message) -> (bool, bool) {
    let system = message.command() >= SYSTEM_COMMANDS;
    let flagged = message.header().flags.contains(Flags::HIGH_PRIORITY);
    (system || flagged, system)
}

pub(crate) fn refuse(message: Message, acceptance: Acceptance, fault: &Fault) {
    message.refuse(fault.clone());
    acceptance.tell(Err(fault.clone()));
}

/// What a queue is told from elsewhere.
#[derive(Debug, Clone, Copy)]
pub enum Order {
    /// See [`crate::mailbox::Mailbox::open_gate`].
    OpenGate(u8),
    /// See [`crate::mailbox::Mailbox::forget_gate`].
    ForgetGate(u8),
}
