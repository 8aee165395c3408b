//! Faults of the machine and of its users, on real processes: too many tasks for one processor, a
//! configuration that changes under a running app. Also a process that is stopped and resumes.

use std::{fmt::Write as _, time::Duration};

use rustix::process::Signal;

use crate::harness::{MISBEHAVING, Scratch};

/// An app of tasks that do nothing, all on one processor.
fn crowd(count: usize) -> Scratch {
    let mut text = String::from(
        "[app]\nphase_timeout_s = 60\nstop_timeout_s = 5\n[chassis.one]\n[chassis.two]\n\
         [task.other]\nhandler = \"test.misbehaving\"\non = \"two\"\n\
         args = { fault = \"nothing\", phase = \"run\" }\n",
    );
    for number in 0..count {
        let _ = write!(
            text,
            "[task.t{number}]\nhandler = \"test.misbehaving\"\non = \"one\"\n\
             args = {{ fault = \"nothing\", phase = \"run\" }}\n"
        );
    }
    let scratch = Scratch::empty();
    scratch.write("app.toml", text);
    scratch
}

#[test]
fn ten_thousand_tasks_on_one_processor_start_and_stop_in_order() {
    let scratch = crowd(10_000);
    let mut run = scratch.start(MISBEHAVING, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    run.signal(Signal::INT);
    let ended = run.end();
    ended
        .must_exit(130)
        .must_say("10001/10001")
        .must_not_say("does not end");
    // Only a task that did not stop is named; all names begin with `t` and a digit.
    for digit in 0..10 {
        ended.must_not_say(&format!("stop     t{digit}"));
    }
}

#[test]
fn ten_thousand_tasks_on_one_processor_run_in_virtual_time() {
    let scratch = crowd(10_000);
    let arguments = ["sim", "app.toml", "--for", "10", "--json"];
    let ended = scratch.start(MISBEHAVING, &arguments, &[]).end();
    ended.must_exit(0).must_say("10001/10001");
    let run = ended.json();
    assert_eq!(run["ok"], true);
    // They stop one after the other, each after a round trip of 0.3 ms at most.
    assert!(run["took_s"].as_f64().unwrap() < 13.0, "{run}");
}

#[test]
fn a_configuration_that_is_edited_while_the_app_runs_changes_nothing() {
    let scratch = crowd(1);
    let mut run = scratch.start(MISBEHAVING, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    scratch.write("app.toml", "this is [not a configuration");
    run.signal(Signal::INT);
    let ended = run.end();
    ended
        .must_exit(130)
        .must_say("stop     the app was interrupted")
        .must_not_say("does not end")
        .must_not_say("app.toml:");
}

#[test]
fn a_process_that_is_stopped_and_goes_on_within_the_peer_time_out_goes_on_as_if_nothing_had_been() {
    let scratch = Scratch::short();
    let mut run = scratch.start_boot(&["--json"]);
    run.wait_for("1 of ");
    run.freeze("cage_vision");
    run.hold(Duration::from_millis(400));
    run.resume("cage_vision");
    let ended = run.end();
    assert_eq!(ended.must_exit(0).json()["ok"], true);
}
