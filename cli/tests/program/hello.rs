//! The smallest app: it runs over two processes and on the virtual clock, and a task moves by its `on`.

use crate::common::{example, good, hello};

/// The transitions of the log's firings, each with its phase, in order.
fn firings(log: &str) -> Vec<(&str, &str)> {
    log.lines()
        .filter(|line| line.contains("pnt::firing"))
        .filter_map(|line| Some((quoted(line, "transition=")?, quoted(line, "phase=")?)))
        .collect()
}

fn quoted<'a>(line: &'a str, key: &str) -> Option<&'a str> {
    line.split_once(key)?.1.split('"').nth(1)
}

const ALL_FIRINGS: [(&str, &str); 6] = [
    ("greet", "started"),
    ("greet", "completed"),
    ("count", "started"),
    ("count", "completed"),
    ("tell", "started"),
    ("tell", "completed"),
];

/// What the net tells.
const FROM_SHELF: &str = "text=\"Hello, world, from shelf!\"";

#[test]
fn hello_runs_over_two_processes_and_shows_its_net_at_work() {
    let (out, err) = good(&hello(&["-v"]));
    assert_eq!(out.trim_end(), "hello_done");
    assert!(err.contains(FROM_SHELF), "{err}");
    assert_eq!(firings(&err), ALL_FIRINGS, "{err}");
    for chassis in ["desk", "shelf"] {
        let started = |line: &&str| {
            let words: Vec<&str> = line.split_whitespace().collect();
            words.starts_with(&["chassis", chassis, "pid"])
        };
        assert_eq!(err.lines().filter(started).count(), 1, "{err}");
    }
}

#[test]
fn hello_runs_on_the_virtual_clock_in_one_process_and_the_same_every_time() {
    let virtual_time = ["-v", "--set", "time.mode=virtual"];
    let (out, err) = good(&hello(&virtual_time));
    assert_eq!(out.trim_end(), "hello_done");
    assert!(err.contains(FROM_SHELF), "{err}");
    assert_eq!(firings(&err), ALL_FIRINGS, "{err}");
    assert!(!err.contains("pid"), "{err}");
    let (again, _) = good(&hello(&virtual_time));
    assert_eq!(out, again);
}

#[test]
fn a_task_moves_to_another_process_by_its_on_alone() {
    let (_, err) = good(&hello(&["-v", "--set", "task.greeter.on=desk"]));
    assert!(err.contains(&FROM_SHELF.replace("shelf", "desk")), "{err}");
}

#[test]
fn a_handler_that_the_program_does_not_have_is_found_before_anything_starts() {
    let output = hello(&["--set", "task.greeter.handler=hello.greter"]);
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{err}");
    assert!(err.contains("hello.greeter"), "{err}");
    assert!(err.contains("nothing was started"), "{err}");
}

#[test]
fn a_booted_net_stops_at_a_breakpoint_before_its_first_firing_and_the_app_ends_there() {
    let stopped = hello(&["-v", "--break", "hello.greet"]);
    let err = String::from_utf8_lossy(&stopped.stderr).into_owned();
    assert_eq!(stopped.status.code(), Some(7), "{err}");
    assert_eq!(firings(&err), [], "{err}");
    assert!(
        err.contains("net `hello` is at breakpoint `greet`"),
        "{err}"
    );
    let refused = hello(&["--break", "hello.greeet"]);
    let err = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(3), "{err}");
    assert!(
        err.contains("did you mean `greet`?") && err.contains("nothing was started"),
        "{err}"
    );
}

#[test]
fn a_second_run_of_the_same_name_counts_and_shows_its_own_records_alone() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run.mcap").display().to_string();
    let info = |file: &str| {
        let info = example("hello").args(["log", "info", file]).output();
        good(&info.unwrap()).0
    };
    let files = |shown: &str| -> Vec<String> {
        let names = shown.lines().filter(|line| line.ends_with(".mcap"));
        names
            .filter_map(|line| Some(line.rsplit_once('/')?.1.to_owned()))
            .collect()
    };
    let first = ["run.boot.mcap", "run.desk.mcap", "run.shelf.mcap"];
    let second = first.map(|name| name.replace(".mcap", ".part2.mcap"));
    for expected in [first.map(str::to_owned), second] {
        let (_, err) = good(&hello(&["--record", &run]));
        assert!(err.contains("run.mcap · 3 files, "), "{err}");
        assert_eq!(files(&info(&run)), expected);
    }
    // On a virtual clock one process has one file, under the name itself.
    let alone = folder.path().join("alone.mcap").display().to_string();
    for expected in ["alone.mcap", "alone.part2.mcap"] {
        let (_, err) = good(&hello(&["--record", &alone, "--set", "time.mode=virtual"]));
        assert!(err.contains(&format!("{expected} · ")), "{err}");
        let look = err
            .lines()
            .find_map(|line| line.strip_prefix("look     ctos log info "));
        assert_eq!(files(&info(look.unwrap())), [expected]);
    }
    // Two runs are not read as one.
    let both = [
        folder.path().join("run.desk.mcap"),
        folder.path().join("run.desk.part2.mcap"),
    ];
    let cat = example("hello")
        .args(["log", "cat"])
        .args(both)
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&cat.stderr);
    assert_eq!(cat.status.code(), Some(1), "{err}");
    assert!(err.contains("are of two runs"), "{err}");
}
