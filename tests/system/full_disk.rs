//! Recording to a disk that takes no more. The app goes on, says so once with what to do, counts what is
//! lost, and keeps what it had.

use std::process::Command;

use serde_json::Value;

use crate::{
    harness::{Ended, MISBEHAVING, Run, Scratch},
    moving::{APP, ctos, has_moved_at_last, must_have_moved_at_last},
};

/// No file of a process can grow beyond so many blocks of 512 or 1024 bytes, as on a disk that is full.
const LIMITED: &str = "mkdir disk; trap '' XFSZ; ulimit -f 1000; exec \"$0\" \"$@\"";

/// A file system of one megabyte that nobody else sees; what is on it in the end is kept.
const SMALL_DISK: &str = "mkdir disk kept; mount -t tmpfs -o size=1m none disk; \
    \"$0\" \"$@\"; code=$?; cp disk/* kept; exit $code";

fn is_possible() -> bool {
    let script = "mount -t tmpfs -o size=1m none /mnt";
    let tried = Command::new("unshare")
        .args(["-Urm", "sh", "-c", script])
        .output();
    tried.is_ok_and(|tried| tried.status.success())
}

const BOOT: [&str; 10] = [
    "boot",
    "app.toml",
    "--set",
    "record.file=\"disk/run.mcap\"",
    "--set",
    "record.flush_s=0.02",
    // However many files are begun in vain, the first one stays.
    "--set",
    "record.keep=1000",
    "--set",
    "task.judge.args.moves=1",
];

/// The record of a chassis, as `ctos ps` tells it.
fn record(scratch: &Scratch, chassis: &str) -> Value {
    let app = ctos(scratch, &["ps", "--json"]).json();
    let mut all = app["chassis"].as_array().unwrap().iter();
    let one = all.find(|one| one["name"] == chassis).unwrap();
    one["records"][0].clone()
}

/// Waits until the disk is full, looks, and lets the app end by itself.
fn must_go_on(scratch: &Scratch, mut run: Run<'_>, why: &str) -> Ended {
    run.wait_for("phase 3");
    run.wait_for("the record broke off");
    let full = (0..200)
        .map(|_| record(scratch, "desk"))
        .find(|record| record["trouble"].is_string());
    let full = full.expect("the app does not say that its disk is full");
    assert!(full["trouble"].as_str().unwrap().contains(why), "{full}");
    assert!(full["bytes"].as_u64().unwrap() > 0, "{full}");
    let status = ctos(scratch, &["status", "desk"]);
    assert!(
        status.stdout.contains("nothing is written"),
        "{}",
        status.told
    );
    assert!(status.stdout.contains("events are lost"), "{}", status.told);
    let lost = || record(scratch, "desk")["lost"].as_u64().unwrap();
    let before = lost();
    assert!(
        (0..200).any(|_| lost() > before),
        "what is lost is not counted"
    );
    must_have_moved_at_last(&ctos(scratch, &["move", "sink", "cage"]));
    let ended = run.end();
    assert!(
        ended.stdout.contains("came once and in order"),
        "{}",
        ended.told
    );
    for chassis in ["desk", "cage"] {
        let said = ended
            .stderr
            .lines()
            .filter(|line| line.starts_with(chassis) && line.contains("the record broke off"));
        assert!(said.count() <= 1, "said more than once: {}", ended.told);
    }
    ended.must_say("make room on its disk");
    ended
}

/// What was recorded before the disk was full can be read.
fn must_be_readable(scratch: &Scratch, file: &str) {
    let info = ctos(scratch, &["log", "info", "--json", file]).json();
    assert!(info["lines"].as_u64().unwrap() > 100, "{info}");
    let cat = ctos(
        scratch,
        &["log", "cat", "--json", file, "--topic", "/message/sink"],
    );
    assert_eq!(cat.code, Some(0), "{}", cat.stderr);
    assert!(cat.json_lines().len() > 10, "{}", cat.stderr);
}

#[test]
fn an_app_whose_record_may_not_grow_goes_on_without_it_and_says_so() {
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    // The limit is one of memory that is shared as well.
    let sockets = ["--set", "same_host=\"unix\""];
    let all = [&["-c", LIMITED, MISBEHAVING], &BOOT[..], &sockets[..]].concat();
    let run = scratch.start("sh", &all, &[]);
    let ended = must_go_on(&scratch, run, "File too large");
    ended.must_exit(0);
    must_be_readable(&scratch, "disk/run.desk.mcap");
}

#[test]
fn an_app_whose_disk_is_full_goes_on_without_its_record_and_says_so() {
    if !is_possible() {
        // The test above says the same without a disk of its own.
        return;
    }
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    let all = [&["-Urm", "sh", "-c", SMALL_DISK, MISBEHAVING], &BOOT[..]].concat();
    let run = scratch.start("unshare", &all, &[]);
    let ended = must_go_on(&scratch, run, "No space left on device");
    assert_eq!(ended.code, Some(0), "{}", ended.told);
    must_be_readable(&scratch, "kept/run.desk.mcap");
}

/// How many moves beneath records that break off are tried, and how many of them in each app.
const MOVES: usize = 6;
const IN_AN_APP: usize = 10;

/// A count that the long run asks for, or `usual`.
fn count(variable: &str, usual: usize) -> usize {
    std::env::var(variable).map_or(usual, |count| count.parse().unwrap())
}

/// Once in some hundred runs of an app like this, with a move each, a message came after a later one of its sender. A
/// fence had overtaken requests that waited for the link. The records of all its processes break off again and again
/// here.
#[test]
fn messages_to_a_task_that_moves_while_records_break_off_come_once_and_in_order() {
    let (wanted, in_an_app) = (
        count("CTOS_MOVES", MOVES),
        count("CTOS_MOVES_IN_AN_APP", IN_AN_APP),
    );
    let mut made = 0;
    while made < wanted {
        let count = in_an_app.min(wanted - made);
        let scratch = Scratch::empty();
        scratch.write("app.toml", APP);
        let moves = format!("task.judge.args.moves={count}");
        let limited = ["-c", LIMITED, MISBEHAVING];
        let sets = [
            "--set",
            "same_host=\"unix\"",
            "--set",
            "record.keep=3",
            // A machine that has no time for a chassis for some seconds is not what is tested here.
            "--set",
            "app.peer_timeout_s=60",
            "--set",
            &moves,
        ];
        let all = [&limited[..], &BOOT[..], &sets[..]].concat();
        let mut run = scratch.start("sh", &all, &[]);
        run.wait_for("phase 3");
        run.wait_for("the record broke off");
        let mut refused = None;
        for number in 0..count {
            let to = if number % 2 == 0 { "cage" } else { "desk" };
            let moved = ctos(&scratch, &["move", "sink", to]);
            if !has_moved_at_last(&moved) {
                refused = Some(moved.told);
                break;
            }
        }
        made += count;
        let ended = run.end();
        let refused = refused.unwrap_or_default();
        assert!(refused.is_empty(), "move {made}: {refused}{}", ended.told);
        let said = ended.stdout.contains("came once and in order");
        assert!(said, "within {made} moves: {}", ended.told);
        ended.must_exit(0);
    }
}
