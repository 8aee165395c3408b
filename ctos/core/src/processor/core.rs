//! What a processor consists of, and which one this thread runs.

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    sync::Arc,
};

use crossbeam_channel::Receiver;

use super::{
    futures::{Futures, WakerOf},
    handle::{Item, ProcessorHandle},
    wake::{FutureId, LocalWake},
    yielding::Yielding,
};
use crate::{
    delivery::{Delivery, NotTaken},
    envelope::Message,
    exchange::Calls,
    reply::CallKey,
    sync::Schedule,
    timers::Timers,
};
use ctos_time::{Clock, Instant};

/// The queue of a task, as its processor sees it.
pub trait Inlet {
    /// Takes a message of this thread, if there is a credit for it now.
    ///
    /// # Errors
    /// The message, if there is none.
    fn offer(&self, processor: &Processor, message: Message) -> Result<(), NotTaken>;
    /// Takes in what was brought.
    fn accept(&self, processor: &Processor, delivery: Delivery);
    /// Takes nothing more; everything inside is answered.
    fn close(&self, processor: &Processor);
}

/// Who waits for a timer.
pub(super) enum Timed {
    Sleep(LocalWake),
    Call(CallKey),
}

/// One processor, seen from its own thread.
pub struct Processor {
    pub handle: Arc<ProcessorHandle>,
    /// What other threads bring, in the order in which they brought it.
    pub(super) inbox: Receiver<Item>,
    clock: Clock,
    /// The moment at which the runtime last took over from the code of tasks, or woke up.
    pub(super) recent: Cell<Instant>,
    /// Whether no code of tasks has run since then.
    fresh: Cell<bool>,
    pub(super) yielding: Yielding,
    pub(super) futures: RefCell<Futures>,
    /// The future that is being polled, and its waker.
    pub(super) current: Cell<Option<(FutureId, WakerOf)>>,
    /// Calls of the present poll whose receivers have run within it, and how many are at work now.
    pub(super) handed_over: Cell<u32>,
    pub(super) depth: Cell<u32>,
    pub(super) timers: RefCell<Timers<Timed>>,
    pub(super) calls: RefCell<Calls>,
    /// Calls that were made lately, and when the processor looks after them.
    pub(super) unsettled: RefCell<Vec<CallKey>>,
    pub(super) settle_at: Cell<Instant>,
    /// The queues of its tasks, by slot.
    pub(super) queues: RefCell<Vec<Option<Rc<dyn Inlet>>>>,
    /// Its synchronous functions.
    pub schedule: Schedule,
}

thread_local! {
    /// The processor whose code this thread runs.
    pub(super) static HERE: RefCell<Option<Rc<Processor>>> = const { RefCell::new(None) };
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
            handed_over: Cell::new(0),
            depth: Cell::new(0),
            timers: RefCell::default(),
            calls: RefCell::default(),
            unsettled: RefCell::default(),
            settle_at: Cell::new(Instant::LAST),
            queues: RefCell::default(),
            schedule,
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
    pub fn look_at_clock(&self) -> Instant {
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
    pub(crate) fn here_if(handle: &ProcessorHandle) -> Option<Rc<Self>> {
        let here = HERE.try_with(|here| {
            let here = here.borrow();
            let here = here.as_ref()?;
            std::ptr::eq(&*here.handle, handle).then(|| here.clone())
        });
        here.ok().flatten()
    }

    /// [`Self::here_if`], unless the inbox holds something: that was sent earlier and comes first. (Of two messages
    /// of one sender, another thread may have read the first from their link.)
    pub(crate) fn at_hand(handle: &Arc<ProcessorHandle>) -> Option<Rc<Self>> {
        Self::here_if(handle).filter(|here| here.inbox.is_empty())
    }

    /// The processor that this thread runs.
    pub fn here() -> Option<Rc<Self>> {
        HERE.try_with(|here| here.borrow().clone()).ok().flatten()
    }

    // -- queues of tasks --------------------------------------------------------------------

    /// Makes the queue of the task in `slot` known.
    pub(crate) fn add_queue(&self, slot: u32, queue: Rc<dyn Inlet>) {
        let mut queues = self.queues.borrow_mut();
        let slot = slot as usize;
        if queues.len() <= slot {
            queues.resize_with(slot + 1, || None);
        }
        if let Some(place) = queues.get_mut(slot) {
            *place = Some(queue);
        }
    }

    /// The queue of the task in `slot`.
    pub(crate) fn queue(&self, slot: u32) -> Option<Rc<dyn Inlet>> {
        self.queues.borrow().get(slot as usize)?.clone()
    }

    /// Brings something to the queue of the task in `slot`.
    pub(crate) fn deliver(&self, slot: u32, delivery: Delivery) {
        match self.queue(slot) {
            Some(queue) => queue.accept(self, delivery),
            None => delivery.refuse(),
        }
    }

    /// Forgets the queue of the task in `slot` and refuses what is in it.
    pub(crate) fn close_queue(&self, slot: u32) {
        let mut queues = self.queues.borrow_mut();
        let queue = queues.get_mut(slot as usize).and_then(Option::take);
        drop(queues);
        if let Some(queue) = queue {
            queue.close(self);
        }
    }
}
