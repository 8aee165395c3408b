//! The pose of a known object: points of its model, where each is seen, and the lens give camera_T_model.
//!
//! Three points allow up to four poses (`triangle`); random threes find the one that most matches agree with, wrong
//! matches or not. It is fitted to the pixels, matches beyond 3.5 standard deviations are left out, and every other pose that
//! threes allow is fitted, too: when one explains the matches nearly as well, the answer is a refusal. Models may be flat.
//! Knows no picture and no task.

mod triangle;

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Matrix6, Point3, SMatrix, Translation3, UnitQuaternion,
    Vector2, Vector3,
};
use rand::seq::index;
use rand_chacha::ChaCha8Rng;

use crate::{
    adjust::{Adjustable, adjusted, inverse},
    calibrate::left_jacobian,
    camera::{Camera, Distortion, Intrinsics},
};

/// Fewest matches: three allow several poses.
pub const FEWEST_MATCHES: usize = 4;

/// Ratio of extents below which points of a model lie on one line.
const FLAT: f64 = 1e-3;
/// Most threes that are drawn; with half of the matches wrong 120 find right ones often.
const MOST_SAMPLES: usize = 120;
/// So many different poses are fitted.
const MOST_CANDIDATES: usize = 8;
/// What counts as agreement, as an angle: 8 px at a focal length of 800 px.
const AGREE: f64 = 0.01;
/// Matches that are off by more are not those of this model, as an angle: 1.6 px at a focal length of 800 px.
const WORST_NOISE: f64 = 0.002;
/// Poses that are turned by less, rad, are tried as one.
const SAME_TURN: f64 = 0.03;
/// Matches beyond this many standard deviations, in u or in v, are left out.
const REJECT_SD: f64 = 3.5;
/// Rounds of rejection.
const ROUNDS: usize = 20;
/// No place in a picture is known better, px.
const LEAST_NOISE_PX: f64 = 0.01;
/// Another pose must be less likely by this much: the difference of the sums of squares over the variance.
const CLEARLY: f64 = 16.0;
/// Condition number, columns scaled, beyond which a pose is not determined.
const WORST_CONDITION: f64 = 1e7;
/// Three points allow so many poses.
const POSES_OF_THREE: f64 = 4.0;
/// Poses that leave matches out may come about by chance this seldom.
const BY_CHANCE: f64 = 0.01;
/// Coordinates of a model are smaller, m.
const LARGEST_M: f64 = 1e5;
/// Objects are no further away, m: no laboratory is so large.
const FARTHEST_M: f64 = 50.0;

/// A point of the model and where it is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// In the model's frame, m.
    pub point: Point3<f64>,
    /// In the picture, px.
    pub pixel: Vector2<f64>,
}

/// A pose with everything that is known about how good it is.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelPose {
    /// The model in the camera's frame.
    pub camera_t_model: Isometry3<f64>,
    /// Covariance of its rotation vector (3, rad) and its translation (3, m).
    pub covariance: Matrix6<f64>,
    /// Root of the mean over the used matches of du² + dv², px.
    pub rms_px: f64,
    /// Standard deviation of the noise of a coordinate, from 2N - 6 degrees of freedom, px.
    pub noise_px: f64,
    /// Matches that were not used, by their index from 0.
    pub rejected: Vec<usize>,
}

impl ModelPose {
    /// Standard deviations of the rotation vector (3, rad) and the translation (3, m).
    #[must_use]
    pub fn sd(&self) -> [f64; 6] {
        std::array::from_fn(|k| self.covariance[(k, k)].max(0.0).sqrt())
    }
}

/// Why there is no pose. Matches count from 0.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoModelPose {
    /// Too few matches.
    #[error("{0} matches; a pose needs {FEWEST_MATCHES} or more at different points")]
    TooFew(usize),
    /// A number is NaN or infinite.
    #[error("match {0} has a number that is not finite")]
    NotFinite(usize),
    /// The lens sees nothing there.
    #[error(
        "match {row} is seen at ({u:.1}, {v:.1}), where the lens has no direction: is this the lens of that camera?"
    )]
    NoRay {
        /// Which.
        row: usize,
        /// Column, px.
        u: f64,
        /// Row of the picture, px.
        v: f64,
    },
    /// Coordinates with which nothing can be computed.
    #[error(
        "a point of the model is {0:.1e} m from its origin: no object is as large; are coordinates in m, and are all columns right?"
    )]
    TooLarge(f64),
    /// A turn about the line changes nothing.
    #[error(
        "the points of the model lie on one line (thickness/length {0:.1e}): its turn about that line is not seen"
    )]
    OneLine(f64),
    /// No pose explains most of the matches.
    #[error(
        "no pose explains the matches: the best one agrees with {agreeing} of {matches}; are points and pixels of the same rows, the model in m and not mirrored, and u and v in order?"
    )]
    Nowhere {
        /// Matches that agree.
        agreeing: usize,
        /// All.
        matches: usize,
    },
    /// Two poses explain them.
    #[error(
        "two poses explain the matches, off by {first_px:.3} and {second_px:.3} px and turned by {turn_rad:.2} rad from one another; come nearer, tilt the object or match more points, not all in one plane"
    )]
    Ambiguous {
        /// Root mean square of the better one, px.
        first_px: f64,
        /// And of the other one, px.
        second_px: f64,
        /// The angle between them, rad.
        turn_rad: f64,
    },
    /// The object is further away than any laboratory is large.
    #[error(
        "the object would be {0:.0} m before the camera: points of the model are in m; are these millimetres?"
    )]
    TooFar(f64),
    /// The matches leave the pose open.
    #[error(
        "the matches do not determine the pose (condition {0:.1e}): they are seen nearly at one place or in one line"
    )]
    Undetermined(f64),
}

/// Where the model stands before the camera with this lens. The generator draws the threes: the same matches and
/// generator give the same result, bit for bit.
///
/// # Errors
/// [`NoModelPose`] with the reason if no single pose follows.
pub fn model_pose(
    matches: &[Match],
    intrinsics: &Intrinsics,
    distortion: &Distortion,
    rng: &mut ChaCha8Rng,
) -> Result<ModelPose, NoModelPose> {
    let rays = checked(matches, intrinsics, distortion)?;
    let lens = Camera {
        rotation: UnitQuaternion::identity(),
        centre: Point3::origin(),
        intrinsics: *intrinsics,
        distortion: *distortion,
    };
    let limit = AGREE * lens.focal();
    let mut candidates = candidates(matches, &rays, &lens, limit, rng);
    let agreeing = candidates.first().map_or(0, |best| best.agreeing);
    let nowhere = |agreeing| NoModelPose::Nowhere {
        agreeing,
        matches: matches.len(),
    };
    if agreeing < FEWEST_MATCHES || 2 * agreeing < matches.len() {
        return Err(nowhere(agreeing));
    }
    let first = candidates.remove(0);
    let best = settled(matches, first.camera, limit)
        .filter(|best| best.noise_px() < WORST_NOISE * lens.focal())
        .ok_or(nowhere(agreeing))?;
    if best.by_chance(matches) > BY_CHANCE {
        return Err(nowhere(best.used.len()));
    }
    // All others are fitted to the matches that the best one uses.
    let others = candidates.into_iter();
    let others = others.filter_map(|other| fitted(matches, &best.used, other.camera));
    let mut fits: Vec<(f64, Camera)> = others.collect();
    fits.push((best.squares, best.camera));
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    the_only_one(matches, &best.used, &fits)
}

/// The best of all fits to the used matches, best first, unless another one explains them nearly as well.
fn the_only_one(
    matches: &[Match],
    used: &[usize],
    fits: &[(f64, Camera)],
) -> Result<ModelPose, NoModelPose> {
    let Some((&(squares, camera), others)) = fits.split_first() else {
        return Err(NoModelPose::Nowhere {
            agreeing: used.len(),
            matches: matches.len(),
        });
    };
    let found = summary(matches, used, camera, squares)?;
    let away = found.camera_t_model.translation.vector.norm();
    if away > FARTHEST_M {
        return Err(NoModelPose::TooFar(away));
    }
    let noise = found.noise_px.max(LEAST_NOISE_PX);
    let turn = |other: &Camera| (other.rotation * camera.rotation.inverse()).angle();
    let [rx, ry, rz, ..] = found.sd();
    let apart = (10.0 * rx.max(ry).max(rz)).clamp(1e-3, 0.5);
    let rms = |squares: f64| (squares / used.len() as f64).sqrt();
    match others.iter().find(|(_, other)| turn(other) > apart) {
        Some((other_squares, other)) if other_squares - squares < CLEARLY * noise * noise => {
            Err(NoModelPose::Ambiguous {
                first_px: rms(squares),
                second_px: rms(*other_squares),
                turn_rad: turn(other),
            })
        }
        _ => Ok(found),
    }
}

/// Directions at which the points are seen, of length 1.
fn checked(
    matches: &[Match],
    intrinsics: &Intrinsics,
    distortion: &Distortion,
) -> Result<Vec<Vector3<f64>>, NoModelPose> {
    let finite = |one: &Match| {
        let mut numbers = one.point.iter().chain(one.pixel.iter());
        numbers.all(|number| number.is_finite())
    };
    if let Some(row) = matches.iter().position(|one| !finite(one)) {
        return Err(NoModelPose::NotFinite(row));
    }
    let mut different: Vec<&Match> = Vec::new();
    for one in matches {
        if !different.iter().any(|other| other.point == one.point) {
            different.push(one);
        }
        // Of a table of millions no more need be compared.
        if different.len() == FEWEST_MATCHES {
            break;
        }
    }
    if different.len() < FEWEST_MATCHES {
        return Err(NoModelPose::TooFew(different.len()));
    }
    let farthest = matches.iter().map(|one| one.point.coords.amax());
    let farthest = farthest.fold(0.0, f64::max);
    if farthest > LARGEST_M {
        return Err(NoModelPose::TooLarge(farthest));
    }
    let count = matches.len() as f64;
    let middle: Vector3<f64> = matches.iter().map(|one| one.point.coords / count).sum();
    let spread: Matrix3<f64> = matches
        .iter()
        .map(|one| one.point.coords - middle)
        .map(|off| off * off.transpose())
        .sum();
    let mut extents = spread
        .symmetric_eigenvalues()
        .map(|one| one.max(0.0).sqrt());
    extents.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
    let thickness = extents[1] / extents[0];
    if thickness.is_nan() || thickness < FLAT {
        return Err(NoModelPose::OneLine(thickness));
    }
    let ray = |(row, one): (usize, &Match)| {
        let (u, v) = (one.pixel.x, one.pixel.y);
        let plane = Vector2::new(
            (u - intrinsics.cx) / intrinsics.fx,
            (v - intrinsics.cy) / intrinsics.fy,
        );
        let ray = distortion.undistort(plane);
        let ray = ray.map(|ray| Vector3::new(ray.x, ray.y, 1.0).normalize());
        ray.ok_or(NoModelPose::NoRay { row, u, v })
    };
    matches.iter().enumerate().map(ray).collect()
}

/// A pose that three matches allow.
struct Candidate {
    camera: Camera,
    agreeing: usize,
    /// Sum of squared residuals, each cut at the squared limit, px².
    cost: f64,
}

/// The best of the poses that threes allow, each turned from the others, best first.
fn candidates(
    matches: &[Match],
    rays: &[Vector3<f64>],
    lens: &Camera,
    limit: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<Candidate> {
    let n = matches.len();
    let mut best: Vec<Candidate> = Vec::new();
    let mut consider = |three: [usize; 3]| {
        let points = three.map(|row| matches[row].point);
        for pose in triangle::poses(&points, &three.map(|row| rays[row])) {
            let candidate = judged(matches, posed(lens, &pose), limit);
            let same = |other: &Candidate| {
                (other.camera.rotation * candidate.camera.rotation.inverse()).angle() < SAME_TURN
            };
            match best.iter().position(same) {
                Some(known) if best[known].cost <= candidate.cost => continue,
                Some(known) => best[known] = candidate,
                None => best.push(candidate),
            }
            best.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            best.truncate(MOST_CANDIDATES);
        }
    };
    if n * (n - 1) * (n - 2) / 6 <= MOST_SAMPLES {
        for a in 0..n {
            for b in a + 1..n {
                for c in b + 1..n {
                    consider([a, b, c]);
                }
            }
        }
    } else {
        for _ in 0..MOST_SAMPLES {
            let drawn = index::sample(rng, n, 3);
            consider([drawn.index(0), drawn.index(1), drawn.index(2)]);
        }
    }
    best
}

fn judged(matches: &[Match], camera: Camera, limit: f64) -> Candidate {
    let (mut agreeing, mut cost) = (0, 0.0);
    for one in matches {
        let square = residual(&camera, one).map_or(f64::INFINITY, |off| off.norm_squared());
        if square < limit * limit {
            agreeing += 1;
        }
        cost += square.min(limit * limit);
    }
    Candidate {
        camera,
        agreeing,
        cost,
    }
}

/// The lens at a pose: its frame is the camera's, and the world is the model.
fn posed(lens: &Camera, camera_t_model: &Isometry3<f64>) -> Camera {
    Camera {
        rotation: camera_t_model.rotation,
        centre: camera_t_model.inverse() * Point3::origin(),
        ..*lens
    }
}

/// Predicted minus seen, px; nothing for what lies behind the camera.
fn residual(camera: &Camera, one: &Match) -> Option<Vector2<f64>> {
    (camera.in_camera_frame(&one.point).z > 0.0)
        .then(|| camera.project_unchecked(&one.point))?
        .map(|pixel| pixel - one.pixel)
}

/// A fit with the matches that it stands on.
struct Settled {
    camera: Camera,
    used: Vec<usize>,
    squares: f64,
}

impl Settled {
    fn noise_px(&self) -> f64 {
        noise(self.squares, self.used.len())
    }

    /// How many poses are expected to agree with so many of matches that have nothing to do with one another, where some are
    /// left out; 0 where none is (L. Moisan and B. Stival, International Journal of Computer Vision 57, 2004, section 3).
    fn by_chance(&self, matches: &[Match]) -> f64 {
        let (all, used) = (matches.len(), self.used.len());
        if used == all {
            return 0.0;
        }
        let seen = matches.iter().map(|one| one.pixel);
        let low = seen
            .clone()
            .fold(Vector2::repeat(f64::INFINITY), |a, b| a.inf(&b));
        let high = seen.fold(Vector2::repeat(f64::NEG_INFINITY), |a, b| a.sup(&b));
        let area = (high - low).map(|side| side.max(1.0)).product();
        let near = 2.0 * REJECT_SD * self.noise_px().max(LEAST_NOISE_PX);
        let share = (near * near / area).min(1.0);
        // The logarithm: of many matches the numbers overflow.
        let choices = ln_choose(all, used) + ln_choose(used, 3);
        let poses = (POSES_OF_THREE * (all - 3) as f64).ln();
        (poses + choices + (used - 3) as f64 * share.ln()).exp()
    }
}

/// The logarithm of the number of ways to choose `k` of `n`.
fn ln_choose(n: usize, k: usize) -> f64 {
    (0..k.min(n))
        .map(|i| ((n - i) as f64 / (k - i) as f64).ln())
        .sum()
}

/// Fits, leaves out what is too far off, takes back what is near, and fits again until nothing changes.
fn settled(matches: &[Match], mut camera: Camera, mut limit: f64) -> Option<Settled> {
    let mut used: Vec<usize> = Vec::new();
    let mut squares = 0.0;
    for _ in 0..ROUNDS {
        let near = |row: &usize| {
            let off = matches.get(*row).and_then(|one| residual(&camera, one));
            off.is_some_and(|off| off.amax() <= limit)
        };
        let now: Vec<usize> = (0..matches.len()).filter(near).collect();
        if now.len() < FEWEST_MATCHES || 2 * now.len() < matches.len() {
            return None;
        }
        if now == used {
            break;
        }
        used = now;
        (squares, camera) = fitted(matches, &used, camera)?;
        limit = REJECT_SD * noise(squares, used.len()).max(LEAST_NOISE_PX);
    }
    Some(Settled {
        camera,
        used,
        squares,
    })
}

fn noise(squares: f64, used: usize) -> f64 {
    (squares / (2 * used).saturating_sub(6).max(1) as f64).sqrt()
}

/// The pose of least squares over the used matches, and its sum of squares, px².
fn fitted(matches: &[Match], used: &[usize], start: Camera) -> Option<(f64, Camera)> {
    let matches = used.iter().filter_map(|row| matches.get(*row)).copied();
    let fit = adjusted(Fit {
        matches: matches.collect(),
        camera: start,
    })?;
    Some((fit.squares()?, fit.camera))
}

struct Fit {
    matches: Vec<Match>,
    camera: Camera,
}

impl Fit {
    /// Predicted minus seen, and its derivatives by a turn about the camera's axes and a shift of the translation.
    fn row(&self, one: &Match) -> Option<(Vector2<f64>, SMatrix<f64, 2, 6>)> {
        let off = residual(&self.camera, one)?;
        let (_, by_all) = self.camera.project_with_jacobian(&one.point)?;
        let turn = self.camera.rotation.to_rotation_matrix().into_inner();
        // A shift of the centre by C moves the point in the camera's frame by -R C.
        let by_shift = -by_all.fixed_view::<2, 3>(0, 3) * turn.transpose();
        let arm = self.camera.rotation * one.point.coords;
        let mut by = SMatrix::<f64, 2, 6>::zeros();
        by.fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(-by_shift * arm.cross_matrix()));
        by.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_shift);
        Some((off, by))
    }
}

impl Adjustable for Fit {
    fn squares(&self) -> Option<f64> {
        let squares = self.matches.iter().map(|one| {
            let off = residual(&self.camera, one)?;
            Some(off.norm_squared())
        });
        squares.sum()
    }

    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let (mut normal, mut right) = (DMatrix::zeros(6, 6), DVector::zeros(6));
        for one in &self.matches {
            let (off, by) = self.row(one)?;
            normal += by.transpose() * by;
            right -= by.transpose() * off;
        }
        Some((normal, right))
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        let pose = self.camera.camera_from_world();
        let turn = UnitQuaternion::new(step.fixed_rows::<3>(0).into_owned());
        let shift = pose.translation.vector + step.fixed_rows::<3>(3);
        let pose = Isometry3::from_parts(Translation3::from(shift), turn * pose.rotation);
        Self {
            matches: self.matches.clone(),
            camera: posed(&self.camera, &pose),
        }
    }
}

fn summary(
    matches: &[Match],
    used: &[usize],
    camera: Camera,
    squares: f64,
) -> Result<ModelPose, NoModelPose> {
    let chosen = used.iter().filter_map(|row| matches.get(*row)).copied();
    let fit = Fit {
        matches: chosen.collect(),
        camera,
    };
    let (normal, _) = fit
        .equations()
        .ok_or(NoModelPose::Undetermined(f64::INFINITY))?;
    let (unit, condition) = inverse(&normal).ok_or(NoModelPose::Undetermined(f64::INFINITY))?;
    if condition.is_nan() || condition > WORST_CONDITION {
        return Err(NoModelPose::Undetermined(condition));
    }
    let noise_px = noise(squares, used.len());
    let camera_t_model = camera.camera_from_world();
    // A turn δ on the left changes the rotation vector r by J(r)⁻¹ δ.
    let by_turn = left_jacobian(camera_t_model.rotation.scaled_axis()).try_inverse();
    let mut change = Matrix6::identity();
    change
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&by_turn.unwrap_or_else(Matrix3::identity));
    let unit: Matrix6<f64> = unit.fixed_view::<6, 6>(0, 0).into_owned();
    let rejected = (0..matches.len()).filter(|row| used.binary_search(row).is_err());
    Ok(ModelPose {
        camera_t_model,
        covariance: change * unit * change.transpose() * noise_px.powi(2),
        rms_px: (squares / used.len() as f64).sqrt(),
        noise_px,
        rejected: rejected.collect(),
    })
}

#[cfg(test)]
mod tests;
