//! How far solids are from one another: plain functions of numbers.
//!
//! The distance of capsules from capsules and from boxes is exact while they are apart; what is in the other has a
//! distance below zero, which is the more negative the deeper it is, but not by how much. The distance of two boxes is that along the best of
//! their fifteen separating axes (S. Gottschalk and others, SIGGRAPH 1996), which is never more than the true one.
//! The distance of a hull from anything is that of GJK, or a little less; where they touch, the depth is not found.

use mcs::model::{Placement, Solid, hull};
use nalgebra::Vector3;

/// The least distance of two solids, m; below zero where one is in the other.
#[must_use]
pub fn between(one: &Solid, other: &Solid) -> f64 {
    match (one, other) {
        (
            Solid::Capsule { a, b, radius },
            Solid::Capsule {
                a: c,
                b: d,
                radius: thick,
            },
        ) => segments(a, b, c, d) - radius - thick,
        (Solid::Capsule { a, b, radius }, Solid::Block { at, half })
        | (Solid::Block { at, half }, Solid::Capsule { a, b, radius }) => {
            segment_block(a, b, at, half) - radius
        }
        (Solid::Block { at, half }, Solid::Block { at: on, half: size }) => {
            blocks((at, half), (on, size))
        }
        (Solid::Hull { .. }, _) | (_, Solid::Hull { .. }) => {
            let gap = hull::gap(|to| one.farthest(to), |to| other.farthest(to));
            gap - one.rounding() - other.rounding()
        }
    }
}

/// The least distance of two segments, m, after C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9.
#[must_use]
pub fn segments(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>, d: &Vector3<f64>) -> f64 {
    let (along, across, way) = (b - a, d - c, a - c);
    let (length, width) = (along.norm_squared(), across.norm_squared());
    let (ahead, aside) = (along.dot(&way), across.dot(&way));
    let unit = |t: f64| t.clamp(0.0, 1.0);
    let tiny = f64::MIN_POSITIVE;
    let (s, t) = if length <= tiny && width <= tiny {
        (0.0, 0.0)
    } else if length <= tiny {
        (0.0, unit(aside / width))
    } else if width <= tiny {
        (unit(-ahead / length), 0.0)
    } else {
        let mixed = along.dot(&across);
        let denominator = length * width - mixed * mixed;
        let s = match denominator > 1e-12 * length * width {
            true => unit((mixed * aside - ahead * width) / denominator),
            // As good as parallel: any place will do, and the ends are tried below.
            false => 0.0,
        };
        let t = (mixed * s + aside) / width;
        if t < 0.0 {
            (unit(-ahead / length), 0.0)
        } else if t > 1.0 {
            (unit((mixed - ahead) / length), 1.0)
        } else {
            (s, t)
        }
    };
    (way + along * s - across * t).norm()
}

/// The least distance of a segment from a box, m; 0 where it meets the box.
#[must_use]
pub fn segment_block(
    a: &Vector3<f64>,
    b: &Vector3<f64>,
    at: &Placement,
    half: &Vector3<f64>,
) -> f64 {
    let from = at.rotation.tr_mul(&(a - at.origin));
    let way = at.rotation.tr_mul(&(b - a));
    let out = |t: f64| {
        let point = from + way * t;
        Vector3::from_fn(|axis, _| point[axis] - point[axis].clamp(-half[axis], half[axis]))
    };
    // Half the slope of the squared distance: it rises with t, evenly between the places where the segment crosses a
    // face's plane.
    let slope = |t: f64| out(t).dot(&way);
    let (mut low, mut high) = ((0.0, slope(0.0)), (1.0, slope(1.0)));
    if low.1 >= 0.0 {
        return out(0.0).norm();
    }
    if high.1 <= 0.0 {
        return out(1.0).norm();
    }
    for axis in 0..3 {
        for face in [-half[axis], half[axis]] {
            let t = (face - from[axis]) / way[axis];
            // None where the segment runs along the plane.
            if !(t > low.0 && t < high.0) {
                continue;
            }
            let there = slope(t);
            if there <= 0.0 {
                low = (t, there);
            } else {
                high = (t, there);
            }
        }
    }
    let t = low.0 - low.1 * (high.0 - low.0) / (high.1 - low.1);
    out(t).norm()
}

/// A separating distance of two boxes, m: never more than the least distance; below zero when no axis separates them.
#[must_use]
pub fn blocks(
    (one, half): (&Placement, &Vector3<f64>),
    (other, size): (&Placement, &Vector3<f64>),
) -> f64 {
    let way = other.origin - one.origin;
    let gap = |axis: &Vector3<f64>| {
        let reach = |at: &Placement, half: &Vector3<f64>| {
            let along = at.rotation.tr_mul(axis);
            along.abs().dot(half)
        };
        way.dot(axis).abs() - reach(one, half) - reach(other, size)
    };
    let mut best = f64::NEG_INFINITY;
    for place in [one, other] {
        for axis in 0..3 {
            best = best.max(gap(&place.rotation.column(axis).into_owned()));
        }
    }
    for first in 0..3 {
        for second in 0..3 {
            let edges = one
                .rotation
                .column(first)
                .cross(&other.rotation.column(second));
            let length = edges.norm();
            // Edges that are as good as parallel give no axis that the faces do not.
            if length > 1e-6 {
                best = best.max(gap(&(edges / length)));
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Translation3, UnitQuaternion};
    use proptest::prelude::*;
    use rapier3d_f64::parry::{math::Pose, query, shape};

    use super::*;

    fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
        proptest::array::uniform3(-size..size).prop_map(Vector3::from)
    }

    fn capsule() -> impl Strategy<Value = Solid> {
        (vector(1.0), vector(1.0), 0.01..0.2_f64, any::<bool>()).prop_map(
            |(a, b, radius, round)| Solid::Capsule {
                a,
                b: if round { a } else { b },
                radius,
            },
        )
    }

    fn block() -> impl Strategy<Value = Solid> {
        (
            vector(1.0),
            vector(3.0),
            proptest::array::uniform3(0.02..0.5_f64),
        )
            .prop_map(|(origin, rpy, half)| Solid::Block {
                at: Placement::from_radians(origin.into(), rpy.into()),
                half: half.into(),
            })
    }

    fn hull() -> impl Strategy<Value = Solid> {
        let points = proptest::collection::vec(vector(0.4), 8..40);
        (vector(1.0), vector(3.0), points).prop_map(|(origin, rpy, points)| {
            let at = Placement::from_radians(origin.into(), rpy.into());
            Solid::around_points(&at, &points).unwrap()
        })
    }

    /// Of another program: parry, by its own algorithms.
    fn elsewhere(one: &Solid, other: &Solid) -> f64 {
        let made = |solid: &Solid| -> (Pose, Box<dyn shape::Shape>) {
            let pose = |isometry: Isometry3<f64>| -> Pose {
                let (t, r) = (isometry.translation, isometry.rotation);
                Pose::from_parts(
                    [t.x, t.y, t.z].into(),
                    rapier3d_f64::parry::math::Rotation::from_xyzw(r.i, r.j, r.k, r.w),
                )
            };
            match solid {
                Solid::Capsule { a, b, radius } => {
                    let end = |v: &Vector3<f64>| [v.x, v.y, v.z].into();
                    let none = Isometry3::identity();
                    (
                        pose(none),
                        Box::new(shape::Capsule::new(end(a), end(b), *radius)),
                    )
                }
                Solid::Block { at, half } => (
                    pose(at.isometry()),
                    Box::new(shape::Cuboid::new([half.x, half.y, half.z].into())),
                ),
                Solid::Hull { at, hull } => {
                    let corners = hull.corners().iter().map(|v| [v.x, v.y, v.z].into());
                    let corners: Vec<_> = corners.collect();
                    let form = shape::ConvexPolyhedron::from_convex_hull(&corners);
                    (pose(at.isometry()), Box::new(form.unwrap()))
                }
            }
        };
        let ((pose1, shape1), (pose2, shape2)) = (made(one), made(other));
        query::distance(&pose1, &*shape1, &pose2, &*shape2)
            .unwrap()
            .distance
    }

    proptest! {
        #[test]
        fn capsules_are_as_far_from_one_another_as_another_program_says(one in capsule(), other in capsule()) {
            let (found, expected) = (between(&one, &other), elsewhere(&one, &other));
            prop_assert!((found.max(0.0) - expected).abs() < 1e-5, "{} {}", found, expected);
        }

        #[test]
        fn a_capsule_is_as_far_from_a_box_as_another_program_says(one in capsule(), other in block()) {
            let (found, expected) = (between(&one, &other), elsewhere(&one, &other));
            prop_assert!((found.max(0.0) - expected).abs() < 1e-5, "{} {}", found, expected);
        }

        #[test]
        fn boxes_are_never_nearer_than_found_and_never_apart_when_they_touch(one in block(), other in block()) {
            let (found, expected) = (between(&one, &other), elsewhere(&one, &other));
            prop_assert!(found <= expected + 1e-6, "{} {}", found, expected);
            prop_assert!(expected > 1e-9 || found <= 1e-9, "{} {}", found, expected);
            prop_assert!(expected < 1e-6 || found > 0.0, "{} {}", found, expected);
        }

        #[test]
        fn a_hull_is_as_far_from_anything_as_another_program_says(
            one in hull(),
            other in prop_oneof![capsule(), block(), hull()],
        ) {
            let expected = elsewhere(&one, &other);
            // The other program's hulls have the corners alone.
            let rounding = [&one, &other].map(|solid| match solid {
                Solid::Hull { hull, .. } => hull.rounding(),
                _ => 0.0,
            });
            let found = between(&one, &other) + rounding[0] + rounding[1];
            prop_assert!((found.max(0.0) - expected).abs() < 1e-5, "{} {}", found, expected);
        }

        #[test]
        fn a_distance_is_the_same_both_ways_and_wherever_both_are_moved(
            one in prop_oneof![capsule(), block(), hull()],
            other in prop_oneof![capsule(), block(), hull()],
            by in vector(2.0),
            turn in vector(3.0),
        ) {
            let moved = Placement::from(&Isometry3::from_parts(
                Translation3::from(by),
                UnitQuaternion::from_scaled_axis(turn),
            ));
            let there = between(&one.seen_from(&moved), &other.seen_from(&moved));
            let here = between(&one, &other);
            prop_assert!((here - there).abs() < 1e-9);
            prop_assert!((here - between(&other, &one)).abs() < 1e-9);
        }

        #[test]
        fn a_segment_is_no_farther_from_a_box_than_any_of_its_points(a in vector(1.0), b in vector(1.0), other in block(), t in 0.0..1.0_f64) {
            let Solid::Block { at, half } = other else { unreachable!() };
            let point = a + (b - a) * t;
            let least = segment_block(&a, &b, &at, &half);
            prop_assert!(least <= segment_block(&point, &point, &at, &half) + 1e-12);
        }
    }
}
