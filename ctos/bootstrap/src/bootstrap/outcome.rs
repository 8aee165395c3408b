//! How an app ended, or why it could not be brought up.

use std::sync::Arc;

use super::{End, Observer};
use ctos_core::contain;

/// How an app ended, and what became of its processes.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Why it ended.
    pub end: End,
    /// Chassis that ended otherwise than they should have: name and how.
    pub casualties: Vec<(String, String)>,
    /// How long it ran, in its own time.
    pub took: std::time::Duration,
}

/// An app that could not be brought up at all.
#[derive(Debug, thiserror::Error)]
pub enum BootError {
    /// A socket or a process could not be had.
    #[error("{what}: {error}")]
    Io {
        /// What was attempted.
        what: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// A fault names a chassis that the app has not, or the one that boots where that cannot be.
    #[error("there is no chassis `{chassis}` to which {what} could happen")]
    NoChassis {
        /// The name.
        chassis: String,
        /// What should have happened to it.
        what: &'static str,
    },
    /// The links of its chassis cannot be had.
    #[error("{0}")]
    Links(String),
    /// A chassis ended, or said no, before it was connected.
    #[error("chassis `{chassis}` did not start: {reason}")]
    Chassis {
        /// Its name.
        chassis: String,
        /// What it said last.
        reason: String,
    },
    /// Hosts cannot take their chassis.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Hosts(Vec<HostError>),
    /// A chassis was not connected in time.
    #[error("chassis {} did not connect within {timeout_s} s; give them more time with `app.phase_timeout_s`", .chassis.join(", "))]
    Late {
        /// Their names.
        chassis: Vec<String>,
        /// The timeout, s.
        timeout_s: f64,
    },
}

/// What was attempted when the system said no.
pub fn io_error(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> BootError {
    let what = what.into();
    move |error| BootError::Io { what, error }
}

/// A host on which nothing can be started.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("host `{host}` ({agent}): {reason}")]
pub struct HostError {
    /// Its name.
    pub host: String,
    /// Where its agent should be.
    pub agent: std::net::SocketAddr,
    /// What is wrong, and what to do.
    pub reason: String,
}

/// An observer whose panics (a closed terminal, say) do not take the boot with them: the app must
/// still be stopped in order.
pub fn contained(observer: &Observer) -> Observer {
    let observer = observer.clone();
    Arc::new(move |event| {
        if let Err(panic) = contain::contained(|| observer(event)) {
            tracing::error!(%panic, "whoever watches the boot panicked");
        }
    })
}
