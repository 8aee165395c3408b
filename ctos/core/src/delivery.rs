//! What comes to the queue of a task, and what becomes of it there.

use crate::envelope::Message;
use ctos_message::{ChassisNumber, Flags, SYSTEM_COMMANDS, fault::Fault};

/// A message that was not taken.
pub enum NotTaken {
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

/// What is brought to a queue.
pub enum Delivery {
    /// A message that has a credit.
    Message(Message),
    /// One that waits for a credit.
    Waits(Message),
    /// See [`crate::mailbox::Mailbox::open_gate`].
    OpenGate(ChassisNumber),
    /// See [`crate::mailbox::Mailbox::forget_gate`].
    ForgetGate(ChassisNumber),
}

impl Delivery {
    /// The queue is gone: waiting senders are told.
    pub(crate) fn refuse(self) {
        if let Self::Message(message) | Self::Waits(message) = self {
            message.refuse(Fault::Stopping);
        }
    }
}
