//! Rigid-body dynamics of the arm: recursive Newton-Euler, gravity, mass matrix. No allocation.
//!
//! The recursion is that of Luh, Walker and Paul (ASME J. DSMC 102, 1980) in link frames.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::model::{ArmModel, DOF, DhRow, Joints};
pub use crate::model::DynamicsOptions;

/// Rotation of frame i in frame i-1 and the way from origin i-1 to origin i, in frame i.
fn step(row: &DhRow, angle: f64) -> (Matrix3<f64>, Vector3<f64>) {
    let (s, c) = angle.sin_cos();
    let (sa, ca) = (row.sin_alpha, row.cos_alpha);
    let rotation = Matrix3::new(c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca);
    (rotation, Vector3::new(row.a, row.d * sa, row.d * ca))
}

impl ArmModel {
    /// Inverse dynamics: the joint torques (N m) that give accelerations `qdd` (rad/s^2) at
    /// positions `q` (rad) and speeds `qd` (rad/s), gravity included.
    #[must_use]
    pub fn inverse_dynamics(
        &self,
        q: &Joints,
        qd: &Joints,
        qdd: &Joints,
        options: DynamicsOptions,
    ) -> Joints {
        self.newton_euler(q, qd, qdd, &self.gravity, options)
    }

    /// Torques (N m) that hold the arm at rest at `q` (rad) against gravity.
    #[must_use]
    pub fn gravity_torques(&self, q: &Joints) -> Joints {
        let mut rotations = [Matrix3::identity(); DOF];
        let mut ways = [Vector3::zeros(); DOF];
        let mut forces = [Vector3::zeros(); DOF];
        // Holding against gravity is the same as accelerating upwards.
        let mut up = -self.gravity;
        for index in 0..DOF {
            let (rotation, way) = step(&self.dh[index], q[index]);
            up = rotation.tr_mul(&up);
            forces[index] = up * self.links[index].mass;
            (rotations[index], ways[index]) = (rotation, way);
        }
        let moments = [Vector3::zeros(); DOF];
        self.backward(&rotations, &ways, &forces, &moments)
    }

    fn newton_euler(
        &self,
        q: &Joints,
        qd: &Joints,
        qdd: &Joints,
        gravity: &Vector3<f64>,
        options: DynamicsOptions,
    ) -> Joints {
        let mut rotations = [Matrix3::identity(); DOF];
        let mut ways = [Vector3::zeros(); DOF];
        let mut forces = [Vector3::zeros(); DOF];
        let mut moments = [Vector3::zeros(); DOF];
        let mut turning = Vector3::zeros();
        let mut turning_rate = Vector3::zeros();
        let mut acceleration = -*gravity;
        for index in 0..DOF {
            let (rotation, way) = step(&self.dh[index], q[index]);
            let spin = Vector3::new(0.0, 0.0, qd[index]);
            let spin_rate = Vector3::new(0.0, 0.0, qdd[index]);
            turning_rate = rotation.tr_mul(&(turning_rate + spin_rate + turning.cross(&spin)));
            turning = rotation.tr_mul(&(turning + spin));
            acceleration = rotation.tr_mul(&acceleration)
                + turning_rate.cross(&way)
                + turning.cross(&turning.cross(&way));
            let link = &self.links[index];
            let centre = &link.centre_of_mass;
            let at_centre =
                acceleration + turning_rate.cross(centre) + turning.cross(&turning.cross(centre));
            forces[index] = at_centre * link.mass;
            moments[index] = link.inertia * turning_rate + turning.cross(&(link.inertia * turning));
            (rotations[index], ways[index]) = (rotation, way);
        }
        let mut torques = self.backward(&rotations, &ways, &forces, &moments);
        for (index, torque) in torques.iter_mut().enumerate() {
            let motor = &self.motors[index];
            if options.rotor_inertia {
                *torque += motor.reflected_inertia() * qdd[index];
            }
            if options.friction {
                *torque += motor.friction_torque(qd[index]);
            }
        }
        torques
    }

    /// The inward pass: joint torques from the net force and moment on each link.
    fn backward(
        &self,
        rotations: &[Matrix3<f64>; DOF],
        ways: &[Vector3<f64>; DOF],
        forces: &[Vector3<f64>; DOF],
        moments: &[Vector3<f64>; DOF],
    ) -> Joints {
        let mut force = Vector3::zeros();
        let mut moment = Vector3::zeros();
        let mut torques = [0.0; DOF];
        for index in (0..DOF).rev() {
            // `force` and `moment` arrive in this link's frame, exerted by it on the next link.
            force += forces[index];
            moment += ways[index].cross(&force)
                + self.links[index].centre_of_mass.cross(&forces[index])
                + moments[index];
            force = rotations[index] * force;
            moment = rotations[index] * moment;
            torques[index] = moment.z;
        }
        torques
    }

    /// Joint-space mass matrix M(q), kg m^2, column by column from inverse dynamics.
    #[must_use]
    pub fn mass_matrix(&self, q: &Joints, options: DynamicsOptions) -> Matrix6<f64> {
        let still = [0.0; DOF];
        let weightless = Vector3::zeros();
        let mut matrix = Matrix6::zeros();
        for column in 0..DOF {
            let mut unit = still;
            unit[column] = 1.0;
            let torques = self.newton_euler(q, &still, &unit, &weightless, options);
            matrix.set_column(column, &Vector6::from(torques));
        }
        matrix
    }

    /// Forward dynamics: joint accelerations (rad/s^2) under `torques` (N m), or `None` when the mass
    /// matrix is not positive definite, which only a broken inertia set or non-finite input gives.
    #[must_use]
    pub fn forward_dynamics(
        &self,
        q: &Joints,
        qd: &Joints,
        torques: &Joints,
        options: DynamicsOptions,
    ) -> Option<Joints> {
        let bias = self.inverse_dynamics(q, qd, &[0.0; DOF], options);
        let drive = Vector6::from(*torques) - Vector6::from(bias);
        let matrix = self.mass_matrix(q, options);
        Some(matrix.cholesky()?.solve(&drive).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const POSE: Joints = [0.5, -0.5, 0.5, -0.5, 0.5, -0.5];
    const ONES: Joints = [1.0; 6];

    fn assert_close(found: &Joints, expected: &Joints) {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found} is not {expected}");
        }
    }

    #[test]
    fn gravity_torques_are_the_published_ones() {
        let expected = [0.0, 33.404_608_849, 0.237_041_794, 0.0, -0.013_545_114, 0.0];
        assert_close(&ArmModel::puma560().gravity_torques(&POSE), &expected);
    }

    #[test]
    fn inverse_dynamics_are_the_published_ones_for_the_identified_set() {
        let model = ArmModel::puma560_identified();
        let rigid = model.inverse_dynamics(&POSE, &ONES, &ONES, DynamicsOptions::RIGID);
        assert_close(
            &rigid,
            &[
                2.162_084_304,
                34.157_004_464,
                1.338_393_456,
                0.005_147_848,
                -0.008_551_583,
                0.000_019_806,
            ],
        );
        let rotors = model.inverse_dynamics(&POSE, &ONES, &ONES, DynamicsOptions::WITH_ROTORS);
        assert_close(
            &rotors,
            &[
                2.946_114_273,
                36.481_819_309,
                1.915_266_788,
                0.195_938_475,
                0.162_154_709,
                0.194_084_311,
            ],
        );
    }

    #[test]
    fn friction_opposes_motion_in_both_directions() {
        let model = ArmModel::puma560();
        for sign in [1.0, -1.0] {
            let qd = [sign; 6];
            let with = model.inverse_dynamics(&POSE, &qd, &[0.0; 6], DynamicsOptions::FULL);
            let without = model.inverse_dynamics(&POSE, &qd, &[0.0; 6], DynamicsOptions::RIGID);
            for index in 0..6 {
                assert!(sign * (with[index] - without[index]) > 0.0);
            }
        }
    }

    /// Kinetic energy from the velocities of the links' centres of mass, by a way of its own.
    fn kinetic_energy(model: &ArmModel, q: &Joints, qd: &Joints) -> f64 {
        let frames = model.frames(q);
        let mut turning = Vector3::zeros();
        let mut origin_speed = Vector3::zeros();
        let mut previous = super::super::kinematics::Frame::base();
        let mut energy = 0.0;
        for (index, frame) in frames.iter().enumerate() {
            turning += previous.rotation.column(2) * qd[index];
            origin_speed += turning.cross(&(frame.origin - previous.origin));
            let link = &model.links[index];
            let speed = origin_speed + turning.cross(&(frame.rotation * link.centre_of_mass));
            let inertia = frame.rotation * link.inertia * frame.rotation.transpose();
            energy += 0.5 * link.mass * speed.norm_squared();
            energy += 0.5 * turning.dot(&(inertia * turning));
            energy += 0.5 * model.motors[index].reflected_inertia() * qd[index] * qd[index];
            previous = *frame;
        }
        energy
    }

    fn potential_energy(model: &ArmModel, q: &Joints) -> f64 {
        let frames = model.frames(q);
        let weigh = |(frame, link): (&super::super::kinematics::Frame, &super::super::Link)| {
            let centre = frame.origin + frame.rotation * link.centre_of_mass;
            -link.mass * model.gravity.dot(&centre)
        };
        frames.iter().zip(&model.links).map(weigh).sum()
    }

    fn joints(bound: f64) -> impl Strategy<Value = Joints> {
        prop::array::uniform6(-bound..bound)
    }

    proptest! {
        #[test]
        fn power_of_the_torques_is_the_rate_of_the_energy(
            q in joints(3.0), qd in joints(2.0), qdd in joints(5.0),
        ) {
            let model = ArmModel::puma560();
            let torques = model.inverse_dynamics(&q, &qd, &qdd, DynamicsOptions::WITH_ROTORS);
            let power: f64 = torques.iter().zip(&qd).map(|(torque, speed)| torque * speed).sum();
            let energy = |h: f64| {
                let moved: Joints = std::array::from_fn(|i| q[i] + h * (qd[i] + 0.5 * h * qdd[i]));
                let speeds: Joints = std::array::from_fn(|i| qd[i] + h * qdd[i]);
                kinetic_energy(&model, &moved, &speeds) + potential_energy(&model, &moved)
            };
            let step = 1e-5;
            let rate = (energy(step) - energy(-step)) / (2.0 * step);
            prop_assert!((power - rate).abs() < 1e-5 * (1.0 + power.abs()), "{power} {rate}");
        }

        #[test]
        fn gravity_is_inverse_dynamics_at_rest(q in joints(3.0)) {
            let model = ArmModel::puma560();
            let still = [0.0; 6];
            let at_rest = model.inverse_dynamics(&q, &still, &still, DynamicsOptions::FULL);
            let gravity = model.gravity_torques(&q);
            for index in 0..6 {
                prop_assert!((gravity[index] - at_rest[index]).abs() < 1e-12);
            }
        }

        #[test]
        fn forward_dynamics_undo_inverse_dynamics(
            q in joints(3.0), qd in joints(2.0), qdd in joints(5.0),
        ) {
            let model = ArmModel::puma560();
            let options = DynamicsOptions::FULL;
            let torques = model.inverse_dynamics(&q, &qd, &qdd, options);
            let found = model.forward_dynamics(&q, &qd, &torques, options);
            prop_assert!(found.is_some());
            for (found, given) in found.unwrap_or_default().iter().zip(&qdd) {
                prop_assert!((found - given).abs() < 1e-9);
            }
        }
    }
}
