//! The synchronization service: plain functions called at a fixed rate on a processor (CIRSSE report
//! 108, section 3).
//!
//! A [`Cyclic`] function allocates nothing, locks nothing and never waits. The functions of one processor
//! share a [`Schedule`], whichever tasks they belong to. Its time is counted in base ticks, and a function
//! runs every so many of them. Within a tick the order follows from what each function reads and writes
//! ([`Synchronous`]). Deadlines are counted in whole periods, so they do not drift. What a processor does
//! that comes late is its [`Overrun`] policy, and never a burst. Lateness and duration are kept in
//! histograms that can be read without touching the loop.
//!
//! Knows clocks, functions and two settings of a processor ([`Lead`], [`Overrun`]); knows no task,
//! no message and no file.

mod directory;
mod flow;
mod function;
mod grid;
mod histogram;
mod lead;
mod schedule;
mod signal;
mod source;
mod statistics;

use std::time::Duration;

use ctos_time::Instant;

pub use ctos_config::{Lead, Overrun};
pub(crate) use directory::Directory;
pub use directory::{FunctionView, ScheduleView};
pub use function::{CyclicHandle, Synchronous};
pub use histogram::Histogram;
pub use schedule::{Schedule, ScheduleSettings};
pub use signal::Signal;
pub use source::{TickSource, TickSourceHandle};
pub use statistics::CyclicStatistics;

/// What a synchronous function is told at each tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tick {
    /// The moment at which the tick was due.
    pub due: Instant,
    /// The moment at which it runs.
    pub now: Instant,
    /// Counts the function's periods since it was put on the schedule, skipped ones included.
    pub count: u64,
    /// How many of its periods were skipped just before this tick.
    pub missed: u64,
}

/// A synchronous function.
pub trait Cyclic {
    /// One period's work.
    fn tick(&mut self, tick: &Tick);
}

impl<F: FnMut(&Tick)> Cyclic for F {
    fn tick(&mut self, tick: &Tick) {
        self(tick);
    }
}

/// A synchronous function that cannot be put on a schedule.
#[derive(Debug, thiserror::Error)]
pub enum CyclicError {
    /// The functions wait for each other within one tick.
    #[error(
        "the data of {} flows in a circle ({}); let one of them take the value of the tick before with `reads_previous`",
        .functions.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", "),
        .signals.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
    )]
    Circle {
        /// The functions, by `task.function`.
        functions: Vec<String>,
        /// The signals that go between them.
        signals: Vec<String>,
    },
    /// Which of two values a reader would get would be left to chance.
    #[error(
        "the signal `{signal}` is written by `{first}` and by `{second}`; give one of them a signal of its own"
    )]
    TwoWriters {
        /// The signal.
        signal: String,
        /// Who writes it already.
        first: String,
        /// Who would write it too.
        second: String,
    },
    /// The processor counts in periods that do not add up to the function's.
    #[error(
        "`{function}` wants a period of {} s, which is not a whole number of base periods of processor `{processor}` ({} s); the nearest is {} s",
        .period.as_secs_f64(), .base.as_secs_f64(), .nearest.as_secs_f64()
    )]
    NotAMultiple {
        /// The function.
        function: String,
        /// What it asked for.
        period: Duration,
        /// The processor.
        processor: String,
        /// Its base period.
        base: Duration,
        /// The whole number of base periods that is nearest.
        nearest: Duration,
    },
    /// The function counts in base ticks, and the processor has none.
    #[error(
        "`{function}` counts in base periods, but processor `{processor}` has none; give it `period_s` in the configuration"
    )]
    NoBase {
        /// The function.
        function: String,
        /// The processor.
        processor: String,
    },
    /// A phase that the function's own period does not contain.
    #[error("`{function}` runs at every {every} ticks, so its phase is 0 to {}; {phase} is not", every - 1)]
    Phase {
        /// The function.
        function: String,
        /// The phase.
        phase: u64,
        /// Its period, base ticks.
        every: u64,
    },
    /// A rate or period of nothing.
    #[error("`{function}` has a period of nothing; it needs 1 tick, or 1 µs, or more")]
    NoPeriod {
        /// The function.
        function: String,
    },
    /// The name is on the schedule already.
    #[error(
        "`{function}` is on the schedule already; drop its handle before it is put there again"
    )]
    SameName {
        /// The function.
        function: String,
    },
    /// The processor is paced by a device already.
    #[error(
        "processor `{processor}` has a tick source already; drop its handle before it gets another one"
    )]
    SameSource {
        /// The processor.
        processor: String,
    },
    /// The system refused the thread that waits for the device.
    #[error("no thread could be had that waits for the ticks of processor `{processor}`: {error}")]
    Thread {
        /// The processor.
        processor: String,
        /// What the system said.
        error: std::io::Error,
    },
}
