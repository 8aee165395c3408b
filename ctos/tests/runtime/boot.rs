//! Booting, failing, stopping and losing chassis, in virtual time.
//!
//! Every app here is simulated, so what a seed shows, it shows every time.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{BootError, BootEvent, End, Observer, Outcome, simulate},
    call::Fault,
    config::{App, load_texts},
    message::{Command, CommandInfo, Message, Replier},
    registry::Registry,
    simulation,
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
ctos::command! {
    /// Keeps the handler busy for ever.
    pub struct Block => (), 3, "block"
}
ctos::command! {
    /// Is answered never, or when it is dropped.
    pub struct Keep => (), 4, "keep"
}

/// What happened, in order, seen from outside: moment, task, what.
type Trace = Arc<Mutex<Vec<(u64, String, String)>>>;

#[derive(Deserialize, Clone, Default)]
#[serde(default, deny_unknown_fields)]
struct Args {
    refuses: Option<String>,
    hangs: Option<String>,
    panics: Option<String>,
    /// Whom to call in phase run, and for what.
    calls: Option<String>,
    command: Option<String>,
    /// Calls so often, and then ends the app.
    rounds: u32,
}

struct Actor {
    args: Args,
    trace: Trace,
    count: u32,
    kept: Vec<Replier<Keep>>,
}

impl Actor {
    fn saw(&self, cx: &Context, what: impl Into<String>) {
        let moment = cx.now().as_nanos();
        let entry = (moment, cx.name().to_owned(), what.into());
        self.trace.lock().unwrap().push(entry);
    }
}

impl Drop for Actor {
    fn drop(&mut self) {
        let entry = (0, String::new(), "dropped".to_owned());
        self.trace.lock().unwrap().push(entry);
    }
}

impl EventHandler for Actor {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Count::CODE => {
                let (Count {}, reply) = message.open::<Count>()?;
                self.count += 1;
                self.saw(cx, format!("count {}", self.count));
                reply.ok(self.count)
            }
            Panic::CODE => panic!("as it was told"),
            Block::CODE => {
                self.saw(cx, "blocked");
                std::future::pending().await
            }
            Keep::CODE => {
                let (Keep {}, reply) = message.open::<Keep>()?;
                self.kept.push(reply);
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        self.saw(cx, format!("enters {phase}"));
        let is = |name: &Option<String>| name.as_deref() == Some(&phase.to_string());
        if is(&self.args.refuses) {
            return Err("the key is not turned".into());
        }
        if is(&self.args.panics) {
            panic!("a fuse blew");
        }
        if is(&self.args.hangs) {
            std::future::pending::<()>().await;
        }
        // Phases take their time, differently for each task.
        let length = u64::try_from(cx.name().len())?;
        cx.sleep(Duration::from_millis(length)).await;
        self.saw(cx, format!("entered {phase}"));
        if phase == Phase::Run && self.args.calls.is_some() {
            cx.spawn(play(cx.clone(), self.args.clone(), self.trace.clone()));
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
}

/// Calls another task as the arguments say, and ends the app when they say so.
async fn play(cx: Context, args: Args, trace: Trace) {
    let Some(to) = args.calls else { return };
    let to = cx.task(&to).await.unwrap();
    let mut answers = Vec::new();
    for _ in 0..args.rounds.max(1) {
        let answer = match args.command.as_deref() {
            Some("panic") => cx.call(&to, Panic {}).await.map(|()| 0),
            Some("block") => cx.call(&to, Block {}).await.map(|()| 0),
            Some("keep") => cx.call(&to, Keep {}).await.map(|()| 0),
            _ => cx.call(&to, Count {}).await,
        };
        let text = match &answer {
            Ok(count) => format!("answer {count}"),
            Err(error) => {
                let gone = matches!(error.fault, Fault::PeerDown { .. });
                format!("{}: {error}", if gone { "gone" } else { "error" })
            }
        };
        let moment = cx.now().as_nanos();
        let name = cx.name().to_owned();
        trace.lock().unwrap().push((moment, name, text.clone()));
        answers.push(text);
    }
    if args.rounds > 0 {
        cx.finish(AppResult {
            ok: true,
            text: answers.join(", "),
            json: String::new(),
        });
    }
}

struct Run {
    outcome: Outcome,
    trace: Vec<(u64, String, String)>,
    events: Vec<String>,
}

impl Run {
    /// Where a task's entry stands in the trace.
    fn at(&self, task: &str, what: &str) -> usize {
        let mut entries = self.trace.iter();
        let found = entries.position(|(_, name, text)| name == task && text.starts_with(what));
        found.unwrap_or_else(|| panic!("no `{what}` of `{task}` in {:#?}", self.trace))
    }

    fn has(&self, task: &str, what: &str) -> bool {
        let mut entries = self.trace.iter();
        entries.any(|(_, name, text)| name == task && text.starts_with(what))
    }

    fn stops(&self) -> Vec<&str> {
        let stops = self
            .trace
            .iter()
            .filter(|entry| entry.2.starts_with("stops"));
        stops.map(|entry| entry.1.as_str()).collect()
    }
}

fn app(text: &str, sets: &[&str]) -> App {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    load_texts(&[("boot.toml", text)], &sets, &[]).unwrap()
}

fn registry(trace: &Trace) -> Registry {
    let mut registry = Registry::new();
    let commands: [CommandInfo; 4] = [Count::INFO, Panic::INFO, Block::INFO, Keep::INFO];
    let trace = trace.clone();
    registry.handler("actor", &commands, move |cx: &Context| {
        let args = cx.args::<Args>()?;
        Ok(Actor {
            args,
            trace: trace.clone(),
            count: 0,
            kept: Vec::new(),
        })
    });
    registry
}

fn try_run(text: &str, sets: &[&str], faults: &[simulation::Fault]) -> Result<Run, BootError> {
    let trace = Trace::default();
    let events: Arc<Mutex<Vec<String>>> = Arc::default();
    let seen = events.clone();
    let observer: Observer = Arc::new(move |event: &BootEvent| {
        seen.lock().unwrap().push(format!("{event:?}"));
    });
    let outcome = simulate(app(text, sets), registry(&trace), faults, &observer)?;
    let trace = trace.lock().unwrap().clone();
    let events = events.lock().unwrap().clone();
    Ok(Run {
        outcome,
        trace,
        events,
    })
}

fn run(text: &str, sets: &[&str], faults: &[simulation::Fault]) -> Run {
    try_run(text, sets, faults).unwrap()
}

/// Three tasks on two chassis; `caller` calls `arm` and ends the app after its rounds.
const APP: &str = r#"
    [app]
    until = "caller"
    phase_timeout_s = 2.0
    stop_timeout_s = 1.0
    [chassis.desk]
    [chassis.cage]
    stop_first = true
    [task.arm]
    handler = "actor"
    on = "cage"
    [task.hand]
    handler = "actor"
    on = "cage"
    [task.caller]
    handler = "actor"
    on = "desk"
    args = { calls = "arm", rounds = 3 }
    [task.clerk]
    handler = "actor"
    on = "desk"
"#;

const TASKS: [&str; 4] = ["arm", "hand", "caller", "clerk"];

fn millis(millis: u64) -> Instant {
    Instant::START + Duration::from_millis(millis)
}

fn finished(run: &Run) -> &str {
    match &run.outcome.end {
        End::Finished(result) if result.ok => &result.text,
        end => panic!("ended with {end:?}: {:#?}", run.trace),
    }
}

#[test]
fn no_task_enters_a_phase_before_all_have_acknowledged_the_one_before() {
    for seed in 0..50 {
        let run = run(APP, &[&format!("app.seed={seed}")], &[]);
        for pair in Phase::ALL.windows(2) {
            for before in TASKS {
                for after in TASKS {
                    let acknowledged = run.at(before, &format!("entered {}", pair[0]));
                    assert!(acknowledged < run.at(after, &format!("enters {}", pair[1])));
                }
            }
        }
        let done = run
            .events
            .iter()
            .filter(|event| event.contains("PhaseDone"));
        assert_eq!(done.count(), 3);
        assert_eq!(finished(&run), "answer 1, answer 2, answer 3");
    }
}

#[test]
fn tasks_stop_in_the_reverse_of_their_creation_and_those_of_the_arm_first() {
    let run = run(APP, &[], &[]);
    assert_eq!(run.stops(), ["hand", "arm", "clerk", "caller"]);
    assert!(
        run.trace
            .iter()
            .any(|entry| entry.2 == "stops: the app has finished")
    );
    // Nothing is kept alive by messages that never arrived.
    let dropped = run.trace.iter().filter(|entry| entry.2 == "dropped");
    assert_eq!(dropped.count(), TASKS.len());
}

#[test]
fn a_task_that_refuses_a_phase_is_named_and_the_boot_is_undone() {
    for refused in Phase::ALL {
        let set = format!("task.hand.args.refuses=\"{refused}\"");
        let run = run(APP, &[&set], &[]);
        let End::PhaseFailed { phase, failures } = &run.outcome.end else {
            panic!("{:?}", run.outcome.end);
        };
        assert_eq!(*phase, refused);
        let expected = ("hand".to_owned(), "the key is not turned".to_owned());
        assert_eq!(*failures, [expected]);
        assert_eq!(run.stops().len(), TASKS.len());
        for later in Phase::ALL.iter().filter(|later| **later > refused) {
            assert!(!run.has("arm", &format!("enters {later}")));
        }
    }
}

#[test]
fn a_task_that_never_acknowledges_a_phase_is_named_after_the_limit_and_stopped() {
    let run = run(APP, &["task.arm.args.hangs=\"connect\""], &[]);
    let End::PhaseFailed { phase, failures } = &run.outcome.end else {
        panic!("{:?}", run.outcome.end);
    };
    assert_eq!(*phase, Phase::Connect);
    assert_eq!(failures.len(), 1);
    assert_eq!(failures[0].0, "arm");
    assert!(
        failures[0].1.contains("within 2.000 s"),
        "{}",
        failures[0].1
    );
    // The stop cancels the phase that hangs.
    assert_eq!(run.stops().len(), TASKS.len());
    assert!(run.outcome.took < Duration::from_secs(3));
}

#[test]
fn a_task_that_panics_in_a_phase_is_named_and_the_boot_is_undone() {
    let run = run(APP, &["task.arm.args.panics=\"create\""], &[]);
    let (task, reason) = match &run.outcome.end {
        End::TaskFailed { task, reason } => (task.clone(), reason.clone()),
        End::PhaseFailed { failures, .. } => failures[0].clone(),
        end => panic!("{end:?}"),
    };
    assert_eq!(task, "arm");
    assert!(reason.contains("a fuse blew"), "{reason}");
    let mut stopped = run.stops();
    stopped.sort_unstable();
    assert_eq!(stopped, ["caller", "clerk", "hand"]);
}

#[test]
fn an_app_whose_tasks_cannot_be_built_says_which() {
    let run = run(APP, &["task.hand.args.colour=\"red\""], &[]);
    let End::PhaseFailed { phase, failures } = &run.outcome.end else {
        panic!("{:?}", run.outcome.end);
    };
    assert_eq!((*phase, failures.len()), (Phase::Create, 1));
    assert_eq!(failures[0].0, "hand");
    assert!(failures[0].1.contains("colour"), "{}", failures[0].1);
    assert!(!run.has("arm", "enters create"));
}

#[test]
fn a_stop_ends_a_handler_that_waits() {
    // `caller` waits for `arm`, which waits for ever; the call's deadline ends the app.
    let sets = [
        "task.caller.args.command=\"block\"",
        "task.caller.args.rounds=1",
        "task.caller.call_deadline_s=0.2",
    ];
    let run = run(APP, &sets, &[]);
    let text = finished(&run);
    assert!(
        text.contains("`arm` did not answer `block` from `caller` within 0.200 s"),
        "{text}"
    );
    assert!(run.at("arm", "blocked") < run.at("arm", "stops"));
    let errors = run
        .events
        .iter()
        .filter(|event| event.contains("Stopped") && event.contains("Some"));
    assert_eq!(errors.count(), 0, "{:#?}", run.events);
}

#[test]
fn a_panic_without_restart_ends_the_app_and_names_the_task() {
    let sets = [
        "task.caller.args.command=\"panic\"",
        "task.caller.args.rounds=0",
    ];
    let run = run(APP, &sets, &[]);
    let End::TaskFailed { task, reason } = &run.outcome.end else {
        panic!("{:?}", run.outcome.end);
    };
    assert_eq!(task, "arm");
    assert!(reason.contains("as it was told"), "{reason}");
    assert!(run.has(
        "caller",
        "error: the handler of `arm` panicked at `panic` from `caller`"
    ));
    assert_eq!(run.stops(), ["hand", "clerk", "caller"]);
}

#[test]
fn a_restarted_task_regains_its_phase_until_the_limit_is_reached() {
    let sets = [
        "task.caller.args.command=\"panic\"",
        "task.caller.args.rounds=3",
        "task.arm.restart=\"always\"",
        "task.arm.max_restarts=2",
    ];
    let run = run(APP, &sets, &[]);
    let End::TaskFailed { task, reason } = &run.outcome.end else {
        panic!("{:?}: {:#?}", run.outcome.end, run.trace);
    };
    assert_eq!(task, "arm");
    assert!(reason.contains("(after 2 restarts)"), "{reason}");
    for phase in Phase::ALL {
        let entered = (String::from("arm"), format!("entered {phase}"));
        let times = run
            .trace
            .iter()
            .filter(|entry| (&entry.1, &entry.2) == (&entered.0, &entered.1));
        assert_eq!(times.count(), 3, "{phase}");
    }
}

#[test]
fn a_panic_in_a_phase_of_a_restart_fails_the_task_and_leaves_nobody_waiting() {
    // The second build panics in its first phase: `panics` is read again by the new handler.
    let text = APP.replace("until = \"caller\"", "");
    let trace = Trace::default();
    let mut registry = Registry::new();
    let built = Arc::new(Mutex::new(0));
    let shared = trace.clone();
    registry.handler("actor", &[Count::INFO, Panic::INFO], move |cx: &Context| {
        let mut args = cx.args::<Args>()?;
        if cx.name() == "arm" {
            let mut built = built.lock().unwrap();
            *built += 1;
            args.panics = (*built > 1).then(|| "create".to_owned());
        }
        let trace = shared.clone();
        Ok(Actor {
            args,
            trace,
            count: 0,
            kept: Vec::new(),
        })
    });
    let sets = [
        "task.arm.restart=\"always\"",
        "task.caller.args.command=\"panic\"",
        "task.caller.args.rounds=0",
    ];
    let outcome = simulate(
        app(&text, &sets),
        registry,
        &[],
        &(Arc::new(|_: &BootEvent| ()) as Observer),
    );
    let End::TaskFailed { task, reason } = outcome.unwrap().end else {
        panic!("{:#?}", trace.lock().unwrap());
    };
    assert_eq!(task, "arm");
    assert!(reason.contains("panicked again: a fuse blew"), "{reason}");
}

#[test]
fn an_app_in_which_nothing_can_happen_any_more_is_stuck() {
    let sets = [
        "task.caller.args.calls=\"arm\"",
        "task.caller.args.rounds=0",
    ];
    assert_eq!(run(APP, &sets, &[]).outcome.end, End::Stuck);
}

#[test]
fn one_seed_is_one_run_and_another_seed_another_interleaving_with_the_same_results() {
    let busy = format!(
        "{APP}\n[task.second]\nhandler = \"actor\"\non = \"desk\"\nargs = {{ calls = \"hand\" }}\n"
    );
    let mut interleavings = Vec::new();
    for seed in 0..20 {
        let set = format!("app.seed={seed}");
        let (one, two) = (run(&busy, &[&set], &[]), run(&busy, &[&set], &[]));
        assert_eq!(one.trace, two.trace);
        assert_eq!(one.events, two.events);
        assert_eq!(one.outcome, two.outcome);
        assert_eq!(finished(&one), "answer 1, answer 2, answer 3");
        let order: Vec<(String, String)> = one
            .trace
            .into_iter()
            .map(|(_, task, what)| (task, what))
            .collect();
        if !interleavings.contains(&order) {
            interleavings.push(order);
        }
    }
    assert!(
        interleavings.len() > 5,
        "{} interleavings",
        interleavings.len()
    );
}

#[test]
fn a_chassis_that_is_killed_ends_the_calls_to_it_and_everybody_left_is_told() {
    let sets = [
        "task.caller.args.command=\"keep\"",
        "task.caller.args.rounds=1",
    ];
    for seed in 0..20 {
        let seed = format!("app.seed={seed}");
        let kill = simulation::Fault::on("cage", simulation::FaultKind::Kill, millis(60));
        let run = run(APP, &[&sets[..], &[&seed]].concat(), &[kill]);
        let call = &run.trace[run.at("caller", "gone")].2;
        assert!(call.contains("chassis `cage` is gone"), "{call}");
        assert!(
            call.contains("`arm`") && call.contains("`caller`"),
            "{call}"
        );
        // The app may end with the caller's result or with the loss, whichever came first.
        match &run.outcome.end {
            End::ChassisDown { chassis } => assert_eq!(chassis, "cage"),
            End::Finished(_) => {}
            end => panic!("{end:?}"),
        }
        assert_eq!(run.stops(), ["clerk", "caller"]);
        // Told by its own chassis, or by the boot if that saw it first and stops it for this reason.
        let told = run.has("clerk", "misses cage");
        assert!(told || run.has("clerk", "stops: chassis `cage` is gone"));
        let casualty = (
            "cage".to_owned(),
            "was killed by signal 9 (SIGKILL)".to_owned(),
        );
        assert_eq!(run.outcome.casualties, [casualty]);
    }
}

#[test]
fn a_kill_at_any_moment_ends_the_app_in_bounded_time() {
    for at in (0..120).step_by(3) {
        for chassis in ["desk", "cage"] {
            let kill =
                simulation::Fault::on(chassis.to_owned(), simulation::FaultKind::Kill, millis(at));
            let run = run(APP, &["task.caller.args.rounds=1000"], &[kill]);
            assert_ne!(run.outcome.end, End::Stuck, "{chassis} at {at} ms");
            assert!(
                run.outcome.took < Duration::from_secs(10),
                "{chassis} at {at} ms"
            );
        }
    }
}

#[test]
fn a_link_that_is_cut_makes_each_end_gone_for_the_other() {
    let cut = simulation::Fault::between("desk", "cage", simulation::FaultKind::Cut, millis(60));
    let sets = [
        "task.caller.args.command=\"keep\"",
        "task.caller.args.rounds=1",
    ];
    let run = run(APP, &sets, &[cut]);
    assert!(finished(&run).starts_with("gone: chassis `cage` is gone"));
    assert!(run.has("clerk", "misses cage"));
    assert!(run.has("hand", "misses desk"));
    // The boot still reaches both, so all of them come to rest.
    assert_eq!(run.stops(), ["hand", "arm", "clerk", "caller"]);
}

#[test]
fn a_chassis_that_loses_the_boot_stops_its_tasks_by_itself() {
    let cut = simulation::Fault::between("boot", "cage", simulation::FaultKind::Cut, millis(60));
    let sets = [
        "task.caller.args.command=\"keep\"",
        "task.caller.args.rounds=0",
    ];
    let run = run(APP, &sets, &[cut]);
    let lost = End::ChassisDown {
        chassis: "cage".to_owned(),
    };
    assert_eq!(run.outcome.end, lost);
    for task in ["hand", "arm"] {
        assert!(
            run.has(task, "stops: chassis `boot` is gone"),
            "{:#?}",
            run.trace
        );
    }
}

#[test]
fn a_link_that_stalls_delays_and_loses_nothing() {
    let stall = simulation::Fault::between("desk", "cage", simulation::FaultKind::Stall, millis(1))
        .until(millis(700));
    let run = run(APP, &[], &[stall]);
    assert_eq!(finished(&run), "answer 1, answer 2, answer 3");
    assert!(run.outcome.took > Duration::from_millis(700));
}

#[test]
fn a_fault_of_an_unknown_chassis_is_refused() {
    let kill = |chassis: &str| {
        simulation::Fault::on(chassis.to_owned(), simulation::FaultKind::Kill, millis(1))
    };
    for chassis in ["crate", "boot"] {
        let refused = try_run(APP, &[], &[kill(chassis)]);
        let error = refused.err().map(|error| error.to_string());
        let expected = format!("there is no chassis `{chassis}` to which a kill could happen");
        assert_eq!(error, Some(expected));
    }
}

#[test]
fn an_observer_that_panics_does_not_take_the_app_with_it() {
    let trace = Trace::default();
    let observer: Observer = Arc::new(|_| panic!("the terminal is closed"));
    let outcome = simulate(app(APP, &[]), registry(&trace), &[], &observer).unwrap();
    assert!(matches!(outcome.end, End::Finished(_)), "{:?}", outcome.end);
}
