//! CTOS, the runtime that everything else stands on. Its event handler tasks are found by symbolic
//! name and exchange messages across threads, processes and machines; a configuration file boots them.
//!
//! It re-creates the five services of the CIRSSE Testbed Operating System (CIRSSE report 108, section 3). These are
//! bootstrap ([`boot`]), task identification ([`task::Context::task`]), message passing ([`message`], [`call`]),
//! synchronization ([`sync`], [`realtime`]) and inter-processor blocking ([`semaphore`]). Inside a chassis there is
//! also shared memory ([`chassis::Chassis::share`]). It knows nothing of robots, nets or pictures.
//!
//! Start with [`task::EventHandler`]; register it in a [`registry::Registry`]; name it in a
//! configuration ([`config`]); boot that with [`boot::boot`].

extern crate self as ctos;

/// For the code that [`command!`] writes.
#[doc(hidden)]
pub use serde;

pub mod boot;

pub use ctos_config::diagnostic;
#[doc(hidden)]
pub use ctos_core::contain::{note_panic, panic_text};
pub use ctos_core::{
    Context, DEFAULT_DEADLINE, TaskCounters, call, chassis, disk, message, realtime, recent,
    registry, semaphore, supervise, sync, task, time,
};
pub use ctos_derive::handler;
pub use ctos_host::{control, doors, remote, text};
pub use ctos_link::{reactor, shared_memory};
pub use ctos_message::{Command, blob::Blob, command};
pub use ctos_simulation as simulation;
pub use ctos_time::seed::mix;

/// The commands of the runtime itself, and what an app tells of itself.
pub mod system {
    pub use ctos_bootstrap::bootstrap::{AppReport, MemberReport};
    pub use ctos_core::system::{
        AppResult, CommandDescription, Introspect, MoveTask, Ping, Shutdown, Statistics,
    };
}

/// What a chassis tells about its tasks without disturbing them.
pub mod survey {
    pub use ctos_core::report::{Activity, AtReport, ChassisReport, TaskReport, WaitReport};
}

/// Watching a running app: lints, which are warnings about what it does.
pub mod watch {
    pub use ctos_bootstrap::watch::{Lint, LintCode, lints};
}

/// Recording: everything that an app does as MCAP, reading it, and replaying one task out of it.
pub mod record {
    pub use ctos_core::tap::ChannelSchema;
    pub use ctos_record::{
        Channel, Difference, Ending, Entry, Filter, Number, ReadError, Record, RecordLayer,
        RecordReport, ReplayError, ReplayReport, Run, file_name, noted, replay, replayable,
        scan_only,
    };
}

/// Who may reach an app: keys, roles and TLS.
pub mod security {
    pub use ctos_link::security::{
        BlockingStream, Identity, KeyError, Keys, Listed, Role, RoleError, list_keys, make_key,
    };
}

/// Configuration of an app: TOML files, includes, profiles and `--set`, read into checked types.
pub mod config {
    pub use ctos_config::{
        App, Bundle, BundleError, ChassisConfig, ChassisRestart, ChassisSupervision, Cut, DEFAULTS,
        Entry, Expander, GeneratedTask, HostConfig, InjuryConfig, LinkConfig, Node, OnTaskFailure,
        Origin, ProcessorConfig, RecordConfig, SameHost, SecurityConfig, Selection, SharedConfig,
        Start, TaskConfig, TimeMode, Value, ZenohConfig, ZenohEndpoint, ZenohEndpointError,
        ZenohMode, has_zenoh, load, load_texts, schema,
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
