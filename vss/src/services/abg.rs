//! The class `abg`: the alpha-beta-gamma filter, its gains and a run over a table.

use std::sync::LazyLock;

use ctos::diagnostic::Source;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    code, ended, opened,
    table::{self, Columns, Table},
    told,
};
use crate::tracking::{Gains, Track};

const COLUMNS: Columns = Columns {
    names: &["t", "z"],
    count: None,
    may_be_empty: &["z"],
    help: "the first line is `t,z`: times in s, ascending, and positions in m; an empty z has no measurement",
};

/// Rows that are apart by so many periods, or by so small a part of one, are told.
const OTHER_PERIOD: f64 = 100.0;

const FORMS: &[Form] = &[
    Form {
        text: "gains",
        floats: 0,
        takes: "",
        gives: "3 floats: alpha, beta, gamma, with a correction of gamma r/T^2 to the acceleration",
        results: "alpha beta gamma",
        help: "the gains of the steady state for the manoeuvring index",
    },
    Form {
        text: "filter FILE",
        floats: 0,
        takes: "",
        gives: "4 floats a row: position (m), velocity (m/s) and acceleration (m/s^2) after it, and the position predicted \
                before it (m)",
        results: "* x v a predicted",
        help: "filters a table t,z; the first row sets the position, at rest; each row has the gains of its own interval",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    lambda: f64,
    period: f64,
    sigma_w: f64,
    sigma_v: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            lambda: 0.0,
            period: 1.0,
            sigma_w: 0.0,
            sigma_v: 0.0,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("follows a position by an alpha-beta-gamma filter")
        .exec(FORMS)
        .float(
            "lambda",
            0.0..=1e9,
            "",
            "manoeuvring index sigma_w T^2 / sigma_v at -period; 0: from -sigma-w and -sigma-v",
            |options: &mut Options| &mut options.lambda,
        )
        .float(
            "period",
            1e-9..=1e9,
            "s",
            "the interval T that -lambda is about",
            |options| &mut options.period,
        )
        .float(
            "sigma-w",
            0.0..=1e12,
            "m/s^2",
            "standard deviation of the change of the acceleration in a period",
            |options| &mut options.sigma_w,
        )
        .float(
            "sigma-v",
            0.0..=1e12,
            "m",
            "standard deviation of a measurement",
            |options| &mut options.sigma_v,
        )
});

/// An object of class `abg`.
#[derive(Default)]
pub(super) struct Filter(Options);

impl ServiceObject for Filter {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| match form.text {
            "gains" => self.gains(io),
            _ => self.filter(io),
        });
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let given =
            |io: &Transport, name: &str| io.text.split_whitespace().any(|word| word == name);
        let by_index = given(io, "-lambda");
        let by_noise = given(io, "-sigma-w") || given(io, "-sigma-v");
        let before = self.0.clone();
        TABLE.ctrl(&mut self.0, io);
        if by_noise && by_index {
            self.0 = before;
            let text = "-lambda and -sigma-w, -sigma-v say the same thing: give one or the other";
            return Err(Report::error(sorma::report::code::VALUE, text));
        }
        if by_noise {
            self.0.lambda = 0.0;
        }
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.0)
    }
}

impl Filter {
    /// The manoeuvring index at the period.
    fn index(&self) -> f64 {
        let options = &self.0;
        if options.lambda > 0.0 {
            options.lambda
        } else {
            options.sigma_w * options.period * options.period / options.sigma_v
        }
    }

    /// The gains for an interval, s; none where the index of that is no number above 0.
    fn gains_for(&self, dt: f64) -> Option<Gains> {
        let share = dt / self.0.period;
        Gains::of(self.index() * share * share)
    }

    /// The gains for the period.
    fn own_gains(&self) -> Result<Gains, Report> {
        self.gains_for(self.0.period).ok_or_else(|| {
            let text = "there is no manoeuvring index: set CTRL -lambda L -period T, or -sigma-w, -sigma-v and -period, above 0";
            Report::error(sorma::report::code::VALUE, text)
        })
    }

    fn gains(&self, io: &mut Transport) -> Outcome {
        let gains = self.own_gains()?;
        io.floats = vec![gains.alpha, gains.beta, gains.gamma];
        Ok(())
    }

    fn filter(&self, io: &mut Transport) -> Outcome {
        let path = io.text.trim().strip_prefix("filter").unwrap_or_default();
        let source = opened(path.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        self.own_gains()?;
        if table.at.is_empty() {
            let text = format!("{}: the table has no rows", source.name());
            return Err(Report::error(code::TABLE, text));
        }
        let mut answer = Vec::with_capacity(4 * table.at.len());
        let mut state: Option<(f64, Track)> = None;
        for (row, numbers) in table.rows().enumerate() {
            let &[t, z] = numbers else {
                continue;
            };
            let (track, predicted) = match state {
                None if z.is_nan() => {
                    let text =
                        "the first row has no z, and so the filter no position to begin with";
                    return Err(wrong(&source, &table, row, text));
                }
                None => (Track::at_rest(z), z),
                Some((before, track)) => {
                    let dt = t - before;
                    if dt <= 0.0 {
                        let text = format!("t is {t:?} s, not after the row before ({before:?} s)");
                        return Err(wrong(&source, &table, row, &text));
                    }
                    let predicted = track.predicted(dt);
                    let after = if z.is_nan() {
                        predicted
                    } else {
                        let gains = self.gains_for(dt).ok_or_else(|| {
                            let text =
                                format!("no filter follows over the {dt:?} s since the row before");
                            wrong(&source, &table, row, &text)
                        })?;
                        predicted.corrected(z, gains, dt)
                    };
                    if ![after.x, after.v, after.a]
                        .iter()
                        .all(|number| number.is_finite())
                    {
                        let text =
                            format!("the {dt:?} s since the row before lead to no finite position");
                        return Err(wrong(&source, &table, row, &text));
                    }
                    (after, predicted.x)
                }
            };
            answer.extend([track.x, track.v, track.a, predicted]);
            state = Some((t, track));
        }
        if let Some(text) = other_unit(&table, self.0.period) {
            let text = format!("{}: {text}", source.name());
            io.report(Report::warning(code::TABLE, text));
        }
        io.floats = answer;
        Ok(())
    }
}

/// Rows that are much farther apart than the period, or much nearer, are most often in another unit.
fn other_unit(table: &Table, period: f64) -> Option<String> {
    let first = table.rows().next()?.first()?;
    let last = table.rows().last()?.first()?;
    let between = (last - first) / (table.at.len() - 1) as f64;
    let ratio = between / period;
    (ratio.is_finite() && !(1.0 / OTHER_PERIOD..OTHER_PERIOD).contains(&ratio)).then(|| {
        format!(
            "rows are {between:.3e} s apart, and -period is {period:?} s: are times in s, and is this the period of -lambda or -sigma-w?"
        )
    })
}

fn wrong(source: &Source, table: &Table, row: usize, text: &str) -> Report {
    let place = table.place(source, row);
    Report::error(code::TABLE, format!("{place}: {text}"))
}
