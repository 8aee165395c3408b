//! The PUMA 560 of `mcs::model`, seen as the physics needs it: one joint with its link, all values at the
//! joint side of the gear.
//!
//! The numbers and their sources are in `configs/models/puma560.toml`: the simulated arm and the model that
//! the controller compensates with are the same, as long as nobody changes one of them on purpose.

use std::sync::LazyLock;

use mcs::model::{Joint, Model, built_in, file::Inertias};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

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
    pub centre: Point3<f64>,
    /// Inertia tensor about the centre of mass, axes of the link's frame, kg m^2.
    pub inertia: Matrix3<f64>,
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

/// The six links, base first. Base frame: world, z up, the floor under the shoulder at z = 0.
#[must_use]
pub fn links() -> [Link; JOINTS] {
    static LINKS: LazyLock<[Link; JOINTS]> = LazyLock::new(read);
    *LINKS
}

fn read() -> [Link; JOINTS] {
    // The tests of `mcs` hold that its file is a model of six joints.
    let model = built_in::model("puma560", Inertias::Engine).and_then(Result::ok);
    std::array::from_fn(|index| {
        let link = |model: &Model| {
            let frame = model.at(model.frame(&format!("link{}", index + 1))?);
            Some((frame.placement, model.joints().get(index)?.clone()))
        };
        let Some((frame, joint)) = model.as_ref().and_then(link) else {
            unreachable!("the built-in PUMA 560 has six joints with their links");
        };
        let Joint {
            body,
            motor,
            limits,
            ..
        } = joint;
        let body = body.seen_from(&frame.inverse());
        let gear = motor.gear_ratio.abs();
        let friction = motor.friction;
        Link {
            d: frame.origin.z,
            a: frame.origin.x,
            alpha: frame.rotation[(2, 1)].atan2(frame.rotation[(2, 2)]),
            limits: [limits.lower, limits.upper],
            mass: body.mass,
            centre: body.centre.into(),
            inertia: body.inertia,
            rotor_inertia: motor.reflected_inertia(),
            viscous: friction.viscous * gear * gear,
            coulomb: [friction.coulomb_forward, -friction.coulomb_backward]
                .map(|torque| torque * gear),
            max_torque: limits.torque,
        }
    })
}

/// The poses of the base frame and of the six link frames in the world, `world_T_link`.
#[must_use]
pub fn link_poses(joints: &[f64; JOINTS]) -> [Isometry3<f64>; JOINTS + 1] {
    let mut poses = [Isometry3::identity(); JOINTS + 1];
    let mut pose = Isometry3::identity();
    for ((link, q), out) in links().iter().zip(joints).zip(poses.iter_mut().skip(1)) {
        pose *= link.pose(*q);
        *out = pose;
    }
    poses
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
    fn the_values_at_the_joints_are_the_published_products() {
        let rotor = [0.78403, 2.32481, 0.57687, 0.19079, 0.17071, 0.19406];
        for (link, value) in links().iter().zip(rotor) {
            assert!((link.rotor_inertia - value).abs() < 1e-5);
        }
        // Joint 1: 62.6111 * (0.395, 0.435) N m and 62.6111^2 * 1.48e-3 N m s/rad.
        let [first, ..] = links();
        assert!((first.coulomb[0] - 24.7314).abs() < 1e-4);
        assert!((first.coulomb[1] - 27.2358).abs() < 1e-4);
        assert!((first.viscous - 5.80182).abs() < 1e-4);
    }
}
