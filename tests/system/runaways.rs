//! Objects and handlers that never come to an end: what goes on beside them, who names them, and what ends them.

use std::{fs, io::Write as _, time::Duration};

use rustix::process::Signal;

use crate::{
    harness::{Ended, MISBEHAVING, Run, SCOTT, Scratch},
    inspector::Terminal,
};

const APP: &str = r#"
[app]
name = "runaways"
stop_timeout_s = 2

[chassis.desk]

[chassis.cage]
restart = "on-failure"
processors.main = {}
processors.other = {}

[task.d1]
handler = "sorma.daemon"
on = "desk"

[task.d2]
handler = "sorma.daemon"
on = "cage/main"
"#;

const SPINNING: &str = r#"
[task.spins]
handler = "test.spinning"
on = "cage/other"
"#;

fn up<'a>(scratch: &'a Scratch, tasks: &str) -> Run<'a> {
    scratch.write("app.toml", format!("{APP}{tasks}"));
    let mut run = scratch.start(MISBEHAVING, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    run
}

fn ctos(scratch: &Scratch, arguments: &[&str]) -> Ended {
    scratch.start(MISBEHAVING, arguments, &[]).end()
}

/// Asks until the answer has `text`; the watchdog of a run ends what never comes.
fn until(scratch: &Scratch, line: &str, text: &str) {
    while !scratch.scott(&["-c", line]).stdout.contains(text) {}
}

#[test]
fn a_daemon_goes_on_beside_an_object_that_never_ends_which_is_named_and_ended_by_a_restart() {
    let scratch = Scratch::empty();
    let _run = up(&scratch, "");
    let turning = ["--limit", "4", "-c", "mill@d2 EXEC"];
    let turning = scratch.start(SCOTT, &turning, &[]);
    until(&scratch, "sorm@d2 CTRL -busy", "mill: EXEC of ");
    // Another one that wants the same object does not wait for ever either, whatever its own deadline is.
    let second = scratch.start(SCOTT, &["-c", "mill@d2 EXEC"], &[]);
    let other = scratch.scott(&["-c", "foo@d2 EXEC", "-c", "sorm@d2 CTRL -statistics"]);
    other.must_exit_leaving(0);
    assert!(other.stdout.contains("mill is in a call"), "{}", other.told);
    // The first one hears which object it is, since when, and what ends it.
    let late = turning.end();
    late.must_exit_leaving(6)
        .must_say("no answer of `d2` within 4 s")
        .must_say("mill: EXEC of `")
        .must_say("`ctos restart cage");
    let busy = second.end();
    busy.must_exit_leaving(1)
        .must_say("`mill` is in EXEC of `")
        .must_say("`ctos restart cage` ends it");
    ctos(&scratch, &["restart", "cage"]).must_exit_leaving(0);
    let again = scratch.scott(&["-c", "foo@d2 EXEC", "-c", "sorm@d2 CTRL -busy"]);
    again.must_exit_leaving(0);
    assert!(!again.stdout.contains("mill"), "{}", again.told);
}

#[test]
fn a_person_who_waits_for_a_busy_object_is_told_of_whom_and_what_can_be_done() {
    if !Terminal::can_be_had() {
        return;
    }
    let scratch = Scratch::empty();
    let _run = up(&scratch, "");
    let mut terminal = Terminal::start(&scratch, "runaways");
    terminal.until("scott runaways");
    terminal.keys.write_all(b"mill@d2 EXEC\r").unwrap();
    // Its lines break between words, wherever that is.
    for word in ["waiting:", "`cage`", "mill:", "Ctrl-C", "restart"] {
        terminal.until(word);
    }
    // The way out that was named is one.
    terminal.keys.write_all(b"\x03").unwrap();
    terminal.until("scott runaways");
    terminal.keys.write_all(b"foo@d1 EXEC\r").unwrap();
    terminal.until("dinner in the kitchen");
}

#[test]
fn a_restart_of_a_task_that_never_ends_says_what_it_waits_for_and_offers_what_works() {
    let scratch = Scratch::empty();
    let _run = up(&scratch, SPINNING);
    let ended = ctos(&scratch, &["restart", "spins"]);
    ended
        .must_exit_leaving(6)
        .must_say("for spins: its handler has been at `spin` for ")
        .must_say("`ctos restart cage` restarts its chassis");
    // By now it is plain that nothing else helps.
    while !ctos(&scratch, &["status", "spins"])
        .stdout
        .contains("ctos restart cage")
    {}
    ctos(&scratch, &["restart", "cage"]).must_exit_leaving(0);
    // What comes to an end is restarted as before.
    ctos(&scratch, &["restart", "d2"]).must_exit_leaving(0);
}

#[test]
fn a_daemon_goes_on_beside_an_object_whose_building_never_ends() {
    let scratch = Scratch::empty();
    let _run = up(&scratch, "");
    let building = scratch.start(SCOTT, &["-c", "ruin@d2 EXEC"], &[]);
    until(&scratch, "sorm@d2 CTRL -busy", "ruin: is being built for ");
    let other = scratch.scott(&["-c", "foo@d2 EXEC", "-c", "bar@d2 CTRL -dump"]);
    other.must_exit_leaving(0);
    let busy = building.end();
    busy.must_exit_leaving(1)
        .must_say("`ruin` has been in the making for ")
        .must_say("`ctos restart cage` ends that");
}

#[test]
fn an_app_whose_boot_is_frozen_keeps_no_command_for_ever() {
    let scratch = Scratch::empty();
    let run = up(&scratch, "");
    run.signal(Signal::STOP);
    let commands = [
        &["restart", "d2"][..],
        &["move", "d2", "desk"],
        &["net", "marking", "d2"],
        &["record", "--for", "1s"],
        &["stop"],
    ];
    let late = commands.map(|command| scratch.start(MISBEHAVING, command, &[]));
    for late in late {
        late.end()
            .must_exit_leaving(6)
            .must_say("app `runaways` (pid ")
            .must_say(" s: is its process stopped, or very busy?");
    }
    run.signal(Signal::KILL);
    run.signal(Signal::CONT);
}

/// Two tasks that want the same permit, of which the chassis of the first is frozen until the second has it. How often the
/// first wrote after that.
fn written_by_a_frozen_owner(looks: bool) -> usize {
    let scratch = Scratch::empty();
    let owner = |task: &str, on: &str, more: &str| {
        format!(
            "[task.{task}]\nhandler = \"test.owner\"\non = \"{on}\"\nargs = {{ file = \"{task}\", looks = {looks}{more} }}\n"
        )
    };
    let app = "[app]\nuntil = \"second\"\npeer_timeout_s = 1.0\nstop_timeout_s = 30\n[chassis.desk]\n[chassis.cage]\nrestart = \"on-failure\"\n";
    let tasks = owner("first", "cage", "") + &owner("second", "desk", ", after = \"first\"");
    scratch.write("app.toml", app.to_owned() + &tasks);
    let mut run = scratch.start(MISBEHAVING, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    let written = || {
        fs::read_to_string(scratch.path("first"))
            .unwrap_or_default()
            .lines()
            .count()
    };
    while written() == 0 {
        run.hold(Duration::from_millis(10));
    }
    run.freeze("cage");
    run.wait_for("has permit 2");
    let before = written();
    run.resume("cage");
    // It ends by itself, long before the boot would end it.
    let why = run.line_with("given up: ");
    assert!(
        why.contains("peer_timeout_s = 1: this chassis ends"),
        "{why}"
    );
    run.wait_for("failed   cage ended with exit code 6");
    let after = written() - before;
    run.wait_for("cage is up again");
    scratch.write("enough", "");
    let ended = run.end();
    ended.must_exit(0).must_not_say("SIGKILL");
    after
}

#[test]
fn an_owner_that_was_frozen_and_given_up_writes_nothing_more_that_it_looks_at_the_clock_for() {
    // It may have been frozen between the two.
    let written = written_by_a_frozen_owner(true);
    assert!(written <= 1, "{written} times");
}

#[test]
fn an_owner_that_was_frozen_and_given_up_is_ended_at_once_though_it_asks_for_nothing() {
    // Each takes a millisecond; the process went on for a second before it ended.
    let written = written_by_a_frozen_owner(false);
    assert!(written < 100, "{written} times");
}
