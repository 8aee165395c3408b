//! The class `handeye`: where a camera sits on a tool, from a table of poses.

use std::sync::LazyLock;

use ctos::diagnostic::Source;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    MOST_TOLD, code, ended, opened,
    table::{self, Columns},
    told,
};
use crate::handeye::{Sample, hand_eye};

/// Numbers of a pose: the upper three rows of its matrix.
const POSE: usize = 12;

/// Entries of a matrix may be off those of a rotation by so much: tables are rounded.
const ROUNDED: f64 = 1e-3;

/// A place that is known no better is told to be poor, rad and m.
const POOR_RAD: f64 = 0.02;
const POOR_M: f64 = 0.01;

/// Cameras on a tool sit nearer to it, m.
const FAR_M: f64 = 0.5;

const COLUMNS: Columns = Columns {
    names: &[],
    count: Some(2 * POSE),
    may_be_empty: &[],
    help: "a row has 24 numbers: base_T_tool and then camera_T_target, each its upper 3 x 4 by rows, m; a first line of names may stand above",
};

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "14 floats: rotation vector (rad) and translation (m) of tool_T_camera, 6 standard deviations of these, and the \
            root mean squares of the angle (rad) and of the distance (m) between the target as seen and as expected",
    results: "rx ry rz: rad; x y z: m; sd_rx sd_ry sd_rz: rad; sd_x sd_y sd_z: m; rms_angle: rad; rms_distance: m",
    help: "calibrates a camera on a tool from poses of the tool and of a target that stands still",
}];

#[derive(Debug, Clone, Default)]
pub(super) struct Options;

pub(super) static TABLE: LazyLock<OptionTable<Options>> =
    LazyLock::new(|| OptionTable::new("finds where a camera sits on a tool").exec(FORMS));

/// An object of class `handeye`.
pub(super) struct HandEye;

impl ServiceObject for HandEye {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|_| calibrate(io));
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut Options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&Options)
    }
}

fn calibrate(io: &mut Transport) -> Outcome {
    let source = opened(io.text.trim())?;
    let table = table::read(&source, &COLUMNS).map_err(told)?;
    let mut samples = Vec::with_capacity(table.at.len());
    table.tell_repeated(&source, io);
    for (row, numbers) in table.rows().enumerate() {
        let (tool, target) = numbers.split_at(POSE);
        let sample = pose(tool).zip(pose(target));
        let Some((base_t_tool, camera_t_target)) = sample else {
            let name = if pose(tool).is_none() {
                "base_T_tool"
            } else {
                "camera_T_target"
            };
            let text = format!(
                "{}: the matrix of {name} is no rotation: its columns are not of length 1 and at right angles (rounded to fewer than four digits, or written by columns?), \
                 or it is a mirror",
                table.place(&source, row)
            );
            return Err(Report::error(code::TABLE, text));
        };
        let before = camera_t_target.translation.vector.z;
        if before <= 0.0 {
            let text = format!(
                "{}: the target is {before:.3} m before the camera, behind it: camera_T_target is the target in the camera's frame, whose z \
                 points forward; is it the inverse?",
                table.place(&source, row)
            );
            return Err(Report::error(code::TABLE, text));
        }
        samples.push(Sample {
            base_t_tool,
            camera_t_target,
        });
    }
    let found = hand_eye(&samples)
        .map_err(|why| Report::error(code::NO_CAMERA, format!("{}: {why}", source.name())))?;
    if !found.rejected.is_empty() {
        let told = found.rejected.iter().take(MOST_TOLD).map(|one| {
            let at = table.place(&source, one.row);
            format!(
                "{at} is off by {:.4} rad and {:.4} m",
                one.off_rad, one.off_m
            )
        });
        let told: Vec<String> = told.collect();
        let (all, samples) = (found.rejected.len(), samples.len());
        let text = format!(
            "{all} of {samples} samples are not used: {}",
            told.join("; ")
        );
        io.report(Report::warning(code::REJECTED, text));
    }
    for warning in doubts(&found, &source) {
        io.report(Report::warning(code::NO_CAMERA, warning));
    }
    io.floats.clear();
    let turn = found.tool_t_camera.rotation.scaled_axis();
    let shift = found.tool_t_camera.translation.vector;
    io.floats.extend(turn.iter().chain(shift.iter()));
    io.floats.extend(found.sd);
    io.floats.extend([found.rms_rad, found.rms_m]);
    Ok(())
}

/// What a person should know before leaning on it.
fn doubts(found: &crate::handeye::HandEye, source: &Source) -> Vec<String> {
    let mut all = Vec::new();
    let largest = |sd: &[f64]| sd.iter().copied().fold(0.0, f64::max);
    let (turn, shift) = (largest(&found.sd[..3]), largest(&found.sd[3..]));
    if turn > POOR_RAD || shift > POOR_M {
        all.push(format!(
            "{}: the samples determine the camera's place poorly: to {turn:.4} rad and {shift:.4} m; take 10 or more, with turns of the tool \
             of 0.3 rad and more about two axes",
            source.name()
        ));
    }
    let away = found.tool_t_camera.translation.vector.norm();
    if away > FAR_M {
        all.push(format!(
            "{}: the camera would sit {away:.2} m from the tool: are lengths in m, and does a row begin with base_T_tool?",
            source.name()
        ));
    }
    all
}

/// A pose from the upper three rows of its matrix; `None` when they hold no rotation.
fn pose(rows: &[f64]) -> Option<Isometry3<f64>> {
    let at = |row: usize, column: usize| rows.get(4 * row + column).copied();
    let mut matrix = Matrix3::zeros();
    let mut shift = Vector3::zeros();
    for row in 0..3 {
        for column in 0..3 {
            matrix[(row, column)] = at(row, column)?;
        }
        shift[row] = at(row, 3)?;
    }
    let off = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    if off > ROUNDED || matrix.determinant() < 0.0 {
        return None;
    }
    // The nearest rotation to what was rounded.
    let turn = Rotation3::from_matrix_eps(&matrix, 1e-15, 100, Rotation3::identity());
    let turn = UnitQuaternion::from_rotation_matrix(&turn);
    Some(Isometry3::from_parts(Translation3::from(shift), turn))
}
