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
    let (unit, condition) = unit_covariance(camera, positions, model.parameters(), None)?;
    Ok(describe(
        camera,
        positions,
        &(unit * sd_px.powi(2)),
        condition,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::ceiling_camera;

    /// A grid of 4 x 4 lights at each of the heights, m.
    fn layout(heights: &[f64]) -> Vec<Point3<f64>> {
        let at = |k: usize| k as f64 * 0.4 - 0.6;
        let level = |z: f64| (0..16).map(move |k| Point3::new(at(k % 4), at(k / 4), z));
        heights.iter().copied().flat_map(level).collect()
    }

    #[test]
    fn the_layout_of_the_case_study_is_good_enough_and_one_height_is_not() {
        let camera = ceiling_camera();
        let of = |heights: &[f64]| design(&camera, &layout(heights), 0.15, LensModel::Brown5);
        let spread = of(&[0.4, 0.8, 1.2, 1.5]).unwrap();
        // 10 mm and 0.5 % at three standard deviations.
        assert!(3.0 * spread.position_sd_m < 0.010, "{spread:?}");
        assert!(3.0 * spread.focal_sd_rel < 0.005, "{spread:?}");
        let narrow = of(&[0.80, 0.81, 0.82, 0.83]).unwrap();
        assert!(
            narrow.focal_sd_rel > 5.0 * spread.focal_sd_rel,
            "{narrow:?}"
        );
        // Lights in one place leave everything open.
        let one = vec![Point3::new(0.1, 0.2, 0.3); 20];
        assert!(matches!(
            design(&camera, &one, 0.15, LensModel::Brown5),
            Err(CalibrationError::Undetermined { .. })
        ));
    }

    #[test]
    fn the_bound_is_proportional_to_the_noise() {
        let lights = layout(&[0.4, 0.9, 1.4]);
        let of = |sd| design(&ceiling_camera(), &lights, sd, LensModel::Brown5).unwrap();
        assert!((of(0.3).position_sd_m / of(0.1).position_sd_m - 3.0).abs() < 1e-9);
    }
}
