//! Chassis that die and come back, and those that come back too often, in virtual time.

use std::{
    collections::BTreeSet,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Fault, FaultKind, Observer, Outcome, simulate},
    config::{App, load_texts},
    message::{Command, CommandInfo, Message, Tid},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase, StopReason},
    time::Instant,
};
use serde::Deserialize;

ctos::command! {
    /// Counts.
    pub struct Count => u32, 1, "count"
}
ctos::command! {
    /// Panics.
    pub struct Panic => (), 2, "panic"
}

/// Moment, task, its id, what.
type Trace = Arc<Mutex<Vec<(u64, String, Tid, String)>>>;

#[derive(Deserialize, Clone, Default)]
#[serde(default, deny_unknown_fields)]
struct Args {
    /// Phase, and from which life of the task on.
    refuses: Option<String>,
    hangs: Option<String>,
    /// Calls this one in the phase that hangs.
    asks: Option<String>,
    from_life: u32,
    /// Calls this task, again and again, until it has counted to `enough` in one life.
    calls: Option<String>,
    enough: u32,
    panics_at: Option<u32>,
    /// How long the last phase takes besides, µs.
    runs_late_us: u64,
}

struct Actor {
    args: Args,
    life: u32,
    trace: Trace,
    count: u32,
}

impl Actor {
    fn saw(&self, cx: &Context, what: impl Into<String>) {
        let entry = (
            cx.now().as_nanos(),
            cx.name().to_owned(),
            cx.tid(),
            what.into(),
        );
        self.trace.lock().unwrap().push(entry);
    }
}

impl EventHandler for Actor {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Count::CODE => {
                let (Count {}, reply) = message.open::<Count>()?;
                self.count += 1;
                if Some(self.count) == self.args.panics_at {
                    self.saw(cx, "breaks");
                }
                assert_ne!(Some(self.count), self.args.panics_at, "enough is enough");
                reply.ok(self.count)
            }
            Panic::CODE => panic!("as it was told"),
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        self.saw(cx, format!("enters {phase}"));
        let is = |name: &Option<String>| {
            self.life >= self.args.from_life && name.as_deref() == Some(&phase.to_string())
        };
        if is(&self.args.refuses) {
            return Err("the key is not turned".into());
        }
        if is(&self.args.hangs) {
            if let Some(asks) = &self.args.asks {
                let asked = cx.task(asks).await?;
                let call = cx.call(&asked, Count {}).deadline(Duration::from_secs(100));
                call.await?;
            }
            std::future::pending::<()>().await;
        }
        cx.sleep(Duration::from_millis(5)).await;
        if phase == Phase::Run {
            cx.sleep(Duration::from_micros(self.args.runs_late_us))
                .await;
        }
        self.saw(cx, format!("entered {phase}"));
        if phase == Phase::Run && self.args.calls.is_some() {
            cx.spawn(play(cx.clone(), self.args.clone()));
        }
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        self.saw(cx, format!("stops: {reason}"));
        Ok(())
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        self.saw(cx, format!("misses {chassis}"));
        Ok(())
    }

    async fn chassis_up(&mut self, cx: &Context, chassis: &str) -> Handled {
        self.saw(cx, format!("greets {chassis}"));
        Ok(())
    }
}

/// Counts with the other task until one life of it has reached the number; looks it up by name each time.
async fn play(cx: Context, args: Args) {
    let name = args.calls.unwrap();
    loop {
        cx.sleep(Duration::from_millis(10)).await;
        let Ok(task) = cx.task(&name).await else {
            continue;
        };
        match cx.call(&task, Count {}).await {
            Ok(count) if count >= args.enough => break,
            _ => {}
        }
    }
    cx.finish(AppResult {
        ok: true,
        text: "counted".to_owned(),
        json: String::new(),
    });
}

struct Run {
    outcome: Outcome,
    trace: Vec<(u64, String, Tid, String)>,
    events: Vec<BootEvent>,
}

impl Run {
    fn of<'r>(&'r self, task: &'r str) -> impl Iterator<Item = (Tid, &'r str)> {
        let entries = self.trace.iter().filter(move |entry| entry.1 == task);
        entries.map(|entry| (entry.2, entry.3.as_str()))
    }

    fn times(&self, task: &str, what: &str) -> usize {
        self.of(task)
            .filter(|(_, saw)| saw.starts_with(what))
            .count()
    }

    fn restarts(&self) -> usize {
        let restarted = |event: &&BootEvent| matches!(event, BootEvent::Restarted { .. });
        self.events.iter().filter(restarted).count()
    }

    #[track_caller]
    fn must_finish(&self) {
        assert!(
            matches!(&self.outcome.end, End::Finished(result) if result.ok),
            "{:?}\n{:#?}\n{:#?}",
            self.outcome.end,
            self.events,
            self.trace
        );
    }
}

/// `caller` counts with `arm`, which lives on a chassis that is restarted.
const APP: &str = r#"
    [app]
    until = "caller"
    phase_timeout_s = 2.0
    stop_timeout_s = 1.0
    [chassis.desk]
    [chassis.cage]
    restart = "on-failure"
    restart_backoff_s = 0.1
    [task.arm]
    handler = "actor"
    on = "cage"
    [task.hand]
    handler = "actor"
    on = "cage"
    [task.caller]
    handler = "actor"
    on = "desk"
    args = { calls = "arm", enough = 20 }
    [task.clerk]
    handler = "actor"
    on = "desk"
"#;

fn run(sets: &[&str], faults: &[Fault]) -> Run {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let app: App = load_texts(&[("app.toml", APP)], &sets, &[]).unwrap();
    let trace = Trace::default();
    let lives: Arc<Mutex<std::collections::BTreeMap<String, u32>>> = Arc::default();
    let mut registry = Registry::new();
    let commands: [CommandInfo; 2] = [Count::INFO, Panic::INFO];
    let kept = trace.clone();
    registry.handler("actor", &commands, move |cx: &Context| {
        let mut lives = lives.lock().unwrap();
        let life = lives.entry(cx.name().to_owned()).or_default();
        *life += 1;
        Ok(Actor {
            args: cx.args()?,
            life: *life,
            trace: kept.clone(),
            count: 0,
        })
    });
    let events: Arc<Mutex<Vec<BootEvent>>> = Arc::default();
    let seen = events.clone();
    let observer: Observer = Arc::new(move |event: &BootEvent| {
        seen.lock().unwrap().push(event.clone());
    });
    let outcome = simulate(app, registry, faults, &observer).unwrap();
    let trace = trace.lock().unwrap().clone();
    let events = events.lock().unwrap().clone();
    Run {
        outcome,
        trace,
        events,
    }
}

fn kill(chassis: &str, millis: u64) -> Fault {
    Fault::on(
        chassis.to_owned(),
        FaultKind::Kill,
        Instant::START + Duration::from_millis(millis),
    )
}

#[test]
fn a_chassis_that_is_killed_comes_back_and_its_names_with_it() {
    for seed in 0..30 {
        let run = run(&[&format!("app.seed={seed}")], &[kill("cage", 120)]);
        run.must_finish();
        assert_eq!(run.restarts(), 1);
        assert!(run.outcome.casualties.is_empty(), "{:?}", run.outcome);
        for task in ["arm", "hand"] {
            for phase in Phase::ALL {
                assert_eq!(run.times(task, &format!("entered {phase}")), 2, "{task}");
            }
        }
        // The others kept their lives, and are told once of each.
        for task in ["caller", "clerk"] {
            assert_eq!(run.times(task, "enters create"), 1);
            assert_eq!(run.times(task, "misses cage"), 1);
            assert_eq!(run.times(task, "greets cage"), 1);
        }
        let order: Vec<&str> = run.of("clerk").map(|(_, what)| what).collect();
        let at = |what: &str| order.iter().position(|saw| *saw == what).unwrap();
        assert!(at("misses cage") < at("greets cage"));
    }
}

#[test]
fn no_task_id_is_used_twice() {
    let run = run(
        &["task.caller.args.enough=40"],
        &[kill("cage", 120), kill("cage", 400)],
    );
    run.must_finish();
    assert_eq!(run.restarts(), 2);
    let mut ids = BTreeSet::new();
    for task in ["arm", "hand"] {
        ids.extend(run.of(task).map(|(tid, _)| tid.to_string()));
    }
    assert_eq!(ids.len(), 6, "two tasks with three lives each: {ids:?}");
}

#[test]
fn a_kill_at_any_moment_is_survived() {
    for at in (0..260).step_by(4) {
        for seed in 0..3 {
            let run = run(&[&format!("app.seed={seed}")], &[kill("cage", at)]);
            run.must_finish();
            assert!(run.restarts() <= 1, "{:#?}", run.events);
            // Whenever it died, what ran at the end had passed the phases in their order.
            let mut lives: Vec<(Tid, Vec<String>)> = Vec::new();
            for (tid, saw) in run.of("arm").filter(|(_, saw)| saw.starts_with("entered")) {
                match lives.iter_mut().find(|(of, _)| *of == tid) {
                    Some((_, phases)) => phases.push(saw.to_owned()),
                    None => lives.push((tid, vec![saw.to_owned()])),
                }
            }
            let all = ["entered create", "entered connect", "entered run"];
            assert_eq!(lives.last().unwrap().1, all, "killed at {at} ms");
            assert!(
                lives
                    .iter()
                    .all(|(_, phases)| *phases == all[..phases.len()])
            );
        }
    }
}

#[test]
fn a_chassis_that_falls_again_while_it_rises_is_raised_again() {
    for second in (121..330).step_by(6) {
        let run = run(&[], &[kill("cage", 120), kill("cage", second)]);
        run.must_finish();
        assert!(run.restarts() >= 1);
    }
}

#[test]
fn both_chassis_may_fall_at_once() {
    let sets = ["chassis.desk.restart=\"always\""];
    for at in [20, 60, 150] {
        let run = run(&sets, &[kill("cage", at), kill("desk", at)]);
        run.must_finish();
    }
}

#[test]
fn a_crash_loop_ends_the_app_with_its_reason() {
    let sets = [
        "chassis.cage.max_restarts=2",
        "chassis.cage.restart_window_s=30",
        "task.caller.args.enough=1000000",
    ];
    let kills = [kill("cage", 120), kill("cage", 900), kill("cage", 2_000)];
    let run = run(&sets, &kills);
    let End::GivenUp { chassis, reason } = &run.outcome.end else {
        panic!("{:?}: {:#?}", run.outcome.end, run.events);
    };
    assert_eq!(chassis, "cage");
    assert_eq!(
        reason,
        "was restarted 2 times within 30 s and failed again: it was killed by signal 9 (SIGKILL)"
    );
    assert_eq!(run.restarts(), 2);
    // The others are stopped in order, and know why.
    for task in ["caller", "clerk"] {
        let expected = format!("stops: chassis `cage` {reason}");
        assert_eq!(run.times(task, &expected), 1);
    }
}

#[test]
fn restarts_that_are_far_apart_do_not_add_up() {
    let sets = [
        "chassis.cage.max_restarts=1",
        "chassis.cage.restart_window_s=1",
        "task.caller.args.enough=300",
    ];
    let kills: Vec<Fault> = (1..6).map(|number| kill("cage", number * 1_500)).collect();
    let run = run(&sets, &kills);
    run.must_finish();
    assert_eq!(run.restarts(), 5);
}

#[test]
fn without_a_policy_the_app_ends_with_the_chassis() {
    let run = run(&["chassis.cage.restart=\"never\""], &[kill("cage", 120)]);
    let gone = End::ChassisDown {
        chassis: "cage".to_owned(),
    };
    assert_eq!(run.outcome.end, gone);
    assert_eq!(run.outcome.casualties.len(), 1);
    assert_eq!(run.restarts(), 0);
}

#[test]
fn a_phase_that_fails_after_a_restart_counts_as_a_failure_of_the_chassis() {
    let sets = [
        "task.hand.args.refuses=\"connect\"",
        "task.hand.args.from_life=2",
        "task.caller.args.enough=1000000",
        "chassis.cage.max_restarts=2",
    ];
    let run = run(&sets, &[kill("cage", 120)]);
    let End::GivenUp { reason, .. } = &run.outcome.end else {
        panic!("{:?}", run.outcome.end);
    };
    assert!(
        reason.ends_with("it did not pass startup phase `connect`: `hand`: the key is not turned"),
        "{reason}"
    );
    // What came up in vain was stopped in order.
    assert_eq!(run.times("arm", "stops: chassis `cage` did not pass"), 2);
}

#[test]
fn a_task_that_fails_takes_its_chassis_with_it_where_the_configuration_says_so() {
    let sets = [
        "task.arm.args.panics_at=10",
        "task.caller.args.enough=9",
        "chassis.cage.on_task_failure=\"restart-chassis\"",
    ];
    let run = run(
        &[&sets[..], &["task.caller.args.enough=1000"]].concat(),
        &[],
    );
    let End::GivenUp { chassis, reason } = &run.outcome.end else {
        panic!("{:?}: {:#?}", run.outcome.end, run.events);
    };
    assert_eq!(chassis, "cage");
    assert!(
        reason.contains("was restarted 3 times within 60 s and failed again: it has a task that failed: `arm`: its handler panicked"),
        "{reason}"
    );
    assert!(reason.contains("enough is enough"), "{reason}");
    // Its neighbour was stopped in order each time before the process ended.
    assert_eq!(
        run.times("hand", "stops: chassis `cage` has a task that failed"),
        4
    );
    assert_eq!(run.times("clerk", "greets cage"), 3);
}

/// `arm` breaks at so many calls, and takes its chassis with it.
fn breaks_at(count: u32) -> Vec<String> {
    vec![
        format!("task.arm.args.panics_at={count}"),
        "task.caller.args.enough=1000".to_owned(),
        "chassis.cage.on_task_failure=\"restart-chassis\"".to_owned(),
    ]
}

fn run_breaking(sets: &[String], faults: &[Fault]) -> Run {
    let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
    run(&sets, faults)
}

#[test]
fn a_chassis_that_dies_while_one_of_its_tasks_fails_is_restarted_all_the_same() {
    let sets = breaks_at(10);
    let calm = run_breaking(&sets, &[]);
    let broke = calm.trace.iter().find(|entry| entry.3 == "breaks");
    let broke = broke.expect("it breaks").0;
    for late_us in (0..400).step_by(10) {
        let kill = Fault::on(
            "cage",
            FaultKind::Kill,
            Instant::from_nanos(broke) + Duration::from_micros(late_us),
        );
        let run = run_breaking(&sets, &[kill]);
        assert!(
            matches!(&run.outcome.end, End::GivenUp { chassis, .. } if chassis == "cage"),
            "{late_us} us: {:?}",
            run.outcome.end
        );
    }
}

#[test]
fn no_app_is_said_to_be_up_once_one_of_its_tasks_has_failed() {
    let (mut failed, mut contained) = (0, 0);
    for (seed, late_us) in (0..400).zip((10_000..11_000).step_by(10).cycle()) {
        let mut sets = breaks_at(1);
        sets.push(format!("app.seed={seed}"));
        sets.push(format!("task.hand.args.runs_late_us={late_us}"));
        let run = run_breaking(&sets, &[]);
        let is_up = |event: &BootEvent| {
            matches!(
                event,
                BootEvent::PhaseDone {
                    phase: Phase::Run,
                    ..
                }
            )
        };
        let was_up = run.events.iter().any(is_up);
        match &run.outcome.end {
            End::TaskFailed { task, .. } => {
                assert_eq!(task, "arm");
                assert!(!was_up, "seed {seed}, {late_us} us: {:#?}", run.events);
                failed += 1;
            }
            End::GivenUp { .. } => {
                assert!(was_up, "seed {seed}, {late_us} us: {:#?}", run.events);
                contained += 1;
            }
            other => panic!("seed {seed}, {late_us} us: {other:?}"),
        }
    }
    assert!(failed > 0 && contained > 0, "{failed}, {contained}");
}

#[test]
fn a_task_that_fails_ends_the_app_where_the_configuration_does_not_say_otherwise() {
    let run = run(&["task.arm.args.panics_at=3"], &[]);
    assert!(
        matches!(&run.outcome.end, End::TaskFailed { task, .. } if task == "arm"),
        "{:?}",
        run.outcome.end
    );
}

#[test]
fn a_chassis_that_lost_only_the_boot_is_seen_dead_before_the_next_one_starts() {
    let cut = Fault::between(
        "boot",
        "cage",
        FaultKind::Cut,
        Instant::START + Duration::from_millis(120),
    );
    let run = run(&[], &[cut]);
    run.must_finish();
    // The old incarnation stops its tasks before the new one creates its own.
    let arm: Vec<&str> = run.of("arm").map(|(_, what)| what).collect();
    let stopped = arm.iter().position(|saw| saw.starts_with("stops")).unwrap();
    let again = arm.iter().rposition(|saw| *saw == "enters create").unwrap();
    assert!(stopped < again, "{arm:#?}");
    assert_eq!(arm.iter().filter(|saw| **saw == "enters create").count(), 2);
}

#[test]
fn an_app_that_is_stopped_while_a_chassis_is_away_ends() {
    // It ends by itself 30 ms after the kill, within the pause.
    let sets = [
        "task.caller.args.calls=\"clerk\"",
        "task.caller.args.enough=14",
        "chassis.cage.restart_backoff_s=5",
    ];
    let run = run(&sets, &[kill("cage", 120)]);
    run.must_finish();
    assert_eq!(run.restarts(), 0);
    assert!(
        run.outcome.took < Duration::from_secs(2),
        "{:?}",
        run.outcome
    );
}

#[test]
fn one_seed_is_one_run_with_restarts_too() {
    let runs = [0, 1].map(|_| run(&["app.seed=5"], &[kill("cage", 120), kill("cage", 500)]));
    let [one, two] = runs;
    assert_eq!(one.trace, two.trace);
    assert_eq!(one.events, two.events);
    assert_eq!(one.outcome, two.outcome);
}

#[test]
fn a_task_that_never_acknowledges_says_what_it_waits_for() {
    let sets = [
        "task.arm.args.hangs=\"connect\"",
        "task.arm.args.asks=\"hand\"",
        "task.hand.args.hangs=\"connect\"",
    ];
    let run = run(&sets, &[]);
    let End::PhaseFailed { phase, failures } = &run.outcome.end else {
        panic!("{:?}", run.outcome.end);
    };
    assert_eq!(*phase, Phase::Connect);
    let why = |task: &str| {
        let mut failures = failures.iter().filter(|(name, _)| name == task);
        failures.next().map(|(_, why)| why.as_str()).unwrap()
    };
    assert_eq!(
        why("arm"),
        "`arm` did not acknowledge phase connect within 2.000 s: it waits for the reply of `hand` to `count` for 2.0 s"
    );
    assert!(
        why("hand").starts_with("`hand` did not acknowledge phase connect within 2.000 s: it has been at `phase` for 2.0 s and waits for no task"),
        "{}",
        why("hand")
    );
}

#[test]
fn keys_of_restarts_without_restarts_are_pointed_out() {
    let load = |set: &str| load_texts(&[("app.toml", APP)], &[set.to_owned()], &[]);
    assert!(
        load("chassis.cage.max_restarts=5")
            .unwrap()
            .warnings
            .is_empty()
    );
    for set in [
        "chassis.desk.max_restarts=5",
        "chassis.desk.restart_window_s=5",
        "chassis.desk.restart_backoff_s=5",
        "chassis.desk.on_task_failure=restart-chassis",
    ] {
        let warnings = load(set).unwrap().warnings.into_sorted();
        assert_eq!(warnings.len(), 1, "{set}");
        assert!(warnings[0].message.contains("has no effect"), "{set}");
    }
    for set in [
        "chassis.cage.restart=sometimes",
        "chassis.cage.max_restarts=0",
        "chassis.cage.restart_backoff_s=0",
    ] {
        assert!(load(set).is_err(), "{set}");
    }
}
