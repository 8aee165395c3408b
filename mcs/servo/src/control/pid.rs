//! Conventional PID per joint with gravity compensation (the canonical law of report 108, section 4).

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use super::ControlLaw;
use super::integral::Integral;
use crate::driver::SlotReading;
use crate::model::{Data, DynamicsOptions, Model};
use crate::trajectory::Setpoint;

/// PID per joint around model-based gravity compensation, with torque limits and anti-windup.
///
/// Every gain is a share of the inertia that the joint has in the present pose, rotor included. So each joint alone has
/// the same natural frequency and damping ratio in any pose. A setpoint's acceleration gets the torque that this inertia
/// needs. What joints do to one another is left to the loop.
#[derive(Debug, Clone)]
pub struct PidGravity {
    model: Arc<Model>,
    data: Data,
    gains: Gains,
    integral: Integral,
    measured: Vec<f64>,
    /// Inertia of each joint in the present pose, kg m^2 or kg.
    inertia: Vec<f64>,
}

/// Gains as shares of the inertia.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Gains {
    /// Of the position error, 1/s^2.
    proportional: f64,
    /// Of the velocity error, 1/s.
    derivative: f64,
}

impl Gains {
    /// Those that give a joint alone a natural frequency of `bandwidth` Hz with damping ratio `damping`.
    fn by_bandwidth(bandwidth: f64, damping: f64) -> Self {
        let natural = TAU * bandwidth;
        Self {
            proportional: natural * natural,
            derivative: 2.0 * damping * natural,
        }
    }
}

impl PidGravity {
    /// The law that gives each joint alone a natural frequency of `bandwidth` Hz with damping ratio `damping`.
    #[must_use]
    pub fn new(model: Arc<Model>, bandwidth: f64, damping: f64) -> Self {
        let n = model.dof();
        Self {
            data: model.data(),
            gains: Gains::by_bandwidth(bandwidth, damping),
            integral: Integral::new(n, bandwidth),
            measured: vec![0.0; n],
            inertia: vec![0.0; n],
            model,
        }
    }
}

impl ControlLaw for PidGravity {
    fn reset(&mut self, _readings: &[SlotReading]) {
        self.integral.reset();
    }

    fn tune(&mut self, bandwidth: f64, damping: f64) {
        self.gains = Gains::by_bandwidth(bandwidth, damping);
        self.integral.tune(bandwidth);
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        period: Duration,
        out: &mut [f64],
    ) {
        for (measured, reading) in self.measured.iter_mut().zip(readings) {
            *measured = reading.position;
        }
        let (data, gains) = (&mut self.data, self.gains);
        let with_rotors = DynamicsOptions::WITH_ROTORS;
        let mass = self.model.mass_matrix(data, &self.measured, with_rotors);
        for (index, inertia) in self.inertia.iter_mut().enumerate() {
            *inertia = mass[(index, index)];
        }
        let gravity = self.model.gravity_torques(data, &self.measured);
        let joints = self.model.joints().iter().enumerate();
        for ((index, joint), (out, reading)) in joints.zip(out.iter_mut().zip(readings)) {
            let (inertia, limit) = (self.inertia[index], joint.limits.torque);
            let error = setpoint.position[index] - reading.position;
            let speed_error = setpoint.velocity[index] - reading.velocity;
            let share = setpoint.acceleration[index]
                + gains.proportional * error
                + gains.derivative * speed_error;
            let torque = gravity[index] + inertia * share;
            let integral = &mut self.integral;
            *out = integral.added_to(torque, index, (inertia, error), limit, period);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joints::Joints;
    use crate::model::{built_in, file::Inertias};

    const PERIOD: Duration = Duration::from_micros(4500);

    fn model(name: &str) -> Arc<Model> {
        Arc::new(built_in::model(name, Inertias::Engine).unwrap().unwrap())
    }

    fn readings(q: &[f64]) -> Vec<SlotReading> {
        let reading = |position: &f64| SlotReading {
            position: *position,
            velocity: 0.0,
        };
        q.iter().map(reading).collect()
    }

    #[test]
    fn without_error_the_torque_is_gravitys() {
        let model = model("puma560");
        let mut law = PidGravity::new(Arc::clone(&model), 6.0, 1.0);
        let q = Joints::from([0.1, 0.5, -2.0, 0.3, 0.4, 0.5]);
        let mut out = [0.0; 6];
        law.torques(&Setpoint::at_rest(q), &readings(&q), PERIOD, &mut out);
        assert_eq!(out, model.gravity_torques(&mut model.data(), &q));
    }

    #[test]
    fn torque_and_integral_stay_bounded_under_an_error_that_never_ends() {
        let model = model("puma560");
        let limit = model.joints()[0].limits.torque;
        let mut law = PidGravity::new(Arc::clone(&model), 6.0, 1.0);
        let q = Joints::from([0.0, 0.5, -2.0, 0.0, 0.0, 0.0]);
        let target = Joints::from([0.5, 0.5, -2.0, 0.0, 0.0, 0.0]);
        let mut out = [0.0; 6];
        for _ in 0..10_000 {
            law.torques(&Setpoint::at_rest(target), &readings(&q), PERIOD, &mut out);
            assert!(out[0].abs() <= limit);
        }
        // Back at the target at once: what was gathered is at most the share allowed.
        law.torques(&Setpoint::at_rest(q), &readings(&q), PERIOD, &mut out);
        assert!(out[0].abs() <= crate::control::integral::SHARE * limit + 1e-9);
    }

    #[test]
    fn an_error_is_met_with_the_inertia_of_the_present_pose() {
        // Two poses in which joint 1 carries the arm stretched out, and upright.
        let model = model("puma560");
        let (mut data, straight) = (model.data(), -(0.4318_f64).atan2(0.0203));
        for second in [0.0, 1.5] {
            let q = Joints::from([0.0, second, straight, 0.0, 0.0, 0.0]);
            let mut target = q;
            target[0] += 1e-4;
            let options = DynamicsOptions::WITH_ROTORS;
            let inertia = model.mass_matrix(&mut data, &q, options)[(0, 0)];
            let mut law = PidGravity::new(Arc::clone(&model), 6.0, 1.0);
            let mut out = [0.0; 6];
            law.torques(&Setpoint::at_rest(target), &readings(&q), PERIOD, &mut out);
            let expected = inertia * (TAU * 6.0).powi(2) * 1e-4;
            assert!((out[0] - expected).abs() < 1e-9, "{} {expected}", out[0]);
        }
    }
}
