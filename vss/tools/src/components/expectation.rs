//! Whether a component is what it is expected to be: as large, as round, whole, and all in the picture.

use std::f64::consts::PI;

use super::Component;

/// What a component should be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expectation {
    /// Fewest and most pixels.
    pub area: (u64, u64),
    /// Largest eccentricity: 0 is a circle, 0.6 an ellipse whose axes are as 4 to 5.
    pub eccentricity: f64,
    /// Number of holes; `None`: any.
    pub holes: Option<u64>,
}

/// What a component is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Doubt {
    /// A part of it may lie outside.
    #[error("touches the border of the picture")]
    Clipped,
    /// Fewer pixels.
    #[error("is too small")]
    Small,
    /// More pixels.
    #[error("is too large")]
    Large,
    /// One axis is much longer.
    #[error("is too long for its width")]
    Elongated,
    /// Its outline has corners or dents, or its holes are large.
    #[error("is no full ellipse")]
    Ragged,
    /// Another number of holes.
    #[error("has another number of holes")]
    Holes,
}

impl Doubt {
    /// 1 clipped, 2 small, 4 large, 8 elongated, 16 ragged, 32 holes.
    #[must_use]
    pub fn flag(self) -> i64 {
        1 << (self as i64)
    }
}

/// What an ellipse of the moments of a component would have for area, of which squares fill 0.95 and rings less.
fn of_its_ellipse(component: &Component) -> f64 {
    // Pixels have an extent of their own.
    const PIXEL: f64 = 1.0 / 12.0;
    let (long, short) = component.moments().eigenvalues();
    component.area as f64 / (4.0 * PI * ((long + PIXEL) * (short + PIXEL)).sqrt())
}

/// The least part of its ellipse that a full one fills: steps of the border take more from small ones.
fn least_fill(area: u64) -> f64 {
    0.975 - 0.3 * PI / area.max(1) as f64
}

impl Expectation {
    /// In what `component` is not as expected, in a picture of `width` x `height` pixels.
    #[must_use]
    pub fn doubts(&self, component: &Component, width: usize, height: usize) -> Vec<Doubt> {
        let clipped = component.u_min == 0
            || component.v_min == 0
            || component.u_max + 1 >= width
            || component.v_max + 1 >= height;
        // Holes that are expected are no raggedness.
        let whole = self.holes.is_none_or(|holes| holes == 0);
        let ragged = whole && of_its_ellipse(component) < least_fill(component.area);
        let other = |holes: u64| component.euler != 1 - holes.cast_signed();
        let all = [
            (clipped, Doubt::Clipped),
            (component.area < self.area.0, Doubt::Small),
            (component.area > self.area.1, Doubt::Large),
            (
                component.moments().eccentricity() > self.eccentricity,
                Doubt::Elongated,
            ),
            (ragged, Doubt::Ragged),
            (self.holes.is_some_and(other), Doubt::Holes),
        ];
        let doubts = all.into_iter().filter(|(is, _)| *is);
        doubts.map(|(_, doubt)| doubt).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::components::components;

    const SIDE: usize = 80;

    fn doubts(inside: impl Fn(f64, f64) -> bool, expected: &Expectation) -> Vec<Doubt> {
        let pixels: Vec<u8> = (0..SIDE * SIDE)
            .map(|at| u8::from(inside((at % SIDE) as f64, (at / SIDE) as f64)))
            .collect();
        let found = components(&pixels, SIDE, 1);
        assert_eq!(found.len(), 1);
        expected.doubts(&found[0], SIDE, SIDE)
    }

    fn disc(u: f64, v: f64, radius: f64) -> impl Fn(f64, f64) -> bool {
        move |x, y| (x - u).hypot(y - v) < radius
    }

    const ROUND: Expectation = Expectation {
        area: (20, 2000),
        eccentricity: 0.6,
        holes: Some(0),
    };

    #[test]
    fn discs_of_all_sizes_and_places_are_as_expected() {
        for radius in [3.0, 3.7, 5.2, 8.0, 14.5, 25.0] {
            for step in 0..40 {
                let at = f64::from(step);
                let (u, v) = (35.0 + 0.137 * at, 40.0 + 0.211 * at);
                let found = doubts(disc(u, v, radius), &ROUND);
                assert_eq!(found, [], "radius {radius} at {u}, {v}");
            }
        }
    }

    #[test]
    fn what_is_no_disc_is_told_with_what_it_is_not() {
        let near = |x: f64, y: f64, side: f64| (x - 40.0).abs() < side && (y - 40.0).abs() < side;
        let of = |inside: &dyn Fn(f64, f64) -> bool| doubts(inside, &ROUND);
        assert_eq!(of(&disc(5.0, 40.0, 12.0))[0], Doubt::Clipped);
        assert_eq!(of(&disc(40.0, 40.0, 1.6)), [Doubt::Small]);
        assert_eq!(of(&disc(40.0, 40.0, 30.0)), [Doubt::Large]);
        for side in [8.0, 12.0, 20.0] {
            assert_eq!(of(&|x, y| near(x, y, side)), [Doubt::Ragged], "{side}");
        }
        let ring = |x: f64, y: f64| disc(40.0, 40.0, 12.0)(x, y) && !disc(40.0, 40.0, 5.0)(x, y);
        assert_eq!(of(&ring), [Doubt::Ragged, Doubt::Holes]);
        let one = Expectation {
            holes: Some(1),
            ..ROUND
        };
        assert_eq!(doubts(ring, &one), []);
        let ellipse = |x: f64, y: f64| ((x - 40.0) / 20.0).hypot((y - 40.0) / 10.0) < 1.0;
        assert_eq!(of(&ellipse), [Doubt::Elongated]);
        // Two discs that touch.
        let two = |x: f64, y: f64| disc(30.0, 40.0, 10.0)(x, y) || disc(49.0, 40.0, 10.0)(x, y);
        assert_eq!(of(&two), [Doubt::Elongated, Doubt::Ragged]);
    }
}
