//! A histogram of durations that one thread fills and any number of others read, none of them waiting.
//!
//! Its buckets are linear within each power of two (the layout of Tene's HdrHistogram). There are
//! 32 to the octave, so a value is known to 1/32 of itself, from 1 ns to a minute, in 8 kB.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

/// Binary digits of a value that are kept behind the first.
const DIGITS: u32 = 5;

/// Linear buckets of an octave.
const PER_OCTAVE: u64 = 1 << DIGITS;

/// Values of this many bits and more, 68.7 s, count as the last bucket's.
const BITS: u32 = 36;

const BUCKETS: usize = ((BITS - DIGITS + 1) as usize) << DIGITS;

/// A histogram with one writer that never waits and any number of readers.
#[derive(Debug)]
pub struct Histogram {
    buckets: Box<[AtomicU64]>,
    max_ns: AtomicU64,
    sum_ns: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            buckets: (0..BUCKETS).map(|_| AtomicU64::new(0)).collect(),
            max_ns: AtomicU64::new(0),
            sum_ns: AtomicU64::new(0),
        }
    }
}

/// The bucket of a value.
fn index(nanos: u64) -> usize {
    let nanos = nanos.min((1 << BITS) - 1);
    let bits = u64::BITS - nanos.leading_zeros();
    let shift = bits.saturating_sub(DIGITS + 1);
    // Below two octaves every value has a bucket of its own; from there on each octave has 32.
    let octave = u64::from(shift) << DIGITS;
    usize::try_from(octave + (nanos >> shift)).unwrap_or(BUCKETS - 1)
}

/// The largest value of a bucket, ns.
fn upper_ns(index: usize) -> u64 {
    let index = index as u64;
    if index < 2 * PER_OCTAVE {
        return index;
    }
    let shift = (index >> DIGITS) - 1;
    let digits = (index & (PER_OCTAVE - 1)) + PER_OCTAVE;
    ((digits + 1) << shift) - 1
}

impl Histogram {
    /// How many values were counted.
    #[must_use]
    pub fn count(&self) -> u64 {
        let buckets = self.buckets.iter();
        buckets.map(|bucket| bucket.load(Ordering::Relaxed)).sum()
    }

    /// The largest value, exact.
    #[must_use]
    pub fn max(&self) -> Duration {
        Duration::from_nanos(self.max_ns.load(Ordering::Relaxed))
    }

    /// The sum of all values.
    #[must_use]
    pub fn sum(&self) -> Duration {
        Duration::from_nanos(self.sum_ns.load(Ordering::Relaxed))
    }

    /// An upper bound of the `quantile` (0 to 1), at most 1/32 above it; exact below 64 ns.
    #[must_use]
    pub fn quantile(&self, quantile: f64) -> Duration {
        // One reading of the buckets, so that values counted meanwhile do not shift the rank.
        let counts: Vec<u64> = self
            .buckets
            .iter()
            .map(|bucket| bucket.load(Ordering::Relaxed))
            .collect();
        let total: u64 = counts.iter().sum();
        let wanted = ((quantile.clamp(0.0, 1.0) * total as f64).ceil() as u64).max(1);
        let mut seen = 0;
        for (index, count) in counts.into_iter().enumerate() {
            seen += count;
            // The last bucket has no upper bound but the largest value.
            if seen >= wanted && index + 1 < BUCKETS {
                return Duration::from_nanos(upper_ns(index)).min(self.max());
            }
        }
        self.max()
    }

    /// Counts one value. Allocates nothing and takes no lock.
    pub fn record(&self, value: Duration) {
        let nanos = u64::try_from(value.as_nanos()).unwrap_or(u64::MAX);
        if let Some(bucket) = self.buckets.get(index(nanos)) {
            bucket.fetch_add(1, Ordering::Relaxed);
        }
        self.max_ns.fetch_max(nanos, Ordering::Relaxed);
        self.sum_ns.fetch_add(nanos, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_buckets_are_a_staircase_without_gaps() {
        let mut next = 0;
        for step in 0..BUCKETS {
            // The first value after a bucket is the first one of the next.
            assert_eq!((index(next), index(upper_ns(step))), (step, step));
            next = upper_ns(step) + 1;
        }
        assert_eq!(next, 1 << BITS);
        assert_eq!(index(u64::MAX), BUCKETS - 1);
    }

    proptest! {
        #[test]
        fn a_quantile_is_an_upper_bound_within_a_thirtysecond(
            nanos in proptest::collection::vec(1_u64..1 << 35, 1..200),
            quantile in 0.0_f64..=1.0,
        ) {
            let histogram = Histogram::default();
            for value in &nanos {
                histogram.record(Duration::from_nanos(*value));
            }
            let mut sorted = nanos.clone();
            sorted.sort_unstable();
            let rank = ((quantile * sorted.len() as f64).ceil() as usize).max(1);
            let exact = sorted[rank - 1];
            let bound = histogram.quantile(quantile).as_nanos() as u64;
            prop_assert!(bound >= exact && bound <= exact + exact / 32, "{exact} {bound}");
            prop_assert_eq!(histogram.count(), nanos.len() as u64);
            let sum: Duration = nanos.iter().map(|value| Duration::from_nanos(*value)).sum();
            prop_assert_eq!(histogram.sum(), sum);
        }

        #[test]
        fn nothing_is_too_large_to_be_counted(nanos: u64) {
            let histogram = Histogram::default();
            histogram.record(Duration::from_nanos(nanos));
            prop_assert_eq!(histogram.count(), 1);
            prop_assert_eq!(histogram.max(), Duration::from_nanos(nanos));
            prop_assert!(histogram.quantile(1.0) >= Duration::from_nanos(nanos));
        }
    }

    #[test]
    fn an_empty_histogram_says_nothing_happened() {
        let histogram = Histogram::default();
        assert_eq!(histogram.quantile(0.99), Duration::ZERO);
        assert_eq!((histogram.count(), histogram.max()), (0, Duration::ZERO));
    }
}
