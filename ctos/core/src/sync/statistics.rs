//! The statistics of a synchronous function while it runs, for displays and metrics.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use super::Histogram;

/// What is known of a synchronous function while it runs. The loop writes it, any thread reads it, and neither
/// waits for the other.
#[derive(Debug, Default)]
pub struct CyclicStatistics {
    /// How late its ticks were: from the moment they were due to the moment the function began.
    pub lateness: Histogram,
    /// How long they took.
    pub duration: Histogram,
    period: Duration,
    pub(super) missed: AtomicU64,
    pub(super) overruns: AtomicU64,
}

impl CyclicStatistics {
    /// Of a function that is to run every `period`.
    pub(super) fn new(period: Duration) -> Self {
        Self {
            period,
            ..Self::default()
        }
    }

    /// The function's period.
    #[must_use]
    pub fn period(&self) -> Duration {
        self.period
    }

    /// How often it ran.
    #[must_use]
    pub fn runs(&self) -> u64 {
        self.duration.count()
    }

    /// Periods skipped because the processor came too late.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Runs during which the processor's next base tick came due: this function, together with what
    /// ran before it in the tick, took too long.
    #[must_use]
    pub fn overruns(&self) -> u64 {
        self.overruns.load(Ordering::Relaxed)
    }
}
