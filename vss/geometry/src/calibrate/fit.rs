//! Least-squares fits of a camera to rows of the table, plain or with a Cauchy loss.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Vector2, Vector3, storage::Owned};

use super::{CalibrationError, LEAST_NOISE_PX, LensModel, LightPoint, held::Held};
use crate::camera::{Camera, Distortion, PARAMETERS};

/// Turns a median of absolute normal deviates into their standard deviation.
const MEDIAN_TO_SD: f64 = 1.482_602_218_505_602;

/// Turns what 70 % of absolute normal deviates are below into their standard deviation.
const PART_TO_SD: f64 = 0.964_847_3;

/// Seen minus predicted, px; infinite where there is no prediction.
pub(super) fn residual(camera: &Camera, point: &LightPoint) -> Vector2<f64> {
    let predicted = camera.project_unchecked(&point.position());
    predicted.map_or(Vector2::repeat(f64::INFINITY), |pixel| {
        point.pixel() - pixel
    })
}

/// Standard deviation of the noise per coordinate from the median absolute residual of the `used` rows, widened
/// for the `parameters` that a fit took out of them; never below [`LEAST_NOISE_PX`].
///
/// With few rows a robust fit can make as many residuals vanish as it has parameters, and the median with them;
/// then the median of the others is taken, which is rather too large than too small.
pub(super) fn noise_of(
    camera: &Camera,
    table: &[LightPoint],
    used: &[usize],
    parameters: usize,
) -> f64 {
    let rows = used.iter().filter_map(|row| table.get(*row));
    let mut sizes: Vec<f64> = rows
        .flat_map(|point| <[f64; 2]>::from(residual(camera, point)))
        .map(f64::abs)
        .collect();
    sizes.sort_by(f64::total_cmp);
    let equations = sizes.len();
    let spare = equations.saturating_sub(parameters).max(1);
    let vanishing = if equations < 4 * parameters {
        equations - spare.min(equations)
    } else {
        0
    };
    let middle = sizes
        .get(vanishing + (equations - vanishing) / 2)
        .or(sizes.last());
    let widened = middle.copied().unwrap_or(0.0) * (equations as f64 / spare as f64).sqrt();
    (MEDIAN_TO_SD * widened).max(LEAST_NOISE_PX)
}

/// Where rejection begins: the noise that 70 % of the residuals mean, for at least so many points are right. With points of
/// two noise levels it is larger than [`noise_of`], whose median lies among the better half; with more wrong points than
/// that it is bounded by it.
pub(super) fn wide_noise_of(camera: &Camera, table: &[LightPoint], parameters: usize) -> f64 {
    let mut sizes: Vec<f64> = table
        .iter()
        .flat_map(|point| <[f64; 2]>::from(residual(camera, point)))
        .map(f64::abs)
        .collect();
    sizes.sort_by(f64::total_cmp);
    let all: Vec<usize> = (0..table.len()).collect();
    let noise = noise_of(camera, table, &all, parameters);
    let wide = sizes.get(sizes.len() * 7 / 10).copied().unwrap_or_default() * PART_TO_SD;
    wide.clamp(noise, 3.0 * noise)
}

/// The camera with all distortion terms that `model` does not have set to 0.
pub(super) fn without_terms_beyond(camera: Camera, model: LensModel) -> Camera {
    let d = camera.distortion;
    let distortion = match model {
        LensModel::None => Distortion::default(),
        LensModel::K1 => Distortion {
            k1: d.k1,
            ..Distortion::default()
        },
        LensModel::K1K2 => Distortion {
            k1: d.k1,
            k2: d.k2,
            ..Distortion::default()
        },
        LensModel::K1K2P1P2 => Distortion { k3: 0.0, ..d },
        LensModel::Brown5 => d,
    };
    Camera {
        distortion,
        ..camera
    }
}

/// The camera of least squares over the `used` rows, from `start` on. With `cauchy`, the scale in px, the loss of a
/// row with residual r is c² ln(1 + r²/c²). With `held` the lens terms are expected to be as those of real lenses.
///
/// # Errors
/// [`CalibrationError::NoFit`] when the iteration breaks down.
pub(super) fn fit(
    table: &[LightPoint],
    used: &[usize],
    start: Camera,
    model: LensModel,
    cauchy: Option<f64>,
    held: Option<&Held>,
) -> Result<Camera, CalibrationError> {
    let problem = Problem {
        points: used
            .iter()
            .filter_map(|row| table.get(*row))
            .copied()
            .collect(),
        start,
        change: DVector::zeros(model.parameters()),
        camera: start,
        cauchy,
        held: held.copied(),
    };
    // A robust fit is only where the next one starts from.
    let tolerance = if cauchy.is_some() { 1e-5 } else { 1e-10 };
    let method = LevenbergMarquardt::new()
        .with_ftol(tolerance)
        .with_xtol(tolerance);
    let (problem, report) = method.minimize(problem);
    match report.termination {
        TerminationReason::User(_)
        | TerminationReason::Numerical(_)
        | TerminationReason::NoParameters
        | TerminationReason::NoResiduals
        | TerminationReason::WrongDimensions(_) => Err(CalibrationError::NoFit(format!(
            "least squares over {} points stopped ({:?})",
            used.len(),
            report.termination
        ))),
        _ => Ok(problem.camera),
    }
}

struct Problem {
    points: Vec<LightPoint>,
    start: Camera,
    /// From `start`, in the order of `Camera::moved_by`, as many as are free.
    change: DVector<f64>,
    camera: Camera,
    cauchy: Option<f64>,
    /// What is known of the lens beforehand.
    held: Option<Held>,
}

impl Problem {
    /// The lens terms that are free, with their indices among the parameters and their weights beforehand, px.
    fn held_terms(&self) -> impl Iterator<Item = (usize, f64, f64)> + use<> {
        let (free, d) = (self.change.len(), self.camera.distortion);
        let held = self.held.into_iter().flat_map(move |held| held.terms(free));
        let terms = held.zip([d.k1, d.k2, d.p1, d.p2, d.k3]);
        terms.map(|((index, weight), term)| (index, weight, term))
    }

    /// One for each coordinate of each point, and one for each lens term that is held.
    fn equations(&self) -> usize {
        2 * self.points.len() + self.held_terms().count()
    }
}

/// The factor that turns a residual of squared length `square` into one whose square is its Cauchy loss, and the
/// derivative of the factor by `square`.
fn cauchy_factor(square: f64, scale: f64) -> (f64, f64) {
    let s = square / (scale * scale);
    if s < 1e-6 {
        // ln(1 + s)/s = 1 - s/2 + ..., its root 1 - s/4.
        return (1.0 - 0.25 * s, -0.25 / (scale * scale));
    }
    let mean = s.ln_1p() / s;
    let factor = mean.sqrt();
    (
        factor,
        (1.0 / (1.0 + s) - mean) / (2.0 * s * factor * scale * scale),
    )
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, x: &DVector<f64>) {
        self.change.copy_from(x);
        let mut step = [0.0; PARAMETERS];
        for (to, from) in step.iter_mut().zip(x) {
            *to = *from;
        }
        self.camera = self.start.moved_by(&step);
    }

    fn params(&self) -> DVector<f64> {
        self.change.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let mut residuals = DVector::zeros(self.equations());
        for (k, point) in self.points.iter().enumerate() {
            let mut r = self.camera.project_unchecked(&point.position())? - point.pixel();
            if let Some(scale) = self.cauchy {
                r *= cauchy_factor(r.norm_squared(), scale).0;
            }
            residuals.fixed_rows_mut::<2>(2 * k).copy_from(&r);
        }
        for (row, (_, weight, term)) in (2 * self.points.len()..).zip(self.held_terms()) {
            residuals[row] = weight * term;
        }
        residuals.iter().all(|r| r.is_finite()).then_some(residuals)
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let free = self.change.len();
        let mut jacobian = DMatrix::zeros(self.equations(), free);
        let turn = left_jacobian(self.change.fixed_rows::<3>(0).into_owned());
        for (k, point) in self.points.iter().enumerate() {
            let (pixel, mut block) = self.camera.project_with_jacobian(&point.position())?;
            let by_turn = block.fixed_view::<2, 3>(0, 0) * turn;
            block.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_turn);
            if let Some(scale) = self.cauchy {
                let r = pixel - point.pixel();
                let (factor, slope) = cauchy_factor(r.norm_squared(), scale);
                block = block * factor + r * (2.0 * slope) * (r.transpose() * block);
            }
            jacobian
                .view_mut((2 * k, 0), (2, free))
                .copy_from(&block.columns(0, free));
        }
        for (row, (column, weight, _)) in (2 * self.points.len()..).zip(self.held_terms()) {
            jacobian[(row, column)] = weight;
        }
        jacobian.iter().all(|j| j.is_finite()).then_some(jacobian)
    }
}

/// The left Jacobian of the rotation group: exp(ω + δ) = exp(J δ) exp(ω) to first order.
pub(crate) fn left_jacobian(w: Vector3<f64>) -> Matrix3<f64> {
    let (angle, k) = (w.norm(), w.cross_matrix());
    if angle < 1e-4 {
        return Matrix3::identity() + k * 0.5 + k * k / 6.0;
    }
    let square = angle * angle;
    Matrix3::identity()
        + k * ((1.0 - angle.cos()) / square)
        + k * k * ((angle - angle.sin()) / (square * angle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::ceiling_camera;
    use levenberg_marquardt::differentiate_numerically;

    #[test]
    fn the_jacobian_is_right_for_plain_and_cauchy_losses_and_large_turns() {
        let camera = ceiling_camera();
        let points = [
            (0.3, 0.2, 0.5),
            (-0.4, 0.1, 1.0),
            (0.1, -0.6, 0.8),
            (0.5, 0.5, 1.4),
        ];
        let points: Vec<LightPoint> = points
            .map(|(x, y, z)| LightPoint {
                x,
                y,
                z,
                u: 300.0 + 10.0 * x,
                v: 200.0,
            })
            .to_vec();
        let held = Held::of(&camera, (500, 500), 0.3);
        for (cauchy, held) in [(None, None), (Some(20.0), None), (None, Some(held))] {
            let mut problem = Problem {
                points: points.clone(),
                start: camera,
                change: DVector::zeros(15),
                camera,
                cauchy,
                held,
            };
            let mut change = DVector::from_element(15, 0.01);
            change
                .rows_mut(0, 3)
                .copy_from(&Vector3::new(0.3, -0.2, 0.1));
            problem.set_params(&change);
            let numeric = differentiate_numerically(&mut problem).unwrap();
            let exact = problem.jacobian().unwrap();
            for (a, b) in numeric.iter().zip(&exact) {
                assert!(
                    (a - b).abs() < 1e-4 * (1.0 + b.abs()),
                    "{cauchy:?}: {a} {b}"
                );
            }
        }
    }
}
