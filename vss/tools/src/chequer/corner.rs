//! One corner: where the picture has a saddle, and where exactly two edges cross.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use vss_geometry::adjust::{Adjustable, adjusted};

use super::InnerCorner;

/// Width of the smoothing (its σ), px.
const SMOOTHING: f64 = 1.5;
/// The circle on which bright and dark must change four times, px.
const RING: f64 = 4.5;
/// Places on it that are looked at.
const ON_RING: usize = 32;
/// Saddles weaker than this part of the strongest are none.
const WEAKEST: f64 = 0.02;
/// The strongest of so many pixels around is a saddle, px on each side.
const APART: usize = 3;
/// Most saddles.
const MOST: usize = 20_000;
/// Two crossing edges meet at this angle or more, rad.
const LEAST_ANGLE: f64 = 0.35;
/// A fitted corner may leave this part of its contrast.
const MISFIT: f64 = 0.25;

/// A smoothed picture.
pub(super) struct Smooth {
    pub width: usize,
    pub height: usize,
    grey: Vec<f32>,
}

impl Smooth {
    pub(super) fn of(pixels: &[u8], width: usize) -> Self {
        let height = pixels.len() / width.max(1);
        let reach = (3.0 * SMOOTHING).ceil() as usize;
        let bell = |k: usize| (-0.5 * ((k as f64 - reach as f64) / SMOOTHING).powi(2)).exp();
        let all: f64 = (0..=2 * reach).map(bell).sum();
        let weights: Vec<f32> = (0..=2 * reach).map(|k| (bell(k) / all) as f32).collect();
        let clamp = |at: usize, k: usize, size: usize| {
            (at + k).saturating_sub(reach).min(size.saturating_sub(1))
        };
        let mut across = vec![0.0; width * height];
        for v in 0..height {
            for u in 0..width {
                let taps = weights.iter().enumerate();
                let sum = taps.map(|(k, w)| w * f32::from(pixels[v * width + clamp(u, k, width)]));
                across[v * width + u] = sum.sum();
            }
        }
        let mut grey = vec![0.0; width * height];
        for v in 0..height {
            for u in 0..width {
                let taps = weights.iter().enumerate();
                let sum = taps.map(|(k, w)| w * across[clamp(v, k, height) * width + u]);
                grey[v * width + u] = sum.sum();
            }
        }
        Self {
            width,
            height,
            grey,
        }
    }

    fn at(&self, u: usize, v: usize) -> f64 {
        self.grey
            .get(v * self.width + u)
            .map_or(0.0, |grey| f64::from(*grey))
    }

    /// Between pixels; `None` outside.
    fn between(&self, u: f64, v: f64) -> Option<f64> {
        let inside =
            u >= 0.0 && v >= 0.0 && u < self.width as f64 - 1.0 && v < self.height as f64 - 1.0;
        if !inside {
            return None;
        }
        let (column, row) = (u.floor(), v.floor());
        let (part_u, part_v) = (u - column, v - row);
        // Inside, both are whole numbers of pixels.
        let (column, row) = (column as usize, row as usize);
        let upper = (1.0 - part_u) * self.at(column, row) + part_u * self.at(column + 1, row);
        let lower =
            (1.0 - part_u) * self.at(column, row + 1) + part_u * self.at(column + 1, row + 1);
        Some((1.0 - part_v) * upper + part_v * lower)
    }

    /// The grey value on the circle around a place, in a direction.
    pub(super) fn on_ring(&self, u: f64, v: f64, angle: f64) -> Option<f64> {
        self.between(u + RING * angle.cos(), v + RING * angle.sin())
    }
}

/// Where two edges cross, to about a pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Saddle {
    pub u: f64,
    pub v: f64,
    /// Directions of the two edges, rad, in [0, π).
    pub edges: [f64; 2],
    /// The grey value in the middle of the circle around it.
    pub middle: f64,
    pub strength: f64,
}

/// All corners of two bright and two dark fields.
pub(super) fn saddles(smooth: &Smooth) -> Vec<Saddle> {
    let (width, height) = (smooth.width, smooth.height);
    let mut strength = vec![0.0_f64; width * height];
    for v in 1..height - 1 {
        for u in 1..width - 1 {
            let at = |du: usize, dv: usize| smooth.at(u + du - 1, v + dv - 1);
            let uu = at(2, 1) - 2.0 * at(1, 1) + at(0, 1);
            let vv = at(1, 2) - 2.0 * at(1, 1) + at(1, 0);
            let uv = 0.25 * (at(2, 2) + at(0, 0) - at(2, 0) - at(0, 2));
            strength[v * width + u] = uv * uv - uu * vv;
        }
    }
    let strongest = strength.iter().copied().fold(0.0, f64::max);
    let mut found = Vec::new();
    for v in APART..height - APART {
        for u in APART..width - APART {
            let own = strength[v * width + u];
            if own <= WEAKEST * strongest || own <= 0.0 {
                continue;
            }
            let around = (v - APART..=v + APART)
                .flat_map(|row| (u - APART..=u + APART).map(move |column| (column, row)));
            let mut others = around.filter(|place| *place != (u, v));
            let beaten = others.any(|(column, row)| {
                let other = strength[row * width + column];
                // Of two equal ones the first counts.
                other > own || other == own && (row, column) < (v, u)
            });
            if !beaten && let Some(saddle) = examined(smooth, u, v, own) {
                found.push(saddle);
            }
        }
    }
    found.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    found.truncate(MOST);
    found
}

/// The saddle at a pixel, if bright and dark change four times around it.
fn examined(smooth: &Smooth, u: usize, v: usize, strength: f64) -> Option<Saddle> {
    let (u, v) = (u as f64, v as f64);
    let angle = |k: usize| std::f64::consts::TAU * k as f64 / ON_RING as f64;
    let ring: Option<Vec<f64>> = (0..ON_RING)
        .map(|k| smooth.on_ring(u, v, angle(k)))
        .collect();
    let ring = ring?;
    let middle = ring.iter().sum::<f64>() / ON_RING as f64;
    let mut changes = Vec::new();
    for (k, pair) in ring.iter().zip(ring.iter().cycle().skip(1)).enumerate() {
        let (a, b) = (pair.0 - middle, pair.1 - middle);
        if (a > 0.0) != (b > 0.0) {
            changes.push(angle(k) + a / (a - b) * angle(1));
        }
    }
    let [a, b, c, d] = changes.try_into().ok()?;
    let opposite = |one: f64, other: f64| (other - one - std::f64::consts::PI).abs() < 0.5;
    if !opposite(a, c) || !opposite(b, d) {
        return None;
    }
    let pi = std::f64::consts::PI;
    let line = |one: f64, other: f64| (0.5 * (one + other - pi)).rem_euclid(pi);
    let edges = [line(a, c), line(b, d)];
    let between = (edges[0] - edges[1]).rem_euclid(pi);
    (between.min(pi - between) > LEAST_ANGLE).then_some(Saddle {
        u,
        v,
        edges,
        middle,
        strength,
    })
}

type Parameters = SVector<f64, 7>;

#[derive(Clone)]
struct Problem<'p> {
    /// u, v, the directions of the edges, the mean grey value, half the contrast, the logarithm of the blur.
    parameters: Parameters,
    /// Column, row, grey value.
    pixels: &'p [[f64; 3]],
}

impl Problem<'_> {
    fn for_each(&self, mut each: impl FnMut(f64, f64, [f64; 7])) {
        let [u, v, first, second, mean, half, log] = self.parameters.into();
        let blur = log.exp();
        let root = std::f64::consts::SQRT_2;
        let steep = (2.0 / std::f64::consts::PI).sqrt();
        let (sine_a, cosine_a) = first.sin_cos();
        let (sine_b, cosine_b) = second.sin_cos();
        for [column, row, grey] in self.pixels {
            let (x, y) = (column - u, row - v);
            let (p, q) = (
                (y * cosine_a - x * sine_a) / blur,
                (y * cosine_b - x * sine_b) / blur,
            );
            let (along_a, along_b) = (
                (x * cosine_a + y * sine_a) / blur,
                (x * cosine_b + y * sine_b) / blur,
            );
            let (e, f) = (libm::erf(p / root), libm::erf(q / root));
            let (de, df) = (steep * (-0.5 * p * p).exp(), steep * (-0.5 * q * q).exp());
            let by_u = (de * sine_a * f + e * df * sine_b) / blur;
            let by_v = -(de * cosine_a * f + e * df * cosine_b) / blur;
            let slope = [
                half * by_u,
                half * by_v,
                -half * de * along_a * f,
                -half * e * df * along_b,
                1.0,
                e * f,
                -half * (de * p * f + e * df * q),
            ];
            each(*grey, mean + half * e * f, slope);
        }
    }
}

impl Adjustable for Problem<'_> {
    fn squares(&self) -> Option<f64> {
        let mut squares = 0.0;
        self.for_each(|grey, model, _| squares += (grey - model).powi(2));
        squares.is_finite().then_some(squares)
    }

    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let (mut normal, mut right) = (SMatrix::<f64, 7, 7>::zeros(), Parameters::zeros());
        self.for_each(|grey, model, slope| {
            let slope = Parameters::from(slope);
            normal += slope * slope.transpose();
            right += (grey - model) * slope;
        });
        Some((
            DMatrix::from_column_slice(7, 7, normal.as_slice()),
            DVector::from_column_slice(right.as_slice()),
        ))
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        let mut moved = self.clone();
        moved.parameters += step;
        moved
    }
}

/// Where exactly the edges of a saddle cross; `None` where no two edges fit.
pub(super) fn refined(
    pixels: &[u8],
    width: usize,
    saddle: &Saddle,
    reach: f64,
    noise: f64,
) -> Option<InnerCorner> {
    let height = pixels.len() / width.max(1);
    let span = |at: f64, size: usize| {
        let low = (at - reach).ceil().max(0.0) as usize;
        low..((at + reach).floor() as usize + 1).min(size)
    };
    let mut near = Vec::new();
    for row in span(saddle.v, height) {
        for column in span(saddle.u, width) {
            let (x, y) = (column as f64 - saddle.u, row as f64 - saddle.v);
            if x.hypot(y) <= reach {
                let grey = pixels.get(row * width + column)?;
                near.push([column as f64, row as f64, f64::from(*grey)]);
            }
        }
    }
    if near.len() < 20 {
        return None;
    }
    let greys = || near.iter().map(|pixel| pixel[2]);
    let (low, high) = (
        greys().fold(f64::INFINITY, f64::min),
        greys().fold(0.0, f64::max),
    );
    let [first, second] = saddle.edges;
    let mut start = Problem {
        parameters: Parameters::from([
            saddle.u,
            saddle.v,
            first,
            second,
            0.5 * (low + high),
            0.5 * (high - low),
            0.0,
        ]),
        pixels: &near,
    };
    // Which fields are bright is in the sign of the contrast.
    let mut sign = 0.0;
    start.for_each(|grey, _, slope| sign += (grey - 0.5 * (low + high)) * slope[5]);
    start.parameters[5] *= sign.signum();
    let problem = adjusted(start)?;
    let [u, v, _, _, _, half, _] = problem.parameters.into();
    let (normal, _) = problem.equations()?;
    let squares = problem.squares()?;
    let spare = problem.pixels.len().saturating_sub(7).max(1) as f64;
    let left = (squares / spare).sqrt();
    let covariance = normal.try_inverse()? * noise.max(left).powi(2);
    let stayed = (u - saddle.u).hypot(v - saddle.v) < 2.0_f64.max(0.5 * reach);
    let fits = left <= MISFIT * half.abs() + 2.0 * noise;
    let sd = [covariance[(0, 0)].sqrt(), covariance[(1, 1)].sqrt()];
    let known = sd.iter().all(|sd| sd.is_finite() && *sd < 1.0);
    (stayed && fits && known).then_some(InnerCorner {
        u,
        v,
        sd_u: sd[0],
        sd_v: sd[1],
    })
}
