//! The synchronization service: plain functions called at a fixed rate on a processor.
//!
//! A [`Cyclic`] function allocates nothing, locks nothing and never waits. Its deadlines are counted
//! in whole periods from its start, so they do not drift; a processor that comes late skips whole
//! periods and counts them, and never catches up in a burst. Lateness and duration are kept in
//! histograms that can be read without touching the loop.

use std::{
    future::poll_fn,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    task::Poll,
    time::Duration,
};

use futures_util::task::AtomicWaker;

use crate::time::{Clock, Instant};

/// What a synchronous function is told at each tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tick {
    /// The moment at which the tick was due.
    pub due: Instant,
    /// The moment at which it runs.
    pub now: Instant,
    /// Counts the periods since the start, skipped ones included.
    pub count: u64,
    /// How many periods were skipped just before this tick.
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

/// Powers of two of a microsecond: bucket `i` counts values below `2^i` µs.
const BUCKETS: usize = 24;

/// A histogram with one writer that never waits and any number of readers.
#[derive(Debug, Default)]
pub struct Histogram {
    buckets: [AtomicU64; BUCKETS],
    count: AtomicU64,
    max_ns: AtomicU64,
}

impl Histogram {
    /// Counts one value.
    pub fn record(&self, value: Duration) {
        let nanos = u64::try_from(value.as_nanos()).unwrap_or(u64::MAX);
        let micros = nanos.div_ceil(1000);
        let bucket = (u64::BITS - micros.leading_zeros()) as usize;
        if let Some(bucket) = self.buckets.get(bucket.min(BUCKETS - 1)) {
            bucket.fetch_add(1, Ordering::Relaxed);
        }
        self.count.fetch_add(1, Ordering::Relaxed);
        self.max_ns.fetch_max(nanos, Ordering::Relaxed);
    }

    /// How many values were counted.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// The largest value.
    #[must_use]
    pub fn max(&self) -> Duration {
        Duration::from_nanos(self.max_ns.load(Ordering::Relaxed))
    }

    /// An upper bound of the `quantile` (0 to 1), exact to a factor of two.
    #[must_use]
    pub fn quantile(&self, quantile: f64) -> Duration {
        let wanted = (quantile.clamp(0.0, 1.0) * self.count() as f64).ceil() as u64;
        let mut seen = 0;
        for (index, bucket) in self.buckets.iter().enumerate() {
            seen += bucket.load(Ordering::Relaxed);
            if seen >= wanted.max(1) {
                return Duration::from_micros(1_u64 << index).min(self.max());
            }
        }
        self.max()
    }
}

/// What is known of a synchronous function while it runs.
#[derive(Debug, Default)]
pub struct CyclicStatistics {
    /// How late its ticks were.
    pub lateness: Histogram,
    /// How long they took.
    pub duration: Histogram,
    missed: AtomicU64,
}

impl CyclicStatistics {
    /// Periods skipped because the processor came too late.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }
}

/// Keeps a synchronous function on its schedule; dropped, it takes it off.
#[derive(Debug)]
pub struct CyclicHandle {
    wanted: Arc<AtomicBool>,
    statistics: Arc<CyclicStatistics>,
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

/// Called with what a function's panic said.
type PanicHook = Box<dyn FnOnce(&str)>;

/// One function on a processor's schedule.
pub(crate) struct CyclicEntry {
    function: Box<dyn Cyclic>,
    period: Duration,
    start: Instant,
    next: u64,
    wanted: Arc<AtomicBool>,
    statistics: Arc<CyclicStatistics>,
    on_panic: Option<PanicHook>,
}

impl CyclicEntry {
    pub(crate) fn new(function: Box<dyn Cyclic>, period: Duration, start: Instant) -> Self {
        Self {
            function,
            period: period.max(Duration::from_micros(1)),
            start,
            next: 1,
            wanted: Arc::new(AtomicBool::new(true)),
            statistics: Arc::default(),
            on_panic: None,
        }
    }

    /// Whom to tell when the function panics.
    pub(crate) fn on_panic(&mut self, hook: impl FnOnce(&str) + 'static) {
        self.on_panic = Some(Box::new(hook));
    }

    pub(crate) fn report_panic(&mut self, text: &str) {
        match self.on_panic.take() {
            Some(hook) => hook(text),
            None => tracing::error!(panic = text, "a synchronous function panicked"),
        }
    }

    pub(crate) fn handle(&self) -> CyclicHandle {
        CyclicHandle {
            wanted: self.wanted.clone(),
            statistics: self.statistics.clone(),
        }
    }

    pub(crate) fn is_wanted(&self) -> bool {
        self.wanted.load(Ordering::Acquire)
    }

    pub(crate) fn due(&self) -> Instant {
        self.moment(self.next)
    }

    fn moment(&self, count: u64) -> Instant {
        let period_ns = u64::try_from(self.period.as_nanos()).unwrap_or(u64::MAX);
        self.start + Duration::from_nanos(period_ns.saturating_mul(count))
    }

    /// Runs the tick that is due, skipping whole periods that have passed already.
    pub(crate) fn run(&mut self, clock: &Clock) {
        let now = clock.now();
        let late = now.since(self.due());
        let missed = u64::try_from(late.as_nanos() / self.period.as_nanos()).unwrap_or(0);
        self.next += missed;
        let tick = Tick {
            due: self.due(),
            now,
            count: self.next,
            missed,
        };
        self.next += 1;
        self.statistics.lateness.record(now.since(tick.due));
        self.statistics.missed.fetch_add(missed, Ordering::Relaxed);
        self.function.tick(&tick);
        self.statistics.duration.record(clock.now().since(now));
    }
}

/// Wakes the asynchronous side of a task from a synchronous function, without lock or allocation in
/// the signal itself. Raised many times before it is seen, it is seen once.
#[derive(Debug, Clone, Default)]
pub struct Signal(Arc<SignalInner>);

#[derive(Debug, Default)]
struct SignalInner {
    raised: AtomicBool,
    waker: AtomicWaker,
}

impl Signal {
    /// A signal that is not raised.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Raises it.
    pub fn raise(&self) {
        self.0.raised.store(true, Ordering::Release);
        self.0.waker.wake();
    }

    /// Ends when it has been raised, and lowers it. One future may wait at a time.
    pub async fn wait(&self) {
        poll_fn(|cx| {
            self.0.waker.register(cx.waker());
            if self.0.raised.swap(false, Ordering::AcqRel) {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::RefCell, rc::Rc};

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn late_ticks_skip_whole_periods_and_never_burst(
            steps in proptest::collection::vec(1_u64..20_000, 1..200)
        ) {
            let clock = Clock::virtual_clock();
            let seen = Rc::new(RefCell::new(Vec::new()));
            let log = seen.clone();
            let period = Duration::from_nanos(4_500);
            let mut entry = CyclicEntry::new(
                Box::new(move |tick: &Tick| log.borrow_mut().push(*tick)),
                period,
                Instant::START,
            );
            let statistics = entry.handle().statistics().clone();
            let mut now = 0;
            for step in steps {
                now += step;
                clock.advance_to(Instant::from_nanos(now));
                if entry.due() <= clock.now() {
                    entry.run(&clock);
                    prop_assert!(entry.due() > clock.now());
                }
            }
            let seen = seen.borrow();
            let skipped: u64 = seen.iter().map(|tick| tick.missed).sum();
            prop_assert_eq!(statistics.missed(), skipped);
            if let Some(last) = seen.last() {
                prop_assert_eq!(last.count, seen.len() as u64 + skipped);
            }
            for tick in seen.iter() {
                prop_assert_eq!(tick.due.as_nanos(), tick.count * 4_500);
                prop_assert!(tick.now.since(tick.due) < period);
            }
        }

        #[test]
        fn a_quantile_is_an_upper_bound_within_a_factor_of_two(
            micros in proptest::collection::vec(1_u64..100_000, 1..100)
        ) {
            let histogram = Histogram::default();
            for value in &micros {
                histogram.record(Duration::from_micros(*value));
            }
            let mut sorted = micros.clone();
            sorted.sort_unstable();
            let median = Duration::from_micros(sorted[(sorted.len() - 1) / 2]);
            let bound = histogram.quantile(0.5);
            prop_assert!(bound >= median && bound <= median * 2);
        }
    }
}
