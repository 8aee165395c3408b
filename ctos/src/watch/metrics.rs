//! What a chassis counts, gathered: a command of its agent, asked by the chassis that boots.

use serde::{Deserialize, Serialize};

use super::{lint::Lint, meter::CommandCount};
use crate::{chassis::Chassis, command};

command! {
    /// Asks for all that a chassis counts.
    pub(crate) struct Gather => ChassisMetrics, 0xff80, "gather"
}

/// What one chassis counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ChassisMetrics {
    pub(crate) chassis: String,
    pub(crate) tasks: Vec<TaskMetrics>,
    pub(crate) lints: Vec<Lint>,
    /// Events that the record lacks; `None` when nothing is recorded.
    pub(crate) unrecorded: Option<u64>,
}

/// What is counted of one task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct TaskMetrics {
    pub(crate) task: String,
    pub(crate) commands: Vec<CommandCount>,
    pub(crate) durations: Vec<u64>,
    pub(crate) busy_s: f64,
    pub(crate) queue: u64,
    pub(crate) capacity: u64,
    pub(crate) restarts: u64,
}

/// What this chassis counts now.
pub(crate) fn gather_here(chassis: &Chassis) -> ChassisMetrics {
    let count = |length: usize| u64::try_from(length).unwrap_or(u64::MAX);
    let tasks = chassis.tasks();
    // The tasks of the runtime are not the app's; the first processor is theirs.
    let own = tasks.iter().filter(|task| task.tid.processor() > 0);
    let tasks = own.map(|task| {
        let counters = task.statistics.read();
        let (queue, capacity) = task.mailbox.depth();
        TaskMetrics {
            task: task.name.to_string(),
            commands: task.statistics.meter.commands(),
            durations: task.statistics.meter.durations(),
            busy_s: counters.busy.as_secs_f64(),
            queue: count(queue),
            capacity: count(capacity),
            restarts: counters.restarts,
        }
    });
    ChassisMetrics {
        chassis: chassis.name().to_owned(),
        tasks: tasks.collect(),
        lints: chassis.lints(),
        unrecorded: chassis.tap.dropped(),
    }
}
