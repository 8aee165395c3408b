//! Joint positions between two poses of a path of the tool, of which only every so many are solved.
//!
//! Each joint follows the cubic through both positions and slopes over the progress along the path. It says nothing of
//! time: an acceleration that jumps between two solved poses leaves no trace in it.

use mcs_model::Joints;

use super::timing::JointState;

/// Between knots as near as this to one another there is nothing but rounding.
const NO_WAY: f64 = 1e-9;

/// A solved pose of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knot {
    /// Progress along the path, 0 to 1.
    pub progress: f64,
    /// Joint positions, rad or m.
    pub position: Joints,
    /// Their derivatives by the progress.
    pub slope: Joints,
}

/// Cubics between two knots.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interpolator {
    from: Knot,
    to: Knot,
}

impl Interpolator {
    /// From one knot to the next.
    #[must_use]
    pub fn new(from: Knot, to: Knot) -> Self {
        Self { from, to }
    }

    /// The knot at the start.
    #[must_use]
    pub fn start(&self) -> &Knot {
        &self.from
    }

    /// The knot at the end.
    #[must_use]
    pub fn end(&self) -> &Knot {
        &self.to
    }

    /// A joint's position, its slope and the slope's slope at some progress.
    #[must_use]
    pub fn at(&self, joint: usize, progress: f64) -> [f64; 3] {
        let h = self.to.progress - self.from.progress;
        let (p0, v0) = (self.from.position[joint], self.from.slope[joint]);
        let (p1, v1) = (self.to.position[joint], self.to.slope[joint]);
        if h <= NO_WAY {
            return [p1, v1, 0.0];
        }
        let t = progress - self.from.progress;
        let (way, x) = (p1 - p0, t / h);
        let square = (3.0 * way - h * (2.0 * v0 + v1)) / (h * h);
        let cube = (h * (v0 + v1) - 2.0 * way) / (h * h);
        [
            p0 + t * (v0 + t * (square + cube * x)),
            v0 + t * (2.0 * square + 3.0 * cube * x),
            2.0 * square + 6.0 * cube * x,
        ]
    }

    /// A joint's state while the tool is `along` the path.
    #[must_use]
    pub fn state(&self, joint: usize, along: JointState) -> JointState {
        let [position, slope, bend] = self.at(joint, along.position);
        JointState {
            position,
            velocity: slope * along.velocity,
            acceleration: bend * along.velocity * along.velocity + slope * along.acceleration,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_cubic_is_reproduced_exactly(
            p in -3.0..3.0_f64, v in -5.0..5.0_f64, a in -20.0..20.0_f64, j in -20.0..20.0_f64, share in 0.0..1.0_f64,
        ) {
            let (start, h) = (0.3, 0.018);
            let cubic = |progress: f64| {
                let t = progress - start;
                [p + t * (v + t * (a / 2.0 + t * j / 6.0)), v + t * (a + t * j / 2.0), a + t * j]
            };
            let knot = |progress: f64| {
                let [position, slope, _] = cubic(progress);
                Knot { progress, position: [position; 6].into(), slope: [slope; 6].into() }
            };
            let found = Interpolator::new(knot(start), knot(start + h)).at(3, start + share * h);
            let expected = cubic(start + share * h);
            prop_assert!((found[0] - expected[0]).abs() < 1e-12);
            prop_assert!((found[1] - expected[1]).abs() < 1e-10);
            prop_assert!((found[2] - expected[2]).abs() < 1e-7);
        }
    }
}
