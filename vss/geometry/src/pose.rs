//! Where a target of known lights stands before a camera of known lens: which light is which, and the pose of all of them.
//!
//! The lights lie in one plane. Four of them and their places in the picture determine the map from that plane to the picture
//! (a homography; R. Hartley and A. Zisserman, Multiple View Geometry, 2004, sections 4.1 and 8.1), and a wrong choice of four
//! puts the others beside their places. The pose is then fitted to the pixels. Knows no picture and no task.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Point3, Rotation3, SMatrix, SVector, Translation3, Unit,
    UnitQuaternion, Vector2, Vector3,
};
use serde::{Deserialize, Serialize};

use crate::{
    adjust::{Adjustable, adjusted, by_differences},
    camera::{Camera, Distortion, Intrinsics},
};

/// Fewest lights: with four every choice fits.
pub const FEWEST_LIGHTS: usize = 5;

/// Most places in a picture that are tried: the choices of four grow with their fourth power.
pub const MOST_PLACES: usize = 14;

/// A light may be beside its place by so many pixels before the fit.
const BESIDE_PX: f64 = 6.0;

/// After the fit the lights may be beside their places by this root of a mean square: more is another thing.
const MOST_RMS_PX: f64 = 2.0;

/// The second best choice must be worse by this factor, as a root of the mean square.
const CLEARLY: f64 = 2.0;

/// Ratio of height and longest side below which three lights lie on a line.
const FLAT: f64 = 1e-3;

/// A coordinate of a light is not known better in a picture, px.
const LEAST_NOISE_PX: f64 = 1e-3;

/// The pose of a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TargetPose {
    /// The target in the camera's frame.
    pub camera_t_target: Isometry3<f64>,
    /// Standard deviations of its rotation vector (3, rad, in the camera's axes) and of its translation (3, m).
    pub sd: [f64; 6],
    /// Root of the mean square distance of the lights from where they should be seen, px.
    pub rms_px: f64,
    /// For each light, the index of its place.
    pub places: Vec<usize>,
}

/// Why there is no pose.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoPose {
    /// Too few lights, or lights that do not lie in one plane, or all on one line.
    #[error(
        "a target has {FEWEST_LIGHTS} lights or more in one plane (z = 0), no three of the first four on a line"
    )]
    Target,
    /// The picture has fewer places than the target has lights.
    #[error("the picture has {0} spots, and the target {1} lights")]
    TooFew(usize, usize),
    /// There are too many to try.
    #[error("the picture has {0} spots; at most {MOST_PLACES} can be told apart")]
    TooMany(usize),
    /// No choice fits.
    #[error("no {0} of the {1} spots are the target")]
    Nowhere(usize, usize),
    /// Two choices fit.
    #[error(
        "the target is seen in two ways, off by {0:.2} and {1:.2} px: its lights are too much alike"
    )]
    Ambiguous(f64, f64),
}

/// The target whose lights are at `lights` (m, its own frame, z = 0), among `places` in the picture (px).
///
/// # Errors
/// [`NoPose`] says what is missing.
pub fn find_target(
    lights: &[Point3<f64>],
    places: &[Vector2<f64>],
    intrinsics: &Intrinsics,
    distortion: &Distortion,
) -> Result<TargetPose, NoPose> {
    let flat = lights.iter().all(|light| light.z == 0.0);
    let base = lights.first_chunk::<4>().filter(|_| flat);
    let base = base.filter(|_| lights.len() >= FEWEST_LIGHTS);
    let base = base.ok_or(NoPose::Target)?.map(|light| light.coords.xy());
    if !spans_the_plane(&base) {
        return Err(NoPose::Target);
    }
    if places.len() < lights.len() {
        return Err(NoPose::TooFew(places.len(), lights.len()));
    }
    if places.len() > MOST_PLACES {
        return Err(NoPose::TooMany(places.len()));
    }
    // Without distortion and focal length; what no direction is seen at is no light.
    let rays = places.iter().map(|place| {
        let (u, v) = (place.x - intrinsics.cx, place.y - intrinsics.cy);
        let ray = distortion.undistort(Vector2::new(u / intrinsics.fx, v / intrinsics.fy));
        ray.unwrap_or(Vector2::repeat(f64::NAN))
    });
    let rays: Vec<Vector2<f64>> = rays.collect();
    let beside = BESIDE_PX / intrinsics.fx.min(intrinsics.fy);
    let mut choices: Vec<(f64, Vec<usize>, Matrix3<f64>)> = Vec::new();
    for four in fours(places.len()) {
        let Some(map) = homography(&base, &four.map(|place| rays[place])) else {
            continue;
        };
        let chosen = lights.iter().map(|light| {
            let seen = map * Vector3::new(light.x, light.y, 1.0);
            let seen = seen.xy() / seen.z;
            let off = |place: &usize| (rays[*place] - seen).norm();
            let nearest = (0..rays.len()).min_by(|a, b| off(a).total_cmp(&off(b)))?;
            let off = off(&nearest);
            (off < beside).then_some((nearest, off))
        });
        let Some(chosen) = chosen.collect::<Option<Vec<_>>>() else {
            continue;
        };
        let (which, offs): (Vec<usize>, Vec<f64>) = chosen.into_iter().unzip();
        let mut different = which.clone();
        different.sort_unstable();
        different.dedup();
        if different.len() == which.len() && !choices.iter().any(|(_, known, _)| *known == which) {
            choices.push((offs.iter().map(|off| off * off).sum(), which, map));
        }
    }
    let mut fits: Vec<TargetPose> = Vec::new();
    for (_, which, map) in choices {
        let seen: Vec<Vector2<f64>> = which.iter().map(|place| places[*place]).collect();
        // A small plane looks almost the same from two sides.
        for start in starts(&map) {
            let fit = fit(lights, &seen, &start, intrinsics, distortion);
            fits.extend(fit.map(|(camera_t_target, sd, rms_px)| TargetPose {
                camera_t_target,
                sd,
                rms_px,
                places: which.clone(),
            }));
        }
    }
    fits.sort_by(|a, b| a.rms_px.total_cmp(&b.rms_px));
    let nowhere = NoPose::Nowhere(lights.len(), places.len());
    let best = fits
        .first()
        .filter(|fit| fit.rms_px < MOST_RMS_PX)
        .ok_or(nowhere)?;
    let mut others = fits.iter().skip(1);
    let other = others.find(|other| {
        let apart = best.camera_t_target.inverse() * other.camera_t_target;
        other.places != best.places || apart.rotation.angle() > 10.0 * best.sd[0].max(1e-6)
    });
    match other {
        Some(other) if other.rms_px < CLEARLY * best.rms_px.max(10.0 * LEAST_NOISE_PX) => {
            Err(NoPose::Ambiguous(best.rms_px, other.rms_px))
        }
        _ => Ok(best.clone()),
    }
}

/// Whether no three of four places lie on a line, or nearly.
fn spans_the_plane(four: &[Vector2<f64>; 4]) -> bool {
    let threes = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
    threes.iter().all(|three| {
        let [a, b, c] = three.map(|k: usize| four[k]);
        let (b, c) = (b - a, c - a);
        b.perp(&c).abs() > FLAT * b.norm_squared().max(c.norm_squared())
    })
}

/// All ordered choices of four out of `n`.
fn fours(n: usize) -> impl Iterator<Item = [usize; 4]> {
    let all = (0..n.pow(4))
        .map(move |code| [code / n.pow(3), code / n.pow(2) % n, code / n % n, code % n]);
    all.filter(|[a, b, c, d]| a != b && a != c && a != d && b != c && b != d && c != d)
}

/// The map of a plane to another one that takes four points to four points.
fn homography(from: &[Vector2<f64>; 4], to: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let (mut rows, mut right) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
    for (k, (p, q)) in from.iter().zip(to).enumerate() {
        let u = [p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y];
        let v = [0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y];
        rows.row_mut(2 * k).copy_from_slice(&u);
        rows.row_mut(2 * k + 1).copy_from_slice(&v);
        (right[2 * k], right[2 * k + 1]) = (q.x, q.y);
    }
    let h = rows.lu().solve(&right)?;
    h.iter()
        .all(|x| x.is_finite())
        .then(|| Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0))
}

/// The pose that a map of the plane z = 0 to the picture means, and the one that is tilted the other way.
fn starts(map: &Matrix3<f64>) -> Vec<Isometry3<f64>> {
    let (one, other) = (map.column(0).into_owned(), map.column(1).into_owned());
    // The map's last entry is 1, so the target's origin is before the camera.
    let scale = 2.0 / (one.norm() + other.norm());
    let (one, other) = (one * scale, other * scale);
    let near = Matrix3::from_columns(&[one, other, one.cross(&other)]);
    let turn = Rotation3::from_matrix_eps(&near, 1e-12, 100, Rotation3::identity());
    let turn = UnitQuaternion::from_rotation_matrix(&turn);
    let place = map.column(2) * scale;
    let shift = Translation3::from(place);
    let sight = place.normalize();
    let normal = turn * Vector3::z();
    let normal = normal * normal.dot(&sight).signum();
    let mut all = vec![Isometry3::from_parts(shift, turn)];
    if let Some(axis) = Unit::try_new(normal.cross(&sight), 1e-6) {
        let tilt = 2.0 * normal.dot(&sight).clamp(-1.0, 1.0).acos();
        let turn = UnitQuaternion::from_axis_angle(&axis, tilt) * turn;
        all.push(Isometry3::from_parts(shift, turn));
    }
    all
}

/// The pixels of known lights, and a pose that explains them.
#[derive(Clone)]
struct Fit<'p> {
    lights: &'p [Point3<f64>],
    seen: &'p [Vector2<f64>],
    intrinsics: &'p Intrinsics,
    distortion: &'p Distortion,
    pose: Isometry3<f64>,
}

impl Fit<'_> {
    /// In px; `None` where a light is behind the camera.
    fn residuals(&self) -> Option<DVector<f64>> {
        let camera = Camera {
            rotation: self.pose.rotation,
            centre: (self.pose.inverse() * Point3::origin()).coords.into(),
            intrinsics: *self.intrinsics,
            distortion: *self.distortion,
        };
        let mut all = Vec::with_capacity(2 * self.lights.len());
        for (light, seen) in self.lights.iter().zip(self.seen) {
            let off = camera.project(light)? - seen;
            all.extend([off.x, off.y]);
        }
        Some(DVector::from_vec(all))
    }
}

impl Adjustable for Fit<'_> {
    fn squares(&self) -> Option<f64> {
        Some(self.residuals()?.norm_squared())
    }

    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        by_differences(6, |by| self.moved(by).residuals())
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        Self {
            pose: turned_and_shifted(&self.pose, step),
            ..self.clone()
        }
    }
}

/// A pose after a turn (its first three components, rad) and a shift (the next three, m) in the outer frame.
pub fn turned_and_shifted(pose: &Isometry3<f64>, by: &DVector<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::new(by.fixed_rows::<3>(0).into_owned());
    let shift = pose.translation.vector + by.fixed_rows::<3>(3);
    Isometry3::from_parts(Translation3::from(shift), turn * pose.rotation)
}

/// Least squares of the pixels, with the standard deviations that the residuals tell, and the residuals' root mean square.
fn fit(
    lights: &[Point3<f64>],
    seen: &[Vector2<f64>],
    start: &Isometry3<f64>,
    intrinsics: &Intrinsics,
    distortion: &Distortion,
) -> Option<(Isometry3<f64>, [f64; 6], f64)> {
    let found = adjusted(Fit {
        lights,
        seen,
        intrinsics,
        distortion,
        pose: *start,
    })?;
    let squares = found.squares()?;
    let spare = (2 * lights.len() - 6) as f64;
    let noise = (squares / spare).sqrt().max(LEAST_NOISE_PX);
    let (normal, _) = found.equations()?;
    let covariance = normal.try_inverse()? * (noise * noise);
    let sd = std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt());
    let rms = (squares / lights.len() as f64).sqrt();
    Some((found.pose, sd, rms))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    fn lens() -> (Intrinsics, Distortion) {
        let intrinsics = Intrinsics {
            fx: 420.0,
            fy: 418.0,
            cx: 250.0,
            cy: 246.0,
        };
        let distortion = Distortion {
            k1: -0.15,
            k2: 0.04,
            p1: 5e-4,
            p2: -4e-4,
            k3: 0.0,
        };
        (intrinsics, distortion)
    }

    /// Lights without any symmetry, m.
    fn lights() -> Vec<Point3<f64>> {
        let places = [
            [0.0, 0.0],
            [0.2, 0.0],
            [0.2, 0.15],
            [0.0, 0.15],
            [0.05, 0.1],
            [0.12, 0.03],
        ];
        places.map(|[x, y]| Point3::new(x, y, 0.0)).to_vec()
    }

    fn seen(pose: &Isometry3<f64>, noise: f64, rng: &mut ChaCha8Rng) -> Vec<Vector2<f64>> {
        let (intrinsics, distortion) = lens();
        let centre = pose.inverse() * Point3::origin();
        let camera = Camera {
            rotation: pose.rotation,
            centre,
            intrinsics,
            distortion,
        };
        let all = lights().into_iter().map(|light| {
            let mut drawn = || noise * rng.sample::<f64, _>(StandardNormal);
            camera.project(&light).unwrap() + Vector2::new(drawn(), drawn())
        });
        all.collect()
    }

    fn random_pose(rng: &mut ChaCha8Rng) -> Isometry3<f64> {
        let mut within = |most: f64| rng.random_range(-most..most);
        let turn = Vector3::new(within(0.6), within(0.6), within(3.0));
        Isometry3::new(
            Vector3::new(within(0.1), within(0.1), 0.7 + within(0.2)),
            Vector3::zeros(),
        ) * Isometry3::rotation(turn)
            * Translation3::new(-0.1, -0.07, 0.0)
    }

    #[test]
    fn lights_in_any_order_among_others_are_found_where_they_are() {
        let (intrinsics, distortion) = lens();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..20 {
            let pose = random_pose(&mut rng);
            let mut places = seen(&pose, 0.0, &mut rng);
            // Another lamp, and the order turned about.
            places.push(Vector2::new(40.0, 460.0));
            places.reverse();
            let found = find_target(&lights(), &places, &intrinsics, &distortion).unwrap();
            let off = found.camera_t_target.inverse() * pose;
            assert!(
                off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6,
                "{off}"
            );
            assert_eq!(found.places, [6, 5, 4, 3, 2, 1]);
        }
    }

    #[test]
    fn errors_are_as_large_as_their_standard_deviations_say() {
        let (intrinsics, distortion) = lens();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut squares, mut count) = ([0.0; 6], 0.0);
        for _ in 0..300 {
            let pose = random_pose(&mut rng);
            let places = seen(&pose, 0.1, &mut rng);
            let Ok(found) = find_target(&lights(), &places, &intrinsics, &distortion) else {
                continue;
            };
            let turn = (pose.rotation * found.camera_t_target.rotation.inverse()).scaled_axis();
            let shift = pose.translation.vector - found.camera_t_target.translation.vector;
            for (k, off) in turn.iter().chain(shift.iter()).enumerate() {
                squares[k] += (off / found.sd[k]).powi(2);
            }
            count += 1.0;
        }
        assert!(count > 250.0, "{count}");
        for square in squares {
            // The noise is told from 6 spare residuals, so the ratio's tails are those of Student's t: its variance is 1.5.
            let rms = (square / count).sqrt();
            assert!((1.0..1.5).contains(&rms), "{squares:?} {count}");
        }
    }

    #[test]
    fn what_determines_no_pose_is_refused_with_the_reason() {
        let (intrinsics, distortion) = lens();
        let find = |lights: &[Point3<f64>], places: &[Vector2<f64>]| {
            find_target(lights, places, &intrinsics, &distortion)
        };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let places = seen(&random_pose(&mut rng), 0.0, &mut rng);
        assert_eq!(find(&lights()[..4], &places), Err(NoPose::Target));
        let mut high = lights();
        high[5].z = 0.1;
        assert_eq!(find(&high, &places), Err(NoPose::Target));
        let mut line = lights();
        line[2] = Point3::new(0.1, 1e-6, 0.0);
        assert_eq!(find(&line, &places), Err(NoPose::Target));
        line[2] = Point3::new(f64::NAN, 0.1, 0.0);
        assert_eq!(find(&line, &places), Err(NoPose::Target));
        assert_eq!(find(&lights(), &places[..5]), Err(NoPose::TooFew(5, 6)));
        let many = vec![Vector2::zeros(); MOST_PLACES + 1];
        assert_eq!(find(&lights(), &many), Err(NoPose::TooMany(15)));
        let elsewhere: Vec<_> = places
            .iter()
            .map(|p| Vector2::new(p.x, 500.0 - p.y * p.x / 300.0))
            .collect();
        assert!(
            matches!(find(&lights(), &elsewhere), Err(NoPose::Nowhere(6, 6))),
            "{:?}",
            find(&lights(), &elsewhere)
        );
        // A square with its middle looks the same from four sides.
        let square = [[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2], [0.1, 0.1]];
        let square = square.map(|[x, y]| Point3::new(x, y, 0.0));
        let places = square.map(|p| Vector2::new(200.0 + 500.0 * p.x, 200.0 + 500.0 * p.y));
        let twice = find_target(&square, &places, &intrinsics, &Distortion::default());
        assert!(matches!(twice, Err(NoPose::Ambiguous(..))), "{twice:?}");
    }
}
