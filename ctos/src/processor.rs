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

use std::{
    any::Any,
    cell::{Cell, RefCell},
    collections::VecDeque,
    future::Future,
    panic::{AssertUnwindSafe, catch_unwind},
    pin::Pin,
    rc::Rc,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    task::{Context as PollContext, Poll, Wake, Waker},
    thread::Thread,
    time::Duration,
};

use crate::{
    call::{Answer, ReplySlot},
    context::Note,
    exchange::{CallKey, Calls, Given, Looked, SOON, Started, Ticket},
    inbox::Inbox,
    mailbox::{Delivery, Mailbox, Order, TaskQueue},
    message::Tid,
    sync::Schedule,
    time::{Clock, Instant},
    timers::{TimerKey, Timers},
};

/// Work brought to a processor from another thread.
type Job = Box<dyn FnOnce(&Rc<Processor>) + Send>;

/// What other threads bring to a processor.
enum Item {
    /// A message for the task in a slot.
    Message(u16, Delivery),
    /// The answer to a call that a task of the processor waits for.
    Answer(Ticket, Answer),
    /// The same from somebody who no longer has the ticket.
    AnswerByKey(CallKey, Answer),
    /// A future is ready.
    Wake(FutureId),
    /// The task in a slot takes nothing more.
    Close(u16),
    /// An order to the queue of the task in a slot.
    Order(u16, Order),
    Job(Job),
    /// Nothing but a reason to look up.
    Nudge,
}

/// The part of a processor that other threads may touch.
#[derive(Default)]
pub(crate) struct ProcessorHandle {
    index: u8,
    inbox: Inbox<Item>,
    thread: OnceLock<Thread>,
    stop: AtomicBool,
    /// How long the thread looks for work before it sleeps, ns.
    spin_ns: AtomicU64,
}

impl ProcessorHandle {
    /// The handle of the `index`-th processor of a chassis.
    pub(crate) fn new(index: u8) -> Self {
        Self {
            index,
            ..Self::default()
        }
    }

    /// Its number on its chassis.
    pub(crate) fn index(&self) -> u8 {
        self.index
    }

    /// Runs `job` on the processor's thread, soon.
    pub(crate) fn inject(&self, job: impl FnOnce(&Rc<Processor>) + Send + 'static) {
        // What is refused is dropped here, outside of all locks: the processor is gone.
        drop(self.bring(Item::Job(Box::new(job))));
    }

    /// Ends [`Processor::run`] after the present step.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Release);
        self.unpark();
    }

    /// Wakes the processor, if it sleeps.
    pub(crate) fn unpark(&self) {
        drop(self.bring(Item::Nudge));
    }

    /// How long the thread looks for work before it sleeps. Worth it only where those who bring work
    /// run on other cores.
    pub(crate) fn set_spin(&self, spin: Duration) {
        let spin_ns = u64::try_from(spin.as_nanos()).unwrap_or(u64::MAX);
        self.spin_ns.store(spin_ns, Ordering::Relaxed);
    }

    /// Brings a message for the task in `slot`.
    ///
    /// # Errors
    /// The message, when the processor is gone.
    pub(crate) fn bring_message(&self, slot: u16, delivery: Delivery) -> Result<(), Delivery> {
        match self.bring(Item::Message(slot, delivery)) {
            Err(Item::Message(_, delivery)) => Err(delivery),
            _ => Ok(()),
        }
    }

    /// Tells the processor that the task in `slot` takes nothing more.
    pub(crate) fn bring_close(&self, slot: u16) {
        drop(self.bring(Item::Close(slot)));
    }

    /// Brings an order to the queue of the task in `slot`.
    pub(crate) fn bring_order(&self, slot: u16, order: Order) {
        drop(self.bring(Item::Order(slot, order)));
    }

    /// Brings the answer to a call. Without a processor nobody waits for it.
    pub(crate) fn bring_answer(&self, ticket: Ticket, answer: Answer) {
        drop(self.bring(Item::Answer(ticket, answer)));
    }

    /// [`Self::bring_answer`] without the ticket.
    pub(crate) fn bring_answer_by_key(&self, key: CallKey, answer: Answer) {
        drop(self.bring(Item::AnswerByKey(key, answer)));
    }

    fn bring(&self, item: Item) -> Result<(), Item> {
        if self.inbox.push(item)?
            && let Some(thread) = self.thread.get()
        {
            thread.unpark();
        }
        Ok(())
    }
}

/// Names one future among all that a processor has ever run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct FutureId {
    generation: u64,
    index: u32,
}

struct FutureWaker {
    id: FutureId,
    /// Whether the wake-up is in the inbox already.
    brought: AtomicBool,
    processor: Arc<ProcessorHandle>,
}

impl Wake for FutureWaker {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        if let Some(here) = Processor::here_if(&self.processor) {
            here.wake(self.id);
        } else if !self.brought.swap(true, Ordering::AcqRel) {
            drop(self.processor.bring(Item::Wake(self.id)));
        }
    }
}

/// What a future of this processor is woken by. Free of atomics when the future is a task's own.
#[derive(Clone)]
pub(crate) enum LocalWake {
    /// It is polled again.
    Future(FutureId),
    /// Whoever polls it within another future is told.
    Waker(Waker),
}

/// Called with what a child future's panic said.
type PanicHook = Rc<dyn Fn(String)>;

/// What is out of its entry while it is polled.
struct Running {
    future: Pin<Box<dyn Future<Output = ()>>>,
    waker: Waker,
    on_panic: Option<PanicHook>,
}

#[derive(Default)]
struct Entry {
    generation: u64,
    /// Whether it is among the ready ones.
    ready: bool,
    taken: bool,
    running: Option<Running>,
    shared: Option<Arc<FutureWaker>>,
}

#[derive(Default)]
struct Futures {
    entries: Vec<Entry>,
    free: Vec<u32>,
    ready: VecDeque<FutureId>,
}

impl Futures {
    fn entry(&mut self, id: FutureId) -> Option<&mut Entry> {
        let entry = self.entries.get_mut(id.index as usize)?;
        (entry.taken && entry.generation == id.generation).then_some(entry)
    }

    fn remove(&mut self, id: FutureId) -> Option<Running> {
        let entry = self.entry(id)?;
        entry.taken = false;
        entry.shared = None;
        let running = entry.running.take();
        self.free.push(id.index);
        running
    }
}

/// Who waits for a timer.
enum Timed {
    Sleep(LocalWake),
    Call(CallKey),
}

/// One processor, seen from its own thread.
pub(crate) struct Processor {
    pub(crate) handle: Arc<ProcessorHandle>,
    clock: Clock,
    /// The moment at which the runtime last took over from the code of tasks, or woke up.
    recent: Cell<Instant>,
    /// Whether no code of tasks has run since then.
    fresh: Cell<bool>,
    futures: RefCell<Futures>,
    /// The future that is being polled, and its waker.
    current: RefCell<Option<(FutureId, Waker)>>,
    timers: RefCell<Timers<Timed>>,
    calls: RefCell<Calls>,
    /// Calls of the present poll, whose time runs from its end.
    begun: RefCell<Vec<CallKey>>,
    /// Slots of calls that were made lately: they have no timers, and nobody sees them who wants to know
    /// what their tasks wait for.
    young: RefCell<Vec<u32>>,
    /// When these are looked after at the latest, if nothing leads to it before.
    young_until: Cell<Instant>,
    queues: RefCell<Vec<Option<Rc<TaskQueue>>>>,
    /// Queues of the other processors of the chassis, by processor and slot, that messages went to.
    routes: RefCell<Vec<Vec<Option<Arc<Mailbox>>>>>,
    batch: RefCell<Vec<Item>>,
    /// Its synchronous functions.
    pub(crate) schedule: Schedule,
    /// The next trace ids of its tasks, and where they end.
    traces: Cell<(u64, u64)>,
    handling: Cell<u64>,
    next_serial: Cell<u64>,
    orphan: RefCell<Option<ReplySlot>>,
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
            clock,
            futures: RefCell::default(),
            current: RefCell::default(),
            timers: RefCell::default(),
            calls: RefCell::default(),
            begun: RefCell::default(),
            young: RefCell::default(),
            young_until: Cell::new(Instant::LAST),
            queues: RefCell::default(),
            routes: RefCell::default(),
            batch: RefCell::default(),
            schedule,
            traces: Cell::new((0, 0)),
            handling: Cell::new(0),
            next_serial: Cell::new(1),
            orphan: RefCell::default(),
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
        let now = self.clock.now();
        self.recent.set(now);
        self.fresh.set(true);
        now
    }

    /// The moment at which code of a task has ended: that of the last look, if none has run since.
    #[inline]
    fn moment(&self) -> Instant {
        if self.fresh.get() {
            self.recent.get()
        } else {
            self.look_at_clock()
        }
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

    /// The processor that this thread runs.
    pub(crate) fn here() -> Option<Rc<Self>> {
        HERE.try_with(|here| here.borrow().clone()).ok().flatten()
    }

    // -- futures ----------------------------------------------------------------------------

    /// Adds a future; the id cancels it again.
    pub(crate) fn spawn(
        &self,
        future: impl Future<Output = ()> + 'static,
        on_panic: Option<PanicHook>,
    ) -> FutureId {
        let mut futures = self.futures.borrow_mut();
        let index = futures.free.pop().unwrap_or_else(|| {
            futures.entries.push(Entry::default());
            (futures.entries.len() - 1) as u32
        });
        // The index was free or has just been made.
        #[allow(clippy::indexing_slicing, reason = "see above")]
        let entry = &mut futures.entries[index as usize];
        entry.generation += 1;
        let id = FutureId {
            generation: entry.generation,
            index,
        };
        let shared = Arc::new(FutureWaker {
            id,
            brought: AtomicBool::new(false),
            processor: self.handle.clone(),
        });
        entry.taken = true;
        entry.ready = true;
        entry.running = Some(Running {
            future: Box::pin(future),
            waker: Waker::from(shared.clone()),
            on_panic,
        });
        entry.shared = Some(shared);
        futures.ready.push_back(id);
        id
    }

    /// Drops a future. A future that cancels itself ends at its next await.
    pub(crate) fn cancel(&self, id: FutureId) {
        let running = self.futures.borrow_mut().remove(id);
        // Dropped outside the borrow: destructors may spawn, wake or cancel.
        drop_contained(running);
    }

    /// A future is ready to be polled.
    #[inline]
    pub(crate) fn wake(&self, id: FutureId) {
        let mut futures = self.futures.borrow_mut();
        if let Some(entry) = futures.entry(id)
            && !entry.ready
        {
            entry.ready = true;
            futures.ready.push_back(id);
        }
    }

    #[inline]
    fn wake_local(&self, wake: LocalWake) {
        match wake {
            LocalWake::Future(id) => self.wake(id),
            LocalWake::Waker(waker) => waker.wake(),
        }
    }

    /// What the future polled with `cx` is woken by.
    #[inline]
    fn waits(&self, cx: &PollContext<'_>) -> LocalWake {
        match &*self.current.borrow() {
            Some((id, waker)) if waker.will_wake(cx.waker()) => LocalWake::Future(*id),
            _ => LocalWake::Waker(cx.waker().clone()),
        }
    }

    /// How many futures are ready to be polled.
    pub(crate) fn ready_count(&self) -> usize {
        self.futures.borrow().ready.len()
    }

    /// Polls the `index`-th ready future. False when there is none.
    pub(crate) fn poll_ready(self: &Rc<Self>, index: usize) -> bool {
        let Some((id, running)) = self.take_ready(index) else {
            return false;
        };
        let Some(Running {
            mut future,
            waker,
            on_panic,
        }) = running
        else {
            return true;
        };
        self.enter();
        *self.current.borrow_mut() = Some((id, waker));
        let polled = {
            let current = self.current.borrow();
            let waker = current.as_ref().map_or(Waker::noop(), |current| &current.1);
            let mut cx = PollContext::from_waker(waker);
            self.leave();
            catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(&mut cx)))
        };
        let waker = self.current.borrow_mut().take().map(|current| current.1);
        self.start_calls();
        let (Ok(Poll::Pending), Some(waker)) = (&polled, waker) else {
            drop_contained(future);
            self.cancel(id);
            if let (Err(panic), Some(on_panic)) = (polled, on_panic) {
                on_panic(panic_text(panic.as_ref()));
            }
            return true;
        };
        let running = Running {
            future,
            waker,
            on_panic,
        };
        let cancelled = {
            let mut futures = self.futures.borrow_mut();
            match futures.entry(id) {
                Some(entry) => {
                    entry.running = Some(running);
                    None
                }
                None => Some(running),
            }
        };
        // It was cancelled while it was polled.
        if cancelled.is_some() {
            drop_contained(cancelled);
        }
        true
    }

    #[inline]
    fn take_ready(&self, index: usize) -> Option<(FutureId, Option<Running>)> {
        let mut futures = self.futures.borrow_mut();
        let id = if index == 0 {
            futures.ready.pop_front()
        } else {
            futures.ready.remove(index)
        }?;
        let running = futures.entry(id).and_then(|entry| {
            entry.ready = false;
            entry.running.take()
        });
        Some((id, running))
    }

    /// Looks at the clock after a poll; the time of the calls that were made in it runs from now.
    #[inline]
    fn start_calls(&self) {
        let now = self.moment();
        let mut begun = self.begun.borrow_mut();
        if begun.is_empty() {
            return;
        }
        for key in begun.drain(..) {
            let started = self.calls.borrow_mut().start(key, now);
            match started {
                Started::Done => {}
                Started::List(slot) => {
                    let mut young = self.young.borrow_mut();
                    if young.is_empty() {
                        self.young_until.set(now + SOON / 2);
                    }
                    young.push(slot);
                }
                Started::Urgent => {
                    let call = self.calls.borrow_mut().settle_call(key);
                    self.set_timer(call);
                }
            }
        }
    }

    fn set_timer(&self, call: Option<(CallKey, Instant)>) {
        if let Some((key, at)) = call {
            let timer = self.timers.borrow_mut().insert(at, Timed::Call(key));
            self.calls.borrow_mut().set_timer(key, timer);
        }
    }

    /// Looks after the calls that still wait: sets their timers and shows them to whoever wants to know
    /// what their tasks wait for. Done when there is time for it, because most calls end before.
    pub(crate) fn settle_calls(&self) {
        let mut young = self.young.borrow_mut();
        for slot in young.drain(..) {
            let call = self.calls.borrow_mut().settle(slot);
            self.set_timer(call);
        }
        self.young_until.set(Instant::LAST);
    }

    // -- calls ------------------------------------------------------------------------------

    /// Begins a call that a future of this processor makes; its time runs from the end of the
    /// present poll.
    #[inline]
    pub(crate) fn begin_call(&self, limit: Duration) -> Ticket {
        let ticket = self.calls.borrow_mut().begin(&self.handle, limit);
        self.begun.borrow_mut().push(ticket.key());
        ticket
    }

    /// Notes who asked whom for what in a call.
    #[inline]
    pub(crate) fn note_call(&self, key: CallKey, note: Note) {
        self.calls.borrow_mut().set_note(key, note);
    }

    /// Looks for the answer to a call; with it comes the `note` of the call.
    #[inline]
    pub(crate) fn poll_call(
        &self,
        key: CallKey,
        note: &mut Option<Note>,
        cx: &PollContext<'_>,
    ) -> Looked {
        let (looked, before) = {
            let mut calls = self.calls.borrow_mut();
            let mut timers = self.timers.borrow_mut();
            calls.look(key, note, &mut timers, || self.waits(cx))
        };
        drop(before);
        looked
    }

    /// Nobody waits for the answer to a call any more.
    pub(crate) fn give_up_call(&self, key: CallKey) {
        let mut rest = self.calls.borrow_mut().give_up(key);
        if let Some(timer) = rest.timer.take() {
            self.timers.borrow_mut().remove(timer);
        }
        drop(rest);
    }

    /// Takes the answer to a call of this processor.
    #[inline]
    pub(crate) fn take_answer(&self, ticket: Ticket, answer: Answer) {
        let key = ticket.key();
        let given = self.calls.borrow_mut().answer(key, Some(ticket), answer);
        self.settle(given);
    }

    /// [`Self::take_answer`] from somebody who no longer has the ticket.
    pub(crate) fn take_answer_by_key(&self, key: CallKey, answer: Answer) {
        let given = self.calls.borrow_mut().answer(key, None, answer);
        self.settle(given);
    }

    #[inline]
    fn settle(&self, given: Given) {
        if let Given::Taken(Some(wake)) = given {
            self.wake_local(wake);
        }
    }

    /// When the caller of a call of this processor gives up.
    pub(crate) fn call_deadline(&self, key: CallKey) -> Option<Instant> {
        self.calls.borrow_mut().deadline(key)
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
    #[inline]
    pub(crate) fn queue(&self, slot: u16) -> Option<Rc<TaskQueue>> {
        self.queues.borrow().get(usize::from(slot))?.clone()
    }

    /// Forgets the queue of the task in `slot` and refuses what is in it.
    pub(crate) fn close_queue(&self, slot: u16) {
        let queue = self
            .queues
            .borrow_mut()
            .get_mut(usize::from(slot))
            .and_then(Option::take);
        if let Some(queue) = queue {
            queue.close(self);
        }
    }

    /// The open queue of `to`, a task of another processor of this chassis; `find` is asked when it
    /// is not known here.
    pub(crate) fn route(
        &self,
        to: Tid,
        find: impl FnOnce() -> Option<Arc<Mailbox>>,
    ) -> Option<std::cell::Ref<'_, Arc<Mailbox>>> {
        let (processor, slot) = (usize::from(to.processor()), usize::from(to.slot()));
        let known = std::cell::Ref::filter_map(self.routes.borrow(), |routes| {
            let mailbox = routes.get(processor)?.get(slot)?.as_ref()?;
            (!mailbox.is_closed()).then_some(mailbox)
        });
        match known {
            Ok(known) => return Some(known),
            // Not known, or closed; the cell is free again.
            Err(routes) => drop(routes),
        }
        let found = find();
        let mut routes = self.routes.borrow_mut();
        if routes.len() <= processor {
            routes.resize_with(processor + 1, Vec::new);
        }
        let slots = routes.get_mut(processor)?;
        if slots.len() <= slot {
            slots.resize_with(slot + 1, || None);
        }
        *slots.get_mut(slot)? = found;
        drop(routes);
        std::cell::Ref::filter_map(self.routes.borrow(), |routes| {
            routes.get(processor)?.get(slot)?.as_ref()
        })
        .ok()
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

    // -- the message at hand ----------------------------------------------------------------

    /// A number for a message that is about to be handled.
    #[inline]
    pub(crate) fn next_serial(&self) -> u64 {
        let serial = self.next_serial.get();
        self.next_serial.set(serial + 1);
        serial
    }

    /// Runs code of the handler of message `serial`: the right to answer it, dropped in there, is kept
    /// until it is known how the handler ended.
    #[inline]
    pub(crate) fn handling<T>(&self, serial: u64, code: impl FnOnce() -> T) -> T {
        struct Restore<'a>(&'a Cell<u64>, u64);
        impl Drop for Restore<'_> {
            fn drop(&mut self) {
                self.0.set(self.1);
            }
        }
        let _restore = Restore(&self.handling, self.handling.replace(serial));
        code()
    }

    /// Keeps a right to answer that the handler at work has dropped, or gives it back.
    pub(crate) fn keep_orphan(&self, slot: ReplySlot) -> Result<(), ReplySlot> {
        if slot.serial() == 0 || slot.serial() != self.handling.get() {
            return Err(slot);
        }
        // One message has one slot, so nothing is there before.
        *self.orphan.borrow_mut() = Some(slot);
        Ok(())
    }

    /// The right to answer message `serial`, if its handler dropped it.
    #[inline]
    pub(crate) fn take_orphan(&self, serial: u64) -> Option<ReplySlot> {
        let mut orphan = self.orphan.borrow_mut();
        if orphan.as_ref()?.serial() == serial {
            orphan.take()
        } else {
            None
        }
    }

    // -- time -------------------------------------------------------------------------------

    /// A future that ends at `deadline`.
    pub(crate) fn sleep_until(self: &Rc<Self>, deadline: Instant) -> Sleep {
        Sleep {
            processor: self.clone(),
            deadline,
            key: None,
        }
    }

    /// The next moment at which something is due without being woken.
    pub(crate) fn next_deadline(&self) -> Option<Instant> {
        self.settle_calls();
        let timer = self.timers.borrow().first();
        timer.into_iter().chain(self.schedule.next_due()).min()
    }

    /// The moment at which a sleeping processor must be awake: for a timer, or shortly before a tick.
    fn wake_at(&self) -> Option<Instant> {
        let timer = self.timers.borrow().first();
        timer.into_iter().chain(self.schedule.wake_at()).min()
    }

    /// Wakes the timers that are due.
    pub(crate) fn fire_timers(self: &Rc<Self>) {
        self.enter();
        let now = self.look_at_clock();
        self.settle_calls();
        self.fire_due(now);
    }

    #[inline]
    fn fire_due(&self, now: Instant) {
        if now >= self.young_until.get() {
            self.settle_calls();
        }
        loop {
            let Some(due) = self.timers.borrow_mut().pop_due(now) else {
                return;
            };
            match due {
                Timed::Sleep(wake) => self.wake_local(wake),
                Timed::Call(key) => {
                    let fired = self.calls.borrow_mut().fired(key);
                    if let Some(again) = fired.again {
                        let timer = self.timers.borrow_mut().insert(again, Timed::Call(key));
                        self.calls.borrow_mut().set_timer(key, timer);
                    }
                    if let Some(wake) = fired.wake {
                        self.wake_local(wake);
                    }
                }
            }
        }
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
        // Set once: a processor has one thread.
        let _ = self.handle.thread.set(std::thread::current());
        self.enter();
        let mut ticked = false;
        while !self.handle.stop.load(Ordering::Acquire) {
            self.run_jobs();
            // After each tick something else has its turn, however near the next one is.
            if !ticked {
                self.schedule.spin_to_tick();
            }
            ticked = self.schedule.run();
            if ticked {
                self.look_at_clock();
            }
            self.fire_due(self.recent.get());
            if !self.poll_ready(0) {
                self.wait();
            }
        }
        self.clear();
    }

    /// Waits for something to do: awake for a while if so told, then asleep.
    fn wait(&self) {
        let now = self.moment();
        if self.spin(now) {
            return;
        }
        self.settle_calls();
        let deadline = self.wake_at();
        let left = deadline.map(|deadline| deadline.since(self.look_at_clock()));
        if left == Some(Duration::ZERO) || !self.handle.inbox.sleep() {
            return;
        }
        match left {
            Some(left) => std::thread::park_timeout(left),
            None => std::thread::park(),
        }
        self.look_at_clock();
    }

    /// Looks for work without sleeping, as long as the processor was told to. Never yields: that would
    /// hand the core to whoever else wants it for a whole slice. True when there is something to do.
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
        loop {
            for _ in 0..LOOKS {
                if self.handle.inbox.is_filled() {
                    self.look_at_clock();
                    return true;
                }
                std::hint::spin_loop();
            }
            let now = self.look_at_clock();
            if deadline <= now {
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
        self.routes.borrow_mut().clear();
        let here = HERE.try_with(|here| here.borrow_mut().take_if(|here| Rc::ptr_eq(here, self)));
        // Outside the borrow, as in `enter`.
        drop(here);
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

/// Ends at a moment.
pub(crate) struct Sleep {
    processor: Rc<Processor>,
    deadline: Instant,
    key: Option<TimerKey>,
}

impl Sleep {
    fn take_out(&mut self) {
        if let Some(key) = self.key.take() {
            let timer = self.processor.timers.borrow_mut().remove(key);
            // Outside the borrow: a waker may hold code of others.
            drop(timer);
        }
    }
}

impl Future for Sleep {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<()> {
        self.take_out();
        if self.processor.now() >= self.deadline {
            return Poll::Ready(());
        }
        let waits = self.processor.waits(cx);
        let deadline = self.deadline;
        let key = self
            .processor
            .timers
            .borrow_mut()
            .insert(deadline, Timed::Sleep(waits));
        self.key = Some(key);
        Poll::Pending
    }
}

impl Drop for Sleep {
    fn drop(&mut self) {
        self.take_out();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        call::{Promise, Waiting},
        message::Data,
        sync::{ScheduleSettings, Synchronous, Tick},
    };

    fn processor() -> (Rc<Processor>, Clock) {
        let clock = Clock::virtual_clock();
        (Processor::new(Arc::default(), clock.clone()), clock)
    }

    fn run_until_idle(processor: &Rc<Processor>) {
        while processor.poll_ready(0) {}
    }

    #[test]
    fn timers_end_in_the_order_of_their_deadlines() {
        let (processor, clock) = processor();
        let order = Rc::new(RefCell::new(Vec::new()));
        for delay in [30, 10, 20] {
            let sleep = processor.sleep_until(Instant::from_nanos(delay));
            let order = order.clone();
            processor.spawn(
                async move {
                    sleep.await;
                    order.borrow_mut().push(delay);
                },
                None,
            );
        }
        run_until_idle(&processor);
        while let Some(next) = processor.next_deadline() {
            clock.advance_to(next);
            processor.fire_timers();
            run_until_idle(&processor);
        }
        assert_eq!(*order.borrow(), [10, 20, 30]);
    }

    #[test]
    fn a_panic_ends_its_future_only_and_is_reported() {
        let (processor, _) = processor();
        let said = Rc::new(RefCell::new(String::new()));
        let heard = said.clone();
        processor.spawn(
            async { panic!("boom") },
            Some(Rc::new(move |text| *heard.borrow_mut() = text)),
        );
        let done = Rc::new(Cell::new(false));
        let flag = done.clone();
        processor.spawn(async move { flag.set(true) }, None);
        run_until_idle(&processor);
        assert_eq!((said.borrow().as_str(), done.get()), ("boom", true));
    }

    #[test]
    fn a_dropped_sleep_leaves_no_timer() {
        let (processor, _) = processor();
        let sleep = processor.sleep_until(Instant::from_nanos(5));
        let id = processor.spawn(sleep, None);
        run_until_idle(&processor);
        assert!(processor.next_deadline().is_some());
        processor.cancel(id);
        assert!(processor.next_deadline().is_none());
    }

    #[test]
    fn a_schedule_that_takes_all_the_time_does_not_starve_the_tasks() {
        let (handle, clock) = (Arc::new(ProcessorHandle::default()), Clock::real());
        let settings = ScheduleSettings {
            period: Some(Duration::from_micros(100)),
            spin: Duration::from_micros(50),
            ..ScheduleSettings::default()
        };
        let schedule = Schedule::new(settings, clock.clone());
        let processor = Processor::with_schedule(handle.clone(), clock.clone(), schedule);
        let busy = move |tick: &Tick| while clock.now() < tick.due + Duration::from_micros(99) {};
        let busy = processor
            .schedule
            .add(Synchronous::new("busy", busy))
            .unwrap();
        let left = Rc::new(Cell::new(200));
        let turns = left.clone();
        processor.spawn(
            std::future::poll_fn(move |cx| {
                turns.set(turns.get() - 1);
                if turns.get() == 0 {
                    handle.stop();
                    return Poll::Ready(());
                }
                cx.waker().wake_by_ref();
                Poll::Pending
            }),
            None,
        );
        processor.run();
        assert_eq!(left.get(), 0);
        assert!(busy.statistics().runs() > 0);
    }

    #[test]
    fn a_destructor_that_panics_does_not_end_the_processor() {
        struct Bad;
        impl Drop for Bad {
            fn drop(&mut self) {
                if !std::thread::panicking() {
                    panic!("in a destructor");
                }
            }
        }
        let (processor, _) = processor();
        let bad = Bad;
        let id = processor.spawn(
            async move {
                let _bad = bad;
                std::future::pending::<()>().await;
            },
            None,
        );
        run_until_idle(&processor);
        processor.cancel(id);
        let done = Rc::new(Cell::new(false));
        let flag = done.clone();
        processor.spawn(async move { flag.set(true) }, None);
        run_until_idle(&processor);
        assert!(done.get());
    }

    #[test]
    fn wakes_from_other_threads_are_never_lost() {
        // Each round trip parks the processor; a lost wake-up would hang the test.
        let handle = Arc::new(ProcessorHandle::default());
        let (ask, asked) = std::sync::mpsc::channel::<Arc<Promise>>();
        let answering = std::thread::spawn(move || {
            for promise in asked {
                promise.fulfil(Ok(Data::Bytes(Vec::new())));
            }
        });
        let run = handle.clone();
        let thread = std::thread::spawn(move || Processor::new(run, Clock::real()).run());
        let stopper = handle.clone();
        handle.inject(move |processor| {
            processor.spawn(
                async move {
                    for _ in 0..20_000 {
                        let promise = Arc::new(Promise::default());
                        ask.send(promise.clone()).unwrap();
                        Waiting::here(promise).await.unwrap();
                    }
                    stopper.stop();
                },
                None,
            );
        });
        thread.join().unwrap();
        answering.join().unwrap();
    }

    #[test]
    fn a_job_from_another_thread_runs_on_the_processor() {
        let handle = Arc::new(ProcessorHandle::default());
        let other = handle.clone();
        let thread = std::thread::spawn(move || {
            let processor = Processor::new(handle, Clock::real());
            processor.run();
        });
        let stopper = other.clone();
        other.inject(move |_| stopper.stop());
        thread.join().unwrap();
    }
}
