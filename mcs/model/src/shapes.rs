//! What an arm looks like to whoever must not run into it: capsules, boxes and hulls on its links. Pure data.

use std::sync::Arc;

use nalgebra::Vector3;

use super::features::FrameId;
use super::hull::{Hull, farthest};
use super::placement::Placement;

/// A solid in some frame, m.
#[derive(Debug, Clone, PartialEq)]
pub enum Solid {
    /// All points within `radius` of the segment from `a` to `b`; a sphere when they are equal.
    Capsule {
        /// One end of the axis, m.
        a: Vector3<f64>,
        /// The other end, m.
        b: Vector3<f64>,
        /// Radius, m.
        radius: f64,
    },
    /// A box.
    Block {
        /// Its centre, and its edges as axes.
        at: Placement,
        /// Half its edge lengths, m.
        half: Vector3<f64>,
    },
    /// What holds the points of a mesh.
    Hull {
        /// Its middle and its axes.
        at: Placement,
        /// Its corners about them.
        hull: Arc<Hull>,
    },
}

impl Solid {
    /// A sphere, m.
    #[must_use]
    pub fn sphere(centre: Vector3<f64>, radius: f64) -> Self {
        Self::Capsule {
            a: centre,
            b: centre,
            radius,
        }
    }

    /// What holds a cylinder about the z axis of the frame at `at`, m: a capsule around it; of one that is wider than
    /// high, whose capsule would be mostly air, a box.
    #[must_use]
    pub fn around_cylinder(at: &Placement, radius: f64, length: f64) -> Self {
        if length < 2.0 * radius {
            let half = Vector3::new(radius, radius, 0.5 * length);
            return Self::Block { at: *at, half };
        }
        let end = |z: f64| at.point(&Vector3::new(0.0, 0.0, z));
        Self::Capsule {
            a: end(-0.5 * length),
            b: end(0.5 * length),
            radius,
        }
    }

    /// The same solid seen from the frame in which its own frame stands at `placement`.
    #[must_use]
    pub fn seen_from(&self, placement: &Placement) -> Self {
        match self {
            Self::Capsule { a, b, radius } => Self::Capsule {
                a: placement.point(a),
                b: placement.point(b),
                radius: *radius,
            },
            Self::Block { at, half } => Self::Block {
                at: placement.then(at),
                half: *half,
            },
            Self::Hull { at, hull } => Self::Hull {
                at: placement.then(at),
                hull: Arc::clone(hull),
            },
        }
    }

    /// A hull around these points (m) in the frame at `at`; `None` as [`Hull::around`].
    #[must_use]
    pub fn around_points(at: &Placement, points: &[Vector3<f64>]) -> Option<Self> {
        let (middle, hull) = Hull::around(points)?;
        let [x, y, z] = middle.into();
        Some(Self::Hull {
            at: at.then(&Placement::shifted(x, y, z)),
            hull: Arc::new(hull),
        })
    }

    /// The farthest point in a direction of what remains of it without its [rounding](Self::rounding), m.
    #[must_use]
    pub fn farthest(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Capsule { a, b, .. } => farthest(&[*a, *b], direction),
            Self::Block { at, half } => {
                let own = at.rotation.tr_mul(direction);
                at.point(&half.zip_map(&own, f64::copysign))
            }
            Self::Hull { at, hull } => {
                at.point(&farthest(hull.corners(), &at.rotation.tr_mul(direction)))
            }
        }
    }

    /// How far it goes beyond its axis, or beyond its corners, m.
    #[must_use]
    pub fn rounding(&self) -> f64 {
        match self {
            Self::Capsule { radius, .. } => *radius,
            Self::Block { .. } => 0.0,
            Self::Hull { hull, .. } => hull.rounding(),
        }
    }

    /// The centre and the radius (m) of a sphere that holds it.
    #[must_use]
    pub fn ball(&self) -> (Vector3<f64>, f64) {
        match self {
            Self::Capsule { a, b, radius } => ((a + b) * 0.5, (b - a).norm() * 0.5 + radius),
            Self::Block { at, half } => (at.origin, half.norm()),
            Self::Hull { at, hull } => (at.origin, hull.radius()),
        }
    }

    /// How far its farthest point is from the origin of its frame at most, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        match self {
            Self::Capsule { a, b, radius } => a.norm().max(b.norm()) + radius,
            Self::Block { at, half } => at.origin.norm() + half.norm(),
            Self::Hull { at, hull } => at.origin.norm() + hull.radius(),
        }
    }

    /// What is wrong with its numbers, if anything: radii and edges are above zero, and all is finite.
    pub(super) fn fault(&self) -> Option<SolidFault> {
        let (finite, sizes) = match self {
            Self::Capsule { a, b, radius } => {
                let mut ends = a.iter().chain(b);
                (ends.all(|number| number.is_finite()), [*radius; 3])
            }
            Self::Block { at, half } => (at.is_finite(), [half.x, half.y, half.z]),
            // A mesh may be flat.
            Self::Hull { at, hull } => (at.is_finite(), [1.0_f64.max(hull.radius()); 3]),
        };
        if !finite || sizes.iter().any(|size| !size.is_finite()) {
            return Some(SolidFault::NotFinite);
        }
        let small = sizes.into_iter().find(|size| *size <= 0.0)?;
        Some(match self {
            Self::Capsule { .. } => SolidFault::Size("radius", small),
            Self::Block { .. } | Self::Hull { .. } => SolidFault::Size("edge", 2.0 * small),
        })
    }
}

/// Why numbers make no solid.
pub(super) enum SolidFault {
    NotFinite,
    /// Which size, and its value, m.
    Size(&'static str, f64),
}

/// A solid that is part of an arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// The link whose form it is part of.
    pub frame: FrameId,
    /// The joint that carries it, by index; `None` when it stands on the ground.
    pub carrier: Option<usize>,
    /// Its form in the frame of that joint, or in the base frame.
    pub solid: Solid,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cylinder_is_inside_of_what_is_put_around_it() {
        let at = Placement::from_radians([0.1, -0.2, 0.3], [0.3, 0.4, -0.5]);
        for (radius, length) in [(0.1, 0.5), (0.1, 0.2), (0.3, 0.05)] {
            let solid = Solid::around_cylinder(&at, radius, length);
            for step in 0..16 {
                let (sin, cos) = (f64::from(step) * 0.4).sin_cos();
                for z in [-0.5 * length, 0.5 * length] {
                    let rim = at.point(&Vector3::new(radius * cos, radius * sin, z));
                    let out = match solid {
                        Solid::Capsule { a, b, radius } => {
                            let way = b - a;
                            let along = (rim - a).dot(&way) / way.norm_squared();
                            (a + way * along.clamp(0.0, 1.0) - rim).norm() - radius
                        }
                        Solid::Block { at, half } => {
                            let inside = at.inverse().point(&rim).abs() - half;
                            inside.max()
                        }
                        Solid::Hull { .. } => f64::INFINITY,
                    };
                    assert!(out < 1e-12, "{radius} {length}: {out}");
                }
            }
        }
    }

    #[test]
    fn a_solid_seen_from_elsewhere_keeps_its_ball() {
        let placement = Placement::from_radians([0.3, 1.0, -0.4], [1.0, -0.2, 0.7]);
        let block = Solid::Block {
            at: Placement::shifted(0.1, 0.0, 0.0),
            half: Vector3::new(0.1, 0.2, 0.3),
        };
        let points = [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::zeros()];
        let hull = Solid::around_points(&Placement::shifted(0.3, 0.2, 0.1), &points).unwrap();
        for solid in [Solid::sphere(Vector3::x(), 0.2), block, hull] {
            let (centre, radius) = solid.ball();
            let (seen, same) = solid.seen_from(&placement).ball();
            assert!((placement.point(&centre) - seen).norm() < 1e-12);
            assert!((radius - same).abs() < 1e-12);
        }
    }
}
