//! A simulated chassis: its processors with their clock, and what keeps them from running.

use std::{rc::Rc, sync::Arc, time::Duration};

use ctos_core::{chassis::Chassis, processor::Processor};
use ctos_time::{Clock, Instant};

/// A processor with the moment, in true time, from which on it can run.
struct Slot {
    processor: Rc<Processor>,
    free_at: Instant,
}

/// A simulated chassis. Moments are true ones; its own clock may show others.
pub(crate) struct Machine {
    pub(crate) chassis: Arc<Chassis>,
    slots: Vec<Slot>,
    /// Since its process ended nothing of it runs.
    pub(crate) gone: bool,
    frozen_until: Instant,
    /// Until when each step of a task takes how long.
    slow: Option<(Instant, Duration)>,
}

impl Machine {
    pub(crate) fn new(chassis: Arc<Chassis>) -> Self {
        let slots = (0..chassis.processors.len())
            .filter_map(|index| chassis.processor(index))
            .map(|processor| Slot {
                processor,
                free_at: Instant::START,
            })
            .collect();
        Self {
            chassis,
            slots,
            gone: false,
            frozen_until: Instant::START,
            slow: None,
        }
    }

    pub(crate) fn clock(&self) -> &Clock {
        &self.chassis.clock
    }

    /// Until when it stands still, if it does.
    pub(crate) fn frozen(&self, now: Instant) -> Option<Instant> {
        (self.frozen_until > now).then_some(self.frozen_until)
    }

    /// It stands still.
    pub(crate) fn freeze(&mut self, until: Instant) {
        self.frozen_until = self.frozen_until.max(until);
        for slot in &mut self.slots {
            slot.free_at = slot.free_at.max(until);
        }
    }

    /// Each step takes so long.
    pub(crate) fn slow(&mut self, until: Instant, per_step: Duration) {
        self.slow = Some((until, per_step));
    }

    /// Runs what was brought to its processors. True when there was something.
    pub(crate) fn run_jobs(&self) -> bool {
        let mut any = false;
        for slot in &self.slots {
            any |= slot.processor.run_jobs();
        }
        any
    }

    /// How many futures could be polled now, by processor.
    pub(crate) fn count_ready(&self, now: Instant, counts: &mut Vec<usize>) {
        counts.extend(self.slots.iter().map(|slot| {
            if slot.free_at > now {
                0
            } else {
                slot.processor.ready_count()
            }
        }));
    }

    /// Polls a ready future of a processor, which then is busy for as long as that takes.
    pub(crate) fn poll(&mut self, processor: usize, index: usize, now: Instant) -> bool {
        let Some(slot) = self.slots.get_mut(processor) else {
            return false;
        };
        if let Some((until, per_step)) = self.slow {
            if until > now {
                slot.free_at = slot.free_at.max(now + per_step);
            } else {
                self.slow = None;
            }
        }
        slot.processor.poll_ready(index)
    }

    /// How many processors it has.
    pub(crate) fn processors(&self) -> usize {
        self.slots.len()
    }

    /// When something is due that nothing else brings about.
    pub(crate) fn next_event(&self, now: Instant) -> Option<Instant> {
        self.slots
            .iter()
            .filter_map(|slot| {
                let due = slot.processor.next_deadline();
                let due = due.map(|due| self.clock().true_at(due));
                if slot.free_at <= now {
                    due
                } else if slot.processor.ready_count() > 0 {
                    Some(slot.free_at)
                } else {
                    due.map(|due| due.max(slot.free_at))
                }
            })
            .min()
    }

    /// Lets the timers and synchronous functions run that are due.
    pub(crate) fn run_due(&self, now: Instant) {
        for slot in self.slots.iter().filter(|slot| slot.free_at <= now) {
            slot.processor.schedule.run();
            slot.processor.fire_timers();
        }
    }

    /// Drops everything that its processors run.
    pub(crate) fn clear(&self) {
        for slot in &self.slots {
            slot.processor.clear();
        }
    }
}
