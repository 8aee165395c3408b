//! The class `planecal`: a camera from views of a plane whose corners are known, from a table.

use std::sync::LazyLock;

use nalgebra::{Point2, Vector2};
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    code, ended, opened, resect,
    table::{self, Columns},
    told,
};
use crate::plane::{Corner, PlaneCalibration, PlaneError, calibrate_plane};

const COLUMNS: Columns = Columns {
    names: &["view", "X", "Y", "u", "v"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `view,X,Y,u,v`: number of the view, place on the plane in m, place in the picture in px",
};

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "19 + 12 n floats: fx fy cx cy (px) k1 k2 p1 p2 k3, their 9 standard deviations, rms of the distance between \
            seen and predicted (px); then for each view rotation vector (rad) and translation (m) of camera_T_plane and \
            their 6 standard deviations; 1 + n ints: n, and the views as the table numbers them, in its order",
    results: "",
    help: "calibrates a camera from views of a plane (Zhang), from a table view,X,Y,u,v (m and px)",
}];

/// Residuals beyond so many standard deviations are told.
const TOLD_SD: f64 = 5.0;

/// A focal length with this standard deviation or more, relative to it, is told to be poor.
const POOR_FOCAL: f64 = 0.02;

/// Positions on a plane reach no farther, m: they are millimetres then.
const LARGEST_M: f64 = 5.0;

/// Corners are on no smaller board, m: they are kilometres then, or inches of something else.
const SMALLEST_M: f64 = 1e-3;

/// Numbers of views are no larger.
const MOST_VIEW: f64 = 1e9;

pub(super) static TABLE: LazyLock<OptionTable<resect::Options>> = LazyLock::new(|| {
    resect::lens_options(OptionTable::new("calibrates a camera from views of a plane").exec(FORMS))
});

/// An object of class `planecal`.
#[derive(Default)]
pub(super) struct PlaneCal(resect::Options);

impl ServiceObject for PlaneCal {
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

impl PlaneCal {
    fn calibrate(&self, io: &mut Transport) -> Outcome {
        let (width, height) = self.0.size()?;
        let source = opened(io.text.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        let mut numbers: Vec<f64> = Vec::new();
        let mut views: Vec<Vec<Corner>> = Vec::new();
        let mut rows: Vec<Vec<usize>> = Vec::new();
        for (row, values) in table.rows().enumerate() {
            let &[view, x, y, u, v] = values else {
                continue;
            };
            let wrong = |why: String| {
                let place = table.place(&source, row);
                Err(Report::error(code::TABLE, format!("{place}: {why}")))
            };
            if view.fract() != 0.0 || view.abs() > MOST_VIEW {
                return wrong(format!(
                    "the view is {view:?}; views are numbered by whole numbers"
                ));
            }
            if x.abs().max(y.abs()) > LARGEST_M {
                return wrong(format!(
                    "a corner at ({x}, {y}) m: places on the plane are in m; are these millimetres?"
                ));
            }
            let inside = |at: f64, size: usize| at >= -0.5 && at <= size as f64 - 0.5;
            if !inside(u, width) || !inside(v, height) {
                return wrong(format!(
                    "the corner is seen at ({u:?}, {v:?}), outside the picture of {width} x {height} px (-size)"
                ));
            }
            let at = numbers.iter().position(|number| *number == view);
            let at = at.unwrap_or_else(|| {
                numbers.push(view);
                views.push(Vec::new());
                rows.push(Vec::new());
                numbers.len() - 1
            });
            if let (Some(corners), Some(rows)) = (views.get_mut(at), rows.get_mut(at)) {
                corners.push(Corner {
                    on_plane: Point2::new(x, y),
                    pixel: Vector2::new(u, v),
                });
                rows.push(row);
            }
        }
        let extents = [1, 2].map(|column| {
            let all = table.rows().filter_map(|row| row.get(column).copied());
            let (least, most) = all
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), one| {
                    (least.min(one), most.max(one))
                });
            most - least
        });
        let widest = extents[0].max(extents[1]);
        if (0.0..SMALLEST_M).contains(&widest) && widest > 0.0 {
            let text = format!(
                "{}: all corners lie within {widest:.1e} m: places on the plane are in m; are these other units?",
                source.name()
            );
            return Err(Report::error(code::NO_CAMERA, text));
        }
        table.tell_repeated(&source, io);
        let name = |view: usize| numbers.get(view).copied().unwrap_or(f64::NAN);
        let found = calibrate_plane(&views, width, height, self.0.model()).map_err(|error| {
            let why = match error {
                PlaneError::TooFewPoints(view, _)
                | PlaneError::OneLine(view)
                | PlaneError::Mirrored(view) => error
                    .to_string()
                    .replace(&format!("view {view}"), &format!("view {}", name(view))),
                other => other.to_string(),
            };
            Report::error(code::NO_CAMERA, format!("{}: {why}", source.name()))
        })?;
        for (rows, residuals) in rows.iter().zip(&found.residuals) {
            for (row, off) in rows.iter().zip(residuals) {
                if off.amax() > TOLD_SD * found.noise_px.max(1e-3) {
                    let place = table.place(&source, *row);
                    let text = format!(
                        "{place} is off by {:.2} px, more than {TOLD_SD} standard deviations, and is used: look at that corner, and leave \
                         its row out if it is wrong",
                        off.amax()
                    );
                    io.report(Report::warning(code::REJECTED, text));
                }
            }
        }
        let focal = found.sd[0].max(found.sd[1]) / found.intrinsics.fx.min(found.intrinsics.fy);
        if focal > POOR_FOCAL {
            let text = format!(
                "the views determine the camera poorly: its focal length to {:.1} %; tilt the plane by 30 to 45 degrees, about two axes",
                100.0 * focal
            );
            io.report(Report::warning(code::NO_CAMERA, text));
        }
        answer(&found, &numbers, io);
        Ok(())
    }
}

fn answer(found: &PlaneCalibration, numbers: &[f64], io: &mut Transport) {
    let (i, d) = (&found.intrinsics, &found.distortion);
    io.floats.clear();
    io.floats
        .extend([i.fx, i.fy, i.cx, i.cy, d.k1, d.k2, d.p1, d.p2, d.k3]);
    io.floats.extend(found.sd);
    io.floats.push(found.rms_px);
    for view in &found.views {
        let pose = &view.camera_t_plane;
        io.floats.extend(pose.rotation.scaled_axis().iter());
        io.floats.extend(pose.translation.vector.iter());
        io.floats.extend(view.sd);
    }
    io.ints.clear();
    io.ints
        .push(i64::try_from(found.views.len()).unwrap_or(i64::MAX));
    // A saturating cast: numbers of views are small and whole.
    io.ints.extend(numbers.iter().map(|number| *number as i64));
}
