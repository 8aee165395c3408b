//! Time as a service: one clock for the whole app, real or virtual.
//!
//! Nothing in the workspace asks the operating system for the time; it asks the [`Clock`] that its
//! chassis was started with. A virtual clock moves only when the simulation moves it. So a whole app
//! can run faster than the wall clock and the same way every time.

use std::{
    fmt,
    ops::{Add, Sub},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

use crate::Lease;

/// A moment, in nanoseconds since the app was started. The same in all processes of one host.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct Instant(u64);

impl Instant {
    /// The start of the app.
    pub const START: Self = Self(0);
    /// No moment is later.
    pub const LAST: Self = Self(u64::MAX);

    /// A moment `nanos` nanoseconds after the start of the app.
    #[must_use]
    pub const fn from_nanos(nanos: u64) -> Self {
        Self(nanos)
    }

    /// Nanoseconds since the start of the app.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.0
    }

    /// Time since the start of the app.
    #[must_use]
    pub const fn since_start(self) -> Duration {
        Duration::from_nanos(self.0)
    }

    /// Time from `earlier` to this moment; zero when `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }
}

impl Add<Duration> for Instant {
    type Output = Self;

    fn add(self, duration: Duration) -> Self {
        let nanos = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        Self(self.0.saturating_add(nanos))
    }
}

impl Sub for Instant {
    type Output = Duration;

    fn sub(self, earlier: Self) -> Duration {
        self.since(earlier)
    }
}

impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.6} s", self.since_start().as_secs_f64())
    }
}

/// Where a chassis takes its time from.
#[derive(Debug, Clone)]
pub struct Clock {
    /// The moment of the host's monotonic clock at which the app was started.
    origin_ns: u64,
    /// In place of the host's clock a number that only the simulation advances.
    virtual_ns: Option<Arc<AtomicU64>>,
    /// How this clock shows that number.
    drift: Drift,
    /// Of a process that may be given up.
    lease: Option<Arc<Lease>>,
}

/// How a simulated clock is wrong: it started early and runs at a rate of its own. It is never set
/// back, as the monotonic clock of a host is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Drift {
    /// What it showed at the start of the app, ns.
    pub offset_ns: u64,
    /// How much faster than the true time it runs, ns per s; slower when negative. Above -10^9.
    pub rate_ppb: i32,
}

impl Drift {
    const NANOS: i128 = 1_000_000_000;

    /// Parts of a true 10^9 by which the clock advances; never below 1.
    fn speed(self) -> i128 {
        (Self::NANOS + i128::from(self.rate_ppb)).max(1)
    }

    /// What the clock shows at a true moment.
    fn shown(self, true_ns: u64) -> u64 {
        if self.rate_ppb == 0 {
            return true_ns.saturating_add(self.offset_ns);
        }
        let run = i128::from(true_ns) * self.speed() / Self::NANOS;
        u64::try_from(run + i128::from(self.offset_ns)).unwrap_or(u64::MAX)
    }

    /// The first true moment at which the clock shows `shown_ns`.
    fn true_at(self, shown_ns: u64) -> u64 {
        let run = shown_ns.saturating_sub(self.offset_ns);
        if self.rate_ppb == 0 {
            return run;
        }
        // The smallest t with floor(t * speed / 10^9) >= run is the ceiling of run * 10^9 / speed.
        let speed = self.speed();
        let first = (i128::from(run) * Self::NANOS + speed - 1) / speed;
        u64::try_from(first).unwrap_or(u64::MAX)
    }
}

impl Clock {
    /// A real clock that starts now.
    #[must_use]
    pub fn real() -> Self {
        Self::real_from(monotonic_ns())
    }

    /// A real clock whose start is `origin_ns` of the host's monotonic clock, so that all chassis of
    /// an app on one host agree.
    #[must_use]
    pub fn real_from(origin_ns: u64) -> Self {
        Self {
            origin_ns,
            virtual_ns: None,
            drift: Drift::default(),
            lease: None,
        }
    }

    /// This clock, at which nobody looks any more when `lease` is over.
    #[must_use]
    pub fn leased(self, lease: Lease) -> Self {
        let lease = Some(Arc::new(lease));
        Self { lease, ..self }
    }

    /// What it was [leased](Self::leased) with.
    #[must_use]
    pub fn lease(&self) -> Option<&Lease> {
        self.lease.as_deref()
    }

    /// A virtual clock at the start of the app.
    #[must_use]
    pub fn virtual_clock() -> Self {
        Self {
            origin_ns: 0,
            virtual_ns: Some(Arc::default()),
            drift: Drift::default(),
            lease: None,
        }
    }

    /// A clock that shows the time of this virtual one wrongly, as `drift` says. A real clock is left
    /// as it is.
    pub fn drifting(&self, drift: Drift) -> Self {
        let mut clock = self.clone();
        if clock.virtual_ns.is_some() {
            clock.drift = drift;
        }
        clock
    }

    /// The first true moment of the simulation at which this clock shows `shown`; for a real clock,
    /// which is the truth itself, that moment.
    pub fn true_at(&self, shown: Instant) -> Instant {
        Instant(self.drift.true_at(shown.0))
    }

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Instant {
        let now = match &self.virtual_ns {
            None => Instant(monotonic_ns().saturating_sub(self.origin_ns)),
            Some(now_ns) => Instant(self.drift.shown(now_ns.load(Ordering::Acquire))),
        };
        if let Some(lease) = &self.lease {
            lease.look(now);
        }
        now
    }

    /// What this clock shows at a true moment of the simulation; the inverse of [`Self::true_at`].
    pub fn shown_at(&self, moment: Instant) -> Instant {
        Instant(self.drift.shown(moment.0))
    }

    /// The origin of a real clock, to hand to another chassis; `None` for a virtual clock.
    #[must_use]
    pub fn origin_ns(&self) -> Option<u64> {
        self.virtual_ns.is_none().then_some(self.origin_ns)
    }

    /// The date of the host when a real clock stood at its start, ns since 1970, for those who stamp with dates; `None` for a
    /// virtual clock.
    #[must_use]
    pub fn started_date_ns(&self) -> Option<u64> {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
        let date_ns = u64::try_from(since_1970.as_nanos()).ok()?;
        self.origin_ns()
            .map(|_| date_ns.saturating_sub(self.now().0))
    }

    /// How a virtual clock is wrong; a real one is the truth itself.
    #[must_use]
    pub fn drift(&self) -> Drift {
        self.drift
    }

    /// Moves a virtual clock forward to a true moment. A real clock, or a step back, is left alone.
    pub fn advance_to(&self, moment: Instant) {
        if let Some(now_ns) = &self.virtual_ns {
            now_ns.fetch_max(moment.0, Ordering::AcqRel);
        }
    }
}

fn monotonic_ns() -> u64 {
    let time = clock_gettime(ClockId::Monotonic);
    // The monotonic clock never reports negative parts.
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    let nanos = u64::try_from(time.tv_nsec).unwrap_or(0);
    seconds.saturating_mul(1_000_000_000).saturating_add(nanos)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_drifting_clock_shows_a_moment_first_at_its_true_moment(
            offset_ns in 0_u64..10_000_000_000,
            rate_ppb in -500_000_000_i32..1_000_000_000,
            ahead in 0_u64..1_000_000_000_000,
        ) {
            let clock = Clock::virtual_clock();
            let wrong = clock.drifting(Drift { offset_ns, rate_ppb });
            let shown = Instant::from_nanos(offset_ns + ahead);
            let moment = wrong.true_at(shown);
            if moment > Instant::START {
                clock.advance_to(Instant::from_nanos(moment.as_nanos() - 1));
                prop_assert!(wrong.now() < shown);
            }
            clock.advance_to(moment);
            prop_assert!(wrong.now() >= shown);
        }
    }

    #[test]
    fn a_clock_that_runs_a_thousandth_fast_is_a_millisecond_ahead_after_a_second() {
        let clock = Clock::virtual_clock();
        let fast = clock.drifting(Drift {
            offset_ns: 5,
            rate_ppb: 1_000_000,
        });
        clock.advance_to(Instant::from_nanos(1_000_000_000));
        assert_eq!(fast.now(), Instant::from_nanos(1_001_000_005));
        assert_eq!(clock.now(), Instant::from_nanos(1_000_000_000));
    }

    #[test]
    fn a_virtual_clock_moves_only_forward_and_only_when_told() {
        let clock = Clock::virtual_clock();
        assert_eq!(clock.now(), Instant::START);
        clock.advance_to(Instant::from_nanos(5));
        clock.advance_to(Instant::from_nanos(3));
        assert_eq!(clock.now(), Instant::from_nanos(5));
    }

    #[test]
    fn clocks_of_one_origin_agree() {
        let first = Clock::real();
        let second = Clock::real_from(first.origin_ns().unwrap());
        let before = first.now();
        assert!(second.now() >= before);
    }

    #[test]
    fn whoever_looks_at_a_clock_whose_lease_is_over_finds_out_for_how_long_it_was_not_extended() {
        let (tell, told) = std::sync::mpsc::channel();
        let lease = Lease::new(Duration::from_secs(2), move |late| tell.send(late).unwrap());
        let clock = Clock::virtual_clock().leased(lease);
        let goes_on_to = |seconds: u64| {
            clock.advance_to(Instant::START + Duration::from_secs(seconds));
            // Another thread's clock is the same.
            let now = clock.clone().now();
            (now, told.try_recv().ok())
        };
        let second = Duration::from_secs(1);
        assert_eq!(goes_on_to(100).1, None, "it was never extended");
        clock.lease().unwrap().extend(goes_on_to(100).0);
        assert_eq!(goes_on_to(102).1, None);
        clock.lease().unwrap().extend(goes_on_to(102).0);
        assert_eq!(goes_on_to(104).1, None);
        assert_eq!(goes_on_to(105).1, Some(Some(3 * second)));
        clock.lease().unwrap().lift();
        assert_eq!(goes_on_to(200).1, None);
        clock.lease().unwrap().revoke();
        assert_eq!(goes_on_to(200).1, Some(None), "who revokes it");
        assert_eq!(goes_on_to(200).1, Some(None), "who looks");
    }

    #[test]
    fn moments_never_overflow() {
        let late = Instant::from_nanos(u64::MAX) + Duration::from_secs(1);
        assert_eq!(late.as_nanos(), u64::MAX);
        assert_eq!(Instant::START - late, Duration::ZERO);
    }
}
