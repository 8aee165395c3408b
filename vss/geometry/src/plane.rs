//! Calibration of a camera from pictures of a plane (Z. Zhang, A flexible new technique for camera calibration, IEEE
//! Transactions on Pattern Analysis and Machine Intelligence 22, 2000).
//!
//! Each view gives a homography, two of them the pinhole (without skew), and that the poses; then all is fitted to the pixels
//! together. Knows numbers only.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Point2, Point3, Rotation3, SMatrix, SVector,
    UnitQuaternion, Vector2, Vector3,
};

use crate::{
    adjust::{Adjustable, adjusted, inverse},
    calibrate::{LensModel, left_jacobian},
    camera::{Camera, Distortion, Intrinsics, PARAMETERS},
};

/// Fewest corners of a view: a homography needs four.
const FEWEST_POINTS: usize = 6;
/// Ratio of extents below which the corners of a view lie on one line.
const FLAT: f64 = 1e-3;
/// Views whose normals differ by less, rad, say nothing about the focal length.
const PARALLEL: f64 = 0.02;
/// Parameters of a view's pose.
const POSE: usize = 6;
/// Condition number beyond which a camera is not determined.
const WORST_CONDITION: f64 = 1e8;

/// A corner of the plane in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// On the plane, m.
    pub on_plane: Point2<f64>,
    /// In the picture, px.
    pub pixel: Vector2<f64>,
}

/// The camera, and the pose of the plane in each view.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneCalibration {
    /// Pinhole.
    pub intrinsics: Intrinsics,
    /// Lens; terms beyond the model are 0.
    pub distortion: Distortion,
    /// Standard deviations of fx, fy, cx, cy (px), k1, k2, p1, p2, k3; 0 for terms that are not fitted.
    pub sd: [f64; 9],
    /// The plane in the camera's frame, for each view.
    pub views: Vec<View>,
    /// Root of the mean over all corners of du² + dv², px.
    pub rms_px: f64,
    /// Residuals (seen minus predicted), view by view, px.
    pub residuals: Vec<Vec<Vector2<f64>>>,
    /// Standard deviation of the noise of a coordinate, px.
    pub noise_px: f64,
}

/// One view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// The plane in the camera's frame.
    pub camera_t_plane: Isometry3<f64>,
    /// Standard deviations of its rotation vector (3, rad) and its translation (3, m).
    pub sd: [f64; POSE],
}

/// Why no camera follows. Views count from 0.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlaneError {
    /// Too few views.
    #[error(
        "{0} views; a calibration from a plane needs 3 or more, tilted by 30 to 45 degrees, and 10 to be good"
    )]
    TooFewViews(usize),
    /// Too few corners.
    #[error("view {0} has {1} corners and needs at least {FEWEST_POINTS}")]
    TooFewPoints(usize, usize),
    /// Corners on one line, or at one place.
    #[error("the corners of view {0} lie on one line, on the plane or in the picture")]
    OneLine(usize),
    /// All views parallel.
    #[error(
        "all views show the plane at the same angle (within {0:.3} rad): the focal length does not follow; tilt the plane by 30 to 45 degrees, about two axes"
    )]
    Parallel(f64),
    /// No pinhole follows from the homographies.
    #[error(
        "no camera follows from these views: is the plane tilted by 30 to 45 degrees, and are the corners of all in the same order?"
    )]
    NoCamera,
    /// Mirrored corners: the plane would be seen from behind.
    #[error(
        "view {0} is mirrored: its corners are counted in the other direction, or u and v are swapped"
    )]
    Mirrored(usize),
    /// The fit is not determined.
    #[error(
        "the views do not determine the camera (condition {0:.1e}); add views with other tilts"
    )]
    Undetermined(f64),
}

/// Calibrates a camera from views of a plane. A plane whose corners run in the picture as they do on it, seen from its
/// front, has z away from the camera.
///
/// # Errors
/// [`PlaneError`] says what is missing.
pub fn calibrate_plane(
    views: &[Vec<Corner>],
    width: usize,
    height: usize,
    model: LensModel,
) -> Result<PlaneCalibration, PlaneError> {
    if views.len() < 3 {
        return Err(PlaneError::TooFewViews(views.len()));
    }
    for (index, view) in views.iter().enumerate() {
        if view.len() < FEWEST_POINTS {
            return Err(PlaneError::TooFewPoints(index, view.len()));
        }
        let planar = |of: &dyn Fn(&Corner) -> Vector2<f64>| flatness(view.iter().map(of));
        if planar(&|corner| corner.on_plane.coords) < FLAT || planar(&|corner| corner.pixel) < FLAT
        {
            return Err(PlaneError::OneLine(index));
        }
    }
    let maps: Option<Vec<Matrix3<f64>>> = views.iter().map(|view| homography(view)).collect();
    let maps = maps.ok_or(PlaneError::NoCamera)?;
    let tilts = views.iter().zip(&maps);
    let mirrored = tilts.map(|(view, map)| turned_over(view, map));
    let mirrored: Vec<bool> = mirrored.collect();
    // Either way of counting is right as long as all views have it; most have the right one.
    let many = 2 * mirrored.iter().filter(|one| **one).count() > mirrored.len();
    if let Some(index) = mirrored.iter().position(|one| *one != many) {
        return Err(PlaneError::Mirrored(index));
    }
    let widest = spread_of_lines(&maps, width, height);
    if widest < PARALLEL {
        return Err(PlaneError::Parallel(widest));
    }
    let intrinsics = pinhole(&maps, width, height).ok_or(PlaneError::NoCamera)?;
    let poses: Vec<Isometry3<f64>> = maps.iter().map(|map| pose(map, &intrinsics)).collect();
    let start = Bundle {
        views,
        cameras: poses.iter().map(|pose| camera(pose, intrinsics)).collect(),
        lens: model.parameters() - POSE,
    };
    let found = adjusted(start).ok_or(PlaneError::NoCamera)?;
    found.described()
}

/// A camera with this plane as its world.
fn camera(camera_t_plane: &Isometry3<f64>, intrinsics: Intrinsics) -> Camera {
    Camera {
        rotation: camera_t_plane.rotation,
        centre: camera_t_plane.inverse().translation.vector.into(),
        intrinsics,
        distortion: Distortion::default(),
    }
}

/// Second over first extent of points.
fn flatness(points: impl Iterator<Item = Vector2<f64>> + Clone) -> f64 {
    let count = points.clone().count().max(1) as f64;
    let middle = points.clone().sum::<Vector2<f64>>() / count;
    let mut spread = nalgebra::Matrix2::zeros();
    for point in points {
        spread += (point - middle) * (point - middle).transpose() / count;
    }
    let values = spread.symmetric_eigenvalues();
    if values.max() > 0.0 && values.iter().all(|value| value.is_finite()) {
        (values.min().max(0.0) / values.max()).sqrt()
    } else {
        0.0
    }
}

/// The map from the plane to the picture of least algebraic error in normalised coordinates.
fn homography(view: &[Corner]) -> Option<Matrix3<f64>> {
    let scaled = |of: &dyn Fn(&Corner) -> Vector2<f64>| {
        let count = view.len() as f64;
        let middle = view.iter().map(of).sum::<Vector2<f64>>() / count;
        let size = view.iter().map(|one| (of(one) - middle).norm_squared());
        let size = (size.sum::<f64>() / count / 2.0).sqrt();
        Matrix3::new(
            1.0 / size,
            0.0,
            -middle.x / size,
            0.0,
            1.0 / size,
            -middle.y / size,
            0.0,
            0.0,
            1.0,
        )
    };
    let from = scaled(&|corner| corner.on_plane.coords);
    let to = scaled(&|corner| corner.pixel);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for corner in view {
        let p = from * corner.on_plane.to_homogeneous();
        let q = to * corner.pixel.push(1.0);
        for (block, value) in [(0, q.x), (3, q.y)] {
            let mut row = SVector::<f64, 9>::zeros();
            row.fixed_rows_mut::<3>(block).copy_from(&p);
            row.fixed_rows_mut::<3>(6).copy_from(&(-value * p));
            normal += row * row.transpose();
        }
    }
    if !normal.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let eigen = normal.try_symmetric_eigen(1e-15, 500)?;
    let (smallest, _) = eigen.eigenvalues.argmin();
    let h = Matrix3::from_row_iterator(eigen.eigenvectors.column(smallest).iter().copied());
    let map = to.try_inverse()? * h * from;
    // Points of the plane lie before the camera.
    let depth: f64 = view
        .iter()
        .map(|one| (map * one.on_plane.to_homogeneous()).z)
        .sum();
    Some(map * depth.signum())
}

/// Whether the corners run the other way in the picture than on the plane.
fn turned_over(view: &[Corner], map: &Matrix3<f64>) -> bool {
    let middle = view
        .iter()
        .map(|one| one.on_plane.coords)
        .sum::<Vector2<f64>>();
    let middle = middle / view.len().max(1) as f64;
    let depth = (map * middle.push(1.0)).z;
    map.determinant() / depth.powi(3) < 0.0
}

/// Zhang's equations for B = K⁻ᵀK⁻¹ without skew, in pixels about the middle of the picture and in units of its size.
fn pinhole(maps: &[Matrix3<f64>], width: usize, height: usize) -> Option<Intrinsics> {
    let unit = width.max(height) as f64;
    let middle = Vector2::new(0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let to_unit = Matrix3::new(
        1.0 / unit,
        0.0,
        -middle.x / unit, //
        0.0,
        1.0 / unit,
        -middle.y / unit, //
        0.0,
        0.0,
        1.0,
    );
    // B11, B22, B13, B23, B33.
    let row = |a: Vector3<f64>, b: Vector3<f64>| {
        SVector::<f64, 5>::from([
            a.x * b.x,
            a.y * b.y,
            a.x * b.z + a.z * b.x,
            a.y * b.z + a.z * b.y,
            a.z * b.z,
        ])
    };
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    for map in maps {
        let h = to_unit * map;
        let h = h / h.norm();
        let (a, b) = (h.column(0).into_owned(), h.column(1).into_owned());
        for equation in [row(a, b), row(a, a) - row(b, b)] {
            normal += equation * equation.transpose();
        }
    }
    let eigen = normal.try_symmetric_eigen(1e-15, 500)?;
    let (smallest, _) = eigen.eigenvalues.argmin();
    let b = eigen.eigenvectors.column(smallest).into_owned();
    let [b11, b22, b13, b23, b33]: [f64; 5] = (b * b[0].signum()).into();
    let (cx, cy) = (-b13 / b11, -b23 / b22);
    let scale = b33 - b13 * b13 / b11 - b23 * b23 / b22;
    let (fx, fy) = ((scale / b11).sqrt(), (scale / b22).sqrt());
    let sound = [fx, fy, cx, cy].iter().all(|one| one.is_finite());
    // Distortion can spoil these equations; a principal point far off the picture is no start.
    let near =
        cx.abs() < 0.5 && cy.abs() < 0.5 && (0.1..20.0).contains(&fx) && (0.1..20.0).contains(&fy);
    if sound && near {
        return Some(Intrinsics {
            fx: fx * unit,
            fy: fy * unit,
            cx: cx * unit + middle.x,
            cy: cy * unit + middle.y,
        });
    }
    one_focal(maps, &to_unit).map(|focal| Intrinsics {
        fx: focal * unit,
        fy: focal * unit,
        cx: middle.x,
        cy: middle.y,
    })
}

/// One focal length, with the principal point in the middle: from the same equations by least squares.
fn one_focal(maps: &[Matrix3<f64>], to_unit: &Matrix3<f64>) -> Option<f64> {
    let (mut up, mut down) = (0.0, 0.0);
    for map in maps {
        let h = to_unit * map;
        let h = h / h.norm();
        let (a, b) = (h.column(0).into_owned(), h.column(1).into_owned());
        // w (x·x') + z z' = 0 with w = 1/f².
        let equations = [
            (a.x * b.x + a.y * b.y, a.z * b.z),
            (
                a.xy().norm_squared() - b.xy().norm_squared(),
                a.z * a.z - b.z * b.z,
            ),
        ];
        for (across, along) in equations {
            up -= across * along;
            down += across * across;
        }
    }
    let w = up / down;
    (w.is_finite() && w > 1e-6).then(|| (1.0 / w).sqrt())
}

/// How much the vanishing lines of the planes differ, as an angle, for a focal length as long as the picture: 0 when all are
/// parallel to one another.
fn spread_of_lines(maps: &[Matrix3<f64>], width: usize, height: usize) -> f64 {
    let unit = width.max(height) as f64;
    let (u, v) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let to_unit = Matrix3::new(
        1.0 / unit,
        0.0,
        -u / unit,
        0.0,
        1.0 / unit,
        -v / unit,
        0.0,
        0.0,
        1.0,
    );
    let line = |map: &Matrix3<f64>| {
        let h = to_unit * map;
        h.column(0).cross(&h.column(1)).normalize()
    };
    let first = maps.first().map_or(Vector3::z(), line);
    let angles = maps.iter().map(|map| {
        let line = line(map);
        line.cross(&first).norm().atan2(line.dot(&first).abs())
    });
    angles.fold(0.0, f64::max)
}

/// The pose whose first two axes and place come nearest to a homography.
fn pose(map: &Matrix3<f64>, intrinsics: &Intrinsics) -> Isometry3<f64> {
    let i = intrinsics;
    let undo = Matrix3::new(
        1.0 / i.fx,
        0.0,
        -i.cx / i.fx, //
        0.0,
        1.0 / i.fy,
        -i.cy / i.fy, //
        0.0,
        0.0,
        1.0,
    );
    let h = undo * map;
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    let (a, b) = (h.column(0) * scale, h.column(1) * scale);
    let rough = Matrix3::from_columns(&[a, b, a.cross(&b)]);
    let mut rotation = Rotation3::from_matrix(&rough);
    if let Some(svd) = rough.try_svd(true, true, 1e-15, 500)
        && let (Some(u), Some(v)) = (svd.u, svd.v_t)
    {
        rotation = Rotation3::from_matrix_unchecked(u * v);
    }
    Isometry3::from_parts(
        (h.column(2) * scale).into(),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// All views with one lens: a camera for each, whose world is the plane.
struct Bundle<'a> {
    views: &'a [Vec<Corner>],
    cameras: Vec<Camera>,
    /// Free parameters of pinhole and lens.
    lens: usize,
}

impl Bundle<'_> {
    fn residual(camera: &Camera, corner: &Corner) -> Option<Vector2<f64>> {
        let point = Point3::new(corner.on_plane.x, corner.on_plane.y, 0.0);
        Some(corner.pixel - camera.project_unchecked(&point)?)
    }

    fn pairs(&self) -> impl Iterator<Item = (usize, &Camera, &Corner)> {
        let views = self.views.iter().zip(&self.cameras).enumerate();
        views.flat_map(|(index, (view, camera))| view.iter().map(move |one| (index, camera, one)))
    }

    fn described(&self) -> Result<PlaneCalibration, PlaneError> {
        let undetermined = PlaneError::Undetermined;
        let count = self.views.iter().map(Vec::len).sum::<usize>();
        let free = self.lens + POSE * self.views.len();
        let squares = self.squares().ok_or(PlaneError::NoCamera)?;
        let (normal, _) = self.equations().ok_or(PlaneError::NoCamera)?;
        let (unit, condition) = inverse(&normal).ok_or(undetermined(f64::INFINITY))?;
        if condition > WORST_CONDITION {
            return Err(undetermined(condition));
        }
        let variance = squares / (2 * count).saturating_sub(free).max(1) as f64;
        let Some(first) = self.cameras.first() else {
            return Err(PlaneError::TooFewViews(0));
        };
        let behind = self.pairs().any(|(_, camera, corner)| {
            let point = Point3::new(corner.on_plane.x, corner.on_plane.y, 0.0);
            camera.in_camera_frame(&point).z <= 0.0
        });
        if behind || !(first.intrinsics.fx > 0.0 && first.intrinsics.fy > 0.0) {
            return Err(PlaneError::NoCamera);
        }
        let mut sd = [0.0; 9];
        for (k, one) in sd.iter_mut().take(self.lens).enumerate() {
            *one = (variance * unit[(k, k)]).sqrt();
        }
        let views = self.cameras.iter().enumerate().map(|(index, camera)| {
            let at = self.lens + POSE * index;
            let own = unit.fixed_view::<POSE, POSE>(at, at) * variance;
            View {
                camera_t_plane: camera.camera_from_world(),
                sd: pose_sd(camera, &own),
            }
        });
        let residuals = self.views.iter().zip(&self.cameras).map(|(view, camera)| {
            let residual = |corner| Self::residual(camera, corner);
            view.iter().filter_map(residual).collect()
        });
        Ok(PlaneCalibration {
            intrinsics: first.intrinsics,
            distortion: first.distortion,
            sd,
            views: views.collect(),
            rms_px: (squares / count.max(1) as f64).sqrt(),
            residuals: residuals.collect(),
            noise_px: variance.sqrt(),
        })
    }
}

/// Standard deviations of rotation vector and translation of camera_T_world, from the covariance of a turn on the left and
/// of the centre.
pub(crate) fn pose_sd(camera: &Camera, covariance: &SMatrix<f64, POSE, POSE>) -> [f64; POSE] {
    let pose = camera.camera_from_world();
    let turn = left_jacobian(pose.rotation.scaled_axis());
    let turn = turn.try_inverse().unwrap_or_else(Matrix3::identity);
    let mut change = SMatrix::<f64, POSE, POSE>::zeros();
    change.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    let by_turn = -pose.translation.vector.cross_matrix();
    change.fixed_view_mut::<3, 3>(3, 0).copy_from(&by_turn);
    let by_shift = -pose.rotation.to_rotation_matrix().into_inner();
    change.fixed_view_mut::<3, 3>(3, 3).copy_from(&by_shift);
    let found = change * covariance * change.transpose();
    std::array::from_fn(|k| found[(k, k)].sqrt())
}

impl Adjustable for Bundle<'_> {
    fn squares(&self) -> Option<f64> {
        let mut sum = 0.0;
        for (_, camera, corner) in self.pairs() {
            sum += Self::residual(camera, corner)?.norm_squared();
        }
        sum.is_finite().then_some(sum)
    }

    fn equations(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let free = self.lens + POSE * self.views.len();
        let (mut normal, mut right) = (DMatrix::zeros(free, free), DVector::zeros(free));
        for (index, camera, corner) in self.pairs() {
            let point = Point3::new(corner.on_plane.x, corner.on_plane.y, 0.0);
            let (pixel, j) = camera.project_with_jacobian(&point)?;
            let left = corner.pixel - pixel;
            let (of_pose, of_lens) = (j.fixed_columns::<POSE>(0), j.columns(POSE, self.lens));
            let at = self.lens + POSE * index;
            let mut block = normal.view_mut((0, 0), (self.lens, self.lens));
            block += of_lens.transpose() * of_lens;
            let cross = of_lens.transpose() * of_pose;
            let mut block = normal.view_mut((0, at), (self.lens, POSE));
            block += &cross;
            let mut block = normal.view_mut((at, 0), (POSE, self.lens));
            block += cross.transpose();
            let mut block = normal.view_mut((at, at), (POSE, POSE));
            block += of_pose.transpose() * of_pose;
            let mut rows = right.rows_mut(0, self.lens);
            rows += of_lens.transpose() * left;
            let mut rows = right.rows_mut(at, POSE);
            rows += of_pose.transpose() * left;
        }
        Some((normal, right))
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        let cameras = self.cameras.iter().enumerate().map(|(index, camera)| {
            let mut own = [0.0; PARAMETERS];
            let at = self.lens + POSE * index;
            for (k, to) in own.iter_mut().enumerate().take(POSE + self.lens) {
                *to = if k < POSE {
                    step[at + k]
                } else {
                    step[k - POSE]
                };
            }
            camera.moved_by(&own)
        });
        Self {
            views: self.views,
            cameras: cameras.collect(),
            lens: self.lens,
        }
    }
}

#[cfg(test)]
mod tests;
