//! How often a chassis may be restarted, and how long each restart waits. Knows nothing of processes.

use std::{collections::VecDeque, time::Duration};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use ctos_config::{ChassisRestart, Policy};
use ctos_time::Instant;

/// No pause before a restart is longer.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// A pause is made shorter or longer by up to this part of it, so that chassis that fell together do
/// not come back in step.
const JITTER: f64 = 0.2;

/// How a process ended, for the policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ended {
    /// By itself, with exit code 0.
    Well,
    /// In any other way.
    Badly,
}

/// What follows the death of a process.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Verdict {
    /// The next one is started after the pause.
    Restart { pause: Duration },
    /// The policy has no restart for such an end.
    NotAllowed,
    /// There were so many restarts within the window that there is no further one.
    TooMany { restarts: u32 },
}

/// The restarts of one chassis.
#[derive(Debug)]
pub(crate) struct Intensity {
    policy: Policy,
    /// The moments of the restarts that may still count.
    restarts: VecDeque<Instant>,
    rng: ChaCha8Rng,
}

impl Intensity {
    pub(crate) fn new(policy: Policy, rng: ChaCha8Rng) -> Self {
        Self {
            policy,
            restarts: VecDeque::new(),
            rng,
        }
    }

    /// What follows a process that ended at `now`. A restart is counted.
    pub(crate) fn judge(&mut self, ended: Ended, now: Instant) -> Verdict {
        let allowed = match self.policy.when {
            ChassisRestart::Never => false,
            ChassisRestart::OnFailure => ended == Ended::Badly,
            ChassisRestart::Always => true,
        };
        if !allowed {
            return Verdict::NotAllowed;
        }
        let window = self.policy.window;
        self.restarts.retain(|moment| now.since(*moment) < window);
        let restarts = u32::try_from(self.restarts.len()).unwrap_or(u32::MAX);
        if restarts >= self.policy.max {
            return Verdict::TooMany { restarts };
        }
        self.restarts.push_back(now);
        let doubled = 2.0_f64.powi(i32::try_from(restarts).unwrap_or(i32::MAX));
        let pause = (self.policy.backoff.as_secs_f64() * doubled).min(LONGEST_PAUSE.as_secs_f64());
        let jitter = self.rng.random_range(1.0 - JITTER..1.0 + JITTER);
        Verdict::Restart {
            pause: Duration::from_secs_f64(pause * jitter),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand_chacha::rand_core::SeedableRng;

    use super::*;

    fn intensity(restart: ChassisRestart, max_restarts: u32) -> Intensity {
        let policy = Policy {
            when: restart,
            max: max_restarts,
            window: Duration::from_secs(10),
            backoff: Duration::from_secs(1),
        };
        Intensity::new(policy, ChaCha8Rng::seed_from_u64(1))
    }

    fn at(seconds: u64) -> Instant {
        Instant::START + Duration::from_secs(seconds)
    }

    #[test]
    fn each_policy_restarts_after_the_ends_it_names() {
        use ChassisRestart::{Always, Never, OnFailure};
        for (restart, ended, restarted) in [
            (Never, Ended::Badly, false),
            (Never, Ended::Well, false),
            (OnFailure, Ended::Badly, true),
            (OnFailure, Ended::Well, false),
            (Always, Ended::Badly, true),
            (Always, Ended::Well, true),
        ] {
            let verdict = intensity(restart, 3).judge(ended, at(0));
            assert_eq!(matches!(verdict, Verdict::Restart { .. }), restarted);
        }
    }

    #[test]
    fn pauses_double_within_the_window_and_begin_anew_after_it() {
        let mut intensity = intensity(ChassisRestart::Always, 10);
        for (moment, expected) in [(0, 1.0), (1, 2.0), (2, 4.0), (3, 8.0), (40, 1.0)] {
            let Verdict::Restart { pause } = intensity.judge(Ended::Badly, at(moment)) else {
                panic!("refused at {moment} s");
            };
            let ratio = pause.as_secs_f64() / expected;
            assert!((0.8..=1.2).contains(&ratio), "{pause:?} at {moment} s");
        }
    }

    proptest! {
        #[test]
        fn no_window_ever_holds_more_restarts_than_are_allowed(
            max in 1_u32..6,
            gaps in proptest::collection::vec(0_u64..8_000, 1..60)
        ) {
            let mut intensity = intensity(ChassisRestart::OnFailure, max);
            let mut now = Instant::START;
            let mut restarts: Vec<Instant> = Vec::new();
            for gap in gaps {
                now = now + Duration::from_millis(gap);
                let within = restarts.iter().filter(|one| now.since(**one) < Duration::from_secs(10)).count();
                match intensity.judge(Ended::Badly, now) {
                    Verdict::Restart { pause } => {
                        prop_assert!(within < max as usize);
                        prop_assert!(pause <= LONGEST_PAUSE.mul_f64(1.0 + JITTER));
                        restarts.push(now);
                    }
                    Verdict::TooMany { .. } => prop_assert_eq!(within, max as usize),
                    Verdict::NotAllowed => prop_assert!(false),
                }
            }
        }
    }
}
