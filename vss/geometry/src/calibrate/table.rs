//! What makes a table of lights unfit for calibration, each with its reason.

use nalgebra::{DMatrix, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::{LightPoint, MINIMUM_POINTS};
use crate::camera::Camera;

/// Ratio of extents below which points count as flat.
const FLAT: f64 = 1e-3;
/// Extent (rms) below which all positions are one, m.
const ONE_POSITION_M: f64 = 1e-3;
/// Extent (rms) above which positions are not in metres, m: no laboratory is 35 m long, and one in centimetres is longer.
const LARGEST_M: f64 = 10.0;
/// Extent (rms) below which all pixels are one, px.
const ONE_PIXEL: f64 = 1.0;

/// Why no camera follows from a table. Rows count from 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum CalibrationError {
    /// The picture has no size.
    #[error("the picture size {width} x {height} px is empty; give the camera's width and height")]
    NoPicture {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
    /// A number is NaN or infinite.
    #[error("row {row} of the light table holds a number that is not finite")]
    NotFinite {
        /// The row.
        row: usize,
    },
    /// A pixel is not in the picture.
    #[error(
        "row {row} of the light table has its spot at ({u:.1}, {v:.1}), outside the picture of {width} x {height} px"
    )]
    OutsidePicture {
        /// The row.
        row: usize,
        /// Column, px.
        u: f64,
        /// Row of the picture, px.
        v: f64,
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
    /// Pixels are not in the picture, and all of them are when columns and rows change places.
    #[error(
        "spots are outside the picture of {width} x {height} px, and all are inside it with u and v swapped: u is the column, v the row"
    )]
    Swapped {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
    /// Too few rows.
    #[error(
        "{points} points; a calibration needs at least {MINIMUM_POINTS} at distinct positions, and 50 or more to be good"
    )]
    TooFew {
        /// The number of rows at distinct positions.
        points: usize,
    },
    /// Too few rows for the lens model that was asked for.
    #[error(
        "{points} usable points; a camera with {parameters} parameters needs at least {needed}, and 50 or more to be good"
    )]
    TooFewForModel {
        /// The number of rows, outliers left out.
        points: usize,
        /// The fewest that would do.
        needed: usize,
        /// The parameters of the model, pose and pinhole included.
        parameters: usize,
    },
    /// All lights at one place.
    #[error(
        "all light positions are one point (within {extent_m:.2e} m); move the light through the work volume"
    )]
    OnePoint {
        /// Their extent (rms), m.
        extent_m: f64,
    },
    /// The lights are spread over more than any laboratory.
    #[error(
        "the light positions are {extent_m:.0} m apart (rms): positions are in m; are these millimetres or centimetres?"
    )]
    TooLarge {
        /// Their extent (rms), m.
        extent_m: f64,
    },
    /// All lights on a line.
    #[error(
        "the light positions lie on one line (thickness/length {ratio:.1e}); spread them over the work volume"
    )]
    OneLine {
        /// Second over first singular value.
        ratio: f64,
    },
    /// All lights in a plane.
    #[error(
        "the light positions lie in one plane (thickness/length {ratio:.1e}), from which focal length and distance cannot be told apart; use two heights or more"
    )]
    OnePlane {
        /// Third over first singular value.
        ratio: f64,
    },
    /// All lights on a curve of the third order that passes through the camera.
    #[error(
        "the light positions lie on one curve (a twisted cubic) that passes through the camera, or nearly: many cameras see such points alike; spread them over the work volume"
    )]
    Curve,
    /// All pixels at one place or on a line.
    #[error(
        "the spots are all at one point or on one line of the picture (extents {long_px:.2} and {short_px:.2} px); is the spot really the moving light?"
    )]
    FlatPicture {
        /// Longer extent (rms), px.
        long_px: f64,
        /// Shorter extent (rms), px.
        short_px: f64,
    },
    /// No camera explains half of the rows.
    #[error(
        "no camera explains the table: the best one agrees with {agreeing} of {points} points within {threshold_px:.1} px; are positions and pixels of the same lights in the same rows?"
    )]
    NoConsensus {
        /// Rows that agree with the best camera.
        agreeing: usize,
        /// Rows.
        points: usize,
        /// What counts as agreement, px.
        threshold_px: f64,
    },
    /// Only a mirrored camera explains the table.
    #[error(
        "the table is mirrored: it fits a camera only with all lights behind it; check for a left-handed world, swapped u and v, or v counted upwards"
    )]
    Mirrored,
    /// The rows left do not determine the camera.
    #[error(
        "the points do not determine the camera (condition {condition:.1e}); spread them over the picture and over depth"
    )]
    Undetermined {
        /// Condition number of the column-scaled Jacobian.
        condition: f64,
    },
    /// The fit went wrong.
    #[error("the fit did not lead to a camera: {0}")]
    NoFit(String),
}

impl CalibrationError {
    /// The same about a larger table, of which `of` says where the rows come from.
    pub(crate) fn of_row(self, of: impl Fn(usize) -> usize) -> Self {
        match self {
            Self::NotFinite { row } => Self::NotFinite { row: of(row) },
            Self::OutsidePicture {
                row,
                u,
                v,
                width,
                height,
            } => Self::OutsidePicture {
                row: of(row),
                u,
                v,
                width,
                height,
            },
            other => other,
        }
    }
}

/// Checks numbers, counts and geometry before anything is estimated.
pub(super) fn check(
    table: &[LightPoint],
    width: usize,
    height: usize,
) -> Result<(), CalibrationError> {
    if width == 0 || height == 0 {
        return Err(CalibrationError::NoPicture { width, height });
    }
    let within = |at: f64, size: usize| at >= -0.5 && at <= size as f64 - 0.5;
    let inside = |u: f64, v: f64| within(u, width) && within(v, height);
    for (row, p) in table.iter().enumerate() {
        if ![p.x, p.y, p.z, p.u, p.v]
            .iter()
            .all(|number| number.is_finite())
        {
            return Err(CalibrationError::NotFinite { row });
        }
        if !inside(p.u, p.v) {
            if table.iter().all(|other| inside(other.v, other.u)) {
                return Err(CalibrationError::Swapped { width, height });
            }
            let (u, v) = (p.u, p.v);
            return Err(CalibrationError::OutsidePicture {
                row,
                u,
                v,
                width,
                height,
            });
        }
    }
    let all: Vec<usize> = (0..table.len()).collect();
    check_geometry(table, &all)
}

/// The same for the rows that are left when those beyond `limit_px` are rejected, which must be at least half.
pub(super) fn check_used(
    table: &[LightPoint],
    used: &[usize],
    limit_px: f64,
) -> Result<(), CalibrationError> {
    let (agreeing, points) = (used.len(), table.len());
    if 2 * agreeing < points || agreeing < MINIMUM_POINTS {
        return Err(CalibrationError::NoConsensus {
            agreeing,
            points,
            threshold_px: limit_px,
        });
    }
    check_geometry(table, used)
}

fn check_geometry(table: &[LightPoint], rows: &[usize]) -> Result<(), CalibrationError> {
    let points: Vec<&LightPoint> = rows.iter().filter_map(|row| table.get(*row)).collect();
    let mut positions: Vec<[f64; 3]> = points.iter().map(|p| [p.x, p.y, p.z]).collect();
    let [s1, s2, s3] = extents::<3>(&positions);
    positions.sort_by(|a, b| {
        a.iter()
            .zip(b)
            .fold(std::cmp::Ordering::Equal, |o, (a, b)| {
                o.then(a.total_cmp(b))
            })
    });
    positions.dedup();
    if points.len() < MINIMUM_POINTS {
        return Err(CalibrationError::TooFew {
            points: points.len(),
        });
    }
    if s1.is_nan() || s1 < ONE_POSITION_M {
        return Err(CalibrationError::OnePoint { extent_m: s1 });
    }
    if s1 > LARGEST_M {
        return Err(CalibrationError::TooLarge { extent_m: s1 });
    }
    if s2 < FLAT * s1 {
        return Err(CalibrationError::OneLine { ratio: s2 / s1 });
    }
    if s3 < FLAT * s1 {
        return Err(CalibrationError::OnePlane { ratio: s3 / s1 });
    }
    if positions.len() < MINIMUM_POINTS {
        return Err(CalibrationError::TooFew {
            points: positions.len(),
        });
    }
    let pixels: Vec<[f64; 2]> = points.iter().map(|p| [p.u, p.v]).collect();
    let [long_px, short_px] = extents::<2>(&pixels);
    if long_px < ONE_PIXEL || short_px < FLAT * long_px {
        return Err(CalibrationError::FlatPicture { long_px, short_px });
    }
    Ok(())
}

/// Shortest over longest extent (rms) of the positions of `rows`.
pub(super) fn flatness(table: &[LightPoint], rows: &[usize]) -> f64 {
    let points = rows.iter().filter_map(|row| table.get(*row));
    let positions: Vec<[f64; 3]> = points.map(|p| [p.x, p.y, p.z]).collect();
    let [longest, _, shortest] = extents::<3>(&positions);
    shortest / longest
}

/// Rms extents along the principal axes, largest first.
fn extents<const D: usize>(points: &[[f64; D]]) -> [f64; D] {
    let n = points.len().max(1) as f64;
    let mut mean = [0.0; D];
    for point in points {
        for (sum, x) in mean.iter_mut().zip(point) {
            *sum += x / n;
        }
    }
    let centred = points
        .iter()
        .flat_map(|point| point.iter().zip(&mean).map(|(x, m)| (x - m) / n.sqrt()));
    let matrix = DMatrix::from_row_iterator(points.len(), D, centred);
    // A table of enormous numbers can overflow, on which the decomposition would not end.
    if !matrix.iter().all(|x| x.is_finite()) || points.is_empty() {
        return [f64::NAN; D];
    }
    let mut values: Vec<f64> = matrix.singular_values().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    std::array::from_fn(|k| values.get(k).copied().unwrap_or(0.0))
}

/// A fitted camera must be one: finite numbers and positive focal lengths.
pub(super) fn check_camera(camera: &Camera) -> Result<(), CalibrationError> {
    let i = &camera.intrinsics;
    let centre: Vector3<f64> = camera.centre.coords;
    let finite = centre
        .iter()
        .chain(Vector2::new(i.cx, i.cy).iter())
        .all(|x| x.is_finite());
    if finite && i.fx > 0.0 && i.fy > 0.0 {
        return Ok(());
    }
    Err(CalibrationError::NoFit(format!(
        "focal lengths {:.3e} and {:.3e} px, principal point ({:.3e}, {:.3e})",
        i.fx, i.fy, i.cx, i.cy
    )))
}
