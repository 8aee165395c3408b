//! Cartesian impedance: the tool is held by a spring and turned by another one, and may press with a force.
//!
//! N. Hogan (ASME J. Dyn. Syst. Meas. Control 107, 1985), by the transposed Jacobian, which needs no inverse and so passes
//! singular poses: tau = g + M qdd_d + J^T (K e + f + k (f + s)) + D (qd_d - qd). e is the way from the tool to its setpoint
//! and the turn, f the force that the tool shall give, s the one that the sensor says it is given. At rest a force from
//! outside moves the tool by K^-1 of it. D is J^T C J and a little at each joint, C one damper for each axis: it never gives
//! energy, so with no force feedback (k = 0) the arm with this law is passive towards whatever it touches.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::ControlLaw;
use crate::driver::SlotReading;
use crate::model::{Data, DynamicsOptions, Model};
use crate::trajectory::Setpoint;

/// What no damper of the tool reaches, as joints beyond six, comes to rest as if its natural frequency were this, Hz.
const LOOSE_HZ: f64 = 0.3;

/// Joints that do not carry the tool, as those of another arm, hold their setpoint with this natural frequency, Hz.
const ASIDE_HZ: f64 = 2.0;

/// A softer axis is damped as one of this stiffness, N/m, and N m/rad: it may touch something stiff.
const DAMPED_AS: [f64; 2] = [500.0, 10.0];

/// The tool never counts as heavier, kg, and kg m^2: across a singular pose it cannot be moved at all.
const HEAVIEST: [f64; 2] = [100.0, 10.0];

/// Stiffness that is taken at most, N/m, and N m/rad.
const STIFFEST: [f64; 2] = [5000.0, 300.0];

/// No stronger feedback of a force is stable on a stiff thing at 4.5 ms.
const MOST_GAIN: f64 = 2.0;

/// Springs, force and feedback. Axes are those of the base frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CartesianImpedanceArgs {
    /// Along x, y and z, N/m, and about them, N m/rad.
    pub stiffness: [f64; 6],
    /// Force (N) and moment (N m) that the tool gives besides.
    pub force: [f64; 6],
    /// Gain of the feedback of the force that the first force-torque sensor measures, whose frame is the tool's.
    pub force_gain: f64,
}

impl Default for CartesianImpedanceArgs {
    fn default() -> Self {
        Self {
            stiffness: [1000.0, 1000.0, 1000.0, 60.0, 60.0, 60.0],
            force: [0.0; 6],
            force_gain: 0.0,
        }
    }
}

impl CartesianImpedanceArgs {
    /// # Errors
    /// A text about the first number that cannot be.
    pub fn check(&self) -> Result<(), String> {
        for (index, stiffness) in self.stiffness.iter().enumerate() {
            let most = STIFFEST[index / 3];
            if !(0.0..=most).contains(stiffness) {
                return Err(format!(
                    "`stiffness` {} is {stiffness}; give a value from 0 to {most}",
                    index + 1
                ));
            }
        }
        if !self
            .force
            .iter()
            .all(|force| (-1000.0..=1000.0).contains(force))
        {
            return Err(format!(
                "`force` is {:?}; give numbers from -1000 to 1000",
                self.force
            ));
        }
        if !(0.0..=MOST_GAIN).contains(&self.force_gain) {
            let gain = self.force_gain;
            return Err(format!(
                "`force_gain` is {gain}; give a value from 0 to {MOST_GAIN}"
            ));
        }
        Ok(())
    }
}

/// A spring and a damper for the tool.
#[derive(Debug, Clone)]
pub struct CartesianImpedance {
    model: Arc<Model>,
    data: Data,
    args: CartesianImpedanceArgs,
    damping: f64,
    measured: Vec<f64>,
    /// Whether each joint carries the tool.
    carries: Vec<bool>,
    /// What each joint needs for the setpoint's acceleration, N m, and its inertia, kg m^2.
    feed: Vec<f64>,
    inertia: Vec<f64>,
    /// Force (N) and moment (N m) on the tool, in its frame.
    sensed: [f64; 6],
}

impl CartesianImpedance {
    /// The law for the tip of `model`, with a `damping` ratio.
    ///
    /// # Errors
    /// A text about the first number that cannot be.
    pub fn new(
        model: Arc<Model>,
        args: CartesianImpedanceArgs,
        damping: f64,
    ) -> Result<Self, String> {
        args.check()?;
        let zero = vec![0.0; model.dof()];
        let chain = model.chain(model.tip());
        let carries = (0..model.dof()).map(|joint| chain.contains(&joint));
        Ok(Self {
            carries: carries.collect(),
            data: model.data(),
            model,
            args,
            damping,
            measured: zero.clone(),
            feed: zero.clone(),
            inertia: zero,
            sensed: [0.0; 6],
        })
    }
}

/// The turn from one rotation to another as an axis times an angle, rad. By a quaternion: the arc cosine of a trace is no
/// number where rounding makes it a hair too large.
fn turn(to: &Matrix3<f64>, from: &Matrix3<f64>) -> Vector3<f64> {
    let turn = Rotation3::from_matrix_unchecked(to * from.transpose());
    UnitQuaternion::from_rotation_matrix(&turn).scaled_axis()
}

impl ControlLaw for CartesianImpedance {
    fn reset(&mut self, _readings: &[SlotReading]) {}

    /// Springs stay as they are; only the damping ratio is taken.
    fn tune(&mut self, _bandwidth: f64, damping: f64) {
        self.damping = damping;
    }

    fn sense(&mut self, numbers: &[f64]) {
        if let Some(wrench) = numbers.first_chunk() {
            self.sensed = *wrench;
        }
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
        let (model, data, tip) = (&self.model, &mut self.data, self.model.tip());
        let options = DynamicsOptions::WITH_ROTORS;
        let mass = model.mass_matrix(data, &self.measured, options);
        for (index, feed) in self.feed.iter_mut().enumerate() {
            let rates = setpoint.acceleration.iter().enumerate();
            *feed = rates.map(|(other, rate)| mass[(index, other)] * rate).sum();
            self.inertia[index] = mass[(index, index)];
        }
        for (out, gravity) in out
            .iter_mut()
            .zip(model.gravity_torques(data, &self.measured))
        {
            *out = *gravity;
        }
        let wanted = model.placement(data, &setpoint.position, tip);
        let found = model.placement(data, &self.measured, tip);
        let way = wanted.origin - found.origin;
        let turn = turn(&wanted.rotation, &found.rotation);
        let [fx, fy, fz, mx, my, mz] = self.sensed;
        let on_tool = found.rotation * Vector3::new(fx, fy, fz);
        let about_tool = found.rotation * Vector3::new(mx, my, mz);
        let CartesianImpedanceArgs {
            stiffness,
            force,
            force_gain: gain,
        } = &self.args;
        let jacobian = model.jacobian(data, &self.measured, tip);
        let wrench: [f64; 6] = std::array::from_fn(|row| {
            let (error, sensed) = match row {
                0..3 => (way[row], on_tool[row]),
                _ => (turn[row - 3], about_tool[row - 3]),
            };
            // How fast the tool is to move along this axis, and how readily the joints let it.
            let (mut speed, mut mobility) = (0.0, 0.0);
            for (index, part) in jacobian.row(row).iter().enumerate() {
                speed += part * (setpoint.velocity[index] - readings[index].velocity);
                mobility += part * part / self.inertia[index];
            }
            let mass = (1.0 / mobility).min(HEAVIEST[row / 3]);
            let damped_as = stiffness[row].max(DAMPED_AS[row / 3]);
            let damper = 2.0 * self.damping * (damped_as * mass).sqrt();
            stiffness[row] * error + damper * speed + force[row] + gain * (force[row] + sensed)
        });
        let [loose, aside] = [LOOSE_HZ, ASIDE_HZ].map(|hz| std::f64::consts::TAU * hz);
        for (index, column) in jacobian.column_iter().enumerate() {
            let pairs = column.iter().zip(wrench);
            let push: f64 = pairs.map(|(part, force)| part * force).sum();
            let speed_error = setpoint.velocity[index] - readings[index].velocity;
            let (natural, spring) = match self.carries[index] {
                true => (loose, 0.0),
                false => (aside, aside * aside * self.inertia[index]),
            };
            let damper = 2.0 * self.damping * natural * self.inertia[index];
            let error = setpoint.position[index] - readings[index].position;
            out[index] += self.feed[index] + push + spring * error + damper * speed_error;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::impedance_tests::{PERIOD, Pushed, puma};
    use crate::joints::Joints;
    use crate::model::{built_in, file::Inertias};

    const START: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];

    fn law(args: CartesianImpedanceArgs) -> CartesianImpedance {
        CartesianImpedance::new(puma(), args, 1.0).unwrap()
    }

    /// Torques at the joints of a force and a moment on the tool, at a pose.
    fn at_joints(q: &[f64], wrench: [f64; 6]) -> [f64; 6] {
        let (model, mut data) = (puma(), puma().data());
        let jacobian = model.jacobian(&mut data, q, model.tip());
        std::array::from_fn(|joint| {
            let column = jacobian.column(joint);
            column
                .iter()
                .zip(wrench)
                .map(|(part, force)| part * force)
                .sum()
        })
    }

    #[test]
    fn the_tool_yields_to_a_force_by_that_over_the_stiffness() {
        let stiffness = [800.0, 1200.0, 2000.0, 40.0, 50.0, 60.0];
        for wrench in [
            [10.0, -6.0, 12.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.4, -0.3, 0.5],
        ] {
            let args = CartesianImpedanceArgs {
                stiffness,
                ..CartesianImpedanceArgs::default()
            };
            let mut arm = Pushed::new(START, [0.0; 6]);
            let mut law = law(args);
            // The force stays what it is while the arm gives way.
            for _ in 0..2000 {
                arm.push = at_joints(&arm.q, wrench).to_vec();
                arm.run(&mut law, PERIOD.as_secs_f64());
            }
            let (model, mut data) = (puma(), puma().data());
            let before = model.placement(&mut data, &START, model.tip());
            let after = model.placement(&mut data, &arm.q, model.tip());
            let way = after.origin - before.origin;
            let turn = turn(&after.rotation, &before.rotation);
            for axis in 0..3 {
                let (by, expected) = (way[axis], wrench[axis] / stiffness[axis]);
                assert!(
                    (by - expected).abs() < 1e-5,
                    "along {axis}: {by} {expected}"
                );
                let (by, expected) = (turn[axis], wrench[axis + 3] / stiffness[axis + 3]);
                // Turns about three axes do not simply add up.
                assert!(
                    (by - expected).abs() < 2e-4,
                    "about {axis}: {by} {expected}"
                );
            }
        }
    }

    #[test]
    fn joints_that_do_not_carry_the_tool_hold_their_setpoint_and_those_that_do_give_way() {
        let model = built_in::model("testbed18", Inertias::Engine);
        let model = Arc::new(model.unwrap().unwrap());
        let q: Vec<f64> = [0.0; 3].into_iter().chain(START).cycle().take(18).collect();
        let setpoint = Setpoint::at_rest(Joints::try_from(&q[..]).unwrap());
        let args = CartesianImpedanceArgs {
            stiffness: [0.0; 6],
            ..CartesianImpedanceArgs::default()
        };
        let mut law = CartesianImpedance::new(Arc::clone(&model), args, 1.0).unwrap();
        let mut off = |joint: usize| {
            let mut data = model.data();
            let readings: Vec<SlotReading> = (0..18)
                .map(|index| SlotReading {
                    position: q[index] - if index == joint { 0.01 } else { 0.0 },
                    velocity: 0.0,
                })
                .collect();
            let there: Vec<f64> = readings.iter().map(|reading| reading.position).collect();
            let weight = model.gravity_torques(&mut data, &there)[joint];
            let mut out = [0.0; 18];
            law.torques(&setpoint, &readings, PERIOD, &mut out);
            let inertia = model.mass_matrix(&mut data, &there, DynamicsOptions::WITH_ROTORS);
            (out[joint] - weight) / inertia[(joint, joint)]
        };
        // The tip of the testbed is the left one.
        for joint in 0..9 {
            let [left, right] = [joint, joint + 9].map(&mut off);
            assert!(left.abs() < 1e-9, "{joint}: {left}");
            let natural = std::f64::consts::TAU * 2.0;
            assert!(
                (right - 0.01 * natural * natural).abs() < 1e-9,
                "{joint}: {right}"
            );
        }
    }

    #[test]
    fn a_push_dies_out_without_energy_gained_at_the_servos_rate() {
        for stiffness in [[0.0; 6], [5000.0, 5000.0, 5000.0, 300.0, 300.0, 300.0]] {
            let args = CartesianImpedanceArgs {
                stiffness,
                ..CartesianImpedanceArgs::default()
            };
            for start in [
                START,
                [0.0, 0.5, -1.5236, 0.0, 0.0, 0.0],
                [1.0, 0.2, -1.5, -0.5, -0.4, 2.0],
            ] {
                let mut arm = Pushed::new(start, [0.0; 6]);
                arm.qd = vec![0.3, -0.2, 0.3, 0.6, -0.6, 0.6];
                let speed =
                    |arm: &Pushed| arm.qd.iter().fold(0.0_f64, |most, qd| most.max(qd.abs()));
                let mut law = law(args.clone());
                arm.run(&mut law, 1.5);
                assert!(
                    speed(&arm) < 0.02,
                    "{stiffness:?} {start:?}: {}",
                    speed(&arm)
                );
            }
        }
    }

    #[test]
    fn a_tool_on_a_spring_presses_with_the_force_that_it_shall_whatever_its_own_one_is_worth() {
        // No stiffness of its own along z: the floor's spring, 20 kN/m, gives way until the force is there.
        let args = CartesianImpedanceArgs {
            stiffness: [1000.0, 1000.0, 0.0, 60.0, 60.0, 60.0],
            force: [0.0, 0.0, -15.0, 0.0, 0.0, 0.0],
            force_gain: 0.5,
        };
        let mut law = law(args);
        let mut arm = Pushed::new(START, [0.0; 6]);
        let (model, mut data) = (puma(), puma().data());
        let start = model.placement(&mut data, &START, model.tip());
        let mut force = 0.0;
        for _ in 0..900 {
            let now = model.placement(&mut data, &arm.q, model.tip());
            force = (20_000.0 * (start.origin.z - now.origin.z)).max(0.0);
            arm.push = at_joints(&arm.q, [0.0, 0.0, force, 0.0, 0.0, 0.0]).to_vec();
            let sensed = now.rotation.tr_mul(&Vector3::new(0.0, 0.0, force));
            law.sense(&[sensed.x, sensed.y, sensed.z, 0.0, 0.0, 0.0]);
            arm.run(&mut law, PERIOD.as_secs_f64());
        }
        assert!((force - 15.0).abs() < 0.01 * 15.0, "{force}");
    }

    /// Where a hand that pushes with 10 N for a second, and then lets go, leaves the tool, m from where it was, and the most that
    /// it turned by then, rad.
    fn guided(force_gain: f64, along: Vector3<f64>) -> (Vector3<f64>, f64) {
        let args = CartesianImpedanceArgs {
            stiffness: [0.0, 0.0, 0.0, 60.0, 60.0, 60.0],
            force_gain,
            ..CartesianImpedanceArgs::default()
        };
        let (mut law, mut arm) = (law(args), Pushed::new(START, [0.0; 6]));
        let (model, mut data) = (puma(), puma().data());
        let start = model.placement(&mut data, &START, model.tip());
        let (mut now, mut turned) = (start, 0.0_f64);
        for tick in 0..600 {
            let push = if tick < 222 {
                along * 10.0
            } else {
                Vector3::zeros()
            };
            arm.push = at_joints(&arm.q, [push.x, push.y, push.z, 0.0, 0.0, 0.0]).to_vec();
            let felt = now.rotation.tr_mul(&push);
            law.sense(&[felt.x, felt.y, felt.z, 0.0, 0.0, 0.0]);
            arm.run(&mut law, PERIOD.as_secs_f64());
            now = model.placement(&mut data, &arm.q, model.tip());
            turned = turned.max(turn(&now.rotation, &start.rotation).norm());
        }
        // It lies where it was left.
        assert!(arm.qd.iter().all(|qd| qd.abs() < 5e-3), "{:?}", arm.qd);

        (now.origin - start.origin, turned)
    }

    #[test]
    fn a_hand_that_pushes_guides_a_tool_without_a_spring_and_the_more_easily_the_more_it_is_felt() {
        for along in [Vector3::x(), Vector3::y(), -Vector3::z()] {
            let (by, turned) = guided(0.0, along);
            let (way, aside) = (by.dot(&along), (by - along * by.dot(&along)).norm());
            assert!(way > 0.015 && aside < 0.2 * way, "{along}: {by}");
            assert!(turned < 0.01, "{along}: {turned} rad");
            // Half of what moves it is the hand's now, the other half the sensor's.
            let lightly = guided(1.0, along).0.dot(&along);
            assert!((1.8..2.2).contains(&(lightly / way)), "{along}: {lightly}");
        }
    }

    #[test]
    fn a_turn_too_small_to_see_is_still_a_number() {
        let mut law = law(CartesianImpedanceArgs::default());
        for count in 1..2000 {
            let mut out = [0.0; 6];
            let off = 1e-11 * f64::from(count);
            let readings = START.map(|position| SlotReading {
                position: position + off,
                velocity: 0.0,
            });
            let setpoint = Setpoint::at_rest(Joints::from(START));
            law.torques(&setpoint, &readings, PERIOD, &mut out);
            assert!(out.iter().all(|torque| torque.is_finite()), "{count}");
        }
    }

    #[test]
    fn numbers_that_cannot_be_are_refused() {
        let refused = |change: fn(&mut CartesianImpedanceArgs)| {
            let mut args = CartesianImpedanceArgs::default();
            change(&mut args);
            CartesianImpedance::new(puma(), args, 1.0).unwrap_err()
        };
        assert!(refused(|args| args.stiffness[2] = 1e5).contains("`stiffness` 3"));
        assert!(refused(|args| args.stiffness[3] = f64::NAN).contains("`stiffness` 4"));
        assert!(refused(|args| args.force[0] = f64::INFINITY).contains("`force`"));
        assert!(refused(|args| args.force_gain = -1.0).contains("`force_gain`"));
    }

    #[test]
    fn at_its_setpoint_the_law_carries_the_weight_and_nothing_else() {
        let mut out = [0.0; 6];
        let readings: Vec<SlotReading> = START
            .iter()
            .map(|position| SlotReading {
                position: *position,
                velocity: 0.0,
            })
            .collect();
        let setpoint = Setpoint::at_rest(Joints::from(START));
        law(CartesianImpedanceArgs::default()).torques(&setpoint, &readings, PERIOD, &mut out);
        let (model, mut data) = (puma(), puma().data());
        for (torque, gravity) in out.iter().zip(model.gravity_torques(&mut data, &START)) {
            assert!((torque - gravity).abs() < 1e-12);
        }
    }
}
