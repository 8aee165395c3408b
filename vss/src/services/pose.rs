//! The class `pose`: where a known object stands before a camera, from a table of its points and their pixels.

use std::sync::LazyLock;

use ctos::diagnostic::Source;
use nalgebra::{Point3, Vector2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    MOST_TOLD, code, ended, opened,
    table::{self, Columns, Table},
    told,
};
use crate::{
    camera::{Distortion, Intrinsics},
    camera_info::CameraInfo,
    perspective::{Match, ModelPose, NoModelPose, model_pose},
};

const COLUMNS: Columns = Columns {
    names: &["X", "Y", "Z", "u", "v"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `X,Y,Z,u,v`: points of the object in its own frame in m, picture coordinates in px",
};

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "13 floats: rotation vector (rad) and translation (m) of camera_T_object, 6 standard deviations of these, rms over the \
            used matches of the distance between seen and predicted (px); 1 int: how many were used",
    results: "rx ry rz: rad; x y z: m; sd_rx sd_ry sd_rz: rad; sd_x sd_y sd_z: m; rms: px; ints used",
    help: "finds a known object from points of its model and their pixels, X,Y,Z,u,v (m and px, comma-separated), 4 rows or more",
}];

#[derive(Debug, Clone)]
pub(super) struct Options {
    lens: Vec<f64>,
    camera: String,
    seed: i64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            lens: Vec::new(),
            camera: String::new(),
            seed: 1,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("finds known objects from points of their models")
        .exec(FORMS)
        .floats(
            "lens",
            LENS,
            -1e6..=1e6,
            "",
            "the camera's lens, as `resect` answers it: the first four in px",
            |options: &mut Options| &mut options.lens,
        )
        .word(
            "camera",
            "FILE",
            "the camera's lens as a camera_info file, instead of -lens",
            |options| &mut options.camera,
        )
        .int(
            "seed",
            0..=i64::MAX,
            "",
            "seed of the random threes that the start value comes from; one seed, one result",
            |options| &mut options.seed,
        )
});

/// An object of class `pose`.
#[derive(Default)]
pub(super) struct Pose(Options);

impl ServiceObject for Pose {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|_| self.find(io));
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

/// What a lens of nine numbers is.
pub(super) const LENS: &[&str] = &["FX", "FY", "CX", "CY", "K1", "K2", "P1", "P2", "K3"];

/// The lens that nine numbers or a file give; none when there is neither.
pub(super) fn lens(
    numbers: &[f64],
    camera: &str,
) -> Result<Option<(Intrinsics, Distortion)>, Report> {
    if !camera.is_empty() {
        let source = opened(camera)?;
        let wrong = |why: &dyn std::fmt::Display| {
            Report::error(code::FILE, format!("{}: {why}", source.name()))
        };
        let info = CameraInfo::from_yaml(source.text()).map_err(|why| wrong(&why))?;
        return Ok(Some((info.intrinsics, info.distortion)));
    }
    let &[fx, fy, cx, cy, k1, k2, p1, p2, k3] = numbers else {
        return Ok(None);
    };
    if fx <= 0.0 || fy <= 0.0 {
        let text = "focal lengths (-lens FX FY) are larger than 0 px";
        return Err(Report::error(sorma::report::code::VALUE, text));
    }
    let distortion = Distortion { k1, k2, p1, p2, k3 };
    Ok(Some((Intrinsics { fx, fy, cx, cy }, distortion)))
}

impl Pose {
    fn find(&self, io: &mut Transport) -> Outcome {
        let lens = lens(&self.0.lens, &self.0.camera)?;
        let (intrinsics, distortion) = lens.ok_or_else(|| {
            let text = "the lens is not known: set it with CTRL -lens FX FY CX CY K1 K2 P1 P2 K3, or CTRL -camera FILE";
            Report::error(sorma::report::code::VALUE, text)
        })?;
        let source = opened(io.text.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        table.tell_repeated(&source, io);
        let matches: Vec<Match> = table.rows().filter_map(one).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(self.0.seed.unsigned_abs());
        let found = model_pose(&matches, &intrinsics, &distortion, &mut rng)
            .map_err(|why| Report::error(code::NO_POSE, refused(&source, &table, &why)))?;
        if !found.rejected.is_empty() {
            let text = rejected(&source, &table, &found);
            io.report(Report::warning(code::REJECTED, text));
        }
        let pose = &found.camera_t_model;
        let (turn, shift) = (pose.rotation.scaled_axis(), pose.translation.vector);
        io.floats.clear();
        io.floats.extend(turn.iter().chain(shift.iter()));
        io.floats.extend(found.sd());
        io.floats.push(found.rms_px);
        let used = matches.len() - found.rejected.len();
        io.ints = vec![i64::try_from(used).unwrap_or(i64::MAX)];
        Ok(())
    }
}

fn one(row: &[f64]) -> Option<Match> {
    let &[x, y, z, u, v] = row else {
        return None;
    };
    Some(Match {
        point: Point3::new(x, y, z),
        pixel: Vector2::new(u, v),
    })
}

fn refused(source: &Source, table: &Table, why: &NoModelPose) -> String {
    match why {
        NoModelPose::NoRay { row, u, v } => format!(
            "{}: the point is seen at ({u:?}, {v:?}), where the lens has no direction: is this the lens of that camera?",
            table.place(source, *row)
        ),
        other => format!("{}: {other}", source.name()),
    }
}

fn rejected(source: &Source, table: &Table, found: &ModelPose) -> String {
    let told = found.rejected.iter().take(MOST_TOLD);
    let told: Vec<String> = told.map(|row| table.place(source, *row)).collect();
    let (all, points) = (found.rejected.len(), table.at.len());
    let rest = if all > MOST_TOLD { ", and others" } else { "" };
    format!(
        "{all} of {points} matches are not used: {}{rest}",
        told.join(", ")
    )
}
