//! `scott` at a running app with two daemons, in processes of their own.

use std::{
    io::{Read, Write},
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    time::Duration,
};

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{CTOS, Ended, Run, SCOTT, Scratch};

fn up(scratch: &Scratch) -> Run<'_> {
    let mut run = scratch.start(CTOS, &["boot", "configs/objects.toml"], &[]);
    run.wait_for("phase 3");
    run
}

#[test]
fn a_daemon_on_demand_has_no_process_until_somebody_asks_for_it() {
    let scratch = Scratch::new();
    let start = "chassis.cage.start=on-demand";
    let mut run = scratch.start(CTOS, &["boot", "configs/objects.toml", "--set", start], &[]);
    run.wait_for("phase 3");
    let state = || {
        let ended = scratch.ctos(&["ps", "--json"]);
        ended.must_exit_leaving(0);
        ended.stdout
    };
    let before = state();
    assert!(before.contains("\"waiting\""), "{before}");
    assert!(said(&scratch, "foo.a@d2 EXEC").starts_with("foo.a@d2 RET 0 TMSG breakfast"));
    let after = state();
    assert!(!after.contains("\"waiting\""), "{after}");
    run.signal(Signal::INT);
    let ended = run.end();
    ended
        .must_exit(130)
        .must_say("start    cage, on demand: first asked")
        .must_say("start    cage is up")
        .must_not_say("restart");
}

/// What a statement prints, which must not fail.
#[track_caller]
fn said(scratch: &Scratch, statement: &str) -> String {
    let ended = scratch.scott(&["objects", "-c", statement]);
    ended.must_exit_leaving(0);
    ended.stdout.trim_end().to_owned()
}

/// Asks again until the answer is as wanted; the watchdog of a run ends what never comes.
fn until(mut run: impl FnMut() -> Ended, wanted: impl Fn(&Ended) -> bool) -> Ended {
    loop {
        let ended = run();
        if wanted(&ended) {
            return ended;
        }
    }
}

#[test]
fn a_running_app_is_asked_by_lines_of_text_wherever_its_daemons_are() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    let plain = said(&scratch, "foo.a EXEC");
    assert!(
        plain.starts_with("foo.a RET 0 TMSG breakfast in the kitchen"),
        "{plain}"
    );
    let named = said(&scratch, "foo.a@d2 EXEC");
    assert_eq!(named, plain.replacen("foo.a", "foo.a@d2", 1));
    // An upper-case class means the daemon that the dictionary of the first one names.
    said(&scratch, "QUEUE.jobs EXEC put 'pick up' FMSG 2 0.5 nan");
    let taken = said(&scratch, "queue.jobs@d2 EXEC take");
    assert_eq!(taken, "queue.jobs@d2 RET 0 TMSG pick up FMSG 2 0.5 nan");
    assert_eq!(
        said(&scratch, "queue.jobs EXEC take"),
        "queue.jobs RET 0 TMSG not yet"
    );
    // Another daemon may be the first.
    let ended = scratch.scott(&["--daemon", "d2", "--json", "-c", "sorm CTRL -list"]);
    ended.must_exit_leaving(0);
    assert!(
        ended.json()["text"]
            .as_str()
            .unwrap()
            .contains("queue.jobs")
    );
    // The arm of a process without MCS is refused by name.
    let ended = scratch.scott(&["-c", "mvpos EXEC where"]);
    ended.must_exit_leaving(5).must_say("mcs");
}

#[test]
fn every_way_to_ask_wrongly_has_its_exit_code() {
    let scratch = Scratch::new();
    let code = |arguments: &[&str], code: i32, text: &str| {
        scratch
            .scott(arguments)
            .must_exit_leaving(code)
            .must_say(text);
    };
    code(&["-c", "foo.a EXEC"], 5, "no app is running");
    code(&["--local", "objects"], 2, "cannot be used");
    let _run = up(&scratch);
    code(&["cell", "-c", "foo.a EXEC"], 4, "objects-");
    code(&["--daemon", "d3", "-c", "foo.a EXEC"], 4, "it has d1, d2");
    code(&["-c", "fog.a EXEC"], 4, "did you mean `foo`");
    code(&["-c", "foo.a@d3 EXEC"], 5, "d3");
    code(&["-c", "foo.a CTRL -speed"], 1, "unknown option");
    code(&["-c", "watch"], 2, "write: watch PATTERN");
    code(&["-c", "watch foo.*@d3"], 1, "it has d1, d2");
}

#[test]
fn others_requests_are_watched_with_replies_and_durations() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    let wanted = "watch foo.* --kind EXEC --from its-user* --count 3";
    let watching = scratch.start(SCOTT, &["objects", "--json", "-c", wanted], &[]);
    for daemon in ["d1", "d2"] {
        // It is there before it has been told what to watch.
        let calls = format!("sorm@{daemon} CTRL -statistics");
        until(
            || scratch.scott(&["-c", &calls]),
            |ended| {
                let calls = ended.stdout.split("watch.scott-").nth(1);
                calls.is_some_and(|calls| calls.contains(" ctrl 1 "))
            },
        );
    }
    said(&scratch, "foo.a EXEC");
    said(&scratch, "foo.a CTRL -dump");
    said(&scratch, "bar EXEC");
    said(&scratch, "foo.b@d2 EXEC");
    scratch
        .scott(&["-c", "foo.a EXEC nonsense"])
        .must_exit_leaving(1);
    let ended = watching.end();
    ended.must_exit_leaving(0);
    let mut seen = ended.json_lines();
    // The two daemons are asked in turn.
    seen.sort_by(|a, b| {
        a["at_s"]
            .as_f64()
            .unwrap()
            .total_cmp(&b["at_s"].as_f64().unwrap())
    });
    let told: Vec<(&str, &str, i64)> = seen
        .iter()
        .map(|seen| {
            let text = |key: &str| seen[key].as_str().unwrap();
            (
                text("process"),
                text("request"),
                seen["code"].as_i64().unwrap(),
            )
        })
        .collect();
    let nonsense = seen[2]["code"].as_i64().unwrap();
    assert_ne!(nonsense, 0, "{seen:#?}");
    assert_eq!(
        told,
        [
            ("desk", "foo.a EXEC", 0),
            ("cage", "foo.b EXEC", 0),
            ("desk", "foo.a EXEC TMSG nonsense", nonsense),
        ]
    );
    for one in &seen {
        assert!(one["took_s"].as_f64().unwrap() >= 0.0);
        assert!(one["reply"].as_str().unwrap().contains(" RET "));
    }
    // Nobody watches any more.
    let list = scratch.scott(&["-c", "sorm CTRL -list"]);
    assert!(!list.stdout.contains("watch."), "{}", list.told);
}

#[test]
fn a_request_is_traced_through_the_calls_that_it_leads_to() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    let statements = [
        "-c",
        "foo.a CTRL -drink bar",
        "-c",
        "trace foo.a EXEC",
        "-c",
        "trace QUEUE.jobs EXEC put x",
    ];
    let ended = scratch.scott(&[&["objects", "--json"], &statements[..]].concat());
    ended.must_exit_leaving(0);
    let lines = ended.json_lines();
    let calls: Vec<(i64, &str, &str)> = lines
        .iter()
        .filter(|line| line["depth"].is_i64())
        .map(|line| {
            let text = |key: &str| line[key].as_str().unwrap();
            (
                line["depth"].as_i64().unwrap(),
                text("process"),
                text("object"),
            )
        })
        .collect();
    assert_eq!(
        calls,
        [
            (0, "desk", "foo.a"),
            (1, "desk", "bar"),
            (0, "cage", "queue.jobs")
        ]
    );
}

#[test]
fn what_was_kept_for_a_client_is_free_when_it_is_gone() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    // In one session the permit is held, and the lock holds.
    let held = scratch.scott(&[
        "objects",
        "-c",
        "semaphore.arm EXEC acquire",
        "-c",
        "sorm CTRL -lock foo.a 1000",
        "-c",
        "semaphore.arm EXEC free",
        "-c",
        "expect IMSG 2 0 0",
    ]);
    held.must_exit_leaving(0);
    // Its end is noticed at once, if perhaps not before the next one asks.
    let free = ["-c", "semaphore.arm EXEC free", "-c", "expect IMSG 2 1 0"];
    until(|| scratch.scott(&free), |ended| ended.code == Some(0));
    until(
        || scratch.scott(&["-c", "foo.a EXEC"]),
        |ended| ended.code == Some(0),
    );
    // What was acquired in somebody's name stays his.
    said(&scratch, "semaphore.arm EXEC acquire anna");
    assert_eq!(
        said(&scratch, "semaphore.arm EXEC free"),
        "semaphore.arm RET 0 IMSG 2 0 0"
    );
}

#[test]
fn a_chassis_that_dies_is_an_error_with_names_and_the_next_request_finds_it_again() {
    let scratch = Scratch::new();
    let run = up(&scratch);
    said(&scratch, "blackboard.x@d2 EXEC set lamp on");
    run.kill("cage");
    let again = until(
        || scratch.scott(&["-c", "foo.a@d2 EXEC"]),
        |ended| ended.code == Some(0),
    );
    assert!(again.stdout.starts_with("foo.a@d2 RET 0"), "{}", again.told);
}

#[test]
fn a_watcher_finds_an_app_again_that_was_started_anew() {
    let scratch = Scratch::new();
    let run = up(&scratch);
    let watching = scratch.start(
        SCOTT,
        &["objects", "--json", "-c", "watch foo.* --count 1"],
        &[],
    );
    until(
        || scratch.scott(&["-c", "sorm CTRL -list"]),
        |ended| ended.stdout.contains("watch.scott-"),
    );
    run.signal(Signal::INT);
    run.end();
    let _anew = up(&scratch);
    until(
        || scratch.scott(&["-c", "sorm CTRL -list"]),
        |ended| ended.stdout.contains("watch.scott-"),
    );
    said(&scratch, "foo.b EXEC");
    let ended = watching.end();
    ended.must_exit_leaving(0);
    let lines: Vec<Value> = ended.json_lines();
    assert_eq!(lines[0]["request"], "foo.b EXEC");
}

#[test]
fn classes_are_described_by_the_app_itself() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    let ended = scratch.scott(&["--json", "-c", "sorm CTRL -describe"]);
    ended.must_exit_leaving(0);
    let text = ended.json()["text"].as_str().unwrap().to_owned();
    let names: Vec<String> = text
        .lines()
        .map(|line| {
            let class: Value = serde_json::from_str(line).unwrap();
            assert!(class["options"].is_array() && class["forms"].is_array());
            class["name"].as_str().unwrap().to_owned()
        })
        .collect();
    for class in ["dict", "mvpos", "pino", "queue", "sorm", "spot", "watch"] {
        assert!(
            names.iter().any(|name| name == class),
            "{class} of {names:?}"
        );
    }
}

#[test]
fn the_clocks_of_two_processes_differ_by_no_more_than_is_said() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    said(&scratch, "shmem_w.beat@d2 CTRL -floats 2 -slots 4");
    said(&scratch, "shmem_w.beat@d2 EXEC FMSG 2 1 2");
    said(&scratch, "shmem_far.beat CTRL -daemon d2");
    let asked = |statement: &str| {
        let ended = scratch.scott(&["--json", "-c", statement]);
        ended.must_exit_leaving(0);
        ended.json()
    };
    // Both have the clock of this machine: the truth is zero, and lies within the stated error.
    let mut errors = Vec::new();
    for _ in 0..5 {
        let clock = asked("shmem_far.beat EXEC clock");
        let [offset, error] = [0, 1].map(|index| clock["floats"][index].as_f64().unwrap());
        assert!(error > 0.0 && offset.abs() <= error, "{offset} {error}");
        errors.push(error);
    }
    // More exchanges say more, but for what drift allows meanwhile.
    assert!(errors[4] < errors[0] + 0.1, "{errors:?}");
    let latest = asked("shmem_far.beat EXEC latest");
    assert_eq!(latest["floats"], serde_json::json!([1.0, 2.0]));
    let number = |index: usize| latest["ints"][index].as_i64().unwrap();
    let (age, error) = (number(2), number(6));
    assert!(error > 0 && age > -error, "{latest}");
}

#[test]
fn the_environment_of_a_daemon_gives_recipes_over_those_of_files() {
    let scratch = Scratch::new();
    scratch.edit(
        "configs/objects.dict",
        "queue.small -capacity 3",
        "queue.small -capacity 3\nqueue.tiny -capacity 2",
    );
    let variables = [
        ("SORMA_queue__small", "-capacity 1"),
        ("SORMA_queue__words", "-capacity '7'"),
    ];
    let mut run = scratch.start(CTOS, &["boot", "configs/objects.toml"], &variables);
    run.wait_for("phase 3");
    // Both daemons are processes that the boot started.
    for (name, capacity) in [
        ("queue.small", "-capacity 1"),
        ("queue.words", "-capacity 7"),
        ("queue.words@d2", "-capacity 7"),
        ("queue.tiny", "-capacity 2"),
    ] {
        let dump = said(&scratch, &format!("{name} CTRL -dump"));
        assert!(dump.contains(capacity), "{name}: {dump}");
    }
}

#[test]
fn an_environment_that_is_no_recipe_stops_the_boot_and_names_the_variable() {
    let scratch = Scratch::new();
    let variables = [("SORMA_queue__small", "-capacity '1")];
    let run = scratch.start(CTOS, &["boot", "configs/objects.toml"], &variables);
    let ended = run.end();
    assert_ne!(ended.code, Some(0));
    ended.must_say("SORMA_queue__small");
}

/// `scott` at a terminal, which util-linux's `script` makes.
pub struct Terminal {
    child: Child,
    pub keys: ChildStdin,
    drawn: Receiver<Vec<u8>>,
    shown: String,
}

impl Terminal {
    /// Whether the machine has terminals, and `script` to make one: not every container does.
    pub fn can_be_had() -> bool {
        let mut tried = Command::new("script");
        tried.args(["--quiet", "--command", "exit 0", "/dev/null"]);
        tried.stdin(Stdio::null()).stdout(Stdio::null());
        tried.stderr(Stdio::null());
        tried.status().is_ok_and(|status| status.success())
    }

    pub fn start(scratch: &Scratch, app: &str) -> Self {
        let line = format!("stty cols 100 rows 30; exec '{SCOTT}' {app}");
        let mut child = Command::new("script")
            .args(["--quiet", "--flush", "--command", &line, "/dev/null"])
            .env("XDG_RUNTIME_DIR", scratch.path(""))
            .env("HOME", scratch.path(""))
            .env("SHELL", "/bin/sh")
            .env("TERM", "xterm")
            .current_dir(scratch.path(""))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("install util-linux: this test needs a terminal, which `script` makes");
        let keys = child.stdin.take().unwrap();
        let mut screen = child.stdout.take().unwrap();
        let (sender, drawn) = channel();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = screen.read(&mut bytes) {
                if sender.send(bytes[..count].to_vec()).is_err() {
                    return;
                }
            }
        });
        let shown = String::new();
        Self {
            child,
            keys,
            drawn,
            shown,
        }
    }

    /// Reads what is drawn until a text has come; what came before it.
    #[track_caller]
    pub fn until(&mut self, text: &str) -> String {
        /// How a program asks where the cursor is.
        const WHERE: &str = "\u{1b}[6n";
        loop {
            while let Some(at) = self.shown.find(WHERE) {
                self.shown.replace_range(at..at + WHERE.len(), "");
                self.keys.write_all(b"\x1b[1;1R").unwrap();
            }
            if let Some(at) = self.shown.find(text) {
                let shown: String = self.shown.drain(..at + text.len()).collect();
                return shown;
            }
            match self.drawn.recv_timeout(Duration::from_secs(120)) {
                Ok(bytes) => self.shown += &String::from_utf8_lossy(&bytes),
                Err(why) => panic!("no `{text}` ({why}) in {:?}", self.shown),
            }
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_prompt_tells_that_the_app_is_gone_and_back_while_nobody_types() {
    if !Terminal::can_be_had() {
        return;
    }
    let scratch = Scratch::new();
    let run = up(&scratch);
    let mut terminal = Terminal::start(&scratch, "objects");
    terminal.until("scott objects");
    run.signal(Signal::INT);
    run.end();
    terminal.until("app `objects` is gone");
    terminal.until("scott objects (gone)");
    let _anew = up(&scratch);
    terminal.until("app `objects` is back");
    terminal.until("scott objects");
    // What is typed reaches the new one.
    terminal.keys.write_all(b"foo.a EXEC\r").unwrap();
    terminal.until("breakfast");
}

#[test]
fn the_prompt_helps_takes_plain_numbers_and_shows_names_units_and_matrices() {
    if !Terminal::can_be_had() {
        return;
    }
    let scratch = Scratch::new();
    let _run = up(&scratch);
    let mut terminal = Terminal::start(&scratch, "objects");
    let types = |terminal: &mut Terminal, line: &str| {
        terminal.until("scott objects");
        terminal
            .keys
            .write_all(format!("{line}\r").as_bytes())
            .unwrap();
    };
    types(&mut terminal, "list kin");
    terminal.until("kinematics of an arm");
    types(&mut terminal, "help kin");
    terminal.until("takes joint positions q1 to q6, rad");
    types(&mut terminal, "kin EXEC fkine 0 0 0 0 0 0");
    terminal.until("base_T_6 (m)");
    terminal.until("1  0  0   0.4521");
    types(&mut terminal, "bar EXEC");
    terminal.until("1.5 l");
    types(&mut terminal, "kin EXEC fkin");
    terminal.until("`fkine`?");
    types(&mut terminal, "kim");
    let error = terminal.until("`kin`?");
    assert!(!error.contains(".rs:"), "{error}");
    // A script gets the reply as it reads back.
    let ended = scratch.scott(&["-c", "kin EXEC fkine FMSG 6 0 0 0 0 0 0", "-c", "list kin"]);
    assert!(
        ended.stdout.starts_with("kin RET 0 FMSG 16 1.0 0.0 "),
        "{}",
        ended.stdout
    );
    assert!(
        ended.stdout.contains("\nkin        kinematics of an arm\n"),
        "{}",
        ended.stdout
    );
}
