//! `ctos record` on a running app, and records of simulated runs.

use std::{collections::BTreeSet, fs, path::PathBuf};

use rustix::process::Signal;
use serde_json::Value;

use crate::{
    harness::{MISBEHAVING, Scratch},
    moving::{APP, ctos, must_have_moved_at_last, up},
};

/// The lines of a record, by `ctos log cat`.
fn lines(scratch: &Scratch, files: &[&str]) -> Vec<Value> {
    let arguments = [&["log", "cat", "--json"], files].concat();
    let ended = ctos(scratch, &arguments);
    assert_eq!(ended.code, Some(0), "{}", ended.told);
    ended.json_lines()
}

fn files(scratch: &Scratch, folder: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(scratch.path(folder)).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

/// The records that the app says are being written.
fn written(scratch: &Scratch) -> usize {
    let app = ctos(scratch, &["ps", "--json"]).json();
    let chassis = app["chassis"].as_array().unwrap().iter();
    chassis
        .map(|one| one["records"].as_array().unwrap().len())
        .sum()
}

#[test]
fn a_running_app_is_recorded_for_a_while_and_goes_on_undisturbed() {
    let scratch = Scratch::empty();
    let run = up(&scratch, &["--set", "task.judge.args.moves=1", "--json"]);
    let record = ["record", "load", "--to", "rec", "--for", "400ms", "--json"];
    let recorded = ctos(&scratch, &record);
    assert_eq!(recorded.code, Some(0), "{}", recorded.told);
    let view = recorded.json();
    assert!(view["took_s"].as_f64().unwrap() >= 0.4, "{view}");
    let names: BTreeSet<&str> = view["files"]
        .as_array()
        .unwrap()
        .iter()
        .map(|file| file["chassis"].as_str().unwrap())
        .collect();
    assert_eq!(names, BTreeSet::from(["boot", "desk", "cage"]));
    for file in view["files"].as_array().unwrap() {
        let path = file["file"].as_str().unwrap();
        let info = ctos(&scratch, &["log", "info", "--json", path]).json();
        assert!(info["torn"].is_null(), "{info}");
        assert_eq!(info["lines"], file["lines"], "{info} {file}");
        assert_eq!(file["lost"], 0, "{file}");
    }
    assert_eq!(written(&scratch), 0, "a record is left");
    let replay = ["replay", "app.toml", "rec/load.desk.mcap", "--task", "sink"];
    let refused = ctos(&scratch, &replay);
    assert_eq!(refused.code, Some(1), "{}", refused.told);
    refused
        .must_say("it does not hold the beginning of `sink`")
        .must_say("ctos boot --record FILE");
    must_have_moved_at_last(&ctos(&scratch, &["move", "sink", "cage"]));
    let result = run.end().must_exit(0).json();
    let text = result["text"].as_str().unwrap();
    assert!(text.contains("came once and in order"), "{text}");
}

#[test]
fn what_is_recorded_of_both_ends_of_a_message_can_be_read() {
    let scratch = Scratch::empty();
    let run = up(&scratch, &[]);
    let record = ["record", "--to", "rec", "--for", "0.3s", "--json"];
    assert_eq!(ctos(&scratch, &record).code, Some(0));
    for (file, side) in [
        ("rec/load.cage.mcap", "sender"),
        ("rec/load.desk.mcap", "receiver"),
    ] {
        let lines = lines(&scratch, &[file]);
        let notes = lines
            .iter()
            .filter(|line| line["topic"] == "/message/sink" && line["line"]["noted"] == side);
        let mut count = 0;
        for note in notes {
            let line = &note["line"];
            assert_eq!(line["command"], "note", "{line}");
            assert!(line["data"]["sender"].is_string(), "{line}");
            assert!(line["trace"].is_string(), "{line}");
            count += 1;
        }
        assert!(count > 10, "{count} of {side} in {}", lines.len());
        // Those of the runtime have names, too.
        for line in lines.iter().map(|line| &line["line"]) {
            if let Some(command) = line["command"].as_str() {
                assert!(!command.starts_with("0x"), "{line}");
            }
        }
    }
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_record_ends_with_ctrl_c_and_with_its_recorder() {
    let scratch = Scratch::empty();
    let run = up(&scratch, &[]);
    let mut record = scratch.start(MISBEHAVING, &["record", "--to", "one"], &[]);
    record.wait_for("record   load until Ctrl-C");
    assert_eq!(written(&scratch), 2, "the boot is not among the chassis");
    record.signal(Signal::INT);
    let ended = record.end();
    assert_eq!(ended.code, Some(0), "{}", ended.told);
    assert!(ended.stderr.contains("load.desk.mcap"), "{}", ended.told);
    assert_eq!(written(&scratch), 0);

    let wanted = [
        "record",
        "--to",
        "two",
        "--channels",
        "/message/arm",
        "--channels",
        "/began/s*",
    ];
    let mut record = scratch.start(MISBEHAVING, &wanted, &[]);
    record.wait_for("record   load until Ctrl-C");
    record.signal(Signal::KILL);
    assert_eq!(record.end().signal, Some(9));
    // Nobody waits for a clock here: each look takes its time.
    let gone = (0..200).any(|_| written(&scratch) == 0);
    assert!(gone, "the record goes on without its recorder");
    let path = scratch.path("two/load.desk.mcap");
    let info = ctos(&scratch, &["log", "info", "--json", path.to_str().unwrap()]).json();
    assert!(info["torn"].is_null(), "{info}");
    let topics = lines(&scratch, &["two/load.desk.mcap"]);
    for line in topics {
        let topic = line["topic"].as_str().unwrap();
        assert!(
            topic == "/message/arm" || topic.starts_with("/began/s"),
            "{topic}"
        );
    }
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_chassis_that_comes_back_is_recorded_again_and_the_end_of_the_app_ends_the_record() {
    let scratch = Scratch::empty();
    let run = up(&scratch, &[]);
    let mut record = scratch.start(MISBEHAVING, &["record", "--to", "rec"], &[]);
    record.wait_for("record   load until Ctrl-C");
    assert_eq!(ctos(&scratch, &["restart", "cage"]).code, Some(0));
    let again = (0..200).any(|_| written(&scratch) == 2);
    assert!(again, "the new process is not recorded");
    run.signal(Signal::INT);
    let ended = record.end();
    assert_eq!(ended.code, Some(0), "{}", ended.told);
    run.end().must_exit(130);
    let names: Vec<String> = files(&scratch, "rec")
        .iter()
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .collect();
    assert!(
        names.contains(&"load.cage.part2.mcap".to_owned()),
        "{names:?}"
    );
    let path = scratch.path("rec/load.desk.mcap");
    let info = ctos(&scratch, &["log", "info", "--json", path.to_str().unwrap()]).json();
    assert!(info["torn"].is_null(), "{info}");
}

#[test]
fn a_folder_that_cannot_be_written_is_said_before_anything_is_recorded() {
    let scratch = Scratch::empty();
    let run = up(&scratch, &[]);
    scratch.write("file", "no folder");
    let refused = ctos(&scratch, &["record", "--to", "file"]);
    assert_eq!(refused.code, Some(1), "{}", refused.told);
    assert!(
        refused.stderr.contains("cannot record to file"),
        "{}",
        refused.told
    );
    let refused = ctos(&scratch, &["record", "--to", "/dev/shm/../null/x"]);
    assert_eq!(refused.code, Some(1), "{}", refused.told);
    assert_eq!(ctos(&scratch, &["record", "lod"]).code, Some(4));
    assert_eq!(ctos(&scratch, &["record", "--for", "soon"]).code, Some(2));
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_simulated_run_is_recorded_and_the_same_seed_gives_the_same_bytes() {
    let scratch = Scratch::empty();
    // Without a pause no time would pass between two messages of one process.
    scratch.write(
        "app.toml",
        APP.replace("pause_s = 0.0 ", "pause_s = 0.001 "),
    );
    let record = |folder: &str, seed: &str| {
        let sim = [
            "sim", "app.toml", "--for", "0.2", "--faults", "rough", "--seed", seed,
        ];
        let ended = ctos(&scratch, &[&sim[..], &["--record", folder]].concat());
        assert_eq!(ended.code, Some(0), "{}", ended.told);
        fs::read(scratch.path(folder).join("load.mcap")).unwrap()
    };
    let one = record("one", "7");
    assert!(one.len() > 10_000, "{} bytes", one.len());
    assert!(one == record("two", "7"), "one seed, two records");
    assert!(one != record("three", "8"), "two seeds, one record");
}
