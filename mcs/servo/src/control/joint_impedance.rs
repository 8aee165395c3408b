//! Joint impedance: each joint is a spring and a damper between its setpoint and where it is.
//!
//! The law of N. Hogan (Impedance control, ASME J. Dyn. Syst. Meas. Control 107, 1985) at the joints, with gravity and the
//! setpoint's acceleration fed forward: tau = g(q) + M(q) qdd_d + K (q_d - q) + D (qd_d - qd). At rest a torque t from outside
//! moves a joint by t / K, whatever the pose and the load of the others.

use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;

use super::ControlLaw;
use crate::driver::SlotReading;
use crate::model::{Data, DynamicsOptions, Model};
use crate::trajectory::Setpoint;

/// Springs and dampers.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointImpedanceArgs {
    /// Stiffness of each joint, N m/rad, or N/m of one that slides. None: that of the bandwidth with the inertia at zero.
    pub stiffness: Option<Vec<f64>>,
}

/// A spring and a damper for each joint.
#[derive(Debug, Clone)]
pub struct JointImpedance {
    model: Arc<Model>,
    data: Data,
    stiffness: Vec<f64>,
    /// Damping ratio with the joint's inertia in the present pose.
    damping: f64,
    measured: Vec<f64>,
    /// Torque that the setpoint's acceleration needs, N m, and damping, N m s/rad.
    feed: Vec<f64>,
    dampers: Vec<f64>,
}

impl JointImpedance {
    /// The law with a `stiffness` for each joint (N m/rad or N/m) and a `damping` ratio.
    ///
    /// # Errors
    /// A text about a stiffness that is missing, below zero, or so high that a servo with `period` would be unstable.
    pub fn new(
        model: Arc<Model>,
        stiffness: Vec<f64>,
        damping: f64,
        period: Duration,
    ) -> Result<Self, String> {
        let n = model.dof();
        if stiffness.len() != n {
            let given = stiffness.len();
            return Err(format!(
                "`stiffness` has {given} numbers; give one for each of {n} joints"
            ));
        }
        let most = Self::of_bandwidth(&model, 0.05 / period.as_secs_f64());
        for (index, (stiffness, most)) in stiffness.iter().zip(most).enumerate() {
            // The usual bandwidth may be the highest one, but for rounding.
            if !(0.0..=most * (1.0 + 1e-9)).contains(stiffness) {
                return Err(format!(
                    "the stiffness of joint {} is {stiffness}; give a value from 0 to {most:.0}, with which it reaches the \
                     highest bandwidth of this servo",
                    index + 1
                ));
            }
        }
        let zero = vec![0.0; n];
        Ok(Self {
            data: model.data(),
            model,
            stiffness,
            damping,
            measured: zero.clone(),
            feed: zero.clone(),
            dampers: zero,
        })
    }

    /// The stiffness with which each joint alone, in the pose where all positions are 0, has a natural frequency of
    /// `bandwidth` Hz. The sampled loop stays stable where a joint's inertia is a quarter of that.
    #[must_use]
    pub fn of_bandwidth(model: &Model, bandwidth: f64) -> Vec<f64> {
        let natural = std::f64::consts::TAU * bandwidth;
        let zero = vec![0.0; model.dof()];
        let mut data = model.data();
        let mass = model.mass_matrix(&mut data, &zero, DynamicsOptions::WITH_ROTORS);
        let inertias = mass.diagonal();
        inertias
            .iter()
            .map(|inertia| natural * natural * inertia)
            .collect()
    }
}

impl ControlLaw for JointImpedance {
    fn reset(&mut self, _readings: &[SlotReading]) {}

    /// Springs stay as they are; only the damping ratio is taken.
    fn tune(&mut self, _bandwidth: f64, damping: f64) {
        self.damping = damping;
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        _period: Duration,
        out: &mut [f64],
    ) {
        for (measured, reading) in self.measured.iter_mut().zip(readings) {
            *measured = reading.position;
        }
        let options = DynamicsOptions::WITH_ROTORS;
        let mass = self
            .model
            .mass_matrix(&mut self.data, &self.measured, options);
        let each = self.feed.iter_mut().zip(&mut self.dampers);
        for (index, (feed, damper)) in each.enumerate() {
            let rates = setpoint.acceleration.iter().enumerate();
            *feed = rates.map(|(other, rate)| mass[(index, other)] * rate).sum();
            let inertia = mass[(index, index)];
            *damper = 2.0 * self.damping * (self.stiffness[index] * inertia).sqrt();
        }
        let gravity = self.model.gravity_torques(&mut self.data, &self.measured);
        for (index, (out, reading)) in out.iter_mut().zip(readings).enumerate() {
            let spring = self.stiffness[index] * (setpoint.position[index] - reading.position);
            let damper = self.dampers[index] * (setpoint.velocity[index] - reading.velocity);
            *out = gravity[index] + self.feed[index] + spring + damper;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::impedance_tests::{PERIOD, Pushed, puma};

    const STIFFNESS: [f64; 6] = [400.0, 800.0, 200.0, 60.0, 50.0, 60.0];

    fn law() -> JointImpedance {
        JointImpedance::new(puma(), STIFFNESS.to_vec(), 1.0, PERIOD).unwrap()
    }

    #[test]
    fn a_joint_yields_to_a_torque_by_that_over_its_stiffness() {
        let torques = [8.0, -12.0, 4.0, 0.6, -0.5, 0.3];
        for start in [
            [0.0, 0.8, -2.6, 0.2, 0.7, 0.1],
            [1.0, 0.2, -1.5, -0.5, -0.4, 2.0],
        ] {
            let mut arm = Pushed::new(start, torques);
            arm.run(&mut law(), 2.0);
            for joint in 0..6 {
                let by = arm.q[joint] - start[joint];
                let expected = torques[joint] / STIFFNESS[joint];
                assert!(
                    (by - expected).abs() < 1e-6,
                    "joint {joint}: {by} {expected}"
                );
            }
        }
    }

    #[test]
    fn the_stiffest_springs_that_are_taken_are_stable_in_any_pose() {
        let stiffest = JointImpedance::of_bandwidth(&puma(), 0.05 / PERIOD.as_secs_f64());
        for start in [
            [0.0; 6],
            [0.3, 1.5, -1.5, 0.0, 0.0, 0.0],
            [0.0, 0.8, -3.0, 0.5, 1.2, 0.3],
        ] {
            let mut law = JointImpedance::new(puma(), stiffest.clone(), 0.7, PERIOD).unwrap();
            let mut arm = Pushed::new(start, [0.0; 6]);
            arm.qd = vec![0.4, -0.3, 0.5, 1.0, -1.0, 1.0];
            arm.run(&mut law, 2.0);
            let speed = arm
                .qd
                .iter()
                .fold(0.0_f64, |most, speed| most.max(speed.abs()));
            assert!(speed < 1e-4, "{speed}");
        }
    }

    #[test]
    fn springs_that_cannot_be_are_refused() {
        let refused = |stiffness: &[f64]| {
            JointImpedance::new(puma(), stiffness.to_vec(), 1.0, PERIOD).unwrap_err()
        };
        assert!(refused(&[1.0; 5]).contains("one for each of 6 joints"));
        assert!(refused(&[-1.0; 6]).contains("joint 1 is -1"));
        assert!(refused(&[f64::NAN; 6]).contains("joint 1 is NaN"));
        assert!(refused(&[1e6; 6]).contains("highest bandwidth"));
    }
}
