//! How often a processor looks at the clock while the code of its tasks is brief.
//!
//! A look costs about as much as a brief handler. So once many turns of tasks in a row have each been over
//! within [`BRIEF`], only every few of them are measured together, or more while all of these are taken to
//! have been over within that, and each is taken to have lasted as long as the last that were. What turns
//! out to have been long is charged to the turn after which that was seen, which may be some turns late, and
//! everything is measured again. A virtual clock, which costs nothing and stands still while code runs, is
//! always looked at; so is any clock as long as it must be exact, because something is recorded.

use std::{cell::Cell, time::Duration};

/// A turn that is no longer than this is brief.
const BRIEF: Duration = Duration::from_micros(1);

/// So many looks in a row must have found brief turns before any is left out.
const BRIEF_LOOKS: u32 = 16;

/// Turns between two looks. With the measured one this makes a prime number, so that tasks that take
/// turns are all measured.
const SKIPPED: u32 = 4;

/// The same at most, while the turns since the last look are taken to have been brief all together.
const MOST_SKIPPED: u32 = 22;

/// Counts turns and looks.
pub(super) struct Stopwatch {
    real: bool,
    /// Whether no look may be left out.
    exact: Cell<bool>,
    /// Turns since the last look.
    skipped: Cell<u32>,
    /// So many may go without a look, unless it must be exact.
    may_skip: Cell<u32>,
    /// Looks in a row that found brief turns.
    brief: Cell<u32>,
    /// What a turn took by the last look, ns.
    each_ns: Cell<u64>,
    /// By how much the turns before the last look were taken to have lasted too long together, ns.
    excess_ns: Cell<u64>,
}

impl Stopwatch {
    /// For a clock that is a real one, or not.
    pub(super) fn new(real: bool) -> Self {
        Self {
            real,
            exact: Cell::new(false),
            skipped: Cell::new(0),
            may_skip: Cell::new(0),
            brief: Cell::new(0),
            each_ns: Cell::new(0),
            excess_ns: Cell::new(0),
        }
    }

    /// A turn has ended: whether it goes without a look. It counts as one that did.
    #[inline]
    pub(super) fn skips(&self) -> bool {
        let skipped = self.skipped.get();
        let skips = skipped < self.may_skip.get() && !self.exact.get();
        if skips {
            self.skipped.set(skipped + 1);
        }
        skips
    }

    /// Whether the turns of late were brief, by a real clock.
    #[inline]
    pub(super) fn is_brief(&self) -> bool {
        self.brief.get() >= BRIEF_LOOKS && self.real
    }

    /// From now on every turn is measured, or brief ones need not be.
    #[inline]
    pub(super) fn set_exact(&self, exact: bool) {
        self.exact.set(exact);
    }

    /// Whether it is for a real clock.
    #[inline]
    pub(super) fn is_real(&self) -> bool {
        self.real
    }

    /// Whether turns have ended since the last look.
    #[inline]
    pub(super) fn is_behind(&self) -> bool {
        self.skipped.get() > 0
    }

    /// What a turn that was not measured is taken to have lasted, ns.
    #[inline]
    pub(super) fn estimate(&self) -> u64 {
        self.each_ns.get()
    }

    /// The clock was looked at, `since` after the look before. What is left of that for the last turn, ns: the
    /// turns before it were estimated.
    #[inline]
    pub(super) fn looked(&self, since: Duration) -> u64 {
        let skipped = self.skipped.replace(0);
        let since_ns = u64::try_from(since.as_nanos()).unwrap_or(u64::MAX);
        let before = u64::from(skipped) * self.each_ns.get() + self.excess_ns.get();
        self.excess_ns.set(before.saturating_sub(since_ns));
        if since <= BRIEF * (skipped.min(SKIPPED) + 1) {
            self.each_ns.set(since_ns / u64::from(skipped + 1));
            self.brief.set(self.brief.get().saturating_add(1));
        } else {
            self.brief.set(0);
        }
        self.may_skip.set(self.most_skipped());
        since_ns.saturating_sub(before)
    }

    /// How many turns may go without a look before the next one.
    fn most_skipped(&self) -> u32 {
        if !self.is_brief() {
            return 0;
        }
        // So many are taken to be over within it.
        let soon = (BRIEF.as_nanos() as u64).div_ceil(self.each_ns.get().max(1));
        (soon.min(u64::from(MOST_SKIPPED)) as u32).max(SKIPPED)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn brief(stopwatch: &Stopwatch) {
        for _ in 0..BRIEF_LOOKS {
            assert!(!stopwatch.skips());
            stopwatch.looked(BRIEF / 2);
        }
    }

    #[test]
    fn brief_turns_are_measured_together_after_a_while_and_long_ones_one_by_one() {
        let stopwatch = Stopwatch::new(true);
        brief(&stopwatch);
        for _ in 0..SKIPPED {
            assert!(stopwatch.skips());
        }
        assert!(!stopwatch.skips());
        assert_eq!(stopwatch.estimate(), 500);
        // Four were taken to have lasted 500 ns each.
        assert_eq!(stopwatch.looked(Duration::from_millis(1)), 998_000);
        assert!(!stopwatch.is_behind());
        assert!(!stopwatch.skips(), "a long turn was seen");
    }

    #[test]
    fn the_briefer_turns_are_the_more_of_them_are_measured_together() {
        for (turn, together) in [(1, 22), (50, 20), (200, 5), (900, 4)] {
            let stopwatch = Stopwatch::new(true);
            for _ in 0..BRIEF_LOOKS {
                stopwatch.looked(Duration::from_nanos(turn));
            }
            let skipped = std::iter::from_fn(|| stopwatch.skips().then_some(())).count();
            assert_eq!(skipped, together, "{turn} ns");
            // However many they were: one that was long is seen.
            stopwatch.looked(BRIEF * 6);
            assert!(!stopwatch.is_brief(), "{turn} ns");
        }
    }

    #[test]
    fn a_virtual_clock_is_always_looked_at() {
        let stopwatch = Stopwatch::new(false);
        brief(&stopwatch);
        assert!(!stopwatch.skips());
    }

    #[test]
    fn every_turn_is_measured_while_that_must_be_exact_and_turns_are_brief_all_the_same() {
        let stopwatch = Stopwatch::new(true);
        brief(&stopwatch);
        stopwatch.set_exact(true);
        assert!(!stopwatch.skips());
        assert!(stopwatch.is_brief());
        stopwatch.set_exact(false);
        assert!(stopwatch.skips());
    }

    proptest! {
        #[test]
        fn what_turns_are_charged_makes_up_the_time_that_passed(
            turns in proptest::collection::vec(0_u64..1_500, 1..500),
        ) {
            // As `Processor::time_since` does it.
            let stopwatch = Stopwatch::new(true);
            let (mut charged, mut passed, mut since_look) = (0, 0, 0);
            for turn in turns {
                passed += turn;
                since_look += turn;
                if stopwatch.skips() {
                    charged += stopwatch.estimate();
                } else {
                    charged += stopwatch.looked(Duration::from_nanos(since_look));
                    since_look = 0;
                }
                // Off by what brief turns between two looks last, at most, however many there were.
                let most = 2 * u64::from(SKIPPED) * 1_000;
                prop_assert!(charged <= passed + most, "{charged} ns of {passed}");
                prop_assert!(charged + since_look >= passed, "{charged} ns of {passed}");
            }
        }
    }
}
