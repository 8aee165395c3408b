//! Who was refused: all are counted, and some are logged, so that strangers cannot fill a disk.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use ctos_core::chassis::{Chassis, Extension};
use ctos_time::{Clock, Instant, lock::lock};

/// How many lines there are at most in each of these times.
const LINES: u32 = 10;
const EVERY: Duration = Duration::from_secs(5);

/// The callers that were refused.
#[derive(Debug, Default)]
pub struct Refusals {
    count: AtomicU64,
    told: Mutex<Told>,
}

#[derive(Debug, Default)]
struct Told {
    from: Instant,
    lines: u32,
    left_out: u64,
}

impl Extension for Refusals {
    fn new(_: &Chassis) -> Self {
        Self::default()
    }
}

impl Refusals {
    /// Those at the doors of a chassis.
    #[must_use]
    pub fn of(chassis: &Chassis) -> Arc<Self> {
        chassis.extension()
    }

    /// How many there were.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Counts one, and logs it if few were just now: whether it was.
    pub fn note(&self, clock: &Clock, who: &str, reason: &str) -> bool {
        let refused = self.count.fetch_add(1, Ordering::Relaxed) + 1;
        let Some(left_out) = self.line_at(clock.now()) else {
            return false;
        };
        tracing::warn!(who, reason, refused, left_out, "a caller was refused");
        true
    }

    /// Whether there may be a line at this moment: how many were left out since the last.
    fn line_at(&self, now: Instant) -> Option<u64> {
        let mut told = lock(&self.told);
        if now.since(told.from) >= EVERY {
            told.from = now;
            told.lines = 0;
        }
        if told.lines == LINES {
            told.left_out += 1;
            return None;
        }
        told.lines += 1;
        Some(std::mem::take(&mut told.left_out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_strangers_makes_few_lines_and_the_next_says_how_many_were_left_out() {
        let refusals = Refusals::default();
        let at = |ms: u64| Instant::START + Duration::from_millis(ms);
        // 14 s, one every 0.1 ms.
        let lines = (0..140_000).filter(|n| refusals.line_at(at(n / 10)).is_some());
        assert_eq!(lines.count(), 30);
        assert_eq!(refusals.line_at(at(20_000)), Some(39_990));
        assert_eq!(refusals.line_at(at(20_001)), Some(0));
    }
}
