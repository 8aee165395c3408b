//! Least-squares fit of a round Gaussian to the pixels around a spot, on the background that is there.
//!
//! Three backgrounds are fitted with it: a constant, a plane, and an edge (a constant on either side of a line
//! that may bend). The centre is their mean, each weighted by how well it explains the pixels (Akaike's weights), and its
//! variance holds what they disagree on (K. Burnham and D. Anderson, Sociological Methods and Research 33, 2004).

use nalgebra::{DVector, Matrix2, SMatrix, SVector, Vector2};

use super::picture::{Bell, Picture};

/// The window reaches this many widths from the centre.
pub(super) const REACH: f64 = 3.5;
/// A fit that has not settled after this many evaluations per parameter will not.
const PATIENCE: usize = 10;
/// Parameters of the Gaussian on a constant.
const CONSTANT: usize = 5;
/// Most parameters.
const MOST: usize = 10;
/// A lamp's picture is not quite a Gaussian: what that leaves, as a part of its height, is no background.
const SHAPE: f64 = 0.03;
/// How sharp an edge is expected to be, px (the σ of its blur), and how far, as a factor's logarithm, it may differ.
const EDGE_BLUR: (f64, f64) = (0.7, 0.7);
/// How much an edge is expected to bend, 1/px.
const EDGE_BEND: f64 = 0.1;
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

/// The pixels of a fit: columns and rows, ends excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub u: (usize, usize),
    pub v: (usize, usize),
    /// Whether the picture's border cuts it.
    pub cut: bool,
}

impl Window {
    fn around(picture: &Picture<'_>, guess: Guess) -> Self {
        let reach = (REACH * guess.sigma).ceil() + 1.0;
        let axis = |at: f64, size: usize| {
            let (low, high) = ((at - reach).round(), (at + reach).round());
            let cut = low < 0.0 || high >= size as f64;
            // Saturating casts: a negative start becomes 0.
            ((low as usize, (high as usize + 1).min(size)), cut)
        };
        let (u, cut_u) = axis(guess.u, picture.width());
        let (v, cut_v) = axis(guess.v, picture.height());
        Self {
            u,
            v,
            cut: cut_u || cut_v,
        }
    }

    /// Its middle, from which its backgrounds are counted, and half its diagonal.
    fn middle(&self) -> (Vector2<f64>, f64) {
        let half = |(low, high): (usize, usize)| {
            let (low, high) = (low as f64, high as f64 - 1.0);
            (0.5 * (low + high), 0.5 * (high - low))
        };
        let ((u, half_u), (v, half_v)) = (half(self.u), half(self.v));
        (Vector2::new(u, v), half_u.hypot(half_v))
    }
}

/// What stands behind the spot. The parameters of each follow those of the Gaussian on a constant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Background {
    /// Nothing more.
    Constant,
    /// Slopes along u and v, grey values per px.
    Plane,
    /// Height (grey values), direction (rad), distance from the window's middle (px), logarithm of its blur (px), bend (1/px).
    Edge,
}

impl Background {
    fn parameters(self) -> usize {
        match self {
            Self::Constant => CONSTANT,
            Self::Plane => CONSTANT + 2,
            Self::Edge => CONSTANT + 5,
        }
    }

    /// By how much it must lower the sum of squares, in variances of the noise, to weigh as much as the constant: two
    /// for each parameter (Akaike), and for the edge what the best of many places lowers it by chance.
    fn price(self) -> f64 {
        match self {
            Self::Constant => 0.0,
            Self::Plane => 4.0,
            Self::Edge => 14.0,
        }
    }
}

/// A pixel of the window.
#[derive(Clone, Copy)]
struct Pixel {
    /// Column and row, from the first of the window.
    at: (usize, usize),
    /// From the middle of the window, px.
    from_middle: Vector2<f64>,
    value: f64,
}

#[derive(Clone)]
struct Problem {
    /// u, v, amplitude, logarithm of the width (so that it stays positive), constant; then the background's.
    parameters: DVector<f64>,
    background: Background,
    window: Window,
    /// Those that are not saturated.
    pixels: Vec<Pixel>,
    saturated: usize,
    /// Weight of what is expected of an edge, grey values.
    expected: f64,
}

/// One axis of the Gaussian: pixel mean, its derivative by the centre, and by the logarithm of the width. A pixel's
/// value is the mean over its square, which for narrow spots differs from the value at its middle.
pub(super) fn axis(range: (usize, usize), centre: f64, sigma: f64) -> Vec<[f64; 3]> {
    let bell = |t: f64| (-0.5 * t * t).exp();
    let area = (0.5 * std::f64::consts::PI).sqrt();
    let per_pixel = |pixel: usize| {
        let (a, b) = (
            (pixel as f64 - 0.5 - centre) / sigma,
            (pixel as f64 + 0.5 - centre) / sigma,
        );
        let root = std::f64::consts::SQRT_2;
        let mean = sigma * area * (libm::erf(b / root) - libm::erf(a / root));
        let (left, right) = (bell(a), bell(b));
        [mean, left - right, mean - sigma * (b * right - a * left)]
    };
    (range.0..range.1).map(per_pixel).collect()
}

/// The part of a blurred edge that lies below `t` blurs, and its derivative.
fn edge(t: f64) -> (f64, f64) {
    let root = std::f64::consts::SQRT_2;
    let density = (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
    (0.5 * (1.0 + libm::erf(t / root)), density)
}

impl Problem {
    fn new(picture: &Picture<'_>, guess: Guess) -> Result<Self, String> {
        let window = Window::around(picture, guess);
        let (middle, _) = window.middle();
        let (mut pixels, mut saturated) = (Vec::new(), 0);
        for v in window.v.0..window.v.1 {
            for u in window.u.0..window.u.1 {
                let Some(value) = picture.value(u, v) else {
                    saturated += 1;
                    continue;
                };
                pixels.push(Pixel {
                    at: (u - window.u.0, v - window.v.0),
                    from_middle: Vector2::new(u as f64, v as f64) - middle,
                    value,
                });
            }
        }
        let used = pixels.len();
        if used < 12 {
            return Err(format!("only {used} usable pixels around it"));
        }
        let constant = border_median(&pixels, window);
        let peak = pixels.iter().map(|pixel| pixel.value);
        let peak = peak.fold(constant, f64::max);
        let top = if saturated > 0 {
            f64::from(super::SATURATED)
        } else {
            peak
        };
        let amplitude = (top - constant).max(1.0);
        Ok(Self {
            parameters: DVector::from_row_slice(&[
                guess.u,
                guess.v,
                amplitude,
                guess.sigma.ln(),
                constant,
            ]),
            background: Background::Constant,
            window,
            pixels,
            saturated,
            expected: 0.0,
        })
    }

    /// The same with another background, whose parameters are `more`.
    fn on(&self, background: Background, more: &[f64], expected: f64) -> Self {
        let own = self.parameters.iter().take(CONSTANT).chain(more).copied();
        Self {
            parameters: DVector::from_iterator(background.parameters(), own),
            background,
            expected,
            ..self.clone()
        }
    }

    /// The background without its constant at a place, and its derivatives by its parameters.
    fn behind(&self, from_middle: &Vector2<f64>) -> (f64, [f64; MOST - CONSTANT]) {
        let p = |k: usize| self.parameters.get(CONSTANT + k).copied().unwrap_or(0.0);
        match self.background {
            Background::Constant => (0.0, [0.0; 5]),
            Background::Plane => {
                let value = p(0) * from_middle.x + p(1) * from_middle.y;
                (value, [from_middle.x, from_middle.y, 0.0, 0.0, 0.0])
            }
            Background::Edge => {
                let (height, (sine, cosine), blur, bend) = (p(0), p(1).sin_cos(), p(3).exp(), p(4));
                let normal = from_middle.x * cosine + from_middle.y * sine;
                let along = from_middle.y * cosine - from_middle.x * sine;
                let across = (normal - p(2) + 0.5 * bend * along * along) / blur;
                let (part, slope) = edge(across);
                let steep = height * slope / blur;
                let slopes = [
                    part,
                    steep * along * (1.0 - bend * normal),
                    -steep,
                    -steep * blur * across,
                    0.5 * steep * along * along,
                ];
                (height * part, slopes)
            }
        }
    }

    /// Calls `each` with the value of a pixel, the model's, and the model's derivatives.
    fn for_each(&self, mut each: impl FnMut(f64, f64, &[f64])) {
        let p = |k: usize| self.parameters.get(k).copied().unwrap_or(0.0);
        let (amplitude, sigma, constant) = (p(2), p(3).exp(), p(4));
        let along_u = axis(self.window.u, p(0), sigma);
        let along_v = axis(self.window.v, p(1), sigma);
        let count = self.background.parameters();
        for pixel in &self.pixels {
            let (Some(x), Some(y)) = (along_u.get(pixel.at.0), along_v.get(pixel.at.1)) else {
                continue;
            };
            let g = x[0] * y[0];
            let (behind, by_behind) = self.behind(&pixel.from_middle);
            let mut slope = [0.0; MOST];
            slope[0] = amplitude * x[1] * y[0];
            slope[1] = amplitude * x[0] * y[1];
            slope[2] = g;
            slope[3] = amplitude * (x[2] * y[0] + x[0] * y[2]);
            slope[4] = 1.0;
            slope[CONSTANT..].copy_from_slice(&by_behind);
            each(
                pixel.value,
                constant + behind + amplitude * g,
                &slope[..count],
            );
        }
    }

    /// What is expected of an edge's blur and bend, as more residuals: each with its parameter and its derivative by that.
    fn expectations(&self) -> Vec<(usize, f64, f64)> {
        if self.background != Background::Edge {
            return Vec::new();
        }
        let p = |k: usize| self.parameters.get(k).copied().unwrap_or(0.0);
        let (usual, spread) = EDGE_BLUR;
        let (blur, bend) = (self.expected / spread, self.expected / EDGE_BEND);
        vec![
            (MOST - 2, blur * (p(MOST - 2) - usual.ln()), blur),
            (MOST - 1, bend * p(MOST - 1), bend),
        ]
    }

    /// The place of least squares, by Levenberg's and Marquardt's method on the normal equations, which are small. How it
    /// ends does not matter: whether the result is a spot is judged by the result.
    fn solved(mut self) -> Self {
        let (mut squares, mut damping) = (self.cost(), 1e-3);
        if !squares.is_finite() {
            return self;
        }
        let free = self.background.parameters();
        let (mut normal, mut right) = self.equations();
        for _ in 0..PATIENCE * free {
            let mut damped = normal;
            for k in 0..MOST {
                // Those that are not free stay where they are.
                damped[(k, k)] = if k < free {
                    normal[(k, k)] * (1.0 + damping) + f64::MIN_POSITIVE
                } else {
                    1.0
                };
            }
            let step = damped.cholesky().map(|factor| factor.solve(&right));
            let next = step.map(|step| {
                let mut next = self.parameters.clone();
                next.iter_mut()
                    .zip(step.iter())
                    .for_each(|(to, by)| *to += by);
                (step, next)
            });
            let Some((step, next)) = next else {
                damping *= 10.0;
                continue;
            };
            let before = std::mem::replace(&mut self.parameters, next);
            let now = self.cost();
            if now.is_nan() || now > squares {
                self.parameters = before;
                damping *= 10.0;
                if damping > 1e9 {
                    break;
                }
                continue;
            }
            let fall = squares - now;
            let still = step.iter().zip(&self.parameters);
            let still = still
                .into_iter()
                .all(|(by, at)| by.abs() <= 1e-6 * at.abs().max(1e-3));
            squares = now;
            if fall <= 1e-8 * squares || still {
                break;
            }
            damping = (0.1 * damping).max(1e-9);
            (normal, right) = self.equations();
        }
        self
    }

    /// JᵀJ and -Jᵀr, with what is expected of an edge; 0 beyond the free parameters.
    fn equations(&self) -> (SMatrix<f64, MOST, MOST>, SVector<f64, MOST>) {
        let mut normal = SMatrix::<f64, MOST, MOST>::zeros();
        let mut right = SVector::<f64, MOST>::zeros();
        self.for_each(|value, model, slope| {
            for (i, a) in slope.iter().enumerate() {
                right[i] += a * (value - model);
                for (j, b) in slope.iter().enumerate().skip(i) {
                    normal[(j, i)] += a * b;
                }
            }
        });
        normal.fill_upper_triangle_with_lower_triangle();
        for (index, residual, weight) in self.expectations() {
            normal[(index, index)] += weight * weight;
            right[index] -= weight * residual;
        }
        (normal, right)
    }

    /// What is least at the solution: the sum of squares, with what is expected of an edge.
    fn cost(&self) -> f64 {
        let expected = self.expectations().into_iter();
        self.squares()
            + expected
                .map(|(_, residual, _)| residual * residual)
                .sum::<f64>()
    }

    fn used(&self) -> usize {
        self.pixels.len()
    }

    /// Pixels beyond the parameters.
    fn degrees_of_freedom(&self) -> f64 {
        let free = self.background.parameters();
        self.used().saturating_sub(free).max(1) as f64
    }

    fn squares(&self) -> f64 {
        let mut squares = 0.0;
        self.for_each(|value, model, _| squares += (model - value).powi(2));
        squares
    }

    /// (JᵀJ)⁻¹ of the centre.
    fn covariance(&self) -> Option<Matrix2<f64>> {
        let free = self.background.parameters();
        let (normal, _) = self.equations();
        let normal = normal.view((0, 0), (free, free)).into_owned();
        let inverse = normal.try_inverse()?;
        let block = inverse.fixed_view::<2, 2>(0, 0).into_owned();
        let right = block.iter().all(|entry| entry.is_finite());
        (right && block[(0, 0)] > 0.0 && block[(1, 1)] > 0.0).then_some(block)
    }

    fn is_spot(&self) -> bool {
        let [u, v, amplitude, log, _] = self.own();
        let inside = |at: f64, range: (usize, usize)| {
            at >= range.0 as f64 - 0.5 && at <= range.1 as f64 - 0.5
        };
        inside(u, self.window.u)
            && inside(v, self.window.v)
            && amplitude > 0.0
            && log.exp().is_finite()
    }

    /// Whether it has stayed about where it started, and about as wide.
    fn is_near(&self, guess: &Guess) -> bool {
        let [u, v, _, log, _] = self.own();
        let sigma = log.exp();
        self.is_spot()
            && (u - guess.u).hypot(v - guess.v) < 1.0 + 0.5 * guess.sigma
            && sigma < 1.7 * guess.sigma + 0.5
    }

    /// The parameters of the Gaussian on a constant.
    fn own(&self) -> [f64; CONSTANT] {
        std::array::from_fn(|k| self.parameters.get(k).copied().unwrap_or(f64::NAN))
    }

    /// The least and the most of the background in the window.
    fn variation(&self) -> f64 {
        let behind = self
            .pixels
            .iter()
            .map(|pixel| self.behind(&pixel.from_middle).0);
        let (low, high) = behind.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        high - low
    }
}

/// The median of the values on the window's rim.
fn border_median(pixels: &[Pixel], window: Window) -> f64 {
    let columns = window.u.1.saturating_sub(window.u.0);
    let rows = window.v.1.saturating_sub(window.v.0);
    let on_rim = |(u, v): (usize, usize)| u == 0 || v == 0 || u + 1 == columns || v + 1 == rows;
    let mut rim: Vec<f64> = pixels
        .iter()
        .filter(|pixel| on_rim(pixel.at))
        .map(|pixel| pixel.value)
        .collect();
    rim.sort_by(f64::total_cmp);
    rim.get(rim.len() / 2).copied().unwrap_or(0.0)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spot::tests::frame;

    #[test]
    fn the_jacobian_is_right_on_every_background() {
        let pixels = (0..169).map(|k| (k * 37 % 200) as u8).collect();
        let picture = frame(13, 13, pixels);
        let picture = Picture::of(&picture);
        let guess = Guess {
            u: 6.2,
            v: 5.7,
            sigma: 1.3,
        };
        let constant = Problem::new(&picture, guess).unwrap();
        let plane = constant.on(Background::Plane, &[0.7, -0.4], 0.0);
        let edge = constant.on(Background::Edge, &[20.0, 0.6, 1.3, 0.2, 0.05], 3.0);
        const STEP: f64 = 1e-5;
        for problem in [constant, plane, edge] {
            let models = |problem: &Problem| {
                let mut models = Vec::new();
                problem.for_each(|_, model, _| models.push(model));
                models
            };
            let mut slopes: Vec<Vec<f64>> = Vec::new();
            problem.for_each(|_, _, slope| slopes.push(slope.to_vec()));
            for k in 0..problem.background.parameters() {
                let moved = |by: f64| {
                    let mut other = problem.clone();
                    other.parameters[k] += by;
                    models(&other)
                };
                let both = moved(STEP).into_iter().zip(moved(-STEP)).zip(&slopes);
                for ((more, less), slope) in both {
                    let (numeric, exact) = ((more - less) / (2.0 * STEP), slope[k]);
                    let off = (numeric - exact).abs();
                    assert!(
                        off < 1e-4 * (1.0 + exact.abs()),
                        "{:?} {k}: {numeric} {exact}",
                        problem.background
                    );
                }
            }
        }
    }

    #[test]
    fn a_pixel_is_the_mean_over_its_square() {
        for sigma in [0.3, 0.6, 2.0] {
            let rows = axis((0, 9), 4.3, sigma);
            for (pixel, [mean, ..]) in rows.iter().enumerate() {
                let parts = 2000;
                let sum: f64 = (0..parts)
                    .map(|k| {
                        let at = pixel as f64 - 0.5 + (f64::from(k) + 0.5) / f64::from(parts);
                        (-0.5 * ((at - 4.3) / sigma).powi(2)).exp()
                    })
                    .sum();
                assert!(
                    (mean - sum / f64::from(parts)).abs() < 1e-6,
                    "{sigma} {pixel}"
                );
            }
        }
    }
}
