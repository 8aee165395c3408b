//! What a check of nets says: one JSON object, or a few lines.

use std::{fmt::Write as _, sync::Arc};

use pnt::{
    analysis::verdict::{Engine, Verdict},
    net::Net,
};
use serde::Serialize;

/// The answer about one system of nets. `None` is written as `null`: a limit came first.
#[derive(Debug, Serialize)]
pub(super) struct Answer {
    nets: Vec<String>,
    pub(super) sound: bool,
    places: usize,
    transitions: usize,
    arcs: usize,
    markings: u128,
    edges: u128,
    max_tokens_in_place: u32,
    max_tokens_in_marking: u64,
    bounded: Option<bool>,
    safe: Option<bool>,
    deadlocks: u128,
    live: Option<bool>,
    reversible: Option<bool>,
    home_states: Option<u128>,
    dead_transitions: Vec<String>,
    complete: bool,
    engine: &'static str,
    seconds: f64,
    peak_bytes: usize,
}

impl Answer {
    pub(super) fn new(nets: &[Arc<Net>], verdict: &Verdict, seconds: f64, sound: bool) -> Self {
        let alone = nets.len() == 1;
        let names = nets.iter().flat_map(|net| {
            let transitions = net.transitions().iter();
            transitions.map(move |transition| match alone {
                true => transition.name.clone(),
                false => format!("{}.{}", net.name(), transition.name),
            })
        });
        let never = names
            .zip(&verdict.seen)
            .filter(|(_, seen)| verdict.complete && !**seen);
        Self {
            nets: nets.iter().map(|net| net.name().to_owned()).collect(),
            sound,
            places: nets.iter().map(|net| net.places().len()).sum(),
            transitions: nets.iter().map(|net| net.transitions().len()).sum(),
            arcs: nets.iter().map(|net| arcs(net)).sum(),
            markings: verdict.markings,
            edges: verdict.edges,
            max_tokens_in_place: verdict.bounds.iter().copied().max().unwrap_or(0),
            max_tokens_in_marking: verdict.most_tokens,
            bounded: verdict.bounded,
            safe: verdict.safe,
            deadlocks: verdict.deadlocks,
            live: verdict.live,
            reversible: verdict.reversible,
            home_states: verdict.home_states,
            dead_transitions: never.map(|(name, _)| name).collect(),
            complete: verdict.complete,
            engine: match verdict.engine {
                Engine::Explicit => "explicit",
                Engine::Symbolic => "symbolic",
            },
            seconds,
            peak_bytes: verdict.peak_bytes,
        }
    }

    /// One line.
    pub(super) fn json(&self) -> String {
        // Every field has a form in JSON.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// A few lines for a person.
    pub(super) fn text(&self) -> String {
        let judged = match (self.complete || self.bounded.is_some(), self.sound) {
            (false, _) => "not decided within the limits",
            (true, true) => "sound",
            (true, false) => "not sound",
        };
        let all = if self.complete { "" } else { " so far" };
        let known = |answer: Option<bool>, yes: &str, no: &str| {
            answer.map_or_else(
                || format!("{yes}: not known"),
                |a| if a { yes } else { no }.to_owned(),
            )
        };
        let mut text = format!(
            "{}: {judged}\n  {} places, {} transitions, {} arcs\n  {} markings{all}, {} edges, {} dead\n",
            self.nets.join(", "),
            self.places,
            self.transitions,
            self.arcs,
            self.markings,
            self.edges,
            self.deadlocks,
        );
        let _ = writeln!(
            text,
            "  at most {} tokens in a place, {} in a marking{all}",
            self.max_tokens_in_place, self.max_tokens_in_marking
        );
        let _ = write!(
            text,
            "  {}, {}, {}, {}",
            known(self.bounded, "bounded", "not bounded"),
            known(self.safe, "safe", "not safe"),
            known(self.live, "live", "not live"),
            known(self.reversible, "reversible", "not reversible"),
        );
        text
    }
}

/// Arcs of a net, to places of other nets too. Parallel ones have become one with their weights added
/// when the net was read.
fn arcs(net: &Net) -> usize {
    let of = |outputs: &pnt::net::Outputs| outputs.local.len() + outputs.remote.len();
    net.transitions()
        .iter()
        .map(|t| {
            t.inputs.len()
                + t.reads.len()
                + t.inhibitors.len()
                + t.resets.len()
                + of(&t.outputs)
                + t.fail.as_ref().map_or(0, of)
        })
        .sum()
}
