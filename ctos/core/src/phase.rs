//! The startup phases of an app, and why its tasks are told to stop.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The three startup phases. Each is acknowledged by every task before the next begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Phase {
    /// The task exists and has read its arguments. Other tasks may not exist yet.
    Create,
    /// All tasks exist: find the others by name, open what is needed.
    Connect,
    /// Everybody is connected: begin.
    Run,
}

impl Phase {
    /// All phases, in order.
    pub const ALL: [Self; 3] = [Self::Create, Self::Connect, Self::Run];
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Create => "create",
            Self::Connect => "connect",
            Self::Run => "run",
        })
    }
}

/// Why tasks are told to stop.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, derive_more::Display)]
pub enum StopReason {
    /// The app has its result.
    #[display("the app has finished")]
    Finished,
    /// The person at its terminal asked for it by Ctrl-C, or somebody by SIGTERM.
    #[display("the app was interrupted")]
    Interrupted,
    /// An operator asked for it: `ctos stop`.
    #[display("the operator stopped the app")]
    Stopped,
    /// This task alone was told to end; the app goes on.
    #[display("the task was told to shut down")]
    Shutdown,
    /// A chassis is gone.
    #[display("chassis `{chassis}` is gone")]
    ChassisDown {
        /// Its name.
        chassis: String,
    },
    /// A task failed for good, or a startup phase did.
    #[display("{what}")]
    Failed {
        /// Who and why.
        what: String,
    },
}
