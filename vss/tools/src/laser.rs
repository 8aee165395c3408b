//! A laser scanner with two mirrors: where its beam goes, where it must be sent to meet a point, where a camera sees that it met
//! something, and its calibration from points that it met. Knows no picture and no task.
//!
//! Scanner frame: z forward, x to the side, y downwards. The first mirror turns the beam by the angle a towards x, the second
//! one, `offset` behind it on the way of the light, by b towards y. So the beam leaves from (offset tan a, 0, 0) along
//! (sin a, cos a sin b, cos a cos b). The angles are those of the light, twice those of the mirrors. m, rad, px.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Point3, SVector, Translation3, Unit, UnitQuaternion,
    Vector2, Vector3,
};
use serde::{Deserialize, Serialize};

use crate::camera::Camera;

/// A ray of light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Beam {
    /// Where it leaves the scanner.
    pub origin: Point3<f64>,
    /// Where it goes.
    pub direction: Unit<Vector3<f64>>,
}

/// A scanner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Scanner {
    /// Its frame in the world.
    pub world_t_scanner: Isometry3<f64>,
    /// Way of the light between the mirrors, m.
    pub offset: f64,
    /// Angles a and b for a command of 1, rad.
    pub gain: [f64; 2],
    /// Angles a and b for a command of 0, rad.
    pub zero: [f64; 2],
}

impl Scanner {
    /// The beam at a command for both mirrors, in the world.
    #[must_use]
    pub fn beam(&self, command: [f64; 2]) -> Beam {
        let [a, b] = std::array::from_fn(|k| self.gain[k] * command[k] + self.zero[k]);
        let origin = Point3::new(self.offset * a.tan(), 0.0, 0.0);
        let direction = Vector3::new(a.sin(), a.cos() * b.sin(), a.cos() * b.cos());
        Beam {
            origin: self.world_t_scanner * origin,
            // Its squares add up to 1.
            direction: Unit::new_unchecked(self.world_t_scanner * direction),
        }
    }

    /// The command at which the beam meets a point of the world; `None` behind the scanner.
    #[must_use]
    pub fn aim(&self, point: &Point3<f64>) -> Option<[f64; 2]> {
        let p = self.world_t_scanner.inverse() * point;
        if p.z <= 0.0 {
            return None;
        }
        let b = p.y.atan2(p.z);
        let a = (p.x / (self.offset + p.y.hypot(p.z))).atan();
        let command = [
            (a - self.zero[0]) / self.gain[0],
            (b - self.zero[1]) / self.gain[1],
        ];
        command.iter().all(|x| x.is_finite()).then_some(command)
    }
}

/// What a laser scanner does.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum LaserOrder {
    /// It is off.
    #[default]
    Off,
    /// A spot at a command for both mirrors.
    Spot([f64; 2]),
    /// A line between two commands, drawn faster than any exposure.
    Line([f64; 2], [f64; 2]),
}

/// All points x with normal . x = distance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Plane {
    /// Its direction.
    pub normal: Unit<Vector3<f64>>,
    /// Its distance from the origin along that, m.
    pub distance: f64,
}

/// A place on a ray of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Met {
    /// Where.
    pub place: Point3<f64>,
    /// How far the camera's ray and the beam are apart there, m; 0 with a plane. Many times what noise explains says that the
    /// spot is no spot of this beam.
    pub gap: f64,
}

/// Why nothing follows.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoLaser {
    /// Nothing is seen at that pixel, or behind the camera.
    #[error("the camera sees nothing there, or the place is behind it")]
    Nowhere,
    /// Rays that are nearly parallel meet anywhere.
    #[error(
        "the camera's ray and the light enclose {0:.2} degrees, less than {LEAST_DEGREES}: where they meet cannot be told"
    )]
    Parallel(f64),
    /// Too few points.
    #[error("{0} points; {1} or more are needed")]
    TooFew(usize, usize),
    /// Points on a line or on one plane.
    #[error(
        "the points do not determine it: they lie on one line, or on one plane through the scanner"
    )]
    Undetermined,
}

/// Rays that enclose less meet nowhere, degrees.
pub const LEAST_DEGREES: f64 = 1.0;

/// The ray that a camera sees a pixel by: its centre and its direction in the world.
fn ray(camera: &Camera, pixel: Vector2<f64>) -> Option<(Point3<f64>, Vector3<f64>)> {
    let direction = camera.rotation.inverse() * camera.ray(pixel)?;
    Some((camera.centre, direction.normalize()))
}

/// Where the spot of a beam is that a camera sees at a pixel: in the middle of where both rays are nearest.
///
/// # Errors
/// [`NoLaser::Parallel`] and [`NoLaser::Nowhere`].
pub fn on_beam(camera: &Camera, pixel: Vector2<f64>, beam: &Beam) -> Result<Met, NoLaser> {
    let (eye, sight) = ray(camera, pixel).ok_or(NoLaser::Nowhere)?;
    let light = beam.direction.into_inner();
    let cosine = sight.dot(&light);
    let sine = sight.cross(&light).norm();
    if sine < LEAST_DEGREES.to_radians().sin() {
        return Err(NoLaser::Parallel(sine.asin().to_degrees()));
    }
    let between = beam.origin - eye;
    let along_sight = (between.dot(&sight) - cosine * between.dot(&light)) / (sine * sine);
    let along_light = (cosine * between.dot(&sight) - between.dot(&light)) / (sine * sine);
    let (one, other) = (eye + sight * along_sight, beam.origin + light * along_light);
    if along_sight <= 0.0 || along_light <= 0.0 {
        return Err(NoLaser::Nowhere);
    }
    Ok(Met {
        place: nalgebra::center(&one, &other),
        gap: (one - other).norm(),
    })
}

/// Where a point of a line of light is that a camera sees at a pixel: the line lies in a plane of light.
///
/// # Errors
/// As [`on_beam`].
pub fn on_plane(camera: &Camera, pixel: Vector2<f64>, light: &Plane) -> Result<Met, NoLaser> {
    let (eye, sight) = ray(camera, pixel).ok_or(NoLaser::Nowhere)?;
    let rise = light.normal.dot(&sight);
    if rise.abs() < LEAST_DEGREES.to_radians().sin() {
        return Err(NoLaser::Parallel(rise.abs().asin().to_degrees()));
    }
    let along = (light.distance - light.normal.dot(&eye.coords)) / rise;
    if along <= 0.0 {
        return Err(NoLaser::Nowhere);
    }
    Ok(Met {
        place: eye + sight * along,
        gap: 0.0,
    })
}

/// The plane through points that a line of light met, with the root mean square of their distances from it, m.
///
/// # Errors
/// Fewer than three, or all on one line.
pub fn plane_through(points: &[Point3<f64>]) -> Result<(Plane, f64), NoLaser> {
    const FEWEST: usize = 3;
    if points.len() < FEWEST {
        return Err(NoLaser::TooFew(points.len(), FEWEST));
    }
    let n = points.len() as f64;
    let middle = points
        .iter()
        .map(|point| point.coords)
        .sum::<Vector3<f64>>()
        / n;
    let spread = points.iter().map(|point| {
        let off = point.coords - middle;
        off * off.transpose()
    });
    let spread: Matrix3<f64> = spread.sum::<Matrix3<f64>>() / n;
    let parts = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| parts.eigenvalues[*a].total_cmp(&parts.eigenvalues[*b]));
    let [least, second, most] = order.map(|at| parts.eigenvalues[at].max(0.0).sqrt());
    // Of points on a line both smaller extents are noise.
    if !(most > 0.0 && second > 1e-3 * most && second > 2.0 * least) {
        return Err(NoLaser::Undetermined);
    }
    let normal = Unit::new_normalize(parts.eigenvectors.column(order[0]).into_owned());
    let plane = Plane {
        normal,
        distance: normal.dot(&middle),
    };
    Ok((plane, least))
}

/// A calibrated scanner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fitted {
    /// The scanner. The zero of its second mirror is that of the start: it is the same as a turn about x.
    pub scanner: Scanner,
    /// Root of the mean square distance of the points from their beams, m.
    pub rms_m: f64,
    /// Standard deviations: of a turn about the axes of the world (rad), of the shift (m), of the offset (m), of both gains and
    /// of the zero of the first mirror (rad).
    pub sd: [f64; UNKNOWN],
}

/// Unknowns of a scanner: turn and shift of its frame, offset, gains, zero of the first mirror.
const UNKNOWN: usize = 10;

/// Fewest points of a calibration.
pub const FEWEST_POINTS: usize = 8;

/// Fits a scanner to commands and the points (world, m) that its beam met at them; `start` is what is known of it, within
/// some degrees and centimetres. The points must be on two planes or more.
///
/// # Errors
/// Too few points, or points that do not determine it.
pub fn calibrate(met: &[([f64; 2], Point3<f64>)], start: &Scanner) -> Result<Fitted, NoLaser> {
    const STEPS: [f64; UNKNOWN] = [1e-6; UNKNOWN];
    if met.len() < FEWEST_POINTS {
        return Err(NoLaser::TooFew(met.len(), FEWEST_POINTS));
    }
    // How far each point is beside its beam, in two directions across it.
    let residuals = |scanner: &Scanner| {
        let all = met.iter().flat_map(|(command, point)| {
            let beam = scanner.beam(*command);
            let across = scanner.world_t_scanner * Vector3::x();
            let one = beam.direction.cross(&across).normalize();
            let other = beam.direction.cross(&one);
            let off = point - beam.origin;
            [off.dot(&one), off.dot(&other)]
        });
        DVector::from_iterator(2 * met.len(), all)
    };
    let moved = |scanner: &Scanner, by: &SVector<f64, UNKNOWN>| {
        let pose = scanner.world_t_scanner;
        let turn = UnitQuaternion::new(by.fixed_rows::<3>(0).into_owned());
        let shift = pose.translation.vector + by.fixed_rows::<3>(3);
        Scanner {
            world_t_scanner: Isometry3::from_parts(Translation3::from(shift), turn * pose.rotation),
            offset: scanner.offset + by[6],
            gain: [scanner.gain[0] + by[7], scanner.gain[1] + by[8]],
            zero: [scanner.zero[0] + by[9], scanner.zero[1]],
        }
    };
    let jacobian_at = |scanner: &Scanner| {
        let mut jacobian = DMatrix::zeros(2 * met.len(), UNKNOWN);
        for (column, step) in STEPS.iter().enumerate() {
            let mut by = SVector::zeros();
            by[column] = *step;
            let slope =
                (residuals(&moved(scanner, &by)) - residuals(&moved(scanner, &-by))) / (2.0 * step);
            jacobian.set_column(column, &slope);
        }
        jacobian
    };
    let (mut scanner, mut damping) = (*start, 1e-3);
    let mut off = residuals(&scanner);
    for _ in 0..100 {
        let jacobian = jacobian_at(&scanner);
        let mut normal = jacobian.tr_mul(&jacobian);
        for k in 0..UNKNOWN {
            normal[(k, k)] *= 1.0 + damping;
        }
        let step = normal.cholesky().ok_or(NoLaser::Undetermined)?;
        let step = step.solve(&-jacobian.tr_mul(&off));
        let step = SVector::<f64, UNKNOWN>::from_iterator(step.iter().copied());
        let there = moved(&scanner, &step);
        let next = residuals(&there);
        if next.norm() <= off.norm() {
            (scanner, off, damping) = (there, next, damping * 0.1);
        } else {
            damping *= 10.0;
        }
        if step.amax() < 1e-12 || damping > 1e9 {
            break;
        }
    }
    let rms_m = (off.norm_squared() / met.len() as f64).sqrt();
    if !rms_m.is_finite() {
        return Err(NoLaser::Undetermined);
    }
    let unit = unit_covariance(&jacobian_at(&scanner)).ok_or(NoLaser::Undetermined)?;
    // Two distances of each point, less what was fitted.
    let noise = off.norm_squared() / (2 * met.len() - UNKNOWN) as f64;
    let sd = std::array::from_fn(|k| (noise * unit[(k, k)]).max(0.0).sqrt());
    Ok(Fitted { scanner, rms_m, sd })
}

/// The covariance of the unknowns for noise of 1 m; `None` when the points leave one of them open.
fn unit_covariance(jacobian: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    const LEAST: f64 = 1e-10;
    let lengths: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
    let mut scaled = jacobian.clone();
    for (mut column, length) in scaled.column_iter_mut().zip(&lengths) {
        column /= *length;
    }
    let parts = (scaled.transpose() * &scaled).symmetric_eigen();
    let (least, most) = (parts.eigenvalues.min(), parts.eigenvalues.max());
    if least.is_nan() || least <= LEAST * most {
        return None;
    }
    let inverse = parts.eigenvalues.map(|value| 1.0 / value);
    let mut unit =
        &parts.eigenvectors * DMatrix::from_diagonal(&inverse) * parts.eigenvectors.transpose();
    for (row, first) in lengths.iter().enumerate() {
        for (column, second) in lengths.iter().enumerate() {
            unit[(row, column)] /= first * second;
        }
    }
    Some(unit)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::camera::{Distortion, Intrinsics};

    fn scanner() -> Scanner {
        Scanner {
            world_t_scanner: Isometry3::new(
                Vector3::new(0.3, -0.2, 1.5),
                Vector3::new(2.9, 0.3, 0.2),
            ),
            offset: 0.018,
            gain: [0.06, -0.055],
            zero: [0.004, -0.006],
        }
    }

    fn camera() -> Camera {
        let world_t_camera =
            Isometry3::new(Vector3::new(-0.4, 0.1, 1.6), Vector3::new(3.0, -0.2, 0.1));
        Camera {
            rotation: world_t_camera.rotation.inverse(),
            centre: world_t_camera.translation.vector.into(),
            intrinsics: Intrinsics {
                fx: 600.0,
                fy: 590.0,
                cx: 250.0,
                cy: 240.0,
            },
            distortion: Distortion {
                k1: -0.1,
                k2: 0.02,
                p1: 3e-4,
                p2: -2e-4,
                k3: 0.0,
            },
        }
    }

    /// Where a beam meets the plane at that height.
    fn at_height(beam: &Beam, z: f64) -> Point3<f64> {
        beam.origin + beam.direction.into_inner() * ((z - beam.origin.z) / beam.direction.z)
    }

    proptest! {
        #[test]
        fn the_beam_sent_to_a_point_meets_it(a in -5.0..5.0_f64, b in -5.0..5.0_f64, z in -0.2..0.8_f64) {
            let point = at_height(&scanner().beam([a, b]), z);
            let [x, y] = scanner().aim(&point).unwrap();
            prop_assert!((x - a).abs() < 1e-9 && (y - b).abs() < 1e-9);
        }

        #[test]
        fn a_spot_and_a_point_of_a_line_are_where_they_were(a in -3.0..3.0_f64, b in -3.0..3.0_f64, z in 0.0..0.6_f64) {
            let (beam, camera) = (scanner().beam([a, b]), camera());
            let point = at_height(&beam, z);
            if let Some(pixel) = camera.project(&point) {
                let met = on_beam(&camera, pixel, &beam).unwrap();
                prop_assert!((met.place - point).norm() < 1e-6 && met.gap < 1e-6, "{met:?}");
                let light = Plane { normal: Vector3::y_axis(), distance: point.y };
                let met = on_plane(&camera, pixel, &light);
                if let Ok(met) = met {
                    prop_assert!((met.place - point).norm() < 1e-6, "{met:?}");
                }
                // A spot beside the beam is told by the gap.
                let beside = on_beam(&camera, pixel + Vector2::new(30.0, 30.0), &beam);
                prop_assert!(beside.is_err() || beside.unwrap().gap > 1e-3);
            }
        }
    }

    #[test]
    fn a_beam_along_the_cameras_ray_is_refused() {
        let camera = camera();
        let pixel = Vector2::new(260.0, 250.0);
        let (_, sight) = ray(&camera, pixel).unwrap();
        let direction = Unit::new_normalize(sight);
        let beam = Beam {
            origin: camera.centre + Vector3::new(1e-3, 0.0, 0.0),
            direction,
        };
        assert!(matches!(
            on_beam(&camera, pixel, &beam),
            Err(NoLaser::Parallel(_))
        ));
        let along = Plane {
            normal: Unit::new_normalize(direction.cross(&Vector3::x())),
            distance: 0.0,
        };
        assert!(matches!(
            on_plane(&camera, pixel, &along),
            Err(NoLaser::Parallel(_))
        ));
    }

    #[test]
    fn the_plane_of_light_goes_through_what_the_line_met() {
        // One mirror stands still, the other one turns: on two floors.
        let points: Vec<Point3<f64>> = (-10..=10)
            .flat_map(|k| {
                [0.0, 0.3].map(|z| at_height(&scanner().beam([f64::from(k) * 0.4, 1.0]), z))
            })
            .collect();
        let (plane, rms) = plane_through(&points).unwrap();
        assert!(rms < 1e-9, "{rms}");
        for point in &points {
            assert!((plane.normal.dot(&point.coords) - plane.distance).abs() < 1e-9);
        }
        // One floor alone is a line.
        let line: Vec<Point3<f64>> = points.iter().step_by(2).copied().collect();
        assert_eq!(plane_through(&line), Err(NoLaser::Undetermined));
        assert_eq!(plane_through(&line[..2]), Err(NoLaser::TooFew(2, 3)));
    }

    #[test]
    fn a_scanner_is_calibrated_from_points_on_two_planes() {
        let truth = scanner();
        let mut met = Vec::new();
        for z in [0.0, 0.4] {
            for a in -3..=3 {
                for b in -3..=3 {
                    let command = [1.5 * f64::from(a), 1.5 * f64::from(b)];
                    met.push((command, at_height(&truth.beam(command), z)));
                }
            }
        }
        let start = Scanner {
            world_t_scanner: Isometry3::new(
                Vector3::new(0.32, -0.18, 1.45),
                Vector3::new(2.85, 0.32, 0.15),
            ),
            offset: 0.01,
            gain: [0.055, -0.06],
            zero: [0.0, 0.0],
        };
        let found = calibrate(&met, &start).unwrap();
        assert!(found.rms_m < 1e-6, "{found:?}");
        for command in [[0.7, -3.3], [-4.0, 2.0], [5.0, 5.0]] {
            for z in [-0.1, 0.2, 0.7] {
                let (one, other) = (found.scanner.beam(command), truth.beam(command));
                let off = at_height(&one, z) - at_height(&other, z);
                assert!(off.norm() < 1e-5, "{command:?} {z}: {off}");
            }
        }
        assert_eq!(
            calibrate(&met[..5], &start),
            Err(NoLaser::TooFew(5, FEWEST_POINTS))
        );
        // The same point again and again leaves all but two unknowns open.
        assert_eq!(calibrate(&[met[0]; 20], &start), Err(NoLaser::Undetermined));
    }

    /// Points with noise of 1 mm: the beams, the gains and the place are off by what is answered.
    #[test]
    fn a_calibrated_scanner_is_off_by_its_standard_deviations() {
        let truth = scanner();
        let (mut squares, sets) = ([0.0; UNKNOWN], 200);
        for seed in 0..sets {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut noise = || {
                let drawn: f64 = rng.sample(StandardNormal);
                1e-3 * drawn
            };
            let mut met = Vec::new();
            for at in 0..50 {
                let command = [
                    1.5 * f64::from(at % 5) - 3.0,
                    1.5 * f64::from(at / 5 % 5) - 3.0,
                ];
                let point = at_height(&truth.beam(command), if at < 25 { 0.0 } else { 0.4 });
                met.push((command, point + Vector3::new(noise(), noise(), noise())));
            }
            let Fitted { scanner, sd, .. } = calibrate(&met, &truth).unwrap();
            let turn = scanner.world_t_scanner.rotation * truth.world_t_scanner.rotation.inverse();
            let turn = turn.scaled_axis();
            let shift = scanner.world_t_scanner.translation.vector
                - truth.world_t_scanner.translation.vector;
            let off = [
                turn.x,
                turn.y,
                turn.z,
                shift.x,
                shift.y,
                shift.z,
                scanner.offset - truth.offset,
                scanner.gain[0] - truth.gain[0],
                scanner.gain[1] - truth.gain[1],
                scanner.zero[0] - truth.zero[0],
            ];
            for ((square, off), sd) in squares.iter_mut().zip(off).zip(sd) {
                *square += (off / sd).powi(2) / sets as f64;
            }
        }
        for square in squares {
            assert!((0.85..1.15).contains(&square.sqrt()), "{squares:?}");
        }
    }
}
