//! Who holds which hardware and who waits for it: queues, without messages or time.

use std::collections::{BTreeMap, VecDeque};

use ctos::message::Tid;

/// Something that waits for its turn and may give up.
pub(super) trait Waits {
    /// Whether it still waits.
    fn still_waits(&self) -> bool;
}

/// A turn that begins: tell the waiter the number of its grant.
#[derive(Debug)]
pub(super) struct Turn<W> {
    pub waiter: W,
    pub grant: u64,
}

#[derive(Debug)]
struct Line<W> {
    /// The holder's grant and task.
    holder: Option<(u64, Tid)>,
    waiting: VecDeque<(Tid, W)>,
}

/// One line per piece of hardware.
#[derive(Debug)]
pub(super) struct Arbiter<W> {
    lines: BTreeMap<String, Line<W>>,
    granted: u64,
}

impl<W: Waits> Arbiter<W> {
    /// Nobody holds anything; the first grant has the number after `granted`.
    pub(super) fn after(granted: u64) -> Self {
        Self {
            lines: BTreeMap::new(),
            granted,
        }
    }

    /// Joins the line for `hardware`; returns the waiter with its turn if the hardware is free.
    pub(super) fn acquire(&mut self, hardware: &str, by: Tid, waiter: W) -> Option<Turn<W>> {
        let empty = || Line {
            holder: None,
            waiting: VecDeque::new(),
        };
        let line = self.lines.entry(hardware.to_owned()).or_insert_with(empty);
        line.waiting.push_back((by, waiter));
        line.next(&mut self.granted)
    }

    /// Ends a grant; returns whose turn it is now. A grant that has ended before changes nothing.
    pub(super) fn release(&mut self, grant: u64) -> Option<Turn<W>> {
        let holds = |line: &&mut Line<W>| line.holder.is_some_and(|(number, _)| number == grant);
        let line = self.lines.values_mut().find(holds)?;
        line.holder = None;
        line.next(&mut self.granted)
    }

    /// Ends all grants, and leaves all lines, of tasks that are gone; returns whose turns it is now.
    pub(super) fn revoke(&mut self, gone: impl Fn(Tid) -> bool) -> Vec<Turn<W>> {
        let mut turns = Vec::new();
        for line in self.lines.values_mut() {
            line.waiting.retain(|(by, _)| !gone(*by));
            if line.holder.is_some_and(|(_, by)| gone(by)) {
                line.holder = None;
                turns.extend(line.next(&mut self.granted));
            }
        }
        turns
    }

    /// The grant under which `hardware` is held.
    pub(super) fn holder(&self, hardware: &str) -> Option<u64> {
        self.lines.get(hardware)?.holder.map(|(grant, _)| grant)
    }
}

impl<W: Waits> Line<W> {
    /// The first that still waits becomes the holder, if there is none.
    fn next(&mut self, granted: &mut u64) -> Option<Turn<W>> {
        if self.holder.is_some() {
            return None;
        }
        while let Some((by, waiter)) = self.waiting.pop_front() {
            if waiter.still_waits() {
                *granted += 1;
                self.holder = Some((*granted, by));
                return Some(Turn {
                    waiter,
                    grant: *granted,
                });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    impl Waits for (u32, bool) {
        fn still_waits(&self) -> bool {
            self.1
        }
    }

    fn task(chassis: u16) -> Tid {
        Tid::new(chassis, 0, 1)
    }

    #[test]
    fn turns_come_in_the_order_of_asking_and_other_hardware_is_free() {
        let mut arbiter = Arbiter::after(0);
        let first = arbiter.acquire("camera", task(1), (1, true)).unwrap();
        assert!(arbiter.acquire("camera", task(1), (2, true)).is_none());
        assert!(arbiter.acquire("camera", task(1), (3, true)).is_none());
        assert_eq!(
            arbiter
                .acquire("display", task(1), (4, true))
                .unwrap()
                .waiter
                .0,
            4
        );
        let second = arbiter.release(first.grant).unwrap();
        assert_eq!(second.waiter.0, 2);
        assert!(arbiter.release(first.grant).is_none(), "released twice");
        assert_eq!(arbiter.release(second.grant).unwrap().waiter.0, 3);
    }

    #[test]
    fn waiters_that_gave_up_are_passed_over() {
        let mut arbiter = Arbiter::after(0);
        let first = arbiter.acquire("camera", task(1), (1, true)).unwrap();
        arbiter.acquire("camera", task(1), (2, false));
        arbiter.acquire("camera", task(1), (3, true));
        assert_eq!(arbiter.release(first.grant).unwrap().waiter.0, 3);
    }

    #[test]
    fn what_a_dead_chassis_held_or_waited_for_goes_to_the_next() {
        let mut arbiter = Arbiter::after(0);
        arbiter.acquire("camera", task(1), (1, true));
        arbiter.acquire("camera", task(1), (2, true));
        arbiter.acquire("camera", task(2), (3, true));
        let turns = arbiter.revoke(|tid| tid.chassis() == 1);
        assert_eq!(
            turns.iter().map(|turn| turn.waiter.0).collect::<Vec<_>>(),
            [3]
        );
    }

    proptest! {
        #[test]
        fn nothing_is_held_twice_and_everybody_gets_a_turn(steps in prop::collection::vec((0_u16..3, any::<bool>()), 1..60)) {
            let mut arbiter = Arbiter::after(0);
            let mut held: BTreeMap<String, u64> = BTreeMap::new();
            let (mut asked, mut served) = (0, 0);
            let begin = |held: &mut BTreeMap<String, u64>, hardware: &str, turn: Option<Turn<(u32, bool)>>| {
                turn.map_or(0, |turn| {
                    assert!(held.insert(hardware.to_owned(), turn.grant).is_none(), "held twice");
                    1
                })
            };
            for (which, release) in steps {
                let hardware = format!("h{which}");
                let turn = if release {
                    held.remove(&hardware).and_then(|grant| arbiter.release(grant))
                } else {
                    asked += 1;
                    arbiter.acquire(&hardware, task(which), (asked, true))
                };
                served += begin(&mut held, &hardware, turn);
            }
            while let Some((hardware, grant)) = held.pop_first() {
                let turn = arbiter.release(grant);
                served += begin(&mut held, &hardware, turn);
            }
            prop_assert_eq!(asked, served);
        }
    }
}
