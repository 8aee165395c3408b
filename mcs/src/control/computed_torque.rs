//! Computed torque: inverse dynamics of the whole arm around a PD on the error.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use super::ControlLaw;
use crate::arm::{ArmModel, DOF, DynamicsOptions};
use crate::driver::SlotReading;
use crate::trajectory::Setpoint;

/// Cancels the arm's dynamics by its model, so that every joint's error dies out alike in any pose.
#[derive(Debug, Clone)]
pub struct ComputedTorque {
    model: Arc<ArmModel>,
    /// 1/s^2.
    stiffness: f64,
    /// 1/s.
    damping: f64,
    options: DynamicsOptions,
}

impl ComputedTorque {
    /// The law with errors that die out at `bandwidth` Hz and `damping` ratio; `options` says what the
    /// real arm has (rotors always, friction if its model is to be trusted).
    #[must_use]
    pub fn new(
        model: Arc<ArmModel>,
        bandwidth: f64,
        damping: f64,
        options: DynamicsOptions,
    ) -> Self {
        let natural = TAU * bandwidth;
        Self {
            model,
            stiffness: natural * natural,
            damping: 2.0 * damping * natural,
            options,
        }
    }
}

impl ControlLaw for ComputedTorque {
    fn reset(&mut self, _readings: &[SlotReading]) {}

    fn tune(&mut self, bandwidth: f64, damping: f64) {
        let natural = TAU * bandwidth;
        self.stiffness = natural * natural;
        self.damping = 2.0 * damping * natural;
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        _period: Duration,
        out: &mut [f64],
    ) {
        let mut position = [0.0; DOF];
        let mut velocity = [0.0; DOF];
        let mut acceleration = setpoint.acceleration;
        for (index, reading) in readings.iter().enumerate().take(DOF) {
            position[index] = reading.position;
            velocity[index] = reading.velocity;
            acceleration[index] += self.stiffness * (setpoint.position[index] - reading.position)
                + self.damping * (setpoint.velocity[index] - reading.velocity);
        }
        let torques =
            self.model
                .inverse_dynamics(&position, &velocity, &acceleration, self.options);
        for ((out, torque), limit) in out.iter_mut().zip(torques).zip(&self.model.limits) {
            *out = torque.clamp(-limit.torque, limit.torque);
        }
    }
}
