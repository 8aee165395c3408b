//! The servo's tick must never allocate: neither at rest nor while it plans, follows, brakes or fails.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::sync::Arc;
use std::time::Duration;

use mcs::arm::{ArmModel, DOF, DynamicsOptions, Joints};
use mcs::control::{ComputedTorque, ControlLaw, JointGains, PidGravity};
use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};
use mcs::model::inverse::{Preferences, Search};
use mcs::model::{built_in, file::Inertias};
use mcs::servo::{MotionPhase, Servo, ServoCommand, ServoConfig, ServoPort};
use mcs::trajectory::{CartesianLimits, Planner};
use nalgebra::{Isometry3, Translation3};

const START: Joints = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const GOAL: Joints = [-0.2, 1.0, -2.7, 0.0, 0.5, 0.4];

/// Forward dynamics in one step per period: near enough to be controlled.
struct Arm {
    model: ArmModel,
    q: Joints,
    qd: Joints,
}

impl ChannelDriver for Arm {
    fn slots(&self) -> usize {
        DOF
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        for (index, reading) in readings.iter_mut().enumerate() {
            reading.position = self.q[index];
            reading.velocity = self.qd[index];
        }
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        if power != Power::Released {
            self.qd = [0.0; DOF];
            return Ok(());
        }
        let torques: Joints = std::array::from_fn(|index| torques[index]);
        let options = DynamicsOptions::WITH_ROTORS;
        let qdd = self
            .model
            .forward_dynamics(&self.q, &self.qd, &torques, options);
        for (index, qdd) in qdd.unwrap_or_default().into_iter().enumerate() {
            self.qd[index] += period.as_secs_f64() * qdd;
            self.q[index] += period.as_secs_f64() * self.qd[index];
        }
        Ok(())
    }
}

fn rig(law: Box<dyn ControlLaw>) -> (Servo, ServoPort, Planner) {
    let model = Arc::new(ArmModel::puma560());
    let arm = Arm {
        model: ArmModel::puma560(),
        q: START,
        qd: [0.0; DOF],
    };
    let config = ServoConfig::default();
    let (servo, port) = Servo::new(Arc::clone(&model), Box::new(arm), law, config).unwrap();
    let planner = Planner::new(
        model,
        Isometry3::identity(),
        CartesianLimits::default(),
        0.018,
    );
    (servo, port, planner)
}

/// Ticks until the motion is over (or 3000 times) and counts what was allocated in the ticks alone.
fn allocations(servo: &mut Servo, port: &ServoPort, stop_after: Option<u32>) -> u64 {
    let mut count = 0;
    for tick in 0..3000 {
        if stop_after == Some(tick) {
            port.order(ServoCommand::Stop).unwrap();
        }
        count += allocation_counter::measure(|| servo.tick(0)).count_total;
        if tick > 1 && port.status().motion.phase.is_over() {
            break;
        }
    }
    count
}

fn laws() -> [Box<dyn ControlLaw>; 2] {
    let model = Arc::new(ArmModel::puma560());
    let gains = JointGains::by_bandwidth(&model, 6.0, 1.0);
    let options = DynamicsOptions::WITH_ROTORS;
    [
        Box::new(PidGravity::new(Arc::clone(&model), gains)),
        Box::new(ComputedTorque::new(model, 6.0, 1.0, options)),
    ]
}

#[test]
fn no_tick_allocates_in_any_state() {
    for law in laws() {
        let (mut servo, port, planner) = rig(law);
        let mut count = 0;
        for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
            port.order(command).unwrap();
            count += allocation_counter::measure(|| servo.tick(0)).count_total;
        }
        let segment = planner.joint(&port.status().setpoint, &GOAL, 0.5).unwrap();
        port.order(ServoCommand::Move { id: 1, segment }).unwrap();
        count += allocations(&mut servo, &port, None);
        assert_eq!(port.status().motion.phase, MotionPhase::Done);
        let start = port.status().setpoint;
        let goal = Translation3::new(0.02, 0.1, -0.05) * planner.tool_pose(&start);
        let segment = planner.line(&start, &goal, 0.5).unwrap();
        port.order(ServoCommand::Move { id: 2, segment }).unwrap();
        count += allocations(&mut servo, &port, Some(50));
        assert_eq!(port.status().motion.phase, MotionPhase::Stopped);
        port.emergency_stop();
        count += allocation_counter::measure(|| servo.tick(0)).count_total;
        assert!(port.status().fault.is_some());
        assert_eq!(count, 0);
    }
}

#[test]
fn kinematics_and_dynamics_do_not_allocate() {
    let model = ArmModel::puma560();
    let pose = model.forward(&START);
    let info = allocation_counter::measure(|| {
        let solutions = model.inverse(&pose, &START);
        std::hint::black_box(&solutions);
        std::hint::black_box(model.forward(&START));
        std::hint::black_box(model.gravity_torques(&START));
        let options = DynamicsOptions::FULL;
        std::hint::black_box(model.inverse_dynamics(&START, &GOAL, &GOAL, options));
    });
    assert_eq!(info.count_total, 0);
}

#[test]
fn the_general_model_does_not_allocate_per_evaluation() {
    let model = built_in::model("testbed18", Inertias::Identified)
        .unwrap()
        .unwrap();
    let (tip, mut data) = (model.tip(), model.data());
    let (q, qd) = ([0.2; 18], [0.1; 18]);
    let goal = model.placement(&mut data, &q, tip);
    let mut search = Search::new(&model, tip, true, Preferences::default());
    let info = allocation_counter::measure(|| {
        let options = DynamicsOptions::FULL;
        std::hint::black_box(model.jacobian(&mut data, &q, tip));
        std::hint::black_box(model.gravity_torques(&mut data, &q));
        std::hint::black_box(model.inverse_dynamics(&mut data, &q, &qd, &qd, options));
        std::hint::black_box(model.mass_matrix(&mut data, &q, options));
        std::hint::black_box(model.forward_dynamics(&mut data, &q, &qd, &qd, options)).unwrap();
        std::hint::black_box(search.solve(&model, &goal, &[0.0; 18])).unwrap();
    });
    assert_eq!(info.count_total, 0);
}

#[test]
fn the_counter_counts() {
    let info = allocation_counter::measure(|| drop(std::hint::black_box(vec![0_u8; 64])));
    assert_eq!(info.count_total, 1);
}
