//! `ctos net check`: its page says what is so, its JSON object has what scripts rely on, and its exit codes
//! are those of the list.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use crate::common::root;
use serde_json::Value;

fn ctos(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ctos"))
        .current_dir(folder)
        .args(arguments)
        .output()
        .expect("ctos runs")
}

/// The words of a command line; quotes keep words together.
fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (number, part) in line.split('"').enumerate() {
        if number % 2 == 1 {
            words.push(part.to_owned());
        } else {
            words.extend(part.split_whitespace().map(str::to_owned));
        }
    }
    words
}

#[test]
fn the_page_about_proving_shows_what_the_command_prints() {
    let page = fs::read_to_string(root().join("docs/proving.md")).expect("the page");
    let folder = tempfile::tempdir().expect("a folder");
    std::os::unix::fs::symlink(root().join("configs"), folder.path().join("configs"))
        .expect("the configurations");
    let mut now = page.clone();
    let mut commands = 0;
    for block in page.split("\n```").skip(1).step_by(2) {
        let (head, body) = block.split_once('\n').expect("a block has lines");
        if let Some(name) = head.strip_prefix("net ") {
            fs::write(folder.path().join(name), format!("{body}\n")).expect("a net");
        } else if head == "console" {
            let (command, said) = body.split_once('\n').expect("a command and what it says");
            let line = command.strip_prefix("$ ctos ").expect("a command of ctos");
            let arguments = words(line);
            let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
            let output = ctos(folder.path(), &arguments);
            let out = String::from_utf8(output.stdout).expect("text");
            now = now.replace(
                &format!("{command}\n{said}"),
                &format!("{command}\n{}", out.trim_end()),
            );
            commands += 1;
        }
    }
    assert!(commands >= 5, "{commands}");
    if std::env::var_os("UPDATE").is_some() {
        fs::write(root().join("docs/proving.md"), &now).expect("the page is written");
    } else {
        assert_eq!(
            page, now,
            "UPDATE=1 cargo test -p cli --test program proving writes the page anew"
        );
    }
}

/// The object in the last line of a check of this net, and the exit code.
fn checked(text: &str, arguments: &[&str]) -> (Value, Option<i32>) {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("n.net"), text).expect("a net");
    let all = [&["net", "check", "n.net", "--json"], arguments].concat();
    let output = ctos(folder.path(), &all);
    let out = String::from_utf8(output.stdout).expect("text");
    let last = out.lines().last().unwrap_or("null");
    (
        serde_json::from_str(last).expect("JSON"),
        output.status.code(),
    )
}

const BUFFER: &str = "net pc
place ready = 1, made, idle = 1, got, items, room = 3
transition make\n  in ready\n  out made
transition put\n  in made, room\n  out ready, items
transition get\n  in idle, items\n  out got, room
transition use\n  in got\n  out idle\n";

#[test]
fn a_sound_net_has_exit_code_0_and_every_number() {
    let (object, code) = checked(BUFFER, &[]);
    assert_eq!(code, Some(0), "{object}");
    // 2 states each, and 0 to 3 items. Of the 16 markings, 8 enable `make`, 6 `put`, 6 `get`, 8 `use`.
    let expected = [
        ("places", 6),
        ("transitions", 4),
        ("arcs", 12),
        ("markings", 16),
        ("edges", 28),
        ("max_tokens_in_place", 3),
        ("max_tokens_in_marking", 5),
        ("deadlocks", 0),
    ];
    for (key, number) in expected {
        assert_eq!(object[key], number, "{key}");
    }
    for key in ["sound", "bounded", "live", "reversible", "complete"] {
        assert_eq!(object[key], true, "{key}");
    }
    assert_eq!(object["safe"], false);
    assert_eq!(object["dead_transitions"], serde_json::json!([]));
    assert!(object["seconds"].is_f64() && object["peak_bytes"].is_u64());
}

#[test]
fn what_is_not_sound_has_exit_code_1() {
    let dead = BUFFER.replace("  out idle\n", "\n");
    let (object, code) = checked(&dead, &[]);
    assert_eq!(
        (code, object["deadlocks"].as_u64()),
        (Some(1), Some(1)),
        "{object}"
    );
    let never = format!("{BUFFER}transition odd\n  in items*4\n  out items*4\n");
    let (object, code) = checked(&never, &[]);
    assert_eq!(code, Some(1));
    assert_eq!(object["dead_transitions"], serde_json::json!(["odd"]));
    let heap = BUFFER.replace("in made, room", "in made");
    let (object, code) = checked(&heap, &[]);
    assert_eq!(
        (code, &object["bounded"]),
        (Some(1), &Value::Bool(false)),
        "{object}"
    );
    assert_eq!(
        object["unbounded_places"],
        serde_json::json!(["items", "room"])
    );
}

#[test]
fn a_limit_has_exit_code_6_and_says_so() {
    for limit in [["--max-markings", "5"], ["--max-memory", "100"]] {
        let large = BUFFER.replace("room = 3", "room = 30000");
        let (object, code) = checked(&large, &limit);
        assert_eq!(
            (code, &object["complete"]),
            (Some(6), &Value::Bool(false)),
            "{object}"
        );
        assert!(object["bounded"].is_null() && object["live"].is_null());
    }
}

/// Twelve lines that have nothing to do with each other; each goes round, or comes to its end.
fn lines(round: bool) -> String {
    let mut text = String::from("net lines\n");
    for line in 0..12 {
        let back = if round {
            format!("a{line}")
        } else {
            format!("c{line}")
        };
        text += &format!(
            "place a{line} = 1, b{line}, c{line}\ntransition f{line}\n  in a{line}\n  out b{line}\ntransition g{line}\n  in b{line}\n  out {back}\n"
        );
    }
    text
}

#[test]
fn where_a_limit_ends_the_list_of_markings_stubborn_sets_may_still_tell_whether_anything_is_dead() {
    let few = ["--max-markings", "100"];
    let (object, code) = checked(&lines(true), &few);
    assert_eq!(code, Some(6), "{object}");
    assert_eq!(
        (&object["complete"], &object["deadlock_free"]),
        (&Value::Bool(false), &Value::Bool(true))
    );
    assert!(object["live"].is_null());
    // What is dead is not sound, however much was not looked at.
    assert!(object["sound"].is_null());
    let (object, code) = checked(&lines(false), &few);
    assert_eq!(code, Some(1), "{object}");
    assert_eq!(object["sound"], false);
    assert_eq!(
        (
            object["deadlocks"].as_u64(),
            &object["deadlock_free"],
            &object["live"]
        ),
        (Some(1), &Value::Bool(false), &Value::Bool(false))
    );
    let (object, _) = checked(BUFFER, &[]);
    assert_eq!(object["deadlock_free"], true);
}

const ARM: &str = "net arm
place raw = 1, ready
command calibrate -> calibrated
command carry -> carried
transition calibrate\n  in raw\n  tape calibrate\n  out ready\n  write calibrated
transition carry\n  in ready\n  tape carry\n  out ready\n  write carried\n";

#[test]
fn a_net_with_a_given_tape_is_asked_only_about_that() {
    // Open, `carry` may come first.
    assert_eq!(checked(ARM, &[]).1, Some(1));
    let (object, code) = checked(ARM, &["--tape", "calibrate carry*"]);
    assert_eq!(
        (code, &object["sound"]),
        (Some(0), &Value::Bool(true)),
        "{object}"
    );
    assert_eq!(object["tapes"]["arm"], "calibrate carry*");
    // Raw: idle, on the tape. Ready: idle, on the tape.
    assert_eq!(object["markings"], 4);
    let (object, code) = checked(ARM, &["--tape", "arm: calibrate carry calibrate"]);
    assert_eq!(
        (code, object["deadlocks"].as_u64()),
        (Some(1), Some(1)),
        "{object}"
    );
    assert_eq!(object["commands"][0]["sound"], false);
    let (_, code) = checked(ARM, &["--tape", "calibrate", "--can", "raw & ready"]);
    assert_eq!(code, Some(1));
}

#[test]
fn a_tape_from_a_file_is_pointed_at_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("a file");
    write("n.net", ARM);
    write("good", "# a day\narm:\n  calibrate\n  carry*\n");
    write("bad", "arm: calibrate\n  (cary | carry)*\n");
    let check = |tape: &str| ctos(folder.path(), &["net", "check", "n.net", "--tape", tape]);
    assert_eq!(check("@good").status.code(), Some(0));
    for (tape, place) in [("@bad", "bad:2:4"), ("calibrate | parc", "--tape:1:13")] {
        let output = check(tape);
        let said = String::from_utf8(output.stderr).expect("text");
        assert_eq!(output.status.code(), Some(3), "{said}");
        assert!(said.contains(place), "{said}");
    }
    assert_eq!(check("@nowhere").status.code(), Some(3));
    let said = String::from_utf8(check("@bad").stderr).expect("text");
    assert!(said.contains("did you mean `carry`?"), "{said}");
}

#[test]
fn a_wrong_file_or_question_has_exit_code_3() {
    let (_, code) = checked("net n\nplase a\n", &[]);
    assert_eq!(code, Some(3));
    let (_, code) = checked(BUFFER, &["--can", "itmes"]);
    assert_eq!(code, Some(3));
}

#[test]
fn json_answers_also_for_files_that_cannot_be_read() {
    let (object, _) = checked("net n\nplase a\n", &[]);
    assert!(object["sound"].is_null());
    assert_eq!(
        object["findings"][0]["code"], "pnt::text::keyword",
        "{object}"
    );
    let output = ctos(Path::new("/"), &["net", "check", "/no/such.net", "--json"]);
    let object: Value = serde_json::from_slice(&output.stdout).expect("an object");
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(object["findings"][0]["code"], "ctos::file::unreadable");
}

#[test]
fn a_time_limit_gives_what_is_known_by_then() {
    let large = lines(true);
    let (object, code) = checked(&large, &["--engine", "explicit", "--seconds", "0"]);
    assert_eq!(code, Some(6), "{object}");
    assert_eq!(object["stopped"], "time");
    assert!(
        object["sound"].is_null() && object["markings"].as_u64() > Some(0),
        "{object}"
    );
}

#[test]
fn ctrl_c_gives_what_is_known_by_then_and_has_its_exit_code() {
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = folder.path().join("n.net");
    let made = Command::new("mkfifo")
        .arg(&pipe)
        .status()
        .expect("mkfifo runs");
    assert!(made.success());
    let child = Command::new(env!("CARGO_BIN_EXE_ctos"))
        .args(["net", "check", "--json", "--engine", "explicit"])
        .arg(&pipe)
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("ctos runs");
    // It opens the file after it has begun to wait for Ctrl-C; until then this waits.
    let mut net = fs::OpenOptions::new()
        .write(true)
        .open(&pipe)
        .expect("the pipe");
    let pid = child.id().to_string();
    let killed = Command::new("kill")
        .args(["-INT", &pid])
        .status()
        .expect("kill runs");
    assert!(killed.success());
    std::io::Write::write_all(&mut net, lines(true).as_bytes()).expect("it reads");
    drop(net);
    let output = child.wait_with_output().expect("it ends");
    let object: Value = serde_json::from_slice(&output.stdout).expect("an object");
    assert_eq!(output.status.code(), Some(130), "{object}");
    assert!(object["sound"].is_null(), "{object}");
}

/// Two hands that each take one of two tools first.
const GRAB: &str = "net grab
place left = 1, right = 1, a, b
transition first_left\n  in left\n  out a
transition then_right\n  in a, right\n  out left, right
transition first_right\n  in right\n  out b
transition then_left\n  in b, left\n  out left, right
";

#[test]
fn a_counterexample_in_json_is_played_by_a_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("a file");
    write("grab.net", GRAB);
    let output = ctos(folder.path(), &["net", "check", "grab.net", "--json"]);
    let object: Value = serde_json::from_slice(&output.stdout).expect("an object");
    let shown = &object["counterexamples"][0];
    assert_eq!(shown["shows"], "pnt::check::deadlock");
    assert_eq!(
        shown["sequence"],
        serde_json::json!(["grab.first_left", "grab.first_right"])
    );
    assert_eq!(
        shown["marking"],
        serde_json::json!({ "grab.a": 1, "grab.b": 1 })
    );
    fs::write(folder.path().join("check.json"), &output.stdout).expect("a file");
    write("steps", "first_left, grab.first_right  # the same\n");
    for file in ["check.json", "steps"] {
        let output = ctos(
            folder.path(),
            &["net", "play", "grab.net", "--sequence", file],
        );
        let said = String::from_utf8(output.stdout).expect("text");
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert_eq!(
            said,
            "   0  begins: grab.left, grab.right\n   1  grab.first_left: grab.a, grab.right\n   2  grab.first_right: grab.a, grab.b\nnothing can fire then\n"
        );
    }
    write("steps", "first_left\nthen_left\n");
    let output = ctos(
        folder.path(),
        &["net", "play", "grab.net", "--sequence", "steps"],
    );
    let said = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said.contains("step 2, `grab.then_left`, is not possible"),
        "{said}"
    );
    assert!(said.contains("`grab.b` holds 0, needs 1"), "{said}");
    write("steps", "first_lift\n");
    let output = ctos(
        folder.path(),
        &["net", "play", "grab.net", "--sequence", "steps"],
    );
    let said = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(3));
    assert!(
        said.contains("steps:1:1") && said.contains("did you mean `first_left`?"),
        "{said}"
    );
}

#[test]
fn a_file_takes_the_place_of_the_net_of_an_app_that_is_played() {
    let folder = tempfile::tempdir().expect("a folder");
    let net = fs::read_to_string(root().join("configs/nets/hello.net")).expect("the net");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("a file");
    write("hello.net", &net.replace("idle", "rested"));
    write("other.net", &net.replace("net hello ", "net other "));
    write("broken.net", &net.replace("write hello_done", "write gone"));
    // The whole round of a command. Some of its steps can be taken in several ways, by what is in progress.
    let round = "command hello to hello\ngreet starts\nhello.greet completes\nhello.count starts\nhello.count completes\ntell starts\nhello.tell completes\n";
    write("steps", round);
    let app = root().join("configs/hello.toml");
    let app = app.to_str().expect("a name");
    let play = |files: &[&str]| {
        let all = [
            &["net", "play"][..],
            files,
            &["--app", app, "--sequence", "steps"],
        ]
        .concat();
        let output = ctos(folder.path(), &all);
        let text = |bytes| String::from_utf8(bytes).expect("text");
        (
            output.status.code(),
            text(output.stdout),
            text(output.stderr),
        )
    };
    for (files, place) in [
        (&[][..], "hello.idle"),
        (&["hello.net"][..], "hello.rested"),
    ] {
        let (code, said, errors) = play(files);
        assert_eq!(code, Some(0), "{said}{errors}");
        let lines: Vec<&str> = said.lines().collect();
        assert_eq!(lines[0], format!("   0  begins: hello idle, {place}"));
        assert_eq!(
            lines[7],
            format!("   7  hello.tell completes: hello idle, {place}")
        );
    }
    // A net of another name stands beside those of the app.
    let (code, said, errors) = play(&["other.net"]);
    assert_eq!(code, Some(3), "{said}");
    assert!(
        errors.contains("several nets have a step `greet starts`"),
        "{errors}"
    );
    let (code, _, errors) = play(&["broken.net"]);
    assert_eq!(code, Some(3));
    assert!(errors.contains("broken.net:23:9"), "{errors}");
}

#[test]
fn what_a_check_of_sound_nets_has_written_holds_no_sequence_and_that_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("n.net"), BUFFER).expect("a net");
    let output = ctos(folder.path(), &["net", "check", "n.net", "--json"]);
    fs::write(folder.path().join("check.json"), output.stdout).expect("a file");
    let output = ctos(
        folder.path(),
        &["net", "play", "n.net", "--sequence", "check.json"],
    );
    let said = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(
        said.contains("a check of sound nets has nothing to show"),
        "{said}"
    );
}

#[test]
fn growth_in_json_has_a_round_that_is_played_again_and_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let pump = "net pump\nplace s, done\ntransition arrive\n  out s\n  time exponential 4 s\ntransition serve\n  in s\n  out done\n  time exponential 2 s\ntransition leave\n  in done\n";
    fs::write(folder.path().join("pump.net"), pump).expect("a file");
    let output = ctos(folder.path(), &["net", "check", "pump.net", "--json"]);
    let object: Value = serde_json::from_slice(&output.stdout).expect("an object");
    assert_eq!(
        (output.status.code(), &object["bounded"]),
        (Some(1), &Value::Bool(false))
    );
    assert!(object["markings"].as_u64() < Some(1000), "{object}");
    assert_eq!(object["unbounded_places"], serde_json::json!(["s"]));
    fs::write(folder.path().join("check.json"), &output.stdout).expect("a file");
    let output = ctos(
        folder.path(),
        &[
            "net",
            "play",
            "pump.net",
            "--sequence",
            "check.json",
            "--json",
        ],
    );
    let said = String::from_utf8(output.stdout).expect("text");
    assert_eq!(output.status.code(), Some(0), "{said}");
    let tokens = |line: &str| {
        let line: Value = serde_json::from_str(line).expect("an object");
        line["marking"]["pump.s"].as_u64().unwrap_or(0)
    };
    let held: Vec<u64> = said
        .lines()
        .filter(|line| line.contains("marking"))
        .map(tokens)
        .collect();
    assert!(held.last() > held.first(), "{said}");
}

#[test]
fn one_sequence_for_each_dead_marking_is_shown_when_that_is_asked_for() {
    let text = "net n\nplace a = 1, b, c, d\ntransition x\n  in a\n  out b\ntransition y\n  in a\n  out c\ntransition z\n  in a\n  out d\n";
    for (wanted, shown) in [("1", 1), ("2", 2), ("9", 3)] {
        let (object, code) = checked(text, &["--deadlocks", wanted]);
        assert_eq!(code, Some(1));
        assert_eq!(
            object["counterexamples"].as_array().map(Vec::len),
            Some(shown),
            "{object}"
        );
    }
}

#[test]
fn a_net_that_is_missing_is_named_with_what_to_give() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("a file");
    write(
        "boss.net",
        "net boss\nplace a = 1\ntransition t\n  in a\n  out a, seen@eye\n",
    );
    let said = || {
        let output = ctos(folder.path(), &["net", "check", "boss.net"]);
        assert_eq!(output.status.code(), Some(3));
        String::from_utf8(output.stderr).expect("text")
    };
    assert!(said().contains("--app APP"), "{}", said());
    write("eye.net", "net eye\nplace seen\ntransition t\n  in seen\n");
    assert!(said().contains("give `eye.net` as well"), "{}", said());
    // Beside mistakes of its own, too.
    write(
        "boss.net",
        "net boss\nplace a = 1\ntransition t\n  in a\n  otu a\n  out a, seen@nowhere\n",
    );
    let all = said();
    assert!(
        all.contains("otu") && all.contains("has no net `nowhere`"),
        "{all}"
    );
}

#[test]
fn a_file_in_the_place_of_an_apps_net_is_refused_for_what_the_boot_refuses() {
    let folder = tempfile::tempdir().expect("a folder");
    let dispatcher = root().join("configs/nets/dispatcher.net");
    let text = fs::read_to_string(dispatcher).expect("the net");
    let app = root().join("configs/calibrate.toml");
    let app = app.to_str().expect("a name");
    let check = |text: &str| {
        fs::write(folder.path().join("dispatcher.net"), text).expect("a file");
        let output = ctos(
            folder.path(),
            &["net", "check", "dispatcher.net", "--app", app],
        );
        let said = String::from_utf8(output.stderr).expect("text");
        (output.status.code(), said)
    };
    assert_eq!(check(&text).0, Some(0));
    let (code, said) = check(&text.replacen("  do ", "  do no_", 1));
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("has no local function `no_"), "{said}");
    let endless = format!(
        "{text}\nplace extra capacity 1\ntransition nothing\n  out extra\ntransition away\n  in extra\n"
    );
    let (code, said) = check(&endless);
    assert_ne!(code, Some(0));
    assert!(
        said.contains("takes nothing and would fire for ever"),
        "{said}"
    );
}

#[test]
fn a_question_that_is_answered_with_no_has_exit_code_1() {
    let (object, code) = checked(
        BUFFER,
        &["--can", "items >= 3", "--always", "got & items = 0"],
    );
    assert_eq!(code, Some(0), "{object}");
    assert_eq!(
        object["questions"][0]["sequence"].as_array().map(Vec::len),
        Some(6)
    );
    let (object, code) = checked(BUFFER, &["--can", "items >= 4"]);
    assert_eq!(code, Some(1));
    assert_eq!(checked(BUFFER, &["--never", "items >= 4"]).1, Some(0));
    assert_eq!(checked(BUFFER, &["--never", "items = 3"]).1, Some(1));
    assert!(
        object["questions"][0]["invariant"]["pc.items"].is_u64(),
        "{object}"
    );
}

#[test]
fn the_engines_agree_and_threads_change_nothing() {
    let (one, _) = checked(BUFFER, &["--engine", "explicit"]);
    let (other, _) = checked(BUFFER, &["--engine", "symbolic"]);
    let (many, _) = checked(BUFFER, &["--engine", "explicit", "--threads", "3"]);
    assert_eq!(other["engine"], "symbolic");
    for key in [
        "markings",
        "edges",
        "live",
        "reversible",
        "max_tokens_in_marking",
        "deadlocks",
    ] {
        assert_eq!(one[key], other[key], "{key}");
        assert_eq!(one[key], many[key], "{key}");
    }
}

#[test]
fn the_performance_of_a_net_is_told_with_its_exact_and_its_simulated_values() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("a net");
    write(
        "machine.net",
        "net machine\nplace up = 1, down\ntransition breaks\n  in up\n  out down\n  time exponential 3 s\ntransition repair\n  in down\n  out up\n  time exponential 1 s\n",
    );
    write(
        "untimed.net",
        "net n\nplace a = 1\ntransition t\n  in a\n  out a\n",
    );
    write(
        "stops.net",
        "net n\nplace a = 1\ntransition t\n  in a\n  time exponential 1 s\n",
    );
    let perf = |arguments: &[&str]| ctos(folder.path(), &[&["net", "perf"], arguments].concat());
    let output = perf(&[
        "machine.net",
        "--time",
        "5000",
        "--confidence",
        "0.9999",
        "--json",
    ]);
    assert_eq!(output.status.code(), Some(0));
    let report: Value = serde_json::from_slice(&output.stdout).expect("an object");
    let up = &report["places"][0];
    assert_eq!(up["place"], "up");
    let number = |value: &Value| value.as_f64().expect("a number");
    // Up for three seconds of four.
    let (exact, simulated) = (number(&up["tokens"]["exact"]), &up["tokens"]["simulated"]);
    assert!((exact - 0.75).abs() < 1e-9);
    assert!((number(&simulated["mean"]) - 0.75).abs() <= number(&simulated["half_width"]));
    let breaks = &report["transitions"][0]["throughput_per_s"]["exact"];
    assert!((number(breaks) - 0.25).abs() < 1e-9);
    let again = perf(&[
        "machine.net",
        "--time",
        "5000",
        "--confidence",
        "0.9999",
        "--json",
    ]);
    assert_eq!(output.stdout, again.stdout);
    let words = perf(&["machine.net", "--time", "100"]);
    let words = String::from_utf8(words.stdout).expect("text");
    assert!(
        words.contains("breaks") && words.contains("0.75"),
        "{words}"
    );
    for (arguments, code) in [
        (["machine.net", "--confidence", "2"], 2),
        (["untimed.net", "--time", "1"], 3),
        (["nowhere.net", "--time", "1"], 3),
        (["stops.net", "--time", "1"], 1),
    ] {
        assert_eq!(perf(&arguments).status.code(), Some(code), "{arguments:?}");
    }
}
