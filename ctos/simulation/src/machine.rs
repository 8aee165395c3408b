//! A simulated chassis: its processors with their clock, and what keeps them from running.

use std::{cell::Cell, rc::Rc, sync::Arc, time::Duration};

use ctos_bootstrap::watch;
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
    /// Something has come or run since it looked at itself, or it saw something then.
    pub(crate) stirs: Cell<bool>,
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
            stirs: Cell::new(true),
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

    /// Runs what was brought to a processor. True when there was something.
    pub(crate) fn run_jobs(&self, processor: usize) -> bool {
        let slot = self.slots.get(processor);
        let any = slot.is_some_and(|slot| slot.processor.run_jobs());
        self.stirs.set(self.stirs.get() || any);
        any
    }

    /// It looks at itself, if there may be anything to see: chassis at rest cost nothing.
    pub(crate) fn look(&mut self, now: Instant) {
        if self.stirs.get() {
            self.stirs.set(watch::look(&self.chassis, now));
        }
    }

    /// How many futures of a processor could be polled now.
    pub(crate) fn count_ready(&self, processor: usize, now: Instant) -> usize {
        let free = self.slots.get(processor).filter(|slot| slot.free_at <= now);
        free.map_or(0, |slot| slot.processor.ready_count())
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
        self.stirs.set(true);
        slot.processor.poll_ready(index)
    }

    /// Its processors.
    pub(crate) fn processors(&self) -> impl Iterator<Item = &Rc<Processor>> {
        self.slots.iter().map(|slot| &slot.processor)
    }

    /// When something is due at a processor that nothing else brings about.
    pub(crate) fn next_event(&self, processor: usize, now: Instant) -> Option<Instant> {
        let slot = self.slots.get(processor)?;
        let due = slot.processor.next_deadline();
        let due = due.map(|due| self.clock().true_at(due));
        if slot.free_at <= now {
            due
        } else if slot.processor.ready_count() > 0 {
            Some(slot.free_at)
        } else {
            due.map(|due| due.max(slot.free_at))
        }
    }

    /// A processor falls asleep, if it has nothing to do until something is due or brought. That whose code this thread
    /// ran last does not: what comes to it need not be brought.
    pub(crate) fn falls_asleep(&self, processor: usize, now: Instant) -> bool {
        let slot = self.slots.get(processor).filter(|slot| slot.free_at <= now);
        let here = Processor::here();
        slot.is_some_and(|slot| {
            let is_here = here.is_some_and(|here| Rc::ptr_eq(&here, &slot.processor));
            !is_here && slot.processor.ready_count() == 0 && slot.processor.falls_asleep()
        })
    }

    /// A processor tells when something is brought to it. False when something has been brought.
    pub(crate) fn listens(&self, processor: usize) -> bool {
        let slot = self.slots.get(processor);
        slot.is_none_or(|slot| slot.processor.falls_asleep())
    }

    /// Lets the timers and synchronous functions of a processor run that are due.
    pub(crate) fn run_due(&self, processor: usize, now: Instant) {
        if let Some(slot) = self.slots.get(processor).filter(|slot| slot.free_at <= now) {
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
