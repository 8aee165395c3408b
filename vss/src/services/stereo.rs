//! The class `stereo`: two cameras that saw the same lights, from a table of points and pixels.

use std::sync::LazyLock;

use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    code, ended, opened, resect,
    table::{self, Columns},
    told,
};
use crate::{
    calibrate::{Calibration, LightPoint, calibrate_as},
    stereo::{base, pair},
};

const COLUMNS: Columns = Columns {
    names: &["X", "Y", "Z", "uL", "vL", "uR", "vR"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `X,Y,Z,uL,vL,uR,vR`: world coordinates in m, pixels of the left and of the right camera",
};

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "49 floats: fx fy cx cy (px) k1 k2 p1 p2 k3 of the left camera, the same of the right one, rotation vector (rad) \
            and translation (m) of right_T_left, 24 standard deviations of these, and the rms over the used points of \
            both of the distance between seen and predicted (px)",
    results: "",
    help: "calibrates two cameras from one table X,Y,Z,uL,vL,uR,vR (m and px)",
}];

pub(super) static TABLE: LazyLock<OptionTable<resect::Options>> = LazyLock::new(|| {
    resect::options(OptionTable::new("calibrates two cameras that saw the same points").exec(FORMS))
});

/// An object of class `stereo`.
#[derive(Default)]
pub(super) struct Stereo(resect::Options);

impl ServiceObject for Stereo {
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

impl Stereo {
    fn calibrate(&self, io: &mut Transport) -> Outcome {
        let (width, height) = self.0.size()?;
        let source = opened(io.text.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        table.tell_repeated(&source, io);
        let (mut found, mut middle) = (Vec::new(), Point3::origin());
        for (side, at) in [("left", 3), ("right", 5)] {
            let light = |row: &[f64]| match *row {
                [x, y, z, ..] => Some(LightPoint {
                    x,
                    y,
                    z,
                    u: *row.get(at)?,
                    v: *row.get(at + 1)?,
                }),
                _ => None,
            };
            let points: Vec<LightPoint> = table.rows().filter_map(light).collect();
            let sum: Vector3<f64> = points.iter().map(|point| point.position().coords).sum();
            middle = Point3::from(sum / points.len().max(1) as f64);
            let mut rng = ChaCha8Rng::seed_from_u64(self.0.seed());
            let (model, beforehand) = (self.0.model(), self.0.beforehand());
            let one = calibrate_as(&points, width, height, model, beforehand, &mut rng);
            let one = one.map_err(|error| {
                let why = resect::refused(&source, &table, &error);
                Report::error(code::NO_CAMERA, format!("the {side} camera: {why}"))
            })?;
            for warning in resect::warnings(&source, &table, &one) {
                io.report(Report::warning(
                    warning.code,
                    format!("the {side} camera: {}", warning.text),
                ));
            }
            found.push(one);
        }
        let [left, right] = found.as_slice() else {
            return Ok(());
        };
        let apart = base(left, right, &middle);
        if apart.is_one_place() {
            let text = format!(
                "both cameras saw the points from one place: they stand {:.4} m apart, known to {:.4} m, and their rays enclose {:.1e} rad: no depth follows from such a pair",
                apart.length_m, apart.sd_m, apart.angle
            );
            io.report(Report::warning(code::NO_CAMERA, text));
        }
        let both = pair(left, right);
        io.floats.clear();
        for one in [left, right] {
            io.floats.extend(resect::lens(one));
        }
        let turn = both.right_t_left.rotation.scaled_axis();
        let shift = both.right_t_left.translation.vector;
        io.floats.extend(turn.iter().chain(shift.iter()));
        let sd = |one: &Calibration| one.uncertainty.parameter_sd;
        for one in [left, right] {
            io.floats.extend(sd(one).iter().skip(6));
        }
        io.floats.extend(both.sd);
        io.floats.push(both.rms_px);
        Ok(())
    }
}
