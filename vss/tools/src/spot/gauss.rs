//! Least-squares fit of a round Gaussian to the pixels around a spot, on the background that is there.
//!
//! Three backgrounds are fitted with it: a constant, a plane, and an edge (a constant on either side of a line
//! that may bend). The centre is their mean, each weighted by how well it explains the pixels (Akaike's weights), and its
//! variance holds what they disagree on (K. Burnham and D. Anderson, Sociological Methods and Research 33, 2004).

mod problem;

use nalgebra::{SMatrix, SVector, Vector2};

use super::picture::{Bell, Picture};
use problem::{Background, CONSTANT, EDGE_BLUR, Pixel, Problem};
pub(super) use problem::{REACH, Window, axis};

/// A lamp's picture is not quite a Gaussian: what that leaves, as a part of its height, is no background.
const SHAPE: f64 = 0.03;
/// By how much an edge must beat the other backgrounds to be named, in variances of the noise.
const NAMED: f64 = 4.0;
/// Directions and distances at which an edge is looked for.
const EDGE_STARTS: (usize, usize) = (8, 9);

/// Where a fit starts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Guess {
    pub u: f64,
    pub v: f64,
    pub sigma: f64,
}

/// The fitted Gaussian.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub u: f64,
    pub v: f64,
    pub sd_u: f64,
    pub sd_v: f64,
    pub amplitude: f64,
    pub sigma: f64,
    pub background: f64,
    /// How much the background changes over the window, grey values.
    pub variation: f64,
    /// Noise that the standard deviations stand on: the picture's, or what the fit left if that is more.
    pub noise: f64,
    /// Root mean square of what the fit left, grey values.
    pub residual: f64,
    /// Pixels used beyond the parameters.
    pub degrees_of_freedom: f64,
    /// Pixels left out because they were saturated.
    pub saturated: usize,
    /// Whether an edge of something else lies behind it.
    pub structured: bool,
    pub window: Window,
}

impl Fit {
    pub(super) fn bell(&self) -> Bell {
        Bell {
            u: self.u,
            v: self.v,
            amplitude: self.amplitude,
            sigma: self.sigma,
        }
    }
}

/// What a background would lower the sum of squares of a fit on a constant by, to first order, without fitting it.
struct Scores {
    /// The derivatives of the fit on a constant, pixel by pixel, and what it cannot explain (seen minus model, to first
    /// order).
    rows: Vec<([f64; CONSTANT], f64)>,
    inverse: SMatrix<f64, CONSTANT, CONSTANT>,
}

impl Scores {
    fn of(constant: &Problem) -> Option<Self> {
        let mut rows = Vec::with_capacity(constant.used());
        let mut normal = SMatrix::<f64, CONSTANT, CONSTANT>::zeros();
        let mut right = SVector::<f64, CONSTANT>::zeros();
        constant.for_each(|value, model, slope| {
            let slope: [f64; CONSTANT] =
                std::array::from_fn(|k| slope.get(k).copied().unwrap_or(0.0));
            for (i, a) in slope.iter().enumerate() {
                for (j, b) in slope.iter().enumerate() {
                    normal[(i, j)] += a * b;
                }
                right[i] += a * (value - model);
            }
            rows.push((slope, value - model));
        });
        let inverse = normal.try_inverse()?;
        let step = inverse * right;
        for (slope, left) in &mut rows {
            *left -= slope.iter().zip(&step).map(|(a, b)| a * b).sum::<f64>();
        }
        Some(Self { rows, inverse })
    }

    /// By how much a background of this form, pixel by pixel, lowers the sum of squares, and its height then.
    fn lowered(&self, form: impl Iterator<Item = f64>) -> (f64, f64) {
        let (mut by_left, mut square, mut by_slopes) = (0.0, 0.0, [0.0; CONSTANT]);
        for ((slope, left), value) in self.rows.iter().zip(form) {
            by_left += value * left;
            square += value * value;
            for (sum, one) in by_slopes.iter_mut().zip(slope) {
                *sum += one * value;
            }
        }
        let by_slopes = SVector::from(by_slopes);
        let own = square - by_slopes.dot(&(self.inverse * by_slopes));
        // What the Gaussian on a constant can be itself is nothing new.
        if own > 1e-6 * square {
            (by_left * by_left / own, by_left / own)
        } else {
            (0.0, 0.0)
        }
    }

    fn of_plane(&self, pixels: &[Pixel]) -> f64 {
        let along = |k: usize| self.lowered(pixels.iter().map(move |p| p.from_middle[k])).0;
        along(0) + along(1)
    }

    /// The best place of an edge: what it lowers the sum by, and its parameters.
    fn of_edge(&self, pixels: &[Pixel], reach: f64) -> (f64, [f64; 5]) {
        let (directions, distances) = EDGE_STARTS;
        let blur = EDGE_BLUR.0;
        let mut best = (0.0, [0.0; 5]);
        for turn in 0..directions {
            let angle = std::f64::consts::PI * turn as f64 / directions as f64;
            let (sine, cosine) = angle.sin_cos();
            for step in 0..distances {
                let part = 2.0 * (step as f64 + 0.5) / distances as f64 - 1.0;
                let distance = part * reach;
                // A ramp as steep as the blurred edge is near enough to find its place.
                let steep = 1.0 / (blur * std::f64::consts::TAU.sqrt());
                let form = pixels.iter().map(|pixel| {
                    let at = pixel.from_middle.x * cosine + pixel.from_middle.y * sine;
                    (0.5 + steep * (at - distance)).clamp(0.0, 1.0)
                });
                let (lowered, height) = self.lowered(form);
                if lowered > best.0 {
                    best = (lowered, [height, angle, distance, blur.ln(), 0.0]);
                }
            }
        }
        best
    }
}

/// Fits a Gaussian around `guess`; if the width comes out far from the guess, once more in the right window.
///
/// # Errors
/// A clause that says what went wrong, with "it" for the spot.
pub(super) fn fit(picture: &Picture<'_>, guess: Guess, noise: f64) -> Result<Fit, String> {
    let initial = Problem::new(picture, guess)?;
    let constant = initial.clone().solved();
    // Before something large, a Gaussian on a constant takes that for its own, and runs away.
    let (found, better) = if constant.is_near(&guess) {
        let [u, v, _, log, _] = constant.own();
        let sigma = log.exp();
        (Err(constant), Guess { u, v, sigma })
    } else {
        let fit = on_backgrounds(&initial, constant, noise)?;
        let (u, v, sigma) = (fit.u, fit.v, fit.sigma);
        (Ok(fit), Guess { u, v, sigma })
    };
    let better = Guess {
        sigma: better.sigma.clamp(0.3, 2.0 * guess.sigma + 1.0),
        ..better
    };
    if Window::around(picture, better) == initial.window {
        return found.or_else(|constant| on_backgrounds(&initial, constant, noise));
    }
    let initial = Problem::new(picture, better)?;
    let constant = initial.clone().solved();
    on_backgrounds(&initial, constant, noise)
}

/// The fit on a constant and those on the backgrounds that may explain more, as one.
fn on_backgrounds(initial: &Problem, constant: Problem, picture_noise: f64) -> Result<Fit, String> {
    let rms = |problem: &Problem| (problem.squares() / problem.degrees_of_freedom()).sqrt();
    let [u, v, _, log, _] = initial.own();
    let sigma = log.exp();
    let base = if constant.is_near(&Guess { u, v, sigma }) {
        &constant
    } else {
        initial
    };
    let mut more = Vec::new();
    if let Some(scores) = Scores::of(base) {
        let [_, _, amplitude, log, _] = base.own();
        let spread = picture_noise.powi(2) + (SHAPE * amplitude).powi(2);
        let worth =
            |background: Background, lowered: f64| lowered > (background.price() - 2.0) * spread;
        if worth(Background::Plane, scores.of_plane(&base.pixels)) {
            more.push(base.on(Background::Plane, &[0.0, 0.0], 0.0));
        }
        let reach = (REACH * log.exp()).min(base.window.middle().1);
        let (lowered, place) = scores.of_edge(&base.pixels, reach);
        if worth(Background::Edge, lowered) {
            more.push(base.on(Background::Edge, &place, picture_noise));
        }
    }
    let mut tried = vec![constant];
    tried.extend(more.into_iter().map(Problem::solved));
    tried.retain(Problem::is_spot);
    let residuals: Vec<f64> = tried.iter().map(rms).collect();
    let least = residuals.iter().copied().fold(f64::INFINITY, f64::min);
    let mut members = Vec::new();
    for (problem, residual) in tried.iter().zip(residuals) {
        let Some(unit) = problem.covariance() else {
            continue;
        };
        let [u, v, amplitude, ..] = problem.own();
        let spread = picture_noise.max(least).powi(2) + (SHAPE * amplitude).powi(2);
        members.push(Member {
            problem,
            residual,
            noise: picture_noise.max(residual),
            spread: effective_noise(picture_noise, residual, problem),
            centre: Vector2::new(u, v),
            unit: unit.diagonal(),
            cost: problem.squares() / spread + problem.background.price(),
        });
    }
    average(&members).ok_or_else(|| "its fit left the window, or is not determined".to_owned())
}

/// The noise that the centre is uncertain by. What a fit leaves beyond the picture's noise is no noise: it holds together over
/// patches as large as the spot, and so counts as many times as that has pixels.
fn effective_noise(noise: f64, residual: f64, problem: &Problem) -> f64 {
    let [_, _, _, log, _] = problem.own();
    let by_chance = 1.0 + 3.0 * (2.0 / problem.degrees_of_freedom()).sqrt();
    let structure = (residual.powi(2) - noise.powi(2) * by_chance).max(0.0);
    let patch = (std::f64::consts::TAU * log.exp().powi(2)).max(1.0);
    (noise.max(residual).powi(2) + structure * patch).sqrt()
}

/// A fit on one background.
struct Member<'a> {
    problem: &'a Problem,
    residual: f64,
    noise: f64,
    /// Noise that the centre is uncertain by.
    spread: f64,
    centre: Vector2<f64>,
    /// Variances of the centre for a noise of 1.
    unit: Vector2<f64>,
    /// Akaike's information criterion, less what all have.
    cost: f64,
}

fn average(members: &[Member<'_>]) -> Option<Fit> {
    let best = members.iter().min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let weight = |member: &Member<'_>| (-0.5 * (member.cost - best.cost)).exp();
    let all: f64 = members.iter().map(weight).sum();
    let mut centre = Vector2::zeros();
    for member in members {
        centre += member.centre * (weight(member) / all);
    }
    let mut variance = Vector2::zeros();
    for member in members {
        let off = member.centre - centre;
        let own = member.unit * member.spread.powi(2) + off.component_mul(&off);
        variance += own * (weight(member) / all);
    }
    let problem = best.problem;
    let [u, v, amplitude, log, constant] = problem.own();
    let (middle, _) = problem.window.middle();
    let (behind, _) = problem.behind(&(Vector2::new(u, v) - middle));
    let others = members
        .iter()
        .filter(|one| one.problem.background != Background::Edge);
    let beaten = others.fold(f64::INFINITY, |least, one| least.min(one.cost)) - best.cost;
    let finite = variance.iter().all(|one| one.is_finite());
    finite.then(|| Fit {
        u: centre.x,
        v: centre.y,
        sd_u: variance.x.sqrt(),
        sd_v: variance.y.sqrt(),
        amplitude,
        sigma: log.exp(),
        background: constant + behind,
        variation: problem.variation(),
        noise: best.noise,
        residual: best.residual,
        degrees_of_freedom: problem.degrees_of_freedom(),
        saturated: problem.saturated,
        structured: problem.background == Background::Edge && beaten > NAMED,
        window: problem.window,
    })
}
