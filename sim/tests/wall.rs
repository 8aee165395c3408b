//! An arm that moves slowly onto a wall under a guard of force: what the wall feels, and what the arm does then.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot be set up fails"
)]

use std::{sync::Arc, time::Duration};

use ctos::{
    config::Node,
    diagnostic::{Findings, Source as Text},
    task::HandlerError,
};
use mcs::{
    Joints,
    control::{ComputedTorque, ControlLaw, JointImpedance, PidGravity},
    driver::Power,
    guard::{Around, GuardSet, GuardSettings, Mounted, Neighbour, Reaction, force::Force},
    model::{DynamicsOptions, Model, Placement, built_in, file::Inertias},
    servo::{
        Following, MotionPhase, Newest, Servo, ServoCommand, ServoConfig, ServoPort, ServoStatus,
        Source, Stream, StreamKind,
    },
    trajectory::{CartesianLimits, Planner},
};
use nalgebra::{DVector, Translation3, Vector3};
use sim::{cell::Cell, driver::SimArm, port::Port, simulation::Simulation};

const PERIOD: Duration = Duration::from_micros(4500);

const START: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
/// The tool is the middle of a ball on the flange, the only thing of the arm that has a form.
const BALL: [f64; 3] = [0.0, 0.0, 0.1];
const RADIUS: f64 = 0.03;
/// How far the ball is from the wall at the start, and how far beyond its face it is sent, m.
const GAP: f64 = 0.02;
const BEYOND: f64 = 0.04;
/// What the guard allows, N.
const MOST: f64 = 25.0;

/// How the arm is moved.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    Line,
    Joints,
    Stream,
    /// A line that ends so far behind the face, m.
    Into(f64),
}

#[derive(Debug, Clone, Copy)]
struct Case {
    law: &'static str,
    way: Way,
    /// Of the tool, m/s.
    speed: f64,
    limit_jerk: bool,
    /// The low pass of the sensor, Hz.
    low_pass: Option<f64>,
}

const SLOW: Case = Case {
    law: "pid",
    way: Way::Line,
    speed: 0.05,
    limit_jerk: false,
    low_pass: None,
};

fn arm() -> Arc<Model> {
    let model = built_in::model("puma560", Inertias::Engine).unwrap();
    let ball = Placement::from_degrees(BALL, [0.0; 3]);
    Arc::new(model.unwrap().with_tool(&ball))
}

fn law(name: &str) -> Box<dyn ControlLaw> {
    let model = arm();
    match name {
        "pid" => Box::new(PidGravity::new(model, 8.0, 1.0)),
        "computed_torque" => {
            let options = DynamicsOptions::WITH_ROTORS;
            Box::new(ComputedTorque::new(model, 8.0, 1.0, options))
        }
        _ => {
            let soft = JointImpedance::of_bandwidth(&model, 2.0);
            Box::new(JointImpedance::new(model, soft, 1.0, PERIOD).unwrap())
        }
    }
}

struct Nobody;

impl Around for Nobody {
    fn neighbour(&self, servo: &str) -> Result<Neighbour, HandlerError> {
        Err(format!("there is no servo `{servo}`").into())
    }
}

/// Positions that stay the same, new in each tick.
struct Held(Vec<f64>, u64);

impl Source for Held {
    fn newest(&mut self) -> Option<Newest<'_>> {
        self.1 += 1;
        Some(Newest {
            count: self.1,
            stamp: self.1 as f64 * PERIOD.as_secs_f64(),
            age: 0.0,
            numbers: &self.0,
        })
    }
}

/// A servo, the world, and the wall across the tool's way along x.
struct Rig {
    servo: Servo,
    port: ServoPort,
    planner: Planner,
    simulation: Simulation,
    /// What the physics had press on the ball in the period after each tick, N, whatever a sensor reads of it.
    pressed: Vec<f64>,
}

impl Rig {
    fn new(case: Case, reaction: Reaction) -> Self {
        let model = arm();
        let mut data = model.data();
        let ball = model.placement(&mut data, &START, model.tip()).origin;
        let face = ball.x + RADIUS + GAP;
        let degrees = START.map(f64::to_degrees);
        let [x, y, z] = BALL;
        let low_pass = case.low_pass.map(|hz| format!("filter_hz = {hz:?}\n"));
        let low_pass = low_pass.unwrap_or_default();
        let text = format!(
            "[[arm]]\nname = 'puma'\nmodel = 'puma560'\nstart = {degrees:?}\n\
             [[arm.capsule]]\nlink = 'link6'\nfrom = [{x}, {y}, {z}]\nto = [{x}, {y}, {z}]\nradius = {RADIUS}\ngrey = 50\n\
             [[force_torque]]\nname = 'wrist'\narm = 'puma'\nlink = 'link6'\n{low_pass}\
             [[furniture]]\ncentre = [{:?}, {:?}, {:?}]\nsize = [0.2, 0.4, 0.4]\ngrey = 40\n",
            face + 0.1,
            ball.y,
            ball.z
        );
        let cell = Cell::parse(&Text::new("cell.toml", text));
        let cell = cell.unwrap_or_else(|found| panic!("{found}"));
        let port = Arc::new(Port::new(&cell));
        let simulation = Simulation::new(&cell, Arc::clone(&port));
        let driver = SimArm::new("servo", ("world", &port, &cell), 0, &[0, 1, 2, 3, 4, 5]);
        let driver = Box::new(driver.unwrap().sensing(&cell, &[0]));
        let config = ServoConfig {
            limit_jerk: case.limit_jerk,
            ..ServoConfig::default()
        };
        let (servo, port) = Servo::new(Arc::clone(&model), driver, law(case.law), config).unwrap();
        let text = format!("force = {MOST}");
        let args = Node::from_toml(&Text::new("guard", text), &mut Findings::new());
        let settings = GuardSettings {
            model: &model,
            period: PERIOD,
            servo: "servo",
            around: &Nobody,
            cx: None,
            args: &args,
        };
        let guard = Force::from_args(&settings).unwrap();
        let guard = Mounted::new("fragile", reaction, true, guard);
        port.mount(0, Some(guard)).unwrap();
        let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
        let mut rig = Self {
            servo,
            port,
            planner: planner.limiting_jerk(case.limit_jerk),
            simulation,
            pressed: Vec::new(),
        };
        for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
            rig.port.order(command).unwrap();
            rig.tick();
        }
        rig.send(case);
        rig.pressed.clear();
        rig
    }

    fn tick(&mut self) -> ServoStatus {
        self.servo.tick(0);
        self.simulation.tick(PERIOD, 0, Duration::ZERO).unwrap();
        let touches = self.simulation.touches(0);
        self.pressed
            .push(touches.iter().map(|(_, force)| force.norm()).sum());
        self.port.status()
    }

    /// Sends the tool into the wall.
    fn send(&mut self, case: Case) {
        let start = self.port.status().setpoint;
        let by = match case.way {
            Way::Into(beyond) => GAP + beyond,
            _ => GAP + BEYOND,
        };
        let goal = Translation3::new(by, 0.0, 0.0) * self.planner.tool_pose(&start);
        let share = case.speed / CartesianLimits::default().linear_speed;
        let line = self.planner.line(&start, &goal, share).unwrap();
        let mut solver = self.planner.solver().clone();
        let end = line.end(&mut solver).unwrap();
        // The share of all joints' speeds at which the joint with the longest way takes as long as the line would.
        let share = {
            let joints = self.planner.model().joints().iter().enumerate();
            let paces = joints.map(|(index, joint)| {
                (end[index] - start[index]).abs() * case.speed / by / joint.limits.velocity
            });
            paces.fold(0.0, f64::max)
        };
        let segment = match case.way {
            Way::Line | Way::Into(_) => line,
            Way::Joints => self.planner.joint(&start, &end, share).unwrap(),
            Way::Stream => {
                let how = Following {
                    serial: 1,
                    kind: StreamKind::Joints,
                    max_age: 1.0,
                    pace: (share, 1.0),
                    guards: GuardSet::default(),
                };
                let source = Box::new(Held(end.to_vec(), 0));
                let stream = Stream::new(how, source, self.planner.model());
                return self.port.stream(Box::new(stream)).unwrap();
            }
        };
        let order = ServoCommand::Move { id: 1, segment };
        self.port.order(order).unwrap();
    }

    /// What so many ticks leave.
    fn ticks(&mut self, count: usize) -> Vec<ServoStatus> {
        (0..count).map(|_| self.tick()).collect()
    }

    /// What every tick leaves, until so long after the motion is over, s.
    fn run(&mut self, after: f64) -> Vec<ServoStatus> {
        let mut all = Vec::new();
        let mut left = (after / PERIOD.as_secs_f64()) as u32 + 1;
        let before = self.port.status().motion.id;
        for _ in 0..3000 {
            let status = self.tick();
            all.push(status);
            let over = status.motion.id > before && status.motion.phase.is_over();
            left -= u32::from(over);
            if left == 0 {
                return all;
            }
        }
        panic!("the motion was never over: {:?}", all.last());
    }
}

/// What the sensor feels, N.
fn force(status: &ServoStatus) -> f64 {
    Vector3::new(status.sensors[0], status.sensors[1], status.sensors[2]).norm()
}

fn largest<'a>(all: impl IntoIterator<Item = &'a ServoStatus>) -> f64 {
    all.into_iter().map(force).fold(0.0, f64::max)
}

/// How fast the tool goes along x as the joints were measured, m/s, and with what mass the arm resists there along x, kg.
fn blow(status: &ServoStatus) -> (f64, f64) {
    let model = arm();
    let mut data = model.data();
    let q = &status.position;
    let mass = model.mass_matrix(&mut data, q, DynamicsOptions::WITH_ROTORS);
    let inverse = mass.clone().cholesky().unwrap().inverse();
    let along = model
        .jacobian(&mut data, q, model.tip())
        .row(0)
        .into_owned();
    let speed = (&along * DVector::from_row_slice(&status.velocity))[0];
    let mobility = (&along * inverse * along.transpose())[0];
    (speed, 1.0 / mobility)
}

const CASES: [Case; 9] = [
    SLOW,
    Case {
        speed: 0.02,
        ..SLOW
    },
    Case { speed: 0.1, ..SLOW },
    Case {
        limit_jerk: true,
        ..SLOW
    },
    Case {
        way: Way::Joints,
        ..SLOW
    },
    Case {
        law: "computed_torque",
        ..SLOW
    },
    Case {
        law: "soft",
        ..SLOW
    },
    Case {
        way: Way::Stream,
        ..SLOW
    },
    Case {
        way: Way::Stream,
        limit_jerk: true,
        ..SLOW
    },
];

/// When the force passes what the guard allows.
fn passed(all: &[ServoStatus]) -> usize {
    let passed = all.iter().position(|status| force(status) > MOST);
    passed.unwrap_or_else(|| panic!("no more than {:.1} N", largest(all)))
}

/// The mean force of a period in which the wall takes all momentum of the arm, N, from the last tick before the touch.
fn hardest(all: &[ServoStatus]) -> f64 {
    let touch = all.iter().position(|status| force(status) > 0.5).unwrap();
    let (speed, mass) = blow(&all[touch - 1]);
    speed * mass / PERIOD.as_secs_f64()
}

#[test]
fn the_torques_change_within_two_ticks_of_the_contact_in_the_world_that_passes_what_the_guard_allows()
 {
    let filtered = [0.02, 0.05, 0.1].map(|speed| Case {
        speed,
        low_pass: Some(30.0),
        ..SLOW
    });
    for case in CASES.into_iter().chain(filtered) {
        let mut rig = Rig::new(case, Reaction::Stop);
        let all = rig.run(0.0);
        let on = Rig::new(case, Reaction::Report).ticks(all.len());
        let passed = passed(&all);
        // The wall itself presses hard enough in the period after a tick. The next tick reads it; that is the first one.
        let touched = rig.pressed.iter().position(|force| *force > MOST).unwrap();
        assert!(passed <= touched + 1, "{case:?}: {touched} {passed}");
        assert!(all[passed].guard.is_some(), "{case:?}");
        let changed = (0..all.len()).find(|tick| all[*tick].torque != on[*tick].torque);
        let changed = changed.unwrap();
        assert!(
            (touched + 1..=touched + 2).contains(&changed),
            "{case:?}: {touched} {changed}"
        );
        assert_eq!(changed, passed, "{case:?}: in the tick that reads it");
    }
}

#[test]
fn a_touch_is_no_harder_than_the_arms_momentum_falls_at_once_and_never_grows_again() {
    for case in CASES {
        let all = Rig::new(case, Reaction::Stop).run(1.0);
        let (passed, hardest) = (passed(&all), hardest(&all));
        // The wall takes the momentum within a period, and the law presses besides until it knows.
        let peak = largest(&all);
        assert!(
            peak < 1.5 * hardest + 1.0,
            "{case:?}: {peak:.1} {hardest:.1}"
        );
        let after = &all[passed + 2..];
        assert!(largest(after) < MOST, "{case:?}: {:.1}", largest(after));
        let rested = all.iter().rev().take(100);
        assert!(largest(rested) < 0.2 * MOST, "{case:?}");
    }
}

#[test]
fn the_arm_ends_at_rest_with_its_power_on_and_says_what_it_felt() {
    for case in CASES {
        let all = Rig::new(case, Reaction::Stop).run(0.5);
        let status = all.last().unwrap();
        assert_eq!(status.motion.phase, MotionPhase::Stopped, "{case:?}");
        assert!(status.at_rest && status.fault.is_none(), "{case:?}");
        assert_eq!(status.power, Power::Released);
        let found = status.ended_by_guard(status.motion.id).unwrap();
        let said = found.measured.as_str();
        assert!(
            said.starts_with("the force is ") && said.ends_with("the limit is 25.00 N"),
            "{said}"
        );
        let moved = all.iter().rev().take(50);
        let moved = moved.map(|then| (then.position[0] - status.position[0]).abs());
        assert!(moved.fold(0.0, f64::max) < 1e-3, "{case:?}");
    }
}

#[test]
fn a_motion_that_ends_in_the_wall_is_ended_by_the_guard_while_it_settles() {
    let case = Case {
        way: Way::Into(3e-4),
        speed: 0.02,
        ..SLOW
    };
    let all = Rig::new(case, Reaction::Stop).run(0.5);
    let status = all.last().unwrap();
    assert_eq!(status.motion.phase, MotionPhase::Stopped);
    assert!(status.ended_by_guard(1).is_some());
    assert!(largest(all.iter().rev().take(50)) < 0.2 * MOST);
}

#[test]
fn a_retreat_from_a_wall_leads_off_it() {
    for way in [Way::Line, Way::Joints] {
        let case = Case { way, ..SLOW };
        let mut rig = Rig::new(case, Reaction::Retreat);
        let all = rig.run(0.2);
        let status = all.last().unwrap();
        let back = status.ended_by_guard(1).unwrap().allowed;
        let segment = rig.planner.joint(&status.setpoint, &back, 0.1).unwrap();
        let order = ServoCommand::Move { id: 2, segment };
        rig.port.order(order).unwrap();
        let all = rig.run(0.2);
        let status = all.last().unwrap();
        assert_eq!(status.motion.phase, MotionPhase::Done, "{status:?}");
        assert_eq!(largest(all.iter().rev().take(20)), 0.0, "{case:?}");
        let mut data = arm().data();
        let at = |q: &Joints, data: &mut _| arm().placement(data, q, arm().tip()).origin.x;
        let (there, start) = (
            at(&status.position, &mut data),
            at(&START.into(), &mut data),
        );
        let off = GAP - (there - start);
        assert!(
            (0.002..0.02).contains(&off),
            "{case:?}: {off} m off the wall"
        );
    }
}
