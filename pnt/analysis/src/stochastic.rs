//! Performance of nets that say how long their transitions take (generalized stochastic Petri nets;
//! architecture report, section 6, reference 4): mean tokens, throughput and utilisation in steady
//! state. Two ways that share no arithmetic:
//!
//! - exactly, when every time is exponential and the markings are few enough: markings that take no
//!   time are eliminated, and the embedded Markov chain of the others is solved;
//! - by simulation with the executor's own token game and race, with confidence intervals; for any
//!   times.
//!
//! What is taken for granted, since a net does not say it: actions always succeed, and last what the
//! transition's `time` says; enabling functions let pass, so that of a function and its negation the
//! weights decide; and a new command is put on the tape as soon as the one before is answered, each with
//! the same probability. Knows no clock and no task.

mod chain;
mod exact;
mod levels;
mod markings;
mod model;
mod simulate;
mod student;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use serde::Serialize;
use thiserror::Error;

pub use markings::MOST_MARKINGS;
use model::{Busy, Model};
use pnt_language::net::{Net, Servers};
pub use simulate::Interval;

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

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PerfError {
    /// Nothing takes any time.
    #[error(
        "nothing in the net takes time: give transitions a line such as `time exponential 2 s`"
    )]
    NothingTimed,
    /// Transitions fire for ever without any time between them.
    #[error("transitions fire in a circle that takes no time, from {marking}")]
    Timeless {
        /// A marking of the circle, in words.
        marking: String,
    },
    /// Nothing can fire any more, so that there is no steady state but that.
    #[error("the net stops: nothing can fire at {marking}, so it has no steady state to speak of")]
    Stops {
        /// The marking, in words.
        marking: String,
    },
    /// A place got more tokens than can be counted.
    #[error("a place overflows: {0}")]
    Overflow(String),
    /// An option makes no sense.
    #[error("{0}")]
    Option(String),
    /// A net has what the model cannot say.
    #[error(
        "transition `{transition}` empties the place `{place}`, in which actions are kept room: that can be analysed for places of small capacity, when the transition takes no time, or an exponential one with one server"
    )]
    ResetOfPromised {
        /// The transition with the reset arc.
        transition: String,
        /// The place.
        place: String,
    },
}

/// Why there is no exact solution, while simulation may give an answer.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum NotExact {
    /// A time is not exponential.
    #[error("the time of transition `{0}` is not exponential")]
    NotExponential(String),
    /// There are too many markings, perhaps without end.
    #[error("there are more than {0} markings")]
    TooMany(usize),
    /// What the net does in the long run depends on chance early on.
    #[error(
        "the net ends in one of {classes} separate sets of markings, such as {first} and {second}"
    )]
    Parts {
        /// How many sets.
        classes: usize,
        /// A marking of the first.
        first: String,
        /// A marking of the second.
        second: String,
    },
    /// The iteration did not come to an end.
    #[error("the solution did not converge in {sweeps} sweeps (change {change:e})")]
    NoConvergence {
        /// Sweeps done.
        sweeps: usize,
        /// Relative change of the last one.
        change: f64,
    },
    /// It cannot be answered at all.
    #[error(transparent)]
    Never(#[from] PerfError),
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
    /// Whether the exact value lies in the interval, up to rounding; nothing without an exact value.
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
    /// Cycles and sweeps of the iteration; none when it was solved by elimination.
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

/// The performance of nets that work together.
///
/// # Errors
/// There is no steady state, or the options make no sense.
pub fn analyse(nets: &[Arc<Net>], options: &Options) -> Result<Report, PerfError> {
    check(options)?;
    let model = Model::new(nets)?;
    let exact = match exact::solve(&model, options.markings.min(MOST_MARKINGS)) {
        Err(NotExact::Never(error)) => return Err(error),
        other => other,
    };
    let run = simulate::simulate(&model, options)?;
    let solution = exact.as_ref().ok();
    let figure = |exact: Option<f64>, simulated: Interval| Figure { exact, simulated };
    let places = model.shown_places().map(|(index, name)| PlaceFigures {
        place: name.to_owned(),
        tokens: figure(solution.map(|s| s.tokens[index]), run.tokens[index]),
        marked: figure(solution.map(|s| s.marked[index]), run.marked[index]),
    });
    let transitions = model.transitions.iter().map(|origin| {
        let ends = origin.parts.iter().filter(|(part, _)| part.is_end());
        let throughput_exact = solution.map(|s| ends.clone().map(|(_, t)| s.throughput[*t]).sum());
        let busy = origin.busy.map(|by| {
            let exact = solution.map(|s| s.busy_of(origin));
            let simulated = match by {
                Busy::Servers => run.busy[origin.index],
                Busy::Tokens(place) => run.tokens[place],
            };
            figure(exact, simulated)
        });
        let per_server = |busy: Figure| match origin.servers {
            Servers::Many => None,
            Servers::Limit(limit) => Some(Figure {
                exact: busy.exact.map(|busy| busy / f64::from(limit.get())),
                simulated: busy.simulated.scaled(1.0 / f64::from(limit.get())),
            }),
        };
        TransitionFigures {
            transition: origin.name.clone(),
            throughput_per_s: figure(throughput_exact, run.throughput[origin.index]),
            busy,
            utilisation: busy.and_then(per_server),
        }
    });
    Ok(Report {
        nets: nets.iter().map(|net| net.name().to_owned()).collect(),
        solved: solution.map(|solution| solution.solved),
        not_exact: exact.as_ref().err().map(ToString::to_string),
        simulated: run.simulated,
        places: places.collect(),
        transitions: transitions.collect(),
        notes: model.notes.clone(),
    })
}

fn check(options: &Options) -> Result<(), PerfError> {
    if !(options.confidence > 0.0 && options.confidence < 1.0) {
        return Err(PerfError::Option(format!(
            "a confidence lies between 0 and 1, such as 0.95; this is {}",
            options.confidence
        )));
    }
    if let Some(time_s) = options.time_s
        && !(time_s > 0.0 && time_s <= simulate::MOST_SECONDS)
    {
        return Err(PerfError::Option(format!(
            "a simulated time lies between 0 and {} seconds; this is {time_s}",
            simulate::MOST_SECONDS
        )));
    }
    Ok(())
}
