//! The class `bundle`: several cameras and the lights that they share, from one table, when the robot is uncertain.

use std::sync::LazyLock;

use ctos::diagnostic::Source;
use nalgebra::{Point3, Vector2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    MOST_TOLD, code, ended, opened,
    resect::{self, Options},
    table::{self, Columns, Table},
    told,
};
use crate::{
    bundle::{Bundle, BundleError, Rig, calibrate_together},
    camera::Camera,
};

/// A robot that is off by this factor more or less than was said makes all standard deviations wrong.
const OTHER_ROBOT: f64 = 1.5;

/// Names of the columns after X, Y and Z, as many as there are cameras.
const PIXELS: &[&str] = &[
    "u1", "v1", "u2", "v2", "u3", "v3", "u4", "v4", "u5", "v5", "u6", "v6", "u7", "v7", "u8", "v8",
];

const COLUMNS: Columns = Columns {
    names: &[],
    count: None,
    may_be_empty: PIXELS,
    help: "the first line is `X,Y,Z,u1,v1,u2,v2` and so on, two columns for each of up to 8 cameras: positions as the robot tells \
           them in m, pixels in px; both cells of a light that a camera did not see are empty",
};

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "30 floats of each camera: fx fy cx cy (px) k1 k2 p1 p2 k3, rotation vector (rad) and translation (m) of camera_T_world, \
            and 15 standard deviations of these; then the rms of used pixels (px), the noise of a coordinate (px), and the \
            robot's standard deviation as the lights show it (m); with -lights on 6 of each light more: x y z and their standard \
            deviations (m); 2 ints: cameras, lights",
    results: "",
    help: "calibrates cameras that share lights, X,Y,Z,u1,v1,u2,v2,.. (m and px), together with the places of the lights",
}];

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    let table = OptionTable::new("calibrates several cameras that share lights").exec(FORMS);
    resect::options(table)
        .float(
            "robot-sd",
            1e-7..=1.0,
            "m",
            "standard deviation of each coordinate of a position as the robot tells it",
            |options| &mut options.robot_sd,
        )
        .flag("lights", "the lights are answered, too", |options| {
            &mut options.lights
        })
});

/// An object of class `bundle`.
#[derive(Default)]
pub(super) struct Cameras(Options);

impl ServiceObject for Cameras {
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

type Pixels = Vec<Option<Vector2<f64>>>;

/// Positions, and for each camera where it saw them.
fn lights(source: &Source, table: &Table) -> Result<(Vec<Point3<f64>>, Vec<Pixels>), Report> {
    let wrong = |text: String| Report::error(code::TABLE, text);
    let expected = ["X", "Y", "Z"].iter().chain(PIXELS);
    let named = table.names.iter().zip(expected);
    let right = named.clone().count() == table.names.len()
        && named
            .clone()
            .all(|(name, expected)| name.eq_ignore_ascii_case(expected));
    let count = table.names.len();
    if !right || count < 5 || count.is_multiple_of(2) {
        let given = table.names.join(",");
        let text = format!(
            "{}:1:1: the header is `{given}`; {}",
            source.name(),
            COLUMNS.help
        );
        return Err(wrong(text));
    }
    let mut seen: Vec<Pixels> = vec![Vec::new(); (count - 3) / 2];
    let mut positions = Vec::new();
    for (row, numbers) in table.rows().enumerate() {
        let (at, pixels) = numbers.split_at(3);
        positions.push(Point3::new(at[0], at[1], at[2]));
        for (camera, (seen, pixel)) in seen.iter_mut().zip(pixels.chunks_exact(2)).enumerate() {
            let pixel = Vector2::new(pixel[0], pixel[1]);
            if pixel.x.is_nan() != pixel.y.is_nan() {
                let number = camera + 1;
                let text = format!(
                    "{}: only one of u{number} and v{number} is there",
                    table.place(source, row)
                );
                return Err(wrong(text));
            }
            seen.push((!pixel.x.is_nan()).then_some(pixel));
        }
    }
    Ok((positions, seen))
}

/// Why there are no cameras. The first one's columns are u1 and v1.
fn refused(source: &Source, table: &Table, why: &BundleError) -> String {
    match why {
        BundleError::Camera(index, why) => {
            let why = resect::refused(source, table, why);
            format!("camera {}: {why}", index + 1)
        }
        other => format!("{}: {other}", source.name()),
    }
}

impl Cameras {
    fn calibrate(&self, io: &mut Transport) -> Outcome {
        let options = &self.0;
        let size = options.size()?;
        let source = opened(io.text.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        let (positions, seen) = lights(&source, &table)?;
        table.tell_repeated(&source, io);
        let rig = Rig {
            lights: &positions,
            seen: &seen,
            size,
            model: options.model(),
            beforehand: options.beforehand(),
            robot_sd_m: options.robot_sd,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed());
        let found = calibrate_together(&rig, &mut rng)
            .map_err(|why| Report::error(code::NO_CAMERA, refused(&source, &table, &why)))?;
        self.warn(&source, &table, &found, io);
        io.floats.clear();
        for one in &found.cameras {
            io.floats.extend(numbers(&one.camera));
            let uncertainty = &one.uncertainty;
            io.floats.extend(uncertainty.parameter_sd.iter().skip(6));
            io.floats.extend(uncertainty.camera_t_world_sd());
        }
        io.floats
            .extend([found.rms_px, found.noise_px, found.robot_sd_m]);
        if options.lights {
            for (at, sd) in &found.lights {
                io.floats.extend(at.iter().chain(sd));
            }
        }
        let counts = [found.cameras.len(), found.lights.len()];
        io.ints = counts
            .map(|count| i64::try_from(count).unwrap_or(i64::MAX))
            .to_vec();
        Ok(())
    }

    fn warn(&self, source: &Source, table: &Table, found: &Bundle, io: &mut Transport) {
        for (index, one) in found.cameras.iter().enumerate() {
            if !one.rejected.is_empty() {
                let rows = one.rejected.iter().map(|row| table.place(source, *row));
                let rows: Vec<String> = rows.take(MOST_TOLD).collect();
                let (camera, count) = (index + 1, one.rejected.len());
                let rest = if count > rows.len() {
                    ", and others"
                } else {
                    ""
                };
                let rows = rows.join(", ");
                let text = format!("camera {camera}: {count} points are not used: {rows}{rest}");
                io.report(Report::warning(code::REJECTED, text));
            }
        }
        let ratio = found.robot_sd_m / self.0.robot_sd;
        if !(1.0 / OTHER_ROBOT..OTHER_ROBOT).contains(&ratio) {
            let text = format!(
                "the lights say that the robot's standard deviation is {:.2e} m, not -robot-sd {:.2e} m: set it so, or the \
                 standard deviations answered are wrong",
                found.robot_sd_m, self.0.robot_sd
            );
            io.report(Report::warning(code::NO_CAMERA, text));
        }
    }
}

/// fx fy cx cy k1 k2 p1 p2 k3, rotation vector and translation of camera_T_world.
fn numbers(camera: &Camera) -> impl Iterator<Item = f64> {
    let pose = camera.camera_from_world();
    let (turn, shift) = (pose.rotation.scaled_axis(), pose.translation.vector);
    let (i, d) = (camera.intrinsics, camera.distortion);
    let lens = [i.fx, i.fy, i.cx, i.cy, d.k1, d.k2, d.p1, d.p2, d.k3];
    let pose = [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z];
    lens.into_iter().chain(pose)
}
