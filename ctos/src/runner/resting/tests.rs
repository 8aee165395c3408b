//! Tasks that rest, by a virtual clock.

use std::{
    future::Future,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    task::Poll,
};

use super::*;
use crate::{
    call::{Answer, Promise, ReplySlot, Waiting},
    chassis::{Chassis, TaskRecord},
    config::load_texts,
    mailbox::Acceptance,
    message::{Command, CommandInfo, Data, Flags, Message, Tid},
    processor::Processor,
    registry::{Recipe, Registry},
    runner::{TaskSpec, record, start_task},
    system::{Ping, Statistics},
    task::{EventHandler, Handled},
    time::Clock,
};

crate::command! {
    /// Answers with how many of these came.
    struct Count => u64, 1, "count"
}

struct Counter {
    count: u64,
    dropped: Arc<AtomicU64>,
}

impl EventHandler for Counter {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != Count::CODE {
            return cx.default_processing(message);
        }
        let (Count {}, reply) = message.open::<Count>()?;
        self.count += 1;
        reply.ok(self.count)
    }
}

impl Drop for Counter {
    fn drop(&mut self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
        if !std::thread::panicking() {
            panic!("in a destructor");
        }
    }
}

/// Keeps its context, and answers with its own id.
struct Keeper(Context);

impl EventHandler for Keeper {
    async fn handle(&mut self, _: &Context, message: Message) -> Handled {
        let (Count {}, reply) = message.open::<Count>()?;
        reply.ok(u64::from(self.0.tid().bits()))
    }
}

/// Starts the task in `slot`.
fn start(
    chassis: &Arc<Chassis>,
    processor: &Rc<Processor>,
    slot: u16,
    recipe: Arc<Recipe>,
) -> Arc<TaskRecord> {
    let record = record("t", Tid::new(1, 1, slot), None, recipe, &processor.handle);
    let spec = TaskSpec {
        record: record.clone(),
        config: None,
    };
    start_task(chassis, processor, spec).unwrap();
    record
}

struct Bench {
    chassis: Arc<Chassis>,
    processor: Rc<Processor>,
    record: Arc<TaskRecord>,
    dropped: Arc<AtomicU64>,
}

impl Bench {
    fn new() -> Self {
        let text = "[chassis.cell]\n[task.t]\nhandler = \"counter\"\non = \"cell\"\n";
        let app = load_texts(&[("app.toml", text)], &[], &[]).unwrap();
        let dropped = Arc::<AtomicU64>::default();
        let counted = dropped.clone();
        let mut registry = Registry::new();
        registry.handler("counter", &[Count::INFO], move |_| {
            Ok(Counter {
                count: 0,
                dropped: counted.clone(),
            })
        });
        let recipe = registry.kind("counter").unwrap().recipe();
        let registry = Arc::new(registry);
        let chassis = Chassis::new(1, Arc::new(app), registry, Clock::virtual_clock());
        let processor = chassis.processor(1).unwrap();
        processor.enter();
        let record = start(&chassis, &processor, 0, recipe);
        Self {
            chassis,
            processor,
            record,
            dropped,
        }
    }

    fn settle(&self) {
        while self.processor.run_jobs() || self.processor.poll_ready(0) {}
    }

    fn rests(&self) -> bool {
        let queue = self.processor.queue(0);
        queue.is_some_and(|queue| queue.is_resting())
    }

    fn ask(&self, command: CommandInfo) -> Option<Answer> {
        let nothing = Data::Bytes(Vec::new());
        let message = Message::with_data(self.record.tid, Tid::default(), command.code, nothing);
        let mut message = message.flagged(Flags::REPLY_WAIT);
        let promise = Arc::new(Promise::default());
        message.letter.reply = Some(ReplySlot::local(promise.clone()));
        self.record.mailbox.put(message, Acceptance::Silent);
        self.settle();
        let mut waiting = std::pin::pin!(Waiting::here(promise));
        let mut cx = std::task::Context::from_waker(std::task::Waker::noop());
        match waiting.as_mut().poll(&mut cx) {
            Poll::Ready(answer) => Some(answer),
            Poll::Pending => None,
        }
    }

    fn count(&self) -> u64 {
        let counted = self.ask(Count::INFO).unwrap().unwrap();
        counted.take().unwrap()
    }

    fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.processor.clear();
        self.chassis.close();
    }
}

#[test]
fn a_task_rests_from_its_start_and_again_after_messages_of_the_runtime_and_keeps_its_handler() {
    let bench = Bench::new();
    assert!(bench.rests());
    assert_eq!(bench.processor.ready_count(), 0);
    assert_eq!(bench.count(), 1);
    assert!(!bench.rests(), "the next message may come at once");
    assert_eq!(bench.count(), 2);
    for command in [Ping::INFO, Statistics::INFO] {
        assert!(bench.ask(command).is_some_and(|answer| answer.is_ok()));
        assert!(bench.rests());
    }
    assert_eq!(bench.count(), 3);
    assert_eq!(bench.dropped(), 0);
}

#[test]
fn a_task_to_which_nothing_has_come_has_no_queue() {
    let bench = Bench::new();
    assert!(!bench.processor.has_queue(0));
    assert_eq!(bench.count(), 1);
    assert!(bench.processor.has_queue(0));
}

#[test]
fn a_task_to_which_nothing_has_come_ends_when_it_is_taken_out() {
    let bench = Bench::new();
    ends_when_it_is_taken_out(&bench);
}

#[test]
fn a_task_that_rests_ends_when_it_is_taken_out() {
    let bench = Bench::new();
    assert!(bench.ask(Ping::INFO).is_some_and(|answer| answer.is_ok()));
    assert!(bench.rests());
    ends_when_it_is_taken_out(&bench);
}

fn ends_when_it_is_taken_out(bench: &Bench) {
    let tid = bench.record.tid;
    bench.chassis.remove_task(tid);
    bench.settle();
    // Its destructor panics, which is reported and contained.
    assert_eq!(bench.dropped(), 1);
    assert!(bench.chassis.task(tid).is_none());
    assert!(bench.processor.queue(0).is_none());
    assert!(bench.ask(Count::INFO).is_some_and(|answer| answer.is_err()));
}

#[test]
fn a_processor_that_ends_drops_the_handlers_of_tasks_that_rest() {
    for asked in [false, true] {
        let bench = Bench::new();
        assert!(!asked || bench.rests());
        assert_eq!(bench.processor.has_queue(0), asked);
        bench.processor.clear();
        assert_eq!(bench.dropped(), 1);
    }
}

#[test]
fn a_task_whose_context_is_kept_from_the_beginning_answers() {
    let mut bench = Bench::new();
    let mut registry = Registry::new();
    registry.handler("keeper", &[Count::INFO], |cx| Ok(Keeper(cx.clone())));
    let recipe = registry.kind("keeper").unwrap().recipe();
    bench.record = start(&bench.chassis, &bench.processor, 1, recipe);
    assert!(bench.processor.has_queue(1));
    assert_eq!(bench.count(), u64::from(bench.record.tid.bits()));
}

#[test]
fn what_is_kept_of_an_idle_task_is_small() {
    // Two counters of owners before each that is shared.
    let shared = 2 * size_of::<usize>();
    let record = shared + size_of::<TaskRecord>();
    let queue = shared + size_of::<TaskQueue>();
    let built = size_of::<Option<Built>>();
    assert!(record + built <= 112, "{record} + {built}");
    assert!(record + queue <= 192, "{record} + {queue}");
}
