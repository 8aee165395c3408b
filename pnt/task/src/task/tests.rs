//! Whole apps of nets in virtual time, over several chassis.

mod by_hand;
mod lines;
mod objects;
mod placement;
mod seen_and_asked;
mod stopping;
mod survival;
mod tapes;

use std::{cell::RefCell, sync::Arc, time::Duration};

use ctos::{
    boot::{self, End, Launcher},
    config::{self, App},
    diagnostic::Source,
    registry::Registry,
    system::AppResult,
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::library::{Action, Later};
use pnt_language::compile;

const DISPATCHER: &str = include_str!("../../../tests/nets/dispatcher.net");
const VISION: &str = include_str!("../../../tests/nets/vision.net");
const MOTION: &str = include_str!("../../../tests/nets/motion.net");

/// An app whose tasks are given as `(name, chassis)`, each with a handler of its own name.
fn app(tasks: &[(&str, &str)], seed: u64) -> App {
    use std::fmt::Write as _;
    let mut text = format!(
        "[app]\nname = \"test\"\nuntil = \"operator\"\nseed = {seed}\n[time]\nmode = \"virtual\"\n"
    );
    let mut chassis: Vec<&str> = tasks.iter().map(|(_, chassis)| *chassis).collect();
    chassis.sort_unstable();
    chassis.dedup();
    for name in chassis {
        let _ = writeln!(text, "[chassis.{name}]");
    }
    for (name, chassis) in tasks {
        let _ = writeln!(
            text,
            "[task.{name}]\nhandler = \"{name}\"\non = \"{chassis}\""
        );
    }
    config::load_texts(&[("app.toml", &text)], &[], &[]).unwrap_or_else(|f| panic!("{f}"))
}

fn register_net<S: 'static>(
    registry: &mut Registry,
    text: &'static str,
    library: impl Fn() -> Library<S> + Send + Sync + 'static,
) {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    let name = net.name().to_owned();
    registry.handler(&name, &COMMANDS, move |cx| {
        Ok(NetTask::new(
            cx,
            net.clone(),
            library(),
            Conflicts::Declared,
            None,
        ))
    });
}

/// Puts commands on the tape of a net, one after the other, and ends the app with what comes back.
struct Operator {
    net: &'static str,
    commands: Vec<&'static str>,
}

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, net, commands) = (cx.clone(), self.net, self.commands.clone());
            cx.spawn(async move {
                let result = operate(&child, net, &commands).await;
                let (ok, text) = match result {
                    Ok(text) => (true, text),
                    Err(error) => (false, error.to_string()),
                };
                child.finish(AppResult {
                    ok,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

/// The answers, then the final snapshot's firings and marked places, line by line.
async fn operate(cx: &Context, net: &str, commands: &[&str]) -> Result<String, HandlerError> {
    let to = cx.task(net).await?;
    let mut lines = Vec::new();
    for command in commands {
        let put = PutTape {
            symbol: (*command).to_owned(),
            arguments: vec!["3".to_owned()],
        };
        let answer = cx
            .call(&to, put)
            .deadline(Duration::from_secs(3600))
            .await?;
        lines.push(format!("answer {} [{}]", answer.symbol, answer.text));
    }
    let snapshot = cx.call(&to, Marking {}).await?;
    for (place, tokens) in snapshot.places.iter().filter(|(_, tokens)| *tokens > 0) {
        lines.push(format!("{place} {tokens}"));
    }
    for event in &snapshot.events {
        lines.push(format!(
            "{} {} {}",
            event.at_ns, event.transition, event.phase
        ));
    }
    Ok(lines.join("\n"))
}

fn register_operator(registry: &mut Registry, net: &'static str, commands: &[&'static str]) {
    let commands = commands.to_vec();
    registry.handler("operator", &[], move |_| {
        Ok(Operator {
            net,
            commands: commands.clone(),
        })
    });
}

fn run(app: App, registry: Registry) -> Result<String, String> {
    let launcher = Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    };
    let observer: boot::Observer = Arc::new(|_| {});
    match boot::boot(app, registry, &launcher, &observer).unwrap().end {
        End::Finished(AppResult { ok: true, text, .. }) => Ok(text),
        End::Finished(AppResult { text, .. }) => Err(text),
        other => Err(format!("{other:?}")),
    }
}

#[derive(Default)]
struct Loop {
    left: u32,
}

fn dispatcher_library() -> Library<Loop> {
    Library::new(Loop::default())
        .action("init_calib", |a: Action<Loop>| async move {
            let count = a.arguments().first().map_or(Ok(0), |text| text.parse())?;
            a.with_state(|state| state.left = count);
            Ok(())
        })
        .action("read_next_pos", |a: Action<Loop>| async move {
            a.with_state(|state| state.left -= 1);
            Ok(())
        })
        .action("calibrate", |a: Action<Loop>| async move {
            a.cx().sleep(Duration::from_secs(1)).await;
            a.note("rms 0.2 px");
            Ok(())
        })
        .enabling("more_positions", |state| state.left > 0)
}

fn slow(duration: Duration) -> impl Fn(Action<()>) -> Later<Handled> {
    move |a| {
        Box::pin(async move {
            a.cx().sleep(duration).await;
            Ok(())
        })
    }
}

ctos::command! {
    /// Follows a path.
    struct Follow => (), 0x0301, "follow"
}

/// The case study over three chassis; `seed` decides the order of everything that may be reordered.
fn case_study(seed: u64, vision: fn() -> Library<()>) -> Result<String, String> {
    let tasks = [
        ("operator", "ws1"),
        ("dispatcher", "ws1"),
        ("vision", "cage_vision"),
        ("motion", "cage_motion"),
        ("mcs", "cage_motion"),
    ];
    let mut registry = Registry::new();
    register_operator(&mut registry, "dispatcher", &["calibrate_camera"]);
    register_net(&mut registry, DISPATCHER, dispatcher_library);
    register_net(&mut registry, VISION, vision);
    let motion = MOTION.replace("(path -> reached)", "");
    register_net(&mut registry, motion.leak(), || {
        Library::new(())
            .action("validate_path", slow(Duration::from_millis(1)))
            .action("plan_path", slow(Duration::from_millis(20)))
            .action("find_pos", slow(Duration::from_millis(5)))
            .enabling("path_given", |()| false)
    });
    registry.function::<Follow, _, _>("mcs", |cx, Follow {}| async move {
        cx.sleep(Duration::from_secs(2)).await;
        Ok(())
    });
    run(app(&tasks, seed), registry)
}

fn good_vision() -> Library<()> {
    Library::new(()).action("find_spot", slow(Duration::from_millis(300)))
}

#[test]
fn the_case_study_runs_over_three_chassis_and_comes_back_to_rest() {
    let text = case_study(1, good_vision).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("answer calibration_done [rms 0.2 px]"));
    let count = |what: &str| text.lines().filter(|line| line.ends_with(what)).count();
    assert_eq!(count("end_move_robot fired"), 3);
    assert_eq!(count("loop_again fired"), 2);
    assert_eq!(count("loop_done fired"), 1);
    for place in [
        "robot_available 1",
        "camera_available 1",
        "SI_motion 1",
        "SI_vision 1",
    ] {
        assert!(text.lines().any(|line| line == place), "{place} in\n{text}");
    }
    let marked = text
        .lines()
        .skip(1)
        .take_while(|line| line.split(' ').count() == 2)
        .count();
    assert_eq!(marked, 4, "{text}");
}

#[test]
fn every_order_of_messages_and_actions_leads_back_to_rest() {
    for seed in 0..40 {
        let text = case_study(seed, good_vision).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        assert!(
            text.starts_with("answer calibration_done"),
            "seed {seed}: {text}"
        );
    }
}

#[test]
fn find_spot_and_find_pos_run_at_the_same_time() {
    let text = case_study(1, good_vision).unwrap();
    let position = |what: &str| text.lines().position(|line| line.ends_with(what)).unwrap();
    assert!(position("start_find_pos fired") < position("end_find_spot fired"));
    assert!(position("start_find_spot fired") < position("end_find_pos fired"));
}

#[test]
fn the_same_seed_gives_the_same_firings_at_the_same_times() {
    assert_eq!(case_study(5, good_vision), case_study(5, good_vision));
}

#[test]
fn a_failed_request_takes_the_failure_branches_of_both_nets() {
    let text = case_study(2, || {
        Library::new(()).action("find_spot", |_| async { Err("no spot in sight".into()) })
    })
    .unwrap();
    assert!(text.starts_with("answer calibration_done"));
    assert_eq!(
        text.lines()
            .filter(|line| line.ends_with("fail_find_spot fired"))
            .count(),
        3
    );
}

#[test]
fn an_action_that_takes_longer_than_its_limit_has_failed() {
    let text = case_study(3, || {
        Library::new(()).action("find_spot", slow(Duration::from_secs(86_400)))
    })
    .unwrap();
    assert_eq!(
        text.lines()
            .filter(|line| line.ends_with("fail_find_spot fired"))
            .count(),
        3
    );
}

/// One net with one command, and an operator.
fn alone(
    net: &'static str,
    command: &'static str,
    library: impl Fn() -> Library<()> + Send + Sync + 'static,
) -> Result<String, String> {
    let mut registry = Registry::new();
    register_operator(&mut registry, "n", &[command]);
    register_net(&mut registry, net, library);
    run(app(&[("operator", "a"), ("n", "b")], 1), registry)
}

const WORK: &str = "net n
place free = 1, done
command go -> gone
transition work
  in free
  tape go
  do work
  out done
transition answer
  in done
  out free
  write gone
";

#[test]
fn a_command_that_the_net_does_not_take_is_refused_at_once_with_those_it_takes() {
    let error = alone(WORK, "stop", || Library::new(())).unwrap_err();
    assert!(
        error.contains("net `n` takes no command `stop`; it takes: go"),
        "{error}"
    );
}

#[test]
fn a_net_that_takes_no_commands_answers_each_with_that() {
    let text = "net n\nplace p = 1\ntransition t\n  in p\n  out p\n  time 1 s\n";
    let error = alone(text, "go", || Library::new(())).unwrap_err();
    assert!(error.contains("it takes: none"), "{error}");
}

#[test]
fn an_action_without_failure_branch_is_tried_again_and_then_the_net_gives_up_aloud() {
    let library = |failures: u32| {
        let tried = RefCell::new(0);
        Library::new(()).action("work", move |_: Action<()>| {
            let try_number = *tried.borrow();
            *tried.borrow_mut() += 1;
            async move {
                if try_number < failures {
                    Err("lamp is off".into())
                } else {
                    Ok(())
                }
            }
        })
    };
    let text = alone(WORK, "go", move || library(2)).unwrap();
    assert!(
        text.starts_with("answer gone [work: lamp is off\nwork: lamp is off]"),
        "{text}"
    );
    let error = alone(WORK, "go", move || library(u32::MAX)).unwrap_err();
    assert!(
        error.contains("net `n` has stopped: transition `work` failed 4 times: lamp is off"),
        "{error}"
    );
}

#[test]
fn timed_transitions_of_a_running_net_fire_when_their_time_is_over() {
    let net = "net n
place rest = 1, left, right, both
command go -> gone
transition begin\n  in rest\n  tape go\n  out left, right
transition quick\n  in left\n  out both\n  time 2 s
transition loses\n  in left\n  out both\n  time 3 s
transition slow\n  in right\n  out both\n  time 5 s
transition end\n  in both*2\n  out rest\n  write gone
";
    let text = alone(net, "go", || Library::new(())).unwrap();
    let fired: Vec<(u64, &str)> = text
        .lines()
        .filter_map(|line| line.strip_suffix(" fired")?.split_once(' '))
        .map(|(at_ns, transition)| (at_ns.parse().unwrap(), transition))
        .collect();
    let began = fired[0].0;
    let since: Vec<(u64, &str)> = fired.iter().map(|(at, name)| (at - began, *name)).collect();
    let expected = [
        (0, "begin"),
        (2_000_000_000, "quick"),
        (5_000_000_000, "slow"),
        (5_000_000_000, "end"),
    ];
    assert_eq!(since, expected);
}

#[test]
fn a_net_that_fires_in_a_circle_is_stopped_and_says_so() {
    let circle = "net n\nplace a = 1, b\ncommand go -> gone\ntransition there\n  in a\n  out b\ntransition back\n  in b\n  out a\ntransition never\n  in a*2\n  tape go\n  out a\n  write gone\n";
    let error = alone(circle, "go", || Library::new(())).unwrap_err();
    assert!(
        error.contains("fire in a circle without any action"),
        "{error}"
    );
}

#[test]
fn a_function_that_the_library_lacks_stops_the_net_with_its_name() {
    let error = alone(WORK, "go", || Library::new(())).unwrap_err();
    assert!(error.contains("no local function `work`"), "{error}");
}

#[test]
fn a_token_that_cannot_be_carried_stops_the_net_and_tells_the_caller() {
    let net = "net n\nplace free = 1\ncommand go -> gone\ntransition work\n  in free\n  tape go\n  out there@nowhere\ntransition never\n  in free*2\n  write gone\n";
    let error = alone(net, "go", || Library::new(())).unwrap_err();
    assert!(
        error
            .contains("a token could not be carried to net `nowhere`: no task is called `nowhere`"),
        "{error}"
    );
}

#[test]
fn a_token_for_a_place_that_the_other_net_lacks_stops_the_sender() {
    let mut registry = Registry::new();
    register_operator(&mut registry, "n", &["go"]);
    register_net(
        &mut registry,
        "net n\nplace free = 1\ncommand go -> gone\ntransition work\n  in free\n  tape go\n  out lost@m\ntransition never\n  in free*2\n  write gone\n",
        || Library::new(()),
    );
    register_net(
        &mut registry,
        "net m\nplace found = 1\ntransition t\n  in found\n",
        || Library::new(()),
    );
    let error = run(
        app(&[("operator", "a"), ("n", "b"), ("m", "c")], 1),
        registry,
    )
    .unwrap_err();
    assert!(error.contains("net `m` has no place `lost`"), "{error}");
}

/// Keeps objects and a log of what it was asked, in order.
#[derive(Default)]
struct Memory {
    objects: RefCell<std::collections::BTreeMap<String, Vec<u8>>>,
    log: RefCell<Vec<String>>,
}

impl DataStore for Memory {
    fn get(&self, _cx: &Context, object: &str) -> Later<Result<Vec<u8>, HandlerError>> {
        self.log.borrow_mut().push(format!("get {object}"));
        let found = self.objects.borrow().get(object).cloned();
        Box::pin(async move { found.ok_or_else(|| HandlerError::new("no such object")) })
    }

    fn put(&self, _cx: &Context, objects: Vec<(String, Vec<u8>)>) -> Later<Handled> {
        for (object, bytes) in objects {
            self.log.borrow_mut().push(format!("put {object}"));
            self.objects.borrow_mut().insert(object, bytes);
        }
        Box::pin(async { Ok(()) })
    }

    fn validity(&self, _cx: &Context, object: &str, valid: bool) -> Later<Handled> {
        self.log.borrow_mut().push(format!(
            "{object} is {}",
            if valid { "valid" } else { "invalid" }
        ));
        Box::pin(async { Ok(()) })
    }
}

ctos::command! {
    /// Doubles a number.
    struct Double { number: u32 } => u64, 0x0001, "double"
}

#[test]
fn a_message_action_carries_data_objects_whose_validity_follows_their_places() {
    let text = "net n
place free = 1, asked data question, answered data answer
command go -> gone
transition begin
  in free
  tape go
  do begin
  out asked
transition double
  in asked
  send doubler.double(question -> answer)
  out answered
transition end
  in answered
  do end
  out free
  write gone
";
    let net = compile::net(&Source::new("n.net", text)).unwrap();
    let mut registry = Registry::new();
    register_operator(&mut registry, "n", &["go"]);
    registry.function::<Double, _, _>("doubler", |_, double| async move {
        Ok(u64::from(double.number) * 2)
    });
    registry.handler("n", &COMMANDS, move |cx| {
        let memory = Rc::new(Memory::default());
        let kept = Rc::clone(&memory);
        let library = Library::new(())
            .action("begin", |a: Action<()>| async move {
                let bytes = ctos::message::Data::of(Double { number: 21 }).into_bytes()?;
                a.put_data("question", bytes).await
            })
            .action("end", move |a: Action<()>| {
                let kept = Rc::clone(&kept);
                async move {
                    let bytes = ctos::message::Data::Bytes(a.get_data("answer").await?);
                    a.note(format!("{}", bytes.take::<u64>()?));
                    a.note(kept.log.borrow().join(", "));
                    Ok(())
                }
            });
        Ok(NetTask::new(
            cx,
            net.clone(),
            library,
            Conflicts::Declared,
            Some(memory),
        ))
    });
    let text = run(
        app(&[("operator", "a"), ("n", "a"), ("doubler", "b")], 1),
        registry,
    )
    .unwrap();
    let expected = "answer gone [42\nput question, question is valid, get question, put answer, answer is valid, question is invalid, get answer]";
    assert!(text.starts_with(expected), "{text}");
}
