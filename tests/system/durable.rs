//! Tasks and service objects whose state survives their processes, with real processes that are killed.

use std::time::Duration;

use crate::harness::{CTOS, Ended, MISBEHAVING, Run, Scratch};

const APP: &str = r#"
[app]
until = "counting"

[chassis.desk]

[chassis.cage]
restart = "on-failure"
restart_window_s = 0.01
restart_backoff_s = 0.01

[task.counting]
handler = "test.counting"
on = "desk"

[task.tally]
handler = "test.tally"
on = "cage"
state = "durable"
"#;

/// How often the chassis of the durable task is killed; a campaign does so more often.
fn rounds() -> u64 {
    let rounds = std::env::var("CTOS_MOMENTS").ok();
    rounds.map_or(12, |rounds| rounds.parse().unwrap())
}

fn start(scratch: &Scratch) -> Run<'_> {
    scratch.start(MISBEHAVING, &["boot", "app.toml"], &[])
}

/// The first and the last number of a run.
fn counted(ended: &Ended) -> (u64, u64) {
    ended.must_exit(0);
    let words: Vec<&str> = ended.stdout.split_whitespace().collect();
    let ["from", first, "to", last] = words[..] else {
        panic!("{}", ended.told)
    };
    (first.parse().unwrap(), last.parse().unwrap())
}

#[test]
fn a_task_that_is_killed_loses_no_count_that_it_answered_and_the_next_boot_goes_on_with_it() {
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    let mut run = start(&scratch);
    run.wait_for("phase 3");
    for round in 0..rounds() {
        // At another moment of a count each time.
        run.hold(Duration::from_micros(20_000 + 1_300 * (round % 40)));
        run.kill("cage");
        run.wait_for("restart  cage is up again");
    }
    scratch.write("enough", "");
    let (first, last) = counted(&run.end());
    assert_eq!(first, 0);
    assert!(last > rounds(), "{last}");
    assert!(scratch.path("state/tally.task.redb").exists());
    let (first, _) = counted(&start(&scratch).end());
    assert_eq!(first, last);
}

#[test]
fn a_damaged_store_of_a_task_is_refused_by_its_name_and_kept() {
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    scratch.write("enough", "");
    counted(&start(&scratch).end());
    let file = "state/tally.task.redb";
    let whole = std::fs::read(scratch.path(file)).unwrap();
    let torn = &whole[..whole.len() / 3];
    scratch.write(file, torn);
    start(&scratch)
        .end()
        .must_exit(1)
        .must_say("tally")
        .must_say("state/tally.task.redb cannot be read as a store")
        .must_say("move it away to begin afresh");
    assert_eq!(std::fs::read(scratch.path(file)).unwrap(), torn);
}

#[test]
fn a_task_whose_handler_has_no_state_to_store_is_refused_with_what_to_do() {
    let scratch = Scratch::new();
    scratch.edit(
        "configs/calibrate.toml",
        "[task.referee]\n",
        "[task.referee]\nstate = \"durable\"\n",
    );
    scratch
        .start(CTOS, &["check", "configs/calibrate.toml"], &[])
        .end()
        .must_exit(3)
        .must_say("the state of task `referee` cannot be durable")
        .must_say("Registry::durable");
}

#[test]
fn what_ctrl_changed_of_an_object_survives_the_kill_of_its_daemon_and_the_next_boot() {
    let scratch = Scratch::new();
    scratch.edit(
        "configs/objects.toml",
        "[task.d2]\n",
        "[task.d2]\nstate = \"durable\"\n",
    );
    let boot = || scratch.start(CTOS, &["boot", "configs/objects.toml"], &[]);
    let dumped = || {
        let dump = scratch.scott(&["objects", "-c", "foo.b@d2 CTRL -dump"]);
        dump.must_exit_leaving(0).stdout.clone()
    };
    let mut run = boot();
    run.wait_for("phase 3");
    let change = "foo.b@d2 CTRL -where kitchen";
    scratch
        .scott(&["objects", "-c", change])
        .must_exit_leaving(0);
    let before = dumped();
    assert!(before.contains("kitchen"), "{before}");
    run.kill("cage");
    run.wait_for("restart  cage is up again");
    assert_eq!(dumped(), before);
    run.signal(rustix::process::Signal::INT);
    run.end();
    let mut run = boot();
    run.wait_for("phase 3");
    assert_eq!(dumped(), before);
    run.signal(rustix::process::Signal::INT);
    run.end();
}
