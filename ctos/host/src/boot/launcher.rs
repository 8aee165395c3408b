//! How the process of a chassis is started, and what it is told through its environment.

use std::{ffi::OsString, path::PathBuf};

use serde::{Deserialize, Serialize};
use tokio::process::Command;

use ctos_link::{handshake::Token, transport::Address};
use ctos_message::ChassisNumber;

/// The environment variable that carries the secret of a run to the chassis started for it.
pub const TOKEN_VARIABLE: &str = "CTOS_RUN_TOKEN";

/// The environment variable that says how often the chassis has been started; the first time is 1, which
/// is also what its absence means.
pub const INCARNATION_VARIABLE: &str = "CTOS_INCARNATION";

/// The environment variable that tells a chassis that its standard input ends with the agent that started
/// it.
pub(crate) const TETHER_VARIABLE: &str = "CTOS_TETHERED";

/// How to start the process of a chassis: this program with these arguments, after which come
/// `--chassis NAME --boot ADDRESS --origin NANOSECONDS`.
#[derive(Debug, Clone)]
pub struct Launcher {
    /// The program, usually this one.
    pub program: PathBuf,
    /// What to call it with: a subcommand, the configuration's file and its `--set`s.
    pub arguments: Vec<OsString>,
}

/// Which process of which chassis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ProcessId {
    pub(crate) chassis: ChassisNumber,
    pub(crate) incarnation: u32,
}

/// What the process of a chassis is told when it is started.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Briefing {
    /// The name of its chassis.
    pub(crate) name: String,
    pub(crate) incarnation: u32,
    /// The start of the app on the monotonic clock of its host, ns.
    pub(crate) origin_ns: u64,
    /// Where the boot listens.
    pub(crate) boot: Address,
    pub(crate) token: Token,
}

impl Briefing {
    /// Adds it to `command`.
    pub(crate) fn put_into(&self, command: &mut Command) {
        command
            .args(["--chassis", &self.name, "--boot", &self.boot.to_string()])
            .args(["--origin", &self.origin_ns.to_string()])
            .env(TOKEN_VARIABLE, &self.token.0)
            .env(INCARNATION_VARIABLE, self.incarnation.to_string());
    }
}
