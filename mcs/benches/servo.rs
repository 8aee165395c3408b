//! What one servo period costs without hardware, and what the arm's model costs in it.

#![allow(
    clippy::panic,
    reason = "a benchmark whose set-up fails has nothing to measure"
)]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

use divan::Bencher;
use mcs::arm::{ArmModel, DOF, DynamicsOptions, Joints};
use mcs::control::{JointGains, PidGravity};
use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};
use mcs::servo::{Servo, ServoCommand, ServoConfig, ServoPort};
use mcs::trajectory::{CartesianLimits, Planner};
use nalgebra::{Isometry3, Translation3, Vector3};

const START: Joints = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const GOAL: Joints = [-0.6, 1.4, -2.9, -0.4, 0.3, 1.1];

fn main() {
    divan::main();
}

/// An arm that is always where it was and costs nothing.
struct Statue;

impl ChannelDriver for Statue {
    fn slots(&self) -> usize {
        DOF
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        for (reading, position) in readings.iter_mut().zip(START) {
            reading.position = position;
        }
        Ok(())
    }

    fn write(&mut self, torques: &[f64], _: Power, _: Duration) -> Result<(), DriverError> {
        black_box(torques);
        Ok(())
    }
}

fn planner() -> Planner {
    let model = Arc::new(ArmModel::puma560());
    Planner::new(
        model,
        Isometry3::identity(),
        CartesianLimits::default(),
        0.018,
    )
}

fn servo() -> (Servo, ServoPort) {
    let model = Arc::new(ArmModel::puma560());
    let gains = JointGains::by_bandwidth(&model, 6.0, 1.0);
    let law = PidGravity::new(Arc::clone(&model), gains);
    let config = ServoConfig {
        // The statue never follows: that must be no emergency here.
        following_error: 100.0,
        ..ServoConfig::default()
    };
    let built = Servo::new(model, Box::new(Statue), Box::new(law), config);
    let (mut servo, port) = built.unwrap_or_else(|error| panic!("{error}"));
    for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
        assert!(port.order(command).is_ok());
        servo.tick(0);
    }
    (servo, port)
}

#[divan::bench]
fn tick_holding(bencher: Bencher) {
    let (mut servo, _port) = servo();
    bencher.bench_local(|| servo.tick(0));
}

/// One tick of every hundred of a joint motion, on average over the motion.
#[divan::bench]
fn hundred_ticks_of_a_joint_motion(bencher: Bencher) {
    let segment = planner().joint(&START, &GOAL, 0.2);
    let segment = segment.unwrap_or_else(|error| panic!("{error}"));
    bencher
        .with_inputs(|| {
            let (servo, port) = servo();
            let segment = segment.clone();
            assert!(port.order(ServoCommand::Move { id: 1, segment }).is_ok());
            (servo, port)
        })
        .bench_local_refs(|(servo, _port)| {
            for _ in 0..100 {
                servo.tick(0);
            }
        });
}

#[divan::bench]
fn hundred_ticks_of_a_straight_line(bencher: Bencher) {
    let planner = planner();
    let goal = Translation3::new(0.05, 0.25, -0.1) * planner.tool_pose(&START);
    let segment = planner.line(&START, &goal, 0.5);
    let segment = segment.unwrap_or_else(|error| panic!("{error}"));
    bencher
        .with_inputs(|| {
            let (servo, port) = servo();
            let segment = segment.clone();
            assert!(port.order(ServoCommand::Move { id: 1, segment }).is_ok());
            (servo, port)
        })
        .bench_local_refs(|(servo, _port)| {
            for _ in 0..100 {
                servo.tick(0);
            }
        });
}

#[divan::bench]
fn plan_and_check_a_straight_line(bencher: Bencher) {
    let planner = planner();
    let goal = Translation3::new(0.05, 0.25, -0.1) * planner.tool_pose(&START);
    bencher.bench_local(|| planner.line(black_box(&START), &goal, 0.5));
}

#[divan::bench]
fn forward_kinematics(bencher: Bencher) {
    let model = ArmModel::puma560();
    bencher.bench_local(|| model.frame_6(black_box(&START)));
}

#[divan::bench]
fn jacobian(bencher: Bencher) {
    let model = ArmModel::puma560();
    let point = Vector3::new(0.0, 0.0, 0.1);
    bencher.bench_local(|| model.jacobian(black_box(&START), &point));
}

#[divan::bench]
fn inverse_kinematics_all_eight(bencher: Bencher) {
    let model = ArmModel::puma560();
    let pose = model.forward(&START);
    bencher.bench_local(|| model.inverse(black_box(&pose), &START));
}

#[divan::bench]
fn gravity(bencher: Bencher) {
    let model = ArmModel::puma560();
    bencher.bench_local(|| model.gravity_torques(black_box(&START)));
}

#[divan::bench]
fn inverse_dynamics(bencher: Bencher) {
    let model = ArmModel::puma560();
    let options = DynamicsOptions::WITH_ROTORS;
    bencher.bench_local(|| model.inverse_dynamics(black_box(&START), &GOAL, &GOAL, options));
}

#[divan::bench]
fn mass_matrix(bencher: Bencher) {
    let model = ArmModel::puma560();
    let options = DynamicsOptions::WITH_ROTORS;
    bencher.bench_local(|| model.mass_matrix(black_box(&START), options));
}
