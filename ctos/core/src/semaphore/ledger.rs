//! Who holds the permits of one semaphore and who waits for them: the rules, without time, threads or messages.

use std::{collections::VecDeque, sync::Arc, time::Duration};

use super::{Holder, Late};
use ctos_message::Tid;
use ctos_time::Instant;

/// One wait for, and later hold of, a permit. Never used twice by a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Hold {
    /// The chassis of the task.
    pub(crate) chassis: u8,
    /// Counted by that chassis.
    pub(crate) number: u64,
}

/// Who wants or has a permit.
#[derive(Debug, Clone)]
pub(super) struct Claim {
    pub(super) hold: Hold,
    pub(super) task: Arc<str>,
    pub(super) tid: Tid,
}

/// The permits of one semaphore. `W` wakes somebody who waits.
#[derive(Debug)]
pub(super) struct Ledger<W> {
    permits: u32,
    /// The longest first.
    holders: Vec<(Claim, Instant)>,
    /// High priority, normal priority. Nobody waits while a permit is free.
    waiting: [VecDeque<(Claim, W)>; 2],
}

impl<W> Ledger<W> {
    pub(super) fn new(permits: u32) -> Self {
        Self {
            permits,
            holders: Vec::new(),
            waiting: [VecDeque::new(), VecDeque::new()],
        }
    }

    pub(super) fn permits(&self) -> u32 {
        self.permits
    }

    fn is_free(&self) -> bool {
        self.holders.len() < self.permits as usize
    }

    /// Takes a permit that is free.
    pub(super) fn try_acquire(&mut self, claim: &Claim, now: Instant) -> bool {
        let free = self.is_free();
        if free {
            self.holders.push((claim.clone(), now));
        }
        free
    }

    /// Takes a permit or waits for one. True when it has one.
    pub(super) fn acquire(
        &mut self,
        claim: Claim,
        high: bool,
        waiter: W,
        now: Instant,
    ) -> Option<W> {
        if self.try_acquire(&claim, now) {
            return Some(waiter);
        }
        let [urgent, normal] = &mut self.waiting;
        let line = if high { urgent } else { normal };
        line.push_back((claim, waiter));
        None
    }

    /// Ends every wait and hold that `gone` names: returns those who have a permit now, and those
    /// who wait no longer.
    pub(super) fn end(
        &mut self,
        gone: impl Fn(&Claim) -> bool,
        now: Instant,
    ) -> (Vec<(Hold, W)>, Vec<W>) {
        let mut withdrawn = Vec::new();
        for line in &mut self.waiting {
            let all = std::mem::take(line);
            for (claim, waiter) in all {
                if gone(&claim) {
                    withdrawn.push(waiter);
                } else {
                    line.push_back((claim, waiter));
                }
            }
        }
        self.holders.retain(|(claim, _)| !gone(claim));
        let mut granted = Vec::new();
        while self.is_free() {
            let [urgent, normal] = &mut self.waiting;
            let Some((claim, waiter)) = urgent.pop_front().or_else(|| normal.pop_front()) else {
                break;
            };
            granted.push((claim.hold, waiter));
            self.holders.push((claim, now));
        }
        (granted, withdrawn)
    }

    /// What somebody is told whose time is over.
    pub(super) fn late(&self, hold: Hold, now: Instant) -> Late {
        let holders = self.holders.iter();
        let mut lines = self.waiting.iter().flatten();
        let place = lines.position(|(claim, _)| claim.hold == hold);
        Late {
            holders: holders
                .map(|(claim, since)| (claim.task.to_string(), now.since(*since)))
                .collect::<Vec<(String, Duration)>>(),
            before: place.unwrap_or_else(|| self.waiting.iter().map(VecDeque::len).sum()),
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

    pub(super) fn waiting(&self) -> Vec<String> {
        let lines = self.waiting.iter().flatten();
        lines.map(|(claim, _)| claim.task.to_string()).collect()
    }

    /// Forgets those who wait; they are told by dropping what is returned.
    pub(super) fn close(&mut self) -> Vec<(Claim, W)> {
        self.waiting.iter_mut().flat_map(std::mem::take).collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn claim(number: u64) -> Claim {
        Claim {
            hold: Hold { chassis: 0, number },
            task: format!("t{number}").into(),
            tid: Tid::new(0, 0, number as u16),
        }
    }

    #[derive(Debug, Clone)]
    enum Step {
        Acquire {
            high: bool,
        },
        /// One of those there are, or were: whoever holds, waits, or is gone already.
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

    proptest! {
        /// Never more permits out than there are, none free while somebody waits, served in order, high before
        /// normal, whoever ends and however.
        #[test]
        fn permits_are_never_too_many_and_nobody_waits_for_a_free_one(
            permits in 1_u32..4,
            steps in proptest::collection::vec(step(), 1..200),
        ) {
            let mut ledger = Ledger::new(permits);
            // The model: who holds, and who waits, in the order in which they must be served.
            let mut held: Vec<u64> = Vec::new();
            let mut line: Vec<(bool, u64)> = Vec::new();
            let mut count = 0;
            for step in steps {
                let gone: Vec<u64> = match step {
                    Step::Acquire { high } => {
                        let number = count;
                        count += 1;
                        let granted = ledger.acquire(claim(number), high, number, Instant::START);
                        let free = held.len() < permits as usize;
                        prop_assert_eq!(granted.is_some(), free);
                        if free {
                            held.push(number);
                        } else {
                            let place = line.iter().position(|(other, _)| high && !other);
                            line.insert(place.unwrap_or(line.len()), (high, number));
                        }
                        continue;
                    }
                    Step::End(index) if count > 0 => vec![index.index(count as usize) as u64],
                    Step::End(_) => continue,
                    Step::EndThird(third) => (0..count).filter(|number| number % 3 == third).collect(),
                };
                let is_gone = |claim: &Claim| gone.contains(&claim.hold.number);
                let (granted, mut withdrawn) = ledger.end(is_gone, Instant::START);
                let mut expected: Vec<u64> =
                    line.iter().map(|(_, number)| *number).filter(|number| gone.contains(number)).collect();
                expected.sort_unstable();
                withdrawn.sort_unstable();
                prop_assert_eq!(withdrawn, expected);
                held.retain(|number| !gone.contains(number));
                line.retain(|(_, number)| !gone.contains(number));
                let room = (permits as usize - held.len()).min(line.len());
                let served: Vec<u64> = line.drain(..room).map(|(_, number)| number).collect();
                prop_assert_eq!(granted.iter().map(|(_, number)| *number).collect::<Vec<_>>(), served.clone());
                held.extend(served);
                prop_assert!(held.len() <= permits as usize);
                prop_assert!(line.is_empty() || held.len() == permits as usize);
                let names = |numbers: &[u64]| numbers.iter().map(|number| format!("t{number}")).collect::<Vec<_>>();
                let holders: Vec<String> = ledger.holders().into_iter().map(|holder| holder.task).collect();
                prop_assert_eq!(holders, names(&held));
                let waiting: Vec<u64> = line.iter().map(|(_, number)| *number).collect();
                prop_assert_eq!(ledger.waiting(), names(&waiting));
            }
        }
    }

    #[test]
    fn who_is_late_hears_who_holds_and_how_many_wait_before() {
        let mut ledger = Ledger::new(1);
        let at = |seconds| Instant::from_nanos(seconds * 1_000_000_000);
        for number in 0..4 {
            ledger.acquire(claim(number), number == 3, (), at(number));
        }
        let late = ledger.late(claim(2).hold, at(5));
        assert_eq!(late.holders, [("t0".to_owned(), Duration::from_secs(5))]);
        // The high one and the one that came first.
        assert_eq!(late.before, 2);
        assert_eq!(ledger.late(claim(9).hold, at(5)).before, 3);
    }
}
