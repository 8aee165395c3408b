//! One synchronous function: how it is described, and what the schedule keeps of it.

use std::{
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use super::{Cyclic, CyclicStatistics, FunctionView, Overrun, Tick, grid::Due};
use ctos_time::Instant;

/// Called with why a function cannot go on, or the app should not.
pub(super) type FailureHook = Rc<dyn Fn(&str)>;

/// A synchronous function and its description: its name, the signals it reads and writes, its rate.
///
/// Signals are names that the functions of one processor share; the values themselves go through whatever the
/// functions have in common. They say who must run before whom.
///
/// ```
/// use ctos::sync::{Synchronous, Tick};
///
/// let law = Synchronous::new("law", |_: &Tick| { /* torque from position and setpoint */ })
///     .reads(["position", "setpoint"])
///     .writes(["torque"]);
/// let plan = Synchronous::new("plan", |_: &Tick| { /* the next setpoint */ })
///     .writes(["setpoint"])
///     .every(4)
///     .phase(1);
/// ```
#[must_use = "a function runs when it is put on a schedule"]
pub struct Synchronous {
    pub(super) code: Box<dyn Cyclic>,
    pub(super) view: FunctionView,
    /// In place of `view.every`; must be a whole number of base ticks.
    pub(super) period: Option<Duration>,
    pub(super) on_failure: Option<FailureHook>,
}

impl Synchronous {
    /// Reads these signals as they are written in the same tick: runs after their writers.
    pub fn reads<S: Into<String>>(mut self, signals: impl IntoIterator<Item = S>) -> Self {
        self.view.reads.extend(signals.into_iter().map(Into::into));
        self
    }

    /// Reads these signals as the tick before left them: runs before their writers. A loop of data is
    /// opened here.
    pub fn reads_previous<S: Into<String>>(mut self, signals: impl IntoIterator<Item = S>) -> Self {
        let signals = signals.into_iter().map(Into::into);
        self.view.reads_previous.extend(signals);
        self
    }

    /// Writes these signals; nobody else on the processor does.
    pub fn writes<S: Into<String>>(mut self, signals: impl IntoIterator<Item = S>) -> Self {
        self.view.writes.extend(signals.into_iter().map(Into::into));
        self
    }

    /// Runs every `period`, which must be a whole number of the processor's base periods. On a processor
    /// without `period_s` the first function's period becomes the base of those that fit.
    pub fn period(mut self, period: Duration) -> Self {
        self.period = Some(period);
        self
    }

    /// Runs `ticks` base ticks after the ticks that are a multiple of its period: 0 to period - 1.
    pub fn phase(mut self, ticks: u64) -> Self {
        self.view.phase = ticks;
        self
    }

    pub(crate) fn renamed(mut self, name: String) -> Self {
        self.view.name = name;
        self
    }

    /// Whom to tell when the function panics, when the processor is to stop after an overrun, and when its
    /// tick source fails. Called on the processor's thread.
    pub fn on_failure(mut self, hook: impl Fn(&str) + 'static) -> Self {
        self.on_failure = Some(Rc::new(hook));
        self
    }

    /// The function called `name`, which runs at every base tick of its processor and exchanges nothing.
    pub fn new(name: impl Into<String>, function: impl Cyclic + 'static) -> Self {
        Self {
            code: Box::new(function),
            view: FunctionView {
                name: name.into(),
                every: 1,
                ..FunctionView::default()
            },
            period: None,
            on_failure: None,
        }
    }

    /// Runs at every `ticks`-th base tick of the processor.
    pub fn every(mut self, ticks: u64) -> Self {
        self.view.every = ticks;
        self.period = None;
        self
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.view.name
    }
}

/// Keeps a synchronous function on its schedule; dropped, it takes it off.
#[derive(Debug, Default)]
pub struct CyclicHandle {
    pub(super) wanted: Arc<AtomicBool>,
    pub(super) statistics: Arc<CyclicStatistics>,
}

impl CyclicHandle {
    /// Lateness, duration and missed periods so far.
    #[must_use]
    pub fn statistics(&self) -> &Arc<CyclicStatistics> {
        &self.statistics
    }
}

impl Drop for CyclicHandle {
    fn drop(&mut self) {
        self.wanted.store(false, Ordering::Release);
    }
}

/// One function on a schedule.
pub(super) struct Function {
    /// Counts the functions of the schedule in the order in which they were added.
    pub(super) number: u64,
    pub(super) view: FunctionView,
    /// Out while it runs; gone when it has panicked.
    pub(super) code: Option<Box<dyn Cyclic>>,
    pub(super) wanted: Arc<AtomicBool>,
    pub(super) statistics: Arc<CyclicStatistics>,
    pub(super) on_failure: Option<FailureHook>,
    pub(super) releases: Releases,
    /// How long it took when it ran last.
    pub(super) last: Duration,
}

impl Function {
    pub(super) fn is_wanted(&self) -> bool {
        self.wanted.load(Ordering::Acquire)
    }

    /// What it is told if it runs now, at base tick `due`.
    pub(super) fn release(&mut self, due: &Due, overrun: Overrun, now: Instant) -> Option<Tick> {
        let (missed, run) = self.releases.at(due.tick, overrun);
        self.statistics.missed.fetch_add(missed, Ordering::Relaxed);
        let run = run?;
        let tick = Tick {
            due: due.of_tick(run.tick),
            now,
            count: run.count,
            missed: run.missed,
        };
        self.statistics.lateness.record(now.since(tick.due));
        Some(tick)
    }

    /// It ran from `began` to `ended`.
    pub(super) fn ran(&mut self, due: &Due, began: Instant, ended: Instant) {
        self.last = ended.since(began);
        self.statistics.duration.record(self.last);
        if began < due.next && ended >= due.next {
            self.statistics.overruns.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Counts the releases of a function in base ticks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Releases {
    every: u64,
    /// The base tick of the next release.
    next: u64,
    /// Releases up to now, skipped ones included.
    count: u64,
    /// Releases skipped since the function ran last.
    skipped: u64,
}

/// A release at which the function runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    /// The base tick at which the release was due.
    pub(super) tick: u64,
    pub(super) count: u64,
    pub(super) missed: u64,
}

impl Releases {
    /// Those at every `every`-th tick from `first` on.
    pub(super) fn new(first: u64, every: u64) -> Self {
        Self {
            every: every.max(1),
            next: first,
            count: 0,
            skipped: 0,
        }
    }

    /// At base tick `tick`, all earlier ones being over: how many releases are skipped there, and the one that runs.
    pub(super) fn at(&mut self, tick: u64, overrun: Overrun) -> (u64, Option<Run>) {
        if tick < self.next {
            return (0, None);
        }
        let passed = (tick - self.next) / self.every;
        let latest = self.next + passed * self.every;
        self.next = latest + self.every;
        self.count += passed + 1;
        // A release whose own tick was skipped is lost, unless it may be late.
        if latest < tick && overrun != Overrun::RunLateOnce {
            self.skipped += passed + 1;
            return (passed + 1, None);
        }
        let run = Run {
            tick: latest,
            count: self.count,
            missed: std::mem::take(&mut self.skipped) + passed,
        };
        (passed, Some(run))
    }
}
