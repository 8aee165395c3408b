//! The class `corners`: the inner corners of a chequer pattern in a picture.

use std::sync::LazyLock;

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{code, ended, picture};
use crate::chequer::find_corners;

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "4 floats of each inner corner, row by row: u, v (px, pixel centres at whole numbers), standard deviations of u \
            and v (px); 2 ints: columns and rows. Rows run so that the order is not mirrored, and the first corner is the one \
            nearest to the upper left that this permits",
    results: "* u v sd_u sd_v: px; ints columns rows",
    help: "finds the inner corners of a chequer pattern in a picture",
}];

#[derive(Debug, Clone, Default)]
pub(super) struct Options {
    inner: Vec<i64>,
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("finds the inner corners of a chequer pattern")
        .exec(FORMS)
        .ints(
            "inner",
            &["COLUMNS", "ROWS"],
            3..=1000,
            "",
            "how many inner corners the pattern has; must be set before EXEC",
            |options: &mut Options| &mut options.inner,
        )
});

/// An object of class `corners`.
#[derive(Default)]
pub(super) struct Corners(Options);

impl ServiceObject for Corners {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|_| self.find(io));
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

impl Corners {
    fn find(&self, io: &mut Transport) -> Outcome {
        let [columns, rows] = self.0.inner.as_slice() else {
            let text = "the size of the pattern is not known: set it with CTRL -inner COLUMNS ROWS";
            return Err(Report::error(sorma::report::code::VALUE, text));
        };
        let path = io.text.trim().to_owned();
        let frame = picture::read(&path, io)?;
        let side = |count: &i64| usize::try_from(*count).unwrap_or_default();
        let found = find_corners(&frame, side(columns), side(rows)).map_err(|why| {
            Report::error(
                code::NO_CORNERS,
                format!("`{path}` shows no such pattern: {why}"),
            )
        })?;
        io.floats.clear();
        for corner in &found {
            let sd = [corner.sd_u, corner.sd_v];
            io.floats.extend([corner.u, corner.v]);
            io.floats.extend(sd);
        }
        io.ints.clear();
        io.ints.extend([*columns, *rows]);
        Ok(())
    }
}
