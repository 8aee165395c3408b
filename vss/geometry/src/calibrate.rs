//! Camera calibration from a moving light: resection of one camera from world positions and their pixels.
//!
//! The order is: check the table; start from a normalised direct linear transform inside RANSAC; fit 10, 12, then
//! 15 parameters with a Cauchy loss; reject what lies beyond 3.5 standard deviations until the set stays. Then fit plain
//! least squares, and report every uncertainty. The first limit of the rejection comes from the residuals of all points.
//! Later ones come from those used, so that points of a second noise level come back. Tables from which no camera follows
//! are refused with the reason.
//!
//! Every distortion term that the number of points allows is kept. Terms that the data hardly show cost little when they
//! are kept, and much when they are dropped: p1 and p2 turn the camera, and a standard deviation of the smaller model
//! knows nothing of that (over many simulated cameras the error of the rotation was 1.13 of it). Lens terms are held about 0
//! as loosely as real lenses differ. A free fit of five terms to 70 points far from the picture's corners is not linear over
//! its wide errors, and its 95 % intervals cover the truth in 91 %.
//! This module knows numbers only: no pictures, no tasks, no simulator, and never the true camera.

mod curve;
mod design;
mod fit;
mod held;
mod start;
mod table;
mod uncertainty;

use nalgebra::{Point3, Vector2};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::camera::{Camera, PARAMETERS};
pub use design::design;
pub(crate) use fit::left_jacobian;
use held::Held;
pub use table::CalibrationError;
pub use uncertainty::Uncertainty;
pub(crate) use uncertainty::describe as covariance_means;

/// The fewest points (distinct positions) from which a camera is estimated: a 15-parameter fit needs 8.
pub const MINIMUM_POINTS: usize = 8;
/// Points beyond this many standard deviations, in u or in v, are rejected.
const REJECT_SD: f64 = 3.5;
/// Scale of the Cauchy loss in standard deviations of the noise.
const CAUCHY_SD: f64 = 1.5;
/// Rounds of rejection after which a set that still changes is taken as it is.
const REJECTION_ROUNDS: usize = 20;
/// Noise that no measurement of a spot is below, px: the limit of the rejection never falls under so much of it.
const LEAST_SPOT_NOISE_PX: f64 = 0.01;
/// A camera whose focal length has this standard deviation or more, relative to it, is poor.
pub const POOR_FOCAL: f64 = 0.02;
/// Noise below which residuals are rounding errors, px.
const LEAST_NOISE_PX: f64 = 1e-6;
/// Equations that must be left over beyond the parameters before a lens model is tried.
const SPARE_EQUATIONS: usize = 6;

/// One position of the light, in the world frame, and where the camera saw it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LightPoint {
    /// World x, m.
    pub x: f64,
    /// World y, m.
    pub y: f64,
    /// World z, m.
    pub z: f64,
    /// Column, px.
    pub u: f64,
    /// Row, px.
    pub v: f64,
}

impl LightPoint {
    /// The light in the world, m.
    #[must_use]
    pub fn position(&self) -> Point3<f64> {
        Point3::new(self.x, self.y, self.z)
    }

    /// Its picture, px.
    #[must_use]
    pub fn pixel(&self) -> Vector2<f64> {
        Vector2::new(self.u, self.v)
    }
}

/// Which distortion terms are free. Each model contains the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LensModel {
    /// No distortion: 10 parameters.
    None,
    /// Radial, its first term only: 11 parameters. Taken only when asked for.
    K1,
    /// Radial: 12 parameters.
    K1K2,
    /// Radial and tangential: 14 parameters.
    K1K2P1P2,
    /// k1 k2 p1 p2 k3: 15 parameters.
    Brown5,
}

impl LensModel {
    /// The models of which a calibration takes the largest that the points support.
    const CHOSEN: [Self; 4] = [Self::None, Self::K1K2, Self::K1K2P1P2, Self::Brown5];

    /// Number of free parameters, pose and pinhole included. They are the first so many of
    /// [`Camera::project_with_jacobian`].
    #[must_use]
    pub fn parameters(self) -> usize {
        match self {
            Self::None => 10,
            Self::K1 => 11,
            Self::K1K2 => 12,
            Self::K1K2P1P2 => 14,
            Self::Brown5 => 15,
        }
    }

    /// The fewest points that support the model.
    #[must_use]
    pub fn fewest_points(self) -> usize {
        (self.parameters() + SPARE_EQUATIONS)
            .div_ceil(2)
            .max(MINIMUM_POINTS)
    }

    /// The largest model that `points` points can support.
    fn largest_for(points: usize) -> Self {
        let fits = |model: &&Self| 2 * points >= model.parameters() + SPARE_EQUATIONS;
        Self::CHOSEN
            .iter()
            .rev()
            .find(fits)
            .copied()
            .unwrap_or(Self::None)
    }
}

/// A point of the table that was not used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RejectedPoint {
    /// Row of the table, from 0.
    pub row: usize,
    /// Its residual (seen minus predicted) along u, px.
    pub du: f64,
    /// Its residual along v, px.
    pub dv: f64,
    /// Why.
    pub reason: RejectReason,
}

/// Why a point was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum RejectReason {
    /// Too far from where the camera should have seen it.
    #[error("off by more than {limit_px:.3} px")]
    Outlier {
        /// The limit in u and in v, px.
        limit_px: f64,
    },
    /// Behind the camera.
    #[error("behind the camera")]
    Behind,
}

/// An estimated camera with everything that is known about how good it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Picture width, px.
    pub width: usize,
    /// Picture height, px.
    pub height: usize,
    /// The estimate.
    pub camera: Camera,
    /// Which distortion terms it has; the others are exactly 0.
    pub model: LensModel,
    /// Whether the distortion can be undone over the whole picture.
    pub monotonic: bool,
    /// Root of the mean over the used points of du² + dv², px.
    pub rms_px: f64,
    /// The same with each point predicted by a fit that left it out, px.
    pub leave_out_rms_px: f64,
    /// Standard deviation of the pixel noise per coordinate, from 2N - p degrees of freedom, px.
    pub noise_px: f64,
    /// Residual (seen minus predicted) of every row of the table, px.
    pub residuals: Vec<[f64; 2]>,
    /// Number of points used.
    pub used: usize,
    /// The others.
    pub rejected: Vec<RejectedPoint>,
    /// Shortest over longest extent (rms) of the positions used: how far they are from one plane.
    pub flatness: f64,
    /// Standard deviations of the estimate.
    pub uncertainty: Uncertainty,
}

impl Calibration {
    /// Predicted size of the position error, m: the root of the trace of the centre's covariance, so the root mean
    /// square of the distance |C - C_true|. The distance stays below three times this in well over 99 % of
    /// calibrations.
    #[must_use]
    pub fn position_sd_m(&self) -> f64 {
        self.uncertainty.position_sd_m
    }

    /// Predicted size of the rotation error, rad: likewise, from the rotation vector's covariance.
    #[must_use]
    pub fn rotation_sd_rad(&self) -> f64 {
        self.uncertainty.rotation_sd_rad
    }

    /// Predicted standard deviation of (fx + fy) / 2, relative to it.
    #[must_use]
    pub fn focal_sd_rel(&self) -> f64 {
        self.uncertainty.focal_sd_rel
    }

    /// The rms of the used points against another camera (for example the true one), in the way of `rms_px`, px;
    /// `None` if one of them is not in front of it. `table` is the table that was calibrated from.
    #[must_use]
    pub fn rms_against(&self, camera: &Camera, table: &[LightPoint]) -> Option<f64> {
        let is_rejected = |row: usize| self.rejected.iter().any(|point| point.row == row);
        let (mut squares, mut count) = (0.0, 0);
        for (_, point) in table
            .iter()
            .enumerate()
            .filter(|(row, _)| !is_rejected(*row))
        {
            squares += (camera.project(&point.position())? - point.pixel()).norm_squared();
            count += 1;
        }
        (count > 0).then(|| (squares / f64::from(count)).sqrt())
    }
}

/// Estimates the camera that saw the lights of `table` in pictures of `width` x `height` px.
///
/// It has all distortion terms that the number of points allows, expected to be as those of real lenses
/// ([`Beforehand::Lenses`]).
///
/// The generator drives the random samples of the start only; the same table and generator give the same
/// result, bit for bit.
///
/// # Errors
/// [`CalibrationError`] with its reason if no camera follows from the table.
pub fn calibrate(
    table: &[LightPoint],
    width: usize,
    height: usize,
    rng: &mut ChaCha8Rng,
) -> Result<Calibration, CalibrationError> {
    table::check(table, width, height)?;
    let largest = LensModel::largest_for(table.len());
    estimate(table, (width, height), largest, Beforehand::Lenses, rng)
}

/// What is known of a lens before a point is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Beforehand {
    /// k1, k2 and k3 add to the radius in the corners of the picture with standard deviations of 50, 25 and 5 % of it; those of
    /// p1 and p2 are 3e-3. A k3 that comes out beyond 10 % is expected within 25 %. The estimate and its standard deviations are
    /// those of Bayes.
    #[default]
    Lenses,
    /// Nothing: plain least squares. With few points its standard deviations are too small.
    Nothing,
}

/// The lens parameters of which something is known beforehand, for pictures of `size`, with one over the standard deviation.
pub(crate) fn lens_weights(
    camera: &Camera,
    size: (usize, usize),
    beforehand: Beforehand,
) -> Vec<(usize, f64)> {
    match beforehand {
        Beforehand::Lenses => Held::of(camera, size, 1.0).terms(PARAMETERS).collect(),
        Beforehand::Nothing => Vec::new(),
    }
}

/// Estimates the camera with just the distortion terms of `model`. Otherwise as [`calibrate`].
///
/// # Errors
/// [`CalibrationError`] with its reason if no camera follows from the table, or not one of that model.
pub fn calibrate_as(
    table: &[LightPoint],
    width: usize,
    height: usize,
    model: LensModel,
    beforehand: Beforehand,
    rng: &mut ChaCha8Rng,
) -> Result<Calibration, CalibrationError> {
    table::check(table, width, height)?;
    let enough = |points: usize| {
        let needed = model.fewest_points();
        let parameters = model.parameters();
        (points >= needed)
            .then_some(())
            .ok_or(CalibrationError::TooFewForModel {
                points,
                needed,
                parameters,
            })
    };
    enough(table.len())?;
    let found = estimate(table, (width, height), model, beforehand, rng)?;
    enough(found.used)?;
    Ok(found)
}

/// The camera without outliers; unless the points lie on a curve that many cameras see alike.
fn estimate(
    table: &[LightPoint],
    size: (usize, usize),
    model: LensModel,
    beforehand: Beforehand,
    rng: &mut ChaCha8Rng,
) -> Result<Calibration, CalibrationError> {
    let stand = start::find(table, size.0, size.1, rng)
        .and_then(|start| robust_fit(table, start, model))
        .and_then(|robust| reject(table, robust, size, beforehand));
    let used = stand.as_ref().ok().map(|stand| stand.used.as_slice());
    let is_used = |row: &usize| used.is_none_or(|used| used.binary_search(row).is_ok());
    let rows = table.iter().enumerate().filter(|(row, _)| is_used(row));
    let positions: Vec<Point3<f64>> = rows.map(|(_, point)| point.position()).collect();
    let curve = curve::Curve::of(&positions);
    let found = stand.and_then(|stand| assemble(table, size.0, size.1, &stand));
    let Some(curve) = curve else { return found };
    // Where they pass through the true camera, the fit may end at another one.
    let sure = |found: &Calibration| {
        found.focal_sd_rel() < POOR_FOCAL && !curve.passes(&found.camera.centre)
    };
    found.ok().filter(sure).ok_or(CalibrationError::Curve)
}

/// A camera with the points that it stands on.
struct Stand {
    camera: Camera,
    model: LensModel,
    used: Vec<usize>,
    /// Limit of the rejection, px.
    limit_px: f64,
    /// What was known of the lens.
    held: Option<Held>,
}

/// Fits 10, then 12, then up to 15 parameters, each on a Cauchy loss whose scale comes from the residuals so far.
fn robust_fit(
    table: &[LightPoint],
    start: start::Start,
    largest: LensModel,
) -> Result<Stand, CalibrationError> {
    let all: Vec<usize> = (0..table.len()).collect();
    let mut camera = start.camera;
    // A camera without distortion explains the points of the start; the others come in when it can bend.
    let mut used = start.consensus;
    for model in [LensModel::None, LensModel::K1K2, LensModel::Brown5] {
        let model = model.min(largest);
        for _ in 0..2 {
            let noise = fit::noise_of(&camera, table, &used, model.parameters());
            camera = fit::fit(table, &used, camera, model, Some(CAUCHY_SD * noise), None)?;
        }
        used.clone_from(&all);
    }
    Ok(Stand {
        camera,
        model: largest,
        used,
        limit_px: 0.0,
        held: None,
    })
}

/// Removes points beyond the limit and fits again, until the set of used points does not change. Points may come
/// back.
fn reject(
    table: &[LightPoint],
    mut stand: Stand,
    size: (usize, usize),
    beforehand: Beforehand,
) -> Result<Stand, CalibrationError> {
    let hold = beforehand == Beforehand::Lenses;
    for round in 0..REJECTION_ROUNDS {
        // The median of those used would fall each time that points are rejected, and the limit with it.
        let noise = if round == 0 {
            fit::wide_noise_of(&stand.camera, table, stand.model.parameters())
        } else {
            let free = stand.model.parameters() as f64;
            uncertainty::noise_variance(table, &stand, free).1.sqrt()
        };
        stand.limit_px = REJECT_SD * noise.max(LEAST_SPOT_NOISE_PX);
        let fits = |row: &usize| {
            table.get(*row).is_some_and(|point| {
                stand.camera.in_camera_frame(&point.position()).z > 0.0
                    && fit::residual(&stand.camera, point).amax() <= stand.limit_px
            })
        };
        let used: Vec<usize> = (0..table.len()).filter(fits).collect();
        table::check_used(table, &used, stand.limit_px)?;
        // A fit that holds terms by the noise is made with the noise of the points used.
        let unchanged = used == stand.used && round > usize::from(hold);
        stand.used = used;
        if unchanged {
            break;
        }
        stand.model = stand.model.min(LensModel::largest_for(stand.used.len()));
        stand.camera = fit::without_terms_beyond(stand.camera, stand.model);
        // What a robust fit says of k3, which nothing held, decides nothing.
        let seen = match round {
            0 => fit::without_terms_beyond(stand.camera, LensModel::K1K2P1P2),
            _ => stand.camera,
        };
        stand.held = hold.then(|| Held::of(&seen, size, noise));
        let (used, camera, model) = (&stand.used, stand.camera, stand.model);
        stand.camera = fit::fit(table, used, camera, model, None, stand.held.as_ref())?;
    }
    Ok(stand)
}

fn assemble(
    table: &[LightPoint],
    width: usize,
    height: usize,
    stand: &Stand,
) -> Result<Calibration, CalibrationError> {
    let camera = stand.camera;
    table::check_camera(&camera)?;
    let residual = |point| -> [f64; 2] { fit::residual(&camera, point).into() };
    let residuals: Vec<[f64; 2]> = table.iter().map(residual).collect();
    let rejected = residuals.iter().zip(table).enumerate();
    let rejected = rejected.filter(|(row, _)| stand.used.binary_search(row).is_err());
    let rejected = rejected.map(|(row, (&[du, dv], point))| {
        let behind = camera.in_camera_frame(&point.position()).z <= 0.0;
        let outlier = RejectReason::Outlier {
            limit_px: stand.limit_px,
        };
        RejectedPoint {
            row,
            du,
            dv,
            reason: if behind {
                RejectReason::Behind
            } else {
                outlier
            },
        }
    });
    let summary = uncertainty::summarise(table, stand)?;
    Ok(Calibration {
        width,
        height,
        camera,
        model: stand.model,
        monotonic: camera.is_monotonic_over(width, height),
        rms_px: summary.rms_px,
        leave_out_rms_px: summary.leave_out_rms_px,
        noise_px: summary.noise_px,
        used: stand.used.len(),
        rejected: rejected.collect(),
        flatness: table::flatness(table, &stand.used),
        residuals,
        uncertainty: summary.uncertainty,
    })
}

/// Names of the parameters, in the order of [`Camera::project_with_jacobian`].
pub const PARAMETER_NAMES: [&str; PARAMETERS] = [
    "rx", "ry", "rz", "x", "y", "z", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3",
];

#[cfg(test)]
mod tests;
