//! The file of predetermined manipulator positions.
//!
//! One tool pose per line, comma-separated under the header `x,y,z,roll,pitch,yaw`: the origin of the
//! tool frame (the lamp) in the base frame, m, and its orientation `Rz(yaw) Ry(pitch) Rx(roll)`,
//! degrees. Lines that begin with `#` are comments.

use std::{path::Path, sync::Arc};

use ctos::diagnostic::{Finding, Findings, Source};
use mcs::{Joints, model::Model, trajectory::Solver};
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Fewer positions cannot determine a camera with distortion (`2 n` equations for 15 unknowns), and
/// leave nothing to judge the fit by.
pub const POSITIONS_MIN: usize = 12;

/// A set of points is flat when its smallest extent is below this part of its largest.
const FLAT: f64 = 1e-3;

/// Below this part of the largest coordinate, extents are rounding errors.
const ROUNDING: f64 = 1e-7;

/// The columns.
const COLUMNS: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];

const HELP: &str = "write six numbers, separated by commas: x,y,z in m, roll,pitch,yaw in degrees";

/// A pose of the file and the line it stands in, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Position {
    /// `base_t_tool`.
    pub pose: Isometry3<f64>,
    /// The line.
    pub line: usize,
}

impl Position {
    /// The pose as a homogeneous matrix, row by row.
    #[must_use]
    pub fn row_major(&self) -> [f64; 16] {
        let matrix = self.pose.to_homogeneous().transpose();
        let mut rows = [0.0; 16];
        rows.copy_from_slice(matrix.as_slice());
        rows
    }
}

/// Reads a file of positions.
///
/// # Errors
/// Every line that is not six finite numbers, with its place.
pub fn read(path: &Path) -> Result<Vec<Position>, Findings> {
    parse(&Source::read(path)?)
}

/// Reads the text of such a file.
///
/// # Errors
/// As [`read`].
pub fn parse(source: &Source) -> Result<Vec<Position>, Findings> {
    let mut findings = Findings::new();
    let mut positions = Vec::new();
    let mut rows = rows(source.text());
    let header = rows.next();
    let names = header.iter().flat_map(|row| row.fields());
    if !names.map(|(_, name)| name).eq(COLUMNS) {
        let line = header.map_or(1, |row| row.line);
        findings.push(
            Finding::error(
                "coordinators::positions::header",
                "the first line must be the header `x,y,z,roll,pitch,yaw`",
            )
            .at(source.at_line(line))
            .help("put the header above the positions; only comments may stand before it"),
        );
        return Err(findings);
    }
    for row in rows {
        match pose(source, &row) {
            Ok(pose) => positions.push(Position {
                pose,
                line: row.line,
            }),
            Err(found) => findings.extend(found),
        }
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(positions)
    }
}

/// A line that is neither empty nor a comment.
struct FileRow<'a> {
    /// Counted from 1.
    line: usize,
    /// Byte offset in the file.
    start: usize,
    text: &'a str,
}

impl<'a> FileRow<'a> {
    /// Byte offsets in the file and texts of the fields, without the blanks around them.
    fn fields(&self) -> impl Iterator<Item = (usize, &'a str)> + use<'a> {
        let mut start = self.start;
        self.text.split(',').map(move |field| {
            let shown = field.trim();
            let blanks = match shown {
                "" => 0,
                _ => field.len() - field.trim_start().len(),
            };
            let at = start + blanks;
            start += field.len() + 1;
            (at, shown)
        })
    }
}

fn rows(text: &str) -> impl Iterator<Item = FileRow<'_>> {
    let mut end = 0;
    let lines = text.split_inclusive('\n').enumerate();
    lines.filter_map(move |(index, text)| {
        let mut start = end;
        end += text.len();
        let mut text = text;
        // Some editors put a byte order mark before everything else.
        if let (0, Some(rest)) = (index, text.strip_prefix('\u{feff}')) {
            start += text.len() - rest.len();
            text = rest;
        }
        let content = text.trim();
        let line = index + 1;
        (!content.is_empty() && !content.starts_with('#')).then_some(FileRow { line, start, text })
    })
}

fn pose(source: &Source, row: &FileRow<'_>) -> Result<Isometry3<f64>, Findings> {
    let mut findings = Findings::new();
    let error = |text: String, place| {
        Finding::error("coordinators::positions::row", text)
            .at(place)
            .help(HELP)
    };
    let mut numbers = Vec::with_capacity(COLUMNS.len());
    for (at, field) in row.fields() {
        let wrong = match field.parse::<f64>() {
            Ok(number) if number.is_finite() => {
                numbers.push(number);
                continue;
            }
            Ok(_) => format!("`{field}` is not a finite number"),
            Err(_) if field.is_empty() => "a number is missing".to_owned(),
            Err(_) => format!("`{field}` is no number"),
        };
        findings.push(error(wrong, source.at(at..at + field.len())));
    }
    let count = row.fields().count();
    if count != COLUMNS.len() {
        let text = format!(
            "a position has {} numbers, and here are {count}",
            COLUMNS.len()
        );
        findings.push(error(text, source.at_line(row.line)));
    }
    match numbers.as_slice() {
        [x, y, z, roll, pitch, yaw] if findings.is_empty() => Ok(Isometry3::from_parts(
            Translation3::new(*x, *y, *z),
            UnitQuaternion::from_euler_angles(
                roll.to_radians(),
                pitch.to_radians(),
                yaw.to_radians(),
            ),
        )),
        _ => Err(findings),
    }
}

/// Checks that each pose is within the arm's reach and joint limits with its tool, which is the tip of its model.
pub fn check_reach(positions: &[Position], source: &Source, arm: Model, findings: &mut Findings) {
    // The servo's own check says that an arm has too many joints.
    let Ok(mut solver) = Solver::new(Arc::new(arm)) else {
        return;
    };
    let near = Joints::zeros(solver.model().dof());
    for position in positions {
        if let Err(reason) = solver.nearest(&position.pose, &near, None) {
            findings.push(
                Finding::error(
                    "coordinators::positions::unreachable",
                    format!("the arm cannot take this pose: {reason}"),
                )
                .at(source.at_line(position.line))
                .help("move the pose towards the shoulder, turn the tool, or take the line out"),
            );
        }
    }
}

/// Checks that positions determine a camera: enough of them, and not all in one plane.
pub fn check_spread(positions: &[Position], source: &Source, findings: &mut Findings) {
    let all = source.at_line(1);
    if positions.len() < POSITIONS_MIN {
        findings.push(
            Finding::error(
                "coordinators::positions::too_few",
                format!(
                    "{} positions are too few to calibrate a camera: at least {POSITIONS_MIN} are needed",
                    positions.len()
                ),
            )
            .at(all)
            .help("50 or more, spread over the work volume and over several heights, give a good result"),
        );
    } else if let Some(what) = flat(positions) {
        findings.push(
            Finding::error(
                "coordinators::positions::flat",
                format!("all positions lie {what}, which cannot determine a camera"),
            )
            .at(all)
            .help("spread them over several heights"),
        );
    }
}

/// How positions fail to fill space, if they do.
fn flat(positions: &[Position]) -> Option<&'static str> {
    let points: Vec<Vector3<f64>> = positions
        .iter()
        .map(|position| position.pose.translation.vector)
        .collect();
    // Extents are judged relative to the largest one, so that no square overflows.
    let largest = points.iter().map(Vector3::amax).fold(0.0, f64::max);
    let scale = if largest > 0.0 { largest } else { 1.0 };
    let points: Vec<Vector3<f64>> = points.iter().map(|point| point / scale).collect();
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let scatter: Matrix3<f64> = points
        .iter()
        .map(|point| (point - mean) * (point - mean).transpose())
        .sum();
    // Singular values of the centred points are the roots of these; rounding may make them negative.
    let mut extents: Vec<f64> = scatter
        .symmetric_eigenvalues()
        .iter()
        .map(|square| square.max(0.0).sqrt())
        .collect();
    extents.sort_by(|a, b| b.total_cmp(a));
    match extents.as_slice() {
        [first, ..] if *first <= ROUNDING => Some("at one point"),
        [first, second, _] if second / first < FLAT => Some("on one line"),
        [first, _, third] if third / first < FLAT => Some("in one plane"),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
