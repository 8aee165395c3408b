//! Who has what, and who waits: for the permits of one semaphore, or for all to arrive at one barrier. Knows no clock,
//! no lock and no chassis.

use std::{collections::VecDeque, sync::Arc, time::Duration};

use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use super::{Holder, Passage};
use ctos_message::{ChassisNumber, Tid};
use ctos_time::Instant;

/// What a task can wait for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Kind {
    /// A permit.
    Semaphore,
    /// That everybody has arrived.
    Barrier,
}

/// One wait for, and later hold of, a permit; or one arrival at a barrier. Never used twice by a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Hold {
    /// The chassis of the task.
    pub(crate) chassis: ChassisNumber,
    /// Counted by that chassis.
    pub(crate) number: u64,
}

/// Who wants or has something.
#[derive(Debug, Clone)]
pub(super) struct Claim {
    pub(super) hold: Hold,
    pub(super) task: Arc<str>,
    pub(super) tid: Tid,
}

/// Why a wait did not end in time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Late {
    /// Who holds a permit, and for how long.
    pub(super) holders: Vec<(String, Duration)>,
    /// The tasks that wait, the asking one too if it still does.
    pub(super) waiting: Vec<String>,
    /// How many of them come before it.
    pub(super) before: usize,
}

/// One semaphore or barrier.
#[derive(Debug)]
pub(super) struct Ledger {
    kind: Kind,
    /// Permits, or parties.
    count: u32,
    /// Who has a permit, the longest first.
    holders: Vec<(Claim, Instant)>,
    /// High priority, normal priority. Nobody waits who can be served.
    waiting: [VecDeque<(Claim, oneshot::Sender<Passage>)>; 2],
    /// How often all have passed the barrier, or how many permits were given out.
    generation: u64,
}

impl Ledger {
    pub(super) fn new(kind: Kind, count: u32) -> Self {
        Self {
            kind,
            count,
            holders: Vec::new(),
            waiting: [VecDeque::new(), VecDeque::new()],
            generation: 0,
        }
    }

    pub(super) fn count(&self) -> u32 {
        self.count
    }

    /// Stands in line; the receiver is told when it is served, at once if that is possible. A semaphore tells
    /// the number of the permit.
    pub(super) fn enter(
        &mut self,
        claim: Claim,
        high: bool,
        now: Instant,
    ) -> oneshot::Receiver<Passage> {
        let (waiter, served) = oneshot::channel();
        let [urgent, normal] = &mut self.waiting;
        let line = if high { urgent } else { normal };
        line.push_back((claim, waiter));
        self.serve(now);
        served
    }

    /// Ends every wait and hold that `gone` names. Waits end with a closed channel.
    pub(super) fn end(&mut self, gone: impl Fn(&Claim) -> bool, now: Instant) {
        for line in &mut self.waiting {
            line.retain(|(claim, _)| !gone(claim));
        }
        self.holders.retain(|(claim, _)| !gone(claim));
        self.serve(now);
    }

    fn serve(&mut self, now: Instant) {
        let [urgent, normal] = &mut self.waiting;
        match self.kind {
            Kind::Semaphore => {
                while self.holders.len() < self.count as usize {
                    let Some((claim, waiter)) = urgent.pop_front().or_else(|| normal.pop_front())
                    else {
                        break;
                    };
                    self.generation += 1;
                    let (generation, last) = (self.generation, false);
                    // A task that waits no longer gives it back with its ticket.
                    let _ = waiter.send(Passage { generation, last });
                    self.holders.push((claim, now));
                }
            }
            Kind::Barrier if normal.len() >= self.count as usize => {
                self.generation += 1;
                let generation = self.generation;
                while let Some((_, waiter)) = normal.pop_front() {
                    let last = normal.is_empty();
                    // Who gave up at this moment has passed all the same.
                    let _ = waiter.send(Passage { generation, last });
                }
            }
            Kind::Barrier => {}
        }
    }

    /// Whether it has a permit.
    pub(super) fn has(&self, hold: Hold) -> bool {
        self.holders.iter().any(|(claim, _)| claim.hold == hold)
    }

    /// The answer to a waiter whose deadline has passed.
    pub(super) fn late(&self, hold: Hold, now: Instant) -> Late {
        let holders = self.holders.iter();
        let mut lines = self.waiting.iter().flatten();
        let place = lines.position(|(claim, _)| claim.hold == hold);
        let waiting = self.waiting();
        Late {
            holders: holders
                .map(|(claim, since)| (claim.task.to_string(), now.since(*since)))
                .collect(),
            before: place.unwrap_or(waiting.len()),
            waiting,
        }
    }

    pub(super) fn holders(&self) -> Vec<Holder> {
        let holders = self.holders.iter();
        holders
            .map(|(claim, since)| Holder {
                task: claim.task.to_string(),
                tid: claim.tid,
                since: *since,
            })
            .collect()
    }

    /// The tasks that wait, in the order in which they will be served.
    pub(super) fn waiting(&self) -> Vec<String> {
        let lines = self.waiting.iter().flatten();
        lines.map(|(claim, _)| claim.task.to_string()).collect()
    }

    /// Ends all waits.
    pub(super) fn close(&mut self) {
        self.waiting = Default::default();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;
    use tokio::sync::oneshot::error::TryRecvError;

    use super::*;

    fn claim(number: u64) -> Claim {
        Claim {
            hold: Hold { chassis: 0, number },
            task: format!("t{number}").into(),
            tid: Tid::new(0, 0, number as u32),
        }
    }

    #[derive(Debug, Clone)]
    enum Step {
        Acquire {
            high: bool,
        },
        /// One of the claims that there are, or were: it holds, waits, or is gone already.
        End(prop::sample::Index),
        /// All of every third number, as when a chassis dies.
        EndThird(u64),
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            3 => any::<bool>().prop_map(|high| Step::Acquire { high }),
            3 => any::<prop::sample::Index>().prop_map(Step::End),
            1 => (0_u64..3).prop_map(Step::EndThird),
        ]
    }

    fn names(numbers: &[u64]) -> Vec<String> {
        numbers.iter().map(|number| format!("t{number}")).collect()
    }

    /// Takes out the numbers of those who were served by now, and of those whose wait was ended.
    fn told(
        waits: &mut BTreeMap<u64, oneshot::Receiver<Passage>>,
    ) -> (Vec<(u64, Passage)>, Vec<u64>) {
        let (mut served, mut ended) = (Vec::new(), Vec::new());
        waits.retain(|number, wait| match wait.try_recv() {
            Ok(passage) => {
                served.push((*number, passage));
                false
            }
            Err(TryRecvError::Closed) => {
                ended.push(*number);
                false
            }
            Err(TryRecvError::Empty) => true,
        });
        (served, ended)
    }

    proptest! {
        /// Never more permits out than there are, none free while somebody waits, served in order, high before
        /// normal, whichever claim ends and however.
        #[test]
        fn permits_are_never_too_many_and_nobody_waits_for_a_free_one(
            permits in 1_u32..4,
            steps in proptest::collection::vec(step(), 1..200),
        ) {
            let mut ledger = Ledger::new(Kind::Semaphore, permits);
            let mut waits = BTreeMap::new();
            // The model: who holds, and who waits, in the order in which they must be served.
            let mut held: Vec<u64> = Vec::new();
            let mut line: Vec<(bool, u64)> = Vec::new();
            let mut count = 0;
            for step in steps {
                let gone: Vec<u64> = match step {
                    Step::Acquire { high } => {
                        let number = count;
                        count += 1;
                        waits.insert(number, ledger.enter(claim(number), high, Instant::START));
                        let place = line.iter().position(|(other, _)| high && !other);
                        line.insert(place.unwrap_or(line.len()), (high, number));
                        Vec::new()
                    }
                    Step::End(index) if count > 0 => vec![index.index(count as usize) as u64],
                    Step::End(_) => continue,
                    Step::EndThird(third) => (0..count).filter(|number| number % 3 == third).collect(),
                };
                if !gone.is_empty() {
                    ledger.end(|claim| gone.contains(&claim.hold.number), Instant::START);
                }
                let mut withdrawn: Vec<u64> =
                    line.iter().map(|(_, number)| *number).filter(|number| gone.contains(number)).collect();
                withdrawn.sort_unstable();
                held.retain(|number| !gone.contains(number));
                line.retain(|(_, number)| !gone.contains(number));
                let room = (permits as usize - held.len()).min(line.len());
                let mut granted: Vec<u64> = line.drain(..room).map(|(_, number)| number).collect();
                held.extend(&granted);
                granted.sort_unstable();
                let (served, ended) = told(&mut waits);
                prop_assert_eq!(served.into_iter().map(|(number, _)| number).collect::<Vec<_>>(), granted);
                prop_assert_eq!(ended, withdrawn);
                prop_assert!(held.len() <= permits as usize);
                prop_assert!(line.is_empty() || held.len() == permits as usize);
                let holders: Vec<String> = ledger.holders().into_iter().map(|holder| holder.task).collect();
                prop_assert_eq!(holders, names(&held));
                let waiting: Vec<u64> = line.iter().map(|(_, number)| *number).collect();
                prop_assert_eq!(ledger.waiting(), names(&waiting));
            }
        }

        #[test]
        fn everybody_passes_together_and_only_when_all_are_there(
            parties in 1_u32..6,
            steps in proptest::collection::vec((any::<bool>(), any::<prop::sample::Index>()), 1..100),
        ) {
            let mut barrier = Ledger::new(Kind::Barrier, parties);
            let mut waits = BTreeMap::new();
            let mut there: Vec<u64> = Vec::new();
            let mut generations = 0;
            for (number, (arrives, index)) in steps.into_iter().enumerate() {
                let number = number as u64;
                let mut left = Vec::new();
                let mut passing = Vec::new();
                if arrives || number == 0 {
                    there.push(number);
                    waits.insert(number, barrier.enter(claim(number), false, Instant::START));
                    if there.len() == parties as usize {
                        generations += 1;
                        passing = std::mem::take(&mut there);
                    }
                } else {
                    // Somebody who is there, was there, or never was.
                    let gone = index.index(number as usize) as u64;
                    barrier.end(|claim| claim.hold.number == gone, Instant::START);
                    left.extend(there.extract_if(.., |other| *other == gone));
                }
                let (served, ended) = told(&mut waits);
                let passage = |of: &u64| Passage { generation: generations, last: *of == number };
                let expected: Vec<_> = passing.iter().map(|of| (*of, passage(of))).collect();
                prop_assert_eq!(served, expected);
                prop_assert_eq!(ended, left);
                prop_assert_eq!(barrier.waiting(), names(&there));
            }
        }
    }

    #[test]
    fn who_is_late_hears_who_holds_and_how_many_wait_before() {
        let mut ledger = Ledger::new(Kind::Semaphore, 1);
        let at = |seconds| Instant::from_nanos(seconds * 1_000_000_000);
        let enter = |number| ledger.enter(claim(number), number == 3, at(number));
        let _waits: Vec<_> = (0..4).map(enter).collect();
        let late = ledger.late(claim(2).hold, at(5));
        assert_eq!(late.holders, [("t0".to_owned(), Duration::from_secs(5))]);
        // The high one and the one that came first.
        assert_eq!(late.before, 2);
        assert_eq!(ledger.late(claim(9).hold, at(5)).before, 3);
    }
}
