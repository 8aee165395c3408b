//! Least-squares fit of a round Gaussian on a constant background to the pixels around a spot.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{Dyn, Matrix5, OMatrix, OVector, U5, Vector5, storage::Owned};

use super::SATURATED;
use crate::frame::Frame;

/// Nodes and weights of the 3-point Gauss-Legendre rule on [-½, ½]: a pixel's value is the mean over its square,
/// which for narrow spots differs from the value at its middle.
const NODES: [(f64, f64); 3] = [
    (-0.387_298_334_620_741_7, 5.0 / 18.0),
    (0.0, 8.0 / 18.0),
    (0.387_298_334_620_741_7, 5.0 / 18.0),
];
/// The window reaches this many widths from the centre.
const REACH: f64 = 3.5;
/// A fit that has not settled after this many evaluations per parameter will not.
const PATIENCE: usize = 10;

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
    /// Noise that the standard deviations stand on: the picture's, or what the fit left if that is more.
    pub noise: f64,
    /// Root mean square of what the fit left, grey values.
    pub residual: f64,
    /// Pixels used beyond the parameters.
    pub degrees_of_freedom: f64,
    /// Pixels left out because they were saturated.
    pub saturated: usize,
    pub window: Window,
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
    fn around(frame: &Frame, guess: Guess) -> Self {
        let reach = (REACH * guess.sigma).ceil() + 1.0;
        let axis = |at: f64, size: usize| {
            let (low, high) = ((at - reach).round(), (at + reach).round());
            let cut = low < 0.0 || high >= size as f64;
            // Saturating casts: a negative start becomes 0.
            ((low as usize, (high as usize + 1).min(size)), cut)
        };
        let (u, cut_u) = axis(guess.u, frame.width);
        let (v, cut_v) = axis(guess.v, frame.height);
        Self {
            u,
            v,
            cut: cut_u || cut_v,
        }
    }
}

struct Problem {
    /// u, v, amplitude, log of the width (so that it stays positive), background.
    parameters: Vector5<f64>,
    window: Window,
    /// Row by row; `None` where saturated.
    values: Vec<Option<f64>>,
    used: usize,
}

/// One axis of the Gaussian: pixel mean, its derivative by the centre, and by the log of the width.
fn axis(range: (usize, usize), centre: f64, sigma: f64) -> Vec<[f64; 3]> {
    let per_pixel = |pixel: usize| {
        NODES.iter().fold([0.0; 3], |sum, (node, weight)| {
            let d = (pixel as f64 + node - centre) / sigma;
            let g = weight * (-0.5 * d * d).exp();
            [sum[0] + g, sum[1] + g * d / sigma, sum[2] + g * d * d]
        })
    };
    (range.0..range.1).map(per_pixel).collect()
}

impl Problem {
    fn new(frame: &Frame, guess: Guess) -> Result<Self, String> {
        let window = Window::around(frame, guess);
        let mut values = Vec::new();
        for v in window.v.0..window.v.1 {
            for u in window.u.0..window.u.1 {
                let value = frame.get(u, v).filter(|value| *value < SATURATED);
                values.push(value.map(f64::from));
            }
        }
        let used = values.iter().flatten().count();
        if used < 12 {
            return Err(format!("only {used} usable pixels around it"));
        }
        let background = border_median(&values, window);
        let peak = values.iter().flatten().copied().fold(background, f64::max);
        let amplitude = if used < values.len() {
            f64::from(SATURATED)
        } else {
            peak
        } - background;
        let parameters = Vector5::new(
            guess.u,
            guess.v,
            amplitude.max(1.0),
            guess.sigma.ln(),
            background,
        );
        Ok(Self {
            parameters,
            window,
            values,
            used,
        })
    }

    /// Calls `each` with the value of a pixel, the model's, and the model's derivatives.
    fn for_each(&self, mut each: impl FnMut(f64, f64, [f64; 5])) {
        let [cu, cv, amplitude, log_sigma, background] = self.parameters.into();
        let sigma = log_sigma.exp();
        let along_u = axis(self.window.u, cu, sigma);
        let along_v = axis(self.window.v, cv, sigma);
        let grid = along_v
            .iter()
            .flat_map(|y| along_u.iter().map(move |x| (x, y)));
        for (value, (x, y)) in self.values.iter().zip(grid) {
            if let Some(value) = value {
                let g = x[0] * y[0];
                let slope = [
                    amplitude * x[1] * y[0],
                    amplitude * x[0] * y[1],
                    g,
                    amplitude * (x[2] * y[0] + x[0] * y[2]),
                    1.0,
                ];
                each(*value, background + amplitude * g, slope);
            }
        }
    }

    /// JᵀJ and the sum of squares.
    fn normal_matrix(&self) -> (Matrix5<f64>, f64) {
        let (mut normal, mut squares) = (Matrix5::zeros(), 0.0);
        self.for_each(|value, model, slope| {
            let slope = Vector5::from(slope);
            normal += slope * slope.transpose();
            squares += (model - value).powi(2);
        });
        (normal, squares)
    }
}

/// The median of the values on the window's rim.
fn border_median(values: &[Option<f64>], window: Window) -> f64 {
    let columns = window.u.1.saturating_sub(window.u.0);
    let rows = window.v.1.saturating_sub(window.v.0);
    let on_rim = |index: usize| {
        let (u, v) = (index % columns.max(1), index / columns.max(1));
        u == 0 || v == 0 || u + 1 == columns || v + 1 == rows
    };
    let mut rim: Vec<f64> = values
        .iter()
        .enumerate()
        .filter(|(index, _)| on_rim(*index))
        .filter_map(|(_, v)| *v)
        .collect();
    rim.sort_by(f64::total_cmp);
    rim.get(rim.len() / 2).copied().unwrap_or(0.0)
}

impl LeastSquaresProblem<f64, Dyn, U5> for Problem {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, U5>;
    type ParameterStorage = Owned<f64, U5>;

    fn set_params(&mut self, x: &Vector5<f64>) {
        self.parameters = *x;
    }

    fn params(&self) -> Vector5<f64> {
        self.parameters
    }

    fn residuals(&self) -> Option<OVector<f64, Dyn>> {
        let mut residuals = Vec::with_capacity(self.used);
        self.for_each(|value, model, _| residuals.push(model - value));
        let finite = residuals.iter().all(|r| r.is_finite());
        finite.then(|| OVector::<f64, Dyn>::from_vec(residuals))
    }

    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, U5>> {
        let mut rows = Vec::with_capacity(5 * self.used);
        self.for_each(|_, _, slope| rows.extend(slope));
        let finite = rows.iter().all(|r| r.is_finite());
        finite.then(|| OMatrix::<f64, Dyn, U5>::from_row_slice(&rows))
    }
}

/// Fits a Gaussian around `guess`; if the width comes out far from the guess, once more in the right window.
///
/// # Errors
/// A clause that says what went wrong, with "it" for the spot.
pub(super) fn fit(frame: &Frame, guess: Guess, picture_noise: f64) -> Result<Fit, String> {
    let first = fit_in_window(frame, guess, picture_noise)?;
    let window = Window::around(frame, guess);
    let better = Guess {
        u: first.u,
        v: first.v,
        sigma: first.sigma.clamp(0.3, 2.0 * guess.sigma + 1.0),
    };
    if Window::around(frame, better) == window {
        return Ok(first);
    }
    fit_in_window(frame, better, picture_noise)
}

fn fit_in_window(frame: &Frame, guess: Guess, picture_noise: f64) -> Result<Fit, String> {
    let problem = Problem::new(frame, guess)?;
    let method = LevenbergMarquardt::new()
        .with_patience(PATIENCE)
        .with_ftol(1e-8)
        .with_xtol(1e-6);
    // How it ended does not matter: whether the result is a spot is judged by the result.
    let (problem, _) = method.minimize(problem);
    let [u, v, amplitude, log_sigma, background] = problem.parameters.into();
    let sigma = log_sigma.exp();
    let window = problem.window;
    let inside =
        |at: f64, range: (usize, usize)| at >= range.0 as f64 - 0.5 && at <= range.1 as f64 - 0.5;
    if !(inside(u, window.u) && inside(v, window.v) && amplitude > 0.0 && sigma.is_finite()) {
        return Err("its fit left the window".to_owned());
    }
    let (normal, squares) = problem.normal_matrix();
    let degrees_of_freedom = problem.used.saturating_sub(5).max(1) as f64;
    let residual = (squares / degrees_of_freedom).sqrt();
    let noise = picture_noise.max(residual);
    let covariance = normal.try_inverse().ok_or("its fit is not determined")?;
    let (sd_u, sd_v) = (
        noise * covariance[(0, 0)].sqrt(),
        noise * covariance[(1, 1)].sqrt(),
    );
    if !(sd_u.is_finite() && sd_v.is_finite()) {
        return Err("its fit is not determined".to_owned());
    }
    let saturated = problem.values.len() - problem.used;
    Ok(Fit {
        u,
        v,
        sd_u,
        sd_v,
        amplitude,
        sigma,
        background,
        noise,
        residual,
        degrees_of_freedom,
        saturated,
        window,
    })
}
