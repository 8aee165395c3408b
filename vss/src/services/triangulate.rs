//! The class `triangulate`: points from pairs of pixels of two calibrated cameras.

use std::sync::LazyLock;

use nalgebra::Vector2;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    MOST_TOLD, code, ended, opened, resect,
    table::{self, Columns},
    told,
};
use crate::{camera::Camera, stereo::triangulate};

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
}

impl Default for Options {
    fn default() -> Self {
        Self {
            left: Vec::new(),
            right: Vec::new(),
            sd_px: 0.1,
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
});

/// An object of class `triangulate`.
#[derive(Default)]
pub(super) struct Triangulate(Options);

impl ServiceObject for Triangulate {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| match form.text {
            "pair" => self.pair(io),
            _ => self.table(io),
        });
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
