//! The core of CTOS: tasks and their queues, processors, calls, names, time, synchronization, semaphores and the rules
//! of supervision.
//!
//! It opens no socket and no file and starts no process. Recorder, replay and simulation are other crates,
//! which use [`tap`] and [`disk`]. Users see it as a part of `ctos`; the modules that only the other crates of
//! the runtime use are hidden from its documentation.
//!
//! The layers, lowest first:
//!
//! - plain data: [`report`], [`phase`], [`handled`];
//! - messages and their answers: [`reply`], [`envelope`], [`delivery`];
//! - the executor, and the calls that wait there: [`processor`], [`exchange`];
//! - queues and the chassis: [`mailbox`], [`chassis`]; `kept`: answers that wait for a state to be stored;
//! - event handlers and what they reach: [`context`], [`handler`], [`registry`];
//! - their loop, and how they move: [`runner`], [`moving`];
//! - services that are tasks themselves: [`names`], [`semaphore`].

extern crate self as ctos;

/// For the code that [`command!`](ctos_message::command) writes.
#[doc(hidden)]
pub use serde;

mod asleep;
pub mod chassis;
#[doc(hidden)]
pub mod children;
pub mod circle;
mod concurrent;
#[doc(hidden)]
pub mod contain;
#[doc(hidden)]
pub mod context;
mod credits;
#[doc(hidden)]
pub mod delivery;
mod directory;
pub mod disk;
#[doc(hidden)]
pub mod envelope;
#[doc(hidden)]
pub mod exchange;
#[doc(hidden)]
pub mod handled;
#[doc(hidden)]
pub mod handler;
mod keep;
mod kept;
#[doc(hidden)]
pub mod last_messages;
#[doc(hidden)]
pub mod look;
#[doc(hidden)]
pub mod mailbox;
#[doc(hidden)]
pub mod meter;
#[doc(hidden)]
pub mod moving;
#[doc(hidden)]
pub mod names;
#[doc(hidden)]
pub mod phase;
#[doc(hidden)]
pub mod processor;
pub mod realtime;
pub mod registry;
#[doc(hidden)]
pub mod reply;
#[doc(hidden)]
pub mod report;
#[doc(hidden)]
pub mod runner;
pub mod semaphore;
#[doc(hidden)]
pub mod statistics;
pub mod supervise;
pub mod sync;
#[doc(hidden)]
pub mod system;
#[doc(hidden)]
pub mod tap;
#[doc(hidden)]
pub mod task_record;
mod task_ref;
#[doc(hidden)]
pub mod threads;
mod timers;
mod wait;
#[doc(hidden)]
pub mod waits;

pub use context::{Context, DEFAULT_DEADLINE};
pub use ctos_message::{Command, command};
pub use report::TaskCounters;

/// Event handlers and what they can do: the interface that most users of CTOS see.
pub mod task {
    pub use crate::{
        children::StartError,
        context::{Call, Context, Elapsed, Find, NameError, TaskRef},
        handled::{Handled, HandlerError},
        handler::{Durable, EventHandler, Handover},
        keep::StateStore,
        phase::{Phase, StopReason},
    };
}
/// How a call ends: with a reply or with an error that names both tasks. Always.
pub mod call {
    pub use ctos_message::fault::{CallError, Fault};
}
/// A task, seen without disturbing it.
pub mod recent {
    pub use crate::{
        last_messages::{LastMessage, TaskLook},
        report::Ending,
    };
}

/// Time as a service: one clock for the whole app, real or virtual.
pub mod time {
    pub use ctos_time::{Clock, Instant};
}

/// Messages: a 20-byte header (receiver, sender, command, flags, data size) and data.
pub mod message {
    pub use ctos_message::{
        ChassisNumber, Command, CommandInfo, Data, DataType, Flags, Header, Payload, PayloadError,
        SYSTEM_COMMANDS, Shape, ShapeKind, Tid, trimmed,
    };

    pub use crate::envelope::{Message, RawReplier, Replier};
}
