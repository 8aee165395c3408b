//! Objects and handlers that never come to an end: what goes on beside them, who names them, and what ends them.

use crate::harness::{Ended, MISBEHAVING, Run, SCOTT, Scratch};

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
    // Another one that wants the same object does not wait for ever either, whatever its own limit is.
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
