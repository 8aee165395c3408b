//! A cost at several sizes, and how it grows: its slope in double logarithm.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

/// What something of one size costs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// The time, s.
    pub seconds: f64,
    /// The memory that it takes, bytes; `None` where that is not looked at.
    pub bytes: Option<f64>,
}

/// A cost over sizes, which rise.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// What is measured, in words that end in the size: `boot of tasks`.
    pub what: &'static str,
    /// Whether the cost is that of all of them, so that a slope of 1 is in proportion. Otherwise it is the cost of one step
    /// among them, which should not grow.
    pub whole: bool,
    /// Sizes and costs.
    pub points: Vec<(f64, Cost)>,
    /// Why it went no further, if something failed.
    pub ended: Option<String>,
}

/// The steepest slope that is in proportion, give or take noise.
const MOST_OF_WHOLE: f64 = 1.1;
/// And that of a step that does not grow.
const MOST_OF_STEP: f64 = 0.1;

impl Curve {
    /// The slope of the time over the last decade of sizes; `None` for fewer than two points there.
    #[must_use]
    pub fn slope(&self) -> Option<f64> {
        let points = self.points.iter();
        slope(points.map(|(size, cost)| (*size, cost.seconds)))
    }

    /// The same of the memory.
    #[must_use]
    pub fn slope_of_memory(&self) -> Option<f64> {
        let points = self.points.iter();
        slope(points.filter_map(|(size, cost)| Some((*size, cost.bytes?))))
    }

    /// Whether it grows faster than the work.
    #[must_use]
    pub fn is_steep(&self) -> bool {
        let most = if self.whole {
            MOST_OF_WHOLE
        } else {
            MOST_OF_STEP
        };
        self.slope().is_some_and(|slope| slope > most)
            || self
                .slope_of_memory()
                .is_some_and(|slope| slope > MOST_OF_WHOLE)
    }

    /// A row of the table.
    fn row(&self) -> String {
        let Some((size, last)) = self.points.last() else {
            let why = self.ended.as_deref().unwrap_or("not measured");
            return format!("| {} | | | | | | {why} |", self.what);
        };
        let each = |all: f64| if self.whole { all / size } else { all };
        let slope = |slope: Option<f64>| slope.map_or_else(String::new, |one| format!("{one:.2}"));
        format!(
            "| {} | {size} | {} | {} | {} | {} | {} |",
            self.what,
            time(each(last.seconds)),
            slope(self.slope()),
            last.bytes
                .map_or_else(String::new, |bytes| memory(bytes / size)),
            slope(self.slope_of_memory()),
            self.ended.as_deref().unwrap_or(""),
        )
    }
}

/// The slope of a line through the last decade of points in double logarithm, by least squares.
fn slope(points: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let known = points.filter(|(size, cost)| *size > 0.0 && *cost > 0.0);
    let points: Vec<(f64, f64)> = known.map(|(size, cost)| (size.ln(), cost.ln())).collect();
    let (last, _) = points.last()?;
    let from = last - std::f64::consts::LN_10 - 1e-9;
    let points: Vec<_> = points.iter().filter(|(size, _)| *size >= from).collect();
    let count = points.len() as f64;
    let (x, y) = points
        .iter()
        .fold((0.0, 0.0), |(x, y), one| (x + one.0, y + one.1));
    let (x, y) = (x / count, y / count);
    let along = |one: &&(f64, f64)| (one.0 - x).powi(2);
    let across = |one: &&(f64, f64)| (one.0 - x) * (one.1 - y);
    let width: f64 = points.iter().map(along).sum();
    (points.len() > 1).then(|| points.iter().map(across).sum::<f64>() / width)
}

/// A time in the unit that a person would choose.
pub fn time(seconds: f64) -> String {
    let (number, unit) = match seconds {
        s if s >= 1.0 => (s, "s"),
        s if s >= 1e-3 => (s * 1e3, "ms"),
        s if s >= 1e-6 => (s * 1e6, "µs"),
        s => (s * 1e9, "ns"),
    };
    format!("{} {unit}", short(number))
}

/// The same of memory.
pub fn memory(bytes: f64) -> String {
    let (number, unit) = match bytes {
        b if b >= 1e9 => (b / 1e9, "GB"),
        b if b >= 1e6 => (b / 1e6, "MB"),
        b if b >= 1e3 => (b / 1e3, "kB"),
        b => (b, "B"),
    };
    format!("{} {unit}", short(number))
}

fn short(number: f64) -> String {
    match number {
        n if n >= 100.0 => format!("{n:.0}"),
        n if n >= 10.0 => format!("{n:.1}"),
        n => format!("{n:.2}"),
    }
}

/// All curves as a table of a page.
#[must_use]
pub fn table(curves: &[Curve]) -> String {
    let mut text = String::from(
        "| what | largest | time each | slope | memory each | slope | |\n|---|---|---|---|---|---|---|\n",
    );
    for curve in curves {
        // Writing to a string never fails.
        let _ = writeln!(text, "{}", curve.row());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(whole: bool, cost: impl Fn(f64) -> f64) -> Curve {
        let point = |size: f64| {
            let bytes = Some(100.0 * size);
            (
                size,
                Cost {
                    seconds: cost(size),
                    bytes,
                },
            )
        };
        Curve {
            what: "work",
            whole,
            points: [1.0, 10.0, 100.0, 300.0, 1000.0].map(point).to_vec(),
            ended: None,
        }
    }

    #[test]
    fn what_grows_with_a_power_of_the_size_has_that_power_as_its_slope() {
        for power in [0.0, 1.0, 1.5, 2.0] {
            let slope = curve(true, |size| 3e-6 * size.powf(power)).slope().unwrap();
            assert!((slope - power).abs() < 1e-9, "{slope} {power}");
        }
        // What a beginning costs does not hide how it grows in the end.
        let slope = curve(true, |size| 1e-3 + 1e-6 * size * size)
            .slope()
            .unwrap();
        assert!(slope > 1.8, "{slope}");
        assert_eq!(
            curve(true, |size| size)
                .slope_of_memory()
                .map(|one| (one * 1e6).round()),
            Some(1e6)
        );
    }

    #[test]
    fn one_step_may_not_grow_and_the_whole_may_in_proportion() {
        assert!(!curve(true, |size| size).is_steep());
        assert!(curve(false, |size| size).is_steep());
        assert!(curve(true, |size| size.powf(1.2)).is_steep());
        assert!(!curve(false, |_| 1e-6).is_steep());
    }

    #[test]
    fn a_curve_without_points_says_why_and_one_has_no_slope() {
        let mut none = curve(true, |size| size);
        none.points.truncate(1);
        assert_eq!(none.slope(), None);
        none.points.clear();
        none.ended = Some("no disk".to_owned());
        assert!(table(&[none]).contains("no disk"));
    }
}
