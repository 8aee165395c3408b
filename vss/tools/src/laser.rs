//! A laser scanner with two mirrors: where its beam goes, where it must be sent to meet a point, where a camera sees that it met
//! something, and its calibration from points that it met. Knows no picture and no task.
//!
//! Scanner frame: z forward, x to the side, y downwards. The first mirror turns the beam by the angle a towards x, the second
//! one, `offset` behind it on the way of the light, by b towards y. So the beam leaves from (offset tan a, 0, 0) along
//! (sin a, cos a sin b, cos a cos b). The angles are those of the light, twice those of the mirrors. m, rad, px.

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Point3, Unit, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use vss_geometry::{
    adjust::{Adjustable, adjusted, by_differences, inverse},
    pose::turned_and_shifted,
};

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

    /// The angles of the light at a command, rad.
    ///
    /// # Errors
    /// [`NoLaser::Turned`] when no mirror turns as far.
    pub fn angles(&self, command: [f64; 2]) -> Result<[f64; 2], NoLaser> {
        let [a, b] = std::array::from_fn(|k| self.gain[k] * command[k] + self.zero[k]);
        if a.abs().max(b.abs()) > WIDEST_DEGREES.to_radians() {
            return Err(NoLaser::Turned(a, b));
        }
        Ok([a, b])
    }

    /// The command at which the beam meets a point of the world; `None` where no beam goes.
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
        self.angles(command).is_ok().then_some(command)
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
    /// Points farther apart than any laboratory.
    #[error("the points are {0:.1e} m apart (rms): places are in m; are these millimetres?")]
    TooLarge(f64),
    /// No mirror sends the beam there.
    #[error(
        "the place is not before the scanner, or more than {WIDEST_DEGREES} degrees beside its axis: no beam goes there; is the scanner's \
         pose right, z forward?"
    )]
    Beyond,
    /// A command that no mirror follows.
    #[error(
        "the command turns the beam by {0:.3} and {1:.3} rad, more than {WIDEST_DEGREES} degrees: are gain and zero right?"
    )]
    Turned(f64, f64),
    /// The fit explains nothing.
    #[error(
        "no scanner near the start explains the points: they are {rms:.3} m (rms) beside their beams, and the mirrors would be {offset:.2} m \
         apart; are a and b in order, commands and points of the same rows, and is the start near?"
    )]
    Disagree {
        /// Root of the mean square distance of the points from their beams, m.
        rms: f64,
        /// Between the mirrors, m.
        offset: f64,
    },
}

/// No mirror turns the light farther, degrees.
pub const WIDEST_DEGREES: f64 = 80.0;

/// Points of a calibration are no farther apart (rms), m.
const LARGEST_M: f64 = 10.0;

/// Points at one place are nearer than that, m.
const ONE_PLACE_M: f64 = 1e-5;

/// Points may be beside their beams (rms) by so much of their distance from the scanner.
const MOST_BESIDE: f64 = 0.01;

/// Mirrors are no farther apart, m.
const MOST_OFFSET_M: f64 = 1.0;

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

/// A plane of light, fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedPlane {
    /// The plane.
    pub plane: Plane,
    /// Root of the mean square distance of the points from it, m.
    pub rms_m: f64,
    /// Standard deviations of the components of its normal, and of its distance from the origin (m).
    pub sd: [f64; 4],
}

/// How far points spread: their middle, the mean squares along three axes in ascending order (m^2), and these axes.
fn spread(points: &[Point3<f64>]) -> (Vector3<f64>, [f64; 3], [Vector3<f64>; 3]) {
    let n = points.len() as f64;
    let middle: Vector3<f64> = points.iter().map(|point| point.coords / n).sum();
    let squares = points.iter().map(|point| {
        let off = point.coords - middle;
        off * off.transpose() / n
    });
    let parts = squares.sum::<Matrix3<f64>>().symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| parts.eigenvalues[*a].total_cmp(&parts.eigenvalues[*b]));
    let squares = order.map(|at| parts.eigenvalues[at].max(0.0));
    (
        middle,
        squares,
        order.map(|at| parts.eigenvectors.column(at).into_owned()),
    )
}

/// Places that are in m, and numbers with which something can be computed.
fn check_size(points: impl Iterator<Item = Point3<f64>>) -> Result<(), NoLaser> {
    let points: Vec<Point3<f64>> = points.collect();
    let farthest = points
        .iter()
        .fold(0.0_f64, |most, one| most.max(one.coords.amax()));
    let middle = points.first().map_or(Vector3::zeros(), |one| one.coords);
    let squares: f64 = points
        .iter()
        .map(|one| (one.coords - middle).norm_squared())
        .sum();
    let apart = (squares / points.len().max(1) as f64).sqrt();
    // Squares of enormous numbers overflow.
    if apart.is_nan() || apart > LARGEST_M {
        return Err(NoLaser::TooLarge(apart.min(farthest)));
    }
    Ok(())
}

/// The plane through points that a line of light met. Each has the same noise in all directions: its size follows from how far
/// they are beside the plane. A turn of the normal towards an axis in the plane is as uncertain as the points spread little
/// along that (total least squares, first order in the noise).
///
/// # Errors
/// Fewer than four, or all on one line.
pub fn plane_through(points: &[Point3<f64>]) -> Result<FittedPlane, NoLaser> {
    const FEWEST: usize = 4;
    if points.len() < FEWEST {
        return Err(NoLaser::TooFew(points.len(), FEWEST));
    }
    check_size(points.iter().copied())?;
    let (middle, squares, axes) = spread(points);
    let [least, second, most] = squares.map(f64::sqrt);
    // Of points on a line both smaller extents are noise.
    if !(most > ONE_PLACE_M && second > 1e-3 * most && second > 2.0 * least) {
        return Err(NoLaser::Undetermined);
    }
    let n = points.len() as f64;
    let normal = Unit::new_normalize(axes[0]);
    let noise = squares[0] * n / (n - 3.0);
    let mut variance = [0.0, 0.0, 0.0, noise / n];
    for (square, axis) in squares.iter().zip(&axes).skip(1) {
        // The spread holds the noise, too.
        let turn = noise * square / (n * (square - squares[0]).powi(2));
        for (variance, by) in variance
            .iter_mut()
            .zip([axis.x, axis.y, axis.z, axis.dot(&middle)])
        {
            *variance += turn * by * by;
        }
    }
    Ok(FittedPlane {
        plane: Plane {
            normal,
            distance: normal.dot(&middle),
        },
        rms_m: least,
        sd: variance.map(f64::sqrt),
    })
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

/// Points that determine a scanner worse than this leave something of it open.
const MOST_CONDITION: f64 = 1e5;

/// Unknowns of a scanner: turn and shift of its frame, offset, gains, zero of the first mirror.
const UNKNOWN: usize = 10;

/// Fewest points of a calibration.
pub const FEWEST_POINTS: usize = 8;

/// The points that the beam of a scanner met, by command.
struct Fit<'m> {
    met: &'m [([f64; 2], Point3<f64>)],
    scanner: Scanner,
}

impl Fit<'_> {
    /// How far each point is beside its beam, in two directions across it, m.
    fn residuals(&self) -> DVector<f64> {
        let all = self.met.iter().flat_map(|(command, point)| {
            let beam = self.scanner.beam(*command);
            let across = self.scanner.world_t_scanner * Vector3::x();
            let one = beam.direction.cross(&across).normalize();
            let other = beam.direction.cross(&one);
            let off = point - beam.origin;
            [off.dot(&one), off.dot(&other)]
        });
        DVector::from_iterator(2 * self.met.len(), all)
    }
}

impl Adjustable for Fit<'_> {
    fn squares(&self) -> Option<f64> {
        Some(self.residuals().norm_squared())
    }

    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        by_differences(UNKNOWN, |by| Some(self.moved(by).residuals()))
    }

    fn moved(&self, by: &DVector<f64>) -> Self {
        let old = &self.scanner;
        let scanner = Scanner {
            world_t_scanner: turned_and_shifted(&old.world_t_scanner, by),
            offset: old.offset + by[6],
            gain: [old.gain[0] + by[7], old.gain[1] + by[8]],
            zero: [old.zero[0] + by[9], old.zero[1]],
        };
        Self { scanner, ..*self }
    }
}

/// Fits a scanner to commands and the points (world, m) that its beam met at them; `start` is what is known of it, within
/// some degrees and centimetres. The points must be on two planes or more.
///
/// # Errors
/// Too few points, or points that do not determine it.
pub fn calibrate(met: &[([f64; 2], Point3<f64>)], start: &Scanner) -> Result<Fitted, NoLaser> {
    if met.len() < FEWEST_POINTS {
        return Err(NoLaser::TooFew(met.len(), FEWEST_POINTS));
    }
    for (command, _) in met {
        start.angles(*command)?;
    }
    check_size(met.iter().map(|(_, point)| *point))?;
    let start = Fit {
        met,
        scanner: *start,
    };
    let fit = adjusted(start).ok_or(NoLaser::Undetermined)?;
    let (scanner, off) = (fit.scanner, fit.residuals());
    let rms_m = (off.norm_squared() / met.len() as f64).sqrt();
    if !rms_m.is_finite() {
        return Err(NoLaser::Undetermined);
    }
    let found = fit.equations().and_then(|(normal, _)| inverse(&normal));
    // Points that leave an unknown open make the condition infinite, up to rounding.
    let (unit, _) = found
        .filter(|(_, condition)| *condition < MOST_CONDITION)
        .ok_or(NoLaser::Undetermined)?;
    // Two distances of each point, less what was fitted.
    let noise = off.norm_squared() / (2 * met.len() - UNKNOWN) as f64;
    let sd = std::array::from_fn(|k| (noise * unit[(k, k)]).max(0.0).sqrt());
    let from = scanner.world_t_scanner.translation.vector;
    let away = met.iter().map(|(_, point)| (point.coords - from).norm());
    let away = away.sum::<f64>() / met.len() as f64;
    let sd: [f64; UNKNOWN] = sd;
    let possible = -3.0 * sd[6]..=MOST_OFFSET_M + 3.0 * sd[6];
    if rms_m > MOST_BESIDE * away || !possible.contains(&scanner.offset) {
        return Err(NoLaser::Disagree {
            rms: rms_m,
            offset: scanner.offset,
        });
    }
    Ok(Fitted { scanner, rms_m, sd })
}

/// How far points are beside the beams of their commands, m.
#[must_use]
pub fn beside(scanner: &Scanner, met: &[([f64; 2], Point3<f64>)]) -> Vec<f64> {
    let one = |(command, point): &([f64; 2], Point3<f64>)| {
        let beam = scanner.beam(*command);
        beam.direction.cross(&(point - beam.origin)).norm()
    };
    met.iter().map(one).collect()
}

#[cfg(test)]
mod tests;
