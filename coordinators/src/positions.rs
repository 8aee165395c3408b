//! The file of predetermined manipulator positions.
//!
//! One tool pose per line, comma-separated under the header `x,y,z,roll,pitch,yaw`: the origin of the
//! tool frame (the lamp) in the base frame, m, and its orientation `Rz(yaw) Ry(pitch) Rx(roll)`,
//! degrees. Lines that begin with `#` are comments.

use std::path::Path;

use ctos::diagnostic::{Finding, Findings, Source};
use mcs::arm::{ArmModel, IkError};
use nalgebra::{Isometry3, Matrix3xX, Translation3, UnitQuaternion};
use serde::Deserialize;

/// Fewer positions cannot determine a camera with distortion (`2 n` equations for 15 unknowns), and
/// leave nothing to judge the fit by.
pub const POSITIONS_MIN: usize = 12;

/// A set of points is flat when its smallest extent is below this part of its largest.
const FLAT: f64 = 1e-3;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    x: f64,
    y: f64,
    z: f64,
    roll: f64,
    pitch: f64,
    yaw: f64,
}

impl Row {
    fn pose(&self) -> Option<Isometry3<f64>> {
        let numbers = [self.x, self.y, self.z, self.roll, self.pitch, self.yaw];
        numbers.iter().all(|number| number.is_finite()).then(|| {
            Isometry3::from_parts(
                Translation3::new(self.x, self.y, self.z),
                UnitQuaternion::from_euler_angles(
                    self.roll.to_radians(),
                    self.pitch.to_radians(),
                    self.yaw.to_radians(),
                ),
            )
        })
    }
}

/// A pose of the file and the line it stands in, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(source.text().as_bytes());
    let mut findings = Findings::new();
    let mut positions = Vec::new();
    let headers = reader.headers().cloned().unwrap_or_default();
    if headers.iter().ne(["x", "y", "z", "roll", "pitch", "yaw"]) {
        let text = "the first line must be the header `x,y,z,roll,pitch,yaw`";
        let line = headers.position().map_or(1, csv::Position::line);
        let place = source.at_line(usize::try_from(line).unwrap_or(1));
        findings.push(Finding::error("coordinators::positions::header", text).at(place));
        return Err(findings);
    }
    let mut record = csv::StringRecord::new();
    loop {
        let line = usize::try_from(reader.position().line()).unwrap_or(1);
        match reader.read_record(&mut record) {
            Ok(false) => break,
            Ok(true) => {
                let line = record
                    .position()
                    .and_then(|position| usize::try_from(position.line()).ok())
                    .unwrap_or(line);
                match row(source, &record, &headers, line) {
                    Ok(pose) => positions.push(Position { pose, line }),
                    Err(finding) => findings.push(finding),
                }
            }
            Err(error) => {
                let line = error
                    .position()
                    .and_then(|position| usize::try_from(position.line()).ok())
                    .unwrap_or(line);
                findings.push(
                    Finding::error(
                        "coordinators::positions::row",
                        format!("line {line} cannot be read: {error}"),
                    )
                    .at(source.at_line(line))
                    .help("write six numbers, separated by commas: x,y,z,roll,pitch,yaw"),
                );
            }
        }
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(positions)
    }
}

fn row(
    source: &Source,
    record: &csv::StringRecord,
    headers: &csv::StringRecord,
    line: usize,
) -> Result<Isometry3<f64>, Finding> {
    let help = "write six numbers, separated by commas: x,y,z in m, roll,pitch,yaw in degrees";
    let finding = |text: String, column: Option<&str>| {
        let place = column
            .and_then(|column| place_of(source, line, column))
            .unwrap_or_else(|| source.at_line(line));
        Finding::error("coordinators::positions::row", text)
            .at(place)
            .help(help)
    };
    let row: Row = record.deserialize(Some(headers)).map_err(|error| {
        let field = match error.kind() {
            csv::ErrorKind::Deserialize { err, .. } => {
                err.field().and_then(|field| usize::try_from(field).ok())
            }
            _ => None,
        };
        let column = field.and_then(|field| record.get(field));
        let shown = column.map_or_else(
            || error.to_string(),
            |text| format!("`{text}` is no number"),
        );
        finding(shown, column)
    })?;
    row.pose().ok_or_else(|| {
        let bad = record
            .iter()
            .find(|text| text.parse::<f64>().is_ok_and(|number| !number.is_finite()));
        let shown = bad.unwrap_or("a number");
        finding(format!("`{shown}` is not a finite number"), bad)
    })
}

/// Where `text` stands in a line.
fn place_of(source: &Source, line: usize, text: &str) -> Option<ctos::diagnostic::Place> {
    let whole = source.at_line(line);
    let content = source.text().get(whole.range.clone())?;
    let start = whole.range.start + content.find(text)?;
    Some(source.at(start..start + text.len()))
}

/// Checks that positions can be reached and determine a camera: enough of them, not all in one plane,
/// each within the arm's reach and joint limits with `tool` (`frame_6_T_tool`) in its hand.
pub fn check(
    positions: &[Position],
    source: &Source,
    arm: &ArmModel,
    tool: &Isometry3<f64>,
    findings: &mut Findings,
) {
    for position in positions {
        if let Err(reason) = reach(arm, tool, &position.pose) {
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

fn reach(
    arm: &ArmModel,
    tool: &Isometry3<f64>,
    base_t_tool: &Isometry3<f64>,
) -> Result<(), IkError> {
    let near = [0.0; 6];
    let solutions = arm.inverse(&(base_t_tool * tool.inverse()), &near)?;
    solutions.nearest(arm, &near, None).map(|_| ())
}

/// How positions fail to fill space, if they do.
fn flat(positions: &[Position]) -> Option<&'static str> {
    let points = positions
        .iter()
        .map(|position| position.pose.translation.vector);
    let points = Matrix3xX::from_columns(&points.collect::<Vec<_>>());
    let mean = points.column_mean();
    let centred = Matrix3xX::from_columns(
        &points
            .column_iter()
            .map(|point| point - mean)
            .collect::<Vec<_>>(),
    );
    let mut extents: Vec<f64> = centred.singular_values().iter().copied().collect();
    extents.sort_by(|a, b| b.total_cmp(a));
    match extents.as_slice() {
        [first, ..] if *first <= 0.0 => Some("at one point"),
        [first, second, _] if second / first < FLAT => Some("on one line"),
        [first, _, third] if third / first < FLAT => Some("in one plane"),
        _ => None,
    }
}
