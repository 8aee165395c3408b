//! Where a draughts board stands before calibrated cameras: its pose from the corners of its chequer pattern in all pictures
//! together, with standard deviations.
//!
//! The pattern is found in each picture by itself ([`vss::image::board`]). Its 49 inner corners are placed to a fraction of a
//! pixel, and least squares fit the pose to all of them. A board of fields looks the same after half a turn: a bright
//! dot on its rim, beside the first field, says which way it lies. Knows numbers and pictures only.
//!
//! The board's frame has its origin in the middle of the surface, z up, and the first field, which is dark, at the smallest x and
//! y. The frame in which the cameras stand is called base.

use nalgebra::{
    Isometry3, Point2, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3,
};
use serde::{Deserialize, Serialize};
use vss::{
    camera::Camera,
    camera_info::{CameraInfo, CameraPose},
    chequer::corners_near,
    frame::{Frame, PixelFormat},
    image::{
        Format, Picture,
        board::{Board, BoardError, Side},
    },
};

/// Inner corners of the board, a side.
const INNER: u32 = 7;

/// A corner belongs to a place of the pattern within this part of a field's side.
const NEAR: f64 = 0.25;

/// The dot is brighter than the rim on the opposite side by so many grey values.
const DOT_LEAST: f64 = 20.0;

/// Another camera may see the opposite side brighter by this part of that.
const DOT_DOUBT: f64 = 0.5;

/// Cameras that are where their calibration says leave less, px.
const MOST_RMS_PX: f64 = 1.0;

/// Fewest corners that make a pose.
const FEWEST: usize = 20;

/// What is known of a board.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BoardForm {
    /// A field's side, m.
    pub field_m: f64,
    /// The middle of the bright dot on its rim, in the board's frame, m.
    pub dot: [f64; 2],
    /// About how high its surface is in the base frame, m: where the search begins.
    pub about_z: f64,
}

/// A picture, and the camera that took it.
#[derive(Debug, Clone)]
pub struct View {
    /// The picture.
    pub frame: Frame,
    /// The camera in the base frame.
    pub camera: Camera,
    /// How well its place is known along each axis, m.
    pub position_sd: f64,
    /// How well its direction is known, rad.
    pub rotation_sd: f64,
}

impl View {
    /// A picture of a camera whose lens and place are calibrated.
    #[must_use]
    pub fn new(frame: Frame, lens: &CameraInfo, pose: &CameraPose) -> Self {
        let most = |all: &[f64; 3]| all.iter().copied().fold(0.0, f64::max);
        Self {
            frame,
            camera: lens.at(pose),
            position_sd: most(&pose.position_sd_m),
            rotation_sd: most(&pose.rotation_sd_rad),
        }
    }

    /// Its colours between pixels, 0 to 255; `None` outside.
    #[must_use]
    pub fn colour(&self, at: Vector2<f64>) -> Option<Vector3<f64>> {
        let inside = |x: f64, size: usize| x >= 0.0 && x < size as f64 - 1.0;
        if !(inside(at.x, self.frame.width) && inside(at.y, self.frame.height)) {
            return None;
        }
        let (u, v) = (at.x.floor(), at.y.floor());
        let (du, dv) = (at.x - u, at.y - v);
        let (u, v) = (u as usize, v as usize);
        let rgb = |u: usize, v: usize| {
            let rgb = self.frame.rgb(u, v)?;
            Some(Vector3::from(rgb.map(f64::from)))
        };
        let above = rgb(u, v)? * (1.0 - du) + rgb(u + 1, v)? * du;
        let below = rgb(u, v + 1)? * (1.0 - du) + rgb(u + 1, v + 1)? * du;
        Some(above * (1.0 - dv) + below * dv)
    }

    /// Where the ray of a pixel meets the plane of height `z` in a frame, in that frame.
    #[must_use]
    pub fn on_plane(
        &self,
        pixel: Vector2<f64>,
        base_t_frame: &Isometry3<f64>,
        z: f64,
    ) -> Option<Point2<f64>> {
        let back = base_t_frame.inverse();
        let eye = back * self.camera.centre;
        let ray = self.camera.ray(pixel)?;
        let ray = back * (self.camera.rotation.inverse() * ray);
        let along = (z - eye.z) / ray.z;
        (along.is_finite() && along > 0.0).then(|| (eye + ray * along).xy())
    }
}

/// Where a board stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BoardPose {
    /// The board in the base frame.
    pub base_t_board: Isometry3<f64>,
    /// Standard deviations of its rotation vector (3, rad, base axes) and of its middle (3, m), with what is not known of the
    /// cameras' places.
    pub sd: [f64; 6],
    /// Root of the mean square distance of the corners from where they should be seen, px.
    pub rms_px: f64,
    /// Corners that were used, of 49 for each camera.
    pub corners: usize,
    /// Cameras that saw it.
    pub cameras: Vec<String>,
}

/// Why there is no pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoBoard {
    /// The board has no fields.
    #[error("the side of a field is {0} m; it is larger than 0")]
    Field(f64),
    /// No camera sees a board.
    #[error("no camera sees the board: {0}")]
    Unseen(String),
    /// The dot that says which way it lies is not seen.
    #[error(
        "the board is seen, and not which way it lies: its dot is covered, or is no brighter than its rim"
    )]
    Turned,
    /// The cameras contradict each other or the board's measures.
    #[error(
        "the corners are {0:.2} px off: a camera is no more where its calibration says, or the fields have another size"
    )]
    Contradiction(f64),
    /// The corners do not determine a pose.
    #[error("the {0} corners that are seen do not determine where the board is")]
    Undetermined(usize),
}

/// A corner: where it is on the board (m), and where it was seen.
struct Seen<'a> {
    view: &'a View,
    on_board: Point3<f64>,
    pixel: Vector2<f64>,
}

/// The board before the cameras.
///
/// # Errors
/// [`NoBoard`] says what is missing.
pub fn find_board(views: &[View], form: &BoardForm) -> Result<BoardPose, NoBoard> {
    if !(form.field_m.is_finite() && form.field_m > 0.0) {
        return Err(NoBoard::Field(form.field_m));
    }
    let (start, mut seen) = all_corners(views, form)?;
    let few = |seen: &[Seen<'_>]| NoBoard::Undetermined(seen.len());
    if seen.len() < FEWEST {
        return Err(few(&seen));
    }
    let (pose, _) = fitted(&start, &seen).ok_or(few(&seen))?;
    // What is no corner of the board lies beside its place.
    let off = |one: &Seen<'_>| residual(&pose, one).map_or(f64::INFINITY, |off| off.norm());
    let mut offs: Vec<f64> = seen.iter().map(off).collect();
    offs.sort_by(f64::total_cmp);
    let limit = (4.0 * offs.get(offs.len() / 2).copied().unwrap_or(0.0)).max(0.3);
    seen.retain(|one| off(one) <= limit);
    if seen.len() < FEWEST {
        return Err(few(&seen));
    }
    let (pose, fit_sd) = fitted(&pose, &seen).ok_or(few(&seen))?;
    let squares = seen.iter().filter_map(|one| residual(&pose, one));
    let squares: f64 = squares.map(|off| off.norm_squared()).sum();
    let rms_px = (squares / seen.len() as f64).sqrt();
    if rms_px > MOST_RMS_PX {
        return Err(NoBoard::Contradiction(rms_px));
    }
    let used = |view: &&View| seen.iter().any(|one| std::ptr::eq(one.view, *view));
    let users: Vec<&View> = views.iter().filter(used).collect();
    let pose = the_right_way(&pose, &users, form).ok_or(NoBoard::Turned)?;
    Ok(BoardPose {
        sd: with_cameras(fit_sd, &users, &pose),
        base_t_board: pose,
        rms_px,
        corners: seen.len(),
        cameras: users.iter().map(|view| view.frame.camera.clone()).collect(),
    })
}

/// The corners in all pictures, counted from the same end of the board, and about where that is.
fn all_corners<'a>(
    views: &'a [View],
    form: &BoardForm,
) -> Result<(Isometry3<f64>, Vec<Seen<'a>>), NoBoard> {
    let (mut start, mut all, mut reasons) = (None, Vec::new(), Vec::new());
    for view in views {
        match corners(view, form) {
            Ok((pose, corners)) => {
                let start = *start.get_or_insert(pose);
                // Each picture may count its fields from the other end.
                let turned = (start.rotation.inverse() * pose.rotation) * Vector3::x();
                let sign = if turned.x < 0.0 { -1.0 } else { 1.0 };
                all.extend(corners.into_iter().map(|(on_board, pixel)| Seen {
                    view,
                    on_board: Point3::new(sign * on_board.x, sign * on_board.y, 0.0),
                    pixel,
                }));
            }
            Err(error) => reasons.push(format!("camera `{}`: {error}", view.frame.camera)),
        }
    }
    match start {
        Some(start) => Ok((start, all)),
        None => Err(NoBoard::Unseen(reasons.join("; "))),
    }
}

/// What is not known of the cameras' places adds to what is not known of the corners'.
fn with_cameras(mut sd: [f64; 6], views: &[&View], pose: &Isometry3<f64>) -> [f64; 6] {
    let count = views.len().max(1) as f64;
    let (mut turn, mut place) = (0.0, 0.0);
    for view in views {
        let far = (view.camera.centre.coords - pose.translation.vector).norm();
        turn += view.rotation_sd.powi(2) / count.powi(2);
        place += (view.position_sd.powi(2) + (far * view.rotation_sd).powi(2)) / count.powi(2);
    }
    for (k, own) in sd.iter_mut().enumerate() {
        *own = own.hypot(if k < 3 { turn } else { place }.sqrt());
    }
    sd
}

type Corners = Vec<(Point2<f64>, Vector2<f64>)>;

/// The corners in one picture, and about where the board is if its first field is where this picture counts from.
fn corners(view: &View, form: &BoardForm) -> Result<(Isometry3<f64>, Corners), BoardError> {
    let frame = &view.frame;
    let picture = Picture {
        width: frame.width,
        height: frame.height,
        format: match frame.format {
            PixelFormat::Grey8 => Format::Grey8,
            PixelFormat::Rgb8 => Format::Rgb8,
        },
        pixels: frame.pixels.to_vec(),
        notes: Vec::new(),
    };
    let board = Board::find(&picture, Side::Bottom)?;
    let lines = 1..=INNER;
    let places: Vec<[f64; 2]> = lines
        .clone()
        .flat_map(|file| lines.clone().map(move |rank| [file, rank].map(f64::from)))
        .collect();
    let expected = places.iter().map(|[file, rank]| {
        let [u, v] = board.pixel(*file, *rank);
        let neighbours = [(1.0, 0.0), (0.0, 1.0)].map(|(x, y)| board.pixel(file + x, rank + y));
        let side = neighbours.map(|[x, y]| (x - u).hypot(y - v));
        ([u, v], (NEAR * side[0].min(side[1])).clamp(3.0, 9.0))
    });
    let expected: Vec<([f64; 2], f64)> = expected.collect();
    let found = corners_near(&frame.grey(), frame.width, &expected);
    let on_board = |[file, rank]: &[f64; 2]| Point2::new(file - 4.0, rank - 4.0) * form.field_m;
    let pairs = places.iter().zip(&found);
    let pairs = pairs.filter_map(|(place, corner)| {
        let corner = corner.as_ref()?;
        Some((on_board(place), Vector2::new(corner.u, corner.v)))
    });
    let pairs: Corners = pairs.collect();
    let none = BoardError::NoPattern {
        corners: found.len(),
        lattice: pairs.len(),
    };
    let pose = laid_flat(view, &pairs, form).ok_or(none)?;
    Ok((pose, pairs))
}

/// The pose on the level plane where the board is expected that fits the corners best.
fn laid_flat(view: &View, pairs: &Corners, form: &BoardForm) -> Option<Isometry3<f64>> {
    let level = Isometry3::identity();
    let placed = pairs.iter().filter_map(|(on_board, pixel)| {
        let at = view.on_plane(*pixel, &level, form.about_z)?;
        Some((on_board.coords, at.coords))
    });
    let placed: Vec<(Vector2<f64>, Vector2<f64>)> = placed.collect();
    if placed.len() < 4 {
        return None;
    }
    let count = placed.len() as f64;
    let from = placed.iter().map(|(from, _)| from).sum::<Vector2<f64>>() / count;
    let to = placed.iter().map(|(_, to)| to).sum::<Vector2<f64>>() / count;
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (a, b) in &placed {
        let (a, b) = (a - from, b - to);
        cosine += a.dot(&b);
        sine += a.x * b.y - a.y * b.x;
    }
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), sine.atan2(cosine));
    let shift = to.push(form.about_z) - turn * from.push(0.0);
    Some(Isometry3::from_parts(Translation3::from(shift), turn))
}

/// The pose, or that after half a turn: the dot is on the side where it is brighter. `None` where no camera sees that, or where
/// one camera says so and another one the contrary about as clearly.
fn the_right_way(
    pose: &Isometry3<f64>,
    views: &[&View],
    form: &BoardForm,
) -> Option<Isometry3<f64>> {
    let light = |view: &View, sign: f64| {
        let at = pose * Point3::new(sign * form.dot[0], sign * form.dot[1], 0.0);
        let colour = view.colour(view.camera.project(&at)?)?;
        Some(Vector3::new(0.2126, 0.7152, 0.0722).dot(&colour))
    };
    let (mut here, mut there): (f64, f64) = (0.0, 0.0);
    for view in views {
        if let (Some(one), Some(other)) = (light(view, 1.0), light(view, -1.0)) {
            here = here.max(one - other);
            there = there.max(other - one);
        }
    }
    let (most, least) = (here.max(there), here.min(there));
    if most < DOT_LEAST || least > DOT_DOUBT * most {
        return None;
    }
    let half = if here > there {
        0.0
    } else {
        std::f64::consts::PI
    };
    Some(pose * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), half))
}

fn residual(pose: &Isometry3<f64>, seen: &Seen<'_>) -> Option<Vector2<f64>> {
    Some(seen.view.camera.project(&(pose * seen.on_board))? - seen.pixel)
}

/// Least squares of the pixels, and the standard deviations that the residuals tell.
fn fitted(start: &Isometry3<f64>, seen: &[Seen<'_>]) -> Option<(Isometry3<f64>, [f64; 6])> {
    let mut pose = *start;
    for _ in 0..20 {
        let (normal, right, _) = equations(&pose, seen)?;
        let step = normal.cholesky()?.solve(&-right);
        pose = moved(&pose, &step);
        if step.amax() < 1e-10 {
            break;
        }
    }
    let (normal, _, squares) = equations(&pose, seen)?;
    let spare = (2 * seen.len()).checked_sub(6)?.max(1) as f64;
    let covariance = normal.try_inverse()? * (squares / spare);
    let sd: [f64; 6] = std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt());
    let sound = pose.to_homogeneous().iter().all(|x| x.is_finite());
    (sound && sd.iter().all(|x| x.is_finite())).then_some((pose, sd))
}

type Normal = SMatrix<f64, 6, 6>;

/// The normal equations of the pixels, and the sum of squares.
fn equations(pose: &Isometry3<f64>, seen: &[Seen<'_>]) -> Option<(Normal, SVector<f64, 6>, f64)> {
    let (mut normal, mut right, mut squares) = (Normal::zeros(), SVector::zeros(), 0.0);
    for one in seen {
        let off = residual(pose, one)?;
        let row = slopes(pose, one)?;
        normal += row.transpose() * row;
        right += row.transpose() * off;
        squares += off.norm_squared();
    }
    Some((normal, right, squares))
}

/// The pose turned by a rotation vector in the base's axes about the board's middle, and shifted.
fn moved(pose: &Isometry3<f64>, by: &SVector<f64, 6>) -> Isometry3<f64> {
    let turn = UnitQuaternion::new(by.fixed_rows::<3>(0).into_owned());
    let shift = pose.translation.vector + by.fixed_rows::<3>(3);
    Isometry3::from_parts(Translation3::from(shift), turn * pose.rotation)
}

/// How the pixel of a corner moves with the pose, by differences.
fn slopes(pose: &Isometry3<f64>, seen: &Seen<'_>) -> Option<SMatrix<f64, 2, 6>> {
    const STEP: f64 = 1e-6;
    let mut slopes = SMatrix::<f64, 2, 6>::zeros();
    for column in 0..6 {
        let mut by = SVector::<f64, 6>::zeros();
        by[column] = STEP;
        let up = residual(&moved(pose, &by), seen)?;
        let down = residual(&moved(pose, &-by), seen)?;
        slopes.set_column(column, &((up - down) / (2.0 * STEP)));
    }
    Some(slopes)
}
