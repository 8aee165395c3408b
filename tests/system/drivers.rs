//! Arms whose driver's other end is a process of its own, which is killed, frozen and started again, or lies, while they move.

use std::{
    env,
    io::{BufRead, Write},
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, TryRecvError, channel},
    },
    thread::spawn,
    time::Duration,
};

use mcs_remote::{
    frame::{Frame, SIZE},
    socket::{Address, PeerSocket},
};
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
    let served = Served::new(&Cell::read(cell.as_ref()).unwrap(), 0, own.parse().unwrap());
    let socket = PeerSocket::bind(&Address::Unix(socket.into())).unwrap();
    let (over, (sender, lies)) = (Arc::new(AtomicBool::new(false)), channel());
    let until = Arc::clone(&over);
    spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            let _ = sender.send(line);
            over.store(true, Ordering::Relaxed);
        }
        // Whoever started it is gone when nothing can come from there any more.
        over.store(true, Ordering::Relaxed);
    });
    let mut served = served.unwrap();
    served.serve(&socket, &until).unwrap();
    lie(&mut served, &socket, &lies);
}

/// Answers with the lie that was told last, until nothing can be told any more.
fn lie(served: &mut Served, socket: &PeerSocket, lies: &Receiver<String>) {
    let (mut buffer, mut first, mut lie) = ([0; SIZE + 1], None, String::new());
    for count in 0_u64.. {
        match lies.try_recv() {
            Ok(told) => lie = told,
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => return,
        }
        let got = socket.receive(&mut buffer, Duration::from_millis(20));
        let Some((bytes, from)) = got.unwrap() else {
            continue;
        };
        let Some(answer) = served.take(bytes) else {
            continue;
        };
        let mut frame = Frame::decode(&answer).unwrap();
        let third = &mut frame.rows_mut()[2].values[0];
        match lie.as_str() {
            "no number" => *third = f64::NAN,
            // Each time back and forth: what stays where it jumped to is believed again after a reset.
            "jump" => *third += if count % 2 == 0 { 0.5 } else { 0.0 },
            _ => {}
        }
        let first = first.get_or_insert(frame);
        let told = if lie == "old" { *first } else { frame };
        socket.send(&told.encode(), &from);
    }
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

    /// From now on it tells this lie.
    fn lies(&mut self, lie: &str) {
        writeln!(self.0.stdin.as_mut().unwrap(), "{lie}").unwrap();
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

    /// A motion of the first joint by so much, under way when this returns.
    fn moving(&self, arm: &str, (way, speed): (f64, f64)) -> Run<'s> {
        let first = || self.asked(&format!("pino{arm} EXEC state"))[0];
        let begin = first();
        self.asked(&format!("mvpos{arm} CTRL -speed {speed}"));
        let run = self.starts(&format!("mvpos{arm} EXEC by FMSG 6 {way} 0 0 0 0 0"));
        while (first() - begin).abs() < 0.002 {}
        run
    }

    /// Resets until that is possible, and moves by a little.
    fn works_again(&self, arm: &str) {
        while !self.state(arm).contains("cold") {
            self.line(&format!("pino{arm} EXEC reset"));
        }
        let before = self.asked(&format!("pino{arm} EXEC state"));
        self.asked(&format!("mvpos{arm} CTRL -speed 0.2"));
        let after = self.asked(&format!("mvpos{arm} EXEC by FMSG 6 0.05 0 0 0 0 0"));
        assert!(
            (after[0] - before[0] - 0.05).abs() < 4e-4,
            "{before:?} {after:?}"
        );
    }

    /// Holds that the arm is estopped, that this is told, and that nothing moves it.
    fn must_stand(&self, arm: &str, why: &str) {
        let told = self.state(arm);
        assert!(told.contains("estopped") && told.contains(why), "{told}");
        let place = || self.asked(&format!("pino{arm} EXEC state"))[..6].to_vec();
        let before = place();
        for line in [
            format!("mvpos{arm} EXEC by FMSG 6 0.1 0 0 0 0 0"),
            format!("setpoint{arm} EXEC acquire"),
        ] {
            self.line(&line).must_exit_leaving(1).must_say(why);
        }
        assert_eq!(before, place());
    }
}

/// A loop so slow that it bears what a busy machine delays.
const AT_PATH: [&str; 3] = [
    "task.servo.args.driver_args.address=\"unix:arm.socket\"",
    "task.servo.args.driver_args.watchdog_ms=1000",
    "task.servo.args.bandwidth_hz=3",
];
const PEER: &str = "the peer at `unix:";
/// 1 rad at a hundredth of full speed.
const SLOW: (f64, f64) = (1.0, 0.01);
/// So fast that the joint is away from its setpoint for `following_timeout_s` long before the watchdog of a silent peer.
const FAST: (f64, f64) = (1.0, 0.1);

#[test]
fn a_driver_whose_process_is_killed_in_mid_motion_is_named_and_the_arm_stands_until_it_is_back() {
    let scratch = Scratch::new();
    let (app, mut own) = (App(&scratch, "remote"), 1);
    let mut world = World::start(&scratch, "configs/cell.toml", own);
    let _run = up(&scratch, "configs/remote.toml", &AT_PATH);
    for _ in 0..2 {
        let moving = app.moving("", SLOW);
        drop(world);
        moving.end().must_exit_leaving(1).must_say(PEER);
        app.must_stand("", PEER);
        // It is still gone: a reset says so.
        app.line("pino EXEC reset")
            .must_exit_leaving(1)
            .must_say(PEER);
        own += 1;
        world = World::start(&scratch, "configs/cell.toml", own);
        app.works_again("");
    }
}

#[test]
fn a_driver_whose_process_is_frozen_in_mid_motion_is_named_and_its_arm_has_braked_by_itself() {
    let scratch = Scratch::new();
    let app = App(&scratch, "remote");
    let world = World::start(&scratch, "configs/cell.toml", 1);
    let _run = up(&scratch, "configs/remote.toml", &AT_PATH);
    for motion in [SLOW, FAST] {
        let moving = app.moving("", motion);
        world.signal(Signal::STOP);
        let ended = moving.end();
        ended.must_exit_leaving(1).must_say(PEER);
        ended.must_say("it has answered nothing for ");
        app.must_stand("", PEER);
        while !app.line("pino EXEC reset").told.contains(PEER) {}
        world.signal(Signal::CONT);
        app.works_again("");
    }
}

#[test]
fn a_driver_whose_process_lies_in_mid_motion_is_named_with_its_lie_and_works_again_when_it_tells_the_truth()
 {
    let scratch = Scratch::new();
    let app = App(&scratch, "remote");
    let mut world = World::start(&scratch, "configs/cell.toml", 1);
    let _run = up(&scratch, "configs/remote.toml", &AT_PATH);
    let (way, speed) = FAST;
    for (lie, way, named) in [
        (
            "no number",
            way,
            "sent a position or a speed of slot 3 that is no finite number",
        ),
        ("jump", -way, "let slot 3 jump by "),
        ("old", way, "an old or repeated sequence number"),
    ] {
        let moving = app.moving("", (way, speed));
        world.lies(lie);
        let ended = moving.end();
        ended.must_exit_leaving(1).must_say(PEER).must_say(named);
        app.must_stand("", named);
        let before = app.asked("pino EXEC state")[0];
        // It still lies: a reset says so.
        app.line("pino EXEC reset")
            .must_exit_leaving(1)
            .must_say(named);
        world.lies("no more");
        app.works_again("");
        // The arm had braked at once.
        let moved = app.asked("pino EXEC state")[0] - 0.05 - before;
        assert!(moved.abs() < 0.05, "{lie}: {moved}");
    }
}

#[test]
fn the_end_of_the_process_behind_one_arm_leaves_the_other_one_on_its_way() {
    let scratch = Scratch::new();
    let app = App(&scratch, "testbed");
    let text = scratch.read("configs/testbed.toml");
    let own = "driver = \"sim.arm\"\ndriver_args = { arm = \"left\", joints = [\"arm.joint1\", \"arm.joint2\", \"arm.joint3\", \"arm.joint4\", \"arm.joint5\", \"arm.joint6\"] }";
    assert!(text.contains(own), "{text}");
    let other = "bandwidth_hz = 3\ndriver = \"mcs.remote\"\ndriver_args = { address = \"unix:arm.socket\", watchdog_ms = 1000 }";
    scratch.write("configs/testbed.toml", text.replace(own, other));
    let world = World::start(&scratch, "configs/cell.toml", 1);
    let _run = up(&scratch, "configs/testbed.toml", &[]);
    let begin = app.asked("pino.right EXEC state")[0];
    let left = app.moving(".left", SLOW);
    let right = app.moving(".right", (0.5, 0.05));
    drop(world);
    left.end().must_exit_leaving(1).must_say(PEER);
    app.must_stand(".left", PEER);
    right.end().must_exit_leaving(0);
    let end = app.asked("pino.right EXEC state")[0];
    assert!((end - begin - 0.5).abs() < 8e-4, "{begin} {end}");
    let _world = World::start(&scratch, "configs/cell.toml", 2);
    app.works_again(".left");
}
