//! What is noted of the messages of an app while it runs: each, and what becomes of it.
//!
//! Knows nothing of files and nothing of JSON.

use serde::{Deserialize, Serialize};

use ctos_core::{report::Ending, tap::Came};
use ctos_message::{ChassisNumber, Tid, fault::Fault};

/// On which chassis, seen from the message, something was noted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Side {
    /// Sender and receiver are here.
    Here,
    /// The sender is here, the receiver on another chassis.
    Sender,
    /// The receiver is here, the sender on another chassis.
    Receiver,
}

/// Which message something happened to. Numbers of messages are those of one record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Key {
    pub(crate) id: u64,
    /// The task that receives it, handles it and answers it.
    pub(crate) task: Tid,
    /// The task that sends it and gets the answer.
    pub(crate) peer: Tid,
    pub(crate) command: u16,
    pub(crate) trace: u64,
}

/// What happened to a message, or within a task. Moments are ns since the start of the app.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Step {
    /// It was sent, or came over a link; its data follows.
    Sent {
        flags: u16,
        deadline: Option<u64>,
        side: Side,
    },
    /// A handler was called with it.
    Began,
    /// It returned, so many ns after it was called.
    Ended { took: u64, ending: Ending },
    /// Its sender has what it waited for: the reply, whose data follows, the acceptance of a one-way
    /// message, or a fault.
    Answered {
        side: Side,
        came: Came,
        fault: Option<Fault>,
    },
    /// A part of the task was polled: its loop, or a child. Not noted where what follows tells it.
    Polled { part: u64 },
    /// The task read something that no message brings it; unless it is `lacking`, its value follows.
    Read { what: String, lacking: bool },
}

impl Step {
    /// Whether it happened within a task, to no message.
    pub(crate) fn is_within(&self) -> bool {
        matches!(self, Self::Polled { .. } | Self::Read { .. })
    }
}

/// Something that happened to a message, with its moment and the chassis on which it happened.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Traffic {
    pub(crate) at: u64,
    pub(crate) chassis: ChassisNumber,
    pub(crate) key: Key,
    pub(crate) step: Step,
}
