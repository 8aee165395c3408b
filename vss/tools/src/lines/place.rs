//! Where the points are: candidates from the smoothed picture, and the place of each by derivatives about it.

use std::f64::consts::{FRAC_PI_2, PI};

use super::{Kind, LEAST_DEVIATIONS, LinePoint, LinesOptions, NoLines, unsigned};

/// A picture with what is smoothed of it.
pub(super) struct Plane<'a> {
    lit: &'a [u8],
    dark: Option<&'a [u8]>,
    width: usize,
    height: usize,
    sigma: f64,
    smooth: Vec<f32>,
}

/// What a Gaussian of a width reaches, px.
fn reach(sigma: f64) -> usize {
    (4.0 * sigma).ceil() as usize
}

/// A Gaussian of that many pixels about a place `off` of the middle one.
fn bell(sigma: f64, reach: usize, off: f64) -> Vec<f64> {
    let at = |k: usize| {
        let x = (k as f64 - reach as f64 - off) / sigma;
        (-0.5 * x * x).exp() / (sigma * (2.0 * PI).sqrt())
    };
    (0..=2 * reach).map(at).collect()
}

/// First to third derivative along a direction of the smoothed picture at a place.
struct Slopes([f64; 3]);

impl<'a> Plane<'a> {
    /// `lit` and `dark` hold whole rows of `width`.
    pub(super) fn new(lit: &'a [u8], dark: Option<&'a [u8]>, width: usize, sigma: f64) -> Self {
        let mut plane = Self {
            lit,
            dark,
            width,
            height: lit.len().checked_div(width).unwrap_or(0),
            sigma,
            smooth: Vec::new(),
        };
        plane.smooth = plane.smoothed();
        plane
    }

    /// The light at a pixel; the border is continued.
    fn value(&self, u: isize, v: isize) -> f64 {
        let inside = |at: isize, count: usize| at.clamp(0, count as isize - 1) as usize;
        let at = inside(v, self.height) * self.width + inside(u, self.width);
        let grey = |pixels: &[u8]| f64::from(pixels.get(at).copied().unwrap_or(0));
        grey(self.lit) - self.dark.map_or(0.0, grey)
    }

    fn smoothed(&self) -> Vec<f32> {
        let reach = reach(self.sigma);
        let weights = bell(self.sigma, reach, 0.0);
        let mut result = Vec::with_capacity(self.lit.len());
        let mut sums = vec![0.0; self.width + 2 * reach];
        for v in 0..self.height {
            // Columns first, then along the row.
            sums.fill(0.0);
            for (k, weight) in weights.iter().enumerate() {
                let row = (v + k) as isize - reach as isize;
                for (u, sum) in sums.iter_mut().enumerate() {
                    *sum += weight * self.value(u as isize - reach as isize, row);
                }
            }
            let along = sums.windows(weights.len());
            let along = along.map(|w| w.iter().zip(&weights).map(|(s, w)| s * w).sum::<f64>());
            result.extend(along.map(|value| value as f32));
        }
        result
    }

    /// Derivatives at a place along a direction, from the pixels themselves.
    fn slopes(&self, place: [f64; 2], along: [f64; 2]) -> Slopes {
        let reach = reach(self.sigma);
        let square = self.sigma * self.sigma;
        let [middle_u, middle_v] = place.map(f64::round);
        let off = [place[0] - middle_u, place[1] - middle_v];
        let [across_u, across_v] = off.map(|off| bell(self.sigma, reach, off));
        let (first_u, first_v) = (
            middle_u as isize - reach as isize,
            middle_v as isize - reach as isize,
        );
        // Less the middle: what is cut off of a Gaussian must not count.
        let base = self.value(middle_u as isize, middle_v as isize);
        let mut sums = [0.0; 3];
        for (j, weight_v) in across_v.iter().enumerate() {
            let dv = j as f64 - reach as f64 - off[1];
            for (i, weight_u) in across_u.iter().enumerate() {
                let du = i as f64 - reach as f64 - off[0];
                let a = du * along[0] + dv * along[1];
                let value = self.value(first_u + i as isize, first_v + j as isize) - base;
                let weighted = value * weight_u * weight_v / square;
                sums[0] += weighted * a;
                sums[1] += weighted * (a * a / square - 1.0);
                sums[2] += weighted * a * (a * a / square - 3.0) / square;
            }
        }
        Slopes(sums)
    }

    /// The 3 x 3 smoothed values about a pixel, row by row.
    fn about(&self, u: usize, v: usize) -> Option<[f64; 9]> {
        let first = (v.checked_sub(1)? * self.width) + u.checked_sub(1)?;
        let mut nine = [0.0; 9];
        for (k, value) in nine.iter_mut().enumerate() {
            let at = first + (k / 3) * self.width + k % 3;
            *value = f64::from(*self.smooth.get(at)?);
        }
        Some(nine)
    }
}

/// What must be reached in the smoothed picture.
struct Limits {
    kind: Kind,
    least: f64,
}

/// Across which direction a pixel may be part of a line, or along which an edge rises there.
fn candidate(nine: &[f64; 9], limits: &Limits) -> Option<[f64; 2]> {
    let [a, b, c, d, e, f, g, h, i] = *nine;
    let (du, dv) = (0.5 * (f - d), 0.5 * (h - b));
    if limits.kind == Kind::Edge {
        let rise = du.hypot(dv);
        return (rise >= limits.least).then(|| [du / rise, dv / rise]);
    }
    let (duu, dvv, duv) = (d + f - 2.0 * e, b + h - 2.0 * e, 0.25 * (a + i - c - g));
    let (mean, half) = (0.5 * (duu + dvv), (0.5 * (duu - dvv)).hypot(duv));
    // The larger of both curvatures stands along `angle`.
    let angle = 0.5 * (2.0 * duv).atan2(duu - dvv);
    let (curvature, other, angle) = match limits.kind {
        Kind::Dark => (mean + half, mean - half, angle),
        _ => (half - mean, -half - mean, angle + FRAC_PI_2),
    };
    // A spot bends as much along as across.
    if curvature < limits.least || other.abs() > 0.6 * curvature {
        return None;
    }
    let across = [angle.cos(), angle.sin()];
    let slope = du * across[0] + dv * across[1];
    // It is refined later: half a pixel and what neighbouring pixels err by.
    let axis = across[0].abs().max(across[1].abs());
    ((slope / curvature).abs() * axis <= 1.0).then_some(across)
}

/// The points of all lines, each with its pixel's number, in the order of these: one for each row that a line crosses steeply, or
/// column.
pub(super) fn points(
    plane: &Plane<'_>,
    noise: f64,
    options: &LinesOptions,
) -> Result<Vec<(usize, LinePoint)>, NoLines> {
    let sigma = options.sigma;
    // Standard deviations of derivatives of a Gaussian over white noise, and the response to a contrast of 1.
    let first = noise / (sigma * sigma * (8.0 * PI).sqrt());
    let second = noise * (3.0 / (16.0 * PI)).sqrt() / sigma.powi(3);
    let (noise_of_place, noise_of_height, unit) = match options.kind {
        Kind::Edge => (second, first, 1.0 / (sigma * (2.0 * PI).sqrt())),
        _ => (first, second, 1.0 / (8.0_f64.sqrt() * sigma * sigma)),
    };
    let least = (options.contrast * unit).max(LEAST_DEVIATIONS * noise_of_height);
    // Differences of pixels show a little less than derivatives.
    let limits = Limits {
        kind: options.kind,
        least: 0.7 * least,
    };
    let margin = (2.0 * sigma).ceil() as usize;
    let mut found = Vec::new();
    for v in margin..plane.height.saturating_sub(margin) {
        for u in margin..plane.width.saturating_sub(margin) {
            let nine = plane.about(u, v);
            let Some(across) = nine.and_then(|nine| candidate(&nine, &limits)) else {
                continue;
            };
            if options.kind == Kind::Edge && !rises_most(plane, u, v, across) {
                continue;
            }
            let Some((place, height, slope)) = refined(plane, [u, v], across, options.kind) else {
                continue;
            };
            if height < least {
                continue;
            }
            if found.len() >= options.most {
                return Err(NoLines::TooMany(options.most));
            }
            // Across an edge it gets brighter.
            let direction = across[1].atan2(across[0]) - FRAC_PI_2;
            let point = LinePoint {
                u: place[0],
                v: place[1],
                direction: match options.kind {
                    Kind::Edge => direction.sin().atan2(direction.cos()),
                    _ => unsigned(direction),
                },
                sd: noise_of_place / slope,
                contrast: height / unit,
            };
            found.push((v * plane.width + u, point));
        }
    }
    Ok(found)
}

/// Whether the smoothed picture rises no less at a pixel than at those before and behind it.
fn rises_most(plane: &Plane<'_>, u: usize, v: usize, across: [f64; 2]) -> bool {
    let rise = |u: usize, v: usize| {
        let nine = plane.about(u, v);
        nine.map_or(0.0, |nine| {
            0.5 * ((nine[5] - nine[3]) * across[0] + (nine[7] - nine[1]) * across[1])
        })
    };
    let here = rise(u, v);
    let steep = across[0].abs() < across[1].abs();
    let [before, after] = if steep {
        [rise(u, v - 1), rise(u, v + 1)]
    } else {
        [rise(u - 1, v), rise(u + 1, v)]
    };
    // Two that are equal are both kept: the place tells which one is.
    here >= 0.98 * before && here >= 0.98 * after
}

/// The place of a point about a pixel, its height and the slope there by which noise moves it; `None` when another pixel has it.
fn refined(
    plane: &Plane<'_>,
    pixel: [usize; 2],
    across: [f64; 2],
    kind: Kind,
) -> Option<([f64; 2], f64, f64)> {
    let mut place = pixel.map(|at| at as f64);
    let sign = if kind == Kind::Dark { -1.0 } else { 1.0 };
    for _ in 0..8 {
        let Slopes([first, second, third]) = plane.slopes(place, across);
        let (value, slope, height) = match kind {
            Kind::Edge => (second, third, first),
            _ => (first, second, -sign * second),
        };
        // At a height the slope of the derivative falls.
        if sign * slope >= 0.0 || height <= 0.0 {
            return None;
        }
        let step = (-value / slope).clamp(-0.5, 0.5);
        place = [place[0] + step * across[0], place[1] + step * across[1]];
        if step.abs() < 1e-4 {
            let steep = across[0].abs() < across[1].abs();
            let off = if steep {
                place[1] - pixel[1] as f64
            } else {
                place[0] - pixel[0] as f64
            };
            // One for each row or column: the next pixel has the rest.
            return (-0.5..0.5)
                .contains(&off)
                .then_some((place, height, slope.abs()));
        }
        let far = (place[0] - pixel[0] as f64).hypot(place[1] - pixel[1] as f64);
        if far > 1.5 {
            return None;
        }
    }
    None
}
