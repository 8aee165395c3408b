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

/// A function of a schedule as others see it.
#[derive(Debug, Clone, PartialEq, Eq)]
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

/// The synchronous functions of a chassis.
#[derive(Debug, Default)]
pub(crate) struct Directory {
    functions: Mutex<BTreeMap<String, Arc<CyclicStatistics>>>,
    schedules: Mutex<BTreeMap<(String, usize), ScheduleView>>,
}

impl Directory {
    /// All functions by name, `task.function`.
    pub(crate) fn functions(&self) -> Vec<(String, Arc<CyclicStatistics>)> {
        let functions = lock(&self.functions);
        functions
            .iter()
            .map(|(name, statistics)| (name.clone(), statistics.clone()))
            .collect()
    }

    /// All schedules that have a function.
    pub(crate) fn schedules(&self) -> Vec<ScheduleView> {
        lock(&self.schedules).values().cloned().collect()
    }

    pub(super) fn add(&self, name: &str, statistics: &Arc<CyclicStatistics>) {
        lock(&self.functions).insert(name.to_owned(), statistics.clone());
    }

    /// Takes a function out, unless another one of the same name took its place.
    pub(super) fn remove(&self, name: &str, statistics: &Arc<CyclicStatistics>) {
        let mut functions = lock(&self.functions);
        if functions
            .get(name)
            .is_some_and(|known| Arc::ptr_eq(known, statistics))
        {
            functions.remove(name);
        }
    }

    /// Shows the schedules of one processor as they are now.
    pub(super) fn show(&self, processor: &str, views: Vec<ScheduleView>) {
        let mut schedules = lock(&self.schedules);
        schedules.retain(|(owner, _), _| owner != processor);
        for (index, view) in views.into_iter().enumerate() {
            schedules.insert((processor.to_owned(), index), view);
        }
    }
}
