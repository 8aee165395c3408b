//! Where the fit starts: the direct linear transform (Hartley and Zisserman, chapter 7), normalised, inside RANSAC.

use nalgebra::{
    Matrix3, Matrix3x4, Matrix4, Point3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector4,
};
use rand::seq::index;
use rand_chacha::ChaCha8Rng;

use super::{CalibrationError, LightPoint, MINIMUM_POINTS};
use crate::camera::{Camera, Distortion, Intrinsics};

/// Points per sample: 11 unknowns, 2 equations each.
const SAMPLE: usize = 6;
/// Most samples; with half of the points wrong, 300 find a good one with 99 %.
const MOST_SAMPLES: usize = 400;
/// Fewest samples: noise can spoil a sample of good points.
const FEWEST_SAMPLES: usize = 10;
/// Chance of never having drawn a sample without outliers.
const MISS: f64 = 1e-4;
/// What counts as agreement, as a part of the picture's longer side: distortion must not look like an outlier.
const THRESHOLD: f64 = 8.0 / 640.0;

/// A camera without distortion and the rows that agree with it.
pub(super) struct Start {
    pub camera: Camera,
    pub consensus: Vec<usize>,
}

type Projection = Matrix3x4<f64>;

pub(super) fn find(
    table: &[LightPoint],
    width: usize,
    height: usize,
    rng: &mut ChaCha8Rng,
) -> Result<Start, CalibrationError> {
    let threshold = THRESHOLD * width.max(height) as f64;
    let mut best = Consensus::default();
    let (mut drawn, mut enough) = (0, MOST_SAMPLES);
    while drawn < enough {
        drawn += 1;
        let sample: Vec<usize> =
            index::sample(rng, table.len(), SAMPLE.min(table.len())).into_vec();
        let Some(found) = Consensus::of(table, &sample, threshold) else {
            continue;
        };
        if found.cost < best.cost || best.rows.is_empty() {
            best = found.polished(table, threshold);
            enough = samples_needed(best.rows.len(), table.len());
        }
    }
    let agreeing = best.rows.len();
    if agreeing < MINIMUM_POINTS || 2 * agreeing < table.len() {
        return Err(CalibrationError::NoConsensus {
            agreeing,
            points: table.len(),
            threshold_px: threshold,
        });
    }
    let camera = decompose(&best.projection, table, &best.rows)?;
    Ok(Start {
        camera,
        consensus: best.rows,
    })
}

fn samples_needed(agreeing: usize, points: usize) -> usize {
    let good = (agreeing as f64 / points as f64).powi(SAMPLE as i32);
    let needed = MISS.ln() / (1.0 - good).max(1e-12).ln();
    // A saturating cast: an infinite need becomes the most.
    (needed.ceil() as usize).clamp(FEWEST_SAMPLES, MOST_SAMPLES)
}

struct Consensus {
    projection: Projection,
    rows: Vec<usize>,
    /// Sum of squared residuals, each cut at the squared threshold.
    cost: f64,
}

impl Default for Consensus {
    fn default() -> Self {
        Self {
            projection: Projection::zeros(),
            rows: Vec::new(),
            cost: f64::INFINITY,
        }
    }
}

impl Consensus {
    /// The transform from the rows of `sample`, and all rows that agree with it.
    fn of(table: &[LightPoint], sample: &[usize], threshold: f64) -> Option<Self> {
        let projection = direct_linear_transform(table, sample)?;
        let limit = threshold * threshold;
        let (mut rows, mut cost) = (Vec::new(), 0.0);
        for (row, point) in table.iter().enumerate() {
            let p = projection * point.position().to_homogeneous();
            let square = (p.x / p.z - point.u).powi(2) + (p.y / p.z - point.v).powi(2);
            // NaN compares false and so counts as disagreement.
            if square < limit {
                rows.push(row);
                cost += square;
            } else {
                cost += limit;
            }
        }
        Some(Self {
            projection,
            rows,
            cost,
        })
    }

    /// Repeats with all agreeing rows as the sample, as long as that gets better.
    fn polished(self, table: &[LightPoint], threshold: f64) -> Self {
        let mut best = self;
        for _ in 0..5 {
            if best.rows.len() <= SAMPLE {
                break;
            }
            match Self::of(table, &best.rows, threshold) {
                Some(next) if next.cost < best.cost => best = next,
                _ => break,
            }
        }
        best
    }
}

/// The 3x4 matrix P with (u, v, 1) ~ P (x, y, z, 1) of least algebraic error in normalised coordinates.
fn direct_linear_transform(table: &[LightPoint], rows: &[usize]) -> Option<Projection> {
    let points = || rows.iter().filter_map(|row| table.get(*row));
    let n = rows.len() as f64;
    let (mut middle, mut centre) = (SVector::<f64, 3>::zeros(), SVector::<f64, 2>::zeros());
    for point in points() {
        middle += point.position().coords / n;
        centre += point.pixel() / n;
    }
    let (mut size, mut spread) = (0.0, 0.0);
    for point in points() {
        size += (point.position().coords - middle).norm_squared() / n;
        spread += (point.pixel() - centre).norm_squared() / n;
    }
    let (size, spread) = ((size / 3.0).sqrt(), (spread / 2.0).sqrt());
    let mut normal = SMatrix::<f64, 12, 12>::zeros();
    for point in points() {
        let x = (point.position().coords - middle) / size;
        let w = (point.pixel() - centre) / spread;
        let x = Vector4::new(x.x, x.y, x.z, 1.0);
        for (block, value) in [(0, w.x), (4, w.y)] {
            let mut row = SVector::<f64, 12>::zeros();
            row.fixed_rows_mut::<4>(block).copy_from(&x);
            row.fixed_rows_mut::<4>(8).copy_from(&(-value * x));
            normal += row * row.transpose();
        }
    }
    if !normal.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let eigen = normal.try_symmetric_eigen(1e-15, 500)?;
    let (smallest, _) = eigen.eigenvalues.argmin();
    let p = eigen.eigenvectors.column(smallest);
    let normalised = Projection::from_row_iterator(p.iter().copied());
    let undo_pixels = Matrix3::new(spread, 0.0, centre.x, 0.0, spread, centre.y, 0.0, 0.0, 1.0);
    let to_normalised = Matrix4::new_translation(&(-middle)).append_scaling(1.0 / size);
    Some(undo_pixels * normalised * to_normalised)
}

/// Camera, pose and pinhole from the projection; refuses a mirrored one.
fn decompose(
    p: &Projection,
    table: &[LightPoint],
    rows: &[usize],
) -> Result<Camera, CalibrationError> {
    let not_a_camera =
        || CalibrationError::NoFit("the start value has no finite centre".to_owned());
    let in_front = rows
        .iter()
        .filter_map(|row| table.get(*row))
        .filter(|point| (p * point.position().to_homogeneous()).z > 0.0);
    // The transform's sign is free; choose it so that most lights have positive depth.
    let p = if 2 * in_front.count() >= rows.len() {
        *p
    } else {
        -p
    };
    let m = p.fixed_view::<3, 3>(0, 0).into_owned();
    if m.determinant() < 0.0 {
        return Err(CalibrationError::Mirrored);
    }
    let (k, rotation) = rq(&m).ok_or_else(not_a_camera)?;
    let centre = -(m.try_inverse().ok_or_else(not_a_camera)? * p.column(3));
    let scale = k[(2, 2)];
    let intrinsics = Intrinsics {
        fx: k[(0, 0)] / scale,
        fy: k[(1, 1)] / scale,
        cx: k[(0, 2)] / scale,
        cy: k[(1, 2)] / scale,
    };
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let camera = Camera {
        rotation,
        centre: Point3::from(centre),
        intrinsics,
        distortion: Distortion::default(),
    };
    super::table::check_camera(&camera)?;
    Ok(camera)
}

/// m = K R with K upper triangular and positive on the diagonal.
fn rq(m: &Matrix3<f64>) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
    let flip = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0);
    let qr = (flip * m).transpose().qr();
    let k = flip * qr.r().transpose() * flip;
    let r = flip * qr.q().transpose();
    let signs = Matrix3::from_diagonal(&k.diagonal().map(f64::signum));
    let (k, r) = (k * signs, signs * r);
    k.iter()
        .chain(r.iter())
        .all(|entry| entry.is_finite())
        .then_some((k, r))
}
