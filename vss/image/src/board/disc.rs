//! One disc near a place of the board: the circle across which the light changes most (the integro-differential operator of
//! Daugman, 1993), in coordinates of the board, where discs are round. Its border is then found on each of many rays, and
//! the circle of least squares through these places says how well the disc is known.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use super::{Board, BoardError, Homography, Light, Piece, SQUARES};
use crate::Picture;

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

/// How far from the circle its border is looked for on each ray, squares, and in how many steps to either side.
const BORDER: f64 = 0.08;
const STEPS: i32 = 16;

/// Places of the border that are farther off than this many times the median are of something else.
const REJECT: f64 = 4.0;

/// Rays on which the light changes by so many times what it does on most are left out.
const STEEP: f64 = 1.5;

/// The least places of the border that make a circle.
const FEWEST: usize = 20;

/// How far places of the border are from a circle (rms), squares or pixels, whichever is more.
const ROUND: f64 = 0.02;
const ROUND_PX: f64 = 0.6;

/// No border is known better than this part of a pixel.
const LEAST_SD_PX: f64 = 0.02;

/// How large a disc is that is looked for without a board, squares of the plane in which it is looked for.
const USUAL_RADIUS: f64 = 0.36;

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
    /// White or black man; without a board lighter or darker than what is around it.
    pub piece: Piece,
    /// Standard deviations of u and v, px.
    pub sd_px: [f64; 2],
    /// Standard deviations of file and rank, squares.
    pub sd: [f64; 2],
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

/// The disc near a place of a picture, px, about as large as `radius`, px. It is looked for within 1.1 radii and
/// among radii from 0.7 to 1.3 of that, as seen from above. File and rank of the answer are u and v in these radii.
///
/// # Errors
/// None is seen, or the place is not in the picture.
pub fn disc_near(picture: &Picture, [u, v]: [f64; 2], radius: f64) -> Result<Disc, BoardError> {
    let light = Light::of(picture);
    let side = radius / USUAL_RADIUS;
    let half = 0.5 * f64::from(SQUARES);
    let [x, y] = light.of_picture([u, v]);
    let scale = side / light.scale();
    let plane = Homography::affine([
        [scale, 0.0, x - half * scale],
        [0.0, scale, y - half * scale],
    ]);
    let mut around: Vec<f64> = (0..81)
        .filter_map(|nth| {
            let at = |nth: i32| half + 0.2 * f64::from(nth - 4);
            light.at(plane.of([at(nth % 9), at(nth / 9)]))
        })
        .collect();
    around.sort_by(f64::total_cmp);
    let outside = BoardError::Outside { file: u, rank: v };
    let range = around.first().zip(around.last()).ok_or(outside)?;
    let seen = Board {
        map: plane,
        contrast: (range.1 - range.0).max(4.0),
        light,
        corners: 0,
        rms: 0.0,
    };
    let mut disc = seen.disc(half, half).map_err(|why| match why {
        BoardError::NoDisc { .. } => BoardError::NoDiscNear { u, v, radius },
        _ => BoardError::Outside { file: u, rank: v },
    })?;
    (disc.file, disc.rank) = (disc.u / radius, disc.v / radius);
    disc.sd = disc.sd_px.map(|sd| sd / radius);
    Ok(disc)
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
        let (circle, sd) = self.fitted(&circle).ok_or(none.clone())?;
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
        let dark = if self.corners == 0 {
            self.around(&circle)
        } else {
            self.dark_near(circle.file, circle.rank)
        };
        Ok(Disc {
            u,
            v,
            radius,
            file: circle.file,
            rank: circle.rank,
            sd,
            sd_px: self.in_pixels(&circle, sd),
            piece: if light > dark + self.margin() {
                Piece::WhiteMan
            } else {
                Piece::BlackMan
            },
        })
    }

    /// How much lighter than dark a white disc is at least; without squares any disc is lighter or darker.
    fn margin(&self) -> f64 {
        if self.corners == 0 {
            0.0
        } else {
            0.1 * self.contrast
        }
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
        // Dark squares beside a black disc change less than light ones, and the borders of squares more than both: what is
        // clear counts the same.
        let roots = changes
            .iter()
            .map(|change| change.signum() * change.abs().min(2.0 * LEAST).sqrt());
        Some((roots.sum::<f64>() / PLACES as f64).abs())
    }

    /// The circle through the places of steepest light on the rays, and the standard deviations of its middle, squares.
    fn fitted(&self, circle: &Circle) -> Option<(Circle, [f64; 2])> {
        let (mut circle, mut sd, mut rms) = (*circle, [f64::NAN; 2], f64::NAN);
        for _ in 0..3 {
            (circle, sd, rms) = self.fitted_once(&circle)?;
        }
        // Rays that all agree to the last bit are those of a drawing: pixels still have a size.
        let pixel = self.in_pixels(&circle, [1.0, 1.0]);
        let pixel = 1.0 / pixel[0].min(pixel[1]).max(f64::MIN_POSITIVE);
        // The borders of squares are no circle.
        let round = rms < ROUND.max(ROUND_PX * pixel);
        round.then(|| (circle, sd.map(|sd| sd.max(LEAST_SD_PX * pixel))))
    }

    /// A step of that, and the root mean square distance of the places from the circle, squares.
    fn fitted_once(&self, circle: &Circle) -> Option<(Circle, [f64; 2], f64)> {
        let rays = self.borders(circle);
        let mut used = rays.clone();
        let mut found = None;
        for _ in 0..5 {
            if used.len() < FEWEST {
                return None;
            }
            // How far the border is beyond the circle is a shift of the middle and a change of the radius, to first order.
            let row = |nth: usize| {
                let (sin, cos) = (TAU * nth as f64 / PLACES as f64).sin_cos();
                Vector3::new(cos, sin, 1.0)
            };
            let products = used
                .iter()
                .map(|(nth, _)| row(*nth) * row(*nth).transpose());
            let normal: Matrix3<f64> = products.sum();
            let right: Vector3<f64> = used.iter().map(|(nth, off)| row(*nth) * *off).sum();
            let unit = normal.try_inverse()?;
            let change = unit * right;
            let off = |(nth, off): &(usize, f64)| off - row(*nth).dot(&change);
            let squares: f64 = used.iter().map(|one| off(one).powi(2)).sum();
            let variance = squares / (used.len() - 3) as f64;
            let sd = [0, 1].map(|k| (variance * unit[(k, k)]).sqrt());
            found = Some((change, sd, variance.sqrt()));
            let mut sizes: Vec<f64> = rays.iter().map(|one| off(one).abs()).collect();
            sizes.sort_by(f64::total_cmp);
            let limit = REJECT * sizes.get(sizes.len() / 2)?.max(1e-3);
            let near = |one: &&(usize, f64)| off(one).abs() <= limit;
            let kept: Vec<_> = rays.iter().filter(near).copied().collect();
            if kept.len() == used.len() {
                break;
            }
            used = kept;
        }
        let (change, sd, rms) = found?;
        let circle = Circle {
            file: circle.file + change.x,
            rank: circle.rank + change.y,
            radius: circle.radius + change.z,
        };
        Some((circle, sd, rms))
    }

    /// The rays on which the border is seen, and how far beyond the circle it is. Where it is much steeper than on most rays
    /// the border of a square is so near that both are one.
    fn borders(&self, circle: &Circle) -> Vec<(usize, f64)> {
        let changes = (0..PLACES).filter_map(|nth| self.slope(circle, nth, 0, STEPS / 4));
        let sign = changes.sum::<f64>().signum();
        let seen = (0..PLACES).filter_map(|nth| Some((nth, self.border(circle, nth, sign)?)));
        let seen: Vec<(usize, (f64, f64))> = seen.collect();
        let mut slopes: Vec<f64> = seen.iter().map(|(_, (_, slope))| *slope).collect();
        slopes.sort_by(f64::total_cmp);
        let most = slopes
            .get(slopes.len() / 2)
            .map_or(0.0, |slope| STEEP * slope);
        let usual = seen.iter().filter(|(_, (_, slope))| *slope <= most);
        let usual: Vec<(usize, f64)> = usual.map(|(nth, (off, _))| (*nth, *off)).collect();
        if usual.len() < FEWEST {
            return seen.into_iter().map(|(nth, (off, _))| (nth, off)).collect();
        }
        usual
    }

    /// How far beyond the circle its border is on a ray, squares, and how steep: the nearest place at which the light changes as it does
    /// along most of the circle (`sign`), for the borders of squares may be near, too.
    fn border(&self, circle: &Circle, nth: usize, sign: f64) -> Option<(f64, f64)> {
        let step = BORDER / f64::from(STEPS);
        // Differences over a quarter of the way: single steps are shorter than a pixel.
        let wide = STEPS / 4;
        let slopes =
            (-STEPS..=STEPS).map(|at| self.slope(circle, nth, at, wide).map(|one| sign * one));
        let slopes: Vec<f64> = slopes.collect::<Option<_>>()?;
        let value = |at: i32| slopes.get(usize::try_from(at + STEPS).ok()?).copied();
        let is_peak = |at: &i32| {
            let beside = value(at - 1).zip(value(at + 1));
            let here = value(*at).filter(|here| *here >= 0.5 * LEAST * self.contrast);
            here.zip(beside)
                .is_some_and(|(here, (a, b))| here >= a && here >= b)
        };
        let best = (1 - STEPS..STEPS)
            .filter(is_peak)
            .min_by_key(|at| at.abs())?;
        let most = value(best)?;
        // The middle of what is steep about it: a peak that pixels cut off is flat.
        let (mut sum, mut moment) = (0.0, 0.0);
        for at in best - STEPS / 3..=best + STEPS / 3 {
            let weight = value(at).map_or(0.0, |one| (one - 0.5 * most).max(0.0));
            sum += weight;
            moment += weight * f64::from(at);
        }
        (sum > 0.0).then(|| (step * moment / sum, most))
    }

    /// The change of light along a ray, `at` steps beyond a circle, from as many steps before to as many after.
    fn slope(&self, circle: &Circle, nth: usize, at: i32, wide: i32) -> Option<f64> {
        let light = |steps: i32| {
            let radius = circle.radius + BORDER / f64::from(STEPS) * f64::from(steps);
            let [file, rank] = circle.place(nth, radius);
            self.at(file, rank)
        };
        Some(light(at + wide)? - light(at - wide)?)
    }

    /// Standard deviations on the board as those of the picture, px.
    fn in_pixels(&self, circle: &Circle, sd: [f64; 2]) -> [f64; 2] {
        const STEP: f64 = 1e-4;
        let here = self.pixel(circle.file, circle.rank);
        let along = self.pixel(circle.file + STEP, circle.rank);
        let across = self.pixel(circle.file, circle.rank + STEP);
        std::array::from_fn(|k| {
            let by_file = (along[k] - here[k]) / STEP * sd[0];
            let by_rank = (across[k] - here[k]) / STEP * sd[1];
            by_file.hypot(by_rank)
        })
    }

    /// The light just outside a circle.
    fn around(&self, circle: &Circle) -> f64 {
        let places = (0..PLACES).filter_map(|nth| {
            let [file, rank] = circle.place(nth, 1.25 * circle.radius);
            self.at(file, rank)
        });
        let mut all: Vec<f64> = places.collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or_default()
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
