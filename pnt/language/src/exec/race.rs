//! When timed transitions fire: the race of generalized stochastic Petri nets (architecture report,
//! section 6, reference 4). A transition's clock is set when it becomes enabled, runs while it stays
//! enabled and is thrown away when it is not (enabling memory). The first clock to run out wins. With
//! several servers a transition has as many clocks as its tokens allow.
//!
//! The race keeps clocks and draws times; it knows no clock of the world. The caller says what time it
//! is, fires the winner, and lets transitions that take no time go first.

use std::{cmp::Reverse, collections::BinaryHeap, time::Duration};

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Exp1, StandardNormal};
use serde::{Deserialize, Serialize};

use super::execution::Execution;
use crate::net::{Servers, Timing, TransitionId, When};

/// How often a normally distributed time below zero is drawn again. Its mean is not below zero, so
/// this many in a row do not happen.
const MOST_DRAWS: u32 = 64;

/// Clocks of one transition at most. Times that are not exponential need one for each firing that goes
/// on, and the number of tokens may come from a file.
const MOST_CLOCKS: usize = 1_000_000;

/// A clock that runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// Of which transition.
    pub transition: TransitionId,
    /// When it runs out, in ns of the execution's time.
    pub due_ns: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Due {
    due_ns: u64,
    rank: u32,
    serial: u64,
}

/// The clocks of one net's timed transitions.
#[derive(Debug, Clone)]
pub struct Race {
    rng: ChaCha8Rng,
    first_timed: usize,
    /// Per timed transition, in the order of their starts. An exponential one has one clock for all its
    /// firings, which runs as many times faster and is set anew when their number changes. That is the
    /// same, since exponential times have no memory.
    clocks: Vec<Vec<Due>>,
    /// Per timed transition, how many firings its clocks stand for.
    busy: Vec<u32>,
    /// The next one on top; some have been thrown away.
    queue: BinaryHeap<Reverse<Due>>,
    running: usize,
    serial: u64,
    /// Ranks of transitions that have just fired.
    fired: Vec<usize>,
}

impl Race {
    /// No clock runs until the first [`Self::refresh`].
    #[must_use]
    pub fn new(execution: &Execution, rng: ChaCha8Rng) -> Self {
        let first_timed = execution.wiring.first_timed;
        let timed = execution.wiring.at_rank.len() - first_timed;
        Self {
            rng,
            first_timed,
            clocks: vec![Vec::new(); timed],
            busy: vec![0; timed],
            queue: BinaryHeap::new(),
            running: 0,
            serial: 0,
            fired: Vec::new(),
        }
    }

    /// The race of an execution that takes the place of another one's: no clock runs yet.
    #[must_use]
    pub fn begin_again(&self, execution: &Execution) -> Self {
        Self::new(execution, self.rng.clone())
    }

    /// Whether the net has any timed transition.
    #[must_use]
    pub fn is_needed(&self) -> bool {
        !self.clocks.is_empty()
    }

    /// Sets clocks for what has become enabled and throws away those of what is not any more. To be
    /// called after every change, when no transition that takes no time is enabled. `asks` evaluates an
    /// enabling function (not its negation).
    pub fn refresh(&mut self, execution: &mut Execution, mut asks: impl FnMut(&When) -> bool) {
        while let Some(rank) = self.fired.pop() {
            self.look_at(execution, rank, &mut asks);
        }
        while let Some(rank) = execution.enabling.next_touched() {
            self.look_at(execution, rank, &mut asks);
        }
        for index in 0..execution.wiring.guarded_timed.len() {
            if let Some(rank) = execution.wiring.guarded_timed.get(index) {
                self.look_at(execution, *rank as usize, &mut asks);
            }
        }
    }

    fn look_at(
        &mut self,
        execution: &Execution,
        rank: usize,
        asks: &mut impl FnMut(&When) -> bool,
    ) {
        let Some(id) = execution.wiring.at_rank.get(rank).copied() else {
            return;
        };
        let transition = &execution.net[id];
        let allowed = execution.is_enabled(id)
            && transition
                .when
                .as_ref()
                .is_none_or(|when| asks(when) != when.negated);
        let wanted = if allowed {
            execution.servers_busy(id)
        } else {
            0
        };
        let index = rank - self.first_timed;
        let (Some(clocks), Some(busy)) = (self.clocks.get_mut(index), self.busy.get_mut(index))
        else {
            return;
        };
        let before = clocks.len();
        let (many, faster) = match transition.timing {
            Timing::Exponential { .. } => {
                if *busy != wanted {
                    clocks.clear();
                }
                (wanted.min(1) as usize, wanted.max(1))
            }
            _ => ((wanted as usize).min(MOST_CLOCKS), 1),
        };
        *busy = wanted;
        // The one that began last loses.
        clocks.truncate(many);
        while clocks.len() < many {
            let lasts = draw_ns(transition.timing, faster, &mut self.rng);
            let due = Due {
                due_ns: execution.now_ns.saturating_add(lasts),
                rank: u32::try_from(rank).unwrap_or(u32::MAX),
                serial: self.serial,
            };
            self.serial += 1;
            clocks.push(due);
            self.queue.push(Reverse(due));
        }
        self.running = self.running - before + clocks.len();
        if self.queue.len() > 2 * self.running + 64 {
            let clocks = &self.clocks;
            let first = self.first_timed;
            self.queue.retain(|Reverse(due)| {
                let of = clocks.get(due.rank as usize - first);
                of.is_some_and(|of| of.contains(due))
            });
        }
    }

    /// The transition whose clock runs out first, and when, in ns. Ties go to priority, then to declared
    /// order.
    pub fn next(&mut self, execution: &Execution) -> Option<Clock> {
        loop {
            let Reverse(due) = *self.queue.peek()?;
            let clocks = self.clocks.get(due.rank as usize - self.first_timed)?;
            if clocks.contains(&due) {
                let transition = *execution.wiring.at_rank.get(due.rank as usize)?;
                return Some(Clock {
                    transition,
                    due_ns: due.due_ns,
                });
            }
            self.queue.pop();
        }
    }

    /// The transition whose clock has run out by the execution's time, if there is one: it must be
    /// fired (or started) now. Its clock is gone.
    pub fn pop(&mut self, execution: &Execution) -> Option<TransitionId> {
        let next = self.next(execution)?;
        if next.due_ns > execution.now_ns {
            return None;
        }
        let Reverse(due) = self.queue.pop()?;
        let rank = due.rank as usize;
        let clocks = self.clocks.get_mut(rank - self.first_timed)?;
        clocks.retain(|clock| *clock != due);
        self.running -= 1;
        self.fired.push(rank);
        Some(next.transition)
    }

    /// The clocks that run, to be stored with the execution's state.
    #[must_use]
    pub fn clocks(&self, execution: &Execution) -> Vec<Clock> {
        let of = |due: &Due| {
            let transition = execution.wiring.at_rank.get(due.rank as usize)?;
            Some(Clock {
                transition: *transition,
                due_ns: due.due_ns,
            })
        };
        self.clocks.iter().flatten().filter_map(of).collect()
    }

    /// A race that goes on with stored clocks. Those of transitions that are unknown or not enabled are
    /// left out at the next [`Self::refresh`].
    #[must_use]
    pub fn resume(execution: &Execution, rng: ChaCha8Rng, clocks: &[Clock]) -> Self {
        let mut race = Self::new(execution, rng);
        for clock in clocks {
            let rank = execution.wiring.rank(clock.transition);
            let Some((rank, index)) =
                rank.and_then(|r| Some((r, r.checked_sub(race.first_timed)?)))
            else {
                continue;
            };
            let due = Due {
                due_ns: clock.due_ns,
                rank: u32::try_from(rank).unwrap_or(u32::MAX),
                serial: race.serial,
            };
            if let Some(clocks) = race.clocks.get_mut(index) {
                race.serial += 1;
                race.running += 1;
                clocks.push(due);
                race.queue.push(Reverse(due));
            }
        }
        race
    }
}

impl Execution {
    /// How many firings of a timed transition go on at once now. They are as many as its tokens allow
    /// and it has servers; 0 when it is not enabled.
    #[must_use]
    pub fn servers_busy(&self, id: TransitionId) -> u32 {
        let most = self.net.transitions().get(id.index());
        let most = match most.map(|transition| transition.servers) {
            None => 0,
            Some(Servers::Limit(limit)) => limit.get(),
            Some(Servers::Many) => u32::MAX,
        };
        self.enabling.degree(&self.wiring, &self.net, id, most)
    }
}

/// A time by a transition's distribution, in whole ns; exponential ones `faster` times as short.
fn draw_ns(timing: Timing, faster: u32, rng: &mut ChaCha8Rng) -> u64 {
    let seconds = match timing {
        Timing::Immediate => return 0,
        Timing::Deterministic(time) => {
            return u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        }
        Timing::Exponential { mean } => {
            mean.as_secs_f64() / f64::from(faster) * rng.sample::<f64, _>(Exp1)
        }
        Timing::Normal { mean, spread } => (0..MOST_DRAWS)
            .map(|_| {
                let deviation: f64 = rng.sample(StandardNormal);
                mean.as_secs_f64() + spread.as_secs_f64() * deviation
            })
            .find(|time| *time >= 0.0)
            .unwrap_or(mean.as_secs_f64()),
    };
    let time = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
