//! What a processor does before it sleeps where another one runs on the same core: it lets that have the core
//! and looks once more. If the other one brings something then, neither has slept nor been woken, which is half
//! of what a call between the two costs.
//!
//! Whoever gives way goes to the end of the line of all that want the core. Where programs that work all the
//! time are among them, that is a few milliseconds long, and who sleeps and is woken is better off. So the
//! way is given only while it comes back at once; after it did not, not for a while, longer each time. Nor is it
//! given by who looks at the links, where other processes bring what it waits for, or has synchronous functions.

use std::{cell::Cell, time::Duration};

use ctos_time::Instant;

/// The way came back at once if it did so within this time.
const AT_ONCE: Duration = Duration::from_micros(50);

/// For so long it is not given after it did not come back at once, ...
const FIRST_PAUSE: Duration = Duration::from_micros(100);

/// ... and for so long at most, after that has happened again and again.
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// By this part the pause becomes shorter each time that the way came back at once.
const FORGIVEN: u32 = 64;

/// When the way may be given.
#[derive(Default)]
pub(super) struct Yielding {
    /// Not before this moment.
    from: Cell<Instant>,
    /// How long it was not given the last time.
    pause: Cell<Duration>,
}

impl Yielding {
    pub(super) fn may_yield_core(&self, now: Instant) -> bool {
        now >= self.from.get()
    }

    /// The way was given at `yielded` and has come back now, or there was nobody to give it to.
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
        // Once it comes back at once again and again, all is as before.
        for _ in 0..1000 {
            yielding.came_back(now, now);
        }
        yielding.came_back(now, now + Duration::from_millis(4));
        assert_eq!(yielding.pause.get(), FIRST_PAUSE);
    }
}
