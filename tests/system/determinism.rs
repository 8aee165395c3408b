//! The same seed is the same run in any process: event log, output and results, byte for byte. And what
//! this rests on: nobody but `ctos::time` knows another clock.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::harness::{CTOS, Ended, Scratch};

/// Runs the shortened calibration in a process with this environment; its event log, and how it ended.
fn calibrate(
    scratch: &Scratch,
    seed: &str,
    faults: &str,
    environment: &[(&str, &str)],
) -> (String, Ended) {
    calibrate_with(scratch, (seed, faults), environment, &[])
}

/// The same with more arguments.
fn calibrate_with(
    scratch: &Scratch,
    (seed, faults): (&str, &str),
    environment: &[(&str, &str)],
    more: &[&str],
) -> (String, Ended) {
    let arguments = [
        "sim",
        "configs/calibrate.toml",
        "--seed",
        seed,
        "--faults",
        faults,
        "--events",
        "events.log",
        "-v",
    ];
    let arguments = [&arguments, more].concat();
    let ended = scratch.start(CTOS, &arguments, environment).end();
    (scratch.read("events.log"), ended)
}

/// Runs it twice, with different memory layouts, environments and folders.
fn must_be_the_same(seed: &str, faults: &str) -> String {
    let (here, there) = (Scratch::short(), Scratch::short());
    let (one_events, one) = calibrate(&here, seed, faults, &[]);
    // A large environment moves the stack; the other words are what libraries look at.
    let padding = "x".repeat(100_003);
    let environment = [
        ("PADDING", padding.as_str()),
        ("TZ", "Pacific/Chatham"),
        ("LANG", "de_DE.UTF-8"),
        ("HOME", "/nowhere"),
        ("RAYON_NUM_THREADS", "1"),
        ("MALLOC_PERTURB_", "85"),
    ];
    let (other_events, other) = calibrate(&there, seed, faults, &environment);
    assert!(
        one_events == other_events,
        "{}",
        first_difference(&one_events, &other_events)
    );
    assert_eq!(one.stdout, other.stdout);
    assert_eq!(one.stderr, other.stderr);
    assert_eq!(one.code, other.code);
    assert!(here.results() == there.results(), "the results differ");
    one_events
}

fn first_difference(one: &str, other: &str) -> String {
    let pair = one
        .lines()
        .zip(other.lines())
        .enumerate()
        .find(|(_, (a, b))| a != b);
    match pair {
        Some((number, (a, b))) => format!("line {}:\n{a}\n{b}", number + 1),
        None => "one is longer than the other".to_owned(),
    }
}

#[test]
fn a_calibration_is_the_same_in_every_process_byte_for_byte_also_while_it_is_recorded() {
    let events = must_be_the_same("3", "none");
    assert!(events.lines().count() > 500);
    assert!(events.contains(" deliver cage_motion/"));
    let scratch = Scratch::short();
    let record = ["--set", "record.file=\"run.mcap\""];
    let (recorded, _) = calibrate_with(&scratch, ("3", "none"), &[], &record);
    assert!(
        events == recorded,
        "{}",
        first_difference(&events, &recorded)
    );
    assert!(scratch.path("configs/run.mcap").is_file());
}

#[test]
fn a_calibration_under_rough_faults_is_the_same_in_every_process_and_still_succeeds() {
    let events = must_be_the_same("6", "rough");
    assert!(events.contains(" fault cut ") && events.contains(" fault freeze "));
    assert!(events.contains(" end Finished(AppResult { ok: true"));
}

#[test]
fn a_calibration_that_loses_a_chassis_is_the_same_in_every_process() {
    let events = must_be_the_same("7", "hostile");
    assert!(!events.contains("ok: true"));
}

/// Every Rust file of the workspace, relative to it.
fn sources() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = Vec::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if name != "target" && !name.starts_with('.') {
                    folders.push(path);
                }
            } else if name.ends_with(".rs") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path.strip_prefix(&root).unwrap().to_owned(), text));
            }
        }
    }
    found
}

/// What asks the machine for the time, and the files that may. A clock that can be set
/// (CLOCK_REALTIME, the system time) nobody may ask: stepping it must not matter to an app.
const CLOCKS: [(&str, &[&str]); 9] = [
    // A test that looks for the word, and the build that says when it was.
    (
        "SystemTime",
        &[
            "pnt/language/tests/core.rs",
            "cli/build.rs",
            "ctos/time/src/clock.rs",
        ],
    ),
    ("UNIX_EPOCH", &["cli/build.rs", "ctos/time/src/clock.rs"]),
    ("ClockId::Realtime", &[]),
    ("chrono::", &[]),
    // Benchmarks compare with what others measure with.
    ("Instant::now", &["ctos/benches/", "tests/peers/"]),
    ("std::time::Instant", &["ctos/benches/", "tests/peers/"]),
    (
        "clock_gettime",
        &[
            "ctos/time/src/clock.rs",
            // How long a simulation has computed, for `--cpu`.
            "cli/src/commands/sim.rs",
            "ctos/benches/",
            "pnt/analysis/benches/",
            "tests/peers/",
        ],
    ),
    // A process that ends, and handlers that block on purpose, are real.
    (
        "thread::sleep",
        &[
            "ctos/host/src/boot/child.rs",
            "ctos/tests/conformance/signals.rs",
            "tests/peers/",
            "tests/src/runaways.rs",
        ],
    ),
    // Around real sockets and processes only.
    (
        "tokio::time",
        &[
            "ctos/host/src/",
            "ctos/link/src/",
            "cli/display/src/server.rs",
            "cli/scott/src/panel/server.rs",
            "ctos/benches/",
            "tests/peers/",
        ],
    ),
];

/// Whether a line uses `std::time`'s `Instant` through a group of imports.
fn imports_instant(line: &str) -> bool {
    let group = line
        .split_once("time::{")
        .filter(|(before, _)| before.ends_with("std::"));
    group.is_some_and(|(_, names)| names.contains("Instant"))
}

#[test]
fn nobody_but_the_time_service_asks_the_machine_for_the_time() {
    let myself = Path::new("tests/system/determinism.rs");
    let sources = sources();
    assert!(sources.len() > 200, "{} files", sources.len());
    let mut wrong = Vec::new();
    for (path, text) in &sources {
        if path == myself {
            continue;
        }
        let name = path.to_string_lossy();
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap();
            for (word, allowed) in CLOCKS {
                let used =
                    code.contains(word) || word == "std::time::Instant" && imports_instant(code);
                if used && !allowed.iter().any(|start| name.starts_with(start)) {
                    wrong.push(format!("{name}:{}: {}", number + 1, line.trim()));
                }
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "these know a clock of their own:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn the_time_service_asks_the_monotonic_clock() {
    let sources = sources();
    let (_, text) = sources
        .iter()
        .find(|(path, _)| path == Path::new("ctos/time/src/clock.rs"))
        .unwrap();
    assert_eq!(text.matches("clock_gettime(").count(), 1);
    assert!(text.contains("clock_gettime(ClockId::Monotonic)"));
}
