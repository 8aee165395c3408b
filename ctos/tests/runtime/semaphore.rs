//! Semaphores and barriers between tasks, in virtual time: what a seed shows, it shows every time.

use std::{
    pin::Pin,
    sync::{
        Arc, Mutex,
        atomic::{AtomicI64, AtomicUsize, Ordering},
    },
    time::Duration,
};

use ctos::{
    boot::{End, Fault, FaultKind, Observer, Outcome, simulate},
    config::load_texts,
    message::{Command as _, Message},
    registry::Registry,
    semaphore::{Fence, Permit, Scope, SemaphoreError},
    sync::Signal,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase, StopReason},
    time::Instant,
};
use rand::RngExt as _;

/// What happened, in order.
type Log = Arc<Mutex<Vec<String>>>;
type Script = Arc<dyn Fn(Context, Log) -> Pin<Box<dyn Future<Output = ()>>> + Send + Sync>;

fn script<F: Future<Output = ()> + 'static>(
    play: impl Fn(Context, Log) -> F + Send + Sync + 'static,
) -> Script {
    Arc::new(move |cx, log| Box::pin(play(cx, log)))
}

fn note(log: &Log, what: impl Into<String>) {
    log.lock().unwrap().push(what.into());
}

/// Plays a script in the phase `run`. When all scripts of an app are played, the app has finished. When it is
/// stopped before, each task plays its script to the end first.
struct Player {
    script: Script,
    log: Log,
    left: Arc<AtomicUsize>,
    played: Signal,
}

impl EventHandler for Player {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let play = (self.script)(cx.clone(), self.log.clone());
            let (cx2, left, played) = (cx.clone(), self.left.clone(), self.played.clone());
            cx.spawn(async move {
                play.await;
                played.raise();
                if left.fetch_sub(1, Ordering::Relaxed) == 1 {
                    cx2.finish(AppResult {
                        ok: true,
                        text: String::new(),
                        json: "{}".to_owned(),
                    });
                }
            });
        }
        Ok(())
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        self.played.wait().await;
        Ok(())
    }
}

fn silent() -> Observer {
    Arc::new(|_| ())
}

/// Runs an app of these tasks (name, place, script) on chassis `a`, `b` and `c` with two processors each.
fn run(
    config: &str,
    seed: u64,
    faults: &[Fault],
    tasks: &[(&str, &str, Script)],
) -> (Outcome, Vec<String>) {
    run_with((config, &[]), seed, faults, tasks, |_, _| ())
}

/// The same with overrides and further handlers.
fn run_with(
    (config, sets): (&str, &[String]),
    seed: u64,
    faults: &[Fault],
    tasks: &[(&str, &str, Script)],
    register: impl Fn(&mut Registry, &Log),
) -> (Outcome, Vec<String>) {
    let log = Log::default();
    let left = Arc::new(AtomicUsize::new(tasks.len()));
    let mut registry = Registry::new();
    register(&mut registry, &log);
    let mut text = format!("{config}\n[app]\nseed = {seed}\n");
    for chassis in ["a", "b", "c"] {
        text += &format!("[chassis.{chassis}]\nprocessors = {{ one = {{}}, two = {{}} }}\n");
    }
    for (name, on, script) in tasks {
        text += &format!("[task.{name}]\nhandler = \"{name}\"\non = \"{on}\"\n");
        let (script, log, left) = (script.clone(), log.clone(), left.clone());
        registry.handler(name, &[], move |_| {
            Ok(Player {
                script: script.clone(),
                log: log.clone(),
                left: left.clone(),
                played: Signal::new(),
            })
        });
    }
    let app = load_texts(&[("app.toml", &text)], sets, &[])
        .unwrap_or_else(|findings| panic!("{findings}"));
    let outcome = simulate(app, registry, faults, &silent()).unwrap();
    let log = log.lock().unwrap().clone();
    (outcome, log)
}

fn finished(outcome: &Outcome) -> bool {
    matches!(&outcome.end, End::Finished(result) if result.ok)
}

const fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

const fn at_millis(millis: u64) -> Instant {
    Instant::from_nanos(millis * 1_000_000)
}

/// Takes and gives back permits at random, gives up at random, and counts who is inside.
fn worker(
    semaphore: &'static str,
    permits: u32,
    inside: Arc<AtomicI64>,
    most: Arc<AtomicI64>,
) -> Script {
    script(move |cx, _| {
        let (inside, most) = (inside.clone(), most.clone());
        async move {
            let mut rng = cx.rng("work");
            let semaphore = cx.semaphore(semaphore, permits).unwrap();
            for _ in 0..10 {
                let mut acquire = semaphore.acquire().deadline(Duration::from_secs(60));
                if rng.random_bool(0.3) {
                    acquire = acquire.high_priority();
                }
                let patience = if rng.random_bool(0.3) {
                    millis(1)
                } else {
                    Duration::from_secs(60)
                };
                // Giving up drops the wait, at whatever point it is.
                let Ok(permit) = cx.timeout(patience, async { acquire.await }).await else {
                    continue;
                };
                let permit = permit.unwrap();
                let now = inside.fetch_add(1, Ordering::Relaxed) + 1;
                most.fetch_max(now, Ordering::Relaxed);
                cx.sleep(Duration::from_micros(rng.random_range(1..3_000)))
                    .await;
                inside.fetch_sub(1, Ordering::Relaxed);
                permit.release();
            }
        }
    })
}

#[test]
fn never_more_tasks_are_inside_than_there_are_permits_and_all_get_their_turn() {
    for (semaphore, places) in [
        ("app/board", ["a/one", "a/two", "b/one", "c/one", "c/two"]),
        ("board", ["a/one", "a/one", "a/two", "a/two", "a/one"]),
    ] {
        for seed in 0..40 {
            let permits = 1 + u32::try_from(seed % 3).unwrap();
            let (inside, most) = (Arc::new(AtomicI64::new(0)), Arc::new(AtomicI64::new(0)));
            let names = ["v", "w", "x", "y", "z"];
            let tasks: Vec<_> = names
                .iter()
                .zip(places)
                .map(|(name, on)| {
                    (
                        *name,
                        on,
                        worker(semaphore, permits, inside.clone(), most.clone()),
                    )
                })
                .collect();
            let (outcome, _) = run("", seed, &[], &tasks);
            assert!(finished(&outcome), "{semaphore}, seed {seed}: {outcome:?}");
            assert_eq!(
                most.load(Ordering::Relaxed),
                i64::from(permits),
                "{semaphore}, seed {seed}"
            );
        }
    }
}

/// Waits `after`, then for the semaphore; notes its name when it has it, and keeps it `keep`.
fn turn(semaphore: &'static str, after: u64, high: bool, keep: u64) -> Script {
    script(move |cx, log| async move {
        cx.sleep(millis(after)).await;
        let mut acquire = cx.semaphore(semaphore, 1).unwrap().acquire();
        if high {
            acquire = acquire.high_priority();
        }
        let permit = acquire.await.unwrap();
        note(&log, cx.name());
        cx.sleep(millis(keep)).await;
        drop(permit);
    })
}

#[test]
fn who_waits_is_served_first_come_first_served_and_high_priority_before() {
    for (semaphore, on) in [
        ("app/board", ["a", "b", "c", "a/two"]),
        ("board", ["a", "a/two", "a", "a/two"]),
    ] {
        for seed in 0..10 {
            let tasks = [
                ("first", on[0], turn(semaphore, 0, false, 500)),
                ("third", on[1], turn(semaphore, 100, false, 10)),
                ("fourth", on[2], turn(semaphore, 200, false, 10)),
                ("second", on[3], turn(semaphore, 300, true, 10)),
            ];
            let (outcome, log) = run("", seed, &[], &tasks);
            assert!(finished(&outcome));
            assert_eq!(
                log,
                ["first", "second", "third", "fourth"],
                "{semaphore}, seed {seed}"
            );
        }
    }
}

/// Takes the semaphore, says so, and never gives it back by itself.
fn hog(semaphore: &'static str) -> Script {
    script(move |cx, log| async move {
        let _permit = cx.semaphore(semaphore, 1).unwrap().acquire().await.unwrap();
        note(&log, "taken");
        cx.sleep(Duration::from_secs(3600)).await;
    })
}

#[test]
fn a_permit_is_released_when_the_chassis_of_its_holder_dies() {
    for seed in 0..20 {
        let kill = Fault::on("a", FaultKind::Kill, at_millis(1_000));
        let waits_too = script(|cx, _| async move {
            // Waits in the line of a chassis that is gone when its turn would come.
            let semaphore = cx.semaphore("app/board", 1).unwrap();
            let _ = semaphore.acquire().deadline(Duration::from_secs(60)).await;
        });
        let waiter = script(|cx, log| async move {
            cx.sleep(millis(200)).await;
            let semaphore = cx.semaphore("app/board", 1).unwrap();
            let permit = semaphore.acquire().await;
            note(&log, format!("had {}", permit.is_ok()));
        });
        let tasks = [
            ("holder", "a", hog("app/board")),
            ("queued", "a/two", waits_too),
            ("waiter", "b", waiter),
        ];
        let (outcome, log) = run("", seed, &[kill], &tasks);
        let gone = End::ChassisDown {
            chassis: "a".to_owned(),
        };
        assert_eq!(outcome.end, gone);
        // Whichever of the two on the chassis that dies was first.
        assert_eq!(log.last().unwrap(), "had true", "seed {seed}: {log:?}");
    }
}

ctos::command! {
    /// Writes to what the semaphore protects, with the number of the permit.
    struct Write { number: u64 } => (), 1, "write"
}

/// What the semaphore protects. Notes what it takes, and what it refuses.
struct Board {
    fence: Fence,
    log: Log,
}

impl EventHandler for Board {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != Write::CODE {
            return cx.default_processing(message);
        }
        let (Write { number }, reply) = message.open::<Write>()?;
        match self.fence.pass(number) {
            Ok(()) => {
                note(&self.log, format!("write {number}"));
                reply.ok(())
            }
            Err(error) => reply.fail(error),
        }
    }
}

#[test]
fn a_fence_shuts_out_every_permit_that_is_older_than_one_that_passed() {
    let mut fence = Fence::default();
    fence.pass(3).unwrap();
    fence.pass(3).unwrap();
    let said = fence.pass(2).unwrap_err().to_string();
    assert_eq!(said, "permit 2 is no longer good: permit 3 has been used");
    fence.pass(7).unwrap();
}

#[test]
fn each_permit_has_a_greater_number_than_those_before_it_and_is_confirmed() {
    for name in ["app/board", "board"] {
        let takes = script(move |cx, log| async move {
            let semaphore = cx.semaphore(name, 2).unwrap();
            let first = semaphore.acquire().await.unwrap();
            let second = semaphore.acquire().await.unwrap();
            second.confirm(&cx).await.unwrap();
            let numbers = (first.number(), second.number());
            first.release();
            let third = semaphore.acquire().await.unwrap();
            note(&log, format!("{numbers:?} {}", third.number()));
        });
        let (outcome, log) = run("", 1, &[], &[("takes", "a", takes)]);
        assert!(finished(&outcome));
        assert_eq!(log, ["(1, 2) 3"], "{name}");
    }
}

#[test]
fn a_holder_that_was_frozen_and_given_up_writes_nothing_after_the_next_one() {
    for frozen_ms in [500, 1_900, 2_100, 2_500, 6_000] {
        for seed in 0..3 {
            // Writes without end, with the one permit that it had, then without a look at it.
            let writer = script(|cx, log| async move {
                let semaphore = cx.semaphore("app/board", 1).unwrap();
                let permit = semaphore.acquire().await.unwrap();
                let board = cx.task("board").await.unwrap();
                let number = permit.number();
                for _ in 0..3_000 {
                    let written = cx.call(&board, Write { number }).await;
                    if let Err(error) = written {
                        note(&log, format!("refused {}", error.reason()));
                    }
                    cx.sleep(millis(1)).await;
                }
                let confirmed = permit.confirm(&cx).await.is_ok();
                note(&log, format!("{number} confirmed {confirmed}"));
            });
            let next = script(|cx, _| async move {
                cx.sleep(millis(200)).await;
                let semaphore = cx.semaphore("app/board", 1).unwrap();
                let permit = semaphore.acquire().deadline(Duration::from_secs(60)).await;
                let permit = permit.unwrap();
                permit.confirm(&cx).await.unwrap();
                let board = cx.task("board").await.unwrap();
                let number = permit.number();
                for _ in 0..20 {
                    cx.call(&board, Write { number }).await.unwrap();
                    cx.sleep(millis(7)).await;
                }
            });
            let freeze = Fault::on("a", FaultKind::Freeze, at_millis(1_000))
                .until(at_millis(1_000 + frozen_ms));
            let tasks = [("writer", "a", writer), ("next", "b", next)];
            let sets = ["chassis.a.restart=\"on-failure\"".to_owned()];
            let config = "[task.board]\nhandler = \"board\"\non = \"c\"\n";
            let (_, log) = run_with((config, &sets), seed, &[freeze], &tasks, |registry, log| {
                let log = log.clone();
                registry.handler("board", &[Write::INFO], move |_| {
                    Ok(Board {
                        fence: Fence::default(),
                        log: log.clone(),
                    })
                });
            });
            let numbers = log.iter().filter_map(|line| line.strip_prefix("write "));
            let numbers: Vec<u64> = numbers.map(|number| number.parse().unwrap()).collect();
            assert!(numbers.is_sorted(), "{frozen_ms} ms, seed {seed}: {log:?}");
            assert!(numbers.contains(&2), "{frozen_ms} ms, seed {seed}");
            // Who was not given up holds it to its end.
            let confirmed = log.iter().any(|line| line == "1 confirmed true");
            assert_eq!(confirmed, frozen_ms < 2_000, "{frozen_ms} ms, seed {seed}");
        }
    }
}

ctos::command! {
    /// Keeps a permit in the handler, or where other tasks find it.
    struct Keep { shared: bool } => (), 1, "keep"
}
ctos::command! {
    /// Panics.
    struct Panic => (), 2, "panic"
}

/// A handler that keeps permits.
struct Keeper {
    kept: Vec<Permit>,
    semaphore: &'static str,
}

impl EventHandler for Keeper {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            1 => {
                let (Keep { shared }, reply) = message.open::<Keep>()?;
                let permit = cx.semaphore(self.semaphore, 1)?.acquire().await?;
                if shared {
                    cx.share("permit", Arc::new(Mutex::new(permit)));
                } else {
                    self.kept.push(permit);
                }
                reply.ok(())
            }
            2 => panic!("as it was told"),
            _ => cx.default_processing(message),
        }
    }
}

/// Lets `keeper` take the semaphore and panic, and takes it after it.
fn heir(semaphore: &'static str, shared: bool) -> Script {
    script(move |cx, log| async move {
        let keeper = cx.task("keeper").await.unwrap();
        cx.call(&keeper, Keep { shared }).await.unwrap();
        let semaphore = cx.semaphore(semaphore, 1).unwrap();
        assert!(semaphore.try_acquire().await.unwrap().is_none());
        assert!(cx.call(&keeper, Panic {}).await.is_err());
        let permit = semaphore.acquire().deadline(Duration::from_secs(1)).await;
        note(&log, format!("had {}", permit.is_ok()));
    })
}

#[test]
fn a_permit_is_released_when_its_holder_panics_whether_it_is_restarted_or_ends() {
    for (semaphore, on) in [("app/board", "b"), ("board", "a/two")] {
        for (restart, shared) in [("always", false), ("never", false), ("never", true)] {
            let log = Log::default();
            let left = Arc::new(AtomicUsize::new(1));
            let mut registry = Registry::new();
            registry.handler("keeper", &[], move |_| {
                Ok(Keeper {
                    kept: Vec::new(),
                    semaphore,
                })
            });
            let seen = log.clone();
            registry.handler("heir", &[], move |_| {
                Ok(Player {
                    script: heir(semaphore, shared),
                    log: seen.clone(),
                    left: left.clone(),
                    played: Signal::new(),
                })
            });
            let text = format!(
                "[chassis.a]\nprocessors = {{ one = {{}}, two = {{}} }}\n[chassis.b]\n\
                 [task.keeper]\nhandler = \"keeper\"\non = \"a\"\nrestart = \"{restart}\"\n\
                 [task.heir]\nhandler = \"heir\"\non = \"{on}\"\n"
            );
            let app = load_texts(&[("app.toml", &text)], &[], &[])
                .unwrap_or_else(|findings| panic!("{findings}"));
            simulate(app, registry, &[], &silent()).unwrap();
            assert_eq!(
                *log.lock().unwrap(),
                ["had true"],
                "{semaphore} {restart} {shared}"
            );
        }
    }
}

#[test]
fn who_waits_too_long_hears_who_holds_it_for_how_long_and_who_waits_before() {
    for (semaphore, on) in [("app/board", "b"), ("board", "a/two")] {
        let queued = script(move |cx, _| async move {
            cx.sleep(millis(100)).await;
            let semaphore = cx.semaphore(semaphore, 1).unwrap();
            let _ = semaphore.acquire().deadline(Duration::from_secs(9)).await;
        });
        let late = script(move |cx, log| async move {
            cx.sleep(millis(1_000)).await;
            let semaphore = cx.semaphore(semaphore, 1).unwrap();
            let views = cx.semaphores().await.unwrap();
            note(
                &log,
                format!(
                    "{} {:?} {}",
                    views[0].holders[0].task, views[0].waiting, views[0].scope
                ),
            );
            let error = semaphore
                .acquire()
                .deadline(millis(2_000))
                .await
                .unwrap_err();
            note(&log, error.to_string());
            let SemaphoreError::Deadline { holders, .. } = error else {
                panic!("{error}");
            };
            note(
                &log,
                format!(
                    "{}",
                    holders[0].1 >= millis(2_500) && holders[0].1 < millis(3_100)
                ),
            );
            cx.finish(AppResult {
                ok: true,
                text: String::new(),
                json: "{}".to_owned(),
            });
        });
        let tasks = [
            ("arm", "a", hog(semaphore)),
            ("hand", on, queued),
            ("eye", on, late),
        ];
        let (_, log) = run("", 1, &[], &tasks);
        let scope = if semaphore == "board" {
            Scope::Chassis
        } else {
            Scope::App
        };
        assert_eq!(
            log[..2],
            ["taken".to_owned(), format!("arm [\"hand\"] {scope}")]
        );
        let begin =
            format!("`eye` waited 2.000 s for the semaphore `{semaphore}`, held by `arm` for ");
        assert!(log[2].starts_with(&begin), "{log:?}");
        assert!(log[2].ends_with(" s; 1 other waits before it"), "{log:?}");
        assert_eq!(log[3], "true", "{log:?}");
    }
}

/// Arrives after some time and notes how it passed.
fn arrival(barrier: &'static str, after: u64) -> Script {
    script(move |cx, log| async move {
        let barrier = cx
            .barrier(barrier, 3)
            .unwrap()
            .deadline(Duration::from_secs(3));
        for _ in 0..2 {
            cx.sleep(millis(after)).await;
            match barrier.wait().await {
                Ok(passage) => note(&log, format!("{} {}", passage.generation, passage.last)),
                Err(error) => note(&log, error.to_string()),
            }
        }
    })
}

#[test]
fn a_barrier_lets_all_pass_together_again_and_again() {
    for (barrier, on) in [
        ("app/start", ["a", "b", "c"]),
        ("start", ["a", "a/two", "a"]),
    ] {
        for seed in 0..10 {
            let tasks = [
                ("x", on[0], arrival(barrier, 10)),
                ("y", on[1], arrival(barrier, 400)),
                ("z", on[2], arrival(barrier, 900)),
            ];
            let (outcome, mut log) = run("", seed, &[], &tasks);
            assert!(finished(&outcome));
            log.sort();
            let expected = [
                "1 false", "1 false", "1 true", "2 false", "2 false", "2 true",
            ];
            assert_eq!(log, expected, "{barrier}, seed {seed}");
        }
    }
}

#[test]
fn who_waits_at_a_barrier_for_the_dead_hears_who_is_there() {
    let dies = script(|cx, _| async move {
        let _ = cx.barrier("app/start", 3).unwrap().wait().await;
    });
    let late = script(|cx, log| async move {
        cx.sleep(millis(2_000)).await;
        let barrier = cx.barrier("app/start", 3).unwrap().deadline(millis(500));
        note(&log, barrier.wait().await.unwrap_err().to_string());
    });
    let kill = Fault::on("c", FaultKind::Kill, at_millis(1_500));
    // The app is stopped when `c` dies, and `late` plays on until it has its answer.
    let tasks = [("late", "a", late), ("dies", "c", dies)];
    let (_, log) = run("", 3, &[kill], &tasks);
    assert_eq!(
        log,
        ["`late` waited 0.500 s at the barrier `app/start`, where 1 of 3 have arrived: `late`"]
    );
}

#[test]
fn the_configuration_says_how_many_and_who_shares() {
    let config = "[semaphore.board]\nscope = \"app\"\npermits = 2\n[barrier.start]\nscope = \"app\"\nparties = 2\n";
    let task = || {
        script(|cx, log| async move {
            let semaphore = cx.semaphore("board", 1).unwrap();
            let first = semaphore.acquire().await.unwrap();
            cx.barrier("start", 7).unwrap().wait().await.unwrap();
            let views = cx.semaphores().await.unwrap();
            note(
                &log,
                format!(
                    "{} {} {}",
                    views[0].scope,
                    views[0].permits,
                    views[0].holders.len()
                ),
            );
            cx.barrier("start", 7).unwrap().wait().await.unwrap();
            drop(first);
        })
    };
    let (outcome, log) = run(config, 1, &[], &[("x", "a", task()), ("y", "b", task())]);
    assert!(finished(&outcome), "{outcome:?}");
    assert_eq!(log, ["app 2 2", "app 2 2"]);
}

#[test]
fn tasks_that_do_not_agree_on_the_number_are_told() {
    for name in ["board", "app/board"] {
        let task = script(move |cx, log| async move {
            let keep = cx.semaphore(name, 2).unwrap();
            let _permit = keep.acquire().await.unwrap();
            let other = match cx.semaphore(name, 3) {
                Ok(semaphore) => semaphore.acquire().await.unwrap_err(),
                Err(error) => error,
            };
            note(&log, other.to_string());
            note(&log, cx.semaphore(name, 0).unwrap_err().to_string());
        });
        let (outcome, log) = run("", 1, &[], &[("x", "a", task)]);
        assert!(finished(&outcome));
        assert_eq!(
            log,
            [
                format!(
                    "`{name}` is for 2, but `x` asks for one for 3; say it once, in the configuration"
                ),
                format!(
                    "`{name}`, asked for by `x`, is for nobody: it needs a number of at least 1"
                ),
            ]
        );
    }
}

#[test]
fn waiting_for_a_semaphore_of_the_app_ends_when_the_link_to_it_is_cut() {
    let cut = Fault::between("boot", "a", FaultKind::Cut, at_millis(500));
    let waits = script(|cx, log| async move {
        let semaphore = cx.semaphore("app/board", 1).unwrap();
        let _first = semaphore.acquire().await.unwrap();
        let error = semaphore.acquire().await.unwrap_err();
        note(
            &log,
            format!("{}", matches!(error, SemaphoreError::Service(_))),
        );
    });
    let idle = script(|_, _| async {});
    let (_, log) = run("", 1, &[cut], &[("x", "a", waits), ("y", "b", idle)]);
    assert_eq!(log, ["true"]);
}
