//! Computed torque: inverse dynamics of the whole arm around a PD on the error.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use super::ControlLaw;
use crate::driver::SlotReading;
use crate::model::{Data, DynamicsOptions, Model};
use crate::trajectory::Setpoint;

/// Cancels the arm's dynamics by its model, so that every joint's error dies out alike in any pose.
#[derive(Debug, Clone)]
pub struct ComputedTorque {
    model: Arc<Model>,
    data: Data,
    /// 1/s^2.
    stiffness: f64,
    /// 1/s.
    damping: f64,
    options: DynamicsOptions,
    position: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
}

impl ComputedTorque {
    /// The law with errors that die out at `bandwidth` Hz and `damping` ratio; `options` says what the
    /// real arm has (rotors always, friction if its model is to be trusted).
    #[must_use]
    pub fn new(model: Arc<Model>, bandwidth: f64, damping: f64, options: DynamicsOptions) -> Self {
        let still = vec![0.0; model.dof()];
        let natural = TAU * bandwidth;
        Self {
            data: model.data(),
            model,
            stiffness: natural * natural,
            damping: 2.0 * damping * natural,
            options,
            position: still.clone(),
            velocity: still.clone(),
            acceleration: still,
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
        for (index, reading) in readings.iter().enumerate().take(self.position.len()) {
            self.position[index] = reading.position;
            self.velocity[index] = reading.velocity;
            self.acceleration[index] = setpoint.acceleration[index]
                + self.stiffness * (setpoint.position[index] - reading.position)
                + self.damping * (setpoint.velocity[index] - reading.velocity);
        }
        let torques = self.model.inverse_dynamics(
            &mut self.data,
            &self.position,
            &self.velocity,
            &self.acceleration,
            self.options,
        );
        for (out, torque) in out.iter_mut().zip(torques) {
            *out = *torque;
        }
    }
}
