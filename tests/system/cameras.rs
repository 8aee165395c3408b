//! Five cameras under one manager, and the one that the arm carries.

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{CTOS, Run, SCOTT, Scratch};

const FIVE: [&str; 5] = [
    "ceiling_west",
    "ceiling_east",
    "side_south",
    "side_front",
    "wrist",
];

/// Boots the app under a name that no other test has: its snapshot buffers are of the whole host.
fn up<'a>(scratch: &'a Scratch, name: &str, more: &[&str]) -> Run<'a> {
    let name = format!("app.name=\"{name}\"");
    let all = [&["boot", "configs/cameras.toml", "--set", &name], more].concat();
    let mut run = scratch.start(CTOS, &all, &[]);
    run.wait_for("phase 3");
    run
}

fn spot(camera: &str) -> String {
    format!("spot EXEC camera {camera}")
}

fn numbers(value: &Value) -> Vec<f64> {
    let all = value.as_array().unwrap().iter();
    all.map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn five_cameras_see_the_lamp_at_once_each_by_its_own_number() {
    let scratch = Scratch::new();
    let name = format!("five_{}", std::process::id());
    let run = up(&scratch, &name, &[]);
    // The noise makes small things that are no lamps.
    let set = "spot CTRL -threshold 90 -min-area 5 -most 10000";
    scratch.scott(&[&name, "-c", set]).must_exit_leaving(0);
    let asked = FIVE.map(|camera| {
        let line = spot(camera);
        scratch.start(SCOTT, &[&name, "--json", "-c", &line], &[])
    });
    for (camera, run) in FIVE.iter().zip(asked) {
        let ended = run.end();
        ended.must_exit_leaving(0);
        let answer = ended.json();
        let spot = numbers(&answer["floats"]);
        assert!(spot.len() >= 3, "{camera}: {answer}");
        assert!((0.0..500.0).contains(&spot[0]) && (0.0..500.0).contains(&spot[1]));
        assert_eq!(answer["ints"][1], 0, "{camera}: {answer}");
    }
    stopped(run);
}

/// Ends it in order, so that nothing stays in the memory of the host.
fn stopped(run: Run<'_>) {
    run.signal(Signal::TERM);
    run.end();
}

/// The Tool that takes pictures is in one chassis, cameras and the daemon that looks at pictures are in another one.
#[test]
fn frames_cross_between_chassis_of_a_host_without_their_pixels() {
    let scratch = Scratch::new();
    let name = format!("crossing_{}", std::process::id());
    let mut run = up(&scratch, &name, &["--log", "vss=debug"]);
    let set = "spot CTRL -threshold 90 -min-area 5 -most 10000";
    scratch.scott(&[&name, "-c", set]).must_exit_leaving(0);
    let line = spot("side_south");
    scratch.scott(&[&name, "-c", &line]).must_exit_leaving(0);
    let fetched = run.line_with("pixels fetched");
    assert!(
        fetched.contains("side_south") && fetched.contains("250000"),
        "{fetched}"
    );
    stopped(run);
}

/// Each camera is asked for as many pictures as it gives, each of which crosses to who looks at it, while the arm moves. Nothing
/// is as large as a spot must be here: it is the cameras' work that is measured. A release on an idle machine with two cores
/// is held to 25 Hz of each and to the servo's period; anything else to giving all pictures.
#[test]
#[allow(clippy::print_stdout, reason = "what was measured is told, too")]
fn five_cameras_take_pictures_as_fast_as_they_are_asked_beside_a_moving_arm() {
    let measured = std::env::var_os("CTOS_CAMERAS_HZ").is_some();
    let pictures = if measured { 250 } else { 20 };
    let scratch = Scratch::new();
    // An object does one thing at a time, so each camera has its own.
    let own = FIVE.map(|camera| format!("spot.{camera} -threshold 254 -min-area 100000\n"));
    let dictionary = scratch.read("configs/cameras.dict") + &own.concat();
    scratch.write("configs/cameras.dict", dictionary);
    let name = format!("fast_{}", std::process::id());
    let run = up(&scratch, &name, &[]);
    let told = |line: &str| {
        let ended = scratch.scott(&[&name, "--json", "-c", line]);
        ended.must_exit_leaving(0);
        ended.json()
    };
    // Ticks of the servo, and those that were missed.
    let ticks = || numbers(&told("pino.arm EXEC state")["ints"]);
    let before = ticks();
    let asked = FIVE.map(|camera| {
        let lines = format!("{}.txt", camera);
        let line = format!("spot.{camera} EXEC camera {camera}\n");
        scratch.write(&lines, line.repeat(pictures));
        scratch.start(SCOTT, &[&name, "--json", "-f", &lines], &[])
    });
    let moved = told("mvpos.arm EXEC by FMSG 6 0.3 0.1 0.1 0 0 0.5");
    assert_eq!(moved["ret"], 0, "{moved}");
    let mut rates = Vec::new();
    for (camera, run) in FIVE.iter().zip(asked) {
        let ended = run.end();
        ended.must_exit_leaving(0);
        let answers: Vec<Value> = ended
            .stdout
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(answers.len(), pictures, "{camera}");
        // The last two are the picture's number and the stamp, ns.
        let stamps = answers.iter().map(|answer| {
            let ints = numbers(&answer["ints"]);
            (ints[ints.len() - 2], ints[ints.len() - 1])
        });
        let stamps: Vec<(f64, f64)> = stamps.collect();
        assert!(stamps.is_sorted_by(|one, other| one.0 < other.0 && one.1 < other.1));
        let seconds = (stamps[pictures - 1].1 - stamps[0].1) * 1e-9;
        rates.push((pictures - 1) as f64 / seconds);
    }
    let after = ticks();
    let (all, missed) = (after[0] - before[0], after[1] - before[1]);
    println!("pictures a second {rates:.1?}; ticks {all}, of which missed {missed}");
    if measured {
        assert!(rates.iter().all(|rate| *rate >= 25.0), "{rates:.1?}");
        assert!(missed <= 0.001 * all, "{missed} of {all} ticks are missed");
    }
    stopped(run);
}

/// Without the light there is nothing; a spot is where it was sent, and a line is found as one.
#[test]
fn the_laser_scanner_points_and_draws_and_a_camera_sees_where() {
    let scratch = Scratch::new();
    let name = format!("scanner_{}", std::process::id());
    let run = up(&scratch, &name, &[]);
    let told = |line: &str| {
        let ended = scratch.scott(&[&name, "--json", "-c", line]);
        ended.must_exit_leaving(0);
        ended.json()
    };
    told("spot CTRL -threshold 90 -min-area 3 -most 10000");
    told("lines CTRL -contrast 25 -length 40");
    let none = told("lines EXEC camera ceiling_west");
    let target = [0.2, -0.7, 0.0];
    let command = numbers(&told("laser.scanner EXEC point FMSG 3 0.2 -0.7 0")["floats"]);
    let spots = numbers(&told("spot EXEC camera ceiling_west")["floats"]);
    let met = spots.chunks(3).map(|spot| {
        let [a, b, u, v] = [command[0], command[1], spot[0], spot[1]];
        numbers(&told(&format!("laser.scanner EXEC spot FMSG 4 {a} {b} {u} {v}"))["floats"])
    });
    // A spot that is not of the beam has a gap; a pixel is 7 mm there.
    let met: Vec<Vec<f64>> = met.filter(|met| met[3] < 5e-3).collect();
    assert_eq!(met.len(), 1, "{met:?} of {spots:?}");
    for (met, target) in met[0].iter().zip(target) {
        assert!((met - target).abs() < 6e-3, "{met}, not {target}");
    }
    told("laser.scanner EXEC draw FMSG 4 3.77 -2 3.77 2");
    let drawn = told("lines EXEC camera ceiling_west");
    told("laser.scanner EXEC off");
    let off = told("lines EXEC camera ceiling_west");
    let pieces = |answer: &Value| answer["ints"][0].as_i64().unwrap();
    assert!(pieces(&drawn) > pieces(&none), "{drawn} {none}");
    assert_eq!(pieces(&off), pieces(&none), "{off} {none}");
    // One that the app does not have is told.
    told("laser CTRL -name pointer");
    let ended = scratch.scott(&[&name, "-c", "laser EXEC off"]);
    ended.must_exit_leaving(1);
    assert!(
        ended
            .stderr
            .contains("no Vision Module is called `vmLaser.pointer`"),
        "{}",
        ended.stderr
    );
    stopped(run);
}

/// The truth is where the lamp of the cell is as the world begins; what is answered is told beside it.
#[test]
#[allow(clippy::print_stdout, reason = "what was measured is told, too")]
fn two_of_the_cameras_triangulate_the_lamp_and_rays_that_are_parallel_are_refused() {
    let scratch = Scratch::new();
    let name = format!("stereo_{}", std::process::id());
    let run = up(&scratch, &name, &[]);
    let ended = scratch.scott(&[&name, "--json", "-f", "configs/stereo.sor"]);
    ended.must_exit_leaving(0);
    let answers = ended.stdout.lines().map(|line| {
        let answer: Value = serde_json::from_str(line).unwrap();
        numbers(&answer["floats"])
    });
    let found: Vec<Vec<f64>> = answers.filter(|floats| floats.len() == 8).collect();
    let [met] = found.as_slice() else {
        panic!("{}", ended.stdout);
    };
    let text = scratch.read("configs/cameras-cell.toml");
    let cell = sim::cell::Cell::parse(&ctos::diagnostic::Source::new("cell", text));
    let truth = cell.unwrap().start().lamps[0].centre;
    println!("found {met:.5?}, truth {truth:.5}");
    for (k, truth) in truth.iter().enumerate() {
        assert!((met[k] - truth).abs() < 4.0 * met[3 + k], "{met:?} {truth}");
    }
    assert!(met[6] < 4.0 * met[7], "{met:?}");
    // A second camera a millimetre beside the first one sees everything by parallel rays.
    let dictionary = scratch.read("configs/cameras.dict");
    let west = dictionary.split("-left ").nth(1).unwrap();
    let west: Vec<&str> = west.split_whitespace().take(15).collect();
    let mut beside: Vec<String> = west.iter().map(ToString::to_string).collect();
    let x: f64 = beside[12].parse().unwrap();
    beside[12] = (x + 1e-3).to_string();
    let set = format!(
        "triangulate CTRL -left {} -right {}",
        west.join(" "),
        beside.join(" ")
    );
    scratch.scott(&[&name, "-c", &set]).must_exit_leaving(0);
    let line = "triangulate EXEC cameras ceiling_west ceiling_west";
    let ended = scratch.scott(&[&name, "-c", line]);
    ended.must_exit_leaving(1);
    assert!(
        ended.stderr.contains("rays are parallel"),
        "{}",
        ended.stderr
    );
    stopped(run);
}

/// The client that steers it is an object of a daemon in a chassis of its own.
#[test]
fn the_scanner_goes_dark_and_to_the_next_client_when_the_chassis_of_the_first_one_dies() {
    let scratch = Scratch::new();
    let guest = "[task.guest]\nhandler = \"sorma.daemon\"\non = \"cage_tools\"\nargs.dictionary = [\"cameras.dict\"]\n";
    let app = scratch.read("configs/cameras.toml") + guest;
    scratch.write("configs/cameras.toml", app);
    let name = format!("steered_{}", std::process::id());
    let more = ["--set", "vss.hold_limit_s=600.0", "--log", "vss=debug"];
    let mut run = up(&scratch, &name, &more);
    let point = |object: &str| format!("{object} EXEC point FMSG 3 0.2 -0.7 0");
    let first = scratch.scott(&[&name, "-c", &point("laser.scanner@guest")]);
    first.must_exit_leaving(0);
    // Had it not been taken back, this one would be told after ten seconds that it is not granted.
    let line = point("laser.scanner");
    let second = scratch.start(SCOTT, &[&name, "-c", &line], &[]);
    run.kill("cage_tools");
    run.wait_for("off: whoever had it lit is gone");
    second.end().must_exit_leaving(0);
    stopped(run);
}

#[test]
fn what_a_killed_chassis_held_of_a_camera_is_taken_back() {
    let scratch = Scratch::new();
    // A picture takes five seconds, and a task may hold a camera for ten minutes.
    let cell = scratch.read("configs/cameras-cell.toml");
    let slow = cell.replacen("exposure_ms = 8.0", "exposure_ms = 5000.0", 1);
    scratch.write("configs/cameras-cell.toml", slow);
    let name = format!("killed_{}", std::process::id());
    let more = ["--set", "vss.hold_limit_s=600.0", "--log", "vss=debug"];
    let mut run = up(&scratch, &name, &more);
    let line = spot("ceiling_west");
    let first = scratch.start(SCOTT, &[&name, "-c", &line], &[]);
    run.wait_for("granted");
    run.kill("cage_tools");
    assert_ne!(first.end().code, Some(0));
    run.wait_for("taken back");
    run.wait_for("cage_tools is up again");
    let set = "spot CTRL -threshold 90 -min-area 5 -most 10000";
    scratch.scott(&[&name, "-c", set]).must_exit_leaving(0);
    // Had it not been taken back, nobody would get it for ten minutes, and the harness ends this after two.
    let again = scratch.scott(&[&name, "--json", "-c", &line]);
    again.must_exit_leaving(0);
    assert!(numbers(&again.json()["floats"]).len() >= 3);
}

#[test]
fn the_camera_on_the_arm_is_calibrated_within_its_own_standard_deviations() {
    let scratch = Scratch::new();
    let ended = scratch.ctos(&["sim", "configs/handeye.toml", "--json"]);
    ended.must_exit(0);
    let result = &ended.json()["result"];
    assert_eq!(result["link"], "puma.link6");
    assert!(result["samples"].as_u64().unwrap() >= 12, "{result}");
    let (error, sd) = (numbers(&result["error"]), numbers(&result["sd"]));
    for (error, sd) in error.iter().zip(&sd) {
        assert!(error.abs() < 3.5 * sd, "{result}");
    }
    // Good to a mrad and a mm, and not by saying nothing.
    assert!(sd[..3].iter().all(|sd| *sd < 1e-3), "{result}");
    assert!(sd[3..].iter().all(|sd| *sd < 1e-3), "{result}");
}
