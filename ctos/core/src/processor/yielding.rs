//! Before it sleeps, a processor yields its core to others on it and checks its inbox once more. If another one
//! has brought something, neither has slept nor been woken, which saves half of what a call between the two
//! costs.
//!
//! A thread that yields goes to the end of the core's run queue. With busy programs in that queue a yield takes
//! a few milliseconds, and to sleep and be woken is quicker. So a yield that returns late is not repeated for a
//! while, longer each time. A processor that looks at the links, where other processes bring what it waits for,
//! does not yield, nor does one with synchronous functions.

use std::{cell::Cell, time::Duration};

use ctos_time::Instant;

/// A yield that returns within this time returned at once.
const AT_ONCE: Duration = Duration::from_micros(50);

/// After a first yield that returned late there is none for so long, ...
const FIRST_PAUSE: Duration = Duration::from_micros(100);

/// ... and after many of them for so long at most.
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// Each yield that returned at once shortens the pause by this part.
const FORGIVEN: u32 = 64;

/// When the processor may yield.
#[derive(Default)]
pub(super) struct Yielding {
    /// Not before this moment.
    from: Cell<Instant>,
    /// The latest pause.
    pause: Cell<Duration>,
}

impl Yielding {
    pub(super) fn may_yield_core(&self, now: Instant) -> bool {
        now >= self.from.get()
    }

    /// A yield that began at `yielded` has returned now, or nothing else was ready to run.
    pub(super) fn came_back(&self, yielded: Instant, now: Instant) {
        if now.since(yielded) <= AT_ONCE {
            let pause = self.pause.get();
            if !pause.is_zero() {
                let less = pause.max(FIRST_PAUSE) / FORGIVEN;
                self.pause.set(pause.saturating_sub(less));
            }
            return;
        }
        let pause = (self.pause.get() * 2).clamp(FIRST_PAUSE, LONGEST_PAUSE);
        self.pause.set(pause);
        self.from.set(now + pause);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(micros: u64) -> Instant {
        Instant::START + Duration::from_micros(micros)
    }

    #[test]
    fn the_way_is_given_as_long_as_it_comes_back_at_once() {
        let yielding = Yielding::default();
        for turn in 0..100 {
            assert!(yielding.may_yield_core(at(turn)));
            yielding.came_back(at(turn), at(turn + 1));
        }
    }

    #[test]
    fn it_is_not_given_for_a_while_after_others_kept_it_and_for_longer_each_time() {
        let yielding = Yielding::default();
        let mut now = Instant::START;
        let mut pauses = Vec::new();
        for _ in 0..15 {
            let yielded = now;
            now = yielded + Duration::from_millis(4);
            yielding.came_back(yielded, now);
            assert!(!yielding.may_yield_core(now));
            let pause = yielding.pause.get();
            assert!(!yielding.may_yield_core(now + (pause - Duration::from_nanos(1))));
            now = now + pause;
            assert!(yielding.may_yield_core(now));
            pauses.push(pause);
        }
        assert!(pauses.is_sorted());
        assert_eq!(pauses.first(), Some(&FIRST_PAUSE));
        assert_eq!(pauses.last(), Some(&LONGEST_PAUSE));
        // After many yields that return at once, the pause is the first one again.
        for _ in 0..1000 {
            yielding.came_back(now, now);
        }
        yielding.came_back(now, now + Duration::from_millis(4));
        assert_eq!(yielding.pause.get(), FIRST_PAUSE);
    }
}
