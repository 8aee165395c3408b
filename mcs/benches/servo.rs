//! What one servo period costs without hardware, and what the arm's model costs in it.

#![allow(
    clippy::panic,
    reason = "a benchmark whose set-up fails has nothing to measure"
)]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

use divan::Bencher;
use mcs::Joints;
use mcs::control::PidGravity;
use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};
use mcs::joints::Distances;
use mcs::model::{Model, built_in, file::Inertias};
use mcs::servo::{Servo, ServoCommand, ServoConfig, ServoPort};
use mcs::trajectory::{CartesianLimits, Planner, Segment};
use nalgebra::Translation3;

const START: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const GOAL: [f64; 6] = [-0.6, 1.4, -2.9, -0.4, 0.3, 1.1];

fn main() {
    divan::main();
}

/// An arm that is always where it was and costs nothing.
struct Statue(Vec<f64>);

impl ChannelDriver for Statue {
    fn slots(&self) -> usize {
        self.0.len()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        for (reading, position) in readings.iter_mut().zip(&self.0) {
            reading.position = *position;
        }
        Ok(())
    }

    fn write(&mut self, torques: &[f64], _: Power, _: Duration) -> Result<(), DriverError> {
        black_box(torques);
        Ok(())
    }
}

/// An arm, or arms on carts, where they start and where they go.
fn arm(name: &str) -> (Arc<Model>, Joints, Joints) {
    let Some(Ok(model)) = built_in::model(name, Inertias::Engine) else {
        panic!("{name} is no model");
    };
    let (carts, on) = (model.dof() / 9, [0.2, 0.1, -0.1]);
    let of = |arm: [f64; 6]| {
        let cart = [&on[..], &arm].concat();
        let all = if carts == 0 {
            arm.to_vec()
        } else {
            cart.repeat(carts)
        };
        Joints::try_from(&all[..]).unwrap_or_else(|error| panic!("{error}"))
    };
    (Arc::new(model), of(START), of(GOAL))
}

fn planner(model: &Arc<Model>) -> Planner {
    let planner = Planner::new(Arc::clone(model), CartesianLimits::default(), 0.018);
    planner.unwrap_or_else(|error| panic!("{error}"))
}

fn servo(model: &Arc<Model>, start: &Joints) -> (Servo, ServoPort) {
    let law = PidGravity::new(Arc::clone(model), 6.0, 1.0);
    // The statue never follows: that must be no emergency here.
    let far = Distances {
        turning: 100.0,
        sliding: 100.0,
    };
    let config = ServoConfig {
        following_error: far,
        following_window: far,
        ..ServoConfig::default()
    };
    let driver = Box::new(Statue(start.to_vec()));
    let built = Servo::new(Arc::clone(model), driver, Box::new(law), config);
    let (mut servo, port) = built.unwrap_or_else(|error| panic!("{error}"));
    for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
        assert!(port.order(command).is_ok());
        servo.tick(0);
    }
    (servo, port)
}

/// The first hundred ticks of a motion.
fn hundred_ticks(bencher: Bencher, model: &Arc<Model>, start: &Joints, segment: Segment) {
    bencher
        .with_inputs(|| {
            let (servo, port) = servo(model, start);
            assert!(port.order(ServoCommand::Move { id: 1, segment }).is_ok());
            (servo, port)
        })
        .bench_local_refs(|(servo, _port)| {
            for _ in 0..100 {
                servo.tick(0);
            }
        });
}

#[divan::bench(args = ["puma560", "testbed9", "testbed18"])]
fn tick_holding(bencher: Bencher, name: &str) {
    let (model, start, _) = arm(name);
    let (mut servo, _port) = servo(&model, &start);
    bencher.bench_local(|| servo.tick(0));
}

#[divan::bench(args = ["puma560", "testbed9", "testbed18"])]
fn hundred_ticks_of_a_joint_motion(bencher: Bencher, name: &str) {
    let (model, start, goal) = arm(name);
    let segment = planner(&model).joint(&start, &goal, 0.2);
    let segment = segment.unwrap_or_else(|error| panic!("{error}"));
    hundred_ticks(bencher, &model, &start, segment);
}

#[divan::bench(args = ["puma560", "testbed9", "testbed18"])]
fn hundred_ticks_of_a_straight_line(bencher: Bencher, name: &str) {
    let (model, start, _) = arm(name);
    let mut planner = planner(&model);
    let goal = Translation3::new(0.05, 0.25, -0.1) * planner.tool_pose(&start);
    let segment = planner.line(&start, &goal, 0.5);
    let segment = segment.unwrap_or_else(|error| panic!("{error}"));
    hundred_ticks(bencher, &model, &start, segment);
}

#[divan::bench(args = ["puma560", "testbed9"])]
fn plan_and_check_a_straight_line(bencher: Bencher, name: &str) {
    let (model, start, _) = arm(name);
    let mut planner = planner(&model);
    let goal = Translation3::new(0.05, 0.25, -0.1) * planner.tool_pose(&start);
    bencher.bench_local(|| planner.line(black_box(&start), &goal, 0.5));
}
