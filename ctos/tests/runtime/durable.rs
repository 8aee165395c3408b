//! State that survives its process: what is answered when, and what the next handler knows. The store here is a value
//! in memory that takes a second, or refuses.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Fault, FaultKind, simulate},
    config::{App, load_texts},
    message::{Command, Replier},
    registry::Registry,
    system::AppResult,
    task::{Context, Durable, Handled, HandlerError, Handover, Phase, StateStore},
    time::Instant,
};
use futures_util::future::LocalBoxFuture;
use serde::{Deserialize, Serialize};

/// Adds to the sum, and answers it.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 0x0001)]
struct Add {
    number: u64,
    /// What goes wrong after that: `panic`, `refuse`, or, with the answer given before, `answer and panic`.
    then: String,
}

/// Adds, keeps the sum at once or not, and asks another task, for two seconds.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 0x0002)]
struct AddAndTell {
    number: u64,
    keep: bool,
}

/// Answers after a while, by a child.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 0x0003)]
struct Later {
    seconds: u64,
}

#[derive(Default)]
struct Sum(u64);

#[ctos::handler]
impl Sum {
    #[command]
    fn add(&mut self, request: Add, reply: Replier<Add>) -> Handled {
        self.0 += request.number;
        match request.then.as_str() {
            "refuse" => Err(format!("refused at {}", self.0).into()),
            "panic" => panic!("on purpose"),
            "answer and panic" => {
                reply.ok(self.0)?;
                panic!("on purpose");
            }
            _ => reply.ok(self.0),
        }
    }

    #[command]
    async fn add_and_tell(
        &mut self,
        cx: &Context,
        request: AddAndTell,
    ) -> Result<u64, HandlerError> {
        self.0 += request.number;
        if request.keep {
            cx.keep(&self.state()).await?;
        }
        let other = cx.task("other").await?;
        cx.call(&other, Later { seconds: 2 }).await?;
        Ok(self.0)
    }

    #[command]
    fn later(&mut self, cx: &Context, request: Later, reply: Replier<Later>) -> Handled {
        let (here, sum) = (cx.clone(), self.0);
        cx.spawn(async move {
            here.sleep(Duration::from_secs(request.seconds)).await;
            reply.ok(sum).unwrap();
        });
        Ok(())
    }
}

impl Handover for Sum {
    type State = u64;

    fn hand_over(&mut self) -> Result<u64, HandlerError> {
        Ok(self.0)
    }

    fn take_over(&mut self, _: &Context, sum: u64) -> Handled {
        self.0 = sum;
        Ok(())
    }
}

impl Durable for Sum {
    fn state(&self) -> u64 {
        self.0
    }
}

/// A store that takes a second; it refuses the commits with these numbers, from 1.
#[derive(Clone, Default)]
struct Slow {
    state: Arc<Mutex<Option<Vec<u8>>>>,
    refuses: Vec<u32>,
    commits: Arc<AtomicU32>,
}

impl StateStore for Slow {
    fn load(&self, _: &Context) -> Result<Option<Vec<u8>>, HandlerError> {
        Ok(self.state.lock().unwrap().clone())
    }

    fn store<'a>(&'a self, cx: &'a Context, state: &'a [u8]) -> LocalBoxFuture<'a, Handled> {
        Box::pin(async move {
            let number = self.commits.fetch_add(1, Ordering::Relaxed) + 1;
            cx.sleep(Duration::from_secs(1)).await;
            if self.refuses.contains(&number) {
                return Err("the disk is full".into());
            }
            *self.state.lock().unwrap() = Some(state.to_vec());
            Ok(())
        })
    }
}

type Scene = for<'a> fn(&'a Context, &'a Slow) -> LocalBoxFuture<'a, Result<String, HandlerError>>;

struct Driver(Scene, Slow);

#[ctos::handler]
impl Driver {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (scene, store, here) = (self.0, self.1.clone(), cx.clone());
            cx.spawn(async move {
                let said = scene(&here, &store).await;
                let text = said.unwrap_or_else(|error| error.to_string());
                let json = String::new();
                here.finish(AppResult {
                    ok: true,
                    text,
                    json,
                });
            });
        }
        Ok(())
    }
}

const APP: &str = r#"
    app.until = "driver"
    [chassis.desk]
    [chassis.cage]
    restart = "always"
    restart_backoff_s = 0.05
    processors = { main = {}, side = {} }
    [task.sum]
    handler = "sum"
    on = "cage"
    state = "durable"
    restart = "on-failure"
    [task.other]
    handler = "sum"
    on = "desk"
    [task.driver]
    handler = "driver"
    on = "desk"
"#;

fn app(text: &str) -> App {
    load_texts(&[("app.toml", text)], &[], &[]).unwrap()
}

fn run(store: Slow, faults: &[Fault], scene: Scene) -> String {
    let mut registry = Registry::new();
    registry.durable("sum", &Sum::COMMANDS, |_| Ok(Sum::default()));
    registry.states(store.clone());
    registry.handler("driver", &[], move |_| Ok(Driver(scene, store.clone())));
    let app = app(APP);
    assert!(registry.check(&app).is_empty());
    let outcome = simulate(app, registry, faults, &(Arc::new(|_: &BootEvent| ()) as _));
    match outcome.unwrap().end {
        End::Finished(result) => result.text,
        other => panic!("{other:?}"),
    }
}

/// Asks `sum` to add, and says what came of it and when, s.
async fn add(cx: &Context, number: u64, then: &str) -> String {
    let began = cx.now();
    let to = cx.wait_for_task("sum", Duration::from_secs(60)).await;
    let then = then.to_owned();
    let answer = cx.call(&to.unwrap(), Add { number, then }).await;
    let took = cx.now().since(began).as_secs_f64();
    match answer {
        Ok(sum) => format!("{sum} after {took:.0} s"),
        Err(error) => format!("{} after {took:.0} s", error.reason()),
    }
}

#[test]
fn an_answer_leaves_when_the_state_that_led_to_it_is_stored() {
    let said = run(Slow::default(), &[], |cx, store| {
        Box::pin(async move {
            let first = add(cx, 3, "").await;
            assert_eq!(*store.state.lock().unwrap(), Some(vec![3]));
            // What changes nothing is not stored.
            let same = add(cx, 0, "").await;
            let refused = add(cx, 4, "refuse").await;
            Ok(format!("{first}; {same}; {refused}"))
        })
    });
    assert_eq!(said, "3 after 1 s; 3 after 0 s; refused at 7 after 1 s");
}

#[test]
fn a_handler_that_panics_has_changed_nothing_and_answered_nothing() {
    for then in ["panic", "answer and panic"] {
        static THEN: Mutex<&str> = Mutex::new("");
        *THEN.lock().unwrap() = then;
        let said = run(Slow::default(), &[], |cx, _| {
            Box::pin(async move {
                let then = *THEN.lock().unwrap();
                add(cx, 3, "").await;
                let broke = add(cx, 4, then).await;
                Ok(format!("{broke}; {}", add(cx, 0, "").await))
            })
        });
        assert!(said.contains("panicked"), "{said}");
        assert!(said.ends_with("3 after 0 s"), "{said}");
    }
}

#[test]
fn a_state_that_cannot_be_stored_is_refused_and_the_task_goes_on_from_the_last_one() {
    let store = Slow {
        refuses: vec![3],
        ..Slow::default()
    };
    let said = run(store, &[], |cx, _| {
        Box::pin(async move {
            let first = add(cx, 3, "").await;
            let refused = add(cx, 4, "").await;
            Ok(format!("{first}; {refused}; {}", add(cx, 1, "").await))
        })
    });
    assert_eq!(
        said,
        "3 after 1 s; its state could not be stored: the disk is full after 1 s; 4 after 1 s"
    );
}

#[test]
fn what_a_handler_keeps_before_it_asks_others_survives_a_kill_in_the_midst_of_that() {
    // The first second is that of the state at the beginning. With `keep` the other task is asked when the next one is
    // stored, a second later.
    let kill = Fault::on("cage", FaultKind::Kill, Instant::from_nanos(2_500_000_000));
    let scene: [Scene; 2] = [
        |cx, _| Box::pin(tell_and_look(cx, false)),
        |cx, _| Box::pin(tell_and_look(cx, true)),
    ];
    let said = scene.map(|scene| run(Slow::default(), std::slice::from_ref(&kill), scene));
    assert_eq!(said, ["false 0 after 0 s", "false 5 after 0 s"]);
}

async fn tell_and_look(cx: &Context, keep: bool) -> Result<String, HandlerError> {
    let to = cx.task("sum").await?;
    let told = cx.call(&to, AddAndTell { number: 5, keep }).await;
    cx.sleep(Duration::from_secs(1)).await;
    Ok(format!("{} {}", told.is_ok(), add(cx, 0, "").await))
}

#[test]
fn what_a_child_answers_waits_for_no_handler() {
    let said = run(Slow::default(), &[], |cx, _| {
        Box::pin(async move {
            let to = cx.task("sum").await?;
            let later = cx.call(&to, Later { seconds: 1 });
            // The handler that is at work meanwhile has its state stored for a second more.
            let (later, sum) =
                futures_util::future::join(async { (later.await, cx.now()) }, async {
                    cx.sleep(Duration::from_millis(500)).await;
                    (add(cx, 2, "").await, cx.now())
                })
                .await;
            Ok(format!("{} {} {}", later.0?, sum.0, later.1 < sum.1))
        })
    });
    assert_eq!(said, "0 2 after 1 s true");
}

#[test]
fn a_durable_task_moves_within_its_chassis_and_not_away_from_its_store() {
    let said = run(Slow::default(), &[], |cx, _| {
        Box::pin(async move {
            add(cx, 3, "").await;
            let away = cx.move_task("sum", "desk").await.unwrap_err().reason();
            let within = cx.move_task("sum", "cage:side").await?;
            Ok(format!("{away}; {within}; {}", add(cx, 1, "").await))
        })
    });
    assert_eq!(
        said,
        "`sum` stays where it is: its state is stored by its chassis: change `on` and boot the app again; cage:side; 4 after 1 s"
    );
}

#[test]
fn a_task_without_a_state_to_store_and_a_program_without_a_store_are_refused_with_what_to_do() {
    let mut registry = Registry::new();
    registry.handover("sum", &Sum::COMMANDS, |_| Ok(Sum::default()));
    registry.handler("driver", &[], |_| {
        Ok(Driver(|_, _| unreachable!(), Slow::default()))
    });
    let findings = registry.check(&app(APP)).to_string();
    let told = "app.toml:11:5: error: the state of task `sum` cannot be durable: its handler `sum` has none that can be stored";
    assert!(findings.contains(told), "{findings}");
    assert!(findings.contains("`Registry::durable`"), "{findings}");
    registry.durable("sum", &Sum::COMMANDS, |_| Ok(Sum::default()));
    let findings = registry.check(&app(APP)).to_string();
    let told = "this program has no place for the state of task `sum`";
    assert!(findings.contains(told), "{findings}");
    assert!(findings.contains("keep_states"), "{findings}");
}
