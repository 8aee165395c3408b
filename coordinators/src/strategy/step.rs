//! A step in work of which several ways are known: which of them are open, which one was chosen, and how those that were tried
//! ended. Pure data; knows no net and no task.

use ctos::time::Instant;
use rand::Rng;
use serde::{Deserialize, Serialize};

use super::belief::{Belief, Candidate, Choice, Figures};
use crate::outcome::{Failure, Outcome};

/// A way of a step.
pub trait Way: Copy + PartialEq {
    /// Its name in log, answers and belief.
    fn name(self) -> String;
}

/// One way that was tried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tried {
    /// Its name.
    pub way: String,
    /// How long it took, s.
    pub seconds: f64,
    /// What came of it: words about the way, or why it led nowhere.
    pub ended: Result<String, Failure>,
}

impl Tried {
    /// The same in words, after the step that it is about.
    #[must_use]
    pub fn line(&self, context: &str) -> String {
        let Self {
            way,
            seconds,
            ended,
        } = self;
        match ended {
            Ok(about) => format!("{context}: {way}, {about}{seconds:.1} s"),
            Err(failure) => format!(
                "{context}: {way} failed after {seconds:.1} s: {}",
                failure.reason
            ),
        }
    }
}

/// A step in work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step<W> {
    /// The command that it belongs to.
    pub command: u32,
    /// What is believed of its ways is believed for this.
    pub context: String,
    /// Ways that were not tried yet.
    pub open: Vec<W>,
    /// The way that was chosen last, until it has ended.
    pub chosen: Option<W>,
    /// When it began.
    pub began: Option<Instant>,
    /// The others, in order.
    pub tried: Vec<Tried>,
    /// What ended the chosen one before its end, until that is judged.
    pub ended: Option<Failure>,
}

impl<W> Default for Step<W> {
    fn default() -> Self {
        Self {
            command: 0,
            context: String::new(),
            open: Vec::new(),
            chosen: None,
            began: None,
            tried: Vec::new(),
            ended: None,
        }
    }
}

/// Ways with what each is assumed to cost before it has been seen, s.
pub type Costs<W> = [(W, f64)];

impl<W: Way> Step<W> {
    /// A step of which all ways are open.
    #[must_use]
    pub fn new(command: u32, context: String, costs: &Costs<W>) -> Self {
        Self {
            command,
            context,
            open: costs.iter().map(|(way, _)| *way).collect(),
            ..Self::default()
        }
    }

    /// The way to try next, and the numbers of all that are open, its own first. `None` when none is.
    #[must_use]
    pub fn choose(
        &self,
        belief: &Belief,
        costs: &Costs<W>,
        rng: &mut impl Rng,
    ) -> Option<(W, Vec<Figures>)> {
        let open = costs.iter().filter(|(way, _)| self.open.contains(way));
        let candidates: Vec<Candidate> = open.map(|(way, cost)| candidate(*way, *cost)).collect();
        let Choice { name, figures } = belief.choose(&self.context, &candidates, rng)?;
        let mut ways = self.open.iter();
        let way = ways.find(|way| way.name() == name)?;
        Some((*way, figures))
    }

    /// Begins to try a way.
    pub fn begin(&mut self, way: W, now: Instant) {
        self.open.retain(|open| *open != way);
        self.chosen = Some(way);
        self.began = Some(now);
        self.ended = None;
    }

    /// Notes how the chosen way ended: among those that were tried, and in what is believed where that has to do with the way.
    pub fn note(&mut self, belief: &mut Belief, now: Instant, ended: Result<String, Failure>) {
        let Some(way) = self.chosen.take() else {
            return;
        };
        let seconds = self
            .began
            .map_or(0.0, |began| now.since(began).as_secs_f64());
        let counts = match &ended {
            Ok(_) => Some(true),
            Err(failure) => another_may_do(failure).then_some(false),
        };
        if let Some(succeeded) = counts {
            belief.note(&self.context, &way.name(), succeeded, seconds);
        }
        self.tried.push(Tried {
            way: way.name(),
            seconds,
            ended,
        });
    }

    /// Whether a protective stop ended the chosen way.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        let ended = self.ended.as_ref();
        ended.is_some_and(|failure| failure.outcome == Outcome::Stopped)
    }

    /// Whether another way may do where the chosen one has ended.
    #[must_use]
    pub fn may_go_on(&self) -> bool {
        self.ended.as_ref().is_some_and(another_may_do)
    }
}

/// What is believed of all ways of a step.
#[must_use]
pub fn figures<W: Way>(belief: &Belief, context: &str, costs: &Costs<W>) -> Vec<Figures> {
    let figures = costs.iter().map(|(way, cost)| {
        let seen = belief.seen(context, &way.name());
        Figures {
            name: way.name(),
            trials: seen.trials,
            chance: seen.chance(),
            cost: seen.cost(*cost),
        }
    });
    figures.collect()
}

/// Numbers of ways in words, one after the other.
#[must_use]
pub fn in_words(figures: &[Figures]) -> String {
    let figures: Vec<String> = figures.iter().map(ToString::to_string).collect();
    figures.join(", ")
}

fn candidate<W: Way>(way: W, cost: f64) -> Candidate {
    Candidate {
        name: way.name(),
        cost,
    }
}

/// Whether another way may do where one ended so.
fn another_may_do(failure: &Failure) -> bool {
    matches!(
        failure.outcome,
        Outcome::Unreachable | Outcome::Guard | Outcome::Unseen
    )
}
