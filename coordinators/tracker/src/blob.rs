//! What a picture shows of the ball: the largest bright blob that looks like it, or the largest and what it is not (SORMA technical report,
//! section 2.2.3). Knows no tasks.

use serde::{Deserialize, Serialize};
use vss::{
    components::{Component, Doubt, Expectation, components},
    frame::Frame,
    target_map::Seen,
};

/// What the ball is expected to look like. It can be tuned while argus works.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Look {
    /// Grey value from which a pixel is of the ball.
    pub threshold: u8,
    /// Fewest and most pixels.
    pub area_px: [u64; 2],
    /// Largest eccentricity: 0 is a circle, 0.6 an ellipse whose axes are as 4 to 5.
    pub eccentricity: f64,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            threshold: 80,
            area_px: [150, 20_000],
            eccentricity: 0.5,
        }
    }
}

/// A blob of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// What is seen of it.
    pub seen: Seen,
    /// Its pixels.
    pub area: u64,
    /// Its eccentricity.
    pub eccentricity: f64,
    /// Blobs that are large enough to be the ball.
    pub blobs: usize,
    /// What it is not, as flags of [`vss::components::Doubt`]; 0 is the ball.
    pub doubts: i64,
}

/// A second blob that is as good as the largest: nobody knows which is the ball.
pub const AMBIGUOUS: i64 = 64;

impl Sighting {
    /// Whether there is a doubt of one of these kinds.
    #[must_use]
    pub fn has(&self, doubts: &[Doubt]) -> bool {
        doubts.iter().any(|doubt| self.doubts & doubt.flag() != 0)
    }
}

/// A blob this much smaller than the largest is none that could be taken for it.
const RIVAL: f64 = 0.5;

/// The largest blob that is the ball, else the largest with what it is not; `None` in a picture that is dark everywhere. So a
/// reflection that is larger does no harm.
#[must_use]
pub fn largest(frame: &Frame, look: &Look) -> Option<Sighting> {
    let found = components(&frame.grey(), frame.width, look.threshold);
    let [least, most] = look.area_px;
    let expected = Expectation {
        area: (least, most),
        eccentricity: look.eccentricity,
        holes: None,
    };
    let doubts = |blob| expected.doubts(blob, frame.width, frame.height);
    let balls = || found.iter().filter(|blob| doubts(blob).is_empty());
    let ball = balls().max_by_key(|blob| blob.area);
    let largest = ball.or_else(|| found.iter().max_by_key(|blob| blob.area))?;
    let mut flags: i64 = doubts(largest).iter().map(|doubt| doubt.flag()).sum();
    let is_rival = |blob: &&Component| {
        !std::ptr::eq(*blob, largest) && blob.area as f64 > RIVAL * largest.area as f64
    };
    if balls().any(|blob| is_rival(&blob)) {
        flags |= AMBIGUOUS;
    }
    Some(Sighting {
        seen: Seen::of(largest),
        area: largest.area,
        eccentricity: largest.moments().eccentricity(),
        blobs: found.iter().filter(|blob| blob.area >= least).count(),
        doubts: flags,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 200;

    fn picture(bright: impl Fn(f64, f64) -> bool) -> Frame {
        let pixel = |at: usize| match bright((at % SIDE) as f64, (at / SIDE) as f64) {
            true => 220,
            false => 20,
        };
        let pixels: Vec<u8> = (0..SIDE * SIDE).map(pixel).collect();
        Frame::grey8(SIDE, SIDE, pixels)
    }

    fn disc(x: f64, y: f64, (u, v): (f64, f64), radius: f64) -> bool {
        (x - u).hypot(y - v) < radius
    }

    fn seen(bright: impl Fn(f64, f64) -> bool) -> Option<Sighting> {
        largest(&picture(bright), &Look::default())
    }

    #[test]
    fn a_ball_is_seen_where_it_is() {
        let found = seen(|x, y| disc(x, y, (80.3, 120.6), 20.0)).unwrap();
        assert_eq!((found.doubts, found.blobs), (0, 1));
        assert!((found.seen.u - 80.3).abs() < 0.1 && (found.seen.v - 120.6).abs() < 0.1);
        assert!((found.seen.radius - 20.0).abs() < 0.1 && (found.seen.spread - 20.0).abs() < 0.1);
    }

    #[test]
    fn what_is_no_whole_ball_is_not_taken_for_one() {
        let none = |bright: &dyn Fn(f64, f64) -> bool| seen(bright).unwrap().doubts != 0;
        // Cut by the border, a reflection, a half that is covered, and two of them.
        assert!(none(&|x, y| disc(x, y, (5.0, 100.0), 20.0)));
        assert!(none(&|x, y| disc(x, y, (100.0, 100.0), 3.0)));
        assert!(none(&|x, y| disc(x, y, (100.0, 100.0), 20.0) && x < 102.0));
        assert!(none(&|x, y| {
            disc(x, y, (60.0, 100.0), 20.0) || disc(x, y, (140.0, 100.0), 18.0)
        }));
        assert_eq!(seen(|_, _| false), None);
    }

    #[test]
    fn a_small_reflection_beside_the_ball_does_no_harm() {
        let found = seen(|x, y| disc(x, y, (60.0, 100.0), 20.0) || disc(x, y, (150.0, 40.0), 8.0));
        assert_eq!(found.unwrap().doubts, 0);
    }

    #[test]
    fn a_long_reflection_that_is_larger_than_the_ball_does_no_harm() {
        let streak = |x: f64, y: f64| x < 190.0 && x > 10.0 && (y - 150.0).abs() < 6.0;
        let found = seen(|x, y| disc(x, y, (60.0, 60.0), 20.0) || streak(x, y)).unwrap();
        assert_eq!((found.doubts, found.blobs), (0, 2));
        assert!((found.seen.u - 60.0).abs() < 0.1, "{found:?}");
        // Without a ball it is told what the streak is not.
        assert_ne!(seen(streak).unwrap().doubts, 0);
    }
}
