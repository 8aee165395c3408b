//! A draughts board in a picture: where it is, what stands on it, and where one disc is.
//!
//! The board is found by the 49 inner corners of its chequer pattern, for its border may look like anything: corners where
//! two dark and two light squares meet, those of them that form a lattice, and the homography from the board to the
//! picture. The pattern itself says which squares are dark, and so, with the side on which White
//! sits, where a1 is: dark, at each player's lower left. Knows no lens: straight lines must be straight.
//!
//! Places on the board are counted in squares: files from the left edge of a (0) to the right edge of h (8), ranks from the
//! lower edge of 1 (0) to the upper edge of 8 (8).

mod corners;
mod disc;
mod homography;
mod lattice;
mod light;
mod markers;
mod situation;

pub use disc::{Disc, disc_near};
pub use situation::{Field, Piece, Rest, Roles};

use homography::Homography;
use lattice::Lattice;
use light::Light;

use crate::Picture;

/// A side of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Large v.
    Bottom,
    /// Small v.
    Top,
    /// Small u.
    Left,
    /// Large u.
    Right,
}

impl Side {
    fn direction(self) -> [f64; 2] {
        match self {
            Self::Bottom => [0.0, 1.0],
            Self::Top => [0.0, -1.0],
            Self::Left => [-1.0, 0.0],
            Self::Right => [1.0, 0.0],
        }
    }
}

/// White sits on a side when the way there is that part of the way to White: within 78 degrees.
const SIDEWAYS: f64 = 0.2;

/// Which part of the way from the board's centre to White's edge leads to a side of the picture.
fn towards(near: [f64; 2], centre: [f64; 2], white: Side) -> f64 {
    let ([u, v], way) = (
        white.direction(),
        [near[0] - centre[0], near[1] - centre[1]],
    );
    (way[0] * u + way[1] * v) / way[0].hypot(way[1])
}

/// Why no board is seen.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BoardError {
    /// The dark corner squares are where they cannot be with White on that side.
    #[error(
        "White does not sit on the side of the picture that -white says: the dark corner squares are at the left and right of White \
         only when seen from another side; set -white, or is the picture mirrored?"
    )]
    Sideways,
    /// Too few corners form a lattice.
    #[error(
        "no chequer pattern is seen: {lattice} of its 49 inner corners form a lattice, at least {CORNERS_LEAST} are needed \
         ({corners} places look like corners)"
    )]
    NoPattern {
        /// Places that look like corners.
        corners: usize,
        /// Those of the largest lattice.
        lattice: usize,
    },
    /// Rows are covered, and it is not seen which.
    #[error(
        "the board can lie in several ways: {across} x {down} of its 7 x 7 inner corners are seen, and the squares around \
         them do not say where it ends"
    )]
    Ambiguous {
        /// Corners in one direction.
        across: usize,
        /// And in the other.
        down: usize,
    },
    /// There is a pattern, and it is no board.
    #[error(
        "the pattern is no board of 8 x 8: {seen} of {all} places where squares meet look as they should"
    )]
    NoBoard {
        /// Places that do.
        seen: usize,
        /// All that are in the picture.
        all: usize,
    },
    /// The markers are no markers of a board, or not those.
    #[error(
        "the pattern between the four markers is no board: {seen} of {all} places where squares meet look as they should; are \
         these the markers, and at their places?"
    )]
    NoBoardAtMarkers {
        /// Places that do, in the best way to lie.
        seen: usize,
        /// All that are in the picture.
        all: usize,
    },
    /// No disc is near the place that is asked for.
    #[error("no disc is seen near {file:.2}, {rank:.2} (squares from the corner of a1)")]
    NoDisc {
        /// Where it was looked for.
        file: f64,
        /// Where it was looked for.
        rank: f64,
    },
    /// No disc is near the place of the picture that is asked for.
    #[error("no disc of about {radius:.1} px radius is seen near {u:.1}, {v:.1} px")]
    NoDiscNear {
        /// Where it was looked for, px.
        u: f64,
        /// Where it was looked for, px.
        v: f64,
        /// How large it should be, px.
        radius: f64,
    },
    /// The place is not on the board, or not in the picture.
    #[error(
        "{file:.2}, {rank:.2} is no place of the board that is in the picture (0 to 8 squares from the corner of a1)"
    )]
    Outside {
        /// The place.
        file: f64,
        /// The place.
        rank: f64,
    },
}

/// A pattern needs so many corners: with fewer, texts and grids are taken for boards.
const CORNERS_LEAST: usize = 20;

/// Squares a side.
const SQUARES: i32 = 8;

/// A board in a picture.
#[derive(Debug, Clone)]
pub struct Board {
    /// From the board (files, ranks) to pixels.
    map: Homography,
    light: Light,
    /// Typical difference of light and dark squares, grey values.
    contrast: f64,
    /// Inner corners that were seen, of 49.
    pub corners: usize,
    /// Root mean square of their distances from the homography, px.
    pub rms: f64,
}

impl Board {
    /// Finds the board in a picture, White on the side `white`.
    ///
    /// # Errors
    /// There is none, or it cannot be told how it lies.
    pub fn find(picture: &Picture, white: Side) -> Result<Self, BoardError> {
        let light = Light::of(picture);
        let corners = corners::find(&light);
        let lattice = lattice::largest(&light, &corners);
        let found = lattice.as_ref().map_or(0, Lattice::len);
        let few = BoardError::NoPattern {
            corners: corners.len(),
            lattice: found,
        };
        let Some(lattice) = lattice.filter(|lattice| lattice.len() >= CORNERS_LEAST) else {
            return Err(few);
        };
        let mut placed: Vec<Placed> = lattice
            .windows()
            .into_iter()
            .filter_map(|window| Placed::new(&light, &window))
            .collect();
        placed.sort_by_key(|one| std::cmp::Reverse(one.seen));
        let (across, down) = lattice.size();
        let best = match placed.as_slice() {
            [] => return Err(few),
            [first, second, ..] if second.seen + 3 > first.seen => {
                return Err(BoardError::Ambiguous { across, down });
            }
            [first, ..] => first,
        };
        // Half of the places can be covered.
        if 2 * best.seen < best.all || best.corners < CORNERS_LEAST {
            let (seen, all) = (best.seen, best.all);
            return Err(BoardError::NoBoard { seen, all });
        }
        let map = best.turned(white);
        Ok(Self {
            map,
            contrast: best.contrast,
            corners: best.corners,
            rms: best.rms * light.scale(),
            light,
        })
    }

    /// The board, if White sits on that side of the picture.
    ///
    /// # Errors
    /// [`BoardError::Sideways`].
    pub fn facing(self, white: Side) -> Result<Self, BoardError> {
        let (near, centre) = (self.pixel(4.0, 0.0), self.pixel(4.0, 4.0));
        match towards(near, centre, white) > SIDEWAYS {
            true => Ok(self),
            false => Err(BoardError::Sideways),
        }
    }

    /// Where a place of the board is in the picture, px.
    #[must_use]
    pub fn pixel(&self, file: f64, rank: f64) -> [f64; 2] {
        self.light.to_picture(self.map.of([file, rank]))
    }

    /// The homography from places of the board (files, ranks, 1) to pixels (u, v, 1) up to scale, row by row; the last number
    /// is 1.
    #[must_use]
    pub fn homography(&self) -> [f64; 9] {
        self.light.homography_to_picture(&self.map)
    }

    /// The light at a place of the board.
    fn at(&self, file: f64, rank: f64) -> Option<f64> {
        self.light.at(self.map.of([file, rank]))
    }

    /// How much lighter the light squares are than the dark ones around the corner of squares at `file`, `rank`, and the mean of
    /// the dark ones. Nothing where fewer than two squares meet, or where one is outside the picture.
    fn vertex(&self, file: i32, rank: i32) -> Option<(f64, f64)> {
        // a1, the square from 0, 0, is dark.
        vertex(&self.light, &self.map, (file, rank), true)
    }
}

/// How far from a corner its squares are looked at, squares. Discs do not come so close.
const PATCH: f64 = 0.14;

fn vertex(
    light: &Light,
    map: &Homography,
    (x, y): (i32, i32),
    even_is_dark: bool,
) -> Option<(f64, f64)> {
    let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
    for (dx, dy) in [(-1, -1), (-1, 0), (0, -1), (0, 0)] {
        let (column, row) = (x + dx, y + dy);
        if !((0..SQUARES).contains(&column) && (0..SQUARES).contains(&row)) {
            continue;
        }
        let dark = ((column + row) % 2 == 0) == even_is_dark;
        let side = |step: i32| f64::from(2 * step + 1) * PATCH;
        let at = map.of([f64::from(x) + side(dx), f64::from(y) + side(dy)]);
        sums[usize::from(dark)] += light.around(at)?;
        counts[usize::from(dark)] += 1.0;
    }
    (counts[0] > 0.0 && counts[1] > 0.0).then(|| {
        let dark = sums[1] / counts[1];
        (sums[0] / counts[0] - dark, dark)
    })
}

/// A lattice taken for the inner corners of a board.
struct Placed {
    /// From squares of the lattice (0 to 8 in both directions) to the light.
    map: Homography,
    /// The square from 0, 0 is dark.
    even_is_dark: bool,
    /// Median difference of light and dark squares.
    contrast: f64,
    corners: usize,
    rms: f64,
    /// Corners of squares in the picture, and those of them that are as they should be.
    all: usize,
    seen: usize,
}

impl Placed {
    fn new(light: &Light, window: &[([f64; 2], [f64; 2])]) -> Option<Self> {
        let mut used = window.to_vec();
        let mut map = Homography::fitted(&used)?;
        for _ in 0..3 {
            let square = |at: [f64; 2]| {
                let next = map.of([at[0] + 1.0, at[1]]);
                let here = map.of(at);
                (next[0] - here[0]).hypot(next[1] - here[1])
            };
            let near = |pair: &&([f64; 2], [f64; 2])| map.residual(pair) < 0.15 * square(pair.0);
            let kept: Vec<_> = window.iter().filter(near).copied().collect();
            if kept.len() == used.len() {
                break;
            }
            map = Homography::fitted(&kept)?;
            used = kept;
        }
        let squares = used.iter().map(|pair| map.residual(pair).powi(2));
        let rms = (squares.sum::<f64>() / used.len().max(1) as f64).sqrt();
        let places = (0..=SQUARES).flat_map(|x| (0..=SQUARES).map(move |y| (x, y)));
        let contrasts: Vec<f64> = places
            .filter_map(|at| vertex(light, &map, at, true))
            .map(|(contrast, _)| contrast)
            .collect();
        let sum: f64 = contrasts.iter().sum();
        let even_is_dark = sum > 0.0;
        let mut right: Vec<f64> = contrasts
            .iter()
            .map(|contrast| if even_is_dark { *contrast } else { -contrast })
            .collect();
        right.sort_by(f64::total_cmp);
        // The better half: the others may be covered.
        let contrast = *right.get(right.len() * 3 / 4)?;
        let seen = right.iter().filter(|one| **one > 0.3 * contrast).count();
        (contrast > 4.0).then_some(Self {
            map,
            even_is_dark,
            contrast,
            corners: used.len(),
            rms,
            all: right.len(),
            seen,
        })
    }

    /// The map with a1 at 0, 0: of the four ways to lie, two have a dark square there, and one of these has White on its side.
    fn turned(&self, white: Side) -> Homography {
        let ways = (0..4_u8).map(|turn| {
            // From files and ranks to squares of the lattice, whose y runs down where its x runs right.
            let (a, b, c, d, e, f) = match turn {
                0 => (1.0, 0.0, 0.0, 0.0, -1.0, 8.0),
                1 => (0.0, 1.0, 0.0, 1.0, 0.0, 0.0),
                2 => (-1.0, 0.0, 8.0, 0.0, 1.0, 0.0),
                _ => (0.0, -1.0, 8.0, -1.0, 0.0, 8.0),
            };
            let map = self.map.after([[a, b, c], [d, e, f]]);
            let (first, centre, near) = ([0.5, 0.5], map.of([4.0, 4.0]), map.of([4.0, 0.0]));
            let square = [
                a * first[0] + b * first[1] + c,
                d * first[0] + e * first[1] + f,
            ];
            let even = (square[0].floor() as i32 + square[1].floor() as i32) % 2 == 0;
            (even == self.even_is_dark, towards(near, centre, white), map)
        });
        let dark = ways.filter(|(dark, ..)| *dark);
        let best = dark.max_by(|one, other| one.1.total_cmp(&other.1));
        best.map_or_else(|| self.map.clone(), |(.., map)| map)
    }
}

#[cfg(test)]
mod tests;
