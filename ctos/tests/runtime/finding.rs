//! Tasks that are looked for by name while their chassis is being restarted, in virtual time.

use std::{sync::Arc, time::Duration};

use ctos::{
    boot::{BootEvent, End, Fault, FaultKind, Observer, simulate},
    config::load_texts,
    registry::Registry,
    system::{AppResult, Shutdown},
    task::{Context, Handled, HandlerError, NameError, Phase},
    time::Instant,
};
use serde::{Deserialize, Serialize};

/// Counts, and tells whether it runs.
#[derive(Serialize, Deserialize, ctos::Command)]
#[command(reply = bool, code = 0x0001)]
struct Runs {}

/// Fails for good.
#[derive(Serialize, Deserialize, ctos::Command)]
#[command(reply = (), code = 0x0002)]
struct Break {}

#[derive(Default)]
struct Counter {
    runs: bool,
}

#[ctos::handler]
impl Counter {
    #[command]
    fn runs(&mut self, _: Runs) -> bool {
        self.runs
    }

    #[command]
    fn breaks(&mut self, cx: &Context, _: Break) {
        cx.fail("as it was told");
    }

    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        cx.sleep(Duration::from_millis(30)).await;
        if phase == Phase::Connect {
            // Those that pass the phases together find each other.
            let other = if cx.name() == "counter" {
                "twin"
            } else {
                "counter"
            };
            cx.task(other).await?;
        }
        self.runs = phase == Phase::Run;
        Ok(())
    }
}

type Play =
    fn(Context) -> futures_util::future::LocalBoxFuture<'static, Result<String, HandlerError>>;

struct Person(Play);

#[ctos::handler]
impl Person {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, play) = (cx.clone(), self.0);
            cx.spawn(async move {
                let said = play(own.clone()).await;
                let ok = said.is_ok();
                let text = said.unwrap_or_else(|error| error.to_string());
                own.finish(AppResult {
                    ok,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

const APP: &str = r#"
    [app]
    until = "person"
    [chassis.desk]
    [chassis.cage]
    restart_backoff_s = 0.5
    [task.counter]
    handler = "counter"
    on = "cage"
    [task.twin]
    handler = "counter"
    on = "cage"
    [task.person]
    handler = "person"
    on = "desk"
"#;

fn run(play: Play, sets: &[&str], seed: u64, faults: &[Fault]) -> (End, Vec<String>) {
    let mut sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    sets.push(format!("app.seed={seed}"));
    let app = load_texts(&[("app.toml", APP)], &sets, &[]).unwrap();
    let mut registry = Registry::new();
    registry.handler("counter", &Counter::COMMANDS, |_| Ok(Counter::default()));
    registry.handler("person", &Person::COMMANDS, move |_| Ok(Person(play)));
    let events = Arc::<std::sync::Mutex<Vec<String>>>::default();
    let seen = events.clone();
    let observer: Observer = Arc::new(move |event: &BootEvent| {
        seen.lock().unwrap().push(format!("{event:?}"));
    });
    let end = simulate(app, registry, faults, &observer).unwrap().end;
    let events = events.lock().unwrap().clone();
    (end, events)
}

fn text(play: Play, sets: &[&str], seed: u64, faults: &[Fault]) -> String {
    match run(play, sets, seed, faults) {
        (End::Finished(result), _) if result.ok => result.text,
        (end, events) => panic!("{end:?}: {events:#?}"),
    }
}

fn kill(chassis: &str, millis: u64) -> Fault {
    let chassis = chassis.to_owned();
    let at = Instant::START + Duration::from_millis(millis);
    Fault::on(chassis, FaultKind::Kill, at)
}

/// Looks the counter up again and again, for three seconds, and asks it whether it runs. A call may be lost in
/// the death; no lookup may.
fn asks_on(
    cx: Context,
) -> futures_util::future::LocalBoxFuture<'static, Result<String, HandlerError>> {
    Box::pin(async move {
        let (mut lost, mut asked) = (0, 0);
        while cx.now() < Instant::START + Duration::from_secs(3) {
            let counter = cx.task("counter").await?;
            match cx.call(&counter, Runs {}).await {
                Ok(true) => asked += 1,
                Ok(false) => return Err("it was found before it had passed its phases".into()),
                Err(error) if error.may_come_back() => lost += 1,
                Err(error) => return Err(error.into()),
            }
            cx.sleep(Duration::from_millis(7)).await;
        }
        assert!(asked > 100, "{asked}");
        Ok(format!("lost {lost}"))
    })
}

#[test]
fn no_lookup_fails_whenever_the_chassis_dies_and_none_finds_a_task_before_it_runs() {
    let restarts = [
        "chassis.cage.restart=\"on-failure\"",
        "chassis.cage.max_restarts=9",
    ];
    let mut lost = 0;
    for seed in 0..12 {
        for step in 0..10 {
            // Once, and once more while it rises.
            let first = 150 + 7 * step + seed;
            let again = first + 60 * (step + 1);
            let said = text(
                asks_on,
                &restarts,
                seed,
                &[kill("cage", first), kill("cage", again)],
            );
            let losses: u32 = said.strip_prefix("lost ").unwrap().parse().unwrap();
            assert!(losses <= 2, "{said}");
            lost += losses;
        }
    }
    assert!(lost > 0, "the deaths hit nobody");
}

#[test]
fn no_lookup_fails_while_a_chassis_is_stopped_in_order_because_a_task_failed() {
    let restarts = [
        "chassis.cage.restart=\"on-failure\"",
        "chassis.cage.on_task_failure=\"restart-chassis\"",
    ];
    for seed in 0..20 {
        let said = text(
            |cx| {
                Box::pin(async move {
                    cx.sleep(Duration::from_millis(500)).await;
                    let twin = cx.task("twin").await?;
                    cx.call(&twin, Break {}).await?;
                    asks_on(cx).await
                })
            },
            &restarts,
            seed,
            &[],
        );
        let losses: u32 = said.strip_prefix("lost ").unwrap().parse().unwrap();
        assert!(
            losses <= 1,
            "one call is lost at most, and none in vain after it: {said}"
        );
    }
}

#[test]
fn a_task_that_the_boot_has_not_created_yet_is_waited_for() {
    struct Early;
    #[ctos::handler]
    impl Early {
        #[phase]
        async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
            // As soon as it is created; the other chassis may be later.
            let late = cx.task("late").await?;
            if phase == Phase::Run {
                let text = late.name().to_owned();
                let (ok, json) = (true, String::new());
                cx.finish(AppResult { ok, text, json });
            }
            Ok(())
        }
    }
    const APP: &str = r#"
        [app]
        until = "early"
        [chassis.desk]
        [chassis.cage]
        [task.early]
        handler = "early"
        on = "desk"
        [task.counter]
        handler = "counter"
        on = "cage"
        [task.twin]
        handler = "counter"
        on = "cage"
        [task.late]
        handler = "counter"
        on = "cage"
    "#;
    for seed in 0..40 {
        let app = load_texts(&[("app.toml", APP)], &[format!("app.seed={seed}")], &[]).unwrap();
        let mut registry = Registry::new();
        registry.handler("counter", &Counter::COMMANDS, |_| Ok(Counter::default()));
        registry.handler("early", &Early::COMMANDS, |_| Ok(Early));
        let observer: Observer = Arc::new(|_: &BootEvent| ());
        let end = simulate(app, registry, &[], &observer).unwrap().end;
        let End::Finished(result) = end else {
            panic!("seed {seed}: {end:?}");
        };
        assert_eq!(result.text, "late", "seed {seed}");
    }
}

/// Waits until the death, and says what becomes of a lookup and how long it took.
fn asks_once(
    cx: Context,
) -> futures_util::future::LocalBoxFuture<'static, Result<String, HandlerError>> {
    Box::pin(async move {
        cx.task("counter").await?;
        cx.sleep(Duration::from_secs(1)).await;
        let began = cx.now();
        let found = cx.task("counter").await;
        let took = cx.now().since(began).as_secs_f64();
        Ok(match found {
            Ok(_) => format!("found after {took:.1} s"),
            Err(error) => format!("{} after {took:.3} s: {error}", error.may_come_back()),
        })
    })
}

#[test]
fn a_wait_is_as_long_as_a_call_waits_and_says_what_for() {
    let long = [
        "chassis.cage.restart=\"always\"",
        "chassis.cage.restart_backoff_s=60",
    ];
    let said = text(asks_once, &long, 1, &[kill("cage", 900)]);
    assert_eq!(
        said,
        "true after 10.000 s: chassis `cage` is being restarted; it was not back within 10.000 s (`person` waits for `counter`)"
    );
    let sets = [long[0], long[1], "task.person.call_deadline_s=2.5"];
    let said = text(asks_once, &sets, 1, &[kill("cage", 900)]);
    assert!(
        said.starts_with("true after 2.500 s: chassis `cage` is being restarted"),
        "{said}"
    );
    let said = text(
        |cx| {
            Box::pin(async move {
                cx.sleep(Duration::from_secs(1)).await;
                let began = cx.now();
                let at_once = cx.task("counter").deadline(Duration::ZERO).await;
                assert!(
                    matches!(at_once, Err(NameError::NotBack { .. })),
                    "{at_once:?}"
                );
                let found = cx.task("counter").deadline(Duration::from_secs(100)).await;
                assert!(cx.now().since(began) > Duration::from_secs(11));
                Ok(found.is_ok().to_string())
            })
        },
        &long,
        1,
        &[kill("cage", 900)],
    );
    assert_eq!(said, "true");
}

#[test]
fn a_chassis_that_is_not_started_again_is_an_error_at_once() {
    // The app ends with it; the lookup that this cuts short is seen in the log of the call.
    for seed in 0..20 {
        let (end, events) = run(
            |cx| {
                Box::pin(async move {
                    loop {
                        let began = cx.now();
                        match cx.task("counter").await {
                            Ok(_) => cx.sleep(Duration::from_millis(1)).await,
                            Err(error) => {
                                let waited = cx.now().since(began);
                                assert!(waited < Duration::from_millis(100), "{waited:?}: {error}");
                                assert!(!error.may_come_back(), "{error}");
                                assert!(
                                    error
                                        .to_string()
                                        .contains("chassis `cage`, which is not started again"),
                                    "{error}"
                                );
                                cx.fail(&format!("seen: {error}"));
                                std::future::pending::<()>().await;
                            }
                        }
                    }
                })
            },
            &["chassis.cage.restart=\"never\"", "stop_timeout_s=1"],
            seed,
            &[kill("cage", 700)],
        );
        assert!(
            matches!(end, End::ChassisDown { .. } | End::TaskFailed { .. }),
            "{end:?} {events:#?}"
        );
    }
}

#[test]
fn a_name_that_nobody_configured_and_a_task_that_was_shut_down_are_errors_at_once() {
    let said = text(
        |cx| {
            Box::pin(async move {
                let began = cx.now();
                let unknown = cx.task("nobody").await.unwrap_err();
                let twin = cx.task("twin").await?;
                cx.call(&twin, Shutdown {}).await?;
                let ended = cx.task("twin").await.unwrap_err();
                assert!(matches!(ended, NameError::Unknown { .. }), "{ended}");
                assert!(cx.now().since(began) < Duration::from_millis(100));
                Ok(unknown.to_string())
            })
        },
        &["chassis.cage.restart=\"always\""],
        1,
        &[],
    );
    assert_eq!(
        said,
        "no task is called `nobody` (asked by `person`); there are: counter, person, twin"
    );
}
