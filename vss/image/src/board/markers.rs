//! A board by four markers at known places of it, which need not be its corners. The pattern between them says whether they
//! are the markers of a board, and which of the four ways to lie it has.

use super::{Board, BoardError, Homography, Light, SQUARES, Side, corners, towards, vertex};
use crate::Picture;

/// An inner corner belongs to the board when it is so near to where it should be, squares.
const NEAR: f64 = 0.2;

/// A way to lie.
struct Way {
    map: Homography,
    contrast: f64,
    all: usize,
    seen: usize,
    /// How far White's side of the board is on the side that was said, px.
    side: f64,
}

impl Board {
    /// The board whose four markers are seen at `markers` (px, in any order). Their places on it (files and ranks) are
    /// `places`, round the board as a1, h1, h8, a8. White sits on the side `white` of the picture.
    ///
    /// # Errors
    /// The pattern between the markers is no board.
    pub fn at_markers(
        picture: &Picture,
        markers: [[f64; 2]; 4],
        places: &[[f64; 2]; 4],
        white: Side,
    ) -> Result<Self, BoardError> {
        let light = Light::of(picture);
        let corners = corners::find(&light);
        Self::between(&light, &corners, markers, places, white)
    }

    /// The same for every choice of four of some markers; the choice with most of the pattern counts.
    ///
    /// # Errors
    /// The pattern between no four of them is a board.
    pub fn at_some_markers(
        picture: &Picture,
        markers: &[[f64; 2]],
        places: &[[f64; 2]; 4],
        white: Side,
    ) -> Result<(Self, [usize; 4]), BoardError> {
        let light = Light::of(picture);
        let corners = corners::find(&light);
        let mut best: Option<(Self, [usize; 4])> = None;
        let mut refused = BoardError::NoBoardAtMarkers { seen: 0, all: 0 };
        let n = markers.len();
        let fours = (0..n).flat_map(move |a| {
            (a + 1..n).flat_map(move |b| {
                (b + 1..n).flat_map(move |c| (c + 1..n).map(move |d| [a, b, c, d]))
            })
        });
        for four in fours {
            let chosen = four.map(|nth| markers[nth]);
            match Self::between(&light, &corners, chosen, places, white) {
                Ok(board) => {
                    let better = |best: &(Self, _)| {
                        (board.corners, -board.rms) > (best.0.corners, -best.0.rms)
                    };
                    if best.as_ref().is_none_or(better) {
                        best = Some((board, four));
                    }
                }
                Err(why) => {
                    let seen = |why: &BoardError| match why {
                        BoardError::NoBoardAtMarkers { seen, .. } => *seen,
                        _ => 0,
                    };
                    if seen(&why) > seen(&refused) {
                        refused = why;
                    }
                }
            }
        }
        best.ok_or(refused)
    }

    fn between(
        light: &Light,
        corners: &[[f64; 2]],
        markers: [[f64; 2]; 4],
        places: &[[f64; 2]; 4],
        white: Side,
    ) -> Result<Self, BoardError> {
        let markers = around(markers.map(|marker| light.of_picture(marker)));
        let mut ways: Vec<Way> = (0..4)
            .filter_map(|turn| {
                let pair = |nth: usize| (places[nth], markers[(nth + turn) % 4]);
                Way::new(light, Homography::fitted(&[0, 1, 2, 3].map(pair))?, white)
            })
            .collect();
        let best = ways.iter().max_by_key(|way| way.seen);
        let refused = BoardError::NoBoardAtMarkers {
            seen: best.map_or(0, |way| way.seen),
            all: best.map_or(0, |way| way.all),
        };
        // Half of the places can be covered.
        ways.retain(|way| 2 * way.seen >= way.all && way.seen >= 4);
        ways.sort_by(|one, other| other.side.total_cmp(&one.side));
        let Some(way) = ways.into_iter().next() else {
            return Err(refused);
        };
        let (count, rms) = way.inner(corners);
        Ok(Self {
            map: way.map,
            light: light.clone(),
            contrast: way.contrast,
            corners: count,
            rms: rms * light.scale(),
        })
    }

    /// The inner corners of the pattern that are seen: their places on the board (files, ranks) and in the picture, px.
    #[must_use]
    pub fn inner_corners(&self) -> Vec<([f64; 2], [f64; 2])> {
        let found = corners::find(&self.light);
        let pairs = near(&self.map, &found).into_iter();
        pairs
            .map(|(place, at)| (place, self.light.to_picture(at)))
            .collect()
    }
}

/// In the order of a walk around their middle, against the clock as one sees the picture.
fn around(mut markers: [[f64; 2]; 4]) -> [[f64; 2]; 4] {
    let mean = |k: usize| markers.iter().map(|marker| marker[k]).sum::<f64>() / 4.0;
    let (u, v) = (mean(0), mean(1));
    let angle = |marker: &[f64; 2]| (v - marker[1]).atan2(marker[0] - u);
    markers.sort_by(|one, other| angle(one).total_cmp(&angle(other)));
    markers
}

/// The inner corners with what lies at their places.
fn near(map: &Homography, corners: &[[f64; 2]]) -> Vec<([f64; 2], [f64; 2])> {
    let places = (1..SQUARES).flat_map(|x| (1..SQUARES).map(move |y| [f64::from(x), f64::from(y)]));
    let pairs = places.filter_map(|place| {
        let expected = map.of(place);
        let next = map.of([place[0] + 1.0, place[1]]);
        let square = (next[0] - expected[0]).hypot(next[1] - expected[1]);
        let far = |at: &[f64; 2]| (at[0] - expected[0]).hypot(at[1] - expected[1]);
        let nearest = corners.iter().min_by(|a, b| far(a).total_cmp(&far(b)))?;
        (far(nearest) < NEAR * square).then_some((place, *nearest))
    });
    pairs.collect()
}

impl Way {
    fn new(light: &Light, map: Homography, white: Side) -> Option<Self> {
        let places = (0..=SQUARES).flat_map(|x| (0..=SQUARES).map(move |y| (x, y)));
        let contrasts = places.filter_map(|at| vertex(light, &map, at, true));
        let mut contrasts: Vec<f64> = contrasts.map(|(contrast, _)| contrast).collect();
        contrasts.sort_by(f64::total_cmp);
        // The better half: the others may be covered.
        let contrast = *contrasts.get(contrasts.len() * 3 / 4)?;
        let seen = contrasts
            .iter()
            .filter(|one| **one > 0.3 * contrast)
            .count();
        let (centre, near) = (map.of([4.0, 4.0]), map.of([4.0, 0.0]));
        let side = towards(near, centre, white);
        (contrast > 4.0).then_some(Self {
            contrast,
            all: contrasts.len(),
            seen,
            side,
            map,
        })
    }

    /// How many inner corners are where they should be, and the root of their mean square distance from there.
    fn inner(&self, corners: &[[f64; 2]]) -> (usize, f64) {
        let pairs = near(&self.map, corners);
        let squares = pairs.iter().map(|pair| self.map.residual(pair).powi(2));
        let count = pairs.len();
        (count, (squares.sum::<f64>() / count.max(1) as f64).sqrt())
    }
}
