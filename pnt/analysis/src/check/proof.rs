//! What is to be proved of nets, and what was.

use std::sync::Arc;

use ctos::diagnostic::{Finding, Findings, Severity};
use pnt_language::net::Net;

use super::commands::Workflow;
use crate::{
    analysis::{
        cover::Cover,
        explicit::Limits,
        model::{Model, PlaceNumber, TransitionNumber},
        question::Answer,
        verdict::{Engines, Verdict},
    },
    compose::{System, tape::Tape},
};

/// What a net must be to be sound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Nets at rest until a command comes: bounded; no end but rest; rest always within reach; every
    /// command answered once. A transition that never fires is only a warning: an app may have no use
    /// for part of a coordinator.
    Rest,
    /// Nets that are to be run, which nothing comes to from outside: what [`Rule::Rest`] asks, and what
    /// [`Rule::Closed`] asks.
    Alone,
    /// A net of another tool, which is not run: bounded, no dead marking, no dead transition. It need not
    /// return to its initial marking.
    Closed,
}

impl Rule {
    /// Of nets that are to be run: [`Rule::Alone`] for those without commands.
    #[must_use]
    pub fn of(nets: &[Arc<Net>]) -> Self {
        if nets.iter().any(|net| !net.commands().is_empty()) {
            Self::Rest
        } else {
            Self::Alone
        }
    }
}

/// What was proved about composed nets.
#[derive(Debug)]
pub struct Proof {
    /// The nets as one system.
    pub system: System,
    /// Its model; transitions are the system's steps in order.
    pub model: Model,
    /// What holds.
    pub verdict: Verdict,
    /// Why they are not sound; and warnings.
    pub findings: Findings,
    /// Of nets without bound, what they can cover, where that can be computed.
    pub cover: Option<Cover>,
    /// The place that was found to grow without bound.
    pub grows: Option<PlaceNumber>,
    /// Answers to the questions that were asked, in order.
    pub answers: Vec<Answered>,
    /// Each command by itself, if that was asked.
    pub workflows: Vec<Workflow>,
    /// Firing sequences that show why the nets are not sound, in the order of their findings.
    pub counterexamples: Vec<Counterexample>,
}

/// A firing sequence that shows why nets are not sound.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counterexample {
    /// Code of the finding that it belongs to.
    pub code: &'static str,
    /// Firings from the initial marking.
    pub sequence: Vec<TransitionNumber>,
    /// Firings that can follow again and again, each time with more tokens; empty where nothing grows.
    pub round: Vec<TransitionNumber>,
    /// The marking after the sequence.
    pub marking: Vec<u32>,
}

impl Proof {
    /// Whether the nets are sound; `None` where a limit came before that is known.
    #[must_use]
    pub fn sound(&self) -> Option<bool> {
        let errors = |finding: &&Finding| finding.severity == Severity::Error;
        let mut errors = self.findings.iter().filter(errors).peekable();
        if errors.peek().is_none() {
            return self.verdict.complete.then_some(true);
        }
        errors
            .any(|finding| finding.code != NOT_PROVED)
            .then_some(false)
    }
}

/// The code of the findings about dead markings.
pub(super) const DEADLOCK: &str = "pnt::check::deadlock";

/// The code of the finding that a limit came before a proof.
pub const NOT_PROVED: &str = "pnt::check::not_proved";

/// What to prove, and how.
#[derive(Debug, Clone)]
pub struct Options {
    /// What makes the nets sound.
    pub rule: Rule,
    /// How far to look.
    pub limits: Limits,
    /// How far the check before a boot looks: nets that are to be run and have more get a warning.
    pub boot: Limits,
    /// What to look with; questions and tapes need the markings one by one.
    pub engines: Engines,
    /// Questions about markings.
    pub questions: Vec<(Asks, String)>,
    /// Whether to look at each command by itself as well; at those on a given tape, where they come.
    pub workflows: bool,
    /// What comes on tapes; on others, any command as soon as the one before is answered.
    pub tapes: Vec<Tape>,
    /// Dead markings that are shown, each with a shortest way to it: at least one, and no more than are kept.
    pub deadlocks: usize,
}

impl Options {
    /// The check that nets have before they run: nothing is asked, one marking comes after the other.
    #[must_use]
    pub fn new(rule: Rule, limits: Limits) -> Self {
        Self {
            rule,
            limits,
            boot: Limits::default(),
            engines: Engines::Explicit,
            questions: Vec::new(),
            workflows: false,
            tapes: Vec::new(),
            deadlocks: 1,
        }
    }
}

/// What is asked about markings of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asks {
    /// Whether one can be reached.
    Can,
    /// Whether none can be reached.
    Never,
    /// Whether one can be reached from every reachable marking.
    Always,
}

/// A question and its answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answered {
    /// The question as it was asked.
    pub question: String,
    /// What was asked.
    pub asks: Asks,
    /// The answer.
    pub answer: Answer,
}

impl Answered {
    /// Yes or no; `None` when a limit came first.
    #[must_use]
    pub fn yes(&self) -> Option<bool> {
        match self.answer {
            Answer::Unknown => None,
            Answer::Witness(_) => Some(self.asks == Asks::Can),
            Answer::Proved(_) => Some(self.asks != Asks::Can),
        }
    }
}
