//! The class `resect`: the camera that saw known points, from a table of points and pixels.

use std::sync::LazyLock;

use ctos::diagnostic::Source;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    MOST_TOLD, code, ended, opened,
    table::{self, Columns, Table},
    told,
};
use crate::{
    calibrate::{
        Beforehand, Calibration, CalibrationError, LensModel, LightPoint, POOR_FOCAL, RejectReason,
        calibrate_as,
    },
    camera::{Camera, Distortion, Intrinsics},
};

/// Positions with a smaller share of thickness in their length are told to be nearly in one plane.
const NEARLY_FLAT: f64 = 0.02;

/// So are those that say so much less of what is around them than of what is between them, and so little, px.
const AROUND: (f64, f64) = (5.0, 1.0);

/// No camera of a laboratory is farther from its world's origin, m.
const FARTHEST_M: f64 = 100.0;

const COLUMNS: Columns = Columns {
    names: &["X", "Y", "Z", "u", "v"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `X,Y,Z,u,v`: world coordinates in m, picture coordinates in px",
};

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "16 floats: fx fy cx cy (px) k1 k2 p1 p2 k3, rotation vector (rad) and translation (m) of \
            camera_T_world, rms over the used points of the distance between seen and predicted (px); with -sd on \
            15 more: standard deviations of all but the last",
    results: "fx fy cx cy: px; k1 k2 p1 p2 k3; rx ry rz: rad; x y z: m; rms: px",
    help: "calibrates a camera from a table X,Y,Z,u,v (m and px, comma-separated)",
}];

/// What calibrations from tables are asked with; `sd` is of `resect` alone, the last two are of `bundle`.
#[derive(Debug, Clone)]
pub(super) struct Options {
    size: Vec<i64>,
    model: String,
    seed: i64,
    free: bool,
    sd: bool,
    pub robot_sd: f64,
    pub lights: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            size: Vec::new(),
            model: "brown5".to_owned(),
            seed: 1,
            free: false,
            sd: false,
            robot_sd: 1e-3,
            lights: false,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    let table = OptionTable::new("calibrates a camera from known points and their pixels");
    options(table.exec(FORMS)).flag("sd", "standard deviations are answered, too", |options| {
        &mut options.sd
    })
});

/// Adds what every calibration from a table is asked with.
pub(super) fn options(table: OptionTable<Options>) -> OptionTable<Options> {
    let seeded = lens_options(table).int(
        "seed",
        0..=i64::MAX,
        "",
        "seed of the random samples that the start value comes from; one seed, one result",
        |options| &mut options.seed,
    );
    seeded.flag(
        "free",
        "lens terms are fitted without knowing how large those of real lenses are; with few points the standard \
         deviations are then too small",
        |options| &mut options.free,
    )
}

/// Adds the size of the pictures and the lens model.
pub(super) fn lens_options(table: OptionTable<Options>) -> OptionTable<Options> {
    table
        .ints(
            "size",
            &["W", "H"],
            1..=100_000,
            "px",
            "size of the pictures; must be set before EXEC",
            |options: &mut Options| &mut options.size,
        )
        .choice(
            "model",
            &["none", "k1", "k1k2", "brown5"],
            "distortion terms that are fitted; the others are 0",
            |options| &mut options.model,
        )
}

/// An object of class `resect`.
#[derive(Default)]
pub(super) struct Resect(Options);

impl ServiceObject for Resect {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|_| self.calibrate(io));
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.0)
    }
}

impl Options {
    /// Width and height of the pictures, px.
    pub fn size(&self) -> Result<(usize, usize), Report> {
        let [width, height] = self.size.as_slice() else {
            let text = "the size of the pictures is not known: set it with CTRL -size W H";
            return Err(Report::error(sorma::report::code::VALUE, text));
        };
        let side = |length: i64| usize::try_from(length).unwrap_or_default();
        Ok((side(*width), side(*height)))
    }

    pub fn seed(&self) -> u64 {
        self.seed.unsigned_abs()
    }

    pub fn beforehand(&self) -> Beforehand {
        if self.free {
            Beforehand::Nothing
        } else {
            Beforehand::Lenses
        }
    }

    pub fn model(&self) -> LensModel {
        match self.model.as_str() {
            "none" => LensModel::None,
            "k1" => LensModel::K1,
            "k1k2" => LensModel::K1K2,
            _ => LensModel::Brown5,
        }
    }
}

impl Resect {
    fn calibrate(&self, io: &mut Transport) -> Outcome {
        let (width, height) = self.0.size()?;
        let source = opened(io.text.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        table.tell_repeated(&source, io);
        let points: Vec<LightPoint> = table.rows().filter_map(light).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(self.0.seed());
        let (model, beforehand) = (self.0.model(), self.0.beforehand());
        let found = calibrate_as(&points, width, height, model, beforehand, &mut rng)
            .map_err(|error| Report::error(code::NO_CAMERA, refused(&source, &table, &error)))?;
        for warning in warnings(&source, &table, &found) {
            io.report(warning);
        }
        answer(&found, io);
        if self.0.sd {
            let sd = &found.uncertainty;
            io.floats.extend(sd.parameter_sd.iter().skip(6));
            io.floats.extend(sd.camera_t_world_sd());
        }
        Ok(())
    }
}

/// What a person should know about a calibration before leaning on it.
pub(super) fn warnings(source: &Source, table: &Table, found: &Calibration) -> Vec<Report> {
    let mut warnings = Vec::new();
    if !found.rejected.is_empty() {
        let text = rejected(source, table, found);
        warnings.push(Report::warning(code::REJECTED, text));
    }
    if !found.monotonic {
        let text = "the distortion cannot be undone over the whole picture: spread the points up to its corners, or take fewer terms";
        warnings.push(Report::warning(code::NO_CAMERA, text));
    }
    let (between, around) = (
        found.uncertainty.volume_error_px,
        found.uncertainty.cube_error_px,
    );
    if found.flatness < NEARLY_FLAT || (around > AROUND.0 * between && around > AROUND.1) {
        let text = format!(
            "the positions lie nearly in one plane (thickness/length {:.1e}): pixels of points among them are predicted to {between:.2} px, and as far off them as they are wide to {around:.2} px; use two heights or more",
            found.flatness
        );
        warnings.push(Report::warning(code::NO_CAMERA, text));
    }
    let focal = found.focal_sd_rel();
    if focal > POOR_FOCAL {
        let text = format!(
            "the points determine the camera poorly: its focal length to {:.1} %, its place to {:.3} m; spread them over the picture and in depth",
            100.0 * focal,
            found.position_sd_m()
        );
        warnings.push(Report::warning(code::NO_CAMERA, text));
    }
    warnings
}

/// fx fy cx cy k1 k2 p1 p2 k3.
pub(super) fn lens(found: &Calibration) -> [f64; 9] {
    let (i, d) = (&found.camera.intrinsics, &found.camera.distortion);
    [i.fx, i.fy, i.cx, i.cy, d.k1, d.k2, d.p1, d.p2, d.k3]
}

fn answer(found: &Calibration, io: &mut Transport) {
    let camera_t_world = found.camera.camera_from_world();
    let turn = camera_t_world.rotation.scaled_axis();
    let shift = camera_t_world.translation.vector;
    io.floats.clear();
    io.floats.extend(lens(found));
    io.floats.extend(turn.iter().chain(shift.iter()));
    io.floats.push(found.rms_px);
}

/// The numbers by which other classes are told a camera: the first that [`Resect`] answers.
pub(super) const CAMERA: [&str; 15] = [
    "FX", "FY", "CX", "CY", "K1", "K2", "P1", "P2", "K3", "RX", "RY", "RZ", "X", "Y", "Z",
];

/// The camera that they mean, given by `option`.
pub(super) fn camera(numbers: &[f64], option: &str) -> Result<Camera, Report> {
    let wrong = |text: String| Report::error(sorma::report::code::VALUE, text);
    let unset = || {
        wrong(format!(
            "no camera is known: set {option} to what `resect` answers"
        ))
    };
    let &[fx, fy, cx, cy, k1, k2, p1, p2, k3, ..] = numbers else {
        return Err(unset());
    };
    let seen = numbers.get(9..).and_then(pose).ok_or_else(unset)?;
    if fx <= 0.0 || fy <= 0.0 {
        return Err(wrong(format!(
            "no camera has the focal lengths {fx} and {fy} px"
        )));
    }
    let away = seen.translation.vector.norm();
    if away > FARTHEST_M {
        return Err(wrong(format!(
            "{option} says that the world's origin is {away:.0} m from the camera: camera_T_world is in m; are these millimetres?"
        )));
    }
    Ok(Camera {
        rotation: seen.rotation,
        centre: seen.inverse() * Point3::origin(),
        intrinsics: Intrinsics { fx, fy, cx, cy },
        distortion: Distortion { k1, k2, p1, p2, k3 },
    })
}

/// A pose from a rotation vector and a translation.
pub(super) fn pose(numbers: &[f64]) -> Option<Isometry3<f64>> {
    let &[rx, ry, rz, x, y, z] = numbers else {
        return None;
    };
    let turn = UnitQuaternion::new(Vector3::new(rx, ry, rz));
    Some(Isometry3::from_parts(Translation3::new(x, y, z), turn))
}

fn light(row: &[f64]) -> Option<LightPoint> {
    let &[x, y, z, u, v] = row else {
        return None;
    };
    Some(LightPoint { x, y, z, u, v })
}

/// Why no camera follows, with the place where there is one.
pub(super) fn refused(source: &Source, table: &Table, error: &CalibrationError) -> String {
    match error {
        CalibrationError::OutsidePicture {
            row,
            u,
            v,
            width,
            height,
        } => format!(
            "{}: the point is seen at ({u:?}, {v:?}), outside the picture of {width} x {height} px (-size)",
            table.place(source, *row)
        ),
        other => format!("{}: {other}", source.name()),
    }
}

/// Which points were not used, and why.
fn rejected(source: &Source, table: &Table, found: &Calibration) -> String {
    let all = found.rejected.len();
    let told = found.rejected.iter().take(MOST_TOLD).map(|point| {
        let at = table.place(source, point.row);
        match point.reason {
            RejectReason::Behind => format!("{at} lies behind the camera"),
            RejectReason::Outlier { limit_px } => {
                let off = point.du.abs().max(point.dv.abs());
                format!("{at} is off by {off:.2} px, more than {limit_px:.2}")
            }
        }
    });
    let told: Vec<String> = told.collect();
    let more = all.saturating_sub(MOST_TOLD);
    let rest = if more > 0 {
        format!("; and {more} more")
    } else {
        String::new()
    };
    let points = table.at.len();
    format!(
        "{all} of {points} points are not used: {}{rest}",
        told.join("; ")
    )
}
