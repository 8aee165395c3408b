//! Arms whose driver's other end is a process of its own, which is killed, frozen and started again while they move.

use std::{
    env,
    io::Read,
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::spawn,
};

use mcs_remote::socket::{Address, PeerSocket};
use rustix::process::{Pid, Signal, kill_process};
use sim::{cell::Cell, served::Served};

use crate::harness::{CTOS, Ended, Run, SCOTT, Scratch};

/// What [`serves_a_world`] is told: the cell's file, the socket, and the number of the start.
const SERVES: &str = "CTOS_SERVES_A_WORLD";

#[test]
#[ignore = "other tests run it, in a process of its own"]
fn serves_a_world() {
    let Ok(told) = env::var(SERVES) else { return };
    let [cell, socket, own] = told.split('|').collect::<Vec<_>>()[..] else {
        panic!("{told}");
    };
    let mut served = Served::new(&Cell::read(cell.as_ref()).unwrap(), 0, own.parse().unwrap());
    let socket = PeerSocket::bind(&Address::Unix(socket.into())).unwrap();
    // Whoever started it is gone when nothing can come from there any more.
    let over = Arc::new(AtomicBool::new(false));
    let until = Arc::clone(&over);
    spawn(move || {
        let ended = std::io::stdin().read_to_end(&mut Vec::new());
        over.store(true, Ordering::Relaxed);
        ended
    });
    served.as_mut().unwrap().serve(&socket, &until).unwrap();
}

/// A world in a process of its own.
struct World(Child);

impl World {
    fn start(scratch: &Scratch, cell: &str, own: u32) -> Self {
        let socket = scratch.path("configs/arm.socket");
        // What a process that was killed has left.
        let _ = std::fs::remove_file(&socket);
        let told = format!(
            "{}|{}|{own}",
            scratch.path(cell).display(),
            socket.display()
        );
        let child = Command::new(env::current_exe().unwrap())
            .args(["--exact", "drivers::serves_a_world", "--ignored"])
            .env(SERVES, told)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn();
        let mut world = Self(child.unwrap());
        while !socket.exists() {
            assert_eq!(world.0.try_wait().unwrap(), None, "it ended at once");
        }
        world
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.0), signal).unwrap();
    }
}

impl Drop for World {
    fn drop(&mut self) {
        // It may have been killed before.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn up<'s>(scratch: &'s Scratch, file: &str, sets: &[&str]) -> Run<'s> {
    let mut arguments = vec!["boot", file];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    let mut run = scratch.start(CTOS, &arguments, &[]);
    run.wait_for("phase 3");
    run
}

/// One app of these tests, asked by lines of text.
struct App<'s>(&'s Scratch, &'static str);

impl<'s> App<'s> {
    fn line(&self, line: &str) -> Ended {
        self.0.scott(&[self.1, "--json", "-c", line])
    }

    /// The numbers of an answer, which must not be an error.
    #[track_caller]
    fn asked(&self, line: &str) -> Vec<f64> {
        let ended = self.line(line);
        ended.must_exit_leaving(0);
        let answer = ended.json();
        let floats = answer["floats"].as_array().unwrap().iter();
        floats.map(|float| float.as_f64().unwrap()).collect()
    }

    fn starts(&self, line: &str) -> Run<'s> {
        self.0.start(SCOTT, &[self.1, "-c", line], &[])
    }

    fn state(&self, arm: &str) -> String {
        let arm = format!("pino{arm} EXEC state");
        self.0.scott(&[self.1, "-c", &arm]).stdout
    }

    /// A long and slow motion of the first joint by so much, which is under way when this returns.
    fn moving(&self, arm: &str, joints: usize, way: f64) -> Run<'s> {
        let first = || self.asked(&format!("pino{arm} EXEC state"))[0];
        let (begin, rest) = (first(), " 0".repeat(joints - 1));
        self.asked(&format!("mvpos{arm} CTRL -speed 0.1"));
        let run = self.starts(&format!("mvpos{arm} EXEC by FMSG {joints} {way}{rest}"));
        while (first() - begin).abs() < 0.01 {}
        run
    }

    /// Resets until that is possible, and moves by a little.
    fn works_again(&self, arm: &str, joints: usize) {
        while !self.state(arm).contains("cold") {
            self.line(&format!("pino{arm} EXEC reset"));
        }
        let before = self.asked(&format!("pino{arm} EXEC state"));
        let rest = " 0".repeat(joints - 1);
        let after = self.asked(&format!("mvpos{arm} EXEC by FMSG {joints} 0.05{rest}"));
        assert!(
            (after[0] - before[0] - 0.05).abs() < 4e-4,
            "{before:?} {after:?}"
        );
    }

    /// Holds that the arm is estopped, that this is told, and that nothing moves it.
    fn must_stand(&self, arm: &str, joints: usize, why: &str) {
        let told = self.state(arm);
        assert!(told.contains("estopped") && told.contains(why), "{told}");
        let place = || self.asked(&format!("pino{arm} EXEC state"))[..joints].to_vec();
        let before = place();
        let rest = " 0".repeat(joints - 1);
        for line in [
            format!("mvpos{arm} EXEC by FMSG {joints} 0.1{rest}"),
            format!("setpoint{arm} EXEC acquire"),
        ] {
            self.line(&line).must_exit_leaving(1).must_say(why);
        }
        assert_eq!(before, place());
    }
}

const AT_PATH: [&str; 2] = [
    "task.servo.args.driver_args.address=\"unix:arm.socket\"",
    "task.servo.args.driver_args.watchdog_ms=1000",
];
const PEER: &str = "the peer at `unix:";

#[test]
fn a_driver_whose_process_is_killed_in_mid_motion_is_named_and_the_arm_stands_until_it_is_back() {
    let scratch = Scratch::new();
    let (app, mut own) = (App(&scratch, "remote"), 1);
    let mut world = World::start(&scratch, "configs/cell.toml", own);
    let _run = up(&scratch, "configs/remote.toml", &AT_PATH);
    for _ in 0..2 {
        let moving = app.moving("", 6, 1.0);
        drop(world);
        moving.end().must_exit_leaving(1).must_say(PEER);
        app.must_stand("", 6, PEER);
        // It is still gone: a reset says so.
        app.line("pino EXEC reset")
            .must_exit_leaving(1)
            .must_say(PEER);
        own += 1;
        world = World::start(&scratch, "configs/cell.toml", own);
        app.works_again("", 6);
    }
}

#[test]
fn a_driver_whose_process_is_frozen_in_mid_motion_is_named_and_its_arm_has_braked_by_itself() {
    let scratch = Scratch::new();
    let app = App(&scratch, "remote");
    let world = World::start(&scratch, "configs/cell.toml", 1);
    let _run = up(&scratch, "configs/remote.toml", &AT_PATH);
    let moving = app.moving("", 6, 1.0);
    world.signal(Signal::STOP);
    moving.end().must_exit_leaving(1).must_say(PEER);
    app.must_stand("", 6, PEER);
    app.line("pino EXEC reset")
        .must_exit_leaving(1)
        .must_say(PEER);
    world.signal(Signal::CONT);
    app.works_again("", 6);
}

#[test]
fn a_servo_whose_process_is_frozen_in_mid_motion_finds_an_arm_that_stands_and_says_so() {
    let scratch = Scratch::new();
    let app = App(&scratch, "remote");
    let _world = World::start(&scratch, "configs/cell.toml", 1);
    let run = up(&scratch, "configs/remote.toml", &AT_PATH);
    let moving = app.moving("", 6, 1.0);
    run.freeze("cage");
    // Longer than the watchdog, and less long than a process is given up.
    run.hold(std::time::Duration::from_millis(1800));
    run.resume("cage");
    moving.end().must_exit_leaving(1).must_say(PEER);
    app.must_stand("", 6, PEER);
    app.works_again("", 6);
}

#[test]
fn the_end_of_the_process_behind_one_arm_leaves_the_other_one_on_its_way() {
    let scratch = Scratch::new();
    let app = App(&scratch, "testbed");
    scratch.edit(
        "configs/testbed-2x9.toml",
        "driver = \"sim.arm\", driver_args = { arm = \"left\" }",
        "driver = \"mcs.remote\", driver_args = { address = \"unix:arm.socket\", watchdog_ms = 1000 }",
    );
    let world = World::start(&scratch, "configs/testbed-cell.toml", 1);
    let _run = up(&scratch, "configs/testbed-2x9.toml", &[]);
    let begin = app.asked("pino.right EXEC state")[0];
    let left = app.moving(".left", 9, 0.8);
    let right = app.moving(".right", 9, 0.3);
    drop(world);
    left.end().must_exit_leaving(1).must_say(PEER);
    app.must_stand(".left", 9, PEER);
    right.end().must_exit_leaving(0);
    let end = app.asked("pino.right EXEC state")[0];
    assert!((end - begin - 0.3).abs() < 8e-4, "{begin} {end}");
    let _world = World::start(&scratch, "configs/testbed-cell.toml", 2);
    app.works_again(".left", 9);
}
