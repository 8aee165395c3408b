//! The class `laser`: where a scanner's beam goes, where it must be sent, what a camera's ray meets of it, and its calibration.

use std::sync::LazyLock;

use nalgebra::{Point3, Unit, Vector2, Vector3};
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    code, ended, opened,
    resect::{self, pose},
    table::{self, Columns},
    told,
};
use crate::{
    camera::Camera,
    laser::{Met, NoLaser, Plane, Scanner, calibrate, on_beam, on_plane, plane_through},
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
        gives: "4 floats: the spot in the world and how far beam and ray are apart there, m",
        results: "X Y Z gap: m",
        help: "where a spot is; -camera must be set",
    },
    Form {
        text: "line",
        floats: 6,
        takes: "the plane of light nx ny nz d (m), and the pixel u v at which the camera sees a point of the line",
        gives: "3 floats: the point in the world, m",
        results: "X Y Z: m",
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
        gives: "12 floats: rotation vector (rad) and translation (m) of world_T_scanner, offset of the mirrors (m), both gains (rad), \
                both zeros (rad), and the root mean square of the distances of the points from their beams (m)",
        results: "rx ry rz: rad; x y z offset: m; gain_a gain_b zero_a zero_b: rad; rms: m",
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
}

impl Default for Options {
    fn default() -> Self {
        Self {
            pose: vec![0.0; 6],
            offset: 0.0,
            gain: vec![1.0; 2],
            zero: vec![0.0; 2],
            camera: Vec::new(),
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
});

/// An object of class `laser`.
#[derive(Default)]
pub(super) struct Laser(Options);

impl ServiceObject for Laser {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| self.answer(form.text, io));
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
                let met = on_beam(&self.camera()?, Vector2::new(u, v), &beam);
                let Met { place, gap } = met.map_err(nothing)?;
                vec![place.x, place.y, place.z, gap]
            }
            ("line", &[nx, ny, nz, distance, u, v]) => {
                let normal = Unit::try_new(Vector3::new(nx, ny, nz), 1e-9);
                let normal = normal.ok_or_else(|| wrong("a plane has a normal".to_owned()))?;
                let light = Plane { normal, distance };
                let met = on_plane(&self.camera()?, Vector2::new(u, v), &light);
                met.map_err(nothing)?.place.iter().copied().collect()
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
                numbers.chain([found.rms_m]).collect()
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
        let met = floats(&sorm, &format!("laser EXEC line FMSG 6 0 0 1 0 {u} {v}"));
        assert!(
            (met[0] - 0.3).abs() < 1e-9 && (met[1] + 0.2).abs() < 1e-9,
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
        assert_eq!(found.len(), 12);
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
