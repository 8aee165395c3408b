//! The outer form of the arm and of the room: one list, used both by the physics (as colliders) and
//! by the cameras (as pictures).

use nalgebra::{Point3, Vector3};

use crate::puma560::JOINTS;

/// A solid in the frame it is attached to, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// All points within `radius` of the segment from `a` to `b`; a ball when they are equal.
    Capsule {
        /// One end of the axis.
        a: Point3<f64>,
        /// The other end.
        b: Point3<f64>,
        /// Radius, m.
        radius: f64,
    },
    /// A box along the frame's axes.
    Block {
        /// Its centre.
        centre: Point3<f64>,
        /// Half its edge lengths.
        half: Vector3<f64>,
    },
}

/// A solid with the grey it reflects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Its form.
    pub solid: Solid,
    /// Grey level when lit from straight above, 0 to 255.
    pub grey: f64,
}

/// A shape of the arm and the link whose frame it is given in (0 is the base, which never moves).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmShape {
    /// Link number, 0 to 6.
    pub link: usize,
    /// The shape in the link's frame.
    pub shape: Shape,
}

/// The outer form of a PUMA 560 with a lamp at `lamp` (m, frame 6) of `lamp_radius` on a thin rod.
///
/// The dimensions are ours, after the link lengths and offsets of the arm: the upper arm passes
/// beside the shoulder axis, the forearm comes back by part of that offset.
/// The parts near the lamp are painted like the floor: an edge behind the lamp's spot pulls at its
/// measured centre (by up to 0.1 px even so).
#[must_use]
pub fn arm(lamp: &Point3<f64>, lamp_radius: f64) -> Vec<ArmShape> {
    let mut shapes = vec![
        capsule(0, [0.0, 0.0, 0.05], [0.0, 0.0, 0.56], 0.09, 38.0),
        capsule(1, [0.0, 0.0, -0.06], [0.0, 0.0, 0.13], 0.085, 44.0),
        capsule(2, [-0.56, 0.0, 0.235], [-0.4318, 0.0, 0.235], 0.075, 38.0),
        capsule(2, [-0.4318, 0.0, 0.235], [0.0, 0.0, 0.235], 0.062, 42.0),
        capsule(2, [0.0, 0.0, 0.20], [0.0, 0.0, 0.15], 0.058, 38.0),
        capsule(3, [-0.0203, 0.0, -0.04], [-0.0203, 0.0, 0.20], 0.055, 28.0),
        capsule(3, [-0.0203, 0.0, 0.20], [-0.0203, 0.0, 0.37], 0.045, 24.0),
        capsule(4, [0.0, -0.03, 0.0], [0.0, 0.03, 0.0], 0.042, 24.0),
        capsule(6, [0.0, 0.0, 0.0], [0.0, 0.0, 0.04], 0.028, 24.0),
    ];
    // The rod ends where the lamp begins; from the side it hides nothing of it.
    let flange = Point3::new(0.0, 0.0, 0.05625);
    let rod = lamp - flange;
    let length = rod.norm() - lamp_radius - ROD_RADIUS;
    if length > 0.0 {
        let end = flange + rod.normalize() * length;
        shapes.push(ArmShape {
            link: JOINTS,
            shape: Shape {
                solid: Solid::Capsule {
                    a: flange,
                    b: end,
                    radius: ROD_RADIUS,
                },
                grey: 24.0,
            },
        });
    }
    shapes
}

/// Radius of the rod that carries the lamp, m.
const ROD_RADIUS: f64 = 0.004;

fn capsule(link: usize, a: [f64; 3], b: [f64; 3], radius: f64, grey: f64) -> ArmShape {
    ArmShape {
        link,
        shape: Shape {
            solid: Solid::Capsule {
                a: a.into(),
                b: b.into(),
                radius,
            },
            grey,
        },
    }
}
