//! One synchronous function: how it is described, and what the schedule keeps of it.

use std::{
    fmt,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use super::{Cyclic, CyclicStatistics, Directory, Overrun, Tick, flow::Flow, grid::Due};
use ctos_time::{Clock, Instant};

/// Called with why a function cannot go on, or the app should not.
pub(super) type FailureHook = Rc<dyn Fn(&str)>;

/// How often a function runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rate {
    /// At every so many base ticks of the processor.
    Ticks(u64),
    /// Every so often, which must be a whole number of base ticks.
    Period(Duration),
}

/// A synchronous function and what is said of it: its name, the signals it reads and writes, its rate.
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
    pub(super) function: Box<dyn Cyclic>,
    pub(super) flow: Flow,
    pub(super) rate: Rate,
    pub(super) phase: u64,
    pub(super) on_failure: Option<FailureHook>,
}

impl Synchronous {
    /// Reads these signals as they are written in the same tick: runs after whoever writes them.
    pub fn reads<S: Into<String>>(mut self, signals: impl IntoIterator<Item = S>) -> Self {
        self.flow.reads.extend(signals.into_iter().map(Into::into));
        self
    }

    /// Reads these signals as the tick before left them: runs before whoever writes them. A loop of data is
    /// opened here.
    pub fn reads_previous<S: Into<String>>(mut self, signals: impl IntoIterator<Item = S>) -> Self {
        let signals = signals.into_iter().map(Into::into);
        self.flow.reads_previous.extend(signals);
        self
    }

    /// Writes these signals; nobody else on the processor does.
    pub fn writes<S: Into<String>>(mut self, signals: impl IntoIterator<Item = S>) -> Self {
        self.flow.writes.extend(signals.into_iter().map(Into::into));
        self
    }

    /// Runs every `period`, which must be a whole number of the processor's base periods. On a processor
    /// without `period_s` the first function's period becomes the base of those that fit.
    pub fn period(mut self, period: Duration) -> Self {
        self.rate = Rate::Period(period);
        self
    }

    /// Runs `ticks` base ticks after the ticks that are a multiple of its period: 0 to period - 1.
    pub fn phase(mut self, ticks: u64) -> Self {
        self.phase = ticks;
        self
    }

    pub(crate) fn renamed(mut self, name: String) -> Self {
        self.flow.name = name;
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
            function: Box::new(function),
            flow: Flow {
                name: name.into(),
                ..Flow::default()
            },
            rate: Rate::Ticks(1),
            phase: 0,
            on_failure: None,
        }
    }

    /// Runs at every `ticks`-th base tick of the processor.
    pub fn every(mut self, ticks: u64) -> Self {
        self.rate = Rate::Ticks(ticks);
        self
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.flow.name
    }
}

impl fmt::Debug for Synchronous {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Synchronous")
            .field("flow", &self.flow)
            .field("rate", &self.rate)
            .field("phase", &self.phase)
            .finish_non_exhaustive()
    }
}

/// Keeps a synchronous function on its schedule; dropped, it takes it off.
#[derive(Debug)]
pub struct CyclicHandle {
    name: String,
    wanted: Arc<AtomicBool>,
    statistics: Arc<CyclicStatistics>,
    directory: Option<Arc<Directory>>,
}

impl CyclicHandle {
    pub(super) fn new(
        name: String,
        wanted: Arc<AtomicBool>,
        statistics: Arc<CyclicStatistics>,
        directory: Option<Arc<Directory>>,
    ) -> Self {
        if let Some(directory) = &directory {
            directory.add(&name, &statistics);
        }
        Self {
            name,
            wanted,
            statistics,
            directory,
        }
    }

    /// Of a function that is on no schedule.
    pub(crate) fn of_nothing() -> Self {
        Self {
            name: String::new(),
            wanted: Arc::default(),
            statistics: Arc::default(),
            directory: None,
        }
    }

    /// Lateness, duration and missed periods so far.
    #[must_use]
    pub fn statistics(&self) -> &Arc<CyclicStatistics> {
        &self.statistics
    }
}

impl Drop for CyclicHandle {
    fn drop(&mut self) {
        self.wanted.store(false, Ordering::Release);
        if let Some(directory) = &self.directory {
            directory.remove(&self.name, &self.statistics);
        }
    }
}

/// One function on a schedule.
pub(super) struct Function {
    pub(super) number: u64,
    /// Its place in the order within a tick.
    pub(super) rank: usize,
    pub(super) function: Box<dyn Cyclic>,
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

    /// Runs it, now, if base tick `due` releases it. Returns the moment after it.
    pub(super) fn run(
        &mut self,
        due: &Due,
        overrun: Overrun,
        now: Instant,
        clock: &Clock,
    ) -> Instant {
        let release = self.releases.at(due.tick, overrun);
        self.statistics.count_missed(release.missed);
        let Some(run) = release.run else {
            return now;
        };
        let tick = Tick {
            due: due.of_tick(run.tick),
            now,
            count: run.count,
            missed: run.missed,
        };
        self.statistics.lateness.record(now.since(tick.due));
        self.function.tick(&tick);
        let ended = clock.now();
        self.last = ended.since(now);
        self.statistics.duration.record(self.last);
        if now < due.next && ended >= due.next {
            self.statistics.count_overrun();
        }
        ended
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

/// What a base tick means to a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Release {
    /// Releases that were skipped at this tick.
    pub(super) missed: u64,
    pub(super) run: Option<Run>,
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

    /// At base tick `tick`, all earlier ones being over.
    pub(super) fn at(&mut self, tick: u64, overrun: Overrun) -> Release {
        if tick < self.next {
            return Release {
                missed: 0,
                run: None,
            };
        }
        let passed = (tick - self.next) / self.every;
        let latest = self.next + passed * self.every;
        self.next = latest + self.every;
        self.count += passed + 1;
        // A release whose own tick was skipped is lost, unless it may be late.
        if latest < tick && overrun != Overrun::RunLateOnce {
            self.skipped += passed + 1;
            return Release {
                missed: passed + 1,
                run: None,
            };
        }
        let missed = std::mem::take(&mut self.skipped) + passed;
        Release {
            missed: passed,
            run: Some(Run {
                tick: latest,
                count: self.count,
                missed,
            }),
        }
    }
}
