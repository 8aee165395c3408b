//! Cameras that share lights, calibrated together when the robot that carries the light is uncertain itself (bundle
//! adjustment; R. Hartley and A. Zisserman, Multiple View Geometry, 2004, chapter 18 and appendix 6).
//!
//! Unknown are all cameras and all positions of the light. Each position is expected where the robot says, with the standard
//! deviation of the robot, which also fixes the frame: it is that of the robot on the average. Each camera is calibrated by
//! itself first, which tells wrong points. Then all are fitted together, lights eliminated from the normal equations (Schur
//! complement). The noise of the pixels follows from the redundancy of theirs alone (W. Förstner, 1979). Knows numbers only.

use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3, Point3, SMatrix, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::{
    adjust::{Adjustable, adjusted, inverse},
    calibrate::{
        Beforehand, CalibrationError, LensModel, LightPoint, Uncertainty, calibrate_as,
        covariance_means, lens_weights,
    },
    camera::{Camera, PARAMETERS},
};

/// Condition number beyond which cameras are not determined.
const WORST_CONDITION: f64 = 1e8;
/// Rounds in which the noise of the pixels is found.
const ROUNDS: usize = 20;
/// The noise is known when it changes by less than this part.
const STILL: f64 = 5e-3;
/// How well the robot's standard deviation is told: a tenth decides nothing.
const ROUGHLY: f64 = 0.03;
/// No robot is better, m.
const LEAST_ROBOT_M: f64 = 1e-7;
/// No spot is measured better, px.
const LEAST_NOISE_PX: f64 = 1e-4;

/// What several cameras saw of one light.
#[derive(Debug, Clone, Copy)]
pub struct Rig<'a> {
    /// Positions of the light as the robot tells them, m.
    pub lights: &'a [Point3<f64>],
    /// For each camera where it saw each light, px; nothing where it did not.
    pub seen: &'a [Vec<Option<Vector2<f64>>>],
    /// Width and height of the pictures, px.
    pub size: (usize, usize),
    /// Distortion terms.
    pub model: LensModel,
    /// What is known of the lenses.
    pub beforehand: Beforehand,
    /// Standard deviation of each coordinate of a position as the robot tells it, m.
    pub robot_sd_m: f64,
}

/// Cameras and lights with what is known about how good they are.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// The cameras in their order.
    pub cameras: Vec<BundleCamera>,
    /// Where the lights were, with standard deviations of x, y, z, m.
    pub lights: Vec<(Point3<f64>, [f64; 3])>,
    /// Root of the mean over all used pixels of du² + dv², px.
    pub rms_px: f64,
    /// Standard deviation of the noise of a coordinate, px.
    pub noise_px: f64,
    /// The robot's standard deviation as the lights show it, m. Far from what was said, all standard deviations are wrong.
    pub robot_sd_m: f64,
}

/// A camera of several.
#[derive(Debug, Clone, PartialEq)]
pub struct BundleCamera {
    /// The estimate.
    pub camera: Camera,
    /// Standard deviations of it.
    pub uncertainty: Uncertainty,
    /// Lights that it saw and that were not used, by their index: they are off by more than noise explains.
    pub rejected: Vec<usize>,
}

/// Why there is no calibration. Cameras count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BundleError {
    /// The robot's standard deviation is not positive.
    #[error("the robot's standard deviation is {0} m; it is larger than 0")]
    Robot(f64),
    /// There is nothing to calibrate.
    #[error("no camera saw the lights")]
    NoCamera,
    /// A camera with another number of lights.
    #[error(
        "camera {camera} has {places} places for {lights} lights; it has one for each, empty where it did not see it"
    )]
    Places {
        /// Which.
        camera: usize,
        /// Its places.
        places: usize,
        /// The lights.
        lights: usize,
    },
    /// A position of a light is NaN or infinite.
    #[error("the position of light {0} is not finite")]
    NotFinite(usize),
    /// A camera cannot be calibrated by itself.
    #[error("camera {0}: {1}")]
    Camera(usize, CalibrationError),
    /// All together are not determined.
    #[error(
        "the lights do not determine the cameras (condition {0:.1e}); spread them over the pictures and over depth"
    )]
    Undetermined(f64),
}

/// All cameras and lights together. The generator drives the start of each camera.
///
/// # Errors
/// [`BundleError`] with the reason.
pub fn calibrate_together(rig: &Rig<'_>, rng: &mut ChaCha8Rng) -> Result<Bundle, BundleError> {
    checked(rig)?;
    let (mut problem, rejected) = start(rig, rng)?;
    let broken = BundleError::Undetermined(f64::INFINITY);
    for _ in 0..ROUNDS {
        problem = adjusted(problem).ok_or(broken.clone())?;
        let spread = problem.spread()?;
        let noise = spread.noise_px.max(LEAST_NOISE_PX);
        let change = (noise / problem.noise_px - 1.0).abs();
        problem.noise_px = noise;
        if change < STILL {
            break;
        }
    }
    let spread = problem.spread()?;
    let sd =
        |covariance: &Matrix3<f64>| covariance.diagonal().map(|one| one.max(0.0).sqrt()).into();
    let lights = problem.lights.iter().zip(&spread.lights);
    let lights = lights.map(|(light, covariance)| (*light, sd(covariance)));
    let cameras = rejected.into_iter().enumerate();
    Ok(Bundle {
        cameras: cameras
            .map(|(index, rejected)| problem.camera(index, &spread, rejected))
            .collect(),
        lights: lights.collect(),
        rms_px: spread.rms_px,
        noise_px: problem.noise_px,
        robot_sd_m: problem.robot_shown(),
    })
}

/// What can be wrong before anything is computed.
fn checked(rig: &Rig<'_>) -> Result<(), BundleError> {
    if !(rig.robot_sd_m.is_finite() && rig.robot_sd_m > 0.0) {
        return Err(BundleError::Robot(rig.robot_sd_m));
    }
    if rig.seen.is_empty() {
        return Err(BundleError::NoCamera);
    }
    let lights = rig.lights.len();
    if let Some(camera) = rig.seen.iter().position(|seen| seen.len() != lights) {
        return Err(BundleError::Places {
            camera,
            places: rig.seen[camera].len(),
            lights,
        });
    }
    // A light that no camera saw is looked at nowhere else.
    let finite = |light: &Point3<f64>| light.iter().all(|number| number.is_finite());
    match rig.lights.iter().position(|light| !finite(light)) {
        Some(light) => Err(BundleError::NotFinite(light)),
        None => Ok(()),
    }
}

/// The lights that one camera saw, by their index, and the table that they make.
fn table(rig: &Rig<'_>, camera: usize) -> (Vec<usize>, Vec<LightPoint>) {
    let seen = rig.seen.get(camera).into_iter().flatten();
    let rows = rig.lights.iter().zip(seen).enumerate();
    let rows = rows.filter_map(|(light, (at, pixel))| {
        let pixel = (*pixel)?;
        let point = LightPoint {
            x: at.x,
            y: at.y,
            z: at.z,
            u: pixel.x,
            v: pixel.y,
        };
        Some((light, point))
    });
    rows.unzip()
}

/// Each camera by itself, and the lights that it does not use.
fn start(rig: &Rig<'_>, rng: &mut ChaCha8Rng) -> Result<(Together, Vec<Vec<usize>>), BundleError> {
    let mut views: Vec<Vec<(usize, Vector2<f64>)>> = vec![Vec::new(); rig.lights.len()];
    let (mut cameras, mut weights, mut all_rejected) = (Vec::new(), Vec::new(), Vec::new());
    let mut noise_px = f64::INFINITY;
    let (width, height) = rig.size;
    for index in 0..rig.seen.len() {
        let (lights, table) = table(rig, index);
        let light_of = |row: usize| lights.get(row).copied().unwrap_or(row);
        let alone = calibrate_as(&table, width, height, rig.model, rig.beforehand, rng)
            .map_err(|why| BundleError::Camera(index, why.of_row(light_of)))?;
        let rejected = alone.rejected.iter().map(|point| light_of(point.row));
        let rejected: Vec<usize> = rejected.collect();
        for (light, point) in lights.iter().zip(&table) {
            if rejected.binary_search(light).is_err() {
                views[*light].push((index, point.pixel()));
            }
        }
        let mut known = lens_weights(&alone.camera, rig.size, rig.beforehand);
        known.retain(|(parameter, _)| *parameter < rig.model.parameters());
        weights.push(known);
        noise_px = noise_px.min(alone.noise_px);
        cameras.push(alone.camera);
        all_rejected.push(rejected);
    }
    let together = Together {
        cameras,
        lights: rig.lights.to_vec(),
        told: rig.lights.to_vec(),
        views,
        weights,
        free: rig.model.parameters(),
        noise_px: noise_px.max(LEAST_NOISE_PX),
        robot_sd_m: rig.robot_sd_m,
    };
    Ok((together, all_rejected))
}

/// All unknowns at one place.
#[derive(Clone)]
struct Together {
    cameras: Vec<Camera>,
    lights: Vec<Point3<f64>>,
    /// Where the robot said they are.
    told: Vec<Point3<f64>>,
    /// For each light the cameras that use it, and where they saw it.
    views: Vec<Vec<(usize, Vector2<f64>)>>,
    /// For each camera the parameters of which something is known beforehand, and one over its standard deviation.
    weights: Vec<Vec<(usize, f64)>>,
    /// Parameters of a camera.
    free: usize,
    noise_px: f64,
    robot_sd_m: f64,
}

/// How well everything is known.
struct Spread {
    cameras: DMatrix<f64>,
    lights: Vec<Matrix3<f64>>,
    condition: f64,
    rms_px: f64,
    noise_px: f64,
    robot_sd_m: f64,
}

/// A light's part of the normal equations.
struct OfLight {
    /// Its own block, inverted.
    own: Matrix3<f64>,
    right: Vector3<f64>,
    /// With each camera that sees it: the mixed block, `free` x 3.
    mixed: Vec<(usize, DMatrix<f64>)>,
}

impl Together {
    /// Predicted minus seen, with derivatives by the camera and by the light, in standard deviations of the pixels.
    fn view(
        &self,
        light: usize,
        camera: usize,
        pixel: &Vector2<f64>,
    ) -> Option<(Vector2<f64>, DMatrix<f64>, Matrix2x3<f64>)> {
        let camera = self.cameras.get(camera)?;
        let (predicted, by) = camera.project_with_jacobian(self.lights.get(light)?)?;
        let scale = 1.0 / self.noise_px;
        let by_camera = by.columns(0, self.free) * scale;
        // The camera moved one way is the light moved the other way.
        let by_light = by.fixed_view::<2, 3>(0, 3) * -scale;
        let by_camera = DMatrix::from_iterator(2, self.free, by_camera.iter().copied());
        Some(((predicted - pixel) * scale, by_camera, by_light))
    }

    /// From where the robot said, in its standard deviations.
    fn beside(&self, light: usize) -> Vector3<f64> {
        (self.lights[light] - self.told[light]) / self.robot_sd_m
    }

    /// One light's blocks; what it gives to its cameras is added to `normal` and `right`.
    fn of_light(
        &self,
        light: usize,
        normal: &mut DMatrix<f64>,
        right: &mut DVector<f64>,
    ) -> Option<OfLight> {
        let free = self.free;
        let mut own = Matrix3::identity() / self.robot_sd_m.powi(2);
        let mut own_right = -self.beside(light) / self.robot_sd_m;
        let mut mixed = Vec::with_capacity(self.views[light].len());
        for (camera, pixel) in &self.views[light] {
            let (off, by_camera, by_light) = self.view(light, *camera, pixel)?;
            let at = camera * free;
            let mut block = normal.view_mut((at, at), (free, free));
            block += by_camera.transpose() * &by_camera;
            let mut rows = right.rows_mut(at, free);
            rows -= by_camera.transpose() * off;
            own += by_light.transpose() * by_light;
            own_right -= by_light.transpose() * off;
            let block = by_camera.transpose() * by_light;
            let block = DMatrix::from_iterator(free, 3, block.iter().copied());
            mixed.push((*camera, block));
        }
        Some(OfLight {
            own: own.try_inverse()?,
            right: own_right,
            mixed,
        })
    }

    /// The normal equations of the cameras alone, and the blocks of all lights.
    fn reduced(&self) -> Option<(DMatrix<f64>, DVector<f64>, Vec<OfLight>)> {
        let free = self.free;
        let all = self.cameras.len() * free;
        let (mut normal, mut right) = (DMatrix::zeros(all, all), DVector::zeros(all));
        for (index, (camera, weights)) in self.cameras.iter().zip(&self.weights).enumerate() {
            for (parameter, weight) in weights {
                let at = index * free + parameter;
                normal[(at, at)] += weight * weight;
                right[at] -= weight * weight * lens_term(camera, *parameter);
            }
        }
        let mut lights = Vec::with_capacity(self.lights.len());
        for light in 0..self.lights.len() {
            lights.push(self.of_light(light, &mut normal, &mut right)?);
        }
        for light in &lights {
            for (one, with_one) in &light.mixed {
                let by_own = with_one * light.own;
                let mut rows = right.rows_mut(one * free, free);
                rows -= &by_own * light.right;
                for (other, with_other) in &light.mixed {
                    let mut block = normal.view_mut((one * free, other * free), (free, free));
                    block -= &by_own * with_other.transpose();
                }
            }
        }
        Some((normal, right, lights))
    }

    /// The robot's standard deviation as the lights show it, when it and the noise of the pixels are both unknown.
    fn robot_shown(&self) -> f64 {
        let mut shown = self.clone();
        for _ in 0..ROUNDS {
            let Ok(spread) = shown.spread() else {
                break;
            };
            let change = (spread.robot_sd_m / shown.robot_sd_m - 1.0).abs();
            shown.robot_sd_m = spread.robot_sd_m.max(LEAST_ROBOT_M);
            shown.noise_px = spread.noise_px.max(LEAST_NOISE_PX);
            match adjusted(shown.clone()).filter(|_| change > ROUGHLY) {
                Some(next) => shown = next,
                None => break,
            }
        }
        shown.robot_sd_m
    }

    /// How well everything is known here. The noises follow from how many parameters each kind of measurement determines:
    /// all of them together determine all.
    fn spread(&self) -> Result<Spread, BundleError> {
        let undetermined = BundleError::Undetermined;
        let (normal, _, blocks) = self.reduced().ok_or(undetermined(f64::INFINITY))?;
        let (cameras, condition) = inverse(&normal).ok_or(undetermined(f64::INFINITY))?;
        if condition.is_nan() || condition > WORST_CONDITION {
            return Err(undetermined(condition));
        }
        let lights: Vec<Matrix3<f64>> = blocks
            .iter()
            .map(|light| self.of_light_and_cameras(light, &cameras))
            .collect();
        let robot = lights.iter().map(Matrix3::trace).sum::<f64>() / self.robot_sd_m.powi(2);
        let unknown = (cameras.nrows() + 3 * lights.len()) as f64;
        let seen: usize = self.views.iter().map(Vec::len).sum();
        let spare = (2 * seen) as f64 - (unknown - robot - self.known_of_lenses(&cameras));
        let robot_spare = (3 * lights.len()) as f64 - robot;
        let squares = self.pixel_squares().ok_or(undetermined(f64::INFINITY))?;
        let squares = squares * self.noise_px.powi(2);
        let beside: f64 = (0..lights.len())
            .map(|light| self.beside(light).norm_squared())
            .sum();
        Ok(Spread {
            cameras,
            lights,
            condition,
            rms_px: (squares / seen.max(1) as f64).sqrt(),
            noise_px: (squares / spare.max(1.0)).sqrt(),
            robot_sd_m: (beside / robot_spare.max(1e-9)).sqrt() * self.robot_sd_m,
        })
    }

    /// The covariance of a light, from its own block and that of the cameras, m².
    fn of_light_and_cameras(&self, light: &OfLight, cameras: &DMatrix<f64>) -> Matrix3<f64> {
        let free = self.free;
        let mut by_cameras = Matrix3::zeros();
        for (one, with_one) in &light.mixed {
            for (other, with_other) in &light.mixed {
                let block = cameras.view((one * free, other * free), (free, free));
                by_cameras += with_one.transpose() * block * with_other;
            }
        }
        light.own + light.own * by_cameras * light.own
    }

    /// How many lens terms follow from what is known of lenses beforehand.
    fn known_of_lenses(&self, cameras: &DMatrix<f64>) -> f64 {
        let all = self.weights.iter().enumerate();
        let terms = all.flat_map(|(index, weights)| {
            let first = index * self.free;
            weights
                .iter()
                .map(move |(term, weight)| (first + term, weight))
        });
        terms
            .map(|(at, weight)| weight * weight * cameras[(at, at)])
            .sum()
    }

    /// A camera with its standard deviations.
    fn camera(&self, index: usize, spread: &Spread, rejected: Vec<usize>) -> BundleCamera {
        let (free, camera) = (self.free, self.cameras[index]);
        let own = spread
            .cameras
            .view((index * free, index * free), (free, free));
        let mut covariance = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
        covariance.view_mut((0, 0), (free, free)).copy_from(&own);
        let condition = spread.condition;
        BundleCamera {
            camera,
            uncertainty: covariance_means(&camera, &self.lights, &covariance, condition),
            rejected,
        }
    }

    /// Sum of squares of the pixels, in their standard deviations.
    fn pixel_squares(&self) -> Option<f64> {
        let views = self.views.iter().enumerate();
        let all = views.flat_map(|(light, views)| views.iter().map(move |view| (light, view)));
        let squares = all.map(|(light, (camera, pixel))| {
            let predicted = self
                .cameras
                .get(*camera)?
                .project_unchecked(self.lights.get(light)?)?;
            Some((predicted - pixel).norm_squared())
        });
        Some(squares.sum::<Option<f64>>()? / self.noise_px.powi(2))
    }
}

fn lens_term(camera: &Camera, parameter: usize) -> f64 {
    let d = &camera.distortion;
    let terms = [d.k1, d.k2, d.p1, d.p2, d.k3];
    let first = PARAMETERS - terms.len();
    parameter
        .checked_sub(first)
        .and_then(|nth| terms.get(nth))
        .copied()
        .unwrap_or_default()
}

impl Adjustable for Together {
    fn squares(&self) -> Option<f64> {
        let beside = (0..self.lights.len()).map(|light| self.beside(light).norm_squared());
        let cameras = self.cameras.iter().zip(&self.weights);
        let lenses = cameras.flat_map(|(camera, weights)| {
            let terms = weights.iter();
            terms.map(|(parameter, weight)| (weight * lens_term(camera, *parameter)).powi(2))
        });
        Some(self.pixel_squares()? + beside.sum::<f64>() + lenses.sum::<f64>())
    }

    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        self.reduced().map(|(normal, right, _)| (normal, right))
    }

    /// The lights follow the cameras: each takes the step that is best once they have taken theirs.
    fn moved(&self, step: &DVector<f64>) -> Self {
        let mut next = self.clone();
        let free = self.free;
        let Some((_, _, blocks)) = self.reduced() else {
            return next;
        };
        for (light, block) in next.lights.iter_mut().zip(blocks) {
            let mut right = block.right;
            for (camera, mixed) in &block.mixed {
                right -= mixed.transpose() * step.rows(camera * free, free);
            }
            *light += block.own * right;
        }
        for (index, camera) in next.cameras.iter_mut().enumerate() {
            let mut by = [0.0; PARAMETERS];
            let own = step.rows(index * free, free);
            for (to, from) in by.iter_mut().zip(own.iter()) {
                *to = *from;
            }
            *camera = camera.moved_by(&by);
        }
        next
    }
}

#[cfg(test)]
mod tests;
