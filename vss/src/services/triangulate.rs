//! The class `triangulate`: points from pairs of pixels of two calibrated cameras.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use nalgebra::Vector2;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{
    MOST_TOLD, code, ended, opened, resect,
    table::{self, Columns},
    told,
};
use crate::{camera::Camera, catalog::VSM, command::FindPair, stereo::triangulate};

/// Pictures are taken when the cameras are free.
const DEADLINE: Duration = Duration::from_secs(60);

/// Standard deviations beyond which rays are not of one point.
const APART: f64 = 3.0;

const COLUMNS: Columns = Columns {
    names: &["uL", "vL", "uR", "vR"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `uL,vL,uR,vR`: pixels of the same point in the left and in the right camera, px",
};

const FORMS: &[Form] = &[
    Form {
        text: "pair",
        floats: 4,
        takes: "the pixels uL vL uR vR of one point",
        gives: "8 floats: the point in the world and its standard deviations (m), the gap between the two rays and the standard \
                deviation that it has when both are of one point (m)",
        results: "X Y Z: m; sd_X sd_Y sd_Z: m; gap sd_gap: m",
        help: "where the point is that both cameras see",
    },
    Form {
        text: "cameras LEFT RIGHT",
        floats: 0,
        takes: "",
        gives: "8 floats as `pair` answers them, for the brightest spot that each sees; 1 int: the middle of the exposure, ns of the \
                app's time",
        results: "X Y Z: m; sd_X sd_Y sd_Z: m; gap sd_gap: m; ints stamp",
        help: "has two cameras of the app, -left and -right, take a picture at once, and tells where the brightest spot is; the gap says \
               whether they saw the same one",
    },
    Form {
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "8 floats for each row from which a point follows, as `pair` answers them; ints: these rows, from 0",
        results: "",
        help: "points from a table uL,vL,uR,vR (px)",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    left: Vec<f64>,
    right: Vec<f64>,
    sd_px: f64,
    service: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            left: Vec::new(),
            right: Vec::new(),
            sd_px: 0.1,
            service: VSM.to_owned(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("finds points that two cameras see")
        .exec(FORMS)
        .floats(
            "left",
            &resect::CAMERA,
            -1e6..=1e6,
            "",
            "the left camera as `resect` answers it: px, and camera_T_world in rad and m",
            |options: &mut Options| &mut options.left,
        )
        .floats(
            "right",
            &resect::CAMERA,
            -1e6..=1e6,
            "",
            "the right camera, likewise",
            |options| &mut options.right,
        )
        .float(
            "sd",
            1e-6..=1e3,
            "px",
            "standard deviation of each coordinate of a pixel",
            |options| &mut options.sd_px,
        )
        .word(
            "service",
            "TASK",
            "the app's task that finds a spot with two cameras at once; the app must list the Service PairFind",
            |options| &mut options.service,
        )
});

/// An object of class `triangulate`.
#[derive(Default)]
pub(super) struct Triangulate(Options);

impl ServiceObject for Triangulate {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = match TABLE.form(io) {
                Ok(form) => match form.text {
                    "pair" => self.pair(io),
                    "cameras LEFT RIGHT" => self.seen(cx, io).await,
                    _ => self.table(io),
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

/// What one row of pixels gives.
struct Met {
    numbers: [f64; 8],
    /// The rays are not of one point.
    doubt: Option<String>,
}

impl Triangulate {
    fn cameras(&self) -> Result<[Camera; 2], Report> {
        let Options { left, right, .. } = &self.0;
        Ok([
            resect::camera(left, "-left")?,
            resect::camera(right, "-right")?,
        ])
    }

    fn met(&self, [left, right]: &[Camera; 2], pixels: &[f64]) -> Result<Met, String> {
        let &[ul, vl, ur, vr] = pixels else {
            return Err("a row has four pixels".to_owned());
        };
        let found = triangulate(left, right, Vector2::new(ul, vl), Vector2::new(ur, vr));
        let found = found.map_err(|why| why.to_string())?;
        let sd = found.sd(left, right, self.0.sd_px);
        let ([sx, sy, sz], gap_sd) =
            sd.ok_or_else(|| "no camera sees the point where the rays meet".to_owned())?;
        let (p, gap) = (found.point, found.gap_m);
        let doubt = (gap > APART * gap_sd).then(|| {
            format!("the rays miss each other by {gap:.2e} m, {:.0} standard deviations: the pixels are not of one point", gap / gap_sd)
        });
        Ok(Met {
            numbers: [p.x, p.y, p.z, sx, sy, sz, gap, gap_sd],
            doubt,
        })
    }

    /// The spot that two cameras of the app see now.
    async fn seen(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let cameras = self.cameras()?;
        let words: Vec<String> = io.text.split_whitespace().map(str::to_owned).collect();
        let wrong = |text: String| Report::error(code::CAMERA, text);
        let [_, left, right] = words.as_slice() else {
            return Err(wrong(
                "two cameras are named: EXEC cameras LEFT RIGHT".to_owned(),
            ));
        };
        if !cx.is_in_app() {
            return Err(wrong(format!(
                "there are no cameras `{left}` and `{right}` here, for no app runs here: attach to one, or give the name of a file"
            )));
        }
        let names = [left.clone(), right.clone()];
        let nothing = |why: &str| {
            wrong(format!(
                "cameras `{left}` and `{right}` see no spot at once: {why}"
            ))
        };
        let request = FindPair { cameras: names };
        let found = cx.call_task(&self.0.service, request, DEADLINE).await;
        let found = found.map_err(|report| nothing(&report.text))?;
        let [one, other] = found.map_err(|error| nothing(&error.reason))?;
        let pixels = [one.u, one.v, other.u, other.v];
        let met = self.met(&cameras, &pixels).map_err(|why| {
            let text = format!("the spots of `{left}` and `{right}`: {why}");
            Report::error(code::NO_POINT, text)
        })?;
        if let Some(doubt) = met.doubt {
            io.report(Report::warning(code::NO_POINT, doubt));
        }
        io.floats = met.numbers.to_vec();
        io.ints = vec![i64::try_from(one.stamp.as_nanos()).unwrap_or(i64::MAX)];
        Ok(())
    }

    fn pair(&self, io: &mut Transport) -> Outcome {
        let met = self.met(&self.cameras()?, &io.floats);
        let met = met.map_err(|why| Report::error(code::NO_POINT, why))?;
        if let Some(doubt) = met.doubt {
            io.report(Report::warning(code::NO_POINT, doubt));
        }
        io.floats = met.numbers.to_vec();
        Ok(())
    }

    fn table(&self, io: &mut Transport) -> Outcome {
        let cameras = self.cameras()?;
        let source = opened(io.text.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        if table.at.is_empty() {
            let text = format!("{}: the table has no rows", source.name());
            return Err(Report::error(code::TABLE, text));
        }
        let (mut floats, mut ints, mut wrong) = (Vec::new(), Vec::new(), Vec::new());
        for (row, pixels) in table.rows().enumerate() {
            let why = match self.met(&cameras, pixels) {
                Ok(met) => {
                    floats.extend(met.numbers);
                    ints.extend(i64::try_from(row));
                    met.doubt
                }
                Err(why) => Some(why),
            };
            wrong.extend(why.map(|why| format!("{}: {why}", table.place(&source, row))));
        }
        let (all, more) = (wrong.len(), wrong.len().saturating_sub(MOST_TOLD));
        wrong.truncate(MOST_TOLD);
        let mut text = wrong.join("; ");
        if more > 0 {
            text.push_str(&format!("; and {more} more"));
        }
        if floats.is_empty() {
            return Err(Report::error(code::NO_POINT, text));
        }
        if all > 0 {
            io.report(Report::warning(code::NO_POINT, text));
        }
        (io.floats, io.ints) = (floats, ints);
        Ok(())
    }
}
