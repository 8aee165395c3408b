//! The class `traj`: how long joints take under limits of speed, acceleration and jerk.

use std::sync::LazyLock;

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{code, ended};
use crate::model::MAX_JOINTS;
use crate::trajectory::Passage;
use crate::trajectory::passage::MOST_WAY_POINTS;
use crate::trajectory::timing::{self, JointBounds, JointState, Motion, TimingError};

const FORMS: &[Form] = &[
    Form {
        text: "rest",
        floats: Form::ANY,
        takes: "n, then n each of: q0, q1, rad or m; vmax, amax, jmax, per s, s^2, s^3; a jmax of 0 means trapezoid",
        gives: "1 + n floats, s: in which all arrive together, then the least time of each joint",
        results: "",
        help: "from rest to rest",
    },
    Form {
        text: "state",
        floats: Form::ANY,
        takes: "n, then n each of: q0, v0, a0, q1, v1, a1, vmax, amax, jmax",
        gives: "1 + n floats, s: in which all arrive together, then the least time of each joint",
        results: "",
        help: "from any state to any other; with a jmax of 0 the accelerations do not matter",
    },
    Form {
        text: "stop",
        floats: Form::ANY,
        takes: "n, then n each of: v0, a0, amax, jmax",
        gives: "2 n floats: the time of each joint, s, then how far each goes with its sign, rad or m",
        results: "",
        help: "to rest, each joint by itself",
    },
    Form {
        text: "path",
        floats: Form::ANY,
        takes: "with IMSG 1 m, the number of way points: m + 2 points, n numbers each, then n each of: vmax, amax, jmax",
        gives: "1 float: the time from the first point to the last, s",
        results: "",
        help: "from rest through m way points to rest, all joints together at each of them, without a stop where that is quicker",
    },
];

#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Options {}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("how long joints take under limits of speed, acceleration and jerk")
        .exec(FORMS)
});

/// An object of class `traj`.
#[derive(Default)]
pub(super) struct Traj(Options);

impl ServiceObject for Traj {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        // No other form takes whole numbers.
        let ints = match io.text.trim() {
            "path" => std::mem::take(&mut io.ints),
            _ => Vec::new(),
        };
        let outcome = TABLE.form(io).map(|form| form.text);
        let outcome = outcome.and_then(|what| {
            io.floats = match what {
                "path" => path(&ints, &io.floats)?,
                _ => answer(what, &io.floats)?,
            };
            Ok(())
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

/// The numbers of a request, by rows of n.
struct Rows<'f> {
    n: usize,
    numbers: &'f [f64],
}

impl<'f> Rows<'f> {
    /// Takes so many rows, or says how many numbers would have been right.
    fn new(what: &str, floats: &'f [f64], rows: usize) -> Result<Self, Report> {
        let wrong = |text: String| Report::error(sorma::report::code::VALUE, text);
        let Some((count, numbers)) = floats.split_first() else {
            return Err(wrong(format!(
                "EXEC {what} takes the number of joints first"
            )));
        };
        let n = *count as usize;
        if n as f64 != *count || !(1..=MAX_JOINTS).contains(&n) {
            return Err(wrong(format!(
                "EXEC {what}: the number of joints is 1 to {MAX_JOINTS}, not {count}"
            )));
        }
        if numbers.len() != rows * n {
            return Err(wrong(format!(
                "EXEC {what} of {n} joints takes {} floats, not {}",
                1 + rows * n,
                floats.len()
            )));
        }
        Ok(Self { n, numbers })
    }

    /// A number of a joint; all are there.
    fn at(&self, row: usize, joint: usize) -> f64 {
        let at = self.numbers.get(row * self.n + joint);
        at.copied().unwrap_or(f64::NAN)
    }

    fn joints<T>(&self, of: impl Fn(&dyn Fn(usize) -> f64) -> T) -> Vec<T> {
        (0..self.n)
            .map(|joint| of(&|row| self.at(row, joint)))
            .collect()
    }
}

fn untimed(what: &str, error: &TimingError) -> Report {
    Report::error(code::MOTION, format!("EXEC {what}: {error}"))
}

/// The time through way points, whose number stands apart.
fn path(ints: &[i64], floats: &[f64]) -> Result<Vec<f64>, Report> {
    let wrong =
        |text: String| Report::error(sorma::report::code::VALUE, format!("EXEC path {text}"));
    let [given] = ints else {
        let count = ints.len();
        return Err(wrong(format!(
            "takes the number of way points: write IMSG 1 and it, not IMSG {count}"
        )));
    };
    let way_points = usize::try_from(*given).ok();
    let Some(way_points) = way_points.filter(|count| *count <= MOST_WAY_POINTS) else {
        return Err(wrong(format!(
            "goes through 0 to {MOST_WAY_POINTS} way points, not {given}"
        )));
    };
    // m + 2 points and three rows of limits.
    let rows = way_points + 5;
    let joints = floats.len() / rows;
    if joints * rows != floats.len() || !(1..=MAX_JOINTS).contains(&joints) {
        return Err(wrong(format!(
            "with {way_points} way points takes {rows} floats for each of 1 to {MAX_JOINTS} joints, not {} in all",
            floats.len()
        )));
    }
    let (points, limits) = floats.split_at((way_points + 2) * joints);
    let rows = Rows {
        n: joints,
        numbers: limits,
    };
    let bounds = rows.joints(|at| JointBounds {
        velocity: at(0),
        acceleration: at(1),
        jerk: at(2),
    });
    let passage = Passage::through(points, &bounds).map_err(|error| untimed("path", &error))?;
    finite(vec![passage.duration()])
}

fn answer(what: &str, floats: &[f64]) -> Result<Vec<f64>, Report> {
    let untimed = |error: TimingError| untimed(what, &error);
    let state = |position, velocity, acceleration| JointState {
        position,
        velocity,
        acceleration,
    };
    let bounds = |velocity, acceleration, jerk| JointBounds {
        velocity,
        acceleration,
        jerk,
    };
    if what == "stop" {
        let rows = Rows::new(what, floats, 4)?;
        let joints = rows.joints(|at| {
            let limits = bounds(f64::INFINITY, at(2), at(3));
            (state(0.0, at(0), at(1)), limits)
        });
        let found = timing::stops(&joints).map_err(untimed)?;
        let (times, ways): (Vec<f64>, Vec<f64>) = found.into_iter().unzip();
        return finite([times, ways].concat());
    }
    let motions: Vec<Motion> = if what == "rest" {
        let rows = Rows::new(what, floats, 5)?;
        rows.joints(|at| {
            let ends = [at(0), at(1)].map(|position| state(position, 0.0, 0.0));
            (ends[0], ends[1], bounds(at(2), at(3), at(4)))
        })
    } else {
        let rows = Rows::new(what, floats, 9)?;
        rows.joints(|at| {
            let ends = [0, 3].map(|row| state(at(row), at(row + 1), at(row + 2)));
            (ends[0], ends[1], bounds(at(6), at(7), at(8)))
        })
    };
    let times = timing::between(&motions).map_err(untimed)?;
    finite([vec![times.together], times.least].concat())
}

fn finite(numbers: Vec<f64>) -> Result<Vec<f64>, Report> {
    if numbers.iter().all(|number| number.is_finite()) {
        return Ok(numbers);
    }
    let text = "the numbers are too large to compute with";
    Err(Report::error(code::TOO_LARGE, text))
}
