//! Processes that die and interrupts, in mid-run on the real clock: nothing hangs, nobody is left, and the
//! arm is stopped first.

use rustix::process::Signal;

use crate::harness::{Ended, Run, Scratch};

/// What the servo says when it stops the arm because somebody is gone.
const ARM_STOPPED: &str = "the arm is stopped";

/// Boots and waits until the arm is on its way to the second position.
fn in_mid_run<'a>(scratch: &'a Scratch, arguments: &[&str]) -> Run<'a> {
    let mut run = scratch.start_boot(arguments);
    run.wait_for("1 of ");
    assert_eq!(run.chassis.len(), 3);
    run
}

fn kill(scratch: &Scratch, chassis: &str) -> Ended {
    let run = in_mid_run(scratch, &["--json"]);
    run.kill(chassis);
    let ended = run.end();
    ended.must_exit(1);
    for process in ended.chassis.values() {
        assert!(process.ends(), "{}", ended.told);
    }
    let error = format!("chassis `{chassis}` was killed by signal 9 (SIGKILL)");
    assert!(ended.error().contains(&error), "{}", ended.told);
    let result = ended.json();
    assert_eq!(result["ok"], false);
    assert!(result["reason"].as_str().unwrap().contains(&error));
    assert!(scratch.results().is_empty(), "results of a run that failed");
    // The boot would report what does not come to rest, and end it by a signal.
    ended
        .must_not_say("stop     servo")
        .must_not_say("does not end");
    let stop = format!("stop     chassis `{chassis}` is gone");
    let after = ended.told.split_once(&stop).unwrap().1;
    assert!(
        !after.contains("run      "),
        "progress after the end: {after}"
    );
    ended
}

#[test]
fn when_the_vision_chassis_is_killed_the_arm_is_stopped_and_the_run_ends_with_its_name() {
    let scratch = Scratch::new();
    kill(&scratch, "cage_vision")
        .must_say_before(ARM_STOPPED, "error: chassis `cage_vision`")
        .must_say_before(
            "stop     cage_motion is at rest",
            "error: chassis `cage_vision`",
        );
}

#[test]
fn when_the_coordination_chassis_is_killed_the_arm_is_stopped_and_the_run_ends_with_its_name() {
    let scratch = Scratch::new();
    kill(&scratch, "ws1")
        .must_say_before(ARM_STOPPED, "error: chassis `ws1`")
        .must_say_before("stop     cage_motion is at rest", "error: chassis `ws1`");
}

#[test]
fn when_the_motion_chassis_is_killed_the_run_ends_with_its_name() {
    let scratch = Scratch::new();
    kill(&scratch, "cage_motion");
}

#[test]
fn when_the_boot_is_killed_all_chassis_end_by_themselves() {
    let scratch = Scratch::new();
    let run = in_mid_run(&scratch, &[]);
    run.signal(Signal::KILL);
    let ended = run.end();
    assert_eq!(ended.signal, Some(9));
    for (name, process) in &ended.chassis {
        assert!(process.ends(), "chassis {name} still runs");
    }
    assert!(scratch.processes().is_empty());
}

#[test]
fn an_interrupt_in_mid_run_stops_the_app_in_order() {
    let scratch = Scratch::new();
    let run = in_mid_run(&scratch, &["--json"]);
    run.signal(Signal::INT);
    let ended = run.end();
    ended
        .must_exit(130)
        .must_say_before("stop     the app was interrupted", "error: interrupted")
        .must_not_say("does not end")
        .must_not_say("panicked")
        .must_not_say("chassis `");
    assert_eq!(ended.json()["ok"], false);
    assert!(
        scratch.results().is_empty(),
        "results of a run that was interrupted"
    );
}

#[test]
fn a_termination_signal_stops_the_app_in_order_too() {
    let scratch = Scratch::new();
    let run = in_mid_run(&scratch, &[]);
    run.signal(Signal::TERM);
    let ended = run.end();
    ended
        .must_exit(143)
        .must_say("stop     the app was interrupted")
        .must_not_say("does not end");
}

#[test]
fn two_interrupts_in_mid_run_leave_no_process() {
    let scratch = Scratch::new();
    let mut run = in_mid_run(&scratch, &[]);
    run.signal(Signal::INT);
    run.wait_for("stop     the app was interrupted");
    run.signal(Signal::INT);
    run.end().must_exit(130).must_say("error: interrupted");
}

#[test]
fn an_interrupt_while_the_app_starts_leaves_no_process() {
    let scratch = Scratch::new();
    let mut run = scratch.start_boot(&[]);
    run.wait_for("cage_vision");
    run.signal(Signal::INT);
    run.end().must_exit(130).must_say("interrupted");
}
