//! The class `laser`: where a scanner's beam goes, where it must be sent, what a camera's ray meets of it, and its calibration.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use nalgebra::{Point3, Unit, Vector2, Vector3};
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{
    code, ended, opened,
    resect::{self, pose},
    table::{self, Columns},
    told,
};
use crate::{
    camera::Camera,
    command::OrderLaser,
    laser::{
        LaserOrder, Met, NoLaser, Plane, Scanner, calibrate, on_beam, on_plane, plane_through,
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
        gives: "5 floats: unit normal and distance from the origin (m) of the plane of light, and the root mean square of the \
                distances of the points from it (m)",
        results: "nx ny nz; d rms: m",
        help: "the plane of light from a table X,Y,Z of points that a line met",
    },
    Form {
        text: "calibrate FILE",
        floats: 0,
        takes: "",
        gives: "22 floats: rotation vector (rad) and translation (m) of world_T_scanner, offset of the mirrors (m), both gains (rad), \
                both zeros (rad), and the root mean square of the distances of the points from their beams (m); standard deviations \
                of a turn about the world's axes (rad), of translation and offset (m), of both gains and of the first zero (rad)",
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
    task: String,
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
            task: "world".to_owned(),
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
        .word("task", "TASK", "the app's task that drives it", |options| {
            &mut options.task
        })
});

/// An object of class `laser`.
#[derive(Default)]
pub(super) struct Laser(Options);

impl ServiceObject for Laser {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = match TABLE.form(io) {
                Ok(form) => match self.order(form.text, io) {
                    Some(order) => self.ordered(cx, order, io).await,
                    None => self.answer(form.text, io),
                },
                Err(report) => Err(report),
            };
            ended(io, outcome)
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.0)
    }
}

fn wrong(text: String) -> Report {
    Report::error(sorma::report::code::VALUE, text)
}

fn nothing(why: NoLaser) -> Report {
    Report::error(code::NO_CAMERA, why.to_string())
}

impl Laser {
    fn scanner(&self) -> Result<Scanner, Report> {
        let Options {
            pose: numbers,
            offset,
            gain,
            zero,
            ..
        } = &self.0;
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
                let command = command.and_then(|aim| aim.ok_or_else(|| nothing(NoLaser::Nowhere)));
                Some(command.map(LaserOrder::Spot))
            }
            _ => None,
        }
    }

    async fn ordered(
        &self,
        cx: &Waiting<'_>,
        order: Result<LaserOrder, Report>,
        io: &mut Transport,
    ) -> Outcome {
        const DEADLINE: Duration = Duration::from_secs(10);
        let order = order?;
        let Options { name, task, .. } = &self.0;
        let failed = |why: &str| Report::error(code::NO_LASER, format!("scanner `{name}`: {why}"));
        if !cx.is_in_app() {
            return Err(failed(
                "there is none here, for no app runs here: attach to one",
            ));
        }
        let request = OrderLaser {
            laser: name.clone(),
            order,
        };
        let done = cx.call_task(task, request, DEADLINE).await;
        done.map_err(|report| failed(&report.text))?;
        io.floats = match order {
            LaserOrder::Spot(command) => command.to_vec(),
            _ => Vec::new(),
        };
        Ok(())
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
                *square += (self.0.sd_px * (there - here) / STEP).powi(2);
            }
        }
        let sd = squares.iter().map(|square| square.sqrt());
        Ok(numbers.iter().copied().chain(sd).collect())
    }

    fn camera(&self) -> Result<Camera, Report> {
        resect::camera(&self.0.camera, "-camera")
    }

    fn answer(&self, form: &str, io: &mut Transport) -> Outcome {
        io.floats = match (form, io.floats.as_slice()) {
            ("aim", &[x, y, z]) => {
                let command = self.scanner()?.aim(&Point3::new(x, y, z));
                let command = command.ok_or_else(|| nothing(NoLaser::Nowhere))?;
                command.to_vec()
            }
            ("beam", &[a, b]) => {
                let beam = self.scanner()?.beam([a, b]);
                let numbers = beam.origin.iter().chain(beam.direction.iter());
                numbers.copied().collect()
            }
            ("spot", &[a, b, u, v]) => {
                let beam = self.scanner()?.beam([a, b]);
                let camera = self.camera()?;
                self.with_sd(Vector2::new(u, v), |pixel| {
                    let Met { place, gap } = on_beam(&camera, pixel, &beam)?;
                    Ok([place.x, place.y, place.z, gap])
                })?
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
                let points: Vec<Point3<f64>> = table.rows().filter_map(point).collect();
                let (plane, rms) = plane_through(&points).map_err(nothing)?;
                let normal = plane.normal.iter().copied();
                normal.chain([plane.distance, rms]).collect()
            }
            _ => {
                let source = opened(path(io, "calibrate"))?;
                let table = table::read(&source, &SAMPLES).map_err(told)?;
                let rows = table.rows().filter_map(|row| match row {
                    [a, b, rest @ ..] => Some(([*a, *b], point(rest)?)),
                    _ => None,
                });
                let met: Vec<_> = rows.collect();
                let found = calibrate(&met, &self.scanner()?).map_err(nothing)?;
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
mod tests {
    use std::{fmt::Write as _, fs};

    use futures_util::FutureExt as _;
    use sorma::{Dictionary, Reply, Sorm};

    use super::*;

    fn ask(sorm: &Sorm, line: &str) -> Transport {
        let told = sorm.tell(&sorma::Alone, line, "").now_or_never().unwrap();
        told.parse::<Reply>().unwrap().body
    }

    fn floats(sorm: &Sorm, line: &str) -> Vec<f64> {
        let reply = ask(sorm, line);
        assert!(reply.is_ok(), "{line}: {:?}", reply.reports);
        reply.floats
    }

    #[test]
    fn a_scanner_is_pointed_triangulated_and_calibrated_by_lines_of_text() {
        let sorm = Sorm::new(Dictionary::new());
        super::super::register(&sorm);
        // It stands 2 m above the origin and looks down, as the camera beside it does.
        ask(
            &sorm,
            "laser CTRL -pose 3.141592653589793 0 0 0 0 2 -offset 0.02 -gain 0.1 0.1",
        );
        let command = floats(&sorm, "laser EXEC aim FMSG 3 0.3 -0.2 0");
        let beam = floats(
            &sorm,
            &format!("laser EXEC beam FMSG 2 {} {}", command[0], command[1]),
        );
        let along = -beam[2] / beam[5];
        assert!((beam[0] + along * beam[3] - 0.3).abs() < 1e-9, "{beam:?}");
        assert!((beam[1] + along * beam[4] + 0.2).abs() < 1e-9, "{beam:?}");
        let unset = ask(&sorm, "laser EXEC spot FMSG 4 0 0 250 250");
        assert!(unset.reports[0].text.contains("-camera"), "{unset:?}");
        ask(
            &sorm,
            "laser CTRL -camera 500 500 250 250 0 0 0 0 0 3.141592653589793 0 0 -0.5 0 2",
        );
        // It stands at (0.5, 0, 2): the point is 0.2 m to its left in x, and y is turned.
        let (u, v) = (250.0 + 500.0 * -0.2 / 2.0, 250.0 + 500.0 * 0.2 / 2.0);
        let line = format!(
            "laser EXEC spot FMSG 4 {} {} {u} {v}",
            command[0], command[1]
        );
        let met = floats(&sorm, &line);
        for (met, truth) in met.iter().zip([0.3, -0.2, 0.0, 0.0]) {
            assert!((met - truth).abs() < 1e-9, "{met}");
        }
        // Depth by a base of 0.5 m from 2 m: Z^2 / (f b) of a pixel's standard deviation.
        assert_eq!(met.len(), 8);
        assert!((met[6] / 1.6e-3 - 1.0).abs() < 0.05, "{met:?}");
        assert!(met[7] > 1e-4, "{met:?}");
        let alone = ask(&sorm, "laser EXEC point FMSG 3 0.3 -0.2 0");
        assert!(alone.reports[0].text.contains("attach to one"), "{alone:?}");
        let met = floats(&sorm, &format!("laser EXEC line FMSG 6 0 0 1 0 {u} {v}"));
        assert!(
            (met[0] - 0.3).abs() < 1e-9
                && (met[1] + 0.2).abs() < 1e-9
                && (met[3] - 4e-4).abs() < 1e-6,
            "{met:?}"
        );
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            path.display().to_string()
        };
        let (mut samples, mut points) = (String::from("a,b,X,Y,Z\n"), String::from("X,Y,Z\n"));
        for k in 0..24 {
            let (x, y) = (0.2 * f64::from(k % 4) - 0.3, 0.15 * f64::from(k / 4) - 0.3);
            let z = if k % 2 == 0 { 0.0 } else { 0.4 };
            let at = floats(&sorm, &format!("laser EXEC aim FMSG 3 {x} {y} {z}"));
            let _ = writeln!(samples, "{:?},{:?},{x:?},{y:?},{z:?}", at[0], at[1]);
            let _ = writeln!(points, "{x:?},0.25,{z:?}");
        }
        let plane = floats(
            &sorm,
            &format!("laser EXEC plane {}", write("p.csv", &points)),
        );
        assert!(
            (plane[1].abs() - 1.0).abs() < 1e-9 && (plane[1] * plane[3] - 0.25).abs() < 1e-9,
            "{plane:?}"
        );
        // From a start that is off.
        ask(
            &sorm,
            "laser CTRL -pose 3.1 0.02 0.01 0.02 0 1.95 -offset 0.01 -gain 0.095 0.105",
        );
        let found = floats(
            &sorm,
            &format!("laser EXEC calibrate {}", write("s.csv", &samples)),
        );
        assert_eq!(found.len(), 22);
        assert!(found[11] < 1e-6, "{found:?}");
        let few = ask(
            &sorm,
            &format!(
                "laser EXEC calibrate {}",
                write("f.csv", "a,b,X,Y,Z\n0,0,0,0,0\n")
            ),
        );
        assert!(few.reports[0].text.contains("8 or more"), "{few:?}");
    }
}
