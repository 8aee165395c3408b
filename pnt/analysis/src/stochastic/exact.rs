//! The exact steady state of a model whose times are all exponential.

use super::{
    chain::{NoConvergence, final_classes, steady_state},
    error::{NotExact, PerfError},
    markings::{self, Markings},
    model::{Busy, Model, Origin},
    report::Solved,
};

/// Mean values in steady state, per place and per transition of the model.
#[derive(Debug, Clone)]
pub(super) struct Exact {
    pub(super) solved: Solved,
    pub(super) tokens: Vec<f64>,
    pub(super) marked: Vec<f64>,
    pub(super) throughput: Vec<f64>,
    busy: Vec<f64>,
}

impl Exact {
    /// Mean number of firings of one of the nets' transitions that go on.
    pub(super) fn busy_of(&self, origin: &Origin) -> f64 {
        match origin.busy {
            None => 0.0,
            Some(Busy::Tokens(place)) => self.tokens[place],
            Some(Busy::Servers) => origin.parts.iter().map(|(_, t)| self.busy[*t]).sum(),
        }
    }
}

pub(super) fn solve(model: &Model, most: usize) -> Result<Exact, NotExact> {
    let found = markings::explore(model, most)?;
    let classes = final_classes(&found.rows);
    let words =
        |state: usize| model.words(found.store.get(u32::try_from(state).unwrap_or(u32::MAX)));
    let class = match classes.as_slice() {
        [class] => class,
        [first, second, ..] => {
            return Err(NotExact::Parts {
                classes: classes.len(),
                first: words(first[0]),
                second: words(second[0]),
            });
        }
        [] => return Err(PerfError::NothingTimed.into()),
    };
    if let [state] = class.as_slice()
        && found.rows[*state].is_empty()
    {
        let marking = words(*state);
        return Err(PerfError::Stops { marking }.into());
    }
    let not = |NoConvergence { sweeps, change }| NotExact::NoConvergence { sweeps, change };
    let (parts, sweeps) = steady_state(&found.rows, class).map_err(not)?;
    Ok(means(model, &found, class, &parts, sweeps))
}

fn means(model: &Model, found: &Markings, class: &[usize], parts: &[f64], sweeps: usize) -> Exact {
    let mut exact = Exact {
        solved: Solved {
            markings: found.store.len(),
            recurrent: class.len(),
            sweeps,
        },
        tokens: vec![0.0; model.net.places().len()],
        marked: vec![0.0; model.net.places().len()],
        throughput: vec![0.0; found.rules.len()],
        busy: vec![0.0; found.rules.len()],
    };
    for state in class {
        let part = parts[*state];
        let marking = found.store.get(u32::try_from(*state).unwrap_or(u32::MAX));
        for (place, tokens) in marking.iter().enumerate() {
            exact.tokens[place] += part * f64::from(*tokens);
            if *tokens > 0 {
                exact.marked[place] += part;
            }
        }
        for (index, rule) in found
            .rules
            .iter()
            .enumerate()
            .filter(|(_, rule)| rule.is_timed())
        {
            exact.throughput[index] += part * rule.rate(marking);
            exact.busy[index] += part * rule.busy(marking);
        }
        for (index, rate) in &found.fired[*state] {
            exact.throughput[*index as usize] += part * rate;
        }
    }
    exact
}
