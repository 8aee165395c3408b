//! How long before a tick a processor wakes up, to spin the rest of the way.
//!
//! A sleeping thread wakes up late, by some ten microseconds on a busy core. It is hundreds where the core had gone
//! to sleep and a host has to give it back. A thread that sleeps until shortly before the tick and then spins is
//! exact if "shortly" is longer than that. It spins for nothing if it is much longer.

use std::{cell::Cell, time::Duration};

use ctos_config::Lead;

/// The lead as it is now.
#[derive(Debug)]
pub(super) struct Leading {
    kind: Lead,
    /// What was learned.
    learned: Cell<Duration>,
}

/// What is added to a late wake-up: the looks at the clock between waking up and spinning.
const RESERVE: Duration = Duration::from_micros(20);

/// Of what was learned above the least, this part is forgotten at each wake-up in time.
const FORGETTING: u32 = 4096;

impl Leading {
    pub(super) fn new(kind: Lead) -> Self {
        Self {
            kind,
            learned: Cell::new(Lead::LEAST),
        }
    }

    /// The lead before the ticks of a base period.
    #[inline]
    pub(super) fn before(&self, base: Duration) -> Duration {
        match self.kind {
            Lead::Fixed(lead) => lead.min(base / 2),
            Lead::Learned => self.learned.get().min(base / 4),
        }
    }

    /// Whether there is none, ever.
    #[inline]
    pub(super) fn is_none(&self) -> bool {
        self.kind == Lead::Fixed(Duration::ZERO)
    }

    /// A sleep that was to end before a tick ended so much later.
    #[inline]
    pub(super) fn woke_late(&self, late: Duration) {
        let (learned, wanted) = (self.learned.get(), late + RESERVE);
        if wanted <= learned {
            let above = learned.saturating_sub(Lead::LEAST);
            self.learned.set(learned - above / FORGETTING);
        } else if late <= Lead::MOST {
            self.learned.set(wanted.min(Lead::MOST));
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SERVO: Duration = Duration::from_micros(4500);

    fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn a_fixed_lead_is_at_most_half_a_period_and_learns_nothing() {
        let leading = Leading::new(Lead::Fixed(us(300)));
        leading.woke_late(us(450));
        assert_eq!(leading.before(SERVO), us(300));
        assert_eq!(leading.before(us(400)), us(200));
        assert!(!leading.is_none() && Leading::new(Lead::default()).is_none());
    }

    #[test]
    fn a_late_wake_up_is_covered_from_the_next_one_on() {
        let leading = Leading::new(Lead::Learned);
        assert_eq!(leading.before(SERVO), Lead::LEAST);
        leading.woke_late(us(150));
        assert_eq!(leading.before(SERVO), us(170));
        assert_eq!(leading.before(us(400)), us(100), "a quarter of the period");
        leading.woke_late(us(490));
        assert_eq!(leading.before(SERVO), Lead::MOST);
    }

    #[test]
    fn a_core_that_was_taken_away_teaches_nothing() {
        let leading = Leading::new(Lead::Learned);
        leading.woke_late(us(20_000));
        assert_eq!(leading.before(SERVO), Lead::LEAST);
    }

    #[test]
    fn what_is_rare_is_forgotten() {
        let leading = Leading::new(Lead::Learned);
        leading.woke_late(us(400));
        for _ in 0..40_000 {
            leading.woke_late(us(30));
        }
        let now = leading.before(SERVO);
        assert!(now >= Lead::LEAST && now < us(85), "{now:?}");
    }

    proptest! {
        /// Wake-ups whose lateness is spread as that of an idle virtual core, exponentially with this mean.
        #[test]
        fn fewer_than_one_wake_up_in_a_hundred_is_too_late_where_most_can_cover_it(
            mean_us in 1.0_f64..60.0,
            uniform in proptest::collection::vec(1e-6_f64..1.0, 5_000),
        ) {
            let leading = Leading::new(Lead::Learned);
            let mut missed = 0;
            for chance in uniform {
                let late = Duration::from_secs_f64(-chance.ln() * mean_us * 1e-6);
                missed += usize::from(late > leading.before(SERVO));
                leading.woke_late(late);
            }
            prop_assert!(missed < 50, "{missed} of 5000");
        }
    }
}
