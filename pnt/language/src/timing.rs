//! When a transition fires and how many of its firings may go on at once. The words are those of
//! generalized stochastic Petri nets (architecture report, section 6, reference 4). Knows no clock.

use std::{num::NonZeroU32, time::Duration};

/// How long an enabled transition takes. Times are whole microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Timing {
    /// At once, before any timed transition.
    #[default]
    Immediate,
    /// Always the same time.
    Deterministic(Duration),
    /// Exponentially distributed.
    Exponential {
        /// The mean, the inverse of the rate.
        mean: Duration,
    },
    /// General, by mean and spread: normally distributed, drawn again while it is below zero.
    Normal {
        /// The mean before the part below zero is left out.
        mean: Duration,
        /// The standard deviation.
        spread: Duration,
    },
}

impl Timing {
    /// Whether it takes no time.
    #[must_use]
    pub fn is_immediate(&self) -> bool {
        matches!(self, Self::Immediate)
    }
}

/// How many firings of one transition may go on at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Servers {
    /// At most this many.
    Limit(NonZeroU32),
    /// As many as its tokens allow.
    Many,
}

impl Servers {
    /// One at a time.
    pub const ONE: Self = Self::Limit(NonZeroU32::MIN);

    /// What holds without a `servers` line: one for a timed transition, as is the custom with
    /// stochastic nets; else as many as its tokens allow.
    #[must_use]
    pub fn usual(timing: Timing) -> Self {
        if timing.is_immediate() {
            Self::Many
        } else {
            Self::ONE
        }
    }
}
