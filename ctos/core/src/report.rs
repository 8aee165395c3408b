//! What an app tells of itself: plain data, made where it is known and sent to every caller.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::phase::Phase;
use ctos_message::Tid;
use ctos_time::Instant;

/// A chassis at a moment.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ChassisReport {
    /// Its process.
    pub pid: Option<u32>,
    /// Its processors, in declared order, that of the runtime first.
    pub processors: Vec<String>,
    /// Its tasks, without those of the runtime.
    pub tasks: Vec<(Tid, TaskReport)>,
    /// How many callers were refused.
    pub refused: u64,
    /// Its records, if it is recorded.
    pub records: Vec<RecordReport>,
}

/// What a task does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activity {
    /// It waits for messages.
    Idle,
    /// Its handler is at work.
    Busy,
    /// Its handler, or a child, waits for another task.
    Waits,
    /// Its chassis is gone, or does not answer.
    #[default]
    Gone,
}

/// A task at a moment.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TaskReport {
    /// Its symbolic name.
    pub name: String,
    /// Its chassis.
    pub chassis: String,
    /// Its processor.
    pub processor: String,
    /// Its handler's registered name; empty for tasks that no configuration declares.
    pub handler: String,
    /// The process it runs in.
    pub pid: Option<u32>,
    /// What it does.
    pub activity: Activity,
    /// The startup phase it has passed.
    pub phase: Option<Phase>,
    /// For how long, s.
    pub phase_s: f64,
    /// Messages handled.
    pub handled: u64,
    /// Of these, those that ended with an error.
    pub failed: u64,
    /// Time spent in the handler, waiting for others included, and in its synchronous functions, s.
    pub busy_s: f64,
    /// The longest that one message took, s.
    pub longest_s: f64,
    /// How long it has been at the message at hand, s.
    pub in_handler_s: Option<f64>,
    /// The command at hand, or the last one, by name; `None` before the first.
    pub command: Option<String>,
    /// Messages of high priority in its queue.
    pub urgent: u64,
    /// Messages of normal priority in its queue.
    pub queued: u64,
    /// Senders that wait for space in its queue.
    pub senders_waiting: u64,
    /// How many messages of each priority its queue holds.
    pub capacity: u64,
    /// How often its handler was built anew.
    pub restarts: u64,
    /// What it waits for, longest first.
    pub waits: Vec<WaitReport>,
    /// What it says that it is at, in words.
    #[serde(default)]
    pub at: Option<String>,
    /// How long that will go on, as far as it is known, s.
    #[serde(default)]
    pub left_s: Option<f64>,
}

/// What a task says that it is at, besides its messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AtReport {
    /// In words, after "it": `waits for motion: move_robot`.
    pub text: String,
    /// When that will be over, if it is known.
    pub until: Option<Instant>,
}

/// A call, or a send, that has not ended yet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WaitReport {
    /// The asked task.
    pub to: String,
    /// The command's name.
    pub command: String,
    /// For how long, s.
    pub for_s: f64,
}

/// The counters of one task at a moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TaskCounters {
    /// Messages handled.
    pub handled: u64,
    /// Of these, those that the handler ended with an error or a panic.
    pub failed: u64,
    /// Time spent in the handler, waiting for others included.
    pub busy: Duration,
    /// The longest that one message took.
    pub longest: Duration,
    /// Since when the message at hand is being handled; `None` when the task is idle.
    pub began: Option<Instant>,
    /// The command at hand, or the last one.
    pub command: u16,
    /// How often the handler was built anew.
    pub restarts: u64,
    /// The startup phase that was entered last.
    pub phase: Option<Phase>,
}

/// How a handler ended a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Ending {
    /// It returned `Ok`.
    Done,
    /// It returned an error.
    Refused(String),
    /// It panicked.
    Panicked(String),
    /// It was interrupted by an order to stop.
    Stopped,
}

/// The record of one process at a moment.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RecordReport {
    /// The file that is written, or was last.
    pub file: String,
    /// Lines written, of all its files.
    pub lines: u64,
    /// Bytes on disk, of all its files.
    pub bytes: u64,
    /// Events that it lacks.
    pub lost: u64,
    /// Why nothing is written at the moment, if that is so.
    pub trouble: Option<String>,
}
