//! The time of day is set while an app runs: by an operator, by a time server, after a battery has run empty. It
//! matters to nobody.
//!
//! The machine's own clock is left alone. A few lines of C stand before the system's functions in every process
//! of the run. They tell the time of day that a test wants.

use std::{
    fs::{self, OpenOptions},
    os::unix::fs::FileExt,
    path::PathBuf,
    process::Command,
    time::Duration,
};

use crate::harness::{CTOS, Scratch};

const HOUR: i64 = 3600;
const YEAR: i64 = 365 * 24 * HOUR;

/// The time of day as the processes of one folder see it.
struct TimeOfDay {
    library: PathBuf,
    ahead: PathBuf,
}

impl TimeOfDay {
    /// At first it is right.
    fn new(scratch: &Scratch) -> Self {
        let library = scratch.path("stepped_clock.so");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/system/stepped_clock.c");
        let built = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-Wall", "-Werror", source, "-o"])
            .arg(&library)
            .status();
        assert!(built.expect("programs were linked with it").success());
        let ahead = scratch.path("stepped_clock.seconds");
        fs::write(&ahead, 0_i64.to_ne_bytes()).unwrap();
        Self { library, ahead }
    }

    /// From now on it is so many seconds ahead of what it was at first.
    fn set(&self, seconds: i64) {
        let file = OpenOptions::new().write(true).open(&self.ahead).unwrap();
        file.write_all_at(&seconds.to_ne_bytes(), 0).unwrap();
    }

    fn environment(&self) -> [(&str, &str); 2] {
        [
            ("LD_PRELOAD", self.library.to_str().unwrap()),
            ("STEPPED_CLOCK", self.ahead.to_str().unwrap()),
        ]
    }

    /// What another program takes it to be, s.
    fn asked(&self) -> i64 {
        let told = Command::new("date")
            .arg("+%s")
            .envs(self.environment())
            .output();
        let told = String::from_utf8(told.unwrap().stdout).unwrap();
        told.trim().parse().unwrap()
    }
}

#[test]
fn a_clock_that_is_set_back_and_forth_under_a_running_app_changes_nothing() {
    let scratch = Scratch::short();
    let clock = TimeOfDay::new(&scratch);
    let before = clock.asked();
    let boot = ["boot", "configs/calibrate.toml", "--json"];
    let recorded = [&boot[..], &["--record", "run.mcap"]].concat();
    let mut run = scratch.start(CTOS, &recorded, &clock.environment());
    // Calls, timers, heartbeats, ticks and a record are under way whenever it is set, and for some time after.
    run.wait_for("1 of ");
    for step in [-HOUR, 30 * YEAR, -30 * YEAR, HOUR, 0] {
        clock.set(step);
        let off = clock.asked() - before - step;
        assert!((0..120).contains(&off), "it is not set: {off} s");
        run.hold(Duration::from_millis(1500));
    }
    let name = clock.library.file_name().unwrap().to_str().unwrap();
    for (chassis, process) in &run.chassis {
        let maps = format!("/proc/{}/maps", process.pid.as_raw_nonzero());
        let mapped = fs::read_to_string(maps).unwrap();
        assert!(mapped.contains(name), "{chassis} has the machine's clock");
    }
    let ended = run.end();
    let result = ended.must_exit(0).json();
    assert_eq!(result["ok"], true);
    ended.must_say("recorded run.mcap · 5 files, ");
    ended.must_say("look     ctos log info run.mcap");
    // Moments in the record are those of the run, which took less time than the smallest step.
    for chassis in ended.chassis.keys() {
        let file = format!("run.{chassis}.mcap");
        let info = scratch.ctos(&["log", "info", "--json", &file]);
        let info = info.must_exit(0).json();
        let took = info["to_s"].as_f64().unwrap() - info["from_s"].as_f64().unwrap();
        assert!(info["torn"].is_null() && took < 120.0, "{info}");
    }
}
