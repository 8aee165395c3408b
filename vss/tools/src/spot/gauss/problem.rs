//! A round Gaussian on a background, and the pixels that it is fitted to: its value, its derivatives, and the place of least
//! squares.

use nalgebra::{DVector, Matrix2, SMatrix, SVector, Vector2};

use super::{
    super::{SATURATED, picture::Picture},
    Guess,
};

/// The window reaches this many widths from the centre.
pub(in crate::spot) const REACH: f64 = 3.5;
/// A fit that has not settled after this many evaluations per parameter will not.
const PATIENCE: usize = 10;
/// Pixels of a fit, about. Of a larger window every second, third and so on row and column is fitted, so that nothing large
/// takes long.
const PIXELS: usize = 2048;
/// Parameters of the Gaussian on a constant.
pub(super) const CONSTANT: usize = 5;
/// Most parameters.
const MOST: usize = 10;
/// How sharp an edge is expected to be, px (the σ of its blur), and how far, as a factor's logarithm, it may differ.
pub(super) const EDGE_BLUR: (f64, f64) = (0.7, 0.7);
/// How much an edge is expected to bend, 1/px.
const EDGE_BEND: f64 = 0.1;

/// The pixels of a fit: columns and rows, ends excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::spot) struct Window {
    pub u: (usize, usize),
    pub v: (usize, usize),
    /// Whether the picture's border cuts it.
    pub cut: bool,
}

impl Window {
    pub fn around(picture: &Picture<'_>, guess: Guess) -> Self {
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
    pub fn middle(&self) -> (Vector2<f64>, f64) {
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
pub(super) enum Background {
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
    pub fn price(self) -> f64 {
        match self {
            Self::Constant => 0.0,
            Self::Plane => 4.0,
            Self::Edge => 14.0,
        }
    }
}

/// A pixel of the window.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    /// Column and row, from the first of the window.
    at: (usize, usize),
    /// From the middle of the window, px.
    pub from_middle: Vector2<f64>,
    value: f64,
}

#[derive(Clone)]
pub(super) struct Problem {
    /// u, v, amplitude, logarithm of the width (so that it stays positive), constant; then the background's.
    parameters: DVector<f64>,
    pub background: Background,
    pub window: Window,
    /// Those that are not saturated.
    pub pixels: Vec<Pixel>,
    pub saturated: usize,
    /// Weight of what is expected of an edge, grey values.
    expected: f64,
}

/// One axis of the Gaussian: pixel mean, its derivative by the centre, and by the logarithm of the width. A pixel's
/// value is the mean over its square, which for narrow spots differs from the value at its middle.
pub(in crate::spot) fn axis(range: (usize, usize), centre: f64, sigma: f64) -> Vec<[f64; 3]> {
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
    pub fn new(picture: &Picture<'_>, guess: Guess) -> Result<Self, String> {
        let window = Window::around(picture, guess);
        let (middle, _) = window.middle();
        let (mut pixels, mut saturated) = (Vec::new(), 0);
        let side = |(first, end): (usize, usize)| end.saturating_sub(first);
        let all = side(window.u) * side(window.v);
        let stride = ((all as f64 / PIXELS as f64).sqrt().ceil() as usize).max(1);
        for v in (window.v.0..window.v.1).step_by(stride) {
            for u in (window.u.0..window.u.1).step_by(stride) {
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
            f64::from(SATURATED)
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
    pub fn on(&self, background: Background, more: &[f64], expected: f64) -> Self {
        let own = self.parameters.iter().take(CONSTANT).chain(more).copied();
        Self {
            parameters: DVector::from_iterator(background.parameters(), own),
            background,
            expected,
            ..self.clone()
        }
    }

    /// The background without its constant at a place, and its derivatives by its parameters.
    pub fn behind(&self, from_middle: &Vector2<f64>) -> (f64, [f64; MOST - CONSTANT]) {
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
    pub fn for_each(&self, mut each: impl FnMut(f64, f64, &[f64])) {
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
    pub fn solved(mut self) -> Self {
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

    pub fn used(&self) -> usize {
        self.pixels.len()
    }

    /// Pixels beyond the parameters.
    pub fn degrees_of_freedom(&self) -> f64 {
        let free = self.background.parameters();
        self.used().saturating_sub(free).max(1) as f64
    }

    pub fn squares(&self) -> f64 {
        let mut squares = 0.0;
        self.for_each(|value, model, _| squares += (model - value).powi(2));
        squares
    }

    /// (JᵀJ)⁻¹ of the centre.
    pub fn covariance(&self) -> Option<Matrix2<f64>> {
        let free = self.background.parameters();
        let (normal, _) = self.equations();
        let normal = normal.view((0, 0), (free, free)).into_owned();
        let inverse = normal.try_inverse()?;
        let block = inverse.fixed_view::<2, 2>(0, 0).into_owned();
        let right = block.iter().all(|entry| entry.is_finite());
        (right && block[(0, 0)] > 0.0 && block[(1, 1)] > 0.0).then_some(block)
    }

    pub fn is_spot(&self) -> bool {
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
    pub fn is_near(&self, guess: &Guess) -> bool {
        let [u, v, _, log, _] = self.own();
        let sigma = log.exp();
        self.is_spot()
            && (u - guess.u).hypot(v - guess.v) < 1.0 + 0.5 * guess.sigma
            && sigma < 1.7 * guess.sigma + 0.5
    }

    /// The parameters of the Gaussian on a constant.
    pub fn own(&self) -> [f64; CONSTANT] {
        std::array::from_fn(|k| self.parameters.get(k).copied().unwrap_or(f64::NAN))
    }

    /// The least and the most of the background in the window.
    pub fn variation(&self) -> f64 {
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
