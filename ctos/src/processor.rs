//! A processor: one thread that runs tasks, their timers and their synchronous functions.
//!
//! The executor knows nothing of what messages mean. It polls futures that were woken, fires timers,
//! hands over what other threads brought to its inbox, and calls cyclic functions at their deadlines,
//! which come before everything else. In real time each processor has a thread of its own
//! ([`Processor::run`]); in virtual time the simulation polls all processors from one thread through
//! the small steps that `run` is made of.
//!
//! What stays on the processor needs no lock: queues of its tasks, calls that its tasks wait for, futures that
//! are ready. The clock is read after each handler and after each poll; that moment counts as the beginning of
//! whatever comes next.

mod alarm;
mod calls;
mod futures;
mod handle;
mod yielding;

use std::{
    any::Any,
    cell::{Cell, RefCell},
    panic::{AssertUnwindSafe, catch_unwind},
    rc::Rc,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use crossbeam_channel::Receiver;

use self::{
    alarm::Timed,
    futures::{Futures, WakerOf},
    handle::Item,
    yielding::Yielding,
};
use crate::{
    call::ReplySlot,
    exchange::{CallKey, Calls},
    mailbox::TaskQueue,
    park::Glance,
    sync::Schedule,
    time::{Clock, Instant},
    timers::Timers,
};

pub(crate) use self::{
    futures::{FutureId, LocalWake},
    handle::ProcessorHandle,
};

/// One processor, seen from its own thread.
pub(crate) struct Processor {
    pub(crate) handle: Arc<ProcessorHandle>,
    /// What other threads bring, in the order in which they brought it.
    inbox: Receiver<Item>,
    clock: Clock,
    /// The moment at which the runtime last took over from the code of tasks, or woke up.
    recent: Cell<Instant>,
    /// Whether no code of tasks has run since then.
    fresh: Cell<bool>,
    yielding: Yielding,
    futures: RefCell<Futures>,
    /// The future that is being polled, and its waker.
    current: Cell<Option<(FutureId, WakerOf)>>,
    timers: RefCell<Timers<Timed>>,
    calls: RefCell<Calls>,
    /// Calls that were made lately, and when they are looked after.
    young: RefCell<Vec<CallKey>>,
    settle_at: Cell<Instant>,
    /// The queues of its tasks, by slot.
    queues: RefCell<Vec<Option<Rc<TaskQueue>>>>,
    /// Its synchronous functions.
    pub(crate) schedule: Schedule,
    /// The message whose handler is at work; 0: none is.
    handling: Cell<u64>,
    next_serial: Cell<u64>,
    /// Rights to answer that handlers at work have dropped.
    orphans: RefCell<Vec<ReplySlot>>,
}

thread_local! {
    /// The processor whose code this thread runs.
    static HERE: RefCell<Option<Rc<Processor>>> = const { RefCell::new(None) };
}

impl Processor {
    #[cfg(test)]
    pub(crate) fn new(handle: Arc<ProcessorHandle>, clock: Clock) -> Rc<Self> {
        let schedule = Schedule::new(crate::sync::ScheduleSettings::default(), clock.clone());
        Self::with_schedule(handle, clock, schedule)
    }

    pub(crate) fn with_schedule(
        handle: Arc<ProcessorHandle>,
        clock: Clock,
        schedule: Schedule,
    ) -> Rc<Self> {
        Rc::new(Self {
            inbox: handle.take_outlet(),
            handle,
            recent: Cell::new(clock.now()),
            fresh: Cell::new(false),
            clock,
            yielding: Yielding::default(),
            futures: RefCell::default(),
            current: Cell::new(None),
            timers: RefCell::default(),
            calls: RefCell::default(),
            young: RefCell::default(),
            settle_at: Cell::new(Instant::LAST),
            queues: RefCell::default(),
            schedule,
            handling: Cell::new(0),
            next_serial: Cell::new(1),
            orphans: RefCell::default(),
        })
    }

    /// The present moment.
    pub(crate) fn now(&self) -> Instant {
        self.clock.now()
    }

    /// The moment at which the runtime last took over from the code of tasks.
    pub(crate) fn recent(&self) -> Instant {
        self.recent.get()
    }

    /// Reads the clock where the runtime takes over.
    pub(crate) fn look_at_clock(&self) -> Instant {
        let now = self.clock.now();
        self.recent.set(now);
        self.fresh.set(true);
        now
    }

    /// The moment at which code of a task has ended: that of the last look, if none has run since.
    pub(crate) fn moment(&self) -> Instant {
        if self.fresh.get() {
            self.recent.get()
        } else {
            self.look_at_clock()
        }
    }

    /// No code of tasks has run since the last look, to speak of.
    pub(crate) fn stay(&self) {
        self.fresh.set(true);
    }

    /// Code of a task is about to run: the last look at the clock will be an old one.
    pub(crate) fn leave(&self) {
        self.fresh.set(false);
    }

    // -- which processor this thread runs ---------------------------------------------------

    /// From now on this thread runs code of this processor.
    pub(crate) fn enter(self: &Rc<Self>) {
        let before = HERE.with(|here| {
            let mut here = here.borrow_mut();
            match here.as_ref() {
                Some(here) if Rc::ptr_eq(here, self) => None,
                _ => here.replace(self.clone()),
            }
        });
        // Outside the borrow: the last owner of a processor ends what waits there.
        drop(before);
    }

    /// The processor of `handle`, if this thread runs it.
    pub(crate) fn here_if(handle: &Arc<ProcessorHandle>) -> Option<Rc<Self>> {
        let here = HERE.try_with(|here| {
            let here = here.borrow();
            let here = here.as_ref()?;
            Arc::ptr_eq(&here.handle, handle).then(|| here.clone())
        });
        here.ok().flatten()
    }

    /// [`Self::here_if`], unless something is on the way to it from other threads, which comes before what is to be
    /// given to it now: of two messages of one sender, the first may have been read from their link by another thread.
    pub(crate) fn at_hand(handle: &Arc<ProcessorHandle>) -> Option<Rc<Self>> {
        Self::here_if(handle).filter(|here| here.inbox.is_empty())
    }

    /// The processor that this thread runs.
    pub(crate) fn here() -> Option<Rc<Self>> {
        HERE.try_with(|here| here.borrow().clone()).ok().flatten()
    }

    // -- queues of tasks --------------------------------------------------------------------

    /// Makes the queue of the task in `slot` known.
    pub(crate) fn add_queue(&self, slot: u16, queue: Rc<TaskQueue>) {
        let mut queues = self.queues.borrow_mut();
        let slot = usize::from(slot);
        if queues.len() <= slot {
            queues.resize_with(slot + 1, || None);
        }
        if let Some(place) = queues.get_mut(slot) {
            *place = Some(queue);
        }
    }

    /// The queue of the task in `slot`.
    pub(crate) fn queue(&self, slot: u16) -> Option<Rc<TaskQueue>> {
        self.queues.borrow().get(usize::from(slot))?.clone()
    }

    /// Forgets the queue of the task in `slot` and refuses what is in it.
    pub(crate) fn close_queue(&self, slot: u16) {
        let mut queues = self.queues.borrow_mut();
        let queue = queues.get_mut(usize::from(slot)).and_then(Option::take);
        drop(queues);
        if let Some(queue) = queue {
            queue.close(self);
        }
    }

    // -- what others bring ------------------------------------------------------------------

    /// Takes in what other threads have brought by now. True when there was something.
    pub(crate) fn run_jobs(self: &Rc<Self>) -> bool {
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
            Item::Message(slot, delivery) => match self.queue(slot) {
                Some(queue) => queue.take_in(self, delivery),
                None => delivery.refuse(),
            },
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
            Item::Order(slot, order) => {
                if let Some(queue) = self.queue(slot) {
                    queue.obey(self, order);
                }
            }
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

    /// Runs the synchronous functions whose turn it is. True when there was a tick; after each something else has
    /// its turn, however near the next one is.
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
        // The clock was looked at above, or when it last looked for work.
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

    /// Announces that it sleeps now, if there is nothing to do.
    fn falls_asleep(&self) -> bool {
        let handle = &self.handle;
        let has_work = || !self.inbox.is_empty() || handle.stop.load(Ordering::Acquire);
        handle.asleep.fall(has_work)
    }

    /// Looks for work without sleeping, as long as the processor was told to: at what other threads brought,
    /// and at the links of the chassis. Never yields: that would hand the core to whoever else wants it for a
    /// whole slice. True when there is something to do.
    fn spin(&self, since: Instant) -> bool {
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
    pub(crate) fn clear(self: &Rc<Self>) {
        self.enter();
        loop {
            for item in self.inbox.try_iter() {
                match item {
                    // What waits for a credit or an answer is told; the rest only goes.
                    Item::Message(_, delivery) => delivery.refuse(),
                    item => drop_contained(item),
                }
            }
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
}

/// Drops what may hold code of others: a destructor that panics must not end the thread.
pub(crate) fn drop_contained<T>(value: T) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| drop(value))) {
        let text = panic_text(panic.as_ref());
        tracing::error!(panic = %text, "a destructor panicked");
    }
}

/// What a panic said.
pub(crate) fn panic_text(panic: &(dyn Any + Send)) -> String {
    if let Some(text) = panic.downcast_ref::<&str>() {
        (*text).to_owned()
    } else if let Some(text) = panic.downcast_ref::<String>() {
        text.clone()
    } else {
        "a value that is not text".to_owned()
    }
}

#[cfg(test)]
mod tests;
