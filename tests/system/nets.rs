//! Durable nets in real processes that are killed: no token is lost or doubled, and a boot goes on where
//! the last one was. And the commands that intervene in a running net.

use std::time::Duration;

use rustix::process::Signal;

use crate::harness::{Ended, MISBEHAVING, Run, Scratch};

const NETS: [(&str, &str); 3] = [
    (
        "a",
        "net a\nplace src = 8\ntransition forth\n  in src\n  do work\n  out mid@b\n  fail src\n",
    ),
    (
        "b",
        "net b\nplace mid\ntransition pass\n  in mid\n  do work\n  idempotent\n  out far@c\n",
    ),
    (
        "c",
        "net c\nplace far\ntransition back\n  in far\n  do work\n  out src@a\n  fail far\n",
    ),
];

/// Three nets, each in a process that comes back; and who counts their tokens.
pub fn app(scratch: &Scratch, more: &str) {
    let mut text = "[app]\nname = \"ring\"\nuntil = \"counter\"\nstop_timeout_s = 2\n[chassis.desk]\n[task.counter]\nhandler = \"test.counter\"\non = \"desk\"\nargs = { nets = [\"a\", \"b\", \"c\"], when = \"enough\" }\n".to_owned();
    for (name, net) in NETS {
        scratch.write(&format!("{name}.net"), net);
        text.push_str(&format!(
            "[chassis.on_{name}]\nrestart = \"always\"\nmax_restarts = 100\nrestart_backoff_s = 0.01\n[task.{name}]\nhandler = \"test.net\"\non = \"on_{name}\"\nargs = {{ net = \"{name}.net\", {more} }}\n"
        ));
    }
    scratch.write("app.toml", text);
}

fn start(scratch: &Scratch) -> Run<'_> {
    scratch.start(MISBEHAVING, &["boot", "app.toml"], &[])
}

fn must_count(ended: &Ended) {
    // A link that nobody listens for says `os error` of its system, and comes back.
    ended
        .must_exit(0)
        .must_not_say("ERROR")
        .must_not_say("error:");
    assert_eq!(ended.stdout.trim(), "8 tokens", "{}", ended.told);
}

#[test]
fn killed_nets_lose_and_double_no_token_and_the_next_boot_goes_on_with_them() {
    let scratch = Scratch::empty();
    app(&scratch, "durable = true, allow_control = true");
    let mut run = start(&scratch);
    run.wait_for("phase 3");
    for round in 0..3 {
        for net in ["on_a", "on_b", "on_c"] {
            // At another moment of the nets each time.
            run.hold(std::time::Duration::from_millis(30 + 17 * round));
            run.kill(net);
            run.wait_for(&format!("restart  {net} is up again"));
        }
    }
    scratch.write("enough", "");
    must_count(&run.end());
    assert!(scratch.path("state/a.redb").exists());
    must_count(&start(&scratch).end());
}

const COMMANDED: &str = "net net
place free = 1, done
command go -> gone
transition work
  in free
  tape go
  do work
  idempotent
  out done
transition answer
  in done
  out free
  write gone
";

const PUTTING: &str = r#"
[app]
name = "putting"
until = "putter"
peer_timeout_s = 1.0
stop_timeout_s = 2

[chassis.desk]
restart = "always"
max_restarts = 100

[chassis.cage]
restart = "always"
max_restarts = 100

[task.putter]
handler = "test.putter"
on = "desk"

[task.net]
handler = "test.told"
on = "cage"
args = { net = "commanded.net", durable = true }
"#;

#[test]
fn who_puts_a_command_once_is_answered_when_it_is_done_though_the_boot_is_frozen_meanwhile() {
    let scratch = Scratch::empty();
    scratch.write("commanded.net", COMMANDED);
    scratch.write("app.toml", PUTTING);
    let mut run = start(&scratch);
    run.wait_for("phase 3");
    let freeze = |run: &Run<'_>, time| {
        run.signal(Signal::STOP);
        run.hold(Duration::from_millis(time));
        run.signal(Signal::CONT);
    };
    // For less than the time after which the others give it up, and for longer: then all is stopped in order, and begun again.
    for time in [300, 600, 1_900] {
        freeze(&run, time);
    }
    run.wait_for("desk is up again");
    run.hold(Duration::from_millis(300));
    scratch.write("enough", "");
    let ended = run.end();
    ended.must_exit(0);
    let told = scratch.read("told");
    let answers: Vec<&str> = told
        .lines()
        .filter(|line| !line.starts_with("did "))
        .collect();
    assert!(answers.len() > 10, "{told}");
    for (number, answer) in (1..).zip(answers) {
        assert_eq!(answer, format!("answered {number} gone"), "{told}");
        let done = told.find(&format!("did {number}\n"));
        assert!(done < told.find(answer) && done.is_some(), "{told}");
    }
}

#[test]
fn a_torn_or_foreign_store_stops_the_boot_by_its_name() {
    let scratch = Scratch::empty();
    app(&scratch, "durable = true, allow_control = true");
    scratch.write("enough", "");
    must_count(&start(&scratch).end());
    let whole = std::fs::read(scratch.path("state/a.redb")).unwrap();
    std::fs::copy(scratch.path("state/a.redb"), scratch.path("state/b.redb")).unwrap();
    start(&scratch)
        .end()
        .must_exit(1)
        .must_say("state/b.redb holds the state of net `a`, not of net `b`");
    // The first page alone never holds a state.
    scratch.write("state/b.redb", &whole[..4096]);
    start(&scratch)
        .end()
        .must_exit(1)
        .must_say("state/b.redb cannot be read as a store");
    // A store that was not closed is longer than what it holds: a longer part may still be all of it, and is a's then.
    for part in [3, 2] {
        scratch.write("state/b.redb", &whole[..whole.len() / part]);
        start(&scratch).end().must_exit(1).must_say("state/b.redb");
    }
}

pub fn ctos(scratch: &Scratch, arguments: &[&str]) -> Ended {
    scratch.start(MISBEHAVING, arguments, &[]).end()
}

#[test]
fn a_running_net_is_looked_at_and_intervened_in_from_the_command_line() {
    let scratch = Scratch::empty();
    app(&scratch, "allow_control = true");
    let mut run = start(&scratch);
    run.wait_for("phase 3");
    ctos(&scratch, &["net", "pause", "b"])
        .must_exit_leaving(0)
        .must_say("b: pause");
    let marking = ctos(&scratch, &["net", "marking", "b", "--json"]).json();
    assert_eq!(marking["paused"], "by hand");
    ctos(&scratch, &["net", "put", "b", "mid", "3"]).must_exit_leaving(0);
    ctos(&scratch, &["net", "take", "b", "mid", "2"]).must_exit_leaving(0);
    ctos(&scratch, &["net", "fire", "b", "pass"]).must_exit_leaving(0);
    ctos(&scratch, &["net", "fire", "b", "pas"])
        .must_exit_leaving(1)
        .must_say("net `b` has no transition `pas`; there are: pass");
    ctos(&scratch, &["net", "break", "b", "pass"]).must_exit_leaving(0);
    ctos(&scratch, &["net", "resume", "b"]).must_exit_leaving(0);
    let marking = ctos(&scratch, &["net", "marking", "b", "--json"]).json();
    assert_eq!(marking["paused"], "breakpoint `pass`");
    assert_eq!(marking["breakpoints"][0], "pass");
    scratch.write("b2.net", NETS[1].1.replace("mid\n", "mitte\n"));
    ctos(&scratch, &["net", "replace", "b", "b2.net"])
        .must_exit_leaving(1)
        .must_say("has no place `mid`");
    ctos(&scratch, &["net", "pause", "nobody"]).must_exit_leaving(4);
    scratch.write("enough", "");
    // One token was put by hand for good.
    let ended = run.end();
    ended.must_exit(0);
    assert_eq!(ended.stdout.trim(), "9 tokens", "{}", ended.told);
}

#[test]
fn a_boot_that_ends_at_a_breakpoint_says_so_with_its_exit_code() {
    let scratch = Scratch::empty();
    app(&scratch, "breakpoints = [\"forth\"], break_ends = true");
    scratch.edit(
        "app.toml",
        "args = { net = \"b.net\", breakpoints = [\"forth\"]",
        "args = { net = \"b.net\", breakpoints = [\"mid>=1\"]",
    );
    scratch.edit(
        "app.toml",
        "args = { net = \"c.net\", breakpoints = [\"forth\"]",
        "args = { net = \"c.net\", breakpoints = []",
    );
    start(&scratch)
        .end()
        .must_exit(7)
        .must_say("net `a` is at breakpoint `forth`");
}
