//! What the simulator knows of a PUMA 560: kinematics, masses, motors, friction, limits.
//!
//! Source: Robotics Toolbox for Python 1.5.0, `models.DH.Puma560` (after Corke and Armstrong-Helouvry
//! 1994); torque limits from Armstrong, Khatib and Burdick 1986, table 7. Standard
//! Denavit-Hartenberg frames: `A_i = Rz(q) Tz(d) Tx(a) Rx(alpha)`. Nothing here is claimed exact for
//! the machines of the original testbed.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Number of joints.
pub const JOINTS: usize = 6;

/// One joint and the link that it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Denavit-Hartenberg offset along the joint axis, m.
    pub d: f64,
    /// Denavit-Hartenberg length along the new x axis, m.
    pub a: f64,
    /// Denavit-Hartenberg twist about the new x axis, rad.
    pub alpha: f64,
    /// Lowest and highest joint angle, rad.
    pub limits: [f64; 2],
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the link's own frame, m.
    pub centre: [f64; 3],
    /// Diagonal of the inertia tensor about the centre of mass, axes of the link's frame, kg m^2.
    pub inertia: [f64; 3],
    /// Motor inertia seen at the joint, kg m^2.
    pub rotor_inertia: f64,
    /// Viscous friction at the joint, N m s/rad.
    pub viscous: f64,
    /// Coulomb friction at the joint when moving in the positive and negative direction, N m (both
    /// as magnitudes).
    pub coulomb: [f64; 2],
    /// Largest torque the drive can give at the joint, N m.
    pub max_torque: f64,
}

impl Link {
    /// The pose of this link's frame in its parent's frame, `parent_T_link`, at joint angle `q`, rad.
    #[must_use]
    pub fn pose(&self, q: f64) -> Isometry3<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q) * self.fixed_part()
    }

    /// The part of [`pose`](Self::pose) that the joint does not move: `Tz(d) Tx(a) Rx(alpha)`.
    #[must_use]
    pub fn fixed_part(&self) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(self.a, 0.0, self.d),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.alpha),
        )
    }
}

/// The six links, base first. Base frame: world, z up, the shoulder 0.67183 m above the floor.
///
/// Two rows differ from the source because no rigid body can have its values: link 1 (mass 0) is a
/// body of 1 kg at the origin, which changes nothing about joint 1; link 3's `Ixx` is 0.074 instead
/// of 0.066, which broke the triangle inequality.
pub const LINKS: [Link; JOINTS] = [
    Link {
        d: 0.67183,
        a: 0.0,
        alpha: FRAC_PI_2,
        limits: degrees(-160.0, 160.0),
        mass: 1.0,
        centre: [0.0, 0.0, 0.0],
        inertia: [0.35, 0.35, 0.35],
        ..drive(200e-6, 62.6111, 1.48e-3, [0.395, 0.435], 97.6)
    },
    Link {
        d: 0.0,
        a: 0.4318,
        alpha: 0.0,
        limits: degrees(-45.0, 225.0),
        mass: 17.4,
        centre: [-0.3638, 0.006, 0.2275],
        inertia: [0.13, 0.524, 0.539],
        ..drive(200e-6, 107.815, 0.817e-3, [0.126, 0.071], 186.4)
    },
    Link {
        d: 0.15005,
        a: 0.0203,
        alpha: -FRAC_PI_2,
        limits: degrees(-225.0, 45.0),
        mass: 4.8,
        centre: [-0.0203, -0.0141, 0.070],
        inertia: [0.074, 0.086, 0.0125],
        ..drive(200e-6, 53.7063, 1.38e-3, [0.132, 0.105], 89.4)
    },
    Link {
        d: 0.4318,
        a: 0.0,
        alpha: FRAC_PI_2,
        limits: degrees(-110.0, 170.0),
        mass: 0.82,
        centre: [0.0, 0.019, 0.0],
        inertia: [1.8e-3, 1.3e-3, 1.8e-3],
        ..drive(33e-6, 76.0364, 71.2e-6, [0.0112, 0.0169], 24.2)
    },
    Link {
        d: 0.0,
        a: 0.0,
        alpha: -FRAC_PI_2,
        limits: degrees(-100.0, 100.0),
        mass: 0.34,
        centre: [0.0, 0.0, 0.0],
        inertia: [0.3e-3, 0.4e-3, 0.3e-3],
        ..drive(33e-6, 71.923, 82.6e-6, [0.00926, 0.0145], 20.1)
    },
    Link {
        d: 0.0,
        a: 0.0,
        alpha: 0.0,
        limits: degrees(-266.0, 266.0),
        mass: 0.09,
        centre: [0.0, 0.0, 0.032],
        inertia: [0.15e-3, 0.15e-3, 0.04e-3],
        ..drive(33e-6, 76.686, 36.7e-6, [0.00396, 0.0105], 21.3)
    },
];

/// The poses of the base frame and of the six link frames in the world, `world_T_link`.
#[must_use]
pub fn link_poses(joints: &[f64; JOINTS]) -> [Isometry3<f64>; JOINTS + 1] {
    let mut poses = [Isometry3::identity(); JOINTS + 1];
    let mut pose = Isometry3::identity();
    for ((link, q), out) in LINKS.iter().zip(joints).zip(poses.iter_mut().skip(1)) {
        pose *= link.pose(*q);
        *out = pose;
    }
    poses
}

const fn degrees(low: f64, high: f64) -> [f64; 2] {
    [low.to_radians(), high.to_radians()]
}

/// The drive's share of a link: motor values (motor side) carried over the gear to the joint.
const fn drive(rotor: f64, gear: f64, viscous: f64, coulomb: [f64; 2], max_torque: f64) -> Link {
    Link {
        d: 0.0,
        a: 0.0,
        alpha: 0.0,
        limits: [0.0, 0.0],
        mass: 0.0,
        centre: [0.0; 3],
        inertia: [0.0; 3],
        rotor_inertia: rotor * gear * gear,
        viscous: viscous * gear * gear,
        coulomb: [coulomb[0] * gear, coulomb[1] * gear],
        max_torque,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forward_kinematics_gives_the_published_answers() {
        let zero = link_poses(&[0.0; 6])[6];
        assert!((zero.translation.vector - Vector3::new(0.4521, -0.15005, 1.10363)).norm() < 1e-9);
        let bent = link_poses(&[0.5, -0.5, 0.5, -0.5, 0.5, -0.5])[6];
        let p = Vector3::new(0.422303996, 0.059724661, 0.896614052);
        assert!((bent.translation.vector - p).norm() < 2e-9);
        let row = bent.rotation.to_rotation_matrix();
        assert!((row[(0, 0)] - 0.770151153).abs() < 1e-9);
        assert!((row[(0, 1)] - 0.420735492).abs() < 1e-9);
        assert!((row[(0, 2)] + 0.479425539).abs() < 1e-9);
    }

    #[test]
    fn every_link_is_a_body_that_can_exist() {
        for link in LINKS {
            let [x, y, z] = link.inertia;
            assert!(link.mass > 0.0 && x + y >= z && y + z >= x && z + x >= y);
        }
    }

    #[test]
    fn the_motor_inertia_at_the_joint_is_the_published_product() {
        let published = [0.78403, 2.32481, 0.57687, 0.19079, 0.17071, 0.19406];
        for (link, value) in LINKS.iter().zip(published) {
            assert!((link.rotor_inertia - value).abs() < 1e-5);
        }
    }
}
