//! Setpoints and torques that are streamed: followed within limits, and ended by name.

use std::sync::Mutex;

use super::*;
use crate::guard::speed::Speed;
use crate::guard::{Mounted, Reaction};
use crate::servo::stream::{Following, Newest, Source, Stream, StreamKind};

const PERIOD: f64 = 0.0045;

/// What a test streams: its clock (s), and the newest value with its number and stamp (s).
#[derive(Default)]
struct Feed {
    now: f64,
    count: u64,
    stamp: f64,
    numbers: Vec<f64>,
}

/// The servo's side of it.
struct Fed(Arc<Mutex<Feed>>, Vec<f64>);

impl Source for Fed {
    fn newest(&mut self) -> Option<Newest<'_>> {
        let feed = self.0.lock().unwrap();
        self.1.clone_from(&feed.numbers);
        (feed.count > 0).then(|| Newest {
            count: feed.count,
            stamp: feed.stamp,
            age: feed.now - feed.stamp,
            numbers: &self.1,
        })
    }
}

/// A rig with a stream, whose setpoints are all kept.
struct Streamed {
    rig: Rig,
    feed: Arc<Mutex<Feed>>,
    serial: u64,
    setpoints: Vec<Joints>,
}

impl Streamed {
    fn new() -> Self {
        Self::limiting_jerk(false)
    }

    fn limiting_jerk(limits: bool) -> Self {
        let mut rig = Rig::pid();
        rig.servo.config.limit_jerk = limits;
        rig.release();
        Self {
            rig,
            feed: Arc::default(),
            serial: 0,
            setpoints: Vec::new(),
        }
    }

    fn following(kind: StreamKind) -> Self {
        let mut streamed = Self::new();
        streamed.begin(kind, 1.0);
        assert_eq!(streamed.status().stream.serial, 1);
        streamed
    }

    fn begin(&mut self, kind: StreamKind, pace: f64) {
        self.serial += 1;
        *self.feed.lock().unwrap() = Feed::default();
        let how = Following {
            serial: self.serial,
            kind,
            max_age: 0.1,
            pace: (pace, pace),
            guards: GuardSet::default(),
        };
        let source = Box::new(Fed(Arc::clone(&self.feed), Vec::new()));
        let stream = Stream::new(how, source, self.rig.planner.model());
        self.rig.port.stream(Box::new(stream)).unwrap();
        self.tick();
    }

    fn status(&self) -> ServoStatus {
        self.rig.port.status()
    }

    fn put(&self, numbers: &[f64]) {
        let mut feed = self.feed.lock().unwrap();
        feed.count += 1;
        feed.stamp = feed.now;
        feed.numbers = numbers.to_vec();
    }

    fn tick(&mut self) {
        self.feed.lock().unwrap().now += PERIOD;
        self.rig.servo.tick(0);
        self.setpoints.push(self.status().setpoint);
    }

    /// So many ticks, the value being given anew in each.
    fn hold(&mut self, numbers: &[f64], ticks: u32) {
        for _ in 0..ticks {
            self.put(numbers);
            self.tick();
        }
    }

    /// Ticks until nothing moves any more.
    fn rest(&mut self) {
        for _ in 0..1500 {
            self.tick();
            if self.status().at_rest {
                return;
            }
        }
        panic!("it never came to rest: {:?}", self.status());
    }

    fn end(&self) -> String {
        let end = self.status().stream.end;
        end.map_or_else(String::new, |end| end.to_string())
    }

    /// Holds that no setpoint went beyond this fraction of the limits.
    #[track_caller]
    fn held_limits(&self, pace: f64) {
        for triple in self.setpoints.windows(3) {
            for (joint, own) in self.rig.planner.model().joints().iter().enumerate() {
                let limit = &own.limits;
                let [a, b, c] = [0, 1, 2].map(|at: usize| triple[at][joint]);
                let speed = (c - b).abs() / PERIOD;
                assert!(
                    speed <= pace * limit.velocity + 1e-6,
                    "joint {joint}: {speed}"
                );
                let rate = (c - 2.0 * b + a).abs() / (PERIOD * PERIOD);
                assert!(
                    rate <= pace * limit.acceleration + 1e-6,
                    "joint {joint}: {rate}"
                );
                assert!(c <= limit.upper + 1e-9 && c >= limit.lower - 1e-9);
            }
        }
    }

    /// Holds that the accelerations between setpoints changed no faster than the limits of jerk allow.
    #[track_caller]
    fn held_jerk(&self) {
        for (tick, four) in self.setpoints.windows(4).enumerate() {
            for (joint, own) in self.rig.planner.model().joints().iter().enumerate() {
                let [a, b, c, d] = [0, 1, 2, 3].map(|at: usize| four[at][joint]);
                let jerk = (d - 3.0 * c + 3.0 * b - a).abs() / PERIOD.powi(3);
                assert!(
                    jerk <= own.limits.jerk * (1.0 + 1e-6) + 1e-3,
                    "tick {tick}, joint {joint}: {jerk}"
                );
            }
        }
    }
}

fn away(by: f64) -> [f64; 6] {
    START.map(|joint| joint - by)
}

#[test]
fn a_jump_of_a_stream_is_made_within_the_limits_and_held() {
    for pace in [1.0, 0.3] {
        let mut streamed = Streamed::new();
        streamed.begin(StreamKind::Joints, pace);
        streamed.hold(&away(0.5), 600);
        let status = streamed.status();
        assert_eq!((status.fault, status.stream.end), (None, None));
        assert!(distance(&status.setpoint, &away(0.5).into()) < 1e-9);
        assert_eq!(status.motion.phase, MotionPhase::Moving);
        streamed.held_limits(pace);
        // And back in the midst of the way.
        streamed.hold(&away(-0.3), 40);
        streamed.hold(&away(0.5), 400);
        streamed.held_limits(pace);
    }
}

#[test]
fn a_stream_keeps_limits_of_jerk_in_jumps_when_it_ends_and_when_it_is_stopped() {
    for pace in [1.0, 0.3] {
        let mut streamed = Streamed::limiting_jerk(true);
        streamed.begin(StreamKind::Joints, pace);
        streamed.hold(&away(0.5), 600);
        assert!(distance(&streamed.status().setpoint, &away(0.5).into()) < 1e-9);
        // Back in the midst of the way, and beyond what a joint may do.
        streamed.hold(&away(-0.3), 40);
        streamed.hold(&away(0.5), 30);
        streamed.hold(&away(0.8), 80);
        streamed.held_limits(pace);
        streamed.held_jerk();
        // Silence.
        streamed.rest();
        assert!(streamed.end().starts_with("the newest value is"));
        streamed.held_limits(1.0);
        streamed.held_jerk();
    }
    let mut streamed = Streamed::limiting_jerk(true);
    streamed.begin(StreamKind::Joints, 1.0);
    streamed.hold(&away(0.8), 40);
    streamed.rig.port.order(ServoCommand::Stop).unwrap();
    streamed.rest();
    streamed.held_limits(1.0);
    streamed.held_jerk();
}

#[test]
fn a_smooth_stream_at_50_hz_is_followed_as_far_behind_as_its_values_are_apart() {
    for with_speeds in [false, true] {
        let mut streamed = Streamed::following(StreamKind::Joints);
        let sway = |t: f64| 0.2 * (1.0 - (3.0 * t).cos());
        let mut worst = 0.0_f64;
        for tick in 0..1200 {
            let now = f64::from(tick) * PERIOD;
            // Every 18 ms and every 22.5 ms in turn.
            if tick % 9 == 0 || tick % 9 == 4 {
                let mut value = away(sway(now)).to_vec();
                if with_speeds {
                    value.extend([-0.6 * (3.0 * now).sin(); 6]);
                }
                streamed.put(&value);
            }
            streamed.tick();
            let setpoint = streamed.status().setpoint;
            let off = |behind: f64| (setpoint[0] - (START[0] - sway(now - behind))).abs();
            let least = (0..8).fold(f64::INFINITY, |least, ticks| {
                least.min(off(f64::from(ticks) * PERIOD))
            });
            worst = worst.max(least);
        }
        let status = streamed.status();
        assert_eq!((status.fault, status.stream.end), (None, None));
        assert!(
            status.motion.max_tracking_error.turning < 4e-3,
            "{:?}",
            status.motion
        );
        assert!(worst < 2e-3, "with speeds {with_speeds}: {worst} rad");
        streamed.held_limits(1.0);
    }
}

#[test]
fn a_value_that_grows_too_old_brings_the_arm_to_rest_by_name_and_it_can_go_on_anew() {
    let mut streamed = Streamed::following(StreamKind::Joints);
    // In the midst of a way at full speed it falls silent.
    streamed.hold(&away(0.8), 80);
    streamed.rest();
    let end = streamed.end();
    assert!(
        end.starts_with("the newest value is 0.10")
            && end.ends_with("s old, and the limit is 0.100 s"),
        "{end}"
    );
    streamed.held_limits(1.0);
    let status = streamed.status();
    assert_eq!((status.power, status.fault), (Power::Released, None));
    assert_eq!(status.motion.phase, MotionPhase::Stopped);
    assert!(distance(&status.setpoint, &away(0.8).into()) > 0.01);
    // What comes too late is not followed.
    let held = status.setpoint;
    streamed.hold(&away(0.8), 50);
    assert_eq!(streamed.status().setpoint, held);
    // A new stream is, and a motion after it.
    streamed.begin(StreamKind::Joints, 1.0);
    streamed.hold(&away(0.8), 600);
    assert!(distance(&streamed.status().setpoint, &away(0.8).into()) < 1e-9);
    streamed.held_limits(1.0);
    streamed.rig.order(ServoCommand::Cancel);
    streamed.rest();
    let segment = streamed.rig.plan(0.5);
    streamed.rig.start(segment);
    assert_eq!(streamed.rig.run_to_end().phase, MotionPhase::Done);
}

#[test]
fn without_a_first_value_the_arm_holds_and_the_stream_ends() {
    let mut streamed = Streamed::following(StreamKind::Joints);
    let held = streamed.status().setpoint;
    (0..60).for_each(|_| streamed.tick());
    assert_eq!(streamed.end(), "no value has come within 0.100 s");
    assert_eq!(streamed.status().setpoint, held);
}

#[test]
fn a_value_that_cannot_be_followed_is_named_and_the_arm_comes_to_rest() {
    let with = |index: usize, value: f64| {
        let mut numbers = away(0.6).to_vec();
        numbers.resize(12, 0.0);
        numbers[index] = value;
        numbers
    };
    let cases = [
        (with(2, f64::NAN), "number 3 of a value is NaN"),
        (with(7, f64::INFINITY), "number 8 of a value is inf"),
        (vec![0.0; 5], "a value has 5 numbers and not 6 or 12"),
        (vec![], "a value has 0 numbers and not 6 or 12"),
        (
            with(4, 2.0),
            "joint 5 would have to be at 2.0000 rad, its limits are",
        ),
        (with(6, 9.0), "the speed of joint 1 is 9.0000, its limit is"),
    ];
    for (numbers, expected) in cases {
        let mut streamed = Streamed::following(StreamKind::Joints);
        streamed.hold(&away(0.6), 60);
        streamed.put(&numbers);
        streamed.rest();
        let end = streamed.end();
        assert!(end.starts_with(expected), "{end}");
        streamed.held_limits(1.0);
        let status = streamed.status();
        assert_eq!((status.power, status.fault), (Power::Released, None));
    }
}

#[test]
fn a_stream_is_begun_only_by_an_arm_that_is_held_and_at_rest() {
    let mut streamed = Streamed::new();
    let rejected = |streamed: &Streamed| streamed.status().stream_rejected;
    let segment = streamed.rig.plan(0.5);
    streamed.rig.start(segment);
    streamed.begin(StreamKind::Joints, 1.0);
    assert_eq!(rejected(&streamed), Some((1, Rejection::Moving)));
    assert_eq!(streamed.rig.run_to_end().phase, MotionPhase::Done);
    streamed.rig.order(ServoCommand::Stop);
    streamed.begin(StreamKind::Joints, 1.0);
    assert_eq!(rejected(&streamed), Some((2, Rejection::Stopped)));
    streamed.rig.order(ServoCommand::Resume);
    streamed.begin(StreamKind::Joints, 1.0);
    assert_eq!(streamed.status().stream.serial, 3);
    streamed.begin(StreamKind::Joints, 1.0);
    assert_eq!(rejected(&streamed), Some((4, Rejection::Streaming)));
    // No segment meanwhile, and the stream is not disturbed.
    let segment = streamed.rig.plan(0.5);
    streamed.rig.order(ServoCommand::Move { id: 90, segment });
    let told = streamed.status().rejected;
    assert_eq!(told, Some((90, Rejection::Streaming)));
    assert_eq!(streamed.status().stream.end, None);
    streamed.rig.port.emergency_stop();
    streamed.begin(StreamKind::Joints, 1.0);
    streamed.begin(StreamKind::Joints, 1.0);
    assert_eq!(rejected(&streamed), Some((6, Rejection::NotReleased)));
}

#[test]
fn every_stop_ends_a_stream_within_the_limits_and_means_what_it_means_of_a_motion() {
    for (stop, power, fault) in [
        (ServoCommand::Stop, Power::Released, None),
        (ServoCommand::Cancel, Power::Released, None),
        (ServoCommand::EngageBrakes, Power::Braked, None),
        (ServoCommand::PowerOff, Power::Off, None),
        (
            ServoCommand::ControlledStop,
            Power::Off,
            Some(Fault::ControlledStop),
        ),
        (
            ServoCommand::EmergencyStop,
            Power::Off,
            Some(Fault::EmergencyStop),
        ),
    ] {
        let mut streamed = Streamed::following(StreamKind::Joints);
        streamed.hold(&away(0.8), 60);
        let stopped = stop.clone();
        streamed.rig.port.order(stop).unwrap();
        // It falls not silent: its values are not followed.
        for _ in 0..1000 {
            streamed.put(&away(0.8));
            streamed.tick();
            if streamed.status().at_rest && streamed.status().power == power {
                break;
            }
        }
        let status = streamed.status();
        assert_eq!((status.power, status.fault), (power, fault), "{stopped:?}");
        assert!(!streamed.end().is_empty());
        if fault != Some(Fault::EmergencyStop) {
            assert_eq!(status.motion.phase, MotionPhase::Stopped);
            let speed = *streamed.rig.knobs.speed_at_power_off.lock().unwrap();
            assert!(
                speed.is_none_or(|speed| speed < 5e-3),
                "{stopped:?}: {speed:?}"
            );
        }
    }
}

#[test]
fn a_guard_ends_a_stream_and_is_named() {
    let mut streamed = Streamed::new();
    let slow = Speed {
        joints: vec![0.4; 6],
        ..Speed::default()
    };
    let guard = Mounted::new("gently", Reaction::Stop, true, Box::new(slow));
    streamed.rig.port.mount(0, Some(guard)).unwrap();
    streamed.begin(StreamKind::Joints, 1.0);
    streamed.hold(&away(0.6), 40);
    assert!(
        streamed.end().starts_with("guard `gently`: "),
        "{}",
        streamed.end()
    );
    streamed.rest();
    streamed.held_limits(1.0);
}

#[test]
fn torques_that_only_carry_the_weight_let_the_arm_float_and_silence_stops_it() {
    let mut streamed = Streamed::following(StreamKind::Torques { gravity: true });
    streamed.hold(&[0.0; 6], 300);
    let floats = streamed.status();
    assert!(
        distance(&floats.position, &START.into()) < 2e-3,
        "{floats:?}"
    );
    // A push, and then silence.
    streamed.hold(&[8.0, 0.0, 0.0, 0.0, 0.0, 0.0], 60);
    let pushed = streamed.status();
    assert!(pushed.velocity[0] > 0.1, "{pushed:?}");
    streamed.rest();
    let rests = streamed.status();
    assert!(
        streamed.end().starts_with("the newest value is"),
        "{}",
        streamed.end()
    );
    assert_eq!((rests.power, rests.fault), (Power::Released, None));
    // 22 ticks at that speed at most, and the way of braking.
    assert!(rests.position[0] - pushed.position[0] < 0.3, "{rests:?}");
    let held = rests.setpoint;
    (0..200).for_each(|_| streamed.tick());
    let later = streamed.status();
    assert_eq!(later.setpoint, held);
    assert!(distance(&later.position, &held) < 2e-3);
}

#[test]
fn torques_begin_where_those_of_the_law_end() {
    let mut streamed = Streamed::following(StreamKind::Torques { gravity: false });
    // As the weight is not carried, the arm would fall at once without a blend.
    let mut before = streamed.status().torque;
    for _ in 0..20 {
        streamed.put(&[0.0; 6]);
        streamed.tick();
        let now = streamed.status().torque;
        for joint in 0..6 {
            let step = (now[joint] - before[joint]).abs();
            assert!(step < 3.0, "joint {}: {step} N m", joint + 1);
        }
        before = now;
    }
}

#[test]
fn an_arm_that_torques_drive_too_fast_or_against_a_limit_is_stopped_before_it() {
    let mut torque = [0.0; 6];
    let cases = [
        (0, 60.0),
        (0, -60.0),
        (1, 80.0),
        (4, 4.0),
        (4, -4.0),
        (2, -40.0),
    ];
    for (joint, push) in cases {
        torque.fill(0.0);
        torque[joint] = push;
        let mut streamed = Streamed::following(StreamKind::Torques { gravity: true });
        let limits = streamed.rig.planner.model().joints()[joint].limits;
        let mut ticks = 0;
        while streamed.status().stream.end.is_none() {
            streamed.hold(&torque, 1);
            ticks += 1;
            assert!(ticks < 3000, "it went on for ever");
        }
        let end = streamed.end();
        let named = format!("joint {} ", joint + 1);
        assert!(
            end.starts_with(&named) || end.contains("its limit is"),
            "{end}"
        );
        streamed.rest();
        let status = streamed.status();
        assert_eq!(status.fault, None, "{end}");
        let at = status.position[joint];
        assert!(
            at < limits.upper + 1e-3 && at > limits.lower - 1e-3,
            "{end}: {at}"
        );
    }
    let mut streamed = Streamed::following(StreamKind::Torques { gravity: true });
    streamed.hold(&[0.0, 0.0, 0.0, 0.0, 0.0, 1e4], 1);
    assert!(
        streamed.end().starts_with("the torque of joint 6 is 10000"),
        "{}",
        streamed.end()
    );
}

#[test]
fn the_tool_goes_where_poses_and_displacements_say() {
    let mut streamed = Streamed::following(StreamKind::Tool);
    let start = streamed.rig.planner.tool_pose(&START);
    streamed.hold(&[0.05, -0.1, 0.08, 0.1, 0.0, 0.2], 400);
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.1, 0.0, 0.2);
    let reached = streamed.rig.planner.tool_pose(&streamed.status().setpoint);
    let way = reached.translation.vector - start.translation.vector;
    assert!(
        (way - nalgebra::Vector3::new(0.05, -0.1, 0.08)).norm() < 1e-9,
        "{way}"
    );
    assert!(reached.rotation.angle_to(&(turn * start.rotation)) < 1e-9);
    let matrix = start.to_homogeneous();
    let rows: Vec<f64> = (0..16)
        .map(|index| matrix[(index / 4, index % 4)])
        .collect();
    streamed.hold(&rows, 400);
    assert!(distance(&streamed.status().setpoint, &START.into()) < 1e-9);
    streamed.held_limits(1.0);
    let mut wrong = rows.clone();
    wrong[0] *= 2.0;
    let mut far = rows.clone();
    far[3] = 5.0;
    for (numbers, expected) in [
        (wrong, "the 16 numbers of a value are no pose"),
        (far, "out of reach"),
        (vec![1.0; 7], "a value has 7 numbers and not 6 or 16"),
    ] {
        let mut streamed = Streamed::following(StreamKind::Tool);
        streamed.hold(&rows, 5);
        streamed.put(&numbers);
        streamed.rest();
        assert!(streamed.end().contains(expected), "{}", streamed.end());
    }
}

#[test]
fn an_emergency_stop_on_a_stream_takes_the_power_in_its_tick_and_a_value_after_it_moves_nothing() {
    for ticks in (1..200).step_by(9) {
        let mut streamed = Streamed::following(StreamKind::Joints);
        streamed.hold(&GOAL, ticks);
        let at = format!("tick {ticks}");
        streamed.put(&GOAL);
        estop::must_lose_power(&mut streamed.rig, &at, |stopped| {
            assert!(stopped.stream.end.is_some(), "{at}");
        });
        let here = streamed.status().setpoint;
        streamed.hold(&GOAL, 20);
        assert!(distance(&streamed.status().setpoint, &here) < 1e-9, "{at}");
    }
}
