//! Computed torque: inverse dynamics of the whole arm around a PD on the error.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use super::ControlLaw;
use super::integral::Integral;
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
    integral: Option<Integral>,
    /// Inertia of each joint in the present pose, kg m^2 or kg; only the integral needs it.
    inertia: Vec<f64>,
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
            integral: None,
            inertia: still.clone(),
            position: still.clone(),
            velocity: still.clone(),
            acceleration: still,
        }
    }

    /// The same with an integral part, so that the arm arrives in spite of friction and of wrong masses. Not for joints that
    /// something else holds, as in a closed chain: there it would press ever harder.
    #[must_use]
    pub fn with_integral(mut self) -> Self {
        let bandwidth = self.stiffness.sqrt() / TAU;
        self.integral = Some(Integral::new(self.position.len(), bandwidth));
        self
    }
}

impl ControlLaw for ComputedTorque {
    fn reset(&mut self, _readings: &[SlotReading]) {
        if let Some(integral) = &mut self.integral {
            integral.reset();
        }
    }

    fn tune(&mut self, bandwidth: f64, damping: f64) {
        let natural = TAU * bandwidth;
        self.stiffness = natural * natural;
        self.damping = 2.0 * damping * natural;
        if let Some(integral) = &mut self.integral {
            integral.tune(bandwidth);
        }
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        period: Duration,
        out: &mut [f64],
    ) {
        for (index, reading) in readings.iter().enumerate().take(self.position.len()) {
            self.position[index] = reading.position;
            self.velocity[index] = reading.velocity;
            self.acceleration[index] = setpoint.acceleration[index]
                + self.stiffness * (setpoint.position[index] - reading.position)
                + self.damping * (setpoint.velocity[index] - reading.velocity);
        }
        let (model, data) = (&self.model, &mut self.data);
        if self.integral.is_some() {
            let mass = model.mass_matrix(data, &self.position, self.options);
            for (index, inertia) in self.inertia.iter_mut().enumerate() {
                *inertia = mass[(index, index)];
            }
        }
        let torques = model.inverse_dynamics(
            data,
            &self.position,
            &self.velocity,
            &self.acceleration,
            self.options,
        );
        for (index, (out, torque)) in out.iter_mut().zip(torques).enumerate() {
            *out = match &mut self.integral {
                Some(integral) => {
                    let error = setpoint.position[index] - self.position[index];
                    let limit = model.joints()[index].limits.torque;
                    let off = (self.inertia[index], error);
                    integral.added_to(*torque, index, off, limit, period)
                }
                None => *torque,
            };
        }
    }
}
