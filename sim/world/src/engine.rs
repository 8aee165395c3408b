//! Words of the physics engine for ours: vectors, poses, shapes.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::{
    geometry::SharedShape,
    math::{Pose, Rotation, Vector},
};

use crate::shapes::Solid;

/// Free fall, m/s^2.
pub const GRAVITY: f64 = 9.81;

pub fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub fn ours(v: Vector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

pub fn pose(isometry: &Isometry3<f64>) -> Pose {
    let q = isometry.rotation.quaternion();
    Pose::from_parts(
        vector(&isometry.translation.vector),
        Rotation::from_xyzw(q.i, q.j, q.k, q.w),
    )
}

pub fn isometry(pose: &Pose) -> Isometry3<f64> {
    let (r, t) = (pose.rotation, pose.translation);
    Isometry3::from_parts(
        Translation3::new(t.x, t.y, t.z),
        UnitQuaternion::new_normalize(Quaternion::new(r.w, r.x, r.y, r.z)),
    )
}

/// The solid as a shape, and where its frame stands in the solid's.
pub fn shape(solid: &Solid) -> (SharedShape, Isometry3<f64>) {
    match solid {
        Solid::Capsule { a, b, radius } => {
            let (a, b) = (vector(&a.coords), vector(&b.coords));
            let shape = if a == b {
                return (SharedShape::ball(*radius), at(&Point3::new(a.x, a.y, a.z)));
            } else {
                SharedShape::capsule(a, b, *radius)
            };
            (shape, Isometry3::identity())
        }
        Solid::Block { centre, half } => (SharedShape::cuboid(half.x, half.y, half.z), at(centre)),
        Solid::Cylinder { half, radius } => {
            // The engine's stands along y.
            let turn =
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
            (
                SharedShape::cylinder(*half, *radius),
                Isometry3::from_parts(Translation3::identity(), turn),
            )
        }
        Solid::Disc {
            centre,
            normal,
            radius,
        } => {
            let turn = UnitQuaternion::rotation_between(&Vector3::y(), normal);
            let turn = turn.unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
            });
            (
                SharedShape::cylinder(THINNEST, *radius),
                Isometry3::from_parts(centre.coords.into(), turn),
            )
        }
    }
}

/// Half the thickness of what has none, m.
const THINNEST: f64 = 1e-4;

fn at(point: &Point3<f64>) -> Isometry3<f64> {
    Translation3::from(point.coords).into()
}

/// The floor of the room: its upper side is z = 0.
pub const FLOOR: Solid = Solid::Block {
    centre: Point3::new(0.0, 0.0, -0.5),
    half: Vector3::new(5.0, 5.0, 0.5),
};
