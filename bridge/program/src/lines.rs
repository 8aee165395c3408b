//! The lines of the protocol: each one JSON object with one key, which says what it is.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::types::Declared;

/// The version of the protocol.
pub(crate) const VERSION: u32 = 1;

/// A line to the program.
#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Told<'a> {
    Hello {
        protocol: u32,
        task: &'a str,
        app: &'a str,
        args: &'a Value,
        seed: u64,
        virtual_time: bool,
        state: Option<Value>,
        /// The folder of [frames](crate::frames), if there are any.
        #[serde(skip_serializing_if = "Option::is_none")]
        frames: Option<&'a Path>,
        /// Whether it is only to say what it takes, with types.
        #[serde(skip_serializing_if = "std::ops::Not::not")]
        declare: bool,
    },
    Run {},
    Error {
        id: u64,
        text: &'a str,
    },
    Step {
        id: u64,
    },
    Stop {
        reason: &'a str,
    },
}

impl Told<'_> {
    pub(crate) fn line(&self) -> Vec<u8> {
        // Nothing of it is of a kind that JSON has not.
        let mut line = serde_json::to_vec(self).unwrap_or_default();
        line.push(b'\n');
        line
    }
}

/// A line from the program.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Said {
    Hello(Hello),
    Reply {
        id: u64,
        #[serde(default)]
        data: Value,
    },
    Error {
        id: u64,
        text: String,
    },
    Call(Asked),
    Send(Asked),
    Log {
        #[serde(default)]
        level: Level,
        text: String,
    },
    Keep {
        state: Value,
    },
    At {
        text: String,
    },
    Finish {
        ok: bool,
        #[serde(default)]
        text: String,
    },
    Step {
        id: u64,
    },
}

/// What it says of itself.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Hello {
    pub(crate) protocol: u32,
    #[serde(default = "yes")]
    pub(crate) deterministic: bool,
    /// Whether it takes frames.
    #[serde(default)]
    pub(crate) frames: bool,
    #[serde(default)]
    pub(crate) commands: Vec<Offered>,
}

fn yes() -> bool {
    true
}

/// A command that it says it takes.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Offered {
    pub(crate) name: String,
    #[serde(default)]
    pub(crate) help: String,
    pub(crate) code: Option<u16>,
    pub(crate) request: Option<Declared>,
    pub(crate) reply: Option<Declared>,
}

/// What it asks of another task.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Asked {
    pub(crate) id: u64,
    pub(crate) task: String,
    pub(crate) command: String,
    #[serde(default)]
    pub(crate) data: Value,
    pub(crate) deadline_s: Option<f64>,
}

/// How much a line of the log matters.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Level {
    Debug,
    #[default]
    Info,
    Warning,
    Error,
}
