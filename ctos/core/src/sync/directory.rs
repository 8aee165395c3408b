//! Which synchronous functions a chassis runs, by name, for displays and metrics. Written when a schedule changes,
//! never by its loop.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use super::{CyclicStatistics, Overrun};
use ctos_time::lock::lock;

/// A processor's schedule as others see it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScheduleView {
    /// The processor, `chassis/processor`.
    pub processor: String,
    /// The base period.
    pub period: Duration,
    /// What it does when it comes too late.
    pub overrun: Overrun,
    /// The functions in the order in which they run within a tick.
    pub functions: Vec<FunctionView>,
    /// Signals that are read and that nobody writes: mostly a misspelt name, or a function that is not
    /// there yet.
    pub unwritten: Vec<String>,
}

/// The description of a function of a schedule.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FunctionView {
    /// `task.function`.
    pub name: String,
    /// Its period, base ticks.
    pub every: u64,
    /// Its phase, base ticks.
    pub phase: u64,
    /// The signals it reads in the tick that writes them.
    pub reads: Vec<String>,
    /// The signals whose value of the tick before it reads.
    pub reads_previous: Vec<String>,
    /// The signals it writes.
    pub writes: Vec<String>,
}

/// What is shown of one schedule: with the statistics of each of its functions.
pub(super) type Shown = (ScheduleView, Vec<Arc<CyclicStatistics>>);

/// The schedules of a chassis, by processor.
#[derive(Debug, Default)]
pub(crate) struct Directory(Mutex<BTreeMap<String, Vec<Shown>>>);

impl Directory {
    /// All functions by name, `task.function`.
    pub(crate) fn functions(&self) -> Vec<(String, Arc<CyclicStatistics>)> {
        let processors = lock(&self.0);
        let functions = processors.values().flatten().flat_map(|(view, all)| {
            let names = view.functions.iter().map(|function| function.name.clone());
            names.zip(all.iter().cloned())
        });
        let by_name: BTreeMap<_, _> = functions.collect();
        by_name.into_iter().collect()
    }

    /// All schedules that have a function.
    pub(crate) fn schedules(&self) -> Vec<ScheduleView> {
        let processors = lock(&self.0);
        let shown = processors.values().flatten();
        shown.map(|(view, _)| view.clone()).collect()
    }

    /// Shows the schedules of one processor as they are now.
    pub(super) fn show(&self, processor: &str, shown: Vec<Shown>) {
        lock(&self.0).insert(processor.to_owned(), shown);
    }
}
