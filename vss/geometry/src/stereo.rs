//! Two cameras that saw the same lights: how one stands to the other, and points from pairs of pixels.

use nalgebra::{Isometry3, Matrix2x3, Matrix3, Point3, SMatrix, Vector2, Vector3};

use crate::{
    calibrate::{Calibration, left_jacobian},
    camera::Camera,
};

/// right_T_left of two calibrations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Where the left camera's frame is in the right one's.
    pub right_t_left: Isometry3<f64>,
    /// Standard deviations of its rotation vector (3, rad) and its translation (3, m).
    pub sd: [f64; 6],
    /// Root of the mean over all used points of both cameras of du² + dv², px.
    pub rms_px: f64,
}

/// How two cameras stand to one another that were each calibrated from lights in one world. The lights are known, so the
/// calibrations share no unknown, and their errors are independent.
#[must_use]
pub fn pair(left: &Calibration, right: &Calibration) -> Pair {
    let (l, r) = (
        left.camera.camera_from_world(),
        right.camera.camera_from_world(),
    );
    let right_t_left = r * l.inverse();
    let turned = right_t_left.rotation.to_rotation_matrix().into_inner();
    let arm = (turned * l.translation.vector).cross_matrix();
    // With turns on the left, δ = δr - R δl, and of t = tr - R tl follows dt = dtr + (R tl) × δ - R dtl.
    let turns = |pose: &Isometry3<f64>| left_jacobian(pose.rotation.scaled_axis());
    let unturn = left_jacobian(right_t_left.rotation.scaled_axis());
    let unturn = unturn.try_inverse().unwrap_or_else(Matrix3::identity);
    let (by_right, by_left) = (turns(&r), -turned * turns(&l));
    let mut change = SMatrix::<f64, 6, 12>::zeros();
    change
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&(unturn * by_right));
    change
        .fixed_view_mut::<3, 3>(0, 6)
        .copy_from(&(unturn * by_left));
    change
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(arm * by_right));
    change
        .fixed_view_mut::<3, 3>(3, 6)
        .copy_from(&(arm * by_left));
    change
        .fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&Matrix3::identity());
    change.fixed_view_mut::<3, 3>(3, 9).copy_from(&-turned);
    let mut covariance = SMatrix::<f64, 12, 12>::zeros();
    for (at, one) in [(0, right), (6, left)] {
        for (i, row) in one.uncertainty.camera_t_world_covariance.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                covariance[(at + i, at + j)] = *value;
            }
        }
    }
    let found = change * covariance * change.transpose();
    let squares = |one: &Calibration| one.rms_px * one.rms_px * one.used as f64;
    Pair {
        right_t_left,
        sd: std::array::from_fn(|k| found[(k, k)].sqrt()),
        rms_px: ((squares(left) + squares(right)) / (left.used + right.used) as f64).sqrt(),
    }
}

/// How far apart two calibrated cameras stand, seen from the middle of the lights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Base {
    /// Between the centres, m.
    pub length_m: f64,
    /// Its standard deviation, m.
    pub sd_m: f64,
    /// The angle between the rays to the middle of the lights, rad.
    pub angle: f64,
}

impl Base {
    /// Whether the cameras saw everything from one place: no depth follows from such a pair.
    #[must_use]
    pub fn is_one_place(&self) -> bool {
        self.angle < PARALLEL || self.length_m < 3.0 * self.sd_m
    }
}

/// The base of a pair that saw lights around `middle`.
#[must_use]
pub fn base(left: &Calibration, right: &Calibration, middle: &Point3<f64>) -> Base {
    let (l, r) = (left.camera.centre, right.camera.centre);
    let (d, e) = (middle - l, middle - r);
    let along = (r - l).try_normalize(0.0).unwrap_or_else(Vector3::x);
    let variance = |one: &Calibration| {
        let covariance = &one.uncertainty.position_covariance;
        (along.transpose() * Matrix3::from_fn(|i, j| covariance[i][j]) * along).x
    };
    Base {
        length_m: (r - l).norm(),
        sd_m: (variance(left) + variance(right)).sqrt(),
        angle: d.cross(&e).norm().atan2(d.dot(&e)),
    }
}

/// A point from its pixels in two pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangulated {
    /// The middle of the shortest line between the two rays, in the world, m.
    pub point: Point3<f64>,
    /// The length of that line, m: how little the two pixels agree.
    pub gap_m: f64,
    /// The angle between the rays, rad: the depth is as uncertain as it is small.
    pub angle: f64,
}

impl Triangulated {
    /// Standard deviations of the point and of the gap, m, when each coordinate of the pixels has `sd_px` and the cameras are
    /// exact; `None` when a camera does not see the point.
    #[must_use]
    pub fn sd(&self, left: &Camera, right: &Camera, sd_px: f64) -> Option<([f64; 3], f64)> {
        let (mut normal, mut gap) = (Matrix3::zeros(), 0.0);
        for camera in [left, right] {
            let (_, by) = camera.project_with_jacobian(&self.point)?;
            let by: Matrix2x3<f64> = by.fixed_view::<2, 3>(0, 3).into_owned();
            normal += by.transpose() * by;
            gap += ((self.point - camera.centre).norm() / camera.focal()).powi(2);
        }
        let covariance = normal.try_inverse()? * sd_px.powi(2);
        let sd = covariance.diagonal().map(|one| one.max(0.0).sqrt());
        Some((sd.into(), sd_px * gap.sqrt()))
    }
}

/// Why two pixels give no point.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoPoint {
    /// A pixel has no ray: the lens cannot be undone there.
    #[error("the pixel ({0:?}, {1:?}) has no ray: the distortion cannot be undone there")]
    NoRay(f64, f64),
    /// A pixel that no picture has.
    #[error(
        "the pixel ({0:?}, {1:?}) is seen more than {WIDEST_DEGREES} degrees beside the camera's axis, where no picture reaches: are \
         these pixels, and is this the lens of that camera?"
    )]
    Beside(f64, f64),
    /// Both cameras are at one place.
    #[error(
        "both cameras stand at one place ({0:.1e} m apart): no depth follows from such a pair; are these two cameras?"
    )]
    OnePlace(f64),
    /// The rays are nearly parallel.
    #[error("the rays are parallel within {0:.1e} rad: the depth cannot be told")]
    Parallel(f64),
    /// The rays meet behind a camera.
    #[error(
        "the rays meet behind a camera: the pixels are not of one point, or left and right, or u and v, are exchanged"
    )]
    Behind,
}

/// Rays whose angle is below this are parallel, rad.
const PARALLEL: f64 = 1e-3;

/// Cameras nearer to one another are at one place, m.
const ONE_PLACE_M: f64 = 1e-6;

/// No lens of this model sees farther from its axis, degrees.
const WIDEST_DEGREES: f64 = 80.0;

/// The point that two cameras see at two pixels.
///
/// # Errors
/// When a pixel has no ray, or the rays do not meet in front of both.
pub fn triangulate(
    left: &Camera,
    right: &Camera,
    at_left: Vector2<f64>,
    at_right: Vector2<f64>,
) -> Result<Triangulated, NoPoint> {
    let ray = |camera: &Camera, at: Vector2<f64>| {
        let ray = camera.ray(at).ok_or(NoPoint::NoRay(at.x, at.y))?;
        if ray.xy().norm() > ray.z * WIDEST_DEGREES.to_radians().tan() {
            return Err(NoPoint::Beside(at.x, at.y));
        }
        Ok(camera.camera_from_world().rotation.inverse() * ray.normalize())
    };
    let (d, e) = (ray(left, at_left)?, ray(right, at_right)?);
    let base: Vector3<f64> = right.centre - left.centre;
    if base.norm() < ONE_PLACE_M {
        return Err(NoPoint::OnePlace(base.norm()));
    }
    let angle = d.cross(&e).norm().atan2(d.dot(&e));
    if angle < PARALLEL {
        return Err(NoPoint::Parallel(angle));
    }
    // The feet of the common perpendicular: P + s d and Q + t e.
    let (cosine, sine) = (d.dot(&e), angle.sin());
    let s = (base.dot(&d) - cosine * base.dot(&e)) / (sine * sine);
    let t = (cosine * base.dot(&d) - base.dot(&e)) / (sine * sine);
    if s <= 0.0 || t <= 0.0 {
        return Err(NoPoint::Behind);
    }
    let (one, other) = (left.centre + d * s, right.centre + e * t);
    Ok(Triangulated {
        point: nalgebra::center(&one, &other),
        gap_m: (other - one).norm(),
        angle,
    })
}

#[cfg(test)]
mod tests;
