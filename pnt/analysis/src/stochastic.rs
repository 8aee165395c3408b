//! Performance of nets that say how long their transitions take: mean tokens, throughput and
//! utilisation in steady state. (Generalized stochastic Petri nets; architecture report, section 6,
//! reference 4.) Two ways that share no arithmetic:
//!
//! - exactly, when every time is exponential and the markings are few enough. Markings that take no
//!   time are eliminated, and the embedded Markov chain of the others is solved;
//! - by simulation with the executor's own token game and race, with confidence intervals; for any
//!   times.
//!
//! Assumptions, since a net does not say it: actions always succeed, and last what the transition's
//! `time` says. Enabling functions allow their transitions, so the weights decide between a function and
//! its negation. A new command is put on the tape as soon as the one before is answered, each with the
//! same probability. Knows no clock and no task.

mod chain;
mod error;
mod exact;
mod levels;
mod markings;
mod model;
mod report;
mod simulate;
mod student;

#[cfg(test)]
mod tests;

use std::sync::Arc;

pub use error::{NotExact, PerfError};
use model::{Busy, Model};
use pnt_language::net::{Net, Servers};
pub use report::{
    Figure, Interval, MOST_MARKINGS, Options, PlaceFigures, Report, Simulated, Solved,
    TransitionFigures,
};

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
