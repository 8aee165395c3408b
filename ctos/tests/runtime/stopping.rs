//! The first step of a stop: all tasks come to rest while every device answers. In virtual time.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Observer},
    config::{Node, load_texts},
    message::{Command, Message},
    registry::Registry,
    simulation::{self, Fault, FaultKind, Faults, Setup},
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase, StopReason},
    time::Instant,
};

ctos::command! {
    /// Counts.
    pub struct Count => u32, 1, "count"
}
ctos::command! {
    /// Never answers.
    pub struct Hang => (), 2, "hang"
}

type Trace = Arc<Mutex<Vec<String>>>;

/// Answers until it is stopped.
struct Device {
    count: u32,
    trace: Trace,
}

#[ctos::handler]
impl Device {
    #[command]
    fn count(&mut self, _: &Context, _: Count) -> u32 {
        self.count += 1;
        self.count
    }

    #[stop]
    async fn stops(&mut self, _: &Context, reason: &StopReason) -> Handled {
        let mut trace = self.trace.lock().unwrap();
        trace.push(format!("device stops: {reason}"));
        Ok(())
    }
}

/// What the worker does when it is to come to rest.
#[derive(Clone, Copy, PartialEq)]
enum Rests {
    WithTheDevice,
    Never,
    InItsHandler,
    WithAnError,
}

struct Worker {
    rests: Rests,
    trace: Trace,
}

impl EventHandler for Worker {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Count::CODE => message.open::<Count>()?.1.ok(7),
            Hang::CODE => std::future::pending().await,
            _ => cx.default_processing(message),
        }
    }

    async fn quiesce(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        self.trace.lock().unwrap().push(format!("worker: {reason}"));
        let (trace, own) = (self.trace.clone(), cx.clone());
        match self.rests {
            Rests::WithTheDevice => cx.quiet_after(|| "the lamp".to_owned(), async move {
                own.sleep(Duration::from_millis(300)).await;
                let device = own.task("device").await?;
                let count = own.call(&device, Count {}).await?;
                // It takes messages itself meanwhile.
                let me = own.task("worker").await?;
                let seven = own.call(&me, Count {}).await?;
                let mut trace = trace.lock().unwrap();
                trace.push(format!("lamp off {count} {seven}, {}", own.is_stopping()));
                Ok(())
            }),
            Rests::Never => cx.quiet_after(
                || "a part that never comes".to_owned(),
                std::future::pending(),
            ),
            Rests::InItsHandler => std::future::pending().await,
            Rests::WithAnError => return Err("the lamp is stuck".into()),
        }
        Ok(())
    }

    async fn stop(&mut self, _: &Context, _: &StopReason) -> Handled {
        self.trace.lock().unwrap().push("worker stops".to_owned());
        Ok(())
    }
}

/// What ends the app at its second second.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Ends {
    Interrupt,
    Result,
    Failure,
    Death,
}

struct Boss(Ends);

#[ctos::handler]
impl Boss {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        let (own, ends) = (cx.clone(), self.0);
        if phase == Phase::Run {
            cx.spawn(async move {
                assert!(!own.is_stopping());
                own.sleep(Duration::from_secs(2)).await;
                let text = "done".to_owned();
                match ends {
                    Ends::Result => own.finish(AppResult {
                        ok: true,
                        text,
                        json: String::new(),
                    }),
                    Ends::Failure => own.fail("out of paper"),
                    Ends::Interrupt | Ends::Death => {}
                }
            });
        }
        Ok(())
    }
}

const APP: &str = r#"
    [app]
    until = "boss"
    stop_timeout_s = 3.0
    [chassis.cage]
    stop_first = true
    [chassis.desk]
    [chassis.shed]
    [task.device]
    handler = "device"
    on = "cage"
    [task.worker]
    handler = "worker"
    on = "desk"
    [task.boss]
    handler = "boss"
    on = "shed"
"#;

struct Ran {
    end: End,
    trace: Vec<String>,
    /// Moment and what, of the stop.
    events: Vec<(Duration, String)>,
}

fn at(seconds: u64) -> Instant {
    Instant::START + Duration::from_secs(seconds)
}

fn run(rests: Rests, ends: Ends, again: Option<Duration>, seed: u64) -> Ran {
    let app = load_texts(&[("app.toml", APP)], &[format!("app.seed={seed}")], &[]).unwrap();
    let (trace, events) = (Trace::default(), Arc::<Mutex<Vec<_>>>::default());
    let mut registry = Registry::new();
    let of = trace.clone();
    registry.handler("device", &Device::COMMANDS, move |_| {
        Ok(Device {
            count: 0,
            trace: of.clone(),
        })
    });
    let of = trace.clone();
    registry.handler("worker", &[Count::INFO, Hang::INFO], move |_| {
        Ok(Worker {
            rests,
            trace: of.clone(),
        })
    });
    registry.handler("boss", &[], move |_| Ok(Boss(ends)));
    let mut setup = Setup {
        stop_again_after: again,
        ..Setup::default()
    };
    match ends {
        Ends::Interrupt => setup.stop_after = Some(Duration::from_secs(2)),
        Ends::Death => {
            let kill = Fault::on("shed", FaultKind::Kill, at(2));
            setup.faults = Faults::of_script("a death", vec![kill]);
        }
        _ => {}
    }
    let (clock, seen) = (setup.clock.clone(), events.clone());
    let observer: Observer = Arc::new(move |event: &BootEvent| {
        let said = match event {
            BootEvent::Stopping { .. } => "stopping".to_owned(),
            BootEvent::StopStep { step } => step.to_string(),
            BootEvent::QuietAwaited { tasks } => format!("waits for {}", tasks.join(" ")),
            BootEvent::NotQuiet { task, reason } => format!("{task}: {reason}"),
            BootEvent::Quiet { tasks, of, .. } => format!("quiet {tasks}/{of}"),
            BootEvent::Stopped { task, error } => format!("stopped {task} {error:?}"),
            BootEvent::AtRest { chassis } => format!("{chassis} is at rest"),
            _ => return,
        };
        let now = clock.now().since_start();
        seen.lock().unwrap().push((now, said));
    });
    let end = simulation::run(app, registry, setup, &observer)
        .unwrap()
        .outcome
        .end;
    let trace = trace.lock().unwrap().clone();
    let events = events.lock().unwrap().clone();
    Ran { end, trace, events }
}

impl Ran {
    fn said(&self) -> Vec<&str> {
        self.events.iter().map(|(_, said)| said.as_str()).collect()
    }

    fn when(&self, said: &str) -> Duration {
        let found = self.events.iter().find(|(_, one)| one == said);
        found
            .unwrap_or_else(|| panic!("no `{said}` in {:#?}", self.events))
            .0
    }
}

#[test]
fn every_step_is_said_in_order_and_a_task_comes_to_rest_while_devices_still_answer() {
    for seed in 0..10 {
        for ends in [Ends::Interrupt, Ends::Result, Ends::Failure, Ends::Death] {
            let ran = run(Rests::WithTheDevice, ends, None, seed);
            let reason = ran.end.clone();
            let (of, gone) = if ends == Ends::Death {
                (2, true)
            } else {
                (3, false)
            };
            let mut said = vec!["stopping", "quiesce"];
            let quiet = format!("quiet {of}/{of}");
            said.extend([
                quiet.as_str(),
                "tasks",
                "stopped device None",
                "cage is at rest",
            ]);
            if !gone {
                said.push("stopped boss None");
            }
            said.extend(["stopped worker None", "processes"]);
            assert_eq!(ran.said(), said, "{ends:?}, {reason:?}");
            let [told, off, device, worker] = ran.trace.as_slice() else {
                panic!("{:#?}", ran.trace);
            };
            assert!(told.starts_with("worker: "), "{told}");
            assert_eq!(off, "lamp off 1 7, true", "{ends:?}");
            assert!(device.starts_with("device stops: "), "{device}");
            assert_eq!(worker, "worker stops");
        }
    }
}

#[test]
fn a_task_that_does_not_come_to_rest_is_named_with_what_it_waits_for_and_the_stop_goes_on() {
    let ran = run(Rests::Never, Ends::Interrupt, None, 1);
    let late = "worker: not within 3.000 s: a part that never comes";
    let mut said = ran.said();
    said.truncate(6);
    assert_eq!(
        said,
        [
            "stopping",
            "quiesce",
            "waits for worker",
            late,
            "quiet 2/3",
            "tasks"
        ]
    );
    assert_eq!(
        ran.when("waits for worker") - ran.when("quiesce"),
        Duration::from_secs(1)
    );
    let took = ran.when(late) - ran.when("quiesce");
    assert!(took < Duration::from_millis(3100), "{took:?}");
    assert!(
        ran.trace.contains(&"worker stops".to_owned()),
        "{:#?}",
        ran.trace
    );
    assert_eq!(ran.end, End::Interrupted);
}

#[test]
fn a_handler_that_does_not_come_back_is_named_and_interrupted_by_its_stop() {
    let ran = run(Rests::InItsHandler, Ends::Result, None, 1);
    let said = ran.said().join("\n");
    assert!(
        said.contains(
            "worker: `worker` did not come to rest within 3.000 s: it has been at `quiesce`"
        ),
        "{said}"
    );
    assert!(said.contains("stopped worker None"), "{said}");
    assert_eq!(ran.trace.last().unwrap(), "worker stops");
}

#[test]
fn an_error_of_a_task_that_comes_to_rest_is_said() {
    let ran = run(Rests::WithAnError, Ends::Interrupt, None, 1);
    assert!(
        ran.said().contains(&"worker: the lamp is stuck"),
        "{:#?}",
        ran.events
    );
    assert!(ran.said().contains(&"quiet 2/3"), "{:#?}", ran.events);
}

#[test]
fn a_second_interrupt_ends_the_step_and_leaves_the_others_their_time() {
    let again = Duration::from_millis(2500);
    for rests in [Rests::Never, Rests::InItsHandler] {
        let ran = run(rests, Ends::Interrupt, Some(again), 1);
        assert_eq!(ran.when("worker: skipped at a second interrupt"), again);
        assert_eq!(ran.when("tasks"), again);
        assert!(
            ran.said().contains(&"stopped device None"),
            "{:#?}",
            ran.events
        );
        assert!(
            ran.said().contains(&"stopped worker None"),
            "{:#?}",
            ran.events
        );
    }
}

/// Starts so many tasks, and ends the app.
struct Parent;

#[ctos::handler]
impl Parent {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            for number in 0..2000 {
                let name = format!("child{number}");
                cx.start(&name, "child", Node::table()).await?;
            }
        }
        if phase == Phase::Run {
            let (ok, text, json) = (true, String::new(), String::new());
            cx.finish(AppResult { ok, text, json });
        }
        Ok(())
    }
}

struct Child;

#[ctos::handler]
impl Child {}

#[test]
fn thousands_of_started_tasks_are_stopped_without_a_question_to_the_names_for_each() {
    let app = r#"
        [app]
        until = "parent"
        stop_timeout_s = 0.02
        phase_timeout_s = 100
        [chassis.a]
        [task.parent]
        handler = "parent"
        on = "a"
    "#;
    let app = load_texts(&[("app.toml", app)], &[], &[]).unwrap();
    let mut registry = Registry::new();
    registry.handler("parent", &Parent::COMMANDS, |_| Ok(Parent));
    registry.handler("child", &Child::COMMANDS, |_| Ok(Child));
    let events = Trace::default();
    let seen = events.clone();
    let observer: Observer = Arc::new(move |event: &BootEvent| {
        if let BootEvent::Stopped { task, error } = event {
            seen.lock().unwrap().push(format!("{task} {error:?}"));
        }
    });
    let run = simulation::run(app, registry, Setup::default(), &observer).unwrap();
    assert!(
        matches!(run.outcome.end, End::Finished(_)),
        "{:?}",
        run.outcome
    );
    assert_eq!(*events.lock().unwrap(), ["parent None"]);
}
