//! The thread of a processor: what it does first, what next, and when it sleeps.

use std::{
    rc::Rc,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use super::{
    core::{HERE, Processor},
    handle::Item,
};
use crate::contain::drop_contained;
use ctos_time::{
    Instant,
    park::{Glance, Park},
};

/// How often a processor yields before it sleeps: nobody else may be ready yet.
const YIELDS: u32 = 2;

impl Processor {
    // -- what others bring ------------------------------------------------------------------

    /// Takes in what other threads have brought by now. True when there was something.
    pub fn run_jobs(self: &Rc<Self>) -> bool {
        let count = self.inbox.len();
        if count == 0 {
            return false;
        }
        self.enter();
        // What is noted of it is later than its sending.
        self.look_at_clock();
        for item in self.inbox.try_iter().take(count) {
            self.take_in(item);
        }
        true
    }

    fn take_in(self: &Rc<Self>, item: Item) {
        match item {
            Item::Delivery(slot, delivery) => self.deliver(slot, delivery),
            Item::Answer(key, answer) => self.take_answer(key, answer),
            Item::Wake(id) => {
                if let Some(entry) = self.futures.borrow_mut().entry(id)
                    && let Some(shared) = &entry.shared
                {
                    // A swap, so that what a waker that comes too late to be brought again has
                    // written is seen by the poll that follows.
                    shared.brought.swap(false, Ordering::AcqRel);
                }
                self.wake(id);
            }
            Item::Close(slot) => self.close_queue(slot),
            Item::Job(job) => {
                job(self);
                self.look_at_clock();
            }
            Item::Nudge => {}
        }
    }

    // -- the thread -------------------------------------------------------------------------

    /// The processor's thread: returns after [`ProcessorHandle::stop`].
    pub(crate) fn run(self: &Rc<Self>) {
        self.handle.parker.sit_down();
        self.enter();
        let mut ticked = false;
        while !self.handle.stop.load(Ordering::Acquire) {
            self.run_jobs();
            ticked = !self.schedule.is_idle() && self.run_schedule(ticked);
            self.fire_due(self.recent.get());
            if !self.poll_ready(0) {
                self.wait();
            }
        }
        self.clear();
    }

    /// Runs the synchronous functions that are due. True when there was a tick. After each tick something
    /// else runs, however near the next one is.
    fn run_schedule(&self, ticked: bool) -> bool {
        if !ticked {
            self.schedule.spin_to_tick();
        }
        let ticked = self.schedule.run();
        if ticked {
            self.look_at_clock();
        }
        ticked
    }

    /// Waits for something to do: awake for a while if so told, then asleep.
    fn wait(&self) {
        let now = self.moment();
        if self.spin(now) || self.yield_core(now) {
            return;
        }
        self.settle_calls();
        let (tick, deadline) = (self.schedule.wake_at(), self.wake_at());
        // The processor read the clock above, or when it last looked for work.
        let now = self.recent.get();
        let is_due = deadline.is_some_and(|deadline| deadline <= now);
        if is_due || !self.falls_asleep() {
            return;
        }
        self.handle.parker.park(now, deadline);
        self.handle.asleep.up();
        if self.ready_count() > 0 {
            // What it read at the links was for tasks of its own.
            self.handle.parker.had_work();
        }
        let now = self.look_at_clock();
        if let Some(tick) = tick {
            self.schedule.woke(tick, now);
        }
    }

    /// Where it sleeps, of one that has no thread: a simulation polls it. The first call counts.
    pub fn sleep_at(&self, place: Arc<dyn Park>) {
        self.handle.parker.set(place);
    }

    /// Announces that it sleeps now, if there is nothing to do. Who brings something then wakes it.
    pub fn falls_asleep(&self) -> bool {
        let handle = &self.handle;
        let has_work = || !self.inbox.is_empty() || handle.stop.load(Ordering::Acquire);
        handle.asleep.fall(has_work)
    }

    /// Looks for work without sleeping, as long as the processor was told to: at what other threads brought,
    /// and at the links of the chassis. Never yields: that would give the core to another thread for a whole
    /// slice. True when there is something to do.
    pub(super) fn spin(&self, since: Instant) -> bool {
        /// Looks between two looks at the clock.
        const LOOKS: u32 = 32;
        let spin = Duration::from_nanos(self.handle.spin_ns.load(Ordering::Relaxed));
        if spin == Duration::ZERO {
            return false;
        }
        let until = since + spin;
        let deadline = self.wake_at().unwrap_or(Instant::LAST);
        let deadline = deadline.min(self.settle_at.get());
        let handle = &self.handle;
        // What comes over a link may be for others, and a future of this processor is ready when it is not.
        let brings = |glance: Glance| handle.parker.glance(glance) && self.ready_count() > 0;
        loop {
            for _ in 0..LOOKS {
                if !self.inbox.is_empty() || brings(Glance::AtMemory) {
                    self.look_at_clock();
                    return true;
                }
                std::hint::spin_loop();
            }
            let brought = brings(Glance::Everywhere);
            let now = self.look_at_clock();
            if brought || deadline <= now {
                return true;
            }
            if now >= until {
                return false;
            }
        }
    }

    /// Drops every future, so that what they own is released and answered, and takes nothing more.
    pub fn clear(self: &Rc<Self>) {
        self.enter();
        loop {
            self.inbox.try_iter().for_each(Item::refuse);
            let futures = std::mem::take(&mut *self.futures.borrow_mut());
            let cyclics = self.schedule.clear();
            let queues = std::mem::take(&mut *self.queues.borrow_mut());
            let timers = self.timers.borrow_mut().clear();
            if futures.entries.is_empty() && !cyclics && queues.is_empty() {
                break;
            }
            for entry in futures.entries {
                drop_contained(entry);
            }
            for queue in queues.into_iter().flatten() {
                queue.close(self);
            }
            drop_contained(timers);
        }
        let here = HERE.try_with(|here| here.borrow_mut().take_if(|here| Rc::ptr_eq(here, self)));
        // Outside the borrow, as in `enter`.
        drop(here);
    }

    /// Lets others have the core, where it has it together with other processors. True when there is
    /// something to do then.
    fn yield_core(&self, now: Instant) -> bool {
        let handle = &self.handle;
        if !handle.shares_core.load(Ordering::Relaxed)
            || handle.parker.looks_out()
            || !self.schedule.is_idle()
            || !self.yielding.may_yield_core(now)
        {
            return false;
        }
        let deadline = self.wake_at().unwrap_or(Instant::LAST);
        let mut yielded = now;
        for _ in 0..YIELDS {
            std::thread::yield_now();
            let now = self.look_at_clock();
            self.yielding.came_back(yielded, now);
            if !self.inbox.is_empty() || deadline <= now {
                return true;
            }
            if !self.yielding.may_yield_core(now) {
                return false;
            }
            yielded = now;
        }
        false
    }
}
