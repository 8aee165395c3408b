//! The commands that look at a running app and tell it what to do, against real processes.

use std::os::unix::fs::PermissionsExt;

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Ended, MISBEHAVING, Run, Scratch};

const APP: &str = r#"
[app]
name = "cell"
stop_timeout_s = 2

[chassis.desk]

[chassis.cage]

[task.arm]
handler = "test.steady"
on = "cage"
args = { slow_s = 0.0 }

[task.hand]
handler = "test.steady"
on = "desk"
args = { slow_s = 0.0, waits_for = "arm" }
"#;

fn up(scratch: &Scratch) -> Run<'_> {
    scratch.write("app.toml", APP);
    let mut run = scratch.start(MISBEHAVING, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    run
}

fn ctos(scratch: &Scratch, arguments: &[&str]) -> Ended {
    scratch.start(MISBEHAVING, arguments, &[]).end()
}

#[track_caller]
fn json(ended: &Ended) -> Value {
    assert_eq!(ended.code, Some(0), "{}", ended.told);
    ended.json()
}

fn task<'v>(app: &'v Value, name: &str) -> &'v Value {
    let mut tasks = app["tasks"].as_array().unwrap().iter();
    tasks.find(|task| task["name"] == name).unwrap()
}

#[test]
fn a_running_app_is_looked_at_and_stopped_from_outside() {
    let scratch = Scratch::empty();
    let mut run = up(&scratch);
    let folder = scratch.path("ctos");
    let mode = |path: &std::path::Path| path.metadata().unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(&folder), 0o700);
    let socket = std::fs::read_dir(&folder).unwrap().next().unwrap().unwrap();
    assert_eq!(mode(&socket.path()), 0o600);

    let app = json(&ctos(&scratch, &["ps", "--json"]));
    assert_eq!((&app["app"], &app["state"]), (&"cell".into(), &"up".into()));
    for chassis in app["chassis"].as_array().unwrap() {
        let name = chassis["name"].as_str().unwrap();
        let pid = run.chassis[name].pid.as_raw_nonzero().get();
        assert_eq!(chassis["pid"], pid, "{name}");
        assert_eq!(chassis["state"], "up");
        assert_eq!(chassis["answers"], true);
        assert_eq!(chassis["restarts"], 0);
    }
    let hand = task(&app, "hand");
    assert_eq!(hand["activity"], "waits", "{app}");
    assert_eq!(hand["waits"][0]["to"], "arm");
    assert_eq!(hand["waits"][0]["command"], "wait");
    let arm = task(&app, "arm");
    assert_eq!(
        (&arm["phase"], &arm["handler"]),
        (&"Run".into(), &"test.steady".into())
    );
    assert_eq!(
        (&arm["activity"], &arm["command"]),
        (&"busy".into(), &"wait".into())
    );
    assert!(arm["in_handler_s"].as_f64().unwrap() >= 0.0);

    let shown = ctos(&scratch, &["ps"]);
    assert!(shown.stdout.contains("cell · up"), "{}", shown.told);
    assert!(shown.stdout.contains("for arm: wait"), "{}", shown.told);

    let status = json(&ctos(&scratch, &["status", "arm", "--json"]));
    assert_eq!(status["tasks"][0]["name"], "arm");
    let lines = status["logs"][0]["lines"].as_array().unwrap();
    assert_eq!(lines.len(), 3, "one for each phase: {status}");
    let status = ctos(&scratch, &["status", "arm"]);
    assert!(status.stdout.contains("arm · test.steady on cage/main"));
    assert!(status.stdout.contains("is in phase run"), "{}", status.told);
    // What it suggests works as it is typed.
    let suggested = status
        .stdout
        .lines()
        .find(|line| line.starts_with("restart it"));
    let words: Vec<&str> = suggested.unwrap().split_whitespace().skip(2).collect();
    assert_eq!(words, ["ctos", "restart", "arm"]);

    let logs = ctos(
        &scratch,
        &["logs", "arm", "--level", "warn", "--last", "2", "--json"],
    );
    let lines = logs.json_lines();
    assert_eq!(lines.len(), 2, "{}", logs.told);
    assert!(
        lines
            .iter()
            .all(|line| line["chassis"] == "cage" && line["level"] == "warn")
    );

    let wrong = ctos(&scratch, &["status", "amr"]);
    assert_eq!(wrong.code, Some(4), "{}", wrong.told);
    assert!(
        wrong.stderr.contains("did you mean `arm`?"),
        "{}",
        wrong.told
    );
    assert_eq!(ctos(&scratch, &["ps", "--app", "cello"]).code, Some(4));

    let top = json(&ctos(
        &scratch,
        &["top", "--once", "--json", "--interval", "0.2"],
    ));
    assert_eq!(
        task(&top, "arm")["busy"].as_f64().unwrap().round(),
        1.0,
        "{top}"
    );

    let stopped = ctos(&scratch, &["stop", "cell"]);
    assert_eq!(stopped.code, Some(0), "{}", stopped.told);
    // Nobody has pressed Ctrl-C: those who stop, boot and run are told of the operator.
    stopped.must_say_before(
        "stop     the operator stopped the app",
        "stopped  cell: the operator stopped the app",
    );
    stopped.must_not_say("interrupted");
    run.wait_for("stop     the operator stopped the app");
    run.end()
        .must_exit(130)
        .must_say("stops because the operator stopped the app")
        .must_say("error: stopped by the operator")
        .must_not_say("interrupted");
    assert!(
        std::fs::read_dir(&folder).unwrap().next().is_none(),
        "a socket is left"
    );
    let gone = ctos(&scratch, &["ps"]);
    gone.must_exit(5).must_say("no app is running");
}

#[test]
fn a_task_and_a_chassis_are_restarted_by_order() {
    let scratch = Scratch::empty();
    let mut run = up(&scratch);
    let old = run.chassis["cage"].pid;
    // Its handler is at work for ever; a person may restart it all the same, with its chassis.
    let restarted = ctos(&scratch, &["restart", "cage"]);
    assert_eq!(restarted.code, Some(0), "{}", restarted.told);
    run.wait_for("cage is up again");
    assert_ne!(run.chassis["cage"].pid, old);
    let restarted = ctos(&scratch, &["restart", "arm", "--json"]);
    assert_eq!(json(&restarted)["restarted"], "arm");
    let status = json(&ctos(&scratch, &["status", "arm", "--json"]));
    assert_eq!(status["tasks"][0]["restarts"], 1);
    assert_eq!(status["chassis"]["restarts"], 1);
    assert_eq!(status["logs"].as_array().unwrap().len(), 2);
    let why = status["chassis"]["last_end"].as_str().unwrap();
    assert_eq!(why, "was to be restarted");
    assert_eq!(ctos(&scratch, &["restart", "nobody"]).code, Some(4));
    run.signal(Signal::INT);
    run.end().must_exit(130).must_not_say("does not end");
}

#[test]
fn the_log_is_followed_until_the_app_ends() {
    let scratch = Scratch::empty();
    let run = up(&scratch);
    let mut follower = scratch.start(MISBEHAVING, &["logs", "-f"], &[]);
    follower.wait_for("is in phase run");
    run.signal(Signal::INT);
    let followed = follower.end();
    assert_eq!(followed.code, Some(0), "{}", followed.told);
    assert!(
        followed
            .stdout
            .contains("stops because the app was interrupted"),
        "{}",
        followed.told
    );
    run.end().must_exit(130);
}

#[test]
fn an_app_in_the_background_is_up_when_the_command_returns() {
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    let booted = ctos(
        &scratch,
        &["boot", "app.toml", "--detach", "--log-file", "cell.log"],
    );
    assert_eq!(booted.code, Some(0), "{}", booted.told);
    assert!(booted.stderr.contains("cell is up"), "{}", booted.told);
    let app = json(&ctos(&scratch, &["ps", "--json"]));
    assert_eq!(app["state"], "up");
    let stop = booted
        .stderr
        .lines()
        .find_map(|line| line.strip_prefix("stop     ctos "));
    let words: Vec<&str> = stop.unwrap().split_whitespace().collect();
    let stopped = ctos(&scratch, &words);
    assert_eq!(stopped.code, Some(0), "{}", stopped.told);
    assert!(scratch.read("cell.log").contains("phase 3"));
    let log = scratch.path("cell.log").metadata().unwrap();
    assert_eq!(log.permissions().mode() & 0o777, 0o600);
}

#[test]
fn an_app_that_does_not_come_up_in_the_background_says_why() {
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    let refuses = [
        "boot",
        "app.toml",
        "--detach",
        "--set",
        "task.arm.args.dies=\"connect\"",
    ];
    let booted = ctos(&scratch, &refuses);
    booted
        .must_exit(1)
        .must_say("aborted with signal 6 (SIGABRT)")
        .must_say("cell did not become ready");
}

#[test]
fn rubbish_on_the_control_socket_is_answered_with_an_error() {
    use std::io::{BufRead, BufReader, Write};
    let scratch = Scratch::empty();
    let run = up(&scratch);
    // The sockets of the links lie beside it.
    let socket = std::fs::read_dir(scratch.path("ctos"))
        .unwrap()
        .map(Result::unwrap)
        .find(|entry| entry.file_name().to_string_lossy().starts_with("cell-"))
        .unwrap();
    let connect = || std::os::unix::net::UnixStream::connect(socket.path()).unwrap();
    for rubbish in [
        "hello",
        "{}",
        r#"{"version":1,"request":{"kind":"dance"}}"#,
        r#"{"version":9,"request":{"kind":"ps"}}"#,
    ] {
        let stream = connect();
        writeln!(&stream, "{rubbish}").unwrap();
        let mut line = String::new();
        BufReader::new(&stream).read_line(&mut line).unwrap();
        let answer: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(
            (&answer["kind"], &answer["code"]),
            (&"error".into(), &"bad_request".into()),
            "{line}"
        );
    }
    // A line that is too long gets that as an error, and ends the connection.
    let stream = connect();
    let long = vec![b'x'; 3 << 20];
    // It need not be taken to its end.
    let _ = (&stream).write_all(&long);
    let mut answers = BufReader::new(&stream).lines();
    let answer: Value = serde_json::from_str(&answers.next().unwrap().unwrap()).unwrap();
    let message = answer["message"].as_str().unwrap();
    assert!(message.contains("at most 1048576 bytes"), "{message}");
    assert!(!matches!(answers.next(), Some(Ok(_))));
    // A line that never ends costs nobody anything.
    let stream = connect();
    let endless = vec![b'x'; 3 << 20];
    let _ = (&stream).write_all(&endless);
    let app = json(&ctos(&scratch, &["ps", "--json"]));
    assert_eq!(app["state"], "up");
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn the_status_of_a_net_tells_paused_and_waiting_for_another_net_from_idle() {
    let scratch = Scratch::short();
    let at = "task.motion.args.breakpoints=[\"accept_move\"]";
    let mut run = scratch.start_boot(&["--set", at]);
    run.wait_for("net paused");
    let does = |task: &str| {
        let ended = scratch.ctos(&["status", task]);
        ended.must_exit_leaving(0);
        let line = ended.stdout.lines().find(|line| line.starts_with("  does"));
        line.unwrap_or_else(|| panic!("{}", ended.told)).to_owned()
    };
    assert!(does("motion").contains("paused: breakpoint `accept_move`"));
    assert!(does("dispatcher").contains("waits for motion: move_robot"));
    assert!(does("vision").contains("idle"));
}
