//! How good an estimated camera is: covariance, standard deviations, condition, expected error in the work volume.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Matrix6, Point3, SMatrix, Vector3};
use serde::{Deserialize, Serialize};

use super::{CalibrationError, LightPoint, Stand, fit, held::Held};
use crate::camera::{Camera, PARAMETERS};

/// Condition number of the column-scaled Jacobian beyond which a camera is not determined.
const WORST_CONDITION: f64 = 1e8;
/// Points per side of the grid on which the work volume is judged.
const GRID: usize = 5;
/// Nothing is judged nearer to the camera than this part of the distance of the middle.
const NEAREST: f64 = 0.25;

pub(crate) type Covariance = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Standard deviations of an estimated camera, from the noise of the pixels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Standard deviation of each parameter: rotation vector in the camera frame (3, rad), centre (3, m), fx, fy,
    /// cx, cy (px), k1, k2, p1, p2, k3; 0 for terms that are not in the model.
    pub parameter_sd: [f64; PARAMETERS],
    /// Covariance of the centre in the world frame, m².
    pub position_covariance: [[f64; 3]; 3],
    /// Covariance of the rotation vector in the camera frame, rad².
    pub rotation_covariance: [[f64; 3]; 3],
    /// Covariance of camera_T_world: of its rotation vector (3, rad) and its translation (3, m).
    pub camera_t_world_covariance: [[f64; 6]; 6],
    /// Root of the trace of `position_covariance`, m.
    pub position_sd_m: f64,
    /// Root of the trace of `rotation_covariance`, rad.
    pub rotation_sd_rad: f64,
    /// Standard deviation of (fx + fy) / 2, relative to it.
    pub focal_sd_rel: f64,
    /// Condition number of the column-scaled Jacobian.
    pub condition: f64,
    /// Expected error (rms of the length) of a point projected anywhere in the box around the light positions, px.
    pub volume_error_px: f64,
    /// The same in the cube around them whose sides are as long as the longest of the box, px. Positions nearly in one plane
    /// say little of it.
    pub cube_error_px: f64,
}

impl Uncertainty {
    /// Standard deviations of camera_T_world: its rotation vector (3, rad) and its translation (3, m).
    #[must_use]
    pub fn camera_t_world_sd(&self) -> [f64; 6] {
        let covariance = &self.camera_t_world_covariance;
        std::array::from_fn(|k| covariance[k][k].sqrt())
    }
}

/// What [`summarise`] finds.
pub(super) struct Summary {
    pub rms_px: f64,
    pub leave_out_rms_px: f64,
    pub noise_px: f64,
    pub uncertainty: Uncertainty,
}

/// (JᵀJ)⁻¹ of the first `free` parameters over `points`, and the condition number of J with its columns scaled. With
/// `held` JᵀJ has what is known of the lens beforehand.
pub(super) fn unit_covariance(
    camera: &Camera,
    points: &[Point3<f64>],
    free: usize,
    held: Option<&Held>,
) -> Result<(Covariance, f64), CalibrationError> {
    let undetermined = |condition| CalibrationError::Undetermined { condition };
    let mut normal = DMatrix::zeros(free, free);
    for point in points {
        let (_, block) = camera
            .project_with_jacobian(point)
            .ok_or(undetermined(f64::INFINITY))?;
        let block = block.columns(0, free);
        normal += block.transpose() * block;
    }
    if let Some(held) = held {
        held.add_to(&mut normal);
    }
    let scale = DVector::from_iterator(free, normal.diagonal().iter().map(|d| 1.0 / d.sqrt()));
    let scaled = DMatrix::from_fn(free, free, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    if !scaled.iter().all(|entry| entry.is_finite()) {
        return Err(undetermined(f64::INFINITY));
    }
    let eigen = scaled
        .clone()
        .try_symmetric_eigen(1e-15, 1000)
        .ok_or(undetermined(f64::INFINITY))?;
    let (least, most) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
    let condition = if least > 0.0 {
        (most / least).sqrt()
    } else {
        f64::INFINITY
    };
    if condition > WORST_CONDITION {
        return Err(undetermined(condition));
    }
    let inverse = scaled.cholesky().ok_or(undetermined(condition))?.inverse();
    let mut covariance = Covariance::zeros();
    for i in 0..free {
        for j in 0..free {
            covariance[(i, j)] = inverse[(i, j)] * scale[i] * scale[j];
        }
    }
    Ok((covariance, condition))
}

fn positions(table: &[LightPoint], used: &[usize]) -> Vec<Point3<f64>> {
    used.iter()
        .filter_map(|row| table.get(*row))
        .map(LightPoint::position)
        .collect()
}

/// Sum of squared residuals of the used rows and the noise variance it means, σ² = Σr² / (2N - p), when p parameters were
/// free.
pub(super) fn noise_variance(table: &[LightPoint], stand: &Stand, free: f64) -> (f64, f64) {
    let rows = stand.used.iter().filter_map(|row| table.get(*row));
    let squares: f64 = rows
        .map(|point| fit::residual(&stand.camera, point).norm_squared())
        .sum();
    let spare = (2.0 * stand.used.len() as f64 - free).max(1.0);
    (squares, squares / spare)
}

/// Everything that is reported about a fit.
pub(super) fn summarise(table: &[LightPoint], stand: &Stand) -> Result<Summary, CalibrationError> {
    let points = positions(table, &stand.used);
    let parameters = stand.model.parameters();
    let held = stand.held.as_ref();
    let (unit, condition) = unit_covariance(&stand.camera, &points, parameters, held)?;
    // A term that is known beforehand takes so much less out of the residuals.
    let terms = held.into_iter().flat_map(|held| held.terms(parameters));
    let known: f64 = terms
        .map(|(k, weight)| weight * weight * unit[(k, k)])
        .sum();
    let (squares, variance) = noise_variance(table, stand, parameters as f64 - known);
    let n = stand.used.len() as f64;
    let mut left_out = 0.0;
    for point in stand.used.iter().filter_map(|row| table.get(*row)) {
        let r = fit::residual(&stand.camera, point);
        if let Some((_, j)) = stand.camera.project_with_jacobian(&point.position()) {
            // Without this point, its residual is (1 - H)⁻¹ r with its block H of the hat matrix.
            let kept = Matrix2::identity() - j * unit * j.transpose();
            left_out += kept
                .try_inverse()
                .map_or(f64::INFINITY, |inverse| (inverse * r).norm_squared());
        }
    }
    let covariance = unit * variance;
    Ok(Summary {
        rms_px: (squares / n).sqrt(),
        leave_out_rms_px: (left_out / n).sqrt(),
        noise_px: variance.sqrt(),
        uncertainty: describe(&stand.camera, &points, &covariance, condition),
    })
}

/// The standard deviations that a covariance of the parameters means.
pub(crate) fn describe(
    camera: &Camera,
    points: &[Point3<f64>],
    covariance: &Covariance,
    condition: f64,
) -> Uncertainty {
    let rotation: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let position: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into_owned();
    let focal = 0.25 * covariance.fixed_view::<2, 2>(6, 6).sum();
    let array = |m: &Matrix3<f64>| std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]));
    let ends = (
        Vector3::repeat(f64::INFINITY),
        Vector3::repeat(f64::NEG_INFINITY),
    );
    let (low, high) = points.iter().fold(ends, |(low, high), p| {
        (low.inf(&p.coords), high.sup(&p.coords))
    });
    let (middle, half) = ((low + high) / 2.0, (high - low) / 2.0);
    let error = |half: Vector3<f64>| grid_error(camera, (middle, half), covariance);
    Uncertainty {
        parameter_sd: std::array::from_fn(|k| covariance[(k, k)].sqrt()),
        position_covariance: array(&position),
        rotation_covariance: array(&rotation),
        camera_t_world_covariance: camera_t_world_covariance(camera, covariance),
        position_sd_m: position.trace().sqrt(),
        rotation_sd_rad: rotation.trace().sqrt(),
        focal_sd_rel: focal.sqrt() / camera.focal(),
        condition,
        volume_error_px: error(half),
        cube_error_px: error(Vector3::repeat(half.max())),
    }
}

/// Covariance of the rotation vector r and the translation t = -R C of camera_T_world, where the covariance is about
/// a turn δ on the left of R and a shift of the centre C: dr = J(r)⁻¹ δ, dt = -t × δ - R dC.
fn camera_t_world_covariance(camera: &Camera, covariance: &Covariance) -> [[f64; 6]; 6] {
    let pose = camera.camera_from_world();
    let turn = fit::left_jacobian(pose.rotation.scaled_axis());
    let turn = turn.try_inverse().unwrap_or_else(Matrix3::identity);
    let mut change = Matrix6::zeros();
    change.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    let by_turn = -pose.translation.vector.cross_matrix();
    change.fixed_view_mut::<3, 3>(3, 0).copy_from(&by_turn);
    let by_shift = -pose.rotation.to_rotation_matrix().into_inner();
    change.fixed_view_mut::<3, 3>(3, 3).copy_from(&by_shift);
    let of_pose = covariance.fixed_view::<6, 6>(0, 0);
    let found = change * of_pose * change.transpose();
    std::array::from_fn(|i| std::array::from_fn(|j| found[(i, j)]))
}

/// Rms over a grid in the box about `middle` with half sides `half` of the error that `covariance` means for a projected
/// point, px. What is much nearer to the camera than the middle is left out.
fn grid_error(
    camera: &Camera,
    (middle, half): (Vector3<f64>, Vector3<f64>),
    covariance: &Covariance,
) -> f64 {
    // The middles of equal cells, so that every part of the volume counts the same.
    let part = |k: usize| (2 * k + 1) as f64 / GRID as f64 - 1.0;
    let depth = |point: Vector3<f64>| camera.in_camera_frame(&point.into()).z;
    let nearest = NEAREST * depth(middle);
    let (mut sum, mut count) = (0.0, 0.0);
    for cell in 0..GRID.pow(3) {
        let at = [cell % GRID, cell / GRID % GRID, cell / GRID / GRID].map(part);
        let point = middle + half.component_mul(&Vector3::from(at));
        if depth(point) > nearest.max(0.0)
            && let Some((_, j)) = camera.project_with_jacobian(&point.into())
        {
            sum += (j * covariance * j.transpose()).trace();
            count += 1.0;
        }
    }
    (sum / count).sqrt()
}
