//! A processor: one thread that runs tasks, their timers and their synchronous functions.
//!
//! The executor knows nothing of what messages mean. It polls futures that were woken, fires timers,
//! hands over what other threads brought to its inbox, and calls cyclic functions at their deadlines,
//! which come before everything else. In real time each processor has a thread of its own
//! ([`Processor::run`]); in virtual time the simulation polls all processors from one thread through
//! the small steps that `run` is made of.
//!
//! What stays on the processor needs no atomics and no lock: queues of its tasks, calls that its tasks
//! wait for, futures that are ready. The clock is read once after each poll; that moment counts as the
//! beginning of whatever comes next.

mod alarm;
mod calls;
mod courtesy;
mod futures;
mod handle;
mod handover;
mod queues;
mod routes;
mod stopwatch;

use std::{
    any::Any,
    cell::{Cell, RefCell},
    panic::{AssertUnwindSafe, catch_unwind},
    rc::Rc,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use self::{
    alarm::Timed,
    courtesy::Courtesy,
    futures::{Futures, WakerOf},
    handle::Item,
    handover::Handovers,
    queues::Queues,
    routes::Routes,
    stopwatch::Stopwatch,
};
use crate::{
    call::ReplySlot,
    context::Beside,
    exchange::{CallKey, Calls},
    mailbox::TaskQueue,
    message::Letter,
    park::Glance,
    sync::Schedule,
    time::{Clock, Instant},
    timers::Timers,
};

pub(crate) use self::{
    futures::{FutureId, LocalWake},
    handle::ProcessorHandle,
    handover::Turn,
};

/// One processor, seen from its own thread.
pub(crate) struct Processor {
    pub(crate) handle: Arc<ProcessorHandle>,
    clock: Clock,
    /// The moment at which the runtime last took over from the code of tasks, or woke up.
    recent: Cell<Instant>,
    /// Whether no code of tasks has run since then.
    fresh: Cell<bool>,
    /// How rarely it looks at the clock while the code of its tasks is brief.
    stopwatch: Stopwatch,
    handovers: Handovers,
    courtesy: Courtesy,
    futures: RefCell<Futures>,
    /// The future that is being polled, and its waker.
    current: Cell<Option<(FutureId, WakerOf)>>,
    timers: RefCell<Timers<Timed>>,
    calls: RefCell<Calls>,
    /// Calls of the present poll, whose time runs from its end.
    begun: RefCell<Vec<CallKey>>,
    /// Slots of calls that were made lately: they have no timers, and nobody sees them who wants to know
    /// what their tasks wait for.
    young: RefCell<Vec<u32>>,
    /// When these are looked after at the latest, if nothing leads to it before.
    young_until: Cell<Instant>,
    queues: Queues,
    /// Tasks of the other processors of the chassis that messages went to.
    routes: Routes,
    batch: RefCell<Vec<Item>>,
    /// Names of its tasks, by slot, as those beside them called them.
    names: RefCell<Vec<Option<Arc<str>>>>,
    /// Its synchronous functions.
    pub(crate) schedule: Schedule,
    /// What its tasks show each other.
    pub(crate) beside: Beside,
    /// The next trace ids of its tasks, and where they end.
    traces: Cell<(u64, u64)>,
    handling: Cell<u64>,
    next_serial: Cell<u64>,
    /// Rights to answer that handlers at work have dropped.
    orphans: RefCell<Vec<ReplySlot>>,
    /// How many tasks were started here.
    starts: Cell<u32>,
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
            handle,
            recent: Cell::new(clock.now()),
            fresh: Cell::new(false),
            stopwatch: Stopwatch::new(clock.origin_ns().is_some()),
            clock,
            handovers: Handovers::default(),
            courtesy: Courtesy::default(),
            futures: RefCell::default(),
            current: Cell::new(None),
            timers: RefCell::default(),
            calls: RefCell::default(),
            begun: RefCell::default(),
            young: RefCell::default(),
            young_until: Cell::new(Instant::LAST),
            queues: Queues::default(),
            routes: Routes::default(),
            batch: RefCell::default(),
            names: RefCell::default(),
            schedule,
            beside: Beside::default(),
            traces: Cell::new((0, 0)),
            handling: Cell::new(0),
            next_serial: Cell::new(1),
            orphans: RefCell::default(),
            starts: Cell::new(0),
        })
    }

    /// The present moment.
    #[inline]
    pub(crate) fn now(&self) -> Instant {
        self.clock.now()
    }

    /// The moment at which the runtime last took over from the code of tasks.
    #[inline]
    pub(crate) fn recent(&self) -> Instant {
        self.recent.get()
    }

    /// Reads the clock where code of a task has just ended.
    #[inline]
    pub(crate) fn look_at_clock(&self) -> Instant {
        self.measure();
        self.recent.get()
    }

    /// Reads the clock where no code of a task has run since the last look: how long tasks are at work is not to
    /// be learnt from that.
    fn look_without_turn(&self) -> Instant {
        let now = self.clock.now();
        self.recent.set(now);
        self.fresh.set(true);
        now
    }

    /// Runs what may take long and is no turn of any task.
    pub(crate) fn beside_turns(&self, code: impl FnOnce()) {
        let fresh = self.fresh.get();
        self.look_at_clock();
        code();
        self.look_without_turn();
        // A task whose turn this is in goes on.
        self.fresh.set(fresh);
    }

    /// The present moment by `clock`, which is that of the chassis that this thread belongs to. If the thread
    /// runs a processor, it has looked at its clock then.
    #[inline]
    pub(crate) fn look_here(clock: &Clock) -> Instant {
        match Self::here() {
            Some(processor) => processor.look_at_clock(),
            None => clock.now(),
        }
    }

    /// The present moment, in the midst of the code of a task, for what is noted of it. What the runtime begins
    /// before that code goes on ([`Self::leave`]) begins then. None by a virtual clock, which need not be that of
    /// the record.
    #[inline]
    pub(crate) fn look_within(&self) -> Option<Instant> {
        self.stopwatch.is_real().then(|| self.look_at_clock())
    }

    /// The moment of the last look, for what is noted of something that was over by then. None by a virtual clock.
    #[inline]
    pub(crate) fn seen_at(&self) -> Option<Instant> {
        self.stopwatch.is_real().then(|| self.recent.get())
    }

    /// Looks at the clock; what the last of the turns since the look before took, ns.
    #[inline]
    fn measure(&self) -> u64 {
        let now = self.clock.now();
        let took = self.stopwatch.looked(now.since(self.recent.get()));
        self.recent.set(now);
        self.fresh.set(true);
        took
    }

    /// The moment at which code of a task has ended: that of the last look, if none has run since.
    #[inline]
    fn moment(&self) -> Instant {
        if self.is_exact() {
            self.recent.get()
        } else {
            self.look_at_clock()
        }
    }

    /// Whether the last look at the clock was at this moment.
    #[inline]
    fn is_exact(&self) -> bool {
        self.fresh.get() && !self.stopwatch.is_behind()
    }

    /// How long a handler took that began at `began` and has just ended, ns: looked up if it must be
    /// `exact`, else perhaps estimated (see [`Stopwatch`]).
    #[inline]
    pub(crate) fn time_since(&self, began: Instant, exact: bool) -> u64 {
        // One that has waited for others began before the last look.
        let at_once = began == self.recent.get();
        self.stopwatch.set_exact(exact);
        if at_once && self.stopwatch.skips() {
            self.fresh.set(true);
            return self.stopwatch.estimate();
        }
        let took = self.measure();
        if at_once {
            return took;
        }
        let took = self.recent.get().since(began).as_nanos();
        u64::try_from(took).unwrap_or(u64::MAX)
    }

    /// Code of a task is about to run: the last look at the clock will be an old one.
    #[inline]
    pub(crate) fn leave(&self) {
        self.fresh.set(false);
    }

    // -- which processor this thread runs ---------------------------------------------------

    /// From now on this thread runs code of this processor.
    #[inline]
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
    #[inline]
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
    #[inline]
    pub(crate) fn at_hand(handle: &Arc<ProcessorHandle>) -> Option<Rc<Self>> {
        Self::here_if(handle).filter(|here| !here.handle.inbox.is_filled())
    }

    /// Gives the answer to a call of the processor that this thread runs, if nobody has looked at the call. The
    /// letter, when it is to be given in the usual way.
    #[inline]
    pub(crate) fn answer_here(letter: Box<Letter>) -> Option<Box<Letter>> {
        let mut left = Some(letter);
        // It fails where the thread ends.
        let _ = HERE.try_with(|here| {
            if let Ok(here) = here.try_borrow()
                && let Some(here) = here.as_ref()
                && let Ok(mut calls) = here.calls.try_borrow_mut()
                && let Some(letter) = left.take()
            {
                left = calls.answer_unseen(&here.handle, letter).err();
            }
        });
        left
    }

    /// The processor that this thread runs.
    pub(crate) fn here() -> Option<Rc<Self>> {
        HERE.try_with(|here| here.borrow().clone()).ok().flatten()
    }

    // -- queues of tasks --------------------------------------------------------------------

    /// A task is about to be started. Where many are, memory for the next ones is asked for together: the
    /// allocator of a thread may go to the system for each page (that of glibc does), which takes about as long
    /// as starting the tasks that are in it.
    pub(crate) fn prepare_start(&self) {
        prepare(&self.starts, 512);
    }

    /// A trace id that no other message of the run has; `more` gives the first of as many new ones.
    #[inline]
    pub(crate) fn fresh_trace(&self, more: impl FnOnce(u64) -> u64) -> u64 {
        /// So many at once, so that the processors of a chassis rarely meet at its counter.
        const BLOCK: u64 = 256;
        let (mut next, mut end) = self.traces.get();
        if next == end {
            next = more(BLOCK);
            end = next + BLOCK;
        }
        self.traces.set((next + 1, end));
        next
    }

    // -- what others bring ------------------------------------------------------------------

    /// Takes in what other threads brought. True when there was something.
    pub(crate) fn run_jobs(self: &Rc<Self>) -> bool {
        if !self.handle.inbox.is_filled() {
            return false;
        }
        self.enter();
        let mut batch = std::mem::take(&mut *self.batch.borrow_mut());
        self.handle.inbox.swap(&mut batch);
        let any = !batch.is_empty();
        // Whoever sends much sends it to the same task.
        let mut last: Option<(u16, Rc<TaskQueue>)> = None;
        for item in batch.drain(..) {
            let Item::Message(slot, delivery) = item else {
                end_batch(last.take());
                self.take_in(item);
                continue;
            };
            if last.as_ref().is_none_or(|(of, _)| *of != slot) {
                end_batch(last.take());
                last = self.queue(slot).map(|queue| (slot, queue));
            }
            match &last {
                Some((_, queue)) => queue.take_in(self, delivery),
                None => delivery.refuse(),
            }
        }
        end_batch(last);
        *self.batch.borrow_mut() = batch;
        any
    }

    fn take_in(self: &Rc<Self>, item: Item) {
        match item {
            Item::Message(slot, delivery) => match self.queue(slot) {
                Some(queue) => {
                    queue.take_in(self, delivery);
                    queue.end_batch();
                }
                None => delivery.refuse(),
            },
            Item::Answer(ticket, answer) => self.take_answer(ticket, answer),
            Item::AnswerByKey(key, answer) => self.take_answer_by_key(key, answer),
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
        self.start_begun(now);
        if self.spin(now) || self.give_way(now) {
            return;
        }
        self.settle_calls();
        let (tick, deadline) = (self.schedule.wake_at(), self.wake_at());
        // The clock was looked at above, or when it last looked for work.
        let now = self.recent.get();
        if deadline.is_some_and(|deadline| deadline <= now) || !self.handle.inbox.sleep() {
            return;
        }
        self.leave();
        self.handle.parker.park(now, deadline);
        if self.ready_count() > 0 {
            // What it read at the links was for tasks of its own.
            self.handle.parker.had_work();
        }
        // What came over a link has led to a look already.
        if !self.is_exact() {
            self.look_without_turn();
        }
        let now = self.recent.get();
        if let Some(tick) = tick {
            self.schedule.woke(tick, now);
        }
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
        let deadline = deadline.min(self.young_until.get());
        let handle = &self.handle;
        // What comes over a link may be for others, and a future of this processor is ready when it is not.
        let brings = |glance: Glance| handle.parker.glance(glance) && self.ready_count() > 0;
        loop {
            for _ in 0..LOOKS {
                if handle.inbox.is_filled() || brings(Glance::AtMemory) {
                    self.look_without_turn();
                    return true;
                }
                std::hint::spin_loop();
            }
            let brought = brings(Glance::Everywhere);
            let now = self.look_without_turn();
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
        let brought = self.handle.inbox.close();
        for item in brought {
            match item {
                // What waits for room or an answer is told; the rest only goes.
                Item::Message(_, delivery) => delivery.refuse(),
                item => drop_contained(item),
            }
        }
        loop {
            let futures = std::mem::take(&mut *self.futures.borrow_mut());
            let cyclics = self.schedule.clear();
            let queues = self.queues.clear();
            let timers = self.timers.borrow_mut().clear();
            if futures.entries.is_empty() && !cyclics && queues.is_none() {
                break;
            }
            for entry in futures.entries {
                drop_contained(entry);
            }
            for queue in queues.into_iter().flatten() {
                drop_contained(queue.take_resting());
                queue.close(self);
            }
            drop_contained(timers);
        }
        self.routes.clear();
        self.beside.clear();
        let here = HERE.try_with(|here| here.borrow_mut().take_if(|here| Rc::ptr_eq(here, self)));
        // Outside the borrow, as in `enter`.
        drop(here);
    }
}

/// One more is made of what `made` counts. At every `together`th, memory for as many is asked for.
fn prepare(made: &Cell<u32>, together: u32) {
    /// What they take in all, bytes: less than what an allocator makes a mapping of its own for, which would be
    /// gone when it is given back.
    const MEMORY: usize = 112 << 10;
    made.set(made.get().wrapping_add(1));
    if made.get().is_multiple_of(together) {
        // What is given back is kept by the allocator.
        drop(std::hint::black_box(Vec::<u8>::with_capacity(MEMORY)));
    }
}

/// The last of some messages for one queue has been taken in.
fn end_batch(queue: Option<(u16, Rc<TaskQueue>)>) {
    if let Some((_, queue)) = queue {
        queue.end_batch();
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
