//! The integral part of a law: it takes up what the model does not know, wrong masses and dry friction above all.

use std::f64::consts::TAU;
use std::time::Duration;

/// Share of a joint's torque limit that it may take.
pub(super) const SHARE: f64 = 0.3;

/// Torques that grow while joints are off their setpoints, N m or N.
#[derive(Debug, Clone)]
pub(super) struct Integral {
    /// Of the error, as a share of the inertia, 1/s^3.
    gain: f64,
    torques: Vec<f64>,
}

impl Integral {
    /// For so many joints under a loop of `bandwidth` Hz, five times slower than that.
    pub fn new(joints: usize, bandwidth: f64) -> Self {
        let mut integral = Self {
            gain: 0.0,
            torques: vec![0.0; joints],
        };
        integral.tune(bandwidth);
        integral
    }

    pub fn tune(&mut self, bandwidth: f64) {
        self.gain = (TAU * bandwidth).powi(3) / 5.0;
    }

    pub fn reset(&mut self) {
        self.torques.fill(0.0);
    }

    /// The torque of one joint in this tick, where the rest of the law gives `torque` and the joint of `inertia` (kg m^2 or
    /// kg) is `error` off (rad or m). It grows for the next tick, but not beyond its share of `limit`, and at the limit only
    /// if that leads back from it.
    pub fn added_to(
        &mut self,
        torque: f64,
        index: usize,
        (inertia, error): (f64, f64),
        limit: f64,
        period: Duration,
    ) -> f64 {
        let Some(own) = self.torques.get_mut(index) else {
            return torque;
        };
        let wanted = torque + *own;
        let saturated = wanted.abs() > limit && wanted * error > 0.0;
        if !saturated {
            let step = inertia * self.gain * error * period.as_secs_f64();
            *own = (*own + step).clamp(-SHARE * limit, SHARE * limit);
        }
        wanted.clamp(-limit, limit)
    }
}
