//! `ctos move` between real processes, while others send to the task that moves: every message is
//! counted at both ends.

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Ended, MISBEHAVING, Run, Scratch};

/// Senders on two processes that send to one sink; see `tests/src/load.rs`.
pub const APP: &str = r#"
[app]
name = "load"
until = "judge"
stop_timeout_s = 2

[chassis.desk]
processors.main = {}
processors.side = {}

[chassis.cage]
processors.servo = {}

[task.sink]
handler = "test.sink"
on = "desk/main"

[task.near]
handler = "test.sender"
on = "desk/side"
args = { to = "sink", pause_s = 0.0 }

[task.far]
handler = "test.sender"
on = "cage"
args = { to = "sink", pause_s = 0.0 }

[task.slow]
handler = "test.sender"
on = "cage"
args = { to = "sink", pause_s = 0.0003 }

[task.arm]
handler = "test.steady"
on = "cage"
args = { slow_s = 0.0 }

[task.judge]
handler = "test.judge"
on = "desk/side"
args = { sink = "sink", senders = ["near", "far", "slow"], moves = 1000 }
"#;

pub fn up<'a>(scratch: &'a Scratch, arguments: &[&str]) -> Run<'a> {
    scratch.write("app.toml", APP);
    let all = [&["boot", "app.toml"], arguments].concat();
    let mut run = scratch.start(MISBEHAVING, &all, &[]);
    run.wait_for("phase 3");
    run
}

pub fn ctos(scratch: &Scratch, arguments: &[&str]) -> Ended {
    scratch.start(MISBEHAVING, arguments, &[]).end()
}

/// The last move that the judge waits for is made, though the app may end before its answer is there.
pub fn must_have_moved_at_last(moved: &Ended) {
    assert!(has_moved_at_last(moved), "{}", moved.told);
}

/// Whether it was made.
pub fn has_moved_at_last(moved: &Ended) -> bool {
    let ends = ["the app is being stopped", "the app went away"];
    let ends = ends.iter().any(|end| moved.stderr.contains(end));
    moved.code == Some(0) || ends
}

/// The tasks of this name, as `ctos ps` shows them: name and place.
fn places(scratch: &Scratch, name: &str) -> Vec<String> {
    let app: Value = ctos(scratch, &["ps", "--json"]).json();
    let tasks = app["tasks"].as_array().unwrap().iter();
    tasks
        .filter(|task| task["name"] == name)
        .map(|task| {
            let text = |key: &str| task[key].as_str().unwrap().to_owned();
            format!("{}:{}", text("chassis"), text("processor"))
        })
        .collect()
}

#[test]
fn a_task_moves_between_processes_and_back_under_load_and_every_message_comes_once_and_in_order() {
    let scratch = Scratch::empty();
    let moves = [
        ("cage", "desk:main", "cage:servo"),
        ("desk:side", "cage:servo", "desk:side"),
        ("desk:main", "desk:side", "desk:main"),
        ("cage:servo", "desk:main", "cage:servo"),
        ("desk", "cage:servo", "desk:main"),
    ];
    let set = format!("task.judge.args.moves={}", moves.len());
    let run = up(&scratch, &["--set", &set, "--json"]);
    for (order, from, to) in moves {
        let moved = ctos(&scratch, &["move", "sink", order, "--json"]);
        assert_eq!(moved.code, Some(0), "{}", moved.told);
        let said = moved.json();
        assert_eq!(
            (&said["task"], &said["from"], &said["to"]),
            (&"sink".into(), &from.into(), &to.into()),
            "{said}"
        );
        assert!(said["took_s"].as_f64().unwrap() > 0.0);
        if order != "desk" {
            assert_eq!(places(&scratch, "sink"), [to]);
        }
    }
    let ended = run.end();
    let result = ended.must_exit(0).json();
    let text = result["text"].as_str().unwrap();
    assert!(text.contains("came once and in order"), "{text}");
    assert!(text.ends_with("desk cage desk desk cage desk"), "{text}");
    let count: u64 = text.split_whitespace().nth(1).unwrap().parse().unwrap();
    assert!(count > 100, "no load: {text}");
}

#[test]
fn a_move_that_cannot_be_made_says_why_and_leaves_the_task_where_it_is() {
    let scratch = Scratch::empty();
    let run = up(&scratch, &[]);
    for (arguments, code, words) in [
        (["snk", "cage"], 4, "did you mean `sink`?"),
        (["sink", "cgae"], 4, "did you mean `cage`?"),
        (["sink", "cage:srvo"], 4, "did you mean `cage:servo`?"),
        (["sink", "cage:"], 4, "has no processor ``"),
        (["sink", "boot"], 4, "there are: desk, cage"),
        (["arm", "desk"], 1, "its handler passes no state on"),
    ] {
        let refused = ctos(&scratch, &[&["move"], &arguments[..]].concat());
        assert_eq!(refused.code, Some(code), "{}", refused.told);
        assert!(refused.stderr.contains(words), "{}", refused.told);
    }
    assert_eq!(places(&scratch, "sink"), ["desk:main"]);
    assert_eq!(places(&scratch, "arm"), ["cage:servo"]);
    let stays = ctos(&scratch, &["move", "sink", "desk"]);
    assert_eq!(stays.code, Some(0), "{}", stays.told);
    assert!(stays.stderr.contains("is on desk:main already"));
    assert_eq!(
        ctos(&scratch, &["move", "sink", "cage", "--app", "x"]).code,
        Some(4)
    );
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_move_of_a_busy_task_says_what_keeps_it_and_a_second_one_is_refused() {
    let scratch = Scratch::empty();
    scratch.write("holder.toml", "include = [\"app.toml\"]\n[task.holder]\nhandler = \"test.holder\"\non = \"cage\"\nargs = { holds = \"sink\", time_s = 3.0 }\n");
    scratch.write("app.toml", APP);
    let mut run = scratch.start(MISBEHAVING, &["boot", "holder.toml"], &[]);
    run.wait_for("phase 3");
    let mut first = scratch.start(MISBEHAVING, &["move", "sink", "cage"], &[]);
    first.wait_for("its handler has been at `linger`");
    let second = ctos(&scratch, &["move", "sink", "desk:side"]);
    assert_eq!(second.code, Some(1), "{}", second.told);
    assert!(second.stderr.contains("`sink` is being moved already"));
    let first = first.end();
    assert_eq!(first.code, Some(0), "{}", first.told);
    assert!(
        first
            .stderr
            .contains("moved    sink from desk:main to cage:servo")
    );
    assert_eq!(places(&scratch, "sink"), ["cage:servo"]);
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_task_whose_chassis_is_being_restarted_moves_or_stays_and_is_there_once() {
    let scratch = Scratch::empty();
    let run = up(&scratch, &[]);
    let restart = scratch.start(MISBEHAVING, &["restart", "desk"], &[]);
    let moved = ctos(&scratch, &["move", "sink", "cage"]);
    assert!(matches!(moved.code, Some(0 | 1)), "{}", moved.told);
    if moved.code == Some(1) {
        let why = ["does not run", "stays where it is", "is gone"];
        assert!(
            why.iter().any(|why| moved.stderr.contains(why)),
            "{}",
            moved.told
        );
    }
    let restarted = restart.end();
    assert_eq!(restarted.code, Some(0), "{}", restarted.told);
    // Whichever came first, the task is at one place, which takes orders again.
    assert_eq!(places(&scratch, "sink").len(), 1);
    let again = ctos(&scratch, &["move", "sink", "cage"]);
    assert_eq!(again.code, Some(0), "{}", again.told);
    assert_eq!(places(&scratch, "sink"), ["cage:servo"]);
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_task_that_has_moved_away_is_not_stopped_with_the_chassis_it_left() {
    let scratch = Scratch::empty();
    let mut run = up(&scratch, &[]);
    assert_eq!(ctos(&scratch, &["move", "sink", "cage"]).code, Some(0));
    let before = handled(&scratch, "sink");
    assert_eq!(ctos(&scratch, &["restart", "desk"]).code, Some(0));
    run.wait_for("desk is up again");
    assert_eq!(places(&scratch, "sink"), ["cage:servo"]);
    assert!(handled(&scratch, "sink") >= before, "it began anew");
    // And with the one that it is on now it is.
    assert_eq!(ctos(&scratch, &["restart", "cage"]).code, Some(0));
    run.wait_for("cage is up again");
    assert_eq!(places(&scratch, "sink"), ["cage:servo"]);
    run.signal(Signal::INT);
    run.end().must_exit(130).must_not_say("does not end");
}

/// How many messages a task has handled at its present place.
fn handled(scratch: &Scratch, name: &str) -> u64 {
    let status: Value = ctos(scratch, &["status", name, "--json"]).json();
    status["tasks"][0]["handled"].as_u64().unwrap()
}

#[test]
fn a_move_while_the_app_stops_ends_and_does_not_keep_the_app() {
    let scratch = Scratch::empty();
    let mut run = up(&scratch, &[]);
    run.signal(Signal::INT);
    run.wait_for("stop     the app was interrupted");
    let moved = ctos(&scratch, &["move", "sink", "cage"]);
    assert!(matches!(moved.code, Some(0 | 1 | 5)), "{}", moved.told);
    run.end().must_exit(130).must_not_say("does not end");
}
