//! From the disc that a camera on the hand sees to the correction of the gripper: the visual Jacobian (SORMA technical report,
//! section 2.1.4; J. Walter, Rapid Learning in Robotics, 1996, section 8).
//!
//! The gripper stands where it would grip the disc, and is moved from there to the corners of a square. What is seen at each is
//! an example, and a map of 2 x 2 nodes goes through the four of them. It knows neither lens nor place of the camera. A disc that is
//! seen later is completed to the offset of the gripper from it. The radius is one number more than is needed, so the error E tells
//! another disc, or another height, from the one that was taught. Knows numbers only.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::psom::{Psom, Scratch, Search, TrainError};

/// Examples of a map: the corners of a square.
pub const EXAMPLES: usize = 4;

/// Components of a vector of the map: an offset, and what is seen there.
const COMPONENTS: usize = 5;

/// Numbers of a row: the parameters of its node, then its vector.
const ROW: usize = 2 + COMPONENTS;

/// An E up to this is good: one number is spare, and it is 4.5 standard deviations then.
const LARGEST: f64 = 10.0;

/// How far outside the square the gripper may be, as a part of its side.
const REACH: f64 = 0.5;

/// A disc in a picture of the camera on the hand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Column of its middle, px.
    pub u: f64,
    /// Row of its middle, px.
    pub v: f64,
    /// Its radius, px.
    pub radius: f64,
}

/// What was seen from a known place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Example {
    /// Where the gripper was, from where it grips the disc, along two axes of the caller's choice, m.
    pub offset: [f64; 2],
    /// What was seen from there.
    pub seen: Seen,
}

/// The move that takes the gripper to where it grips the disc.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// Along the axes of the examples, m.
    pub by: [f64; 2],
    /// Its standard deviations, m: from the noise of what is seen, now and in the examples.
    pub sd: [f64; 2],
    /// Half the square of what the radius is off from that of the examples, in its standard deviations.
    pub error: f64,
    /// Whether the error is small. If not, this is another disc, another height, or a place far outside the examples; the
    /// correction means nothing then.
    pub good: bool,
}

/// Why there is no map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoMap {
    /// Two of them on the same side of the others.
    #[error(
        "the offsets are no corners of a square: one must be on each side of their middle along both axes"
    )]
    NoSquare,
    /// A standard deviation that is none.
    #[error(
        "the standard deviations of place and radius are {0} and {1} px; both are larger than 0"
    )]
    Sd(f64, f64),
    /// Numbers that are none.
    #[error(transparent)]
    Map(#[from] TrainError),
    /// What is seen does not tell the offset.
    #[error(
        "the disc is seen at one place, or on one line, from all offsets: is it the disc that was looked at?"
    )]
    Unmoved,
}

/// A map from what is seen to the correction.
#[derive(Debug, Clone)]
pub struct VisualJacobian {
    map: Psom,
    scratch: Scratch,
    weights: [f64; COMPONENTS],
    search: Search,
}

impl VisualJacobian {
    /// The map through four examples in any order, whose offsets are about the corners of a square. `sd_px` and `sd_radius_px` are
    /// the standard deviations of a disc's middle and of its radius in a picture.
    ///
    /// # Errors
    /// [`NoMap`] with the reason.
    pub fn train(
        examples: &[Example; EXAMPLES],
        sd_px: f64,
        sd_radius_px: f64,
    ) -> Result<Self, NoMap> {
        let positive = |sd: f64| sd.is_finite() && sd > 0.0;
        if !(positive(sd_px) && positive(sd_radius_px)) {
            return Err(NoMap::Sd(sd_px, sd_radius_px));
        }
        let middle = |axis: usize| examples.iter().map(|one| one.offset[axis]).sum::<f64>() / 4.0;
        let middle = [middle(0), middle(1)];
        let side =
            |one: &Example, axis: usize| f64::from(u8::from(one.offset[axis] > middle[axis]));
        let mut rows = Vec::with_capacity(EXAMPLES * ROW);
        for one in examples {
            rows.extend([side(one, 0), side(one, 1)]);
            rows.extend(one.offset);
            rows.extend([one.seen.u, one.seen.v, one.seen.radius]);
        }
        let map = Psom::train(&rows, ROW, 2).map_err(|why| match why {
            TrainError::Number(_) => NoMap::Map(why),
            _ => NoMap::NoSquare,
        })?;
        let (place, size) = (sd_px.powi(-2), sd_radius_px.powi(-2));
        let weights = [0.0, 0.0, place, place, size];
        // The search begins anew where E is not good: its measure is a share of the spans.
        let spans = map.spans().iter().zip(&weights);
        let whole: f64 = spans.map(|(span, p)| 0.5 * p * span * span).sum();
        let mut found = Self {
            scratch: map.scratch(),
            map,
            weights,
            search: Search {
                restarts: EXAMPLES - 1,
                good: (LARGEST / whole).sqrt(),
                reach: REACH,
                ..Search::default()
            },
        };
        let determined = found.variance(&[0.5, 0.5]);
        determined.map(|_| found).ok_or(NoMap::Unmoved)
    }

    /// The correction for a disc that is seen so; `None` for numbers that are none.
    #[must_use]
    pub fn correction(&mut self, seen: &Seen) -> Option<Correction> {
        let known = [0.0, 0.0, seen.u, seen.v, seen.radius];
        let search = &self.search;
        let found = self
            .map
            .complete(&mut self.scratch, &known, &self.weights, search)
            .ok()?;
        let (error, at) = (found.error, [found.parameters[0], found.parameters[1]]);
        let &[x, y, ..] = found.values else {
            return None;
        };
        let variance = self.variance(&at);
        let sd = variance.map_or([f64::INFINITY; 2], |two| [two.x.sqrt(), two.y.sqrt()]);
        Some(Correction {
            by: [-x, -y],
            sd,
            error,
            good: error <= LARGEST && variance.is_some(),
        })
    }

    /// Where the disc is to be seen when the gripper stands at an offset inside the square; to be looked for there.
    #[must_use]
    pub fn expected(&mut self, offset: [f64; 2]) -> Option<Seen> {
        let known = [offset[0], offset[1], 0.0, 0.0, 0.0];
        let weights = [1.0, 1.0, 0.0, 0.0, 0.0];
        let search = &self.search;
        let found = self
            .map
            .complete(&mut self.scratch, &known, &weights, search);
        match found.ok()?.values {
            &[_, _, u, v, radius] => Some(Seen { u, v, radius }),
            _ => None,
        }
    }

    /// The variances of an offset from the derivatives of the map there; `None` where what is seen does not tell it.
    fn variance(&mut self, at: &[f64; 2]) -> Option<Vector2<f64>> {
        let mut slopes = [0.0; 2 * COMPONENTS];
        self.map.jacobian(&mut self.scratch, at, &mut slopes);
        let slopes = SMatrix::<f64, COMPONENTS, 2>::from_row_slice(&slopes);
        let offset = slopes.fixed_rows::<2>(0).into_owned();
        let seen = slopes.fixed_rows::<3>(2).into_owned();
        let [.., place, _, size] = self.weights;
        let weights = Matrix3::from_diagonal(&Vector3::new(place, place, size));
        let unit: Matrix2<f64> = (seen.transpose() * weights * seen).try_inverse()?;
        // The examples have the noise of pictures, too; each weighs as its node does here.
        let share = |s: f64| s * s + (1.0 - s) * (1.0 - s);
        let own = 1.0 + share(at[0]) * share(at[1]);
        let variance = (offset * unit * offset.transpose() * own).diagonal();
        let sound = variance.iter().all(|one| one.is_finite() && *one > 0.0);
        let largest = self.map.spans().iter().take(2).copied().fold(0.0, f64::max);
        // Less is not told than the whole square.
        (sound && variance.amax().sqrt() < largest).then_some(variance)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Rotation3, UnitQuaternion};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::camera::{Camera, Distortion, Intrinsics};

    const RADIUS: f64 = 0.018;

    /// A disc 0.25 m below a camera that is fixed beside the gripper and tilted, when the gripper is off by so much.
    fn seen(offset: [f64; 2], height: f64) -> Seen {
        let eye = Point3::new(offset[0] + 0.06, offset[1] - 0.01, 0.25 + height);
        let view = Rotation3::face_towards(
            &Vector3::new(-0.2, 0.03, -1.0),
            &Vector3::new(1.0, 0.2, 0.0),
        );
        let camera = Camera {
            rotation: UnitQuaternion::from_rotation_matrix(&view).inverse(),
            centre: eye,
            intrinsics: Intrinsics {
                fx: 410.0,
                fy: 411.0,
                cx: 248.0,
                cy: 250.0,
            },
            distortion: Distortion {
                k1: -0.14,
                k2: 0.03,
                ..Distortion::default()
            },
        };
        let at = camera.project(&Point3::origin()).unwrap();
        let rim = |x: f64, y: f64| (camera.project(&Point3::new(x, y, 0.0)).unwrap() - at).norm();
        let radius = (rim(RADIUS, 0.0) + rim(0.0, RADIUS)) / 2.0;
        Seen {
            u: at.x,
            v: at.y,
            radius,
        }
    }

    fn examples(side: f64) -> [Example; EXAMPLES] {
        let half = side / 2.0;
        [[half, -half], [-half, -half], [-half, half], [half, half]].map(|offset| Example {
            offset,
            seen: seen(offset, 0.0),
        })
    }

    #[test]
    fn inside_the_square_the_gripper_is_corrected_to_a_fifth_of_a_millimetre() {
        let mut map = VisualJacobian::train(&examples(0.03), 0.05, 0.1).unwrap();
        for step in 0..60 {
            let k = f64::from(step);
            let offset = [0.015 * k.sin(), 0.015 * (1.7 * k).cos()];
            let found = map.correction(&seen(offset, 0.0)).unwrap();
            let off = (found.by[0] + offset[0]).hypot(found.by[1] + offset[1]);
            assert!(off < 2e-4 && found.good, "{offset:?}: {found:?}");
        }
        let expected = map.expected([0.0, 0.0]).unwrap();
        let there = seen([0.0, 0.0], 0.0);
        assert!((expected.u - there.u).hypot(expected.v - there.v) < 0.5);
    }

    /// Errors of noisy pictures have the size that is told, noise of the examples included.
    #[test]
    fn the_standard_deviations_are_those_of_the_errors() {
        let (sd_px, sd_radius) = (0.3, 0.3);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut noisy = |mut seen: Seen| {
            let mut drawn = |sd: f64| sd * rng.sample::<f64, _>(StandardNormal);
            seen.u += drawn(sd_px);
            seen.v += drawn(sd_px);
            seen.radius += drawn(sd_radius);
            seen
        };
        let (mut squares, runs) = ([0.0; 2], 400);
        for k in 0..runs {
            let taught = examples(0.03).map(|one| Example {
                seen: noisy(one.seen),
                ..one
            });
            let mut map = VisualJacobian::train(&taught, sd_px, sd_radius).unwrap();
            let offset = [0.012 * f64::from(k).sin(), 0.012 * f64::from(k).cos()];
            let found = map.correction(&noisy(seen(offset, 0.0))).unwrap();
            for (axis, sum) in squares.iter_mut().enumerate() {
                *sum +=
                    ((found.by[axis] + offset[axis]) / found.sd[axis]).powi(2) / f64::from(runs);
            }
        }
        for square in squares {
            assert!((0.85..1.2).contains(&square.sqrt()), "{squares:?}");
        }
    }

    #[test]
    fn another_disc_another_height_and_a_place_far_outside_are_not_good() {
        let mut map = VisualJacobian::train(&examples(0.03), 0.05, 0.1).unwrap();
        let there = seen([0.005, 0.0], 0.0);
        let larger = Seen {
            radius: 1.3 * there.radius,
            ..there
        };
        for wrong in [larger, seen([0.005, 0.0], 0.03), seen([0.08, 0.05], 0.0)] {
            let found = map.correction(&wrong).unwrap();
            assert!(!found.good, "{wrong:?}: {found:?}");
        }
        let none = Seen {
            u: f64::NAN,
            ..there
        };
        assert_eq!(map.correction(&none), None);
    }

    #[test]
    fn examples_that_teach_nothing_are_refused_with_the_reason() {
        let good = examples(0.03);
        let trained =
            |examples: &[Example; EXAMPLES]| VisualJacobian::train(examples, 0.05, 0.1).map(|_| ());
        let mut twice = good;
        twice[1] = twice[0];
        assert_eq!(trained(&twice), Err(NoMap::NoSquare));
        let still = good.map(|one| Example {
            seen: good[0].seen,
            ..one
        });
        assert_eq!(trained(&still), Err(NoMap::Unmoved));
        let mut broken = good;
        broken[2].seen.v = f64::INFINITY;
        assert!(matches!(trained(&broken), Err(NoMap::Map(_))));
        broken[2] = good[2];
        broken[2].offset[0] = f64::NAN;
        assert!(trained(&broken).is_err());
        let sd = VisualJacobian::train(&good, 0.0, 0.1).map(|_| ());
        assert_eq!(sd, Err(NoMap::Sd(0.0, 0.1)));
    }
}
