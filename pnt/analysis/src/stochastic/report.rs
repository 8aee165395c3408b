//! What is asked about the performance of nets, and what is answered.

use serde::Serialize;

/// Tangible markings that the exact solution may have at most. A marking of twenty places takes about
/// 300 bytes with its edges.
pub const MOST_MARKINGS: usize = 1_000_000;

/// What to compute.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Simulated seconds; without it, as many as a million firings of timed transitions take.
    pub time_s: Option<f64>,
    /// Probability that an interval holds the true value, above 0 and below 1.
    pub confidence: f64,
    /// Of all chance.
    pub seed: u64,
    /// Markings that the exact solution may have, [`MOST_MARKINGS`] at most.
    pub markings: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            time_s: None,
            confidence: 0.95,
            seed: 1,
            markings: MOST_MARKINGS,
        }
    }
}

/// A mean and how far the true value may be from it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The mean over all batches.
    pub mean: f64,
    /// Half the width of the confidence interval.
    pub half_width: f64,
}

impl Interval {
    /// That of a multiple.
    #[must_use]
    pub fn scaled(self, by: f64) -> Self {
        Self {
            mean: self.mean * by,
            half_width: self.half_width * by,
        }
    }
}

/// A value from both ways.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figure {
    /// The exact value, if there is an exact solution.
    pub exact: Option<f64>,
    /// From simulation.
    pub simulated: Interval,
}

impl Figure {
    /// Whether the exact value lies in the interval, up to rounding; `None` without an exact value.
    #[must_use]
    pub fn agrees(&self) -> Option<bool> {
        let exact = self.exact?;
        let rounding = 1e-9 * exact.abs().max(1e-9);
        Some((exact - self.simulated.mean).abs() <= self.simulated.half_width + rounding)
    }
}

/// Of one place.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlaceFigures {
    /// Its name, with the net's when there are several.
    pub place: String,
    /// Mean number of tokens.
    pub tokens: Figure,
    /// Part of the time that it is marked.
    pub marked: Figure,
}

/// Of one transition.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TransitionFigures {
    /// Its name, with the net's when there are several.
    pub transition: String,
    /// Firings per second, counted at their ends.
    pub throughput_per_s: Figure,
    /// Mean number of firings that go on; for those that take time.
    pub busy: Option<Figure>,
    /// The same per server; for those with a limited number of servers.
    pub utilisation: Option<Figure>,
}

/// How the exact values were found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Solved {
    /// Markings in which time passes.
    pub markings: usize,
    /// Those that the net returns to for ever.
    pub recurrent: usize,
    /// Cycles and sweeps of the iteration; 0 when it was solved by elimination.
    pub sweeps: usize,
}

/// How long was simulated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Simulated {
    /// Simulated seconds, after those that were left out to forget the beginning.
    pub time_s: f64,
    /// Firings of timed transitions in it.
    pub firings: u64,
    /// Equal parts of the time whose means give the intervals.
    pub batches: usize,
    /// Probability that an interval holds the true value.
    pub confidence: f64,
    /// Of all chance.
    pub seed: u64,
}

/// The answer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Names of the nets.
    pub nets: Vec<String>,
    /// How the exact values were found.
    pub solved: Option<Solved>,
    /// Why there are none.
    pub not_exact: Option<String>,
    /// How long was simulated.
    pub simulated: Simulated,
    /// Places in declared order.
    pub places: Vec<PlaceFigures>,
    /// Transitions in declared order.
    pub transitions: Vec<TransitionFigures>,
    /// What was taken for granted of these nets.
    pub notes: Vec<String>,
}

impl Report {
    /// How many figures have both values, and in how many of them the exact one lies in the interval.
    #[must_use]
    pub fn agreement(&self) -> (usize, usize) {
        let places = self
            .places
            .iter()
            .flat_map(|p| [Some(p.tokens), Some(p.marked)]);
        let transitions = self
            .transitions
            .iter()
            .flat_map(|t| [Some(t.throughput_per_s), t.busy]);
        let agree: Vec<bool> = places
            .chain(transitions)
            .flatten()
            .filter_map(|figure| figure.agrees())
            .collect();
        (agree.len(), agree.iter().filter(|agrees| **agrees).count())
    }
}
