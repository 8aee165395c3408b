//! What an app tells of itself: plain data, made by those who know it and carried to whoever asks.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::phase::Phase;
use ctos_message::Tid;
use ctos_time::Instant;

/// A chassis at a moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChassisReport {
    /// Its name.
    pub chassis: String,
    /// Its process.
    pub pid: u32,
    /// The moment, on the chassis's clock.
    pub now: Instant,
    /// Its processors, in declared order, that of the runtime first.
    pub processors: Vec<String>,
    /// Its tasks, those of the runtime too.
    pub tasks: Vec<TaskReport>,
    /// How many callers were refused.
    pub refused: u64,
    /// Its records, if it is recorded.
    pub records: Vec<RecordReport>,
}

/// A task at a moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskReport {
    /// Its symbolic name.
    pub name: String,
    /// Its id.
    pub tid: Tid,
    /// The registered name of its handler; empty for tasks that no configuration declares.
    pub handler: String,
    /// Its processor's name.
    pub processor: String,
    /// What it has done.
    pub counters: TaskCounters,
    /// What its synchronous functions have taken, those that are on the schedule now.
    pub cyclic: Duration,
    /// When it entered its last startup phase.
    pub phase_since: Option<Instant>,
    /// The command at hand, or the last one, by name; `None` before the first.
    pub command: Option<String>,
    /// What is in its queue.
    pub queue: QueueReport,
    /// What it waits for, longest first.
    pub waits: Vec<WaitReport>,
    /// What it says that it is at.
    pub at: Option<AtReport>,
}

/// What a task says that it is at, besides its messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AtReport {
    /// In words, after "it": `waits for motion: move_robot`.
    pub text: String,
    /// When that will be over, if it is known.
    pub until: Option<Instant>,
}

/// What is in a queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct QueueReport {
    /// Messages of high priority.
    pub urgent: u64,
    /// Messages of normal priority.
    pub normal: u64,
    /// Senders that wait for a credit.
    pub waiting: u64,
    /// How many messages of each priority it holds at most.
    pub capacity: u64,
}

/// A call, or a send, that has not ended yet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WaitReport {
    /// The asked task.
    pub to: String,
    /// The command's name.
    pub command: String,
    /// Since when.
    pub since: Instant,
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
