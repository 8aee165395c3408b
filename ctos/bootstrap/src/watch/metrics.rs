//! What a chassis counts, gathered: a command of its agent, asked by the chassis that boots.

use crate::refusals::Refusals;
use ctos_core::{chassis::Chassis, meter::CommandCount, sync::Histogram};
use ctos_message::command;
use ctos_record::Recorders;
use serde::{Deserialize, Serialize};

use super::lint::Lint;

command! {
    /// Asks for all that a chassis counts.
    pub struct Gather => ChassisMetrics, 0xff80, "gather"
}

/// What one chassis counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChassisMetrics {
    pub chassis: String,
    pub tasks: Vec<TaskMetrics>,
    pub cyclics: Vec<CyclicMetrics>,
    pub links: Vec<LinkMetrics>,
    pub lints: Vec<Lint>,
    /// Events that the record lacks; `None` when nothing is recorded.
    pub unrecorded: Option<u64>,
    /// Callers and requests that were refused.
    pub refused: u64,
}

/// What is counted of one task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskMetrics {
    pub task: String,
    pub commands: Vec<CommandCount>,
    pub durations: Vec<u64>,
    pub busy_s: f64,
    pub queue: u64,
    pub capacity: u64,
    pub restarts: u64,
}

/// What is counted of one synchronous function, `task.function`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CyclicMetrics {
    pub function: String,
    pub lateness: Quantiles,
    pub duration: Quantiles,
    pub missed: u64,
    pub overruns: u64,
}

/// What a histogram says in short.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    pub p50_s: f64,
    pub p99_s: f64,
    pub max_s: f64,
    pub sum_s: f64,
    pub count: u64,
}

impl Quantiles {
    fn of(histogram: &Histogram) -> Self {
        Self {
            p50_s: histogram.quantile(0.5).as_secs_f64(),
            p99_s: histogram.quantile(0.99).as_secs_f64(),
            max_s: histogram.max().as_secs_f64(),
            sum_s: histogram.sum().as_secs_f64(),
            count: histogram.count(),
        }
    }
}

/// What went over one link, bytes of data.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkMetrics {
    pub peer: String,
    pub bytes_out: u64,
    pub bytes_in: u64,
}

/// What this chassis counts now.
pub fn gather_here(chassis: &Chassis) -> ChassisMetrics {
    let count = |length: usize| u64::try_from(length).unwrap_or(u64::MAX);
    let tasks = chassis.tasks();
    // The tasks of the runtime are not the app's; the first processor is theirs.
    let own = tasks.iter().filter(|task| task.tid.processor() > 0);
    let tasks = own.map(|task| {
        let counters = task.statistics.read();
        let (commands, durations) = task.statistics.counts();
        let (queue, capacity) = task.mailbox.depth();
        TaskMetrics {
            task: task.name.to_string(),
            commands,
            durations,
            busy_s: counters.busy.as_secs_f64(),
            queue: count(queue),
            capacity: count(capacity),
            restarts: counters.restarts,
        }
    });
    let cyclics = chassis.cyclics().into_iter();
    let cyclics = cyclics.map(|(function, statistics)| CyclicMetrics {
        function,
        lateness: Quantiles::of(&statistics.lateness),
        duration: Quantiles::of(&statistics.duration),
        missed: statistics.missed(),
        overruns: statistics.overruns(),
    });
    let links = chassis.link_counts().into_iter();
    let links = links.map(|(peer, counts)| LinkMetrics {
        peer,
        bytes_out: counts.bytes_out,
        bytes_in: counts.bytes_in,
    });
    ChassisMetrics {
        chassis: chassis.name().to_owned(),
        tasks: tasks.collect(),
        cyclics: cyclics.collect(),
        links: links.collect(),
        lints: super::lints(chassis),
        refused: Refusals::of(chassis).count(),
        unrecorded: Recorders::of(chassis).dropped(),
    }
}
