//! Least-squares fits of a camera to rows of the table, plain or with a Cauchy loss.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::{CalibrationError, LEAST_NOISE_PX, LensModel, LightPoint, held::Held};
use crate::{
    adjust::{Adjustable, adjusted_until},
    camera::{Camera, Distortion, PARAMETERS, ParameterJacobian},
};

/// A fit ends when a step lowers the sum of squares by less than this part of it. A robust one is only where the next one
/// starts from.
const STILL: f64 = 1e-12;
const ROBUST_STILL: f64 = 1e-5;

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
    let rows = used.iter().filter_map(|row| table.get(*row));
    let points: Vec<LightPoint> = rows.copied().collect();
    let start = Fit {
        points: &points,
        camera: start,
        free: model.parameters(),
        cauchy,
        held: held.copied(),
    };
    let still = if cauchy.is_some() {
        ROBUST_STILL
    } else {
        STILL
    };
    let found = adjusted_until(start, still).map(|fit| fit.camera);
    found.ok_or_else(|| {
        let points = used.len();
        CalibrationError::NoFit(format!("least squares over {points} points stopped"))
    })
}

#[derive(Clone)]
struct Fit<'a> {
    points: &'a [LightPoint],
    camera: Camera,
    /// How many of the parameters of [`Camera::project_with_jacobian`] are free: the first ones.
    free: usize,
    cauchy: Option<f64>,
    /// What is known of the lens beforehand.
    held: Option<Held>,
}

impl Fit<'_> {
    /// The lens terms that are free, with their indices among the parameters and their weights beforehand, px.
    fn held_terms(&self) -> impl Iterator<Item = (usize, f64, f64)> + use<> {
        let (free, d) = (self.free, self.camera.distortion);
        let held = self.held.into_iter().flat_map(move |held| held.terms(free));
        let terms = held.zip([d.k1, d.k2, d.p1, d.p2, d.k3]);
        terms.map(|((index, weight), term)| (index, weight, term))
    }

    /// What a point leaves, px, whose square is its loss, and the derivatives by all parameters.
    fn row(&self, point: &LightPoint) -> Option<(Vector2<f64>, ParameterJacobian)> {
        let (pixel, by) = self.camera.project_with_jacobian(&point.position())?;
        let off = pixel - point.pixel();
        let Some(scale) = self.cauchy else {
            return Some((off, by));
        };
        let (factor, slope) = cauchy_factor(off.norm_squared(), scale);
        let by = by * factor + off * (2.0 * slope) * (off.transpose() * by);
        Some((off * factor, by))
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

impl Adjustable for Fit<'_> {
    fn squares(&self) -> Option<f64> {
        let losses = self.points.iter().map(|point| {
            let off = self.camera.project_unchecked(&point.position())? - point.pixel();
            let square = off.norm_squared();
            let loss = |scale: f64| scale * scale * (square / (scale * scale)).ln_1p();
            Some(self.cauchy.map_or(square, loss))
        });
        let held = self.held_terms();
        let held: f64 = held.map(|(_, weight, term)| (weight * term).powi(2)).sum();
        let squares = losses.sum::<Option<f64>>()? + held;
        squares.is_finite().then_some(squares)
    }

    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let free = self.free;
        let mut normal = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
        let mut right = SVector::<f64, PARAMETERS>::zeros();
        for point in self.points {
            let (off, by) = self.row(point)?;
            for (off, by) in off.iter().zip(by.row_iter()) {
                let by = by.transpose();
                // The lower half of it.
                normal.syger(1.0, &by, &by, 1.0);
                right.axpy(-off, &by, 1.0);
            }
        }
        for (index, weight, term) in self.held_terms() {
            normal[(index, index)] += weight * weight;
            right[index] -= weight * weight * term;
        }
        let normal = DMatrix::from_fn(free, free, |i, j| normal[(i.max(j), i.min(j))]);
        Some((normal, right.rows(0, free).into_owned()))
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        let mut by = [0.0; PARAMETERS];
        for (to, from) in by.iter_mut().zip(step) {
            *to = *from;
        }
        Self {
            camera: self.camera.moved_by(&by),
            ..self.clone()
        }
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

    /// The gradient is that of the sum of squares by differences, and the matrix that of Gauss and Newton: it foretells how the
    /// gradient changes where residuals are small.
    #[test]
    fn the_equations_are_those_of_plain_and_cauchy_losses() {
        let camera = ceiling_camera();
        let points = [
            (0.3, 0.2, 0.5),
            (-0.4, 0.1, 1.0),
            (0.1, -0.6, 0.8),
            (0.5, 0.5, 1.4),
        ];
        let points = points.map(|(x, y, z)| LightPoint {
            x,
            y,
            z,
            u: 300.0 + 10.0 * x,
            v: 200.0,
        });
        let held = Held::of(&camera, (500, 500), 0.3);
        for (cauchy, held) in [(None, None), (Some(20.0), None), (None, Some(held))] {
            let fit = Fit {
                points: &points,
                camera,
                free: 15,
                cauchy,
                held,
            };
            let (normal, right) = fit.equations().unwrap();
            assert!(normal.clone().symmetric_eigenvalues().min() > -1e-6 * normal.norm());
            for k in 0..15 {
                let step = 1e-6;
                let at = |by: f64| {
                    let mut change = DVector::zeros(15);
                    change[k] = by;
                    fit.moved(&change).squares().unwrap()
                };
                let slope = (at(step) - at(-step)) / (2.0 * step);
                let expected = -2.0 * right[k];
                assert!(
                    (slope - expected).abs() < 1e-4 * (1.0 + expected.abs()),
                    "{cauchy:?} {k}: {slope} {expected}"
                );
            }
        }
    }

    #[test]
    fn near_the_minimum_the_matrix_is_half_the_second_derivative() {
        let camera = ceiling_camera();
        let points: Vec<LightPoint> = (0..12)
            .map(|k| {
                let (x, y) = (0.3 * f64::from(k % 3) - 0.3, 0.3 * f64::from(k % 4) - 0.4);
                let pixel = camera
                    .project_unchecked(&nalgebra::Point3::new(x, y, 0.1 * f64::from(k)))
                    .unwrap();
                LightPoint {
                    x,
                    y,
                    z: 0.1 * f64::from(k),
                    u: pixel.x,
                    v: pixel.y,
                }
            })
            .collect();
        let fit = Fit {
            points: &points,
            camera,
            free: 15,
            cauchy: Some(20.0),
            held: None,
        };
        let (normal, _) = fit.equations().unwrap();
        for k in 0..15 {
            let step = 1e-3 / normal[(k, k)].sqrt();
            let mut change = DVector::zeros(15);
            change[k] = step;
            let rise = fit.moved(&change).squares().unwrap() / (step * step);
            let expected = normal[(k, k)];
            assert!(
                (rise / expected - 1.0).abs() < 1e-2,
                "{k}: {rise} {expected}"
            );
        }
    }
}
