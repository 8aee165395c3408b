//! How well a layout of light positions would determine a camera, before anything moves.

use nalgebra::Point3;

use super::{
    CalibrationError, LensModel,
    uncertainty::{Uncertainty, describe, unit_covariance},
};
use crate::camera::Camera;

/// The Cramér-Rao bound of calibrating `camera` with `model` from lights at `positions` (world frame, m) whose spots
/// have the standard deviation `sd_px` per coordinate. No unbiased estimate can be better; ours comes near.
///
/// # Errors
/// [`CalibrationError::Undetermined`] if the positions do not determine the camera.
pub fn design(
    camera: &Camera,
    positions: &[Point3<f64>],
    sd_px: f64,
    model: LensModel,
) -> Result<Uncertainty, CalibrationError> {
    let (unit, condition) = unit_covariance(camera, positions, model.parameters())?;
    Ok(describe(
        camera,
        positions,
        &(unit * sd_px.powi(2)),
        condition,
    ))
}
