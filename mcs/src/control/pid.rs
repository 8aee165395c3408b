//! Conventional PID per joint with gravity compensation (the canonical law of report 108, section 4).

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use super::ControlLaw;
use crate::arm::{ArmModel, DOF, DynamicsOptions, Joints};
use crate::driver::SlotReading;
use crate::trajectory::Setpoint;

/// Share of a joint's torque limit that its integral part may take.
const INTEGRAL_SHARE: f64 = 0.3;

/// Gains of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointGains {
    /// N m per rad of position error.
    pub proportional: f64,
    /// N m per rad s of integrated position error.
    pub integral: f64,
    /// N m per rad/s of velocity error.
    pub derivative: f64,
    /// N m per rad/s^2 of setpoint acceleration: the inertia that the law takes the joint to have.
    /// Zero gives the plain PID of the report.
    pub feedforward: f64,
}

impl JointGains {
    /// Gains that give each joint alone a natural frequency of `bandwidth` Hz with damping ratio
    /// `damping`, for its inertia with the arm stretched out level, where it is largest for joints 1
    /// and 2. The integral acts five times slower than the position loop.
    #[must_use]
    pub fn by_bandwidth(model: &ArmModel, bandwidth: f64, damping: f64) -> [Self; DOF] {
        let straight = -model.dh[3].d.atan2(model.dh[2].a);
        let stretched = [0.0, 0.0, straight, 0.0, 0.0, 0.0];
        let inertia = model.mass_matrix(&stretched, DynamicsOptions::WITH_ROTORS);
        let natural = TAU * bandwidth;
        std::array::from_fn(|index| {
            let inertia = inertia[(index, index)];
            let proportional = inertia * natural * natural;
            Self {
                proportional,
                integral: proportional * natural / 5.0,
                derivative: 2.0 * damping * natural * inertia,
                feedforward: inertia,
            }
        })
    }
}

/// PID per joint around model-based gravity compensation, with torque limits and anti-windup.
#[derive(Debug, Clone)]
pub struct PidGravity {
    model: Arc<ArmModel>,
    gains: [JointGains; DOF],
    /// Torque of the integral part, N m.
    integral: Joints,
}

impl PidGravity {
    /// The law for `model` with `gains`.
    #[must_use]
    pub fn new(model: Arc<ArmModel>, gains: [JointGains; DOF]) -> Self {
        Self {
            model,
            gains,
            integral: [0.0; DOF],
        }
    }
}

impl ControlLaw for PidGravity {
    fn reset(&mut self, _readings: &[SlotReading]) {
        self.integral = [0.0; DOF];
    }

    fn tune(&mut self, bandwidth: f64, damping: f64) {
        self.gains = JointGains::by_bandwidth(&self.model, bandwidth, damping);
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        period: Duration,
        out: &mut [f64],
    ) {
        let mut measured = [0.0; DOF];
        for (measured, reading) in measured.iter_mut().zip(readings) {
            *measured = reading.position;
        }
        let gravity = self.model.gravity_torques(&measured);
        for (index, (out, reading)) in out.iter_mut().zip(readings).enumerate().take(DOF) {
            let gains = &self.gains[index];
            let limit = self.model.limits[index].torque;
            let error = setpoint.position[index] - reading.position;
            let speed_error = setpoint.velocity[index] - reading.velocity;
            let wanted = gravity[index]
                + gains.proportional * error
                + gains.derivative * speed_error
                + gains.feedforward * setpoint.acceleration[index]
                + self.integral[index];
            // Anti-windup: at the torque limit the integral only moves if it leads back from it.
            let saturated = wanted.abs() > limit && wanted * error > 0.0;
            if !saturated {
                let bound = INTEGRAL_SHARE * limit;
                let step = gains.integral * error * period.as_secs_f64();
                self.integral[index] = (self.integral[index] + step).clamp(-bound, bound);
            }
            *out = wanted.clamp(-limit, limit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_micros(4500);

    fn readings(q: &Joints) -> [SlotReading; DOF] {
        q.map(|position| SlotReading {
            position,
            velocity: 0.0,
        })
    }

    #[test]
    fn without_error_the_torque_is_gravitys() {
        let model = Arc::new(ArmModel::puma560());
        let gains = JointGains::by_bandwidth(&model, 6.0, 1.0);
        let mut law = PidGravity::new(Arc::clone(&model), gains);
        let q = [0.1, 0.5, -2.0, 0.3, 0.4, 0.5];
        let mut out = [0.0; DOF];
        law.torques(&Setpoint::at_rest(q), &readings(&q), PERIOD, &mut out);
        assert_eq!(out, model.gravity_torques(&q));
    }

    #[test]
    fn torque_and_integral_stay_bounded_under_an_error_that_never_ends() {
        let model = Arc::new(ArmModel::puma560());
        let gains = JointGains::by_bandwidth(&model, 6.0, 1.0);
        let mut law = PidGravity::new(Arc::clone(&model), gains);
        let q = [0.0, 0.5, -2.0, 0.0, 0.0, 0.0];
        let target = [0.5, 0.5, -2.0, 0.0, 0.0, 0.0];
        let mut out = [0.0; DOF];
        for _ in 0..10_000 {
            law.torques(&Setpoint::at_rest(target), &readings(&q), PERIOD, &mut out);
            assert!(out[0].abs() <= model.limits[0].torque);
        }
        // Back at the target at once: what was gathered is at most the share allowed.
        law.torques(&Setpoint::at_rest(q), &readings(&q), PERIOD, &mut out);
        assert!(out[0].abs() <= INTEGRAL_SHARE * model.limits[0].torque + 1e-9);
    }
}
