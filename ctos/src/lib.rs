//! CTOS, the runtime that everything else stands on: event handler tasks, found by symbolic name, that
//! exchange messages across threads, processes and machines, booted from a configuration file.
//!
//! It re-creates the five services of the CIRSSE Testbed Operating System (CIRSSE report 108,
//! section 3): bootstrap ([`boot`]), task identification ([`task::Context::task`]), message passing
//! ([`message`], [`call`]), synchronization ([`sync`], [`realtime`]) and inter-processor blocking
//! ([`semaphore`]); inside a chassis also shared memory ([`chassis::Chassis::share`]). It knows nothing of robots, nets or pictures.
//!
//! Start with [`task::EventHandler`]; register it in a [`registry::Registry`]; name it in a
//! configuration ([`config`]); boot that with [`boot::boot`].

extern crate self as ctos;

/// For the code that [`command!`] writes.
#[doc(hidden)]
pub use serde;

#[doc(hidden)]
pub mod bench;
pub mod boot;

pub mod chassis;
pub mod control;
pub mod disk;
pub mod doors;
pub mod realtime;
pub mod record;
pub mod registry;
pub mod remote;
pub mod semaphore;
pub mod simulation;
pub mod supervise;
pub mod survey;
pub mod sync;
pub mod system;
pub mod text;
pub mod watch;

mod agent;
mod asleep;
mod bootstrap;
mod children;
mod circle;
mod concurrent;
mod contain;
mod context;
mod credits;
mod delivery;
mod directory;
mod envelope;
mod exchange;
#[cfg(test)]
mod fuzz;
mod handled;
mod handler;
mod last_messages;
mod look;
mod mailbox;
mod meter;
mod moving;
mod names;
mod phase;
mod processor;
mod reply;
mod report;
mod runner;
mod statistics;
mod tap;
mod task_record;
mod timers;
mod wait;
mod waits;

use ctos_link as link;
use ctos_message::{blob, fault, frame};
/// Event handlers and what they can do: the interface that most users of CTOS see.
pub mod task {
    pub use crate::{
        children::StartError,
        context::{Call, Calling, Context, Elapsed, Find, NameError, Send, Sending, TaskRef},
        handled::{Handled, HandlerError},
        handler::{EventHandler, Handover},
        phase::{Phase, StopReason},
    };
}
/// How a call ends: with a reply or with an error that names both tasks. Always.
pub mod call {
    pub use ctos_message::fault::{CallError, Fault};
}
use ctos_time::{lock, park};

pub use context::Context;
pub use context::DEFAULT_DEADLINE;
pub use ctos_config::diagnostic;
pub use ctos_derive::handler;
pub use ctos_link::shared_memory;
pub use ctos_message::{
    Command,
    blob::{Blob, BlobMut},
    command,
};
pub use ctos_time::seed::mix;
pub use report::TaskCounters;

/// A task, seen without disturbing it.
pub mod recent {
    pub use crate::{
        look::{LastMessage, TaskLook},
        report::Ending,
    };
}

/// Time as a service: one clock for the whole app, real or virtual.
pub mod time {
    pub(crate) use ctos_time::Drift;
    pub use ctos_time::{Clock, Instant};
}

/// Messages: a 16-byte header (receiver, sender, command, flags, data size) and data.
pub mod message {
    pub use ctos_message::{
        Command, CommandInfo, Data, Fields, Flags, Header, Payload, PayloadError, SYSTEM_COMMANDS,
        Tid, ToJson, trimmed,
    };
    pub(crate) use ctos_message::{Shape, append};

    pub use crate::envelope::{Message, Replier};
}

/// Who may reach an app: keys, roles and TLS.
pub mod security {
    #[cfg(test)]
    pub(crate) use ctos_link::security::browser_of;
    pub use ctos_link::security::{
        BlockingStream, Identity, KeyError, Keys, Listed, Role, RoleError, list_keys, make_key,
    };
}

/// Configuration of an app: TOML files, includes, profiles and `--set`, read into checked types.
pub mod config {
    pub use ctos_config::{
        App, BarrierConfig, Bundle, BundleError, ChassisConfig, ChassisRestart, ChassisSupervision,
        Cut, DEFAULTS, Entry, Expander, GeneratedTask, HostConfig, InjuryConfig, LinkConfig, Node,
        OnTaskFailure, Origin, ProcessorConfig, RecordConfig, SameHost, SecurityConfig, Selection,
        SemaphoreConfig, ShownValue, TaskConfig, TimeMode, Value, ZenohConfig, ZenohEndpoint,
        ZenohEndpointError, ZenohMode, has_zenoh, load, load_texts, schema,
    };
}

/// The pages of `docs` whose examples are run as tests.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/boot.md")]
    mod boot {}
    #[doc = include_str!("../../docs/links.md")]
    mod links {}
    #[doc = include_str!("../../docs/recording.md")]
    mod recording {}
    #[doc = include_str!("../../docs/synchronization.md")]
    mod synchronization {}
    #[doc = include_str!("../../docs/messages.md")]
    mod messages {}
    #[doc = include_str!("../../docs/names.md")]
    mod names {}
    #[doc = include_str!("../../docs/supervision.md")]
    mod supervision {}
    #[doc = include_str!("../../docs/supervision-of-tasks.md")]
    mod supervision_of_tasks {}
    #[doc = include_str!("../../docs/tasks.md")]
    mod tasks {}
}
