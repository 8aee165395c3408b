//! The PUMA of `configs/remote.toml` in another process than its servo: this project's own world, and MuJoCo.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{JoinHandle, spawn},
};

use mcs_remote::socket::{Address, PeerSocket};
use sim::{cell::Cell, served::Served};

use crate::harness::{CTOS, Run, Scratch};

/// A world behind the protocol, in a thread of the test.
struct World {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl World {
    fn start(scratch: &Scratch, own: u32) -> Self {
        let cell = Cell::read(&scratch.path("configs/cell.toml")).unwrap();
        let socket = PeerSocket::bind(&Address::Unix(scratch.path("configs/arm.socket"))).unwrap();
        let over = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&over);
        let mut served = Served::new(&cell, 0, own).unwrap();
        let thread = spawn(move || served.serve(&socket, &until).unwrap());
        Self {
            over,
            thread: Some(thread),
        }
    }
}

impl Drop for World {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        // What it panicked with was told already.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn up<'s>(scratch: &'s Scratch, sets: &[&str]) -> Run<'s> {
    let mut arguments = vec!["boot", "configs/remote.toml"];
    for set in sets {
        arguments.extend(["--set", set]);
    }
    let mut run = scratch.start(CTOS, &arguments, &[]);
    run.wait_for("phase 3");
    run
}

/// A machine under tests is slow: nobody is given up because of that.
const AT_PATH: [&str; 2] = [
    "task.servo.args.driver_args.address=\"unix:arm.socket\"",
    "task.servo.args.driver_args.watchdog_ms=1000",
];

/// The numbers of an answer, which must not be an error.
#[track_caller]
fn asked(scratch: &Scratch, line: &str) -> Vec<f64> {
    let ended = scratch.scott(&["remote", "--json", "-c", line]);
    ended.must_exit_leaving(0);
    let answer = ended.json();
    let floats = answer["floats"].as_array().unwrap();
    floats.iter().map(|float| float.as_f64().unwrap()).collect()
}

/// Moves the arm by a little and back again; where it was told to go it must be.
#[track_caller]
fn moves(scratch: &Scratch) {
    let before = asked(scratch, "mvpos EXEC where");
    let way = [0.2, -0.1, 0.1, 0.2, -0.1, 0.3];
    for sign in [1.0, -1.0] {
        let by = way.map(|joint| (sign * joint).to_string()).join(" ");
        let after = asked(scratch, &format!("mvpos EXEC by FMSG 6 {by}"));
        for (joint, way) in way.iter().enumerate() {
            let goal = before[joint] + if sign > 0.0 { *way } else { 0.0 };
            let off = (after[joint] - goal).abs();
            // Four times what a motion may be off when it counts as settled: each of both begins where the arm is.
            assert!(off < 8e-4, "joint {joint}: {off}");
        }
    }
}

#[test]
fn the_arm_moves_in_another_process_and_stands_when_that_dies_until_it_is_back() {
    let scratch = Scratch::new();
    let world = World::start(&scratch, 1);
    let _run = up(&scratch, &AT_PATH);
    moves(&scratch);
    drop(world);
    let state = || scratch.scott(&["remote", "-c", "pino EXEC state"]).stdout;
    while !state().contains("fault: ") {}
    let told = state();
    assert!(told.contains("estopped"), "{told}");
    assert!(told.contains("the peer at `unix:"), "{told}");
    let refused = scratch.scott(&["remote", "-c", "mvpos EXEC by FMSG 6 0.1 0 0 0 0 0"]);
    refused.must_exit_leaving(1).must_say("reset it");
    let _world = World::start(&scratch, 2);
    while !state().contains("cold") {
        scratch.scott(&["remote", "-c", "pino EXEC reset"]);
    }
    moves(&scratch);
}

#[test]
fn what_is_wrong_with_an_address_is_found_before_anything_starts() {
    let scratch = Scratch::new();
    let address = "task.servo.args.driver_args.address=";
    let check = |sets: &[&str]| {
        let mut arguments = vec!["check", "configs/remote.toml"];
        sets.iter().for_each(|set| arguments.extend(["--set", set]));
        scratch.ctos(&arguments)
    };
    check(&[]).must_exit(0);
    for wrong in [
        "127.0.0.1:4560",
        "udp:127.0.0.1",
        "udp:127.0.0.1:65536",
        "unix:",
    ] {
        let set = format!("{address}\"{wrong}\"");
        let found = check(&[&set]);
        found
            .must_exit(3)
            .must_say("is no address of a peer")
            .must_say("--set:1:");
    }
    let found = check(&["task.servo.args.driver_args.watchdog_ms=0"]);
    found.must_exit(3).must_say("give a value from 1 to 4000");
    let found = check(&["time.mode=\"virtual\""]);
    found
        .must_exit(3)
        .must_say("does not know the app's virtual time");
    let second = "\n[task.second]\nhandler = \"mcs.servo\"\non = \"cage/servo\"\nargs = { driver = \"mcs.remote\", driver_args.address = \"udp:127.0.0.1:4560\" }\n";
    let text = scratch.read("configs/remote.toml");
    scratch.write("configs/remote.toml", text + second);
    check(&[])
        .must_exit(3)
        .must_say("is driven by task `servo` already");
}

/// The interpreter with which MuJoCo is asked for.
fn python() -> String {
    std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

/// MuJoCo in a process of its own, ended when dropped.
struct Engine(Child);

impl Engine {
    fn start(scratch: &Scratch) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/examples/mujoco/peer.py");
        let urdf = scratch.scott(&[
            "--local",
            "--json",
            "-c",
            "dyn.puma560 CTRL -inertias engine",
            "-c",
            "dyn.puma560 EXEC urdf",
        ]);
        urdf.must_exit_leaving(0);
        scratch.write("arm.urdf", urdf.json()["text"].as_str().unwrap());
        let mut child = Command::new(python())
            .arg(script)
            .args(["arm.urdf", "unix:configs/arm.socket", "--start"])
            .args(["0", "0.785", "-1.571", "0", "0.785", "0"])
            .current_dir(scratch.path("."))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let mut said = BufReader::new(child.stdout.take().unwrap());
        said.read_line(&mut line).unwrap();
        assert!(line.contains("6 slots in MuJoCo"), "{line}");
        Self(child)
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
#[ignore = "needs the Python package mujoco: tests/run looks for it"]
fn the_same_servo_and_laws_drive_a_physics_engine_that_others_wrote() {
    for law in ["pid", "computed_torque"] {
        let scratch = Scratch::new();
        let _engine = Engine::start(&scratch);
        let law = format!("task.servo.args.law=\"{law}\"");
        let _run = up(&scratch, &[AT_PATH[0], AT_PATH[1], &law]);
        moves(&scratch);
    }
}

/// The two errors of a law, mrad, from what the example says: in motion, and settled.
fn errors(said: &str, law: &str) -> [f64; 2] {
    let start = format!("{law}: ");
    let line = said.lines().find(|line| line.starts_with(&start)).unwrap();
    let before = |unit: &str| {
        let words: Vec<&str> = line.split(unit).next().unwrap().split(' ').collect();
        words.last().unwrap().parse().unwrap()
    };
    [before(" mrad in motion"), before(" mrad settled")]
}

/// Has the example `track` move the arm behind an address, and holds what it says against what is promised.
#[track_caller]
fn must_be_tracked(scratch: &Scratch, place: &[&str]) {
    // Built with the tests, in the folder beside theirs.
    let tests = std::env::current_exe().unwrap();
    let example = tests.ancestors().nth(2).unwrap().join("examples/track");
    let ran = Command::new(&example)
        .args(place)
        .current_dir(scratch.path("."))
        .output()
        .unwrap_or_else(|error| panic!("{}: {error}", example.display()));
    let said = String::from_utf8(ran.stdout).unwrap();
    let complaint = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{said}{complaint}");
    let [moving, settled] = errors(&said, "pid");
    let [better, still] = errors(&said, "computed_torque");
    assert!(moving <= 4.0 && settled <= 0.05 && still <= 0.05, "{said}");
    assert!(10.0 * better <= moving, "{said}");
}

#[test]
fn the_arm_of_the_cell_is_tracked_within_four_milliradians_and_ten_times_better_with_its_model() {
    must_be_tracked(&Scratch::new(), &["inside"]);
}

#[test]
#[ignore = "needs the Python package mujoco: tests/run looks for it"]
fn an_engine_that_others_wrote_is_tracked_as_well_as_the_cell() {
    let scratch = Scratch::new();
    let _engine = Engine::start(&scratch);
    must_be_tracked(&scratch, &["unix:configs/arm.socket", "in-step"]);
}
