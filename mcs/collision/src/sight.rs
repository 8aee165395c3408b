//! What the guard sees, for viewers: which two solids are nearest, and where. Computed when somebody looks, apart from the servo.

use std::sync::Arc;

use mcs::guard::{Line, Nearest, Neighbour, Sight};
use mcs::model::Solid;
use nalgebra::Vector3;

use crate::distance::between;
use crate::guard::Findings;
use crate::scene::Scene;

/// Steps after which two points are as near as a drawing needs.
const STEPS: usize = 500;
/// A step that brings them no nearer than this is the last, m.
const FINE: f64 = 1e-9;

/// The arms and the room of one guard, and what it finds.
#[derive(Debug)]
pub(crate) struct Seen {
    pub(crate) scene: Scene,
    pub(crate) others: Vec<Neighbour>,
    pub(crate) findings: Arc<Findings>,
    pub(crate) margin: f64,
}

impl Sight for Seen {
    fn margin(&self) -> f64 {
        self.margin
    }

    fn nearest(&self, q: &[f64]) -> Option<Nearest> {
        let (pair, _) = self.findings.read().nearest?;
        let others: Vec<_> = self.others.iter().map(|arm| arm.read().position).collect();
        let others = others.iter().map(|position| &position[..]);
        let positions: Vec<&[f64]> = std::iter::once(q).chain(others).collect();
        let [one, other] = self.scene.solids(pair, &positions)?;
        Some(Nearest {
            names: self.findings.names.get(pair)?.clone(),
            distance: between(&one, &other),
            ends: ends(&one, &other),
        })
    }
}

/// The nearest points of two solids, m; none of hulls, and of what is in the other. From a point of one to the nearest of the
/// other and back, again and again (W. Cheney and A. Goldstein, Proceedings of the AMS 10, 1959).
#[must_use]
pub fn ends(one: &Solid, other: &Solid) -> Option<Line> {
    let ((mut here, _), mut apart) = (one.ball(), f64::INFINITY);
    let mut there = here;
    for _ in 0..STEPS {
        there = nearest_of(other, &here)?;
        here = nearest_of(one, &there)?;
        let now = (here - there).norm();
        if apart - now < FINE {
            break;
        }
        apart = now;
    }
    let way = there - here;
    let length = way.norm();
    let [thick, thin] = [radius(one), radius(other)];
    if length <= thick + thin {
        return None;
    }
    let on = way / length;
    Some([(here + on * thick).into(), (there - on * thin).into()])
}

/// How thick a solid is about what [`nearest_of`] goes by, m.
fn radius(solid: &Solid) -> f64 {
    match solid {
        Solid::Capsule { radius, .. } => *radius,
        Solid::Block { .. } | Solid::Hull { .. } => 0.0,
    }
}

/// The point of a box, or of the axis of a capsule, that is nearest to another.
fn nearest_of(solid: &Solid, point: &Vector3<f64>) -> Option<Vector3<f64>> {
    match solid {
        Solid::Capsule { a, b, .. } => {
            let way = b - a;
            let length = way.norm_squared();
            let share = (point - a).dot(&way) / length.max(f64::MIN_POSITIVE);
            Some(a + way * share.clamp(0.0, 1.0))
        }
        Solid::Block { at, half } => {
            let within = at.rotation.tr_mul(&(point - at.origin));
            let inside = within.zip_map(half, |along, half| along.clamp(-half, half));
            Some(at.point(&inside))
        }
        Solid::Hull { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use mcs::model::Placement;
    use proptest::prelude::*;

    use super::*;

    fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
        proptest::array::uniform3(-size..size).prop_map(Vector3::from)
    }

    fn solid() -> impl Strategy<Value = Solid> {
        let capsule = (vector(1.0), vector(1.0), 0.01..0.2_f64);
        let half = proptest::array::uniform3(0.02..0.5_f64);
        prop_oneof![
            capsule.prop_map(|(a, b, radius)| Solid::Capsule { a, b, radius }),
            (vector(1.0), vector(3.0), half).prop_map(|(origin, rpy, half)| Solid::Block {
                at: Placement::from_radians(origin.into(), rpy.into()),
                half: half.into(),
            }),
        ]
    }

    /// How far a point is from a solid, m.
    fn off(solid: &Solid, point: [f64; 3]) -> f64 {
        between(solid, &Solid::sphere(point.into(), 0.0))
    }

    proptest! {
        #[test]
        fn the_nearest_points_lie_on_both_solids_and_are_as_far_apart_as_these(
            one in solid(), other in solid()
        ) {
            let apart = between(&one, &other);
            match ends(&one, &other) {
                Some([here, there]) => {
                    prop_assert!(off(&one, here).abs() < 1e-6 && off(&other, there).abs() < 1e-6);
                    let far = (Vector3::from(there) - Vector3::from(here)).norm();
                    // That of two boxes is at most the true one.
                    prop_assert!(far > apart - 1e-6);
                    let boxes = matches!((&one, &other), (Solid::Block { .. }, Solid::Block { .. }));
                    prop_assert!(boxes || far < apart + 2e-3, "{far} for {apart}");
                }
                None => prop_assert!(apart < 1e-3, "{apart}"),
            }
        }
    }
}
