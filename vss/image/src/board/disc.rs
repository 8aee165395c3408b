//! One disc near a place of the board: the circle across which the light changes most (the integro-differential operator of
//! Daugman, 1993), in coordinates of the board, where discs are round.

use std::f64::consts::TAU;

use super::{Board, BoardError, Piece, SQUARES};

/// Places on a circle.
const PLACES: usize = 48;

/// Radii of discs, squares.
const RADII: (f64, f64) = (0.25, 0.48);

/// How far from the place a disc's middle is looked for, squares.
const REACH: f64 = 0.4;

/// Half of the way across the circle, squares.
const ACROSS: f64 = 0.04;

/// The light changes by this part of the board's contrast, at this part of the circle: squares have other borders.
const LEAST: f64 = 0.12;
const SHARE: f64 = 0.65;

/// A disc in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disc {
    /// Its middle, px.
    pub u: f64,
    /// Its middle, px.
    pub v: f64,
    /// Mean radius in the picture, px.
    pub radius: f64,
    /// Its middle on the board, squares.
    pub file: f64,
    /// Its middle on the board, squares.
    pub rank: f64,
    /// White or black man.
    pub piece: Piece,
}

/// A circle on the board.
#[derive(Debug, Clone, Copy)]
struct Circle {
    file: f64,
    rank: f64,
    radius: f64,
}

impl Circle {
    fn place(&self, nth: usize, radius: f64) -> [f64; 2] {
        let (sin, cos) = (TAU * nth as f64 / PLACES as f64).sin_cos();
        [self.file + radius * cos, self.rank + radius * sin]
    }
}

impl Board {
    /// The disc near a place of the board.
    ///
    /// # Errors
    /// None is seen, or the place is not on the board or not in the picture.
    pub fn disc(&self, file: f64, rank: f64) -> Result<Disc, BoardError> {
        let outside = BoardError::Outside { file, rank };
        let side = 0.0..=f64::from(SQUARES);
        if !(side.contains(&file) && side.contains(&rank)) || self.at(file, rank).is_none() {
            return Err(outside);
        }
        let none = BoardError::NoDisc { file, rank };
        let mut best: Option<(f64, Circle)> = None;
        // A coarse search, and finer ones about what it found.
        let (mut reach, mut step) = (REACH, 0.05);
        let (mut middle, mut radii) = ([file, rank], RADII);
        for _ in 0..4 {
            let steps = (reach / step).round() as i32;
            let sizes = ((radii.1 - radii.0) / step).round() as i32;
            for x in -steps..=steps {
                for y in -steps..=steps {
                    for size in 0..=sizes {
                        let circle = Circle {
                            file: middle[0] + step * f64::from(x),
                            rank: middle[1] + step * f64::from(y),
                            radius: radii.0 + step * f64::from(size),
                        };
                        let change = self.change(&circle);
                        if change.is_some_and(|change| best.is_none_or(|best| change > best.0)) {
                            best = change.map(|change| (change, circle));
                        }
                    }
                }
            }
            let Some((_, circle)) = best else {
                return Err(none);
            };
            (middle, reach) = ([circle.file, circle.rank], step);
            radii = (
                (circle.radius - step).max(RADII.0),
                (circle.radius + step).min(RADII.1),
            );
            step /= 3.0;
        }
        let Some((_, circle)) = best else {
            return Err(none);
        };
        let [u, v] = self.pixel(circle.file, circle.rank);
        let border = (0..PLACES).map(|nth| {
            let [file, rank] = circle.place(nth, circle.radius);
            let at = self.pixel(file, rank);
            (at[0] - u).hypot(at[1] - v)
        });
        let radius = border.sum::<f64>() / PLACES as f64;
        let inside = (0..PLACES).filter_map(|nth| {
            let [file, rank] = circle.place(nth, 0.7 * circle.radius);
            self.at(file, rank)
        });
        let mut inside: Vec<f64> = inside.collect();
        inside.sort_by(f64::total_cmp);
        let light = inside.get(inside.len() / 2).copied().ok_or(none)?;
        // Squares under the disc: where it lies across several, the nearest dark one still says what dark is.
        let dark = self.dark_near(circle.file, circle.rank);
        Ok(Disc {
            u,
            v,
            radius,
            file: circle.file,
            rank: circle.rank,
            piece: if light > dark + 0.1 * self.contrast {
                Piece::WhiteMan
            } else {
                Piece::BlackMan
            },
        })
    }

    /// How much the light changes across a circle, in parts of the board's contrast; nothing where it does not change in one
    /// direction along most of it.
    fn change(&self, circle: &Circle) -> Option<f64> {
        let mut changes = [0.0; PLACES];
        for (nth, change) in changes.iter_mut().enumerate() {
            let light = |radius: f64| {
                let [file, rank] = circle.place(nth, radius);
                self.at(file, rank)
            };
            *change =
                (light(circle.radius + ACROSS)? - light(circle.radius - ACROSS)?) / self.contrast;
        }
        let share = |sign: f64| {
            let strong = changes.iter().filter(|change| sign * **change > LEAST);
            strong.count() as f64 / PLACES as f64
        };
        if share(1.0).max(share(-1.0)) < SHARE {
            return None;
        }
        // Dark squares beside a black disc change less than light ones: by roots they count nearly the same.
        let roots = changes
            .iter()
            .map(|change| change.signum() * change.abs().sqrt());
        Some((roots.sum::<f64>() / PLACES as f64).abs())
    }

    /// The light of dark squares near a place.
    fn dark_near(&self, file: f64, rank: f64) -> f64 {
        let corners = [(0, 0), (1, 0), (0, 1), (1, 1)];
        let corners = corners.map(|(x, y)| (file.floor() as i32 + x, rank.floor() as i32 + y));
        let seen = corners.iter().filter_map(|(x, y)| self.vertex(*x, *y));
        let mut dark: Vec<f64> = seen
            .filter(|(contrast, _)| *contrast > 0.35 * self.contrast)
            .map(|(_, dark)| dark)
            .collect();
        dark.sort_by(f64::total_cmp);
        let mean = self
            .light
            .value(self.light.width / 2, self.light.height / 2);
        dark.get(dark.len() / 2).copied().unwrap_or(f64::from(mean))
    }
}
