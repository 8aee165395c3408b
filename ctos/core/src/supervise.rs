//! Supervision: when something that ended is started again, how often, after which wait, and the states
//! that a task passes through meanwhile.
//!
//! It holds rules only and starts nothing: the loop of a task (`runner.rs`) asks it, and so does the
//! supervisor of a chassis. The rules are those of Erlang's supervisors (restart intensity: so many
//! restarts within a window, then the failure goes up the tree). A back-off that doubles keeps what
//! fails at once from failing a thousand times a second.

use std::{collections::VecDeque, time::Duration};

pub use ctos_config::{Policy, When};

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use ctos_time::Instant;

/// The longest wait that doubling leads to; the policy itself may ask for a longer one.
const LONGEST_BACKOFF: Duration = Duration::from_secs(30);

/// How something came to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// It failed.
    Failure,
    /// It was told to end, and did.
    Order,
}

/// What to do about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Start it again after this time.
    RestartAfter(Duration),
    /// The policy does not restart what ended so.
    StayDown,
    /// It was restarted as often as the policy allows: the failure goes up the tree.
    GiveUp {
        /// How many restarts there were within the window.
        restarts: usize,
    },
}

/// Counts the restarts of one thing against its policy.
#[derive(Debug)]
pub struct Restarts {
    policy: Policy,
    /// The moments of the restarts within the window, oldest first.
    recent: VecDeque<Instant>,
    seed: u64,
    /// Made when it is needed first: most things are never restarted, and it is large.
    rng: Option<Box<ChaCha8Rng>>,
}

impl Restarts {
    /// Nothing was restarted so far. The jitter is drawn from `seed`, so that things that fail together are
    /// not restarted together.
    #[must_use]
    pub fn new(policy: Policy, seed: u64) -> Self {
        Self {
            policy,
            recent: VecDeque::new(),
            seed,
            rng: None,
        }
    }

    /// What to do about an end at `now`. A restart is counted by this.
    pub fn judge(&mut self, ending: Ending, now: Instant) -> Verdict {
        let wanted = match (self.policy.when, ending) {
            (When::Never, _) | (When::OnFailure, Ending::Order) => false,
            (When::OnFailure | When::Always, _) => true,
        };
        if !wanted {
            return Verdict::StayDown;
        }
        while let Some(oldest) = self.recent.front()
            && now.since(*oldest) >= self.policy.window
        {
            self.recent.pop_front();
        }
        let restarts = self.recent.len();
        if restarts >= usize::try_from(self.policy.max).unwrap_or(usize::MAX) {
            return Verdict::GiveUp { restarts };
        }
        self.recent.push_back(now);
        Verdict::RestartAfter(self.backoff(restarts))
    }
}

#[doc(hidden)]
impl Restarts {
    /// The back-off, doubled `doublings` times, less up to a fifth of it.
    fn backoff(&mut self, doublings: usize) -> Duration {
        let factor = u32::try_from(doublings)
            .ok()
            .and_then(|doublings| 1_u32.checked_shl(doublings))
            .unwrap_or(u32::MAX);
        let whole = self.policy.backoff.saturating_mul(factor);
        let seed = self.seed;
        let rng = self
            .rng
            .get_or_insert_with(|| Box::new(ChaCha8Rng::seed_from_u64(seed)));
        let part: f64 = rng.random_range(0.8..=1.0);
        let longest = LONGEST_BACKOFF.max(self.policy.backoff);
        whole.min(longest).mul_f64(part)
    }
}

/// Where the task of the configuration is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum State {
    /// Its handler takes messages.
    Running,
    /// Its handler is gone; the next one is built when the back-off is over. Messages wait.
    BackingOff,
    /// The next handler is built and brought to the phase that the last one had reached.
    Rebuilding,
    /// It ended in order by itself: its name is free.
    Ended,
    /// It failed for good; its chassis, and by default the app, hears of it.
    Failed,
    /// It came to rest with the app. It takes no more messages, or hardware at rest would move again.
    Stopped,
    /// It goes on at another place; what still comes here is sent after it.
    Moved,
}

/// What moves a task from one [`State`] to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Event {
    /// Its handler, a child or a synchronous function panicked, or it was shut down, or it could not be
    /// rebuilt. The policy says that it is restarted.
    RestartAllowed,
    /// It failed, and the policy says that it stays down, or that it was restarted often enough.
    RestartRefused,
    /// It was shut down, and the policy does not restart what ended in order.
    ShutDown,
    /// The wait is over.
    BackoffOver,
    /// The new handler has reached the phase of the last one.
    Rebuilt,
    /// The app is being stopped.
    Stop,
    /// The new place has everything.
    Moved,
}

impl State {
    #[cfg(test)]
    const ALL: [Self; 7] = [
        Self::Running,
        Self::BackingOff,
        Self::Rebuilding,
        Self::Ended,
        Self::Failed,
        Self::Stopped,
        Self::Moved,
    ];

    /// The table: the next state, or `None` where the event cannot be.
    pub(crate) const fn next(self, event: Event) -> Option<Self> {
        match (self, event) {
            (Self::Running | Self::Rebuilding, Event::RestartAllowed) => Some(Self::BackingOff),
            (Self::Running | Self::Rebuilding, Event::RestartRefused) => Some(Self::Failed),
            (Self::Running, Event::ShutDown) => Some(Self::Ended),
            (Self::Running, Event::Moved) => Some(Self::Moved),
            (Self::BackingOff, Event::BackoffOver) => Some(Self::Rebuilding),
            (Self::Rebuilding, Event::Rebuilt) => Some(Self::Running),
            (Self::Running | Self::BackingOff | Self::Rebuilding, Event::Stop) => {
                Some(Self::Stopped)
            }
            // A second order to stop changes nothing, and what breaks in a stop stays down.
            (Self::Stopped, Event::Stop) => Some(Self::Stopped),
            (Self::Stopped, Event::RestartRefused) => Some(Self::Failed),
            _ => None,
        }
    }
}

#[cfg(test)]
impl Event {
    const ALL: [Self; 7] = [
        Self::RestartAllowed,
        Self::RestartRefused,
        Self::ShutDown,
        Self::BackoffOver,
        Self::Rebuilt,
        Self::Stop,
        Self::Moved,
    ];
}

/// The table as a Mermaid state diagram, for the page about supervision.
#[cfg(test)]
fn task_states() -> String {
    let mut text = String::from("stateDiagram-v2\n    [*] --> Running\n");
    for state in State::ALL {
        for event in Event::ALL {
            if let Some(next) = state.next(event) {
                text.push_str(&format!("    {state:?} --> {next:?}: {event:?}\n"));
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn restarts(when: When, max: u32) -> Restarts {
        let policy = Policy {
            when,
            max,
            ..Policy::default()
        };
        Restarts::new(policy, 1)
    }

    fn at_s(seconds: u64) -> Instant {
        Instant::START + Duration::from_secs(seconds)
    }

    #[test]
    fn a_policy_restarts_what_it_names() {
        for (when, ending, restarted) in [
            (When::Never, Ending::Failure, false),
            (When::Never, Ending::Order, false),
            (When::OnFailure, Ending::Failure, true),
            (When::OnFailure, Ending::Order, false),
            (When::Always, Ending::Failure, true),
            (When::Always, Ending::Order, true),
        ] {
            let verdict = restarts(when, 3).judge(ending, at_s(1));
            let found = matches!(verdict, Verdict::RestartAfter(_));
            assert_eq!(found, restarted, "{when:?} {ending:?}");
        }
    }

    #[test]
    fn what_failed_long_ago_is_forgiven() {
        let mut restarts = restarts(When::OnFailure, 2);
        let mut judge = |second| restarts.judge(Ending::Failure, at_s(second));
        assert!(matches!(judge(0), Verdict::RestartAfter(_)));
        assert!(matches!(judge(30), Verdict::RestartAfter(_)));
        assert_eq!(judge(59), Verdict::GiveUp { restarts: 2 });
        assert!(matches!(judge(60), Verdict::RestartAfter(_)));
    }

    #[test]
    fn waits_double_within_the_window_and_begin_anew_after_it() {
        let mut restarts = restarts(When::Always, 10);
        let first = restarts.policy.backoff;
        for (second, doubled) in [(0, 1), (1, 2), (2, 4), (3, 8), (70, 1)] {
            let Verdict::RestartAfter(wait) = restarts.judge(Ending::Failure, at_s(second)) else {
                panic!("refused at {second} s");
            };
            let whole = first * doubled;
            assert!(wait <= whole && wait >= whole.mul_f64(0.8), "{wait:?}");
        }
    }

    #[test]
    fn a_wait_that_is_longer_than_doubling_leads_to_stays_as_the_policy_says() {
        let hour = Duration::from_secs(3600);
        let policy = Policy {
            when: When::Always,
            backoff: hour,
            ..Policy::default()
        };
        let mut restarts = Restarts::new(policy, 7);
        for second in 0..3 {
            let verdict = restarts.judge(Ending::Failure, at_s(second));
            let Verdict::RestartAfter(wait) = verdict else {
                panic!("refused at {second} s");
            };
            assert!(wait <= hour && wait >= hour.mul_f64(0.8), "{wait:?}");
        }
    }

    #[test]
    fn a_state_that_is_an_end_is_left_by_nothing_but_a_failing_stop() {
        for event in Event::ALL {
            for end in [State::Ended, State::Failed, State::Moved] {
                assert_eq!(end.next(event), None, "{end:?} {event:?}");
            }
        }
    }

    #[test]
    fn every_state_is_reached_and_a_stop_reaches_every_task_that_lives() {
        let mut reached = vec![State::Running];
        let mut index = 0;
        while let Some(state) = reached.get(index).copied() {
            for next in Event::ALL.into_iter().filter_map(|event| state.next(event)) {
                if !reached.contains(&next) {
                    reached.push(next);
                }
            }
            index += 1;
        }
        reached.sort_unstable();
        let mut all = State::ALL.to_vec();
        all.sort_unstable();
        assert_eq!(reached, all);
        for alive in [State::Running, State::BackingOff, State::Rebuilding] {
            assert_eq!(alive.next(Event::Stop), Some(State::Stopped));
        }
    }

    #[test]
    fn the_page_about_supervision_shows_the_table() {
        let page = include_str!("../../../docs/supervision-of-tasks.md");
        let shown = format!("<!-- states -->\n```mermaid\n{}```\n", task_states());
        assert!(page.contains(&shown), "put this there:\n{shown}");
    }

    proptest! {
        #[test]
        fn no_window_ever_sees_more_restarts_than_the_policy_allows(
            max in 1_u32..6, gaps in proptest::collection::vec(0_u64..40, 1..80)
        ) {
            let mut restarts = restarts(When::OnFailure, max);
            let mut now = 0;
            let mut granted: Vec<u64> = Vec::new();
            for gap in gaps {
                now += gap;
                if let Verdict::RestartAfter(wait) = restarts.judge(Ending::Failure, at_s(now)) {
                    granted.push(now);
                    prop_assert!(wait <= LONGEST_BACKOFF);
                }
                let recent = granted.iter().filter(|moment| now - **moment < 60).count();
                prop_assert!(recent <= max as usize);
            }
        }

        #[test]
        fn the_back_off_doubles_up_to_its_limit(seed: u64) {
            let policy = Policy { when: When::OnFailure, max: 40, ..Policy::default() };
            let mut restarts = Restarts::new(policy, seed);
            let mut whole = policy.backoff;
            for _ in 0..40 {
                let Verdict::RestartAfter(wait) = restarts.judge(Ending::Failure, at_s(0)) else {
                    panic!("a restart was refused");
                };
                prop_assert!(wait <= whole && wait >= whole.mul_f64(0.74));
                whole = (whole * 2).min(LONGEST_BACKOFF);
            }
        }
    }
}
