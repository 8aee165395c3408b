//! The class `clockfit`: the difference of two clocks from a table of exchanges, by the estimator that the runtime uses.

use std::sync::LazyLock;

use ctos::{diagnostic::Source, time::Instant};
use sorma::{
    Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport,
    clock::{ClockDifference, ClockError, Exchange, MOST_DRIFT, USUAL_DRIFT},
};

use super::{
    code, ended, opened,
    table::{self, Columns, Table},
    told,
};

const COLUMNS: Columns = Columns {
    names: &["t1", "t2", "t3", "t4"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `t1,t2,t3,t4`, s: the client sends, the server receives, the server sends, the client receives",
};

/// Times are counted from here, so that none is negative, ns.
const BEGIN_NS: f64 = 1e9;

/// No table lasts longer, s: what fits into whole nanoseconds.
const LONGEST_S: f64 = 1e9;

/// A fastest exchange that took longer is told, s.
const SLOW_S: f64 = 1.0;

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "3 floats: the server's clock minus the client's at the last t4 (s), how fast it grows (s/s), and the most by \
            which the first can be wrong (s)",
    results: "difference: s; drift: s/s; bound: s",
    help: "the difference of two clocks from exchanges t1,t2,t3,t4",
}];

#[derive(Debug, Clone)]
pub(super) struct Options {
    max_drift: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_drift: USUAL_DRIFT,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("fits the difference of two clocks")
        .exec(FORMS)
        .float(
            "max-drift",
            0.0..=MOST_DRIFT,
            "s/s",
            "the clocks drift no faster from one another; the bound leans on it",
            |options: &mut Options| &mut options.max_drift,
        )
});

/// An object of class `clockfit`.
#[derive(Default)]
pub(super) struct ClockFit(Options);

impl ServiceObject for ClockFit {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|_| self.fit(io));
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

impl ClockFit {
    fn fit(&self, io: &mut Transport) -> Outcome {
        let source = opened(io.text.trim())?;
        let table = table::read(&source, &COLUMNS).map_err(told)?;
        let exchanges = Exchanges::of(&source, &table)?;
        let ways = table
            .rows()
            .filter_map(|row| Some(row.get(3)? - row.first()?));
        let fastest = ways.fold(f64::INFINITY, f64::min);
        if fastest.is_finite() && fastest > SLOW_S {
            let text = format!(
                "{}: the fastest request and reply took {fastest:.3} s: times are in s; are these milliseconds or microseconds?",
                source.name()
            );
            io.report(Report::warning(code::CLOCKS, text));
        }
        let mut found = exchanges.observed(&source, &table, self.0.max_drift)?;
        if found.restarts() > 0 {
            let text = format!(
                "{}: exchanges contradict a drift of at most {:?} s/s; fitted with {MOST_DRIFT:?} s/s",
                source.name(),
                self.0.max_drift
            );
            io.report(Report::warning(code::CLOCKS, text));
            found = exchanges.observed(&source, &table, MOST_DRIFT)?;
        }
        if found.restarts() > 0 {
            let text = format!(
                "{}: a clock was set {} times between the exchanges; what was before the last time is left out",
                source.name(),
                found.restarts()
            );
            io.report(Report::warning(code::CLOCKS, text));
        }
        let Some(difference) = found.at(exchanges.end) else {
            let text = format!("{}: there is no exchange", source.name());
            return Err(Report::error(code::TABLE, text));
        };
        let seconds = |ns: f64| ns * 1e-9;
        io.floats = vec![
            exchanges.offset + seconds(difference.offset_ns as f64),
            found.drift(),
            seconds(difference.error_ns as f64) + exchanges.rounding,
        ];
        Ok(())
    }
}

/// The rows as exchanges, in the order of their t4, each clock counted from its first time: large numbers leave no digits
/// for nanoseconds.
struct Exchanges {
    all: Vec<(usize, Exchange)>,
    /// The last t4, by the clock here.
    end: Instant,
    /// First t2 minus first t1, s.
    offset: f64,
    /// The steps of times as large as those of the table, s.
    rounding: f64,
}

impl Exchanges {
    fn of(source: &Source, table: &Table) -> Result<Self, Report> {
        let (mut first, mut rounding) = (None, 0.0_f64);
        let mut all = Vec::with_capacity(table.at.len());
        for (row, numbers) in table.rows().enumerate() {
            let &[t1, t2, t3, t4] = numbers else {
                continue;
            };
            // What the other clock counts beyond that is more than drift and rounding of the table.
            let (way, stay) = (t4 - t1, t3 - t2);
            let largest = numbers.iter().fold(0.0_f64, |most, t| most.max(t.abs()));
            rounding = rounding.max(f64::EPSILON * largest);
            let allowed = MOST_DRIFT * stay + 4.0 * rounding + 1e-8;
            if stay - way > allowed && way >= 0.0 {
                let text = format!(
                    "{}: the server had the request for longer ({stay:?} s from t2 to t3) than request and reply took ({way:?} s from t1 to t4)",
                    table.place(source, row)
                );
                return Err(Report::error(code::TABLE, text));
            }
            let (here, there) = *first.get_or_insert((t1, t2));
            let times = [t1 - here, t2 - there, t3 - there, t4 - here];
            if times.iter().any(|time| time.abs() > LONGEST_S) {
                let text = format!(
                    "{}: it is more than {LONGEST_S:?} s off the first row",
                    table.place(source, row)
                );
                return Err(Report::error(code::TABLE, text));
            }
            all.push((row, times));
        }
        let earliest = all.iter().flat_map(|(_, times)| times).copied();
        let earliest = earliest.fold(0.0, f64::min);
        let moment = |s: f64| Instant::from_nanos(((s - earliest) * 1e9 + BEGIN_NS).round() as u64);
        let mut all: Vec<(usize, Exchange)> = all
            .into_iter()
            .map(|(row, [t1, t2, t3, t4])| {
                let exchange = Exchange {
                    t1: moment(t1),
                    t2: moment(t2),
                    t3: moment(t3),
                    t4: moment(t4),
                };
                (row, exchange)
            })
            .collect();
        all.sort_by_key(|(_, exchange)| exchange.t4);
        let (here, there) = first.unwrap_or_default();
        Ok(Self {
            end: all.last().map_or(Instant::START, |(_, last)| last.t4),
            all,
            offset: there - here,
            rounding,
        })
    }

    fn observed(
        &self,
        source: &Source,
        table: &Table,
        max_drift: f64,
    ) -> Result<ClockDifference, Report> {
        let refused = |text: String| Report::error(code::TABLE, text);
        let made = ClockDifference::new(max_drift);
        let mut found = made.map_err(|error| refused(error.to_string()))?;
        for (row, exchange) in &self.all {
            found.observe(*exchange).map_err(|error| {
                let why = match error {
                    ClockError::Backwards(_) => {
                        "the times run backwards: t4 is before t1, or t3 before t2".to_owned()
                    }
                    other => other.to_string(),
                };
                refused(format!("{}: {why}", table.place(source, *row)))
            })?;
        }
        Ok(found)
    }
}
