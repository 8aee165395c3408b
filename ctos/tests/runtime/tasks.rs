//! Tasks and their supervision in virtual time: handlers made of methods, restarts, shutdown, and state
//! that is handed over. Also monitors, children, and waiting that can never end.

use std::{
    future::Future,
    pin::Pin,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Observer, Outcome, simulate},
    call::Fault,
    config::{Node, load_texts},
    message::{Command, Message, Replier},
    registry::Registry,
    sync::{CyclicHandle, Tick},
    system::{AppResult, Ping, Shutdown},
    task::{
        Context, EventHandler, Handled, HandlerError, Handover, NameError, Phase, StopReason,
        TaskRef,
    },
};
use futures_util::future::join;
use serde::{Deserialize, Serialize};

/// Adds to the sum,
/// and answers with it.
///
/// This is not in its help.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 1)]
struct AddUp {
    number: u64,
}

/// Breaks the handler in one of several ways.
#[derive(Serialize, Deserialize, Command)]
#[command(code = 2, name = "break")]
struct Break {
    how: How,
}

#[derive(Serialize, Deserialize, PartialEq)]
enum How {
    Panic,
    Child,
    Synchronous,
    /// A child panics while the handler waits.
    ChildMeanwhile,
}

/// Is answered at the next `add_up`.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 3)]
struct Later {}

/// Refuses.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 4)]
struct Refuse {}

/// Monitors a task.
#[derive(Serialize, Deserialize, Command)]
#[command(code = 5)]
struct Watch {
    task: String,
}

/// Starts a task.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = String, code = 6)]
struct StartOne {
    name: String,
    handler: String,
}

/// Waits for a name.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = Result<(), String>, code = 7)]
struct WaitFor {
    name: String,
    limit_ms: u64,
}

/// Asks the task at the head of the list to ask the rest, with this deadline.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = Result<(), String>, code = 8)]
struct AskAlong {
    list: Vec<String>,
    deadline_ms: u64,
}

type Trace = Arc<Mutex<Vec<String>>>;

struct Actor {
    name: String,
    trace: Trace,
    sum: u64,
    later: Vec<Replier<Later>>,
    cyclic: Option<CyclicHandle>,
}

#[ctos::handler]
impl Actor {
    fn saw(&self, what: impl std::fmt::Display) {
        self.trace
            .lock()
            .unwrap()
            .push(format!("{} {what}", self.name));
    }

    #[command]
    fn add_up(&mut self, AddUp { number }: AddUp) -> u64 {
        self.sum += number;
        for reply in self.later.drain(..) {
            reply.ok(self.sum).unwrap();
        }
        self.sum
    }

    #[command]
    async fn breaks(&mut self, cx: &Context, Break { how }: Break) -> Result<(), HandlerError> {
        match how {
            How::Panic => panic!("a fuse blew"),
            How::Child => cx.spawn(async { panic!("a wire broke") }),
            How::Synchronous => {
                let function = |_: &Tick| panic!("a joint broke");
                self.cyclic = Some(cx.cyclic(Duration::from_millis(1), function));
            }
            How::ChildMeanwhile => {
                let here = cx.clone();
                cx.spawn(async move {
                    here.sleep(Duration::from_millis(1)).await;
                    panic!("a wire broke");
                });
                std::future::pending::<()>().await;
            }
        }
        Ok(())
    }

    #[command]
    fn answers_later(&mut self, _: Later, reply: Replier<Later>) -> Handled {
        self.later.push(reply);
        Ok(())
    }

    #[command]
    fn refuses(&self, _: Refuse) -> Result<u64, HandlerError> {
        Err("the arm is cold".into())
    }

    #[command]
    async fn watches(&mut self, cx: &Context, Watch { task }: Watch) -> Result<(), HandlerError> {
        let task = cx.task(&task).await?;
        cx.monitor(&task).await?;
        Ok(())
    }

    #[command]
    async fn starts(&mut self, cx: &Context, one: StartOne) -> Result<String, HandlerError> {
        let started = cx.start(&one.name, &one.handler, Node::table()).await?;
        Ok(started.name().to_owned())
    }

    #[command]
    async fn waits(
        &mut self,
        cx: &Context,
        wait: WaitFor,
    ) -> Result<Result<(), String>, HandlerError> {
        let limit = Duration::from_millis(wait.limit_ms);
        let found = cx.wait_for_task(&wait.name, limit).await;
        Ok(found
            .map(|_| ())
            .map_err(|error: NameError| error.to_string()))
    }

    #[phase]
    async fn enters(&mut self, _: &Context, phase: Phase) -> Handled {
        self.saw(format_args!("enters {phase}"));
        Ok(())
    }

    #[stop]
    async fn stops(&mut self, _: &Context, reason: &StopReason) -> Handled {
        self.saw(format_args!("stops: {reason}"));
        Ok(())
    }

    #[task_down]
    async fn misses(&mut self, _: &Context, task: &str, reason: &str) -> Handled {
        self.saw(format_args!("misses {task}: {reason}"));
        Ok(())
    }

    #[task_up]
    async fn finds(&mut self, _: &Context, task: &TaskRef) -> Handled {
        self.saw(format_args!("finds {}", task.name()));
        Ok(())
    }
}

impl Drop for Actor {
    fn drop(&mut self) {
        self.saw("is gone");
    }
}

impl Handover for Actor {
    type State = u64;

    fn hand_over(&mut self) -> Result<u64, HandlerError> {
        Ok(self.sum)
    }

    fn take_over(&mut self, _: &Context, sum: u64) -> Handled {
        self.sum = sum;
        Ok(())
    }
}

/// Keeps its sum also over a panic.
struct Tough(Actor);

impl EventHandler for Tough {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        self.0.handle(cx, message).await
    }
}

impl Handover for Tough {
    type State = u64;

    const AFTER_PANIC: bool = true;

    fn hand_over(&mut self) -> Result<u64, HandlerError> {
        self.0.hand_over()
    }

    fn take_over(&mut self, cx: &Context, sum: u64) -> Handled {
        self.0.take_over(cx, sum)
    }
}

/// Passes a request along a list of tasks, each of which waits for the next.
async fn ask_along(cx: Context, mut ask: AskAlong) -> Result<Result<(), String>, HandlerError> {
    if ask.list.is_empty() {
        return Ok(Ok(()));
    }
    let next = cx.task(&ask.list.remove(0)).await?;
    let deadline = Duration::from_millis(ask.deadline_ms);
    let answer = cx.call(&next, ask).deadline(deadline).await;
    Ok(answer.unwrap_or_else(|error| Err(error.to_string())))
}

type Scene =
    Arc<dyn Fn(Context) -> Pin<Box<dyn Future<Output = Result<(), HandlerError>>>> + Send + Sync>;

struct Driver(Scene);

impl EventHandler for Driver {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (scene, here) = (self.0.clone(), cx.clone());
            cx.spawn(async move {
                let said = scene(here.clone()).await;
                here.finish(AppResult {
                    ok: said.is_ok(),
                    text: said
                        .err()
                        .map(|error| error.to_string())
                        .unwrap_or_default(),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

fn actor(cx: &Context, trace: &Trace) -> Actor {
    let name = cx.name().to_owned();
    let actor = Actor {
        name,
        trace: trace.clone(),
        sum: 0,
        later: Vec::new(),
        cyclic: None,
    };
    actor.saw("is built");
    actor
}

fn run<F, Fut>(sets: &[&str], scene: F) -> (Outcome, Vec<String>)
where
    F: Fn(Context) -> Fut + Send + Sync + 'static,
    Fut: Future<Output = Result<(), HandlerError>> + 'static,
{
    const APP: &str = r#"
        [app]
        until = "driver"
        [chassis.a]
        [chassis.b]
        [task.driver]
        handler = "driver"
        on = "a"
        [task.arm]
        handler = "actor"
        on = "b"
        [task.hand]
        handler = "actor"
        on = "a"
        [task.along1]
        handler = "along"
        on = "a"
        [task.along2]
        handler = "along"
        on = "b"
        [task.along3]
        handler = "along"
        on = "b"
    "#;
    let trace = Trace::default();
    let mut registry = Registry::new();
    let scene: Scene = Arc::new(move |cx| Box::pin(scene(cx)));
    registry.handler("driver", &[], move |_| Ok(Driver(scene.clone())));
    let seen = trace.clone();
    registry.handler("actor", &Actor::COMMANDS, move |cx| Ok(actor(cx, &seen)));
    let seen = trace.clone();
    registry.handover("keeper", &Actor::COMMANDS, move |cx| Ok(actor(cx, &seen)));
    let seen = trace.clone();
    registry.handover("tough", &Actor::COMMANDS, move |cx| {
        Ok(Tough(actor(cx, &seen)))
    });
    registry.function("along", ask_along);
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let app = load_texts(&[("tasks.toml", APP)], &sets, &[]).unwrap();
    let observer: Observer = Arc::new(|_: &BootEvent| ());
    let outcome = simulate(app, registry, &[], &observer).unwrap();
    let trace = trace.lock().unwrap().clone();
    (outcome, trace)
}

/// Runs a scene that must come to its end.
#[track_caller]
fn play<F, Fut>(sets: &[&str], scene: F) -> Vec<String>
where
    F: Fn(Context) -> Fut + Send + Sync + 'static,
    Fut: Future<Output = Result<(), HandlerError>> + 'static,
{
    let (outcome, trace) = run(sets, scene);
    match &outcome.end {
        End::Finished(result) if result.ok => trace,
        end => panic!("{end:?}: {trace:#?}"),
    }
}

fn of<'t>(trace: &'t [String], task: &str) -> Vec<&'t str> {
    let lines = trace.iter();
    lines
        .filter_map(|line| line.strip_prefix(task)?.strip_prefix(' '))
        .collect()
}

async fn add(cx: &Context, task: &TaskRef, number: u64) -> Result<u64, HandlerError> {
    Ok(cx.call(task, AddUp { number }).await?)
}

/// Lets a restart that is about to happen happen: a call waits in the queue until then.
async fn settled(cx: &Context, task: &TaskRef) -> Result<(), HandlerError> {
    cx.sleep(Duration::from_secs(2)).await;
    Ok(cx.call(task, Ping {}).await?)
}

#[test]
fn a_handler_made_of_methods_answers_in_all_the_ways_there_are() {
    assert_eq!(AddUp::INFO.name, "add_up");
    assert_eq!(AddUp::INFO.doc, "Adds to the sum, and answers with it.");
    assert_eq!(Break::INFO.name, "break");
    play(&[], |cx| async move {
        let arm = cx.task("arm").await?;
        assert_eq!(add(&cx, &arm, 2).await?, 2);
        let later = cx.call(&arm, Later {});
        let (later, sum) = join(
            later.into_future(),
            cx.call(&arm, AddUp { number: 3 }).into_future(),
        )
        .await;
        assert_eq!((later?, sum?), (5, 5));
        let refused = cx.call(&arm, Refuse {}).await.unwrap_err();
        assert_eq!(refused.reason(), "the arm is cold");
        let unknown = cx
            .call(
                &arm,
                AskAlong {
                    list: Vec::new(),
                    deadline_ms: 1,
                },
            )
            .await
            .unwrap_err();
        assert!(
            matches!(unknown.fault, Fault::UnknownCommand { .. }),
            "{unknown}"
        );
        Ok(())
    });
}

/// A child of the driver that counts, up to 1000, how often the driver's processor came to it.
fn counting(cx: &Context) -> std::rc::Rc<std::cell::Cell<u32>> {
    let count = std::rc::Rc::new(std::cell::Cell::new(0));
    let counted = count.clone();
    cx.spawn(async move {
        for count in 1..=1000 {
            counted.set(count);
            let mut polled = false;
            std::future::poll_fn(|poll| {
                poll.waker().wake_by_ref();
                if std::mem::replace(&mut polled, true) {
                    std::task::Poll::Ready(())
                } else {
                    std::task::Poll::Pending
                }
            })
            .await;
        }
    });
    count
}

#[test]
fn a_call_is_handled_at_once_where_its_receiver_waits_on_the_same_processor() {
    play(&[], |cx| async move {
        let hand = cx.task("hand").await?;
        let count = counting(&cx);
        let sum = add(&cx, &hand, 2).await?;
        assert_eq!((sum, count.get()), (2, 0), "something else came between");
        Ok(())
    });
}

#[test]
fn a_task_that_calls_without_end_leaves_its_processor_to_others() {
    play(&[], |cx| async move {
        let hand = cx.task("hand").await?;
        let count = counting(&cx);
        for _ in 0..1000 {
            add(&cx, &hand, 1).await?;
        }
        assert!(count.get() >= 20, "{}", count.get());
        Ok(())
    });
}

#[test]
fn a_failed_part_of_a_handler_follows_the_restart_policy() {
    for how in ["Panic", "Child", "Synchronous", "ChildMeanwhile"] {
        let scene = move |cx: Context| async move {
            let arm = cx.task("arm").await?;
            add(&cx, &arm, 2).await?;
            let how = match how {
                "Panic" => How::Panic,
                "Child" => How::Child,
                "Synchronous" => How::Synchronous,
                _ => How::ChildMeanwhile,
            };
            let dies = matches!(how, How::Panic | How::ChildMeanwhile);
            let answer = cx.call(&arm, Break { how }).await;
            match answer {
                Err(error) => assert!(
                    dies && matches!(error.fault, Fault::Panicked { .. }),
                    "{error}"
                ),
                Ok(()) => assert!(!dies),
            }
            settled(&cx, &arm).await?;
            // A handler without a state to hand over begins afresh.
            assert_eq!(add(&cx, &arm, 3).await?, 3);
            Ok(())
        };
        let trace = play(&["task.arm.restart=\"on-failure\""], scene);
        let expected = [
            "is built",
            "enters create",
            "enters connect",
            "enters run",
            "is gone",
            "is built",
            "enters create",
            "enters connect",
            "enters run",
            "stops: the app has finished",
            "is gone",
        ];
        assert_eq!(of(&trace, "arm"), expected, "{how}");
        let (outcome, _) = run(&[], scene);
        assert!(
            matches!(&outcome.end, End::TaskFailed { task, .. } if task == "arm"),
            "{how}: {:?}",
            outcome.end
        );
    }
}

#[test]
fn a_crash_loop_backs_off_and_then_escalates_with_its_reason() {
    let sets = ["task.arm.restart=\"on-failure\"", "task.arm.max_restarts=4"];
    let (outcome, trace) = run(&sets, |cx| async move {
        let arm = cx.task("arm").await?;
        loop {
            let began = cx.now();
            let _ = cx.call(&arm, Break { how: How::Panic }).await;
            // Answered by the next incarnation only.
            let _ = cx.call(&arm, Ping {}).await;
            if cx.now().since(began) > Duration::from_secs(9) {
                return Err("nobody answers".into());
            }
        }
    });
    let failed = End::TaskFailed {
        task: "arm".to_owned(),
        reason: "its handler panicked: a fuse blew (after 4 restarts)".to_owned(),
    };
    assert_eq!(outcome.end, failed);
    let built = of(&trace, "arm")
        .iter()
        .filter(|line| **line == "is built")
        .count();
    assert_eq!(built, 5);
    // 0.1, 0.2, 0.4 and 0.8 s, each less up to a fifth.
    assert!(
        outcome.took > Duration::from_millis(1_125) && outcome.took < Duration::from_millis(1_600)
    );
}

#[test]
fn messages_that_wait_during_a_restart_are_kept_in_order() {
    play(&["task.arm.restart=\"always\""], |cx| async move {
        let arm = cx.task("arm").await?;
        let broken = cx.call(&arm, Break { how: How::Panic }).into_future();
        let sums = futures_util::future::join_all(
            (1..20).map(|number| cx.call(&arm, AddUp { number }).into_future()),
        );
        let (broken, sums) = join(broken, sums).await;
        assert!(matches!(broken.unwrap_err().fault, Fault::Panicked { .. }));
        let mut expected = 0;
        for (number, sum) in (1..20).zip(sums) {
            expected += number;
            assert_eq!(sum?, expected);
        }
        Ok(())
    });
}

#[test]
fn calls_that_the_old_incarnation_had_not_answered_end_at_once() {
    play(
        &[
            "task.arm.restart=\"always\"",
            "task.arm.restart_backoff_s=5",
        ],
        |cx| async move {
            let arm = cx.task("arm").await?;
            let began = cx.now();
            let later = cx.call(&arm, Later {}).into_future();
            let (later, _) = join(
                later,
                cx.call(&arm, Break { how: How::Panic }).into_future(),
            )
            .await;
            assert_eq!(later.unwrap_err().fault, Fault::NoReply);
            assert!(cx.now().since(began) < Duration::from_secs(1));
            Ok(())
        },
    );
}

#[test]
fn a_task_that_is_shut_down_frees_its_name_and_the_app_goes_on() {
    let trace = play(&[], |cx| async move {
        let arm = cx.task("arm").await?;
        cx.call(&arm, Shutdown {}).await?;
        let error = cx.call(&arm, Ping {}).await.unwrap_err();
        assert!(error.is_gone(), "{error}");
        // Also those who knew the name are told that it is free.
        cx.sleep(Duration::from_millis(10)).await;
        assert!(matches!(
            cx.task("arm").await,
            Err(NameError::Unknown { .. })
        ));
        Ok(())
    });
    let arm = of(&trace, "arm");
    assert_eq!(
        arm[arm.len() - 2..],
        ["stops: the task was told to shut down", "is gone"]
    );
}

#[test]
fn always_means_also_after_a_shutdown_and_the_state_is_handed_over() {
    for (restart, again) in [("always", true), ("on-failure", false)] {
        let sets = [
            "task.arm.handler=\"keeper\"",
            &format!("task.arm.restart=\"{restart}\""),
        ];
        play(&sets, move |cx| async move {
            let arm = cx.task("arm").await?;
            add(&cx, &arm, 40).await?;
            cx.call(&arm, Shutdown {}).await?;
            match add(&cx, &arm, 2).await {
                Ok(sum) => assert!(again && sum == 42, "{sum}"),
                Err(error) => assert!(!again, "{error}"),
            }
            Ok(())
        });
    }
}

#[test]
fn a_state_outlives_a_panic_only_where_the_handler_says_that_it_is_good() {
    for (handler, sum) in [("actor", 2), ("keeper", 2), ("tough", 42)] {
        let sets = [
            &format!("task.arm.handler=\"{handler}\""),
            "task.arm.restart=\"on-failure\"",
        ];
        play(&sets.map(|set| set as &str), move |cx| async move {
            let arm = cx.task("arm").await?;
            add(&cx, &arm, 40).await?;
            let _ = cx.call(&arm, Break { how: How::Panic }).await;
            assert_eq!(add(&cx, &arm, 2).await?, sum);
            Ok(())
        });
    }
}

#[test]
fn every_task_but_the_one_that_ends_the_app_can_be_shut_down_and_the_runtime_has_no_names() {
    play(&[], |cx| async move {
        for name in ["arm", "hand"] {
            cx.call(&cx.task(name).await?, Shutdown {}).await?;
        }
        // The names service itself is not among the names.
        assert!(cx.task("tidsvr").await.is_err());
        Ok(())
    });
}

#[test]
fn who_monitors_a_task_is_told_when_it_goes_and_comes() {
    let trace = play(&["task.arm.restart=\"on-failure\""], |cx| async move {
        let (arm, hand) = (cx.task("arm").await?, cx.task("hand").await?);
        let task = "arm".to_owned();
        cx.call(&hand, Watch { task }).await?;
        let _ = cx.call(&arm, Break { how: How::Panic }).await;
        settled(&cx, &arm).await?;
        cx.call(&arm, Shutdown {}).await?;
        settled(&cx, &hand).await
    });
    let hand = of(&trace, "hand");
    let seen: Vec<&&str> = hand
        .iter()
        .filter(|line| line.starts_with("misses") || line.starts_with("finds"))
        .collect();
    assert_eq!(
        seen,
        [
            &"misses arm: its handler panicked: a fuse blew",
            &"finds arm",
            &"misses arm: it was told to shut down",
        ]
    );
}

#[test]
fn a_task_that_another_one_starts_is_a_task_and_ends_with_it() {
    let trace = play(&[], |cx| async move {
        let arm = cx.task("arm").await?;
        let start = |name: &str| StartOne {
            name: name.to_owned(),
            handler: "actor".to_owned(),
        };
        assert_eq!(cx.call(&arm, start("finger")).await?, "arm.finger");
        let finger = cx.task("arm.finger").await?;
        assert_eq!(add(&cx, &finger, 7).await?, 7);
        let twice = cx.call(&arm, start("finger")).await.unwrap_err().reason();
        assert!(
            twice.contains("the name `arm.finger` belongs to task 2.1.")
                && twice.contains("on chassis `b` already, so task 2.1."),
            "{twice}"
        );
        assert_eq!(add(&cx, &finger, 1).await?, 8);
        let mut wrong = start("thumb");
        wrong.handler = "acter".to_owned();
        let unknown = cx.call(&arm, wrong).await.unwrap_err().reason();
        assert_eq!(
            unknown,
            "`arm.thumb` cannot be started: nobody registered the event handler `acter`"
        );
        cx.call(&arm, Shutdown {}).await?;
        assert!(cx.call(&finger, Ping {}).await.unwrap_err().is_gone());
        Ok(())
    });
    let finger = of(&trace, "arm.finger");
    let expected = [
        "is built",
        "enters create",
        "enters connect",
        "enters run",
        // The second one, which could not have the name.
        "is built",
        "stops: the task was told to shut down",
        "is gone",
        "stops: the task was told to shut down",
        "is gone",
    ];
    assert_eq!(finger, expected);
}

#[test]
fn a_child_that_fails_fails_into_its_parent_and_a_name_that_comes_back_is_reached_by_who_held_it() {
    let trace = play(&["task.arm.restart=\"on-failure\""], |cx| async move {
        let arm = cx.task("arm").await?;
        let start = || StartOne {
            name: "finger".to_owned(),
            handler: "actor".to_owned(),
        };
        cx.call(&arm, start()).await?;
        let finger = cx.task("arm.finger").await?;
        let _ = cx.call(&finger, Break { how: How::Panic }).await;
        settled(&cx, &arm).await?;
        cx.call(&arm, start()).await?;
        cx.sleep(Duration::from_millis(10)).await;
        assert_eq!(add(&cx, &finger, 1).await?, 1);
        let now = cx.task("arm.finger").await?;
        assert_ne!(now.tid(), finger.tid());
        Ok(())
    });
    let built = of(&trace, "arm")
        .iter()
        .filter(|line| **line == "is built")
        .count();
    assert_eq!(built, 2, "{trace:#?}");
}

#[test]
fn whoever_waits_for_a_name_gets_it_when_it_appears() {
    play(&[], |cx| async move {
        let (arm, hand) = (cx.task("arm").await?, cx.task("hand").await?);
        let wait = WaitFor {
            name: "arm.finger".to_owned(),
            limit_ms: 5_000,
        };
        let start = async {
            cx.sleep(Duration::from_millis(700)).await;
            let name = "finger".to_owned();
            let handler = "actor".to_owned();
            cx.call(&arm, StartOne { name, handler }).await
        };
        let (found, started) = join(cx.call(&hand, wait).into_future(), start).await;
        assert_eq!((found?, started?), (Ok(()), "arm.finger".to_owned()));
        Ok(())
    });
}

#[test]
fn a_wait_for_a_name_that_takes_too_long_says_who_waits_for_whom() {
    play(&[], |cx| async move {
        let (arm, hand) = (cx.task("arm").await?, cx.task("hand").await?);
        let wait = |name: &str, limit_ms| WaitFor {
            name: name.to_owned(),
            limit_ms,
        };
        let other = cx.call(&arm, wait("nobody", 900)).into_future();
        let (late, never) =
            join(cx.call(&hand, wait("arm.finger", 500)).into_future(), other).await;
        assert_eq!(
            late?.unwrap_err(),
            "`hand` waited 0.500 s for a task called `arm.finger`: `arm`, which would start it, has not; `arm` waits for `nobody`"
        );
        assert_eq!(
            never?.unwrap_err(),
            "`arm` waited 0.900 s for a task called `nobody`: nobody ever had this name"
        );
        Ok(())
    });
}

#[test]
fn waits_for_names_that_close_to_a_circle_are_refused_at_once() {
    play(&[], |cx| async move {
        let (arm, hand) = (cx.task("arm").await?, cx.task("hand").await?);
        let wait = |name: &str| WaitFor {
            name: name.to_owned(),
            limit_ms: 5_000,
        };
        let began = cx.now();
        let second = async {
            cx.sleep(Duration::from_millis(100)).await;
            let answer = cx.call(&arm, wait("hand.thumb")).await;
            (answer, cx.now().since(began))
        };
        let (_, (circle, took)) =
            join(cx.call(&hand, wait("arm.finger")).into_future(), second).await;
        assert!(took < Duration::from_millis(200), "{took:?}");
        assert_eq!(
            circle?.unwrap_err(),
            "nobody can go on: `arm` waits for `hand.thumb`, which `hand` would start, but `hand` waits for `arm.finger`, which `arm` would start"
        );
        Ok(())
    });
}

#[test]
fn calls_that_wait_for_each_other_end_with_the_circle_in_words() {
    play(&[], |cx| async move {
        let first = cx.task("along1").await?;
        let circle = ["along2", "along3", "along1"].map(str::to_owned).to_vec();
        let ask = AskAlong {
            list: circle,
            deadline_ms: 3_000,
        };
        let answer = cx.call(&first, ask).await?;
        let said = answer.unwrap_err();
        assert!(
            said.contains(
                "because tasks wait for one another: `along1` -> `along2` -> `along3` -> `along1`"
            ) || said.contains(
                "because tasks wait for one another: `along3` -> `along1` -> `along2` -> `along3`"
            ) || said.contains(
                "because tasks wait for one another: `along2` -> `along3` -> `along1` -> `along2`"
            ),
            "{said}"
        );
        // A chain that only takes long is not a circle.
        let ask = AskAlong {
            list: vec!["along2".to_owned(), "arm".to_owned()],
            deadline_ms: 1_500,
        };
        let arm = cx.task("arm").await?;
        let busy = cx.call(
            &arm,
            WaitFor {
                name: "nobody".to_owned(),
                limit_ms: 4_000,
            },
        );
        let (chain, _) = join(cx.call(&first, ask).into_future(), busy.into_future()).await;
        let said = chain?.unwrap_err();
        assert!(
            said.contains("within 1.500 s") && !said.contains("one another"),
            "{said}"
        );
        Ok(())
    });
}
