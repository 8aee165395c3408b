//! What a check of nets says: one JSON object, or a few lines.

use std::{collections::BTreeMap, fmt::Write as _, sync::Arc};

use pnt::{
    analysis::{
        explicit::Stopped,
        model::Model,
        question::{self, Because},
        verdict::Engine,
    },
    check::{Answered, Asks, Counterexample, Options, Proof},
    net::Net,
};
use serde::Serialize;

use cli_common::show;

use super::structure::Structure;

/// The answer about one system of nets. `None` is written as `null`: a limit came first.
#[derive(Debug, Serialize)]
pub(super) struct Answer {
    nets: Vec<String>,
    sound: Option<bool>,
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
    deadlock_free: Option<bool>,
    live: Option<bool>,
    reversible: Option<bool>,
    home_states: Option<u128>,
    dead_transitions: Vec<String>,
    complete: bool,
    /// What ended the search before.
    #[serde(skip_serializing_if = "Option::is_none")]
    stopped: Option<&'static str>,
    unbounded_places: Vec<String>,
    engine: &'static str,
    seconds: f64,
    peak_bytes: usize,
    diagram_steps: u64,
    /// Firing sequences that show why the nets are not sound.
    counterexamples: Vec<Shown>,
    findings: Vec<serde_json::Value>,
    /// Conditions of `when` lines: any of them may say yes or no at any time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    free_choices: Vec<FreeChoice>,
    /// What came on tapes, by net, where that was given.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    tapes: BTreeMap<String, String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    questions: Vec<Asked>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    commands: Vec<CommandAlone>,
    #[serde(skip_serializing_if = "Option::is_none")]
    structure: Option<Structure>,
}

/// A question, its answer, and what the answer rests on.
#[derive(Debug, Serialize)]
struct Asked {
    question: String,
    asks: &'static str,
    answer: Option<bool>,
    /// A firing sequence that shows it, and the marking it ends in.
    sequence: Option<Vec<String>>,
    marking: Option<BTreeMap<String, u32>>,
    /// What proves it: an invariant with its weights, or the number of markings looked at.
    invariant: Option<BTreeMap<String, u64>>,
    exhausted: Option<usize>,
}

/// A firing sequence that shows a finding.
#[derive(Debug, Serialize)]
struct Shown {
    shows: &'static str,
    sequence: Vec<String>,
    /// Firings that can follow for ever, each time with more tokens.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    round: Vec<String>,
    /// The marking after the sequence.
    marking: BTreeMap<String, u32>,
}

impl Shown {
    fn new(counterexample: &Counterexample, model: &Model) -> Self {
        let names = |sequence: &[u32]| {
            let each = sequence
                .iter()
                .filter_map(|n| model.transitions.get(*n as usize));
            each.map(|transition| transition.name.clone()).collect()
        };
        Self {
            shows: counterexample.code,
            sequence: names(&counterexample.sequence),
            round: names(&counterexample.round),
            marking: marked(model, &counterexample.marking),
        }
    }
}

/// The places of a marking that hold tokens.
fn marked(model: &Model, marking: &[u32]) -> BTreeMap<String, u32> {
    let pairs = model.places.iter().zip(marking);
    let held = pairs.filter(|(_, tokens)| **tokens > 0);
    held.map(|(place, tokens)| (place.name.clone(), *tokens))
        .collect()
}

/// A condition that the analysis does not look into.
#[derive(Debug, Serialize)]
struct FreeChoice {
    net: String,
    transition: String,
    /// As it is written, with `not`.
    when: String,
    at: String,
}

impl FreeChoice {
    fn all(nets: &[Arc<Net>]) -> Vec<Self> {
        let conditions = nets.iter().flat_map(|net| {
            let transitions = net.transitions().iter();
            transitions.filter_map(move |transition| {
                let when = transition.when.as_ref()?;
                let not = if when.negated { "not " } else { "" };
                Some(Self {
                    net: net.name().to_owned(),
                    transition: transition.written().to_owned(),
                    when: format!("{not}{}", when.function),
                    at: when.at.to_string(),
                })
            })
        });
        conditions.collect()
    }

    /// A line for all of them.
    fn text(all: &[Self], alone: bool) -> String {
        let each = all.iter().take(MOST_CHOICES).map(|one| match alone {
            true => format!("{}: {}", one.transition, one.when),
            false => format!("{}.{}: {}", one.net, one.transition, one.when),
        });
        let mut each: Vec<String> = each.collect();
        if let more @ 1.. = all.len() - each.len() {
            each.push(format!("{more} more"));
        }
        format!(
            "\n  `when` lines, each taken as a free choice between yes and no: {}",
            each.join("; ")
        )
    }
}

/// So many conditions are listed for people.
const MOST_CHOICES: usize = 12;

/// One command by itself.
#[derive(Debug, Serialize)]
struct CommandAlone {
    net: String,
    command: String,
    sound: Option<bool>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    counterexample: Vec<String>,
}

impl Asked {
    fn new(answered: &Answered, model: &Model) -> Self {
        let place = |number: u32| {
            let place = model.places.get(number as usize);
            place.map(|place| place.name.clone()).unwrap_or_default()
        };
        let mut asked = Self {
            question: answered.question.clone(),
            asks: match answered.asks {
                Asks::Can => "can",
                Asks::Never => "never",
                Asks::Always => "always",
            },
            answer: answered.yes(),
            sequence: None,
            marking: None,
            invariant: None,
            exhausted: None,
        };
        match &answered.answer {
            question::Answer::Unknown => {}
            question::Answer::Proved(Because::Exhausted(markings)) => {
                asked.exhausted = Some(*markings);
            }
            question::Answer::Proved(Because::Invariant(weights)) => {
                let named = weights
                    .iter()
                    .map(|(number, weight)| (place(*number), *weight));
                asked.invariant = Some(named.collect());
            }
            question::Answer::Witness(witness) => {
                let name = |number: &u32| {
                    let transition = model.transitions.get(*number as usize);
                    transition.map(|t| t.name.clone()).unwrap_or_default()
                };
                asked.sequence = Some(witness.sequence.iter().map(name).collect());
                asked.marking = Some(marked(model, &witness.marking));
            }
        }
        asked
    }

    fn text(&self) -> String {
        let marked = |tokens: &BTreeMap<String, u32>| {
            let named = tokens.iter().map(|(place, tokens)| match tokens {
                1 => place.clone(),
                _ => format!("{place}*{tokens}"),
            });
            match tokens.is_empty() {
                true => "empty".to_owned(),
                false => named.collect::<Vec<_>>().join(", "),
            }
        };
        let answer = match self.answer {
            Some(true) => "yes",
            Some(false) => "no",
            None => "not known within the limits",
        };
        let mut text = format!("  {} \"{}\": {answer}", self.asks, self.question);
        if let (Some(sequence), Some(marking)) = (&self.sequence, &self.marking) {
            let after = match sequence.is_empty() {
                true => "from the start".to_owned(),
                false => format!("after {}", sequence.join(", ")),
            };
            let _ = write!(text, ": {after}, the marking is {}", marked(marking));
        }
        if let Some(invariant) = &self.invariant {
            let sum = invariant.iter().map(|(place, weight)| match weight {
                1 => place.clone(),
                _ => format!("{weight}*{place}"),
            });
            let sum = sum.collect::<Vec<_>>().join(" + ");
            let _ = write!(text, ": no firing changes {sum}");
        }
        if let Some(markings) = self.exhausted {
            let _ = write!(text, ": all {markings} markings were looked at");
        }
        text
    }
}

impl Answer {
    pub(super) fn new(
        nets: &[Arc<Net>],
        options: &Options,
        proof: &Proof,
        seconds: f64,
        structure: bool,
    ) -> Self {
        let verdict = &proof.verdict;
        let alone = nets.len() == 1;
        let names = nets.iter().flat_map(|net| {
            let transitions = net.transitions().iter();
            transitions.map(move |transition| match alone {
                true => transition.name.clone(),
                false => format!("{}.{}", net.name(), transition.name),
            })
        });
        let seen = match &proof.cover {
            // What cannot be covered cannot fire.
            Some(cover) => by_label(&proof.model, &cover.seen),
            None => verdict.seen.clone(),
        };
        let known = verdict.complete || proof.cover.is_some();
        let never = names.zip(&seen).filter(|(_, seen)| known && !**seen);
        let place = |number: u32| {
            let place = proof.model.places.get(number as usize)?;
            let short = place.name.split_once('.').filter(|_| alone);
            Some(
                short
                    .map_or(place.name.as_str(), |(_, name)| name)
                    .to_owned(),
            )
        };
        Self {
            nets: nets.iter().map(|net| net.name().to_owned()).collect(),
            sound: proof.sound(),
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
            deadlock_free: verdict.deadlock_free,
            live: verdict.live,
            reversible: verdict.reversible,
            home_states: verdict.home_states,
            dead_transitions: never.map(|(name, _)| name).collect(),
            complete: verdict.complete,
            stopped: verdict.stopped.map(|stopped| match stopped {
                Stopped::Markings => "markings",
                Stopped::Bytes => "memory",
                Stopped::Stop => "time",
                Stopped::Tokens(_) => "tokens",
                Stopped::Growth => "growth",
            }),
            engine: match verdict.engine {
                Engine::Explicit => "explicit",
                Engine::Symbolic => "symbolic",
            },
            seconds,
            peak_bytes: verdict.peak_bytes,
            diagram_steps: verdict.diagram_steps,
            unbounded_places: match &proof.cover {
                Some(cover) => cover.unbounded().filter_map(place).collect(),
                None => proof.grows.into_iter().filter_map(place).collect(),
            },
            counterexamples: proof
                .counterexamples
                .iter()
                .map(|counterexample| Shown::new(counterexample, &proof.model))
                .collect(),
            findings: proof.findings.iter().map(show::finding_json).collect(),
            free_choices: FreeChoice::all(nets),
            tapes: options
                .tapes
                .iter()
                .map(|tape| (tape.net.clone(), tape.text.clone()))
                .collect(),
            questions: proof
                .answers
                .iter()
                .map(|answered| Asked::new(answered, &proof.model))
                .collect(),
            commands: proof
                .workflows
                .iter()
                .map(|workflow| CommandAlone {
                    net: workflow.net.clone(),
                    command: workflow.command.clone(),
                    sound: workflow.sound,
                    counterexample: workflow.counterexample.clone(),
                })
                .collect(),
            structure: structure.then(|| Structure::new(nets, &proof.model)),
        }
    }

    /// One line.
    pub(super) fn json(&self) -> String {
        // Every field has a form in JSON.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// A few lines for a person.
    pub(super) fn text(&self) -> String {
        let judged = match (self.sound, self.stopped) {
            (Some(true), _) => "sound",
            (Some(false), _) => "not sound",
            (None, Some("time")) => "not decided in the time there was",
            (None, _) => "not decided within the limits",
        };
        let all = if self.complete { "" } else { " so far" };
        let known = |answer: Option<bool>, yes: &str, no: &str| {
            answer.map_or_else(
                || format!("{yes}: not known"),
                |a| if a { yes } else { no }.to_owned(),
            )
        };
        let mut text = format!(
            "{}: {judged}\n  {}, {}, {}\n  {}{all}, {}, {} dead\n",
            self.nets.join(", "),
            counted(self.places, "place"),
            counted(self.transitions, "transition"),
            counted(self.arcs, "arc"),
            counted(self.markings, "marking"),
            counted(self.edges, "edge"),
            self.deadlocks,
        );
        let _ = writeln!(
            text,
            "  at most {} in a place, {} in a marking{all}",
            counted(self.max_tokens_in_place, "token"),
            self.max_tokens_in_marking
        );
        let _ = write!(
            text,
            "  {}, {}, {}, {}",
            known(self.bounded, "bounded", "not bounded"),
            known(self.safe, "safe", "not safe"),
            known(self.live, "live", "not live"),
            known(self.reversible, "reversible", "not reversible"),
        );
        if !self.unbounded_places.is_empty() {
            let _ = write!(
                text,
                "\n  without bound: {}",
                self.unbounded_places.join(", ")
            );
        }
        if !self.free_choices.is_empty() {
            text.push_str(&FreeChoice::text(&self.free_choices, self.nets.len() == 1));
        }
        for (net, tape) in &self.tapes {
            let _ = write!(text, "\n  tape of {net}: {tape}");
        }
        for asked in &self.questions {
            let _ = write!(text, "\n{}", asked.text());
        }
        for alone in &self.commands {
            let sound = known(alone.sound, "sound", "not sound");
            let _ = write!(
                text,
                "\n  command {} to {}: {sound}",
                alone.command, alone.net
            );
        }
        if let Some(structure) = &self.structure {
            text.push_str(&structure.text());
        }
        text
    }
}

/// Per transition as its author sees it, whether one of its parts is enabled somewhere.
fn by_label(model: &Model, enabled: &[bool]) -> Vec<bool> {
    let mut seen = vec![false; model.label_count()];
    for (transition, enabled) in model.transitions.iter().zip(enabled) {
        if let (Some(label), true) = (transition.label, enabled) {
            seen[label as usize] = true;
        }
    }
    seen
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

/// So many of a thing.
fn counted(count: impl ToString, thing: &str) -> String {
    let count = count.to_string();
    let many = if count == "1" { "" } else { "s" };
    format!("{count} {thing}{many}")
}
