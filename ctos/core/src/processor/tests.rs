//! The executor alone, without messages.

use std::{
    cell::{Cell, RefCell},
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    rc::Rc,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU32, Ordering},
    },
    task::{Poll, Waker},
    time::Duration,
};

use super::*;
use crate::{
    reply::{Caller, Promise},
    sync::{Lead, Schedule, ScheduleSettings, Synchronous, Tick},
};
use ctos_link::{
    reactor::{Happened, LinkParker, Reactor, Seen, Source, Visible},
    shm::bell,
};
use ctos_message::Data;
use ctos_time::{Clock, Instant, lock::lock};

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
        lead: Lead::Fixed(Duration::from_micros(50)),
        ..ScheduleSettings::default()
    };
    let schedule = Schedule::new(settings, clock.clone());
    let processor = Processor::with_schedule(handle.clone(), clock.clone(), schedule);
    let began = Arc::new(AtomicBool::new(false));
    let begins = began.clone();
    let busy = move |tick: &Tick| {
        begins.store(true, Ordering::Release);
        while clock.now() < tick.due + Duration::from_micros(99) {}
    };
    let _busy = processor
        .schedule
        .add(Synchronous::new("busy", busy))
        .unwrap();
    let left = Rc::new(Cell::new(200));
    let turns = left.clone();
    processor.spawn(
        std::future::poll_fn(move |cx| {
            // Those before the first tick say nothing.
            if began.load(Ordering::Acquire) {
                turns.set(turns.get() - 1);
            }
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
    for gives_way in [false, true] {
        wakes_from_other_threads(gives_way);
    }
}

fn wakes_from_other_threads(gives_way: bool) {
    // Each round trip parks the processor; a lost wake-up would hang the test.
    let handle = Arc::new(ProcessorHandle::default());
    handle.set_shares_core(gives_way);
    let (ask, asked) = std::sync::mpsc::channel::<Arc<Promise>>();
    let answering = std::thread::spawn(move || {
        for promise in asked {
            promise.answer(Ok(Data::Bytes(Vec::new())));
        }
    });
    let run = handle.clone();
    let thread = std::thread::spawn(move || Processor::new(run, Clock::real()).run());
    let stopper = handle.clone();
    handle.inject(move |processor| {
        processor.spawn(
            async move {
                for _ in 0..20_000 {
                    let (promise, waiting) = Promise::new();
                    ask.send(promise).unwrap();
                    waiting.await.unwrap();
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

/// A link that shows something after some looks, and then wakes a task.
struct Shows {
    fd: OwnedFd,
    looks_left: AtomicU32,
    visible: bool,
    wakes: Mutex<Option<Waker>>,
}

impl Source for Shows {
    fn serve(&self, _: Happened) -> Seen {
        match lock(&self.wakes).take() {
            Some(waker) => {
                waker.wake();
                Seen::Frames
            }
            None => Seen::Nothing,
        }
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }

    fn visible(&self) -> Option<&dyn Visible> {
        self.visible.then_some(self)
    }
}

impl Visible for Shows {
    fn has_come(&self) -> bool {
        let left = self.looks_left.load(Ordering::SeqCst).saturating_sub(1);
        self.looks_left.store(left, Ordering::SeqCst);
        left == 0
    }

    fn set_asleep(&self, _: bool) {}
}

/// Spins for as long as it takes until a link has brought something.
fn spins_until_a_link_brings_something(visible: bool) -> Arc<Shows> {
    let clock = Clock::real();
    let reactor = Reactor::new("test", clock.clone(), Duration::ZERO).unwrap();
    // Once the standby is gone nobody but the processor looks.
    reactor.close();
    while Arc::strong_count(&reactor) > 1 {
        std::thread::yield_now();
    }
    let processor = Processor::new(Arc::default(), clock);
    processor.enter();
    processor
        .handle
        .parker
        .set(Arc::new(LinkParker::new(reactor.clone())));
    processor.handle.set_spin(Duration::from_secs(600));
    let wakes = Arc::new(Mutex::new(None));
    let keeps = wakes.clone();
    processor.spawn(
        std::future::poll_fn(move |cx| {
            *lock(&keeps) = Some(cx.waker().clone());
            Poll::Pending
        }),
        None,
    );
    run_until_idle(&processor);
    let fd = bell().unwrap();
    // What the system says of it is that something can be read.
    rustix::io::write(&fd, &1_u64.to_ne_bytes()).unwrap();
    let source = Arc::new(Shows {
        fd,
        looks_left: AtomicU32::new(1000),
        visible,
        wakes: Mutex::new(lock(&wakes).take()),
    });
    let shown = source.clone();
    let watched = reactor.add(shown).unwrap();
    assert!(processor.spin(processor.now()), "nothing has come");
    assert_eq!(processor.ready_count(), 1);
    drop(watched);
    source
}

#[test]
fn a_processor_that_spins_looks_at_shared_memory_as_often_as_at_its_inbox() {
    let source = spins_until_a_link_brings_something(true);
    assert_eq!(source.looks_left.load(Ordering::SeqCst), 0);
}

#[test]
fn a_processor_that_spins_asks_for_what_comes_over_sockets() {
    let source = spins_until_a_link_brings_something(false);
    assert_eq!(source.looks_left.load(Ordering::SeqCst), 1000);
}
