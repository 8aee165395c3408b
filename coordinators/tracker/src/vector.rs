//! What a force, or a 3-D mouse, says: a low-pass, and a piecewise linear squashing of the length, the same in every direction (SORMA
//! technical report, section 2.2.7). Knows no tasks.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use serde::Deserialize;

/// How a vector is filtered.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VectorArgs {
    /// Corner of the low-pass, Hz.
    pub low_pass_hz: f64,
    /// Shorter vectors count as none, in their unit.
    pub null_radius: f64,
    /// What a unit beyond that becomes.
    pub scale: f64,
    /// The longest that comes out.
    pub clip: f64,
}

impl VectorArgs {
    /// The first number that cannot be, by its key.
    #[must_use]
    pub fn wrong(&self) -> Option<(&'static str, f64)> {
        let all = [
            ("low_pass_hz", self.low_pass_hz, f64::MIN_POSITIVE),
            ("null_radius", self.null_radius, 0.0),
            ("scale", self.scale, 0.0),
            ("clip", self.clip, 0.0),
        ];
        let wrong = |(_, value, least): &(_, f64, f64)| !(*value >= *least && *value <= 1e6);
        let found = all.into_iter().find(wrong);
        found.map(|(key, value, _)| (key, value))
    }
}

/// A filter of a vector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VectorFilter {
    args: VectorArgs,
    smooth: Vector3<f64>,
}

impl VectorFilter {
    /// That has seen nothing yet.
    #[must_use]
    pub fn new(args: VectorArgs) -> Self {
        Self {
            args,
            smooth: Vector3::zeros(),
        }
    }

    /// Takes the vector of a period in, s, and tells what it becomes. One with a number that is none counts as nothing.
    pub fn take(&mut self, vector: &Vector3<f64>, period: f64) -> Vector3<f64> {
        let vector = match vector.iter().all(|number| number.is_finite()) {
            true => *vector,
            false => Vector3::zeros(),
        };
        let share = 1.0 - (-TAU * self.args.low_pass_hz * period).exp();
        self.smooth += (vector - self.smooth) * share;
        let length = self.smooth.norm();
        let beyond = (length - self.args.null_radius).max(0.0);
        let becomes = (beyond * self.args.scale).min(self.args.clip);
        if becomes <= 0.0 {
            return Vector3::zeros();
        }
        self.smooth * (becomes / length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    const ARGS: VectorArgs = VectorArgs {
        low_pass_hz: 10.0,
        null_radius: 1.0,
        scale: 0.5,
        clip: 3.0,
    };

    /// What a vector becomes that stays.
    fn settled(vector: Vector3<f64>) -> Vector3<f64> {
        let mut filter = VectorFilter::new(ARGS);
        for _ in 0..2000 {
            filter.take(&vector, 0.0045);
        }
        filter.take(&vector, 0.0045)
    }

    #[test]
    fn the_length_is_null_then_scaled_then_clipped() {
        for (length, expected) in [(0.5, 0.0), (1.0, 0.0), (3.0, 1.0), (7.0, 3.0), (50.0, 3.0)] {
            let found = settled(Vector3::new(0.0, length, 0.0));
            assert!(
                (found - Vector3::new(0.0, expected, 0.0)).norm() < 1e-6,
                "{length}: {found}"
            );
        }
    }

    #[test]
    fn a_step_has_come_by_a_time_constant_to_what_a_low_pass_lets_through() {
        let args = VectorArgs {
            null_radius: 0.0,
            scale: 1.0,
            clip: 10.0,
            ..ARGS
        };
        let mut filter = VectorFilter::new(args);
        let constant = 1.0 / (TAU * ARGS.low_pass_hz);
        let steps = 100;
        let mut found = Vector3::zeros();
        for _ in 0..steps {
            found = filter.take(&Vector3::x(), constant / f64::from(steps));
        }
        assert!((found.x - (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_number_counts_as_nothing() {
        let mut filter = VectorFilter::new(ARGS);
        filter.take(&Vector3::new(5.0, 0.0, 0.0), 0.0045);
        let found = filter.take(&Vector3::new(f64::NAN, 1.0, 0.0), 0.0045);
        assert!(found.iter().all(|number| number.is_finite()));
    }

    proptest! {
        #[test]
        fn every_direction_is_filtered_the_same(
            numbers in prop::array::uniform3(-8.0..8.0_f64),
            turn in prop::array::uniform3(-3.0..3.0_f64),
        ) {
            let (vector, turn) = (Vector3::from(numbers), Rotation3::new(Vector3::from(turn)));
            let found = settled(turn * vector) - turn * settled(vector);
            prop_assert!(found.norm() < 1e-9);
        }
    }
}
