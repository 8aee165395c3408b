//! Tasks that break the rules of startup and of stopping: the boot names them and is undone.

use rustix::process::Signal;

use crate::harness::{Ended, MISBEHAVING, Run, Scratch, VIRTUAL};

const APP: &str = r#"
[app]
phase_timeout_s = 5
stop_timeout_s = 1

[chassis.left]

[chassis.right]
processors.main = {}
processors.other = {}

[task.good]
handler = "test.misbehaving"
on = "left"
args = { fault = "nothing", phase = "run" }

[task.bad]
handler = "test.misbehaving"
on = "right/other"
args = { fault = "FAULT", phase = "PHASE" }
"#;

fn app(fault: &str, phase: &str) -> Scratch {
    let scratch = Scratch::empty();
    let text = APP.replace("FAULT", fault).replace("PHASE", phase);
    scratch.write("app.toml", text);
    scratch
}

fn start<'a>(scratch: &'a Scratch, arguments: &[&str]) -> Run<'a> {
    let all = [&["boot", "app.toml"], arguments].concat();
    scratch.start(MISBEHAVING, &all, &[])
}

/// The boot must have been undone because of task `bad` in `phase`, for a reason that says `why`.
fn must_be_undone(ended: &Ended, phase: &str, why: &str) {
    ended
        .must_exit(1)
        .must_say(&format!(
            "startup phase `{phase}` failed and the boot was undone"
        ))
        .must_not_say("task `good`");
    let error = ended.error();
    let line = error.lines().find(|line| line.contains("task `bad`"));
    assert!(
        line.is_some_and(|line| line.contains(why)),
        "{}",
        ended.told
    );
    assert_eq!(ended.stdout, "");
}

#[test]
fn a_task_that_refuses_a_startup_phase_is_named_and_the_boot_undone() {
    for (phase, arguments) in [
        ("create", &VIRTUAL[..]),
        ("connect", &VIRTUAL),
        ("run", &VIRTUAL),
        ("connect", &[]),
    ] {
        let scratch = app("refuse", phase);
        let ended = start(&scratch, arguments).end();
        must_be_undone(&ended, phase, "the hardware does not answer");
    }
}

#[test]
fn a_handler_that_panics_in_a_startup_phase_is_named_and_the_boot_undone() {
    for (phase, arguments) in [
        ("create", &VIRTUAL[..]),
        ("connect", &VIRTUAL),
        ("run", &VIRTUAL),
        ("run", &[]),
    ] {
        let scratch = app("panic", phase);
        let ended = start(&scratch, arguments).end();
        ended.must_exit(1).must_not_say("task `good`");
        let error = ended.error();
        assert!(error.contains("task `bad`"), "{}", ended.told);
        assert!(error.contains("an index out of range"), "{}", ended.told);
        let place = "(at tests/src/misbehaving.rs:";
        assert!(error.contains(place), "{}", ended.told);
        assert_eq!(ended.stdout, "");
    }
}

/// An app in which one task prints a line and another one then ends the boot.
fn printing() -> Scratch {
    let scratch = app("refuse", "run");
    scratch.edit(
        "app.toml",
        r#"fault = "nothing", phase = "run""#,
        r#"fault = "print", phase = "create""#,
    );
    scratch
}

#[test]
fn what_a_handler_prints_stands_in_the_log_with_the_name_of_its_chassis() {
    let scratch = printing();
    let ended = start(&scratch, &["--log-file", "app.log"]).end();
    ended.must_exit(1).must_say("left  │ printed, not logged\n");
    let log = scratch.read("app.log");
    assert!(log.contains("left │ printed, not logged\n"), "{log}");
}

/// Every line is a JSON object; one of them is what the handler has printed.
fn must_be_json(text: &str, told: &str) {
    let objects: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("`{line}`: {told}")))
        .collect();
    let printed = objects
        .iter()
        .find(|object| object["chassis"] == "left" && object["message"] == "printed, not logged");
    assert!(printed.is_some(), "{told}");
}

#[test]
fn a_json_log_holds_json_objects_alone_whatever_it_is_that_speaks() {
    let json = ["--log-format", "json", "-v"];
    let scratch = printing();
    let ended = start(&scratch, &json).end();
    ended.must_exit(1);
    must_be_json(&ended.stderr, &ended.told);

    let scratch = printing();
    let file = ["--log-format", "json", "--detach", "--log-file", "app.log"];
    start(&scratch, &file).end().must_exit(1);
    let log = scratch.read("app.log");
    must_be_json(&log, &log);

    // One that is not started has a finding for each mistake.
    scratch.edit("app.toml", "on = \"left\"", "on = \"loft\"");
    let ended = start(&scratch, &json).end();
    ended.must_exit(3);
    let lines = ended.stderr.lines();
    assert!(
        lines.into_iter().all(|line| line.starts_with('{')),
        "{}",
        ended.told
    );
}

#[test]
fn a_handler_that_never_acknowledges_a_startup_phase_is_named_after_the_time_limit() {
    for (phase, arguments) in [
        ("create", &VIRTUAL[..]),
        ("connect", &VIRTUAL),
        ("run", &VIRTUAL),
        ("create", &["--set", "phase_timeout_s=1"]),
    ] {
        let scratch = app("silence", phase);
        let ended = start(&scratch, arguments).end();
        must_be_undone(&ended, phase, "within");
    }
}

#[test]
fn a_handler_that_blocks_its_processor_cannot_keep_the_app_up() {
    let scratch = app("block", "connect");
    let ended = start(&scratch, &["--set", "phase_timeout_s=1"]).end();
    must_be_undone(&ended, "connect", "within");
}

#[test]
fn a_chassis_that_hangs_is_ended_by_signals_and_named() {
    let scratch = app("nothing", "run");
    let mut run = start(&scratch, &[]);
    run.wait_for("phase 3");
    run.freeze("right");
    run.signal(Signal::INT);
    let ended = run.end();
    ended
        .must_exit(130)
        .must_say("stop     bad is not at rest: ")
        .must_say_before("right does not end: SIGTERM", "right does not end: SIGKILL")
        .must_say("chassis `right` was killed by signal 9 (SIGKILL)");
}

#[test]
fn a_task_that_does_not_come_to_rest_is_named_and_given_up() {
    let scratch = app("silence", "stop");
    let mut run = start(&scratch, &[]);
    run.wait_for("phase 3");
    run.signal(Signal::INT);
    let ended = run.end();
    ended.must_exit(130).must_say("stop     bad: ");
}

#[test]
fn a_second_interrupt_skips_what_does_not_come_to_rest() {
    let scratch = app("silence", "stop");
    // Without the second interrupt the run would outlast the watchdog.
    let mut run = start(&scratch, &["--set", "stop_timeout_s=3600"]);
    run.wait_for("phase 3");
    run.signal(Signal::INT);
    run.wait_for("stop     2 tasks");
    run.signal(Signal::INT);
    let ended = run.end();
    ended
        .must_exit(130)
        .must_say("stop     bad: skipped at a second interrupt")
        .must_say("error: interrupted");
}

#[test]
fn an_app_in_which_nothing_can_ever_happen_again_ends_in_virtual_time() {
    let scratch = app("nothing", "run");
    let ended = start(&scratch, &VIRTUAL).end();
    ended
        .must_exit(1)
        .must_say("every task waits for another one");
}

#[test]
fn a_program_with_its_own_registry_names_its_own_handlers() {
    let scratch = app("nothing", "run");
    scratch.edit("app.toml", "on = \"left\"", "on = \"left\"\nqueue = 7");
    scratch.edit(
        "app.toml",
        "handler = \"test.misbehaving\"\non = \"left\"",
        "handler = \"test.misbehavin\"\non = \"left\"",
    );
    let ended = start(&scratch, &[]).end();
    ended
        .must_exit(3)
        .must_say("did you mean `test.misbehaving`?");
}
