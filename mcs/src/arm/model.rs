//! What a six-joint arm is made of: kinematic rows, link inertias, motors, friction and limits.
//!
//! Pure data, all public, so that a simulator builds its bodies from the same numbers that the
//! controller compensates. Nothing here computes motion.

use nalgebra::{Matrix3, Vector3};

pub use crate::model::{Friction, Limits as JointLimits, Motor};

/// Number of joints of one arm.
pub const DOF: usize = 6;

/// One value per joint, joint 1 first: rad, rad/s, rad/s^2 or N m as the context says.
pub type Joints = [f64; DOF];

/// One row of the standard Denavit-Hartenberg table:
/// `A_i = Rz(q_i) Tz(d) Tx(a) Rx(alpha)`, the pose of frame i in frame i-1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DhRow {
    /// Offset along the joint axis z of frame i-1, m.
    pub d: f64,
    /// Length of the common normal, along x of frame i, m.
    pub a: f64,
    /// Twist about x of frame i, rad.
    pub alpha: f64,
    /// Sine of `alpha`, kept because every pose of the arm needs it.
    pub sin_alpha: f64,
    /// Cosine of `alpha`.
    pub cos_alpha: f64,
}

impl DhRow {
    /// A row with `d` and `a` in m and the twist in quarter turns, which makes its sine and cosine
    /// exact: every arm of this family has axes that are parallel or at right angles.
    #[must_use]
    pub fn quarter_turns(d: f64, a: f64, quarters: i8) -> Self {
        let (sin_alpha, cos_alpha) = match quarters.rem_euclid(4) {
            0 => (0.0, 1.0),
            1 => (1.0, 0.0),
            2 => (0.0, -1.0),
            _ => (-1.0, 0.0),
        };
        Self {
            d,
            a,
            alpha: f64::from(quarters) * std::f64::consts::FRAC_PI_2,
            sin_alpha,
            cos_alpha,
        }
    }
}

/// The rigid body that moves with DH frame i.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the link's own DH frame, m.
    pub centre_of_mass: Vector3<f64>,
    /// Inertia tensor about the centre of mass, axes of the link's DH frame, kg m^2.
    pub inertia: Matrix3<f64>,
}

/// A six-joint arm with a spherical wrist.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmModel {
    /// Name for messages.
    pub name: &'static str,
    /// DH rows, joint 1 first.
    pub dh: [DhRow; DOF],
    /// Links 1 to 6.
    pub links: [Link; DOF],
    /// Motors of joints 1 to 6.
    pub motors: [Motor; DOF],
    /// Limits of joints 1 to 6.
    pub limits: [JointLimits; DOF],
    /// Acceleration of free fall in the base frame, m/s^2.
    pub gravity: Vector3<f64>,
}

const fn link(mass: f64, com: [f64; 3], inertia: [f64; 3]) -> Link {
    let [ixx, iyy, izz] = inertia;
    Link {
        mass,
        centre_of_mass: Vector3::new(com[0], com[1], com[2]),
        inertia: Matrix3::new(ixx, 0.0, 0.0, 0.0, iyy, 0.0, 0.0, 0.0, izz),
    }
}

const fn motor(rotor_inertia: f64, gear_ratio: f64, viscous: f64, coulomb: [f64; 2]) -> Motor {
    let [coulomb_forward, coulomb_backward] = coulomb;
    Motor {
        rotor_inertia,
        gear_ratio,
        friction: Friction {
            viscous,
            coulomb_forward,
            coulomb_backward,
        },
    }
}

/// Jerk is ten times the acceleration, of the wrist fifteen times: published nowhere, and chosen.
fn limits(degrees: [f64; 2], velocity: f64, acceleration: f64, torque: f64) -> JointLimits {
    JointLimits {
        lower: degrees[0].to_radians(),
        upper: degrees[1].to_radians(),
        velocity,
        acceleration,
        jerk: acceleration * if torque < 50.0 { 15.0 } else { 10.0 },
        torque,
    }
}

impl ArmModel {
    /// The PUMA 560 with an inertia set that every physics engine accepts: [`Self::puma560_identified`]
    /// with two changes. Link 3's Ixx is 0.074 kg m^2 (0.066 breaks the triangle inequality of a
    /// rigid body), and link 1, whose mass no experiment can see, gets 1 kg at its frame's origin and
    /// 0.35 kg m^2 about every axis, which does not change joint 1's motion.
    #[must_use]
    pub fn puma560() -> Self {
        let mut model = Self::puma560_identified();
        model.links[0] = link(1.0, [0.0; 3], [0.35, 0.35, 0.35]);
        model.links[2].inertia[(0, 0)] = 0.074;
        model
    }

    /// The PUMA 560 as identified: kinematics and inertias of P. I. Corke and B. Armstrong-Helouvry
    /// (IEEE ICRA 1994) in the form of the Robotics Toolbox, base frame at the floor under the
    /// 26.45 in pedestal. Joint limits after Wang and Chen 1991; largest torques after Armstrong,
    /// Khatib and Burdick 1986; speeds from the motors' voltage saturation (Corke 1996, Table 2.21).
    /// Accelerations are published nowhere: they are chosen well inside torque over inertia.
    #[must_use]
    pub fn puma560_identified() -> Self {
        Self {
            name: "puma560",
            dh: [
                DhRow::quarter_turns(0.67183, 0.0, 1),
                DhRow::quarter_turns(0.0, 0.4318, 0),
                DhRow::quarter_turns(0.15005, 0.0203, -1),
                DhRow::quarter_turns(0.4318, 0.0, 1),
                DhRow::quarter_turns(0.0, 0.0, -1),
                DhRow::quarter_turns(0.0, 0.0, 0),
            ],
            links: [
                link(0.0, [0.0; 3], [0.0, 0.35, 0.0]),
                link(17.4, [-0.3638, 0.006, 0.2275], [0.13, 0.524, 0.539]),
                link(4.8, [-0.0203, -0.0141, 0.070], [0.066, 0.086, 0.0125]),
                link(0.82, [0.0, 0.019, 0.0], [1.8e-3, 1.3e-3, 1.8e-3]),
                link(0.34, [0.0; 3], [0.3e-3, 0.4e-3, 0.3e-3]),
                link(0.09, [0.0, 0.0, 0.032], [0.15e-3, 0.15e-3, 0.04e-3]),
            ],
            motors: [
                motor(200e-6, -62.6111, 1.48e-3, [0.395, -0.435]),
                motor(200e-6, 107.815, 0.817e-3, [0.126, -0.071]),
                motor(200e-6, -53.7063, 1.38e-3, [0.132, -0.105]),
                motor(33e-6, 76.0364, 71.2e-6, [0.0112, -0.0169]),
                motor(33e-6, 71.923, 82.6e-6, [0.00926, -0.0145]),
                motor(33e-6, 76.686, 36.7e-6, [0.00396, -0.0105]),
            ],
            limits: [
                limits([-160.0, 160.0], 1.9, 10.0, 97.6),
                limits([-45.0, 225.0], 1.5, 12.0, 186.4),
                limits([-225.0, 45.0], 2.4, 12.0, 89.4),
                limits([-110.0, 170.0], 5.3, 20.0, 24.2),
                limits([-100.0, 100.0], 5.0, 20.0, 20.1),
                limits([-266.0, 266.0], 5.7, 20.0, 21.3),
            ],
            gravity: Vector3::new(0.0, 0.0, -9.81),
        }
    }

    /// The first joint whose position in `q` is outside its limits (or not a number), by index from 0.
    #[must_use]
    pub fn joint_outside(&self, q: &Joints) -> Option<usize> {
        q.iter()
            .zip(&self.limits)
            .position(|(value, limit)| !(limit.lower..=limit.upper).contains(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflected_inertia_matches_the_published_column() {
        let expected = [0.78403, 2.32481, 0.57687, 0.19079, 0.17071, 0.19406];
        let model = ArmModel::puma560();
        for (motor, expected) in model.motors.iter().zip(expected) {
            assert!((motor.reflected_inertia() - expected).abs() < 5e-6);
        }
    }

    #[test]
    fn every_link_of_the_engine_set_is_a_possible_rigid_body() {
        for link in ArmModel::puma560().links {
            let (x, y, z) = (
                link.inertia[(0, 0)],
                link.inertia[(1, 1)],
                link.inertia[(2, 2)],
            );
            assert!(link.mass > 0.0);
            assert!(x > 0.0 && y > 0.0 && z > 0.0);
            assert!(x + y >= z && y + z >= x && x + z >= y);
        }
    }

    #[test]
    fn a_joint_outside_its_limits_is_found_and_nan_counts_as_outside() {
        let model = ArmModel::puma560();
        assert_eq!(model.joint_outside(&[0.0; 6]), None);
        assert_eq!(
            model.joint_outside(&[0.0, 0.0, 0.9, 0.0, 0.0, 0.0]),
            Some(2)
        );
        assert_eq!(
            model.joint_outside(&[0.0, 0.0, 0.0, 0.0, f64::NAN, 0.0]),
            Some(4)
        );
    }
}
