//! The planner and the servo's queue under random orders, on drives that are always where they are told to be: segments of all
//! kinds at random moments, with and without blends, stops of categories 1 and 2, cancellations with a new plan at once. At
//! every period of 4.5 ms positions, speeds and accelerations are within the limits of the joints, and jerks where that is
//! asked for. No speed has a step, and in the end the arm rests. `CTOS_MOTION_SEEDS=1000` runs a thousand seeds, `CTOS_MOTION_SEEDS=17..18` repeats one.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::ops::Range;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use mcs::Joints;
use mcs::control::ControlLaw;
use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};
use mcs::model::{Model, built_in, file::Inertias};
use mcs::servo::{MotionPhase, QUEUE, Servo, ServoCommand, ServoConfig, ServoPort};
use mcs::trajectory::{
    Blend, CartesianLimits, Goal, Pace, PathKind, Planner, Route, Segment, Setpoint,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PERIOD: Duration = Duration::from_micros(4500);
const READY: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
/// Periods of one run in which orders come.
const TICKS: usize = 3_000;
/// How far a limit of acceleration may be exceeded: paths of the tool are checked at three moments between two solved poses.
const TOLERANCE: f64 = 0.01;
/// How far a limit of jerk may be exceeded, for the same reason.
const JERK_TOLERANCE: f64 = 0.02;

fn seeds() -> Range<u64> {
    let asked = std::env::var("CTOS_MOTION_SEEDS").unwrap_or_else(|_| "12".to_owned());
    let number = |text: &str| text.parse::<u64>().unwrap();
    match asked.split_once("..") {
        Some((from, to)) => number(from)..number(to),
        None => 0..number(&asked),
    }
}

/// What the law was told last, for the drives and for the test.
type Told = Arc<Mutex<Setpoint>>;

struct Ideal(Told);

impl ChannelDriver for Ideal {
    fn slots(&self) -> usize {
        self.0.lock().unwrap().position.len()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        let told = self.0.lock().unwrap();
        for (index, reading) in readings.iter_mut().enumerate() {
            reading.position = told.position[index];
            reading.velocity = told.velocity[index];
        }
        Ok(())
    }

    fn write(&mut self, _: &[f64], power: Power, _: Duration) -> Result<(), DriverError> {
        let mut told = self.0.lock().unwrap();
        if power != Power::Released {
            assert!(
                told.velocity.iter().all(|speed| *speed == 0.0),
                "brakes close in motion"
            );
            *told = Setpoint::at_rest(told.position);
        }
        Ok(())
    }
}

struct Follow(Told);

impl ControlLaw for Follow {
    fn reset(&mut self, _: &[SlotReading]) {}

    fn torques(&mut self, setpoint: &Setpoint, _: &[SlotReading], _: Duration, out: &mut [f64]) {
        *self.0.lock().unwrap() = *setpoint;
        out.fill(0.0);
    }
}

/// The motion that was ordered last, as the planner's task keeps it.
struct Last {
    id: u64,
    segment: Segment,
    end: Joints,
    pace: Pace,
}

struct Rig {
    servo: Servo,
    port: ServoPort,
    planner: Planner,
    limit_jerk: bool,
    told: Told,
    setpoints: Vec<Setpoint>,
    random: ChaCha8Rng,
    last: Option<Last>,
    ids: u64,
    /// How many of each kind were taken: joint motions, lines, arcs, arcs about a centre, arches.
    kinds: [u32; 5],
    bridges: u32,
    stops: u32,
}

impl Rig {
    fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let cart = [0.1, 0.0, 0.0];
        let on_cart = [&cart[..], &READY].concat();
        let (name, start) = match random.random_range(0..4) {
            0 | 1 => ("puma560", READY.to_vec()),
            2 => ("testbed9", on_cart),
            _ => ("testbed18", on_cart.repeat(2)),
        };
        let model = built_in::model(name, Inertias::Engine).unwrap().unwrap();
        let model: Arc<Model> = Arc::new(model);
        let start = Joints::try_from(&start[..]).unwrap();
        let told = Arc::new(Mutex::new(Setpoint::at_rest(start)));
        let limit_jerk = random.random();
        let config = ServoConfig {
            period: PERIOD,
            limit_jerk,
            ..ServoConfig::default()
        };
        let (driver, law) = (
            Box::new(Ideal(told.clone())),
            Box::new(Follow(told.clone())),
        );
        let (servo, port) = Servo::new(Arc::clone(&model), driver, law, config).unwrap();
        let apart = PERIOD.as_secs_f64() * f64::from(config.setpoint_every);
        let planner = Planner::new(model, CartesianLimits::default(), apart).unwrap();
        Self {
            servo,
            port,
            planner: planner.limiting_jerk(limit_jerk),
            limit_jerk,
            told,
            setpoints: Vec::new(),
            random,
            last: None,
            ids: 0,
            kinds: [0; 5],
            bridges: 0,
            stops: 0,
        }
    }

    fn order(&self, command: ServoCommand) {
        self.port.order(command).unwrap();
    }

    fn tick(&mut self) {
        self.servo.tick(0);
        self.setpoints.push(*self.told.lock().unwrap());
    }

    /// Ticks until nothing moves.
    fn rest(&mut self) {
        let mut waited = 0;
        loop {
            self.tick();
            let status = self.port.status();
            if status.at_rest && status.motion.phase.is_over() {
                return;
            }
            waited += 1;
            assert!(waited < 40_000, "it never rests");
        }
    }

    fn release(&mut self) {
        for command in [
            ServoCommand::Reset,
            ServoCommand::PowerOn,
            ServoCommand::ReleaseBrakes,
        ] {
            self.order(command);
            self.tick();
        }
        assert_eq!(self.port.status().power, Power::Released);
    }

    fn number(&mut self, low: f64, high: f64) -> f64 {
        self.random.random_range(low..high)
    }

    fn vector(&mut self, most: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.random.random_range(-most..most))
    }

    /// A way to somewhere: far in joints, or not far with the tool.
    fn route(&mut self, start: &Joints) -> (usize, Route) {
        let (speed, acceleration) = (self.number(0.1, 1.0), self.number(0.1, 1.0));
        let pace = match self.random.random_range(0..3) {
            0 => Pace::from(1.0),
            _ => Pace::new(speed, Some(acceleration)),
        };
        let kind = self.random.random_range(0..5);
        let from = self.planner.tool_pose(start);
        let (by, turn, aside) = (self.vector(0.25), self.vector(0.4), self.vector(0.2));
        let goal = Isometry3::from_parts(
            Translation3::from(from.translation.vector + by),
            UnitQuaternion::from_scaled_axis(turn) * from.rotation,
        );
        let height = self.number(0.01, 0.2);
        let corner = self.random.random::<bool>().then_some(0.5 * height);
        // As far from both ends.
        let middle = from.translation.vector + 0.5 * by;
        let centre = middle + by.cross(&aside);
        let (goal, path) = match kind {
            0 => {
                let model = Arc::clone(self.planner.model());
                let joints = Joints::from_fn(model.dof(), |index| {
                    let limits = &model.joints()[index].limits;
                    self.number(limits.lower, limits.upper)
                });
                (Goal::Joints(joints), PathKind::Joint)
            }
            1 => (Goal::Pose(goal), PathKind::StraightLine),
            2 => {
                let through = (middle + aside).into();
                (Goal::Pose(goal), PathKind::Arc { through })
            }
            3 => {
                let (centre, longer) = (centre.into(), self.random.random());
                (Goal::Pose(goal), PathKind::ArcAbout { centre, longer })
            }
            _ => (Goal::Pose(goal), PathKind::Arch { height, corner }),
        };
        let route = Route {
            goal,
            path,
            pace,
            elbow: None,
        };
        (kind, route)
    }

    fn blend(&mut self) -> Blend {
        let most = self.number(0.0, 1.0);
        match self.random.random_range(0..4) {
            0 => Blend::default(),
            1 => Blend::Share(most),
            2 => Blend::Radius(0.3 * most),
            _ => Blend::Joints(most),
        }
    }

    /// Plans a motion from where the last one ends, as the planner's task does, and orders it. Not everything can be done.
    fn go(&mut self) {
        let status = self.port.status();
        if self.ids.saturating_sub(status.ended.newest()) >= QUEUE as u64 {
            return;
        }
        let last = self.last.take();
        let last = last.filter(|last| status.ended.of(last.id).is_none());
        let start = last.as_ref().map_or(status.setpoint, |last| last.end);
        let (kind, route) = self.route(&start);
        let Ok((segment, end)) = self.planner.segment(&start, &route) else {
            self.last = last;
            return;
        };
        let blend = self.blend();
        let bridge = last.and_then(|last| {
            let pace = Pace {
                speed: last.pace.speed.max(route.pace.speed),
                acceleration: last.pace.acceleration.max(route.pace.acceleration),
            };
            let both = (&last.segment, &segment);
            self.planner.bridge(both, pace, blend)
        });
        self.kinds[kind] += 1;
        self.bridges += u32::from(bridge.is_some());
        self.ids += 1;
        let id = self.ids;
        self.order(match bridge {
            Some(bridge) => ServoCommand::MoveOver {
                id,
                segment,
                bridge,
            },
            None => ServoCommand::Move { id, segment },
        });
        self.last = Some(Last {
            id,
            segment,
            end,
            pace: route.pace,
        });
    }

    /// Brakes, by one of the ways that there are, and makes the arm ready again.
    fn stop(&mut self) {
        self.stops += 1;
        match self.random.random_range(0..3) {
            0 => {
                self.order(ServoCommand::Stop);
                self.rest();
                self.order(ServoCommand::Resume);
            }
            1 => {
                self.order(ServoCommand::ControlledStop);
                self.rest();
                assert_eq!(self.port.status().power, Power::Off);
                self.release();
            }
            _ => {
                self.order(ServoCommand::Cancel);
                self.rest();
            }
        }
        self.last = None;
        // Another plan at once, from wherever that is.
        self.go();
    }

    fn run(&mut self) {
        self.tick();
        self.release();
        self.setpoints.clear();
        let mut next = 0;
        while self.setpoints.len() < TICKS {
            if self.setpoints.len() >= next {
                match self.random.random_range(0..6) {
                    0 => self.stop(),
                    _ => self.go(),
                }
                // Sometimes several come at once, sometimes the queue runs dry.
                let pause = self.random.random_range(0..300);
                next = self.setpoints.len() + if pause < 100 { 1 } else { pause };
            }
            self.tick();
            let status = self.port.status();
            assert_eq!(status.fault, None);
            let rejected = matches!(status.motion.phase, MotionPhase::Rejected(_));
            assert!(
                !rejected && status.rejected.is_none(),
                "{:?}",
                status.rejected
            );
        }
        self.rest();
    }

    /// That the accelerations between the setpoints, seen once a period, change no faster than the limits of jerk allow.
    fn check_jerk(&self) -> Result<(), String> {
        let period = PERIOD.as_secs_f64();
        let joints = self.planner.model().joints();
        for (tick, triple) in self.setpoints.windows(3).enumerate() {
            let [a, b, c] = triple else { continue };
            for (index, joint) in joints.iter().enumerate() {
                let [a, b, c] = [a, b, c].map(|setpoint| setpoint.velocity[index]);
                let found = (c - 2.0 * b + a).abs() / (period * period);
                let most = joint.limits.jerk * (1.0 + JERK_TOLERANCE) + 1e-4;
                if found > most {
                    return Err(format!(
                        "period {tick}, joint {index}: jerk {found}, at most {most}"
                    ));
                }
            }
        }
        Ok(())
    }

    /// That what the drives were told is within the limits, seen once a period.
    fn check(&self) -> Result<(), String> {
        let period = PERIOD.as_secs_f64();
        let joints = self.planner.model().joints();
        for (tick, pair) in self.setpoints.windows(2).enumerate() {
            let [before, now] = pair else { continue };
            for (index, joint) in joints.iter().enumerate() {
                let limits = &joint.limits;
                let wrong = |what: &str, value: f64, most: f64| {
                    Err(format!(
                        "period {tick}, joint {index}: {what} {value}, at most {most}"
                    ))
                };
                let position = now.position[index];
                if position < limits.lower - 1e-9 || position > limits.upper + 1e-9 {
                    return wrong("position", position, limits.upper);
                }
                let fastest = limits.velocity * (1.0 + 1e-6) + 1e-9;
                let moved = (position - before.position[index]) / period;
                if moved.abs() > fastest || now.velocity[index].abs() > fastest {
                    return wrong("speed", moved, fastest);
                }
                // A step of the speed would be an acceleration without end.
                let hardest = limits.acceleration * (1.0 + TOLERANCE) + 1e-6;
                let changed = (now.velocity[index] - before.velocity[index]) / period;
                if changed.abs() > hardest {
                    return wrong("acceleration", changed, hardest);
                }
                let mean = 0.5 * (now.velocity[index] + before.velocity[index]);
                if (moved - mean).abs() > 0.5 * hardest * period {
                    return wrong("the speed is not that of the positions:", moved, mean);
                }
            }
        }
        if self.limit_jerk {
            self.check_jerk()?;
        }
        let end = self.setpoints[self.setpoints.len() - 1];
        match end == Setpoint::at_rest(end.position) {
            true => Ok(()),
            false => Err("it does not rest".to_owned()),
        }
    }
}

#[test]
fn whatever_is_asked_for_at_whatever_moment_every_limit_is_kept_and_the_arm_comes_to_rest() {
    let (mut kinds, mut bridges, mut stops) = ([0; 5], 0, 0);
    for seed in seeds() {
        let mut rig = Rig::new(seed);
        rig.run();
        if let Err(wrong) = rig.check() {
            panic!("CTOS_MOTION_SEEDS={seed}..{}: {wrong}", seed + 1);
        }
        for (all, own) in kinds.iter_mut().zip(rig.kinds) {
            *all += own;
        }
        bridges += rig.bridges;
        stops += rig.stops;
    }
    // It has seen something.
    if seeds().count() >= 10 {
        assert!(kinds.iter().all(|count| *count > 3), "{kinds:?}");
        assert!(bridges > 10 && stops > 10, "{bridges} {stops}");
    }
}
