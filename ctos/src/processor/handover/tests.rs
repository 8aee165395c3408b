//! Turns within turns, by a virtual clock and therefore the same every time: whether the code of tasks is
//! brief is not measured but taken to be so.

mod recorded;

use std::{
    cell::RefCell,
    future::poll_fn,
    path::Path,
    pin::pin,
    rc::Rc,
    sync::{
        Arc, Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    task::Poll,
    time::Duration,
};

use futures_util::{FutureExt, future::join};
use proptest::prelude::*;
use serde::{Deserialize, Serialize};

use super::*;
use crate::{
    call::{CallError, Fault, lock},
    chassis::{Chassis, TaskRecord},
    config::{App, load_texts},
    context::{Context, TaskRef},
    mailbox::{Offered, TaskQueue},
    message::{Command, Message, Tid},
    record::{Recording, start},
    registry::Registry,
    runner::{TaskSpec, record, start_task},
    task::{EventHandler, Handled},
    time::Clock,
};

/// What a task does before it answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Step {
    /// Calls one of the tasks behind it.
    Call(usize, Vec<Step>),
    /// The same, two at once.
    Both([usize; 2], Vec<Step>),
    /// Sends to one of the tasks behind it.
    Tell(usize),
    /// Lets others have their turns.
    Wait,
    /// Calls whoever called.
    CallBack,
    /// Answers with an error.
    Refuse,
    /// Drops the right to answer, then goes on.
    Drop,
    Panic,
    /// Begins a child that calls its own task, which panics, and that says so if it comes so far.
    Child,
}

crate::command! {
    /// Does the steps; answers with how many messages that took, itself included.
    struct Do { number: u64, steps: Vec<Step> } => u64, 1, "do"
}
crate::command! {
    /// Is noted.
    struct Note { number: u64 } => (), 2, "note"
}

/// Who handled whose message, and what that was numbered.
type Log = Arc<Mutex<Vec<(Tid, Tid, u64)>>>;

struct Worker {
    tasks: Arc<Vec<TaskRef>>,
    log: Log,
    sent: u64,
}

/// Ends when everything else that is ready has had its turn.
async fn wait() {
    let mut waited = false;
    poll_fn(|cx| {
        if std::mem::replace(&mut waited, true) {
            return Poll::Ready(());
        }
        cx.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

impl Worker {
    /// One of the tasks behind it: so nobody waits for itself.
    fn behind(&self, cx: &Context, choice: usize) -> Option<TaskRef> {
        let behind = self.tasks.get(usize::from(cx.tid().slot()) + 1..)?;
        behind.get(choice % behind.len().max(1)).cloned()
    }

    fn next(&mut self) -> u64 {
        self.sent += 1;
        self.sent
    }

    async fn call(&mut self, cx: &Context, to: usize, steps: Vec<Step>) -> Result<u64, CallError> {
        let Some(to) = self.behind(cx, to) else {
            return Ok(0);
        };
        let number = self.next();
        cx.call(&to, Do { number, steps }).await
    }
}

impl EventHandler for Worker {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let from = message.from();
        if message.command() == Note::CODE {
            let (Note { number }, _) = message.open::<Note>()?;
            lock(&self.log).push((cx.tid(), from, number));
            return Ok(());
        }
        let (Do { number, steps }, reply) = message.open::<Do>()?;
        lock(&self.log).push((cx.tid(), from, number));
        let mut reply = Some(reply);
        let mut count = 1;
        for step in steps {
            match step {
                Step::Call(to, steps) => count += self.call(cx, to, steps).await?,
                Step::Both(to, steps) => {
                    let [one, other] = to.map(|to| self.behind(cx, to));
                    if let (Some(one), Some(other)) = (one, other) {
                        let [first, second] = [self.next(), self.next()];
                        let ask = |number| Do {
                            number,
                            steps: steps.clone(),
                        };
                        let one = cx.call(&one, ask(first)).into_future();
                        let other = cx.call(&other, ask(second)).into_future();
                        let (one, other) = join(one, other).await;
                        count += one? + other?;
                    }
                }
                Step::Tell(to) => {
                    let number = self.next();
                    if let Some(to) = self.behind(cx, to) {
                        cx.send(&to, Note { number }).await?;
                        count += 1;
                    }
                }
                Step::Wait => wait().await,
                Step::CallBack => {
                    let caller = TaskRef::new("caller", from);
                    let number = self.next();
                    let steps = Vec::new();
                    let called = cx.call(&caller, Do { number, steps });
                    count += called.deadline(Duration::from_secs(1)).await?;
                }
                Step::Refuse => return Err("no".into()),
                Step::Drop => drop(reply.take()),
                Step::Panic => panic!("on purpose"),
                Step::Child => {
                    let (own, log) = (cx.clone(), self.log.clone());
                    let task = TaskRef::new(cx.name(), cx.tid());
                    cx.spawn(async move {
                        let steps = vec![Step::Panic];
                        let number = 0;
                        let _ = own.call(&task, Do { number, steps }).await;
                        lock(&log).push((own.tid(), own.tid(), u64::MAX));
                    });
                }
            }
        }
        match reply {
            Some(reply) => reply.ok(count),
            None => Ok(()),
        }
    }
}

/// Some tasks on one processor.
struct Bench {
    chassis: Arc<Chassis>,
    processor: Rc<Processor>,
    clock: Clock,
    tasks: Arc<Vec<TaskRef>>,
    records: Vec<Arc<TaskRecord>>,
    log: Log,
    recording: Option<Recording>,
}

/// As many tasks.
const TASKS: u16 = 6;

fn all_tasks() -> Arc<Vec<TaskRef>> {
    let task = |slot| TaskRef::new(format!("t{slot}"), Tid::new(1, 1, slot));
    Arc::new((0..TASKS).map(task).collect())
}

fn registry(tasks: &Arc<Vec<TaskRef>>, log: &Log) -> Registry {
    let mut registry = Registry::new();
    let (all, noted) = (tasks.clone(), log.clone());
    registry.handler("worker", &[Do::INFO, Note::INFO], move |_| {
        Ok(Worker {
            tasks: all.clone(),
            log: noted.clone(),
            sent: 0,
        })
    });
    registry
}

/// An app of these tasks, with this before them in its text.
fn app(folder: &Path, begin: &str) -> App {
    let mut text = format!("{begin}[chassis.cell]\n");
    for slot in 0..TASKS {
        text += &format!("[task.t{slot}]\nhandler = \"worker\"\non = \"cell\"\n");
    }
    let file = folder.join("app.toml").display().to_string();
    load_texts(&[(&file, &text)], &[], &[]).unwrap()
}

impl Bench {
    fn new(hands_over: bool) -> Self {
        Self::of(app(Path::new(""), ""), hands_over)
    }

    fn of(app: App, hands_over: bool) -> Self {
        let (tasks, log) = (all_tasks(), Log::default());
        let registry = registry(&tasks, &log);
        let clock = Clock::virtual_clock();
        let chassis = Chassis::new(1, Arc::new(app), Arc::new(registry), clock.clone());
        let recording = start(std::slice::from_ref(&chassis)).unwrap();
        let processor = chassis.processor(1).unwrap();
        processor.handovers.always.set(hands_over);
        processor.enter();
        let kind = chassis.registry.kind("worker").unwrap();
        let records: Vec<_> = tasks
            .iter()
            .map(|task| {
                record(
                    task.name(),
                    task.tid(),
                    None,
                    kind.recipe(),
                    &processor.handle,
                )
            })
            .collect();
        for record in &records {
            let spec = TaskSpec {
                record: record.clone(),
                config: None,
            };
            start_task(&chassis, &processor, spec).unwrap();
        }
        let bench = Self {
            processor,
            clock,
            tasks,
            records,
            log,
            recording,
            chassis,
        };
        // A task that has never had a message has no loop yet that could be given a turn.
        let all = (0..usize::from(TASKS)).map(|task| (task, Vec::new()));
        let answers = bench.call_each(all.collect());
        bench.settle();
        assert!(answers.take().iter().all(|answer| *answer == Some(Ok(1))));
        lock(&bench.log).clear();
        bench
    }

    fn settle(&self) {
        while self.processor.run_jobs() || self.processor.poll_ready(0) {}
    }

    /// Everything that is due until the end.
    fn run(&self) {
        self.settle();
        while let Some(next) = self.processor.next_deadline() {
            self.clock.advance_to(next);
            self.processor.fire_timers();
            self.settle();
        }
    }

    /// A context that calls from outside of the tasks.
    fn caller(&self, slot: u16) -> Context {
        let tid = Tid::new(1, 1, slot);
        let record = record("caller", tid, None, Arc::default(), &self.processor.handle);
        let (chassis, processor) = (self.chassis.clone(), self.processor.clone());
        Context::new(record, chassis, processor, None)
    }

    /// Begins a call of each of the tasks; the answers come in here.
    fn call_each(&self, programs: Vec<(usize, Vec<Step>)>) -> Answers {
        let answers = Answers::default();
        for (number, (to, steps)) in programs.into_iter().enumerate() {
            let cx = self.caller(100 + u16::try_from(number).unwrap());
            let to = self.tasks[to % self.tasks.len()].clone();
            let answers = answers.clone();
            answers.borrow_mut().push(None);
            let call = async move {
                let answer = cx.call(&to, Do { number: 0, steps }).await;
                answers.borrow_mut()[number] = Some(answer);
            };
            self.processor.spawn(call, None);
        }
        answers
    }

    /// The answer to one call of the first task.
    fn ask(&self, steps: Vec<Step>) -> Result<u64, CallError> {
        let answers = self.call_each(vec![(0, steps)]);
        self.run();
        answers.take().remove(0).expect("a call ends")
    }

    fn log(&self) -> Vec<(Tid, Tid, u64)> {
        lock(&self.log).clone()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        if let Some(recording) = self.recording.take() {
            recording.finish();
        }
        self.processor.clear();
        self.chassis.close();
    }
}

type Answers = Rc<RefCell<Vec<Option<Result<u64, CallError>>>>>;

#[test]
fn a_call_of_an_idle_task_ends_in_the_turn_of_its_caller_a_few_times_in_a_row() {
    const MANY: u64 = 2 * MOST as u64 + 8;
    let bench = Bench::new(true);
    let (cx, to) = (bench.caller(100), bench.tasks[0].clone());
    let turns = Rc::new(RefCell::new(Vec::new()));
    let others = turns.clone();
    let calls = async move {
        for number in 0..MANY {
            let ask = Do {
                number,
                steps: Vec::new(),
            };
            let call = pin!(cx.call(&to, ask).into_future());
            assert_eq!(call.await.unwrap(), 1);
            turns.borrow_mut().push(number);
        }
    };
    let mut calls = Box::pin(calls);
    let polls = Arc::new(AtomicUsize::new(0));
    let counted = polls.clone();
    let counting = poll_fn(move |cx| {
        counted.fetch_add(1, Ordering::Relaxed);
        calls.poll_unpin(cx)
    });
    bench.processor.spawn(counting, None);
    assert!(bench.processor.poll_ready(0));
    // The one after these waits in the usual way.
    assert_eq!(others.borrow().len(), MOST as usize);
    bench.settle();
    assert_eq!(others.borrow().len(), MANY as usize);
    let polls = polls.load(Ordering::Relaxed);
    assert_eq!(polls, MANY as usize / (MOST as usize + 1) + 1);
}

#[test]
fn whoever_is_ready_has_its_turn_before_a_task_that_is_called() {
    let bench = Bench::new(true);
    let order = Rc::new(RefCell::new(Vec::new()));
    let (cx, to, noted) = (bench.caller(100), bench.tasks[0].clone(), order.clone());
    let call = async move {
        let ask = Do {
            number: 0,
            steps: Vec::new(),
        };
        cx.call(&to, ask).await.unwrap();
        noted.borrow_mut().push("answer");
    };
    bench.processor.spawn(call, None);
    let noted = order.clone();
    let other = async move { noted.borrow_mut().push("other") };
    bench.processor.spawn(other, None);
    bench.settle();
    assert_eq!(*order.borrow(), ["other", "answer"]);
}

#[test]
fn nothing_is_handed_over_while_something_was_brought_or_the_processor_is_to_stop() {
    for stops in [false, true] {
        let bench = Bench::new(true);
        let answers = bench.call_each(vec![(0, Vec::new())]);
        let handle = &bench.processor.handle;
        if stops {
            handle.stop()
        } else {
            handle.unpark()
        }
        assert!(bench.processor.poll_ready(0));
        assert_eq!(*answers.borrow(), [None]);
        bench.settle();
        assert!(matches!(*answers.borrow(), ref all if all[0] == Some(Ok(1))));
    }
}

#[test]
fn a_task_that_is_called_back_by_whom_it_calls_is_not_entered_again() {
    let bench = Bench::new(true);
    let error = bench
        .ask(vec![Step::Call(0, vec![Step::CallBack])])
        .unwrap_err();
    // Both wait for one another, as long as the inner call lasts.
    assert!(matches!(error.fault, Fault::Refused { .. }), "{error}");
    assert!(error.to_string().contains("within 1.000 s"), "{error}");
    assert_eq!(bench.ask(vec![Step::Call(0, Vec::new())]).unwrap(), 2);
}

#[test]
fn a_chain_of_calls_ends_however_long_it_is() {
    for hands_over in [false, true] {
        let bench = Bench::new(hands_over);
        let steps = (1..TASKS).fold(Vec::new(), |inner, _| vec![Step::Call(0, inner)]);
        assert_eq!(bench.ask(steps).unwrap(), u64::from(TASKS));
        // Each was entered once, by the one before it.
        let slots: Vec<_> = bench.log().iter().map(|(to, ..)| to.slot()).collect();
        assert_eq!(slots, (0..TASKS).collect::<Vec<_>>());
    }
}

#[test]
fn a_panic_of_whom_a_task_calls_is_no_panic_of_its_own() {
    let bench = Bench::new(true);
    let error = bench
        .ask(vec![Step::Call(0, vec![Step::Panic])])
        .unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("`t0` refused") && text.contains("the handler of `t1` panicked"),
        "{text}"
    );
    let failed = |task: usize| bench.records[task].statistics.read().failed;
    assert_eq!((failed(0), failed(1)), (1, 1));
    // The caller goes on.
    assert_eq!(bench.ask(Vec::new()).unwrap(), 1);
}

#[test]
fn a_child_that_its_own_task_cancels_at_its_call_goes_no_further() {
    for hands_over in [false, true] {
        let bench = Bench::new(hands_over);
        assert_eq!(bench.ask(vec![Step::Child]).unwrap(), 1);
        let failed = bench.records[0].statistics.read().failed;
        assert_eq!(failed, 1, "it was called");
        let went_on = bench.log().iter().any(|(.., number)| *number == u64::MAX);
        assert!(!went_on);
    }
}

#[test]
fn rights_to_answer_that_are_dropped_in_turns_within_turns_are_told_apart() {
    for hands_over in [false, true] {
        let bench = Bench::new(hands_over);
        let drops = vec![Step::Drop, Step::Refuse];
        let inner = bench.ask(vec![Step::Drop, Step::Call(0, drops)]);
        // The one that was dropped first, too, is answered with how its handler ended.
        let text = inner.unwrap_err().to_string();
        assert!(text.contains("`t0` refused"), "{text}");
        assert!(text.contains("`t1` refused"), "{text}");
    }
}

#[test]
fn the_time_of_a_call_that_was_handed_over_runs_as_that_of_any_other() {
    let bench = Bench::new(true);
    let cx = bench.caller(100);
    let to = bench.tasks[0].clone();
    let ended = Rc::new(RefCell::new(None));
    let end = ended.clone();
    let call = async move {
        let steps = vec![Step::Call(0, vec![Step::CallBack])];
        let call = cx.call(&to, Do { number: 0, steps });
        let answer = call.deadline(Duration::from_millis(100)).await;
        *end.borrow_mut() = Some((cx.now(), answer));
    };
    let began = bench.clock.now();
    bench.processor.spawn(call, None);
    bench.run();
    let (at, answer) = ended.take().unwrap();
    assert_eq!(at.since(began), Duration::from_millis(100));
    assert!(answer.is_err_and(|error| matches!(error.fault, Fault::Deadline { .. })));
}

#[test]
fn what_a_task_does_not_take_in_the_turn_that_it_is_given_waits_in_its_queue() {
    let bench = Bench::new(true);
    let queue = TaskQueue::open(TaskRecord::with_room(4, bench.processor.handle.clone(), 50));
    let (own, polls) = (queue.clone(), Rc::new(RefCell::new(0)));
    let counted = polls.clone();
    let runner = poll_fn(move |_| {
        *counted.borrow_mut() += 1;
        if *counted.borrow() == 1 {
            assert!(own.poll_next(&mut None).is_pending());
        }
        Poll::Pending
    });
    queue.set_runner(bench.processor.spawn(runner, None));
    bench.settle();
    let (to, processor) = (queue.clone(), bench.processor.clone());
    let offers = async move {
        let message = Message::request(Tid::new(1, 1, 50), Tid::default(), 1, 7_u32);
        let offered = to.offer_call(&processor, message, &TaskMeter::default());
        assert!(matches!(offered, Offered::Taken));
    };
    bench.processor.spawn(offers, None);
    assert!(bench.processor.poll_ready(0));
    assert_eq!(*polls.borrow(), 2, "it had its turn");
    let message = queue.take().unwrap();
    assert_eq!(message.letter.take::<u32>().unwrap(), 7);
    assert!(queue.take().is_none());
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let leaf = prop_oneof![
        any::<usize>().prop_map(Step::Tell),
        Just(Step::Wait),
        any::<usize>().prop_map(|to| Step::Call(to, Vec::new())),
    ];
    let step = leaf.prop_recursive(4, 24, 4, |inner| {
        let steps = proptest::collection::vec(inner, 0..4);
        prop_oneof![
            (any::<usize>(), steps.clone()).prop_map(|(to, steps)| Step::Call(to, steps)),
            (any::<[usize; 2]>(), steps).prop_map(|(to, steps)| Step::Both(to, steps)),
        ]
    });
    proptest::collection::vec(step, 0..6)
}

proptest! {
    #[test]
    fn turns_within_turns_change_no_answer_lose_nothing_and_keep_every_order(
        programs in proptest::collection::vec((0..usize::from(TASKS), steps()), 1..5),
    ) {
        let mut seen = Vec::new();
        for hands_over in [false, true] {
            let bench = Bench::new(hands_over);
            let answers = bench.call_each(programs.clone());
            bench.settle();
            let log = bench.log();
            let mut pairs: std::collections::BTreeMap<_, Vec<u64>> = Default::default();
            for (to, from, number) in log {
                pairs.entry((to, from)).or_default().push(number);
            }
            for ((to, from), numbers) in &pairs {
                let in_order = numbers.windows(2).all(|pair| pair[0] < pair[1]);
                prop_assert!(in_order, "{from} to {to}: {numbers:?}");
            }
            for record in &bench.records {
                let counters = record.statistics.read();
                prop_assert_eq!(counters.began, None);
                prop_assert_eq!(counters.failed, 0);
                prop_assert_eq!(record.mailbox.depth().0, 0);
            }
            let counts: Vec<_> = pairs.iter().map(|(pair, all)| (*pair, all.len())).collect();
            seen.push((answers.take(), counts));
        }
        prop_assert!(seen[0].0.iter().all(|answer| matches!(answer, Some(Ok(_)))));
        prop_assert_eq!(&seen[0], &seen[1]);
    }
}

mod next;
