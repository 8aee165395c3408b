//! How the process of a chassis is started, and what it is told through its environment.

use std::{ffi::OsString, path::PathBuf};

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
