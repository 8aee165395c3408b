//! From the blob of a ball to the place of the ball: a map of 3 x 3 x 3 examples (SORMA technical report, section 2.2.4; J.
//! Walter, Rapid Learning in Robotics, 1996, section 9).
//!
//! The ball is taken to 27 places before the camera, and its blob is noted at each. The map through these knows the lens, the
//! ball's size, and that its picture is an ellipse off its centre, without being told. The radius tells the depth. A blob has
//! two radii, which agree for a whole ball: so there is one number more than unknowns, and E tells a covered ball from a whole
//! one. Units are the caller's: m and px.

use nalgebra::Point3;

use crate::{
    components::Component,
    psom::{Psom, Scratch, Search, TrainError, Unknown},
};

/// Nodes along each axis.
const SIDE: usize = 3;

/// Examples of a map.
pub const EXAMPLES: usize = SIDE * SIDE * SIDE;

/// Components of a vector of the map: a place and a blob.
const COMPONENTS: usize = 7;

/// Numbers of a row: the parameters of its node, then its vector.
const ROW: usize = 3 + COMPONENTS;

/// So far beyond the examples a place is still told, in spans of them: half a span out it is right to a few hundredths of its
/// distance. Who goes there sees the ball nearer, and more exactly, next time.
const BEYOND: f64 = 0.5;

/// What is seen of a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Column of the centroid, px.
    pub u: f64,
    /// Row of the centroid, px.
    pub v: f64,
    /// Radius of a disc with the same area, px.
    pub radius: f64,
    /// Radius of a disc with the same second moments, px.
    pub spread: f64,
}

impl Seen {
    /// Of a blob.
    #[must_use]
    pub fn of(blob: &Component) -> Self {
        let (u, v) = blob.centroid();
        let moments = blob.moments();
        Self {
            u,
            v,
            radius: (blob.area as f64 / std::f64::consts::PI).sqrt(),
            // Of a disc the mean of du^2 and of dv^2 is a quarter of the square of its radius.
            spread: (2.0 * (moments.uu + moments.vv)).sqrt(),
        }
    }

    fn numbers(&self) -> [f64; 4] {
        [self.u, self.v, self.radius, self.spread]
    }
}

/// Where a ball is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Located {
    /// Its place, m.
    pub place: Point3<f64>,
    /// E: half the sum of the squares of what the map's own blob there is off, each by its standard deviation.
    pub error: f64,
    /// Whether E is no larger than the map was made to allow. If it is, the ball is covered, the blob is no ball, or it is far outside
    /// of the examples; the place means nothing then.
    pub good: bool,
}

/// A map from blobs to places.
#[derive(Debug, Clone)]
pub struct TargetMap {
    map: Psom,
    scratch: Scratch,
    weights: [f64; COMPONENTS],
    search: Search,
    largest: f64,
}

impl TargetMap {
    /// The map through 27 examples on a grid, in its order: the last coordinate changes with each, the first one after nine. They
    /// may stand a little beside their nodes: what counts is where they were. `sd` are the standard deviations of what is
    /// seen, px; an E above `largest` is not good.
    ///
    /// # Errors
    /// A number that is none, or two places where one should be.
    pub fn train(
        examples: &[(Point3<f64>, Seen); EXAMPLES],
        sd: &Seen,
        largest: f64,
    ) -> Result<Self, TrainError> {
        let mut rows = [0.0; EXAMPLES * ROW];
        for (index, (row, (place, seen))) in rows.chunks_mut(ROW).zip(examples).enumerate() {
            let node = [index / (SIDE * SIDE), index / SIDE % SIDE, index % SIDE];
            let numbers = node.into_iter().map(|node| node as f64);
            let numbers = numbers.chain(place.iter().copied());
            for (to, number) in row.iter_mut().zip(numbers.chain(seen.numbers())) {
                *to = number;
            }
        }
        let map = Psom::train(&rows, ROW, SIDE)?;
        let mut weights = [0.0; COMPONENTS];
        for (weight, sd) in weights.iter_mut().skip(3).zip(sd.numbers()) {
            *weight = 1.0 / (sd * sd);
        }
        // The search begins anew where E is not good: its measure is a share of the spans.
        let spans = map.spans().iter().zip(&weights);
        let whole: f64 = spans.map(|(span, p)| 0.5 * p * span * span).sum();
        Ok(Self {
            scratch: map.scratch(),
            map,
            weights,
            search: Search {
                restarts: 1,
                good: (largest / whole).sqrt(),
                reach: BEYOND,
                ..Search::default()
            },
            largest,
        })
    }

    /// Where the ball is that is seen so. Allocates nothing.
    ///
    /// # Errors
    /// A number that is none.
    pub fn locate(&mut self, seen: &Seen) -> Result<Located, Unknown> {
        let mut known = [0.0; COMPONENTS];
        for (known, number) in known.iter_mut().skip(3).zip(seen.numbers()) {
            *known = number;
        }
        let search = &self.search;
        let found = self
            .map
            .complete(&mut self.scratch, &known, &self.weights, search)?;
        let mut place = Point3::origin();
        for (to, number) in place.iter_mut().zip(found.values) {
            *to = *number;
        }
        Ok(Located {
            place,
            error: found.error,
            good: found.error <= self.largest,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of 3 cm radius as a camera at the origin sees it that looks along z, f = 800 px.
    fn seen(place: &Point3<f64>) -> Seen {
        let radius = 800.0 * 0.03 / place.z;
        Seen {
            u: 320.0 + 800.0 * place.x / place.z,
            v: 240.0 + 800.0 * place.y / place.z,
            radius,
            spread: radius,
        }
    }

    const SD: Seen = Seen {
        u: 0.03,
        v: 0.03,
        radius: 0.03,
        spread: 0.03,
    };

    fn trained() -> TargetMap {
        let examples = std::array::from_fn(|index| {
            let node = |index: usize| index as f64 - 1.0;
            let place = Point3::new(
                0.15 * node(index / 9),
                0.1 * node(index / 3 % 3),
                1.0 + 0.1 * node(index % 3),
            );
            (place, seen(&place))
        });
        TargetMap::train(&examples, &SD, 10.0).unwrap()
    }

    #[test]
    fn a_ball_between_the_examples_is_located_within_a_millimetre() {
        let mut map = trained();
        for step in 0..50 {
            let k = f64::from(step);
            let place = Point3::new(
                0.14 * k.sin(),
                0.09 * (1.7 * k).cos(),
                1.0 + 0.08 * (2.3 * k).sin(),
            );
            let found = map.locate(&seen(&place)).unwrap();
            let off = (found.place - place).norm();
            assert!(off < 1e-3 && found.good, "{place}: {found:?}");
        }
    }

    #[test]
    fn a_ball_a_little_outside_of_the_examples_is_located_by_those() {
        let mut map = trained();
        for (x, y) in [(0.25, 0.0), (-0.25, 0.16), (0.0, -0.18), (0.22, 0.15)] {
            let place = Point3::new(x, y, 1.05);
            let found = map.locate(&seen(&place)).unwrap();
            let off = (found.place - place).norm();
            assert!(off < 0.01 && found.good, "{place}: {found:?}");
        }
    }

    #[test]
    fn what_is_no_whole_ball_in_the_work_space_has_a_large_error() {
        let mut map = trained();
        let whole = seen(&Point3::new(0.05, -0.03, 1.02));
        assert!(map.locate(&whole).unwrap().good);
        // A third of it covered: the area is less, and the moments are less by another share.
        let covered = Seen {
            radius: whole.radius * 0.816,
            spread: whole.spread * 0.87,
            ..whole
        };
        // Another ball, twice as large.
        let other = Seen {
            radius: 2.0 * whole.radius,
            spread: 2.0 * whole.spread,
            ..whole
        };
        // A stick.
        let stick = Seen {
            spread: 1.6 * whole.radius,
            ..whole
        };
        let far = Seen {
            u: whole.u + 400.0,
            ..whole
        };
        for wrong in [covered, other, stick, far] {
            let found = map.locate(&wrong).unwrap();
            assert!(!found.good && found.error > 100.0, "{wrong:?}: {found:?}");
        }
        let none = Seen {
            u: f64::NAN,
            ..whole
        };
        assert!(map.locate(&none).is_err());
    }

    #[test]
    fn locating_allocates_nothing() {
        let mut map = trained();
        let all = [
            seen(&Point3::new(0.05, -0.03, 1.02)),
            Seen {
                u: 900.0,
                ..seen(&Point3::new(0.0, 0.0, 0.9))
            },
        ];
        let allocated = allocation_counter::measure(|| {
            for seen in &all {
                std::hint::black_box(map.locate(seen)).unwrap();
            }
        });
        assert_eq!(allocated.count_total, 0);
    }
}
