//! The class `laser`: where a scanner's beam goes, where it must be sent, what a camera's ray meets of it, and its calibration.

mod steer;

use std::sync::LazyLock;

use ctos::diagnostic::Source;
use futures_util::future::LocalBoxFuture;
use nalgebra::{Point3, Unit, Vector2, Vector3};
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{
    MOST_TOLD, code, ended, opened,
    resect::{self, pose},
    table::{self, Columns, Table},
    told,
};
use crate::{
    camera::Camera,
    laser::{
        Beam, Fitted, FittedPlane, LaserOrder, Met, NoLaser, Plane, Scanner, beside, calibrate,
        on_beam, on_plane, plane_through,
    },
};

const POINTS: Columns = Columns {
    names: &["X", "Y", "Z"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `X,Y,Z`: points that a line of light met, world, m",
};

const SAMPLES: Columns = Columns {
    names: &["a", "b", "X", "Y", "Z"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `a,b,X,Y,Z`: the command for both mirrors, and the point that the beam met, world, m",
};

/// Standard deviations beyond which ray and beam are not of one spot.
const APART: f64 = 3.0;

/// Rows that are off by so many root mean squares are told, and never those that are off by less, m.
const FAR_RMS: f64 = 4.0;
const LEAST_FAR_M: f64 = 1e-6;

/// A scanner that is known no better is told to be poor, m.
const POOR_M: f64 = 0.1;

const FORMS: &[Form] = &[
    Form {
        text: "point",
        floats: 3,
        takes: "a point X Y Z in the world, m",
        gives: "2 floats: the command for both mirrors, which the scanner has now",
        results: "a b",
        help: "has the scanner of an app send its beam there",
    },
    Form {
        text: "draw",
        floats: 4,
        takes: "commands for both mirrors: where a line begins, and where it ends",
        gives: "nothing",
        results: "",
        help: "has the scanner of an app draw a line, faster than any exposure",
    },
    Form {
        text: "off",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "switches the scanner of an app off",
    },
    Form {
        text: "aim",
        floats: 3,
        takes: "a point X Y Z in the world, m",
        gives: "2 floats: the command for both mirrors at which the beam meets it",
        results: "a b",
        help: "where the scanner must be sent",
    },
    Form {
        text: "beam",
        floats: 2,
        takes: "the command for both mirrors",
        gives: "6 floats: where the beam leaves the scanner (m) and its direction, world",
        results: "x y z: m; dx dy dz",
        help: "where the beam goes",
    },
    Form {
        text: "spot",
        floats: 4,
        takes: "the command for both mirrors, and the pixel u v at which the camera sees the spot",
        gives: "8 floats: the spot in the world and how far beam and ray are apart there (m); their standard deviations (m) when the \
                pixel has that of -sd",
        results: "X Y Z gap sd_X sd_Y sd_Z sd_gap: m",
        help: "where a spot is; -camera must be set",
    },
    Form {
        text: "line",
        floats: 6,
        takes: "the plane of light nx ny nz d (m), and the pixel u v at which the camera sees a point of the line",
        gives: "6 floats: the point in the world and its standard deviations (m) when the pixel has that of -sd",
        results: "X Y Z sd_X sd_Y sd_Z: m",
        help: "where a point of a line of light is; -camera must be set",
    },
    Form {
        text: "plane FILE",
        floats: 0,
        takes: "",
        gives: "9 floats: unit normal and distance from the origin (m) of the plane of light, the root mean square of the \
                distances of the points from it (m), and standard deviations of normal and distance (m)",
        results: "nx ny nz; d rms: m; sd_nx sd_ny sd_nz; sd_d: m",
        help: "the plane of light from a table X,Y,Z of points that a line met",
    },
    Form {
        text: "calibrate FILE",
        floats: 0,
        takes: "",
        gives: "22 floats. The scanner: rotation vector (rad) and translation (m) of world_T_scanner, offset of the mirrors (m), both \
                gains (rad), both zeros (rad). The root mean square of the distances of the points from their beams (m). Standard \
                deviations: of a turn about the world's axes (rad), of translation and offset (m), of both gains and of the first \
                zero (rad)",
        results: "rx ry rz: rad; x y z offset: m; gain_a gain_b zero_a zero_b: rad; rms: m; sd_turn: rad; sd_shift sd_offset: m; sd_gain_a sd_gain_b sd_zero_a: rad",
        help: "the scanner from a table a,b,X,Y,Z; the options say what is known of it before",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    pose: Vec<f64>,
    offset: f64,
    gain: Vec<f64>,
    zero: Vec<f64>,
    camera: Vec<f64>,
    sd_px: f64,
    name: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            pose: vec![0.0; 6],
            offset: 0.0,
            gain: vec![1.0; 2],
            zero: vec![0.0; 2],
            camera: Vec::new(),
            sd_px: 0.1,
            name: "scanner".to_owned(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("points a laser scanner, finds what it met, and calibrates it")
        .exec(FORMS)
        .floats(
            "pose",
            &["RX", "RY", "RZ", "X", "Y", "Z"],
            -1e6..=1e6,
            "",
            "world_T_scanner: rotation vector (rad) and translation (m); z is forward, y downwards",
            |options: &mut Options| &mut options.pose,
        )
        .float(
            "offset",
            0.0..=1.0,
            "m",
            "way of the light between the mirrors",
            |options| &mut options.offset,
        )
        .floats(
            "gain",
            &["A", "B"],
            -10.0..=10.0,
            "rad",
            "angles of the light for a command of 1: towards x and towards y",
            |options| &mut options.gain,
        )
        .floats(
            "zero",
            &["A", "B"],
            -1.5..=1.5,
            "rad",
            "angles of the light for a command of 0",
            |options| &mut options.zero,
        )
        .floats(
            "camera",
            &resect::CAMERA,
            -1e6..=1e6,
            "",
            "the camera as `resect` answers it: px, and camera_T_world in rad and m",
            |options| &mut options.camera,
        )
        .float(
            "sd",
            1e-6..=1e3,
            "px",
            "standard deviation of each coordinate of a pixel",
            |options| &mut options.sd_px,
        )
        .word(
            "name",
            "SCANNER",
            "the scanner of the app that is ordered",
            |options| &mut options.name,
        )
});

/// An object of class `laser`.
#[derive(Default)]
pub(super) struct Laser {
    options: Options,
    /// The scanner of the app that it holds.
    held: Option<steer::Held>,
}

impl ServiceObject for Laser {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = match TABLE.form(io) {
                Ok(form) => match self.order(form.text, io) {
                    Some(Ok(order)) => self.ordered(cx, order, io).await,
                    Some(Err(report)) => Err(report),
                    None => self.answer(form.text, io),
                },
                Err(report) => Err(report),
            };
            ended(io, outcome)
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

fn wrong(text: String) -> Report {
    Report::error(sorma::report::code::VALUE, text)
}

fn nothing(why: NoLaser) -> Report {
    Report::error(code::NO_CAMERA, why.to_string())
}

/// Why a table gives nothing.
fn none(source: &Source, why: NoLaser) -> Report {
    Report::error(code::NO_CAMERA, format!("{}: {why}", source.name()))
}

/// Tells of rows that are off by much more than the others.
fn tell_far(source: &Source, table: &Table, off: &[f64], io: &mut Transport) {
    let squares: f64 = off.iter().map(|off| off * off).sum();
    let rms = (squares / off.len().max(1) as f64).sqrt().max(LEAST_FAR_M);
    let far = off
        .iter()
        .enumerate()
        .filter(|(_, off)| **off > FAR_RMS * rms);
    let told = far.map(|(row, off)| format!("{} by {off:.4} m", table.place(source, row)));
    let told: Vec<String> = told.take(MOST_TOLD).collect();
    if !told.is_empty() {
        let text = format!(
            "rows are off by more than {FAR_RMS} times the root mean square, and are used: {}; leave them out if they are wrong",
            told.join("; ")
        );
        io.report(Report::warning(code::REJECTED, text));
    }
}

/// What a person should know before leaning on a calibration.
fn doubt(found: &Fitted, start: &Scanner) -> Option<String> {
    let signs = found.scanner.gain.iter().zip(start.gain);
    for (mirror, (now, before)) in ["first", "second"].iter().zip(signs) {
        if now * before < 0.0 {
            return Some(format!(
                "the gain of the {mirror} mirror has another sign than -gain says: is the world mirrored, or the mirror connected the \
                 other way round?"
            ));
        }
    }
    let place = found.sd[3..6].iter().copied().fold(0.0, f64::max);
    (place.max(found.sd[6]) > POOR_M).then(|| {
        format!(
            "the points determine the scanner poorly: its place to {place:.3} m, the way between its mirrors to {:.3} m; take them on two \
             planes or more, far apart",
            found.sd[6]
        )
    })
}

impl Laser {
    fn scanner(&self) -> Result<Scanner, Report> {
        let Options {
            pose: numbers,
            offset,
            gain,
            zero,
            ..
        } = &self.options;
        let scanner = (|| {
            Some(Scanner {
                world_t_scanner: pose(numbers)?,
                offset: *offset,
                gain: gain.as_slice().try_into().ok()?,
                zero: zero.as_slice().try_into().ok()?,
            })
        })();
        let scanner = scanner.filter(|scanner| !scanner.gain.contains(&0.0));
        scanner.ok_or_else(|| wrong("a mirror with a -gain of 0 does not move".to_owned()))
    }

    /// What a request orders the scanner to do, if it is an order.
    fn order(&self, form: &str, io: &Transport) -> Option<Result<LaserOrder, Report>> {
        match (form, io.floats.as_slice()) {
            ("off", _) => Some(Ok(LaserOrder::Off)),
            ("draw", &[a, b, to_a, to_b]) => Some(Ok(LaserOrder::Line([a, b], [to_a, to_b]))),
            ("point", &[x, y, z]) => {
                let command = self.scanner().map(|own| own.aim(&Point3::new(x, y, z)));
                let command = command.and_then(|aim| aim.ok_or_else(|| nothing(NoLaser::Beyond)));
                Some(command.map(LaserOrder::Spot))
            }
            _ => None,
        }
    }

    /// Numbers that follow from a pixel, and then their standard deviations.
    fn with_sd<const N: usize>(
        &self,
        pixel: Vector2<f64>,
        of: impl Fn(Vector2<f64>) -> Result<[f64; N], NoLaser>,
    ) -> Result<Vec<f64>, Report> {
        const STEP: f64 = 1e-3;
        let numbers = of(pixel).map_err(nothing)?;
        let mut squares = [0.0; N];
        for step in [Vector2::new(STEP, 0.0), Vector2::new(0.0, STEP)] {
            let beside = of(pixel + step).map_err(nothing)?;
            for ((square, there), here) in squares.iter_mut().zip(beside).zip(numbers) {
                *square += (self.options.sd_px * (there - here) / STEP).powi(2);
            }
        }
        let sd = squares.iter().map(|square| square.sqrt());
        Ok(numbers.iter().copied().chain(sd).collect())
    }

    fn beam(&self, command: [f64; 2]) -> Result<Beam, Report> {
        let scanner = self.scanner()?;
        scanner.angles(command).map_err(nothing)?;
        Ok(scanner.beam(command))
    }

    fn camera(&self) -> Result<Camera, Report> {
        resect::camera(&self.options.camera, "-camera")
    }

    fn answer(&self, form: &str, io: &mut Transport) -> Outcome {
        io.floats = match (form, io.floats.as_slice()) {
            ("aim", &[x, y, z]) => {
                let command = self.scanner()?.aim(&Point3::new(x, y, z));
                let command = command.ok_or_else(|| nothing(NoLaser::Beyond))?;
                command.to_vec()
            }
            ("beam", &[a, b]) => {
                let beam = self.beam([a, b])?;
                let numbers = beam.origin.iter().chain(beam.direction.iter());
                numbers.copied().collect()
            }
            ("spot", &[a, b, u, v]) => {
                let beam = self.beam([a, b])?;
                let camera = self.camera()?;
                let met = self.with_sd(Vector2::new(u, v), |pixel| {
                    let Met { place, gap } = on_beam(&camera, pixel, &beam)?;
                    Ok([place.x, place.y, place.z, gap])
                })?;
                if let [_, _, _, gap, .., sd] = *met
                    && gap > APART * sd
                {
                    let text = format!(
                        "ray and beam miss each other by {gap:.2e} m, {:.0} standard deviations: the spot is not one of this beam",
                        gap / sd
                    );
                    io.report(Report::warning(code::NO_POINT, text));
                }
                met
            }
            ("line", &[nx, ny, nz, distance, u, v]) => {
                let normal = Unit::try_new(Vector3::new(nx, ny, nz), 1e-9);
                let normal = normal.ok_or_else(|| wrong("a plane has a normal".to_owned()))?;
                let light = Plane { normal, distance };
                let camera = self.camera()?;
                self.with_sd(Vector2::new(u, v), |pixel| {
                    Ok(on_plane(&camera, pixel, &light)?.place.coords.into())
                })?
            }
            ("plane FILE", _) => {
                let source = opened(path(io, "plane"))?;
                let table = table::read(&source, &POINTS).map_err(told)?;
                table.tell_repeated(&source, io);
                let points: Vec<Point3<f64>> = table.rows().filter_map(point).collect();
                let FittedPlane { plane, rms_m, sd } =
                    plane_through(&points).map_err(|why| none(&source, why))?;
                let off = points
                    .iter()
                    .map(|point| (plane.normal.dot(&point.coords) - plane.distance).abs());
                tell_far(&source, &table, &off.collect::<Vec<_>>(), io);
                let normal = plane.normal.iter().copied();
                normal.chain([plane.distance, rms_m]).chain(sd).collect()
            }
            _ => {
                let source = opened(path(io, "calibrate"))?;
                let table = table::read(&source, &SAMPLES).map_err(told)?;
                let rows = table.rows().filter_map(|row| match row {
                    [a, b, rest @ ..] => Some(([*a, *b], point(rest)?)),
                    _ => None,
                });
                let met: Vec<_> = rows.collect();
                let start = self.scanner()?;
                table.tell_repeated(&source, io);
                for (row, (command, _)) in met.iter().enumerate() {
                    start.angles(*command).map_err(|why| {
                        let place = table.place(&source, row);
                        Report::error(code::TABLE, format!("{place}: {why}"))
                    })?;
                }
                let found = calibrate(&met, &start).map_err(|why| none(&source, why))?;
                tell_far(&source, &table, &beside(&found.scanner, &met), io);
                if let Some(text) = doubt(&found, &start) {
                    let text = format!("{}: {text}", source.name());
                    io.report(Report::warning(code::NO_CAMERA, text));
                }
                let Scanner {
                    world_t_scanner,
                    offset,
                    gain,
                    zero,
                } = found.scanner;
                let turn = world_t_scanner.rotation.scaled_axis();
                let shift = world_t_scanner.translation.vector;
                let numbers = turn.iter().chain(shift.iter()).copied();
                let numbers = numbers.chain([offset]).chain(gain).chain(zero);
                numbers.chain([found.rms_m]).chain(found.sd).collect()
            }
        };
        Ok(())
    }
}

/// The file of a request that begins with a word.
fn path<'t>(io: &'t Transport, word: &str) -> &'t str {
    let text = io.text.trim();
    text.strip_prefix(word).unwrap_or(text).trim()
}

fn point(row: &[f64]) -> Option<Point3<f64>> {
    match row {
        [x, y, z] => Some(Point3::new(*x, *y, *z)),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
