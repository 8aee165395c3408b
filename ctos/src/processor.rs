//! A processor: one thread that runs tasks, their timers and their synchronous functions.
//!
//! The executor knows nothing of messages. It polls futures that were woken, fires timers, and calls
//! cyclic functions at their deadlines, which come before everything else. In real time each
//! processor has a thread of its own ([`Processor::run`]); in virtual time the simulation polls all
//! processors from one thread through the small steps that `run` is made of.

use std::{
    any::Any,
    cell::{Cell, RefCell},
    collections::{BTreeMap, VecDeque},
    future::Future,
    panic::{AssertUnwindSafe, catch_unwind},
    pin::Pin,
    rc::Rc,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context as PollContext, Poll, Wake, Waker},
    time::Duration,
};

use crate::{
    call::lock,
    link::lookout::Parker,
    sync::Schedule,
    time::{Clock, Instant},
};

/// Work brought to a processor from another thread.
type Job = Box<dyn FnOnce(&Rc<Processor>) + Send>;

/// The part of a processor that other threads may touch.
#[derive(Default)]
pub(crate) struct ProcessorHandle {
    ready: Mutex<VecDeque<u64>>,
    jobs: Mutex<Vec<Job>>,
    /// Where its thread sleeps.
    pub(crate) parker: Parker,
    stop: AtomicBool,
}

impl ProcessorHandle {
    /// Runs `job` on the processor's thread, soon.
    pub(crate) fn inject(&self, job: impl FnOnce(&Rc<Processor>) + Send + 'static) {
        lock(&self.jobs).push(Box::new(job));
        self.unpark();
    }

    /// Ends [`Processor::run`] after the present step.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Release);
        self.unpark();
    }

    /// Wakes the processor, if it sleeps.
    pub(crate) fn unpark(&self) {
        self.parker.unpark();
    }
}

struct FutureWaker {
    id: u64,
    queued: AtomicBool,
    processor: Arc<ProcessorHandle>,
}

impl Wake for FutureWaker {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        if !self.queued.swap(true, Ordering::AcqRel) {
            lock(&self.processor.ready).push_back(self.id);
            self.processor.unpark();
        }
    }
}

/// Called with what a child future's panic said.
type PanicHook = Rc<dyn Fn(String)>;

struct Entry {
    /// Out while it is being polled.
    future: Option<Pin<Box<dyn Future<Output = ()>>>>,
    waker: Arc<FutureWaker>,
    on_panic: Option<PanicHook>,
}

#[derive(Default)]
struct Timers {
    queue: BTreeMap<(Instant, u64), Waker>,
    next: u64,
}

/// One processor, seen from its own thread.
pub(crate) struct Processor {
    pub(crate) handle: Arc<ProcessorHandle>,
    clock: Clock,
    futures: RefCell<BTreeMap<u64, Entry>>,
    next_future: Cell<u64>,
    timers: RefCell<Timers>,
    /// Its synchronous functions.
    pub(crate) schedule: Schedule,
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
            clock,
            futures: RefCell::default(),
            next_future: Cell::new(0),
            timers: RefCell::default(),
            schedule,
        })
    }

    pub(crate) fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Adds a future; the number cancels it again.
    pub(crate) fn spawn(
        &self,
        future: impl Future<Output = ()> + 'static,
        on_panic: Option<PanicHook>,
    ) -> u64 {
        let id = self.next_future.get();
        self.next_future.set(id + 1);
        let waker = Arc::new(FutureWaker {
            id,
            queued: AtomicBool::new(false),
            processor: self.handle.clone(),
        });
        let entry = Entry {
            future: Some(Box::pin(future)),
            waker: waker.clone(),
            on_panic,
        };
        self.futures.borrow_mut().insert(id, entry);
        waker.wake();
        id
    }

    /// Drops a future. A future that cancels itself ends at its next await.
    pub(crate) fn cancel(&self, id: u64) {
        let entry = self.futures.borrow_mut().remove(&id);
        // Dropped outside the borrow: destructors may spawn, wake or cancel.
        drop_contained(entry);
    }

    /// A future that ends at `deadline`.
    pub(crate) fn sleep_until(self: &Rc<Self>, deadline: Instant) -> Sleep {
        Sleep {
            processor: self.clone(),
            deadline,
            key: None,
        }
    }

    /// Runs the jobs that other threads brought. True when there were some.
    pub(crate) fn run_jobs(self: &Rc<Self>) -> bool {
        let jobs = std::mem::take(&mut *lock(&self.handle.jobs));
        let any = !jobs.is_empty();
        for job in jobs {
            job(self);
        }
        any
    }

    /// How many futures are ready to be polled.
    pub(crate) fn ready_count(&self) -> usize {
        lock(&self.handle.ready).len()
    }

    /// Polls the `index`-th ready future. False when there is none.
    pub(crate) fn poll_ready(&self, index: usize) -> bool {
        let Some(id) = lock(&self.handle.ready).remove(index) else {
            return false;
        };
        let taken = {
            let mut futures = self.futures.borrow_mut();
            futures.get_mut(&id).and_then(|entry| {
                // A swap, so that what a waker that comes too late to queue again has written is
                // seen by the poll below.
                entry.waker.queued.swap(false, Ordering::AcqRel);
                let future = entry.future.take()?;
                Some((future, entry.waker.clone(), entry.on_panic.clone()))
            })
        };
        let Some((mut future, waker, on_panic)) = taken else {
            return true;
        };
        let waker = Waker::from(waker);
        let mut cx = PollContext::from_waker(&waker);
        match catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(&mut cx))) {
            Ok(Poll::Pending) => {
                if let Some(entry) = self.futures.borrow_mut().get_mut(&id) {
                    entry.future = Some(future);
                    return true;
                }
                // It was cancelled while it was polled.
                drop_contained(future);
            }
            Ok(Poll::Ready(())) => {
                drop_contained(future);
                self.cancel(id);
            }
            Err(panic) => {
                drop_contained(future);
                self.cancel(id);
                if let Some(on_panic) = on_panic {
                    on_panic(panic_text(panic.as_ref()));
                }
            }
        }
        true
    }

    /// The next moment at which something is due without being woken.
    pub(crate) fn next_deadline(&self) -> Option<Instant> {
        let timer = self.timers.borrow().queue.keys().next().map(|key| key.0);
        timer.into_iter().chain(self.schedule.next_due()).min()
    }

    /// Wakes the timers that are due.
    pub(crate) fn fire_timers(&self) {
        if self.timers.borrow().queue.is_empty() {
            return;
        }
        let now = self.now();
        loop {
            let waker = {
                let mut timers = self.timers.borrow_mut();
                match timers.queue.first_entry() {
                    Some(entry) if entry.key().0 <= now => Some(entry.remove()),
                    _ => None,
                }
            };
            match waker {
                Some(waker) => waker.wake(),
                None => return,
            }
        }
    }

    /// The moment at which a sleeping processor must be awake: for a timer, or shortly before a tick.
    fn wake_at(&self) -> Option<Instant> {
        let timer = self.timers.borrow().queue.keys().next().map(|key| key.0);
        timer.into_iter().chain(self.schedule.wake_at()).min()
    }

    /// The processor's thread: returns after [`ProcessorHandle::stop`].
    pub(crate) fn run(self: &Rc<Self>) {
        self.handle.parker.sit_down();
        let mut ticked = false;
        while !self.handle.stop.load(Ordering::Acquire) {
            self.run_jobs();
            // After each tick something else has its turn, however near the next one is.
            if !ticked {
                self.schedule.spin_to_tick();
            }
            ticked = self.schedule.run();
            self.fire_timers();
            if self.poll_ready(0) {
                continue;
            }
            match self.wake_at() {
                Some(deadline) => {
                    let wait = deadline.since(self.now());
                    if wait > Duration::ZERO {
                        self.handle.parker.park(Some(wait));
                    }
                }
                None => self.handle.parker.park(None),
            }
        }
        self.clear();
    }

    /// Drops every future, so that what they own is released and answered.
    pub(crate) fn clear(&self) {
        loop {
            let futures = std::mem::take(&mut *self.futures.borrow_mut());
            let cyclics = self.schedule.clear();
            let jobs = std::mem::take(&mut *lock(&self.handle.jobs));
            if futures.is_empty() && !cyclics && jobs.is_empty() {
                return;
            }
            for (_, entry) in futures {
                drop_contained(entry);
            }
            drop_contained(jobs);
        }
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
    key: Option<(Instant, u64)>,
}

impl Future for Sleep {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<()> {
        if self.processor.now() >= self.deadline {
            return Poll::Ready(());
        }
        let processor = self.processor.clone();
        let mut timers = processor.timers.borrow_mut();
        if let Some(key) = self.key.take() {
            timers.queue.remove(&key);
        }
        let key = (self.deadline, timers.next);
        timers.next += 1;
        timers.queue.insert(key, cx.waker().clone());
        self.key = Some(key);
        Poll::Pending
    }
}

impl Drop for Sleep {
    fn drop(&mut self) {
        if let Some(key) = self.key.take() {
            self.processor.timers.borrow_mut().queue.remove(&key);
        }
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
