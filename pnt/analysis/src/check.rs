//! What the nets of an app prove before anything moves: bounded, no end but rest, every transition
//! of use, rest always within reach, every command answered by one of its output symbols. What they
//! do not prove becomes findings that point into the net texts.

pub mod commands;
pub mod objects;
pub mod tapes;

#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use ctos::{
    diagnostic::{Finding, Findings, Place as At},
    message::DataType,
    registry::Vocabulary,
};

use commands::Workflow;

use crate::{
    analysis::{
        cover::{Cover, cover},
        explicit::{Progress, Reached},
        model::{Model, TransitionNumber},
        question::{Answer, Question},
        returns::always_reachable,
        verdict::{Engines, Looked, Verdict, list, look},
    },
    compose::{Stands, Step, System, SystemPlace, tape::Ends},
};
use pnt_language::net::{Action, Net, Part};

pub use crate::analysis::explicit::Limits;
pub use tapes::Tape;

/// Steps of a firing sequence that are shown; the ones before are counted.
const SHOWN_STEPS: usize = 16;

/// What was looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Report {
    /// Reachable markings.
    pub markings: u128,
    /// Edges between them.
    pub edges: u128,
    /// Whether these are all, so that no error means a proof.
    pub proved: bool,
}

/// The functions that a library offers to a net.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FunctionNames {
    /// Local functions, for `do` lines.
    pub actions: BTreeSet<String>,
    /// Enabling functions, for `when` lines.
    pub enabling: BTreeSet<String>,
    /// The local functions that take and give data objects, each with its argument and its result.
    pub typed: BTreeMap<String, (DataType, DataType)>,
}

impl FunctionNames {
    /// What local functions are called in a [`Vocabulary`].
    pub const LOCAL: &'static str = "local function";
    /// What enabling functions are called in a [`Vocabulary`].
    pub const ENABLING: &'static str = "enabling function";

    /// The names for editors.
    #[must_use]
    pub fn vocabulary(self) -> Vocabulary {
        Vocabulary::from([(Self::LOCAL, self.actions), (Self::ENABLING, self.enabling)])
    }
}

/// Reports functions that a net names and a library does not offer.
pub fn functions(net: &Net, names: &FunctionNames, findings: &mut Findings) {
    let mut unknown = |what: &str, name: &str, at: &At, known: &BTreeSet<String>| {
        if !known.contains(name) {
            let finding = Finding::error(
                "pnt::net::unknown_function",
                format!("the library of net `{}` has no {what} `{name}`", net.name()),
            );
            findings.push(
                finding
                    .at(at.clone())
                    .help("this library offers no such functions at all")
                    .suggest(name, known.iter().map(String::as_str)),
            );
        }
    };
    for transition in net.transitions() {
        if let Some(when) = &transition.when {
            unknown(
                FunctionNames::ENABLING,
                &when.function,
                &when.at,
                &names.enabling,
            );
        }
        if let Some(Action::Local { function, at, .. }) = &transition.action {
            unknown(FunctionNames::LOCAL, function, at, &names.actions);
        }
    }
    for transition in net.transitions() {
        if let Some(Action::Local {
            function,
            inputs,
            outputs,
            at,
            ..
        }) = &transition.action
        {
            let objects = (inputs.as_slice(), outputs.as_slice());
            let found = match names.typed.get(function) {
                Some(types) => {
                    objects::check(&format!("local function `{function}`"), objects, *types)
                }
                None if names.actions.contains(function) => objects::none(
                    &format!("local function `{function}`"),
                    "it reads and stores data objects itself",
                    objects,
                ),
                None => Vec::new(),
            };
            for finding in found {
                findings.push(finding.at(at.clone()));
            }
        }
    }
}

/// What a net must be to be sound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Nets at rest until a command comes: bounded; no end but rest; rest always within reach; every
    /// command answered once. A transition that never fires is only a warning: an app may have no use
    /// for part of a coordinator.
    Rest,
    /// A plain net, which nothing comes to from outside: bounded, no dead marking, no dead transition.
    /// It need not return to its initial marking.
    Closed,
}

impl Rule {
    /// [`Rule::Closed`] for nets without commands.
    #[must_use]
    pub fn of(nets: &[Arc<Net>]) -> Self {
        if nets.iter().any(|net| !net.commands().is_empty()) {
            Self::Rest
        } else {
            Self::Closed
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
    /// Of nets without bound, what they can cover, where that can be told.
    pub cover: Option<Cover>,
    /// Answers to the questions that were asked, in order.
    pub answers: Vec<Answered>,
    /// Each command by itself, if that was asked.
    pub workflows: Vec<Workflow>,
}

/// What to prove, and how.
#[derive(Debug, Clone)]
pub struct Options {
    /// What makes the nets sound.
    pub rule: Rule,
    /// How far to look.
    pub limits: Limits,
    /// What to look with; questions and tapes need the markings one by one.
    pub engines: Engines,
    /// Questions about markings.
    pub questions: Vec<(Asks, String)>,
    /// Whether to look at each command by itself as well; at those on a given tape, where they come.
    pub workflows: bool,
    /// What comes on tapes; on others, any command as soon as the one before is answered.
    pub tapes: Vec<Tape>,
}

impl Options {
    /// The check that nets have before they run: nothing is asked, one marking comes after the other.
    #[must_use]
    pub fn new(rule: Rule, limits: Limits) -> Self {
        Self {
            rule,
            limits,
            engines: Engines::Explicit,
            questions: Vec::new(),
            workflows: false,
            tapes: Vec::new(),
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
    /// Yes or no; nothing when a limit came first.
    #[must_use]
    pub fn yes(&self) -> Option<bool> {
        match self.answer {
            Answer::Unknown => None,
            Answer::Witness(_) => Some(self.asks == Asks::Can),
            Answer::Proved(_) => Some(self.asks != Asks::Can),
        }
    }
}

/// States that a coverability graph may have; it serves only nets that are not sound anyway.
const COVER_NODES: usize = 50_000;

/// Composes nets and explores what can happen.
///
/// # Errors
/// All findings about nets that do not fit together, and about questions; then nothing is explored.
pub fn prove(
    nets: &[Arc<Net>],
    options: &Options,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Proof, Findings> {
    let (mut system, mut findings) = System::compose(nets);
    if findings.has_errors() {
        return Err(findings);
    }
    let given = !options.tapes.is_empty();
    let ends = given.then(|| system.with_tapes(&options.tapes));
    let model = Model::of_system(&system);
    let mut questions = Vec::new();
    for (asks, text) in &options.questions {
        let question = findings.keep(Question::parse(text, &model));
        questions.extend(question.map(|question| (question, *asks)));
    }
    if findings.has_errors() {
        return Err(findings);
    }
    let Options { rule, limits, .. } = *options;
    // What is told about nets with a tape needs the markings one by one.
    let looked = if rule == Rule::Rest || !questions.is_empty() {
        list(&model, &limits, progress)
    } else {
        look(&model, &limits, options.engines, progress)
    };
    let answered = |(question, asks): (Question, Asks)| Answered {
        answer: match asks {
            Asks::Can | Asks::Never => question.can_be(&looked.explored),
            Asks::Always => question.stays_possible(&looked.explored, limits.bytes),
        },
        question: question.to_string(),
        asks,
    };
    let answers = questions.into_iter().map(answered).collect();
    let grows = looked.explored.growth.is_some();
    let end = ends.map(|ends| end(&ends, &looked, &limits));
    let workflows = match (&end, options.workflows) {
        (_, false) => Vec::new(),
        (None, true) => commands::workflows(&system, &limits),
        (Some(end), true) => commands::on_tapes(&system, &looked.explored, end, &limits),
    };
    let judge = Judge {
        system: &system,
        model: &model,
        rule,
        looked: &looked,
        end: end.as_ref(),
    };
    findings.extend(judge.findings());
    let verdict = looked.verdict;
    Ok(Proof {
        cover: grows.then(|| cover(&model, COVER_NODES)).flatten(),
        workflows,
        answers,
        system,
        model,
        verdict,
        findings,
    })
}

/// Composes the nets of an app and checks them. The markings are only explored when the nets fit
/// together.
#[must_use]
pub fn check(nets: &[Arc<Net>], limits: &Limits) -> (Report, Findings) {
    match prove(nets, &Options::new(Rule::Rest, *limits), &mut |_| {}) {
        Ok(proof) => {
            let report = Report {
                markings: proof.verdict.markings,
                edges: proof.verdict.edges,
                proved: proof.verdict.reversible.is_some(),
            };
            (report, proof.findings)
        }
        Err(findings) => {
            let report = Report {
                markings: 0,
                edges: 0,
                proved: false,
            };
            (report, findings)
        }
    }
}

/// Whether the end of what comes on given tapes always stays within reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum End {
    /// From every reachable marking.
    Always,
    /// Not from this one.
    NotFrom(Vec<u32>),
    /// A limit came first.
    Unknown,
}

fn end(ends: &Ends, looked: &Looked<'_>, limits: &Limits) -> End {
    match always_reachable(
        &looked.explored,
        &|marking| ends.holds(marking),
        limits.bytes,
    ) {
        None => End::Unknown,
        Some(None) => End::Always,
        Some(Some(marking)) => End::NotFrom(marking),
    }
}

struct Judge<'a> {
    system: &'a System,
    model: &'a Model,
    rule: Rule,
    looked: &'a Looked<'a>,
    /// Where tapes are given.
    end: Option<&'a End>,
}

impl Judge<'_> {
    fn findings(&self) -> Findings {
        let mut findings = Findings::new();
        let errors = [
            self.growth(),
            self.dead(),
            self.unasked(),
            self.overfilled(),
            self.trapped(),
            self.unproved(),
        ];
        for finding in errors.into_iter().flatten() {
            findings.push(finding);
        }
        if self.looked.verdict.complete {
            self.never(&mut findings);
        }
        findings
    }

    /// A shortest way to a marking that was found, in words.
    fn way_to(&self, marking: &[u32]) -> String {
        self.steps(&self.looked.explored.path(marking).unwrap_or_default())
    }

    fn steps(&self, path: &[TransitionNumber]) -> String {
        if path.is_empty() {
            return "nothing".to_owned();
        }
        let skipped = path.len().saturating_sub(SHOWN_STEPS);
        let names: Vec<&str> = path
            .iter()
            .skip(skipped)
            .filter_map(|number| self.model.transitions.get(*number as usize))
            .map(|transition| transition.name.as_str())
            .collect();
        let before = match skipped {
            0 => String::new(),
            1 => "one step, ".to_owned(),
            _ => format!("{skipped} steps, "),
        };
        format!("{before}{}", names.join(", "))
    }

    /// The place that tells most about a marking: marked, not at rest, and written by a person.
    fn telling(&self, marking: &[u32]) -> Option<&SystemPlace> {
        let importance = |place: &SystemPlace| match place.stands {
            Stands::Place(id) => {
                let net = self.system.nets().get(place.net);
                let declared =
                    net.is_some_and(|net| net[id].role == pnt_language::net::Role::Declared);
                if declared { 0 } else { 2 }
            }
            Stands::OnTape(_) | Stands::Firing(_) | Stands::OnTheWay(_) => 1,
            Stands::InProgress(_) => 3,
            Stands::Idle | Stands::Filled(_) | Stands::Holds(_) | Stands::Word(_) => 4,
        };
        self.system
            .places()
            .iter()
            .zip(marking)
            .filter(|(place, tokens)| **tokens > place.tokens && !place.stands.is_count())
            .map(|(place, _)| place)
            .min_by_key(|place| importance(place))
    }

    fn at_marking(&self, finding: Finding, marking: &[u32]) -> Finding {
        let emptied = || {
            let pairs = self.system.places().iter().zip(marking);
            pairs
                .filter(|(place, tokens)| **tokens < place.tokens && !place.stands.is_count())
                .map(|(place, _)| place)
                .next()
        };
        match self.telling(marking) {
            Some(place) => finding
                .at(place.at.clone())
                .label("this is marked then, and nothing takes it on"),
            None => match emptied() {
                Some(place) => finding.at(place.at.clone()).label("this is empty then"),
                None => finding,
            },
        }
    }

    fn growth(&self) -> Option<Finding> {
        let growth = self.looked.explored.growth.as_ref()?;
        let place = self.system.places().get(growth.place as usize)?;
        Some(
            Finding::error(
                "pnt::check::unbounded",
                format!(
                    "`{}` can collect tokens without bound: after {}, each round of {} adds to it",
                    place.name,
                    self.steps(&growth.lead),
                    self.steps(&growth.cycle)
                ),
            )
            .at(place.at.clone())
            .label("this place grows")
            .help("let the round take back the token it adds, or bound it with a semaphore place"),
        )
    }

    /// Dead markings; other than rest where that may well have nothing to do.
    fn dead_ends(&self) -> impl Iterator<Item = &Reached> {
        let nearest = usize::from(self.rule == Rule::Rest);
        let dead = self.looked.explored.dead.iter();
        dead.filter(move |dead| dead.distance >= nearest)
    }

    fn dead(&self) -> Option<Finding> {
        if let Some((sequence, marking)) = &self.looked.deadlock {
            let others = match self.looked.verdict.deadlocks {
                1 => String::new(),
                count => format!(" ({count} such markings in all)"),
            };
            return Some(self.dead_finding(&self.steps(sequence), marking, &others));
        }
        let dead = self.dead_ends().next()?;
        let rest = self
            .looked
            .explored
            .dead
            .iter()
            .any(|dead| dead.distance == 0);
        let rest = rest && self.rule == Rule::Rest;
        let others = match self.looked.explored.dead_count - u64::from(rest) {
            1 => String::new(),
            count => format!(" ({count} such markings in all)"),
        };
        Some(self.dead_finding(&self.way_to(&dead.marking), &dead.marking, &others))
    }

    fn dead_finding(&self, way: &str, marking: &[u32], others: &str) -> Finding {
        let finding = Finding::error(
            "pnt::check::deadlock",
            format!(
                "{}: after {way} the marking is {}, and no transition is sure to fire{others}",
                match (self.end, self.rule) {
                    (Some(_), _) => "the nets can stop before the end of what is on the tape",
                    (None, Rule::Rest) => "the nets can stop short of rest",
                    (None, Rule::Closed) => "there is a deadlock",
                },
                self.system.marking_name(marking)
            ),
        )
        .help("give this marking a way on; a single `when` may stay false for ever, so pair it with its negation");
        self.at_marking(finding, marking)
    }

    fn trapped(&self) -> Option<Finding> {
        // A dead end is the clearer finding.
        if self.rule == Rule::Closed || self.dead_ends().next().is_some() {
            return None;
        }
        if let Some(end) = self.end {
            return self.unfinished(end);
        }
        let marking = self.looked.returns.as_ref()?.no_return.as_ref()?;
        let finding = Finding::error(
            "pnt::check::no_return",
            format!(
                "rest can get out of reach: after {} the marking is {}, and no way leads back to the initial marking",
                self.way_to(marking),
                self.system.marking_name(marking)
            ),
        )
        .help("look for a token that is lost or left over, or a command that gets no answer");
        Some(self.at_marking(finding, marking))
    }

    fn unfinished(&self, end: &End) -> Option<Finding> {
        let End::NotFrom(marking) = end else {
            return None;
        };
        let finding = Finding::error(
            "pnt::check::no_end",
            format!(
                "what is on the tape can get impossible to finish: after {} the marking is {}, and no way leads to its end with every command answered",
                self.way_to(marking),
                self.system.marking_name(marking)
            ),
        )
        .help("look for a command that gets no answer, or give another tape");
        Some(self.at_marking(finding, marking))
    }

    /// The nearest marking and step of a kind.
    fn nearest_step(&self, wanted: impl Fn(&Step) -> bool) -> Option<(Reached, &Step)> {
        let steps = (0..)
            .zip(self.system.steps())
            .zip(&self.looked.explored.seen);
        let wanted = steps.filter(|((_, step), seen)| **seen && wanted(step));
        let nearest =
            |((number, step), _)| Some((self.looked.explored.nearest_enabled(number)?, step));
        wanted.filter_map(nearest).min_by(|(a, _), (b, _)| a.cmp(b))
    }

    fn overfilled(&self) -> Option<Finding> {
        let (reached, step) = self.nearest_step(|step| step.overfills.is_some())?;
        let place = self.system.places().get(step.overfills?)?;
        let sender = self.system.nets().get(step.net)?;
        let transition = &sender[step.transition?];
        Some(
            Finding::error(
                "pnt::check::overfilled",
                format!(
                    "tokens of `{}.{}` can find no room in `{}`, which refuses them, and their net stops: after {}",
                    sender.name(),
                    transition.name,
                    place.name,
                    self.way_to(&reached.marking)
                ),
            )
            .at(transition.at.clone())
            .help("let the receiver give back a token for each that it takes on, and the sender wait for it; or raise the capacity"),
        )
    }

    fn unasked(&self) -> Option<Finding> {
        let (reached, step) = self.nearest_step(|step| step.unasked)?;
        let transition = &self.system.nets().get(step.net)?[step.transition?];
        let symbol = transition.write.as_deref().unwrap_or_default();
        Some(
            Finding::error(
                "pnt::check::answer",
                format!(
                    "transition `{}` can write `{symbol}` when no command waits for it: after {}",
                    transition.name,
                    self.way_to(&reached.marking)
                ),
            )
            .at(transition.at.clone())
            .help(
                "each command is answered once, by one of the output symbols of its `command` line",
            ),
        )
    }

    fn unproved(&self) -> Option<Finding> {
        let returns = match (self.rule, self.end) {
            (Rule::Closed, _) => true,
            (Rule::Rest, Some(end)) => *end != End::Unknown,
            (Rule::Rest, None) => self.looked.returns.is_some(),
        };
        let proved = self.looked.verdict.complete && returns;
        if proved || self.looked.explored.growth.is_some() {
            return None;
        }
        let place = self
            .system
            .places()
            .iter()
            .zip(&self.looked.explored.bounds);
        let (place, bound) = place.max_by_key(|(_, bound)| **bound)?;
        let lives = match self.looked.verdict.deadlock_free {
            Some(true) => "; there is no deadlock, by stubborn sets",
            _ => "",
        };
        Some(
            Finding::error(
                "pnt::check::not_proved",
                format!(
                    "not proved: more than {} markings; `{}` has held up to {bound} tokens so far{lives}",
                    self.looked.explored.markings, place.name
                ),
            )
            .at(place.at.clone())
            .help(
                "bound what can be in flight with semaphore places, or raise the limit of markings",
            ),
        )
    }

    /// Transitions of no use: never enabled at any reachable marking.
    fn never(&self, findings: &mut Findings) {
        let transitions = self.system.nets().iter().flat_map(|net| net.transitions());
        let all = transitions.zip(&self.looked.verdict.seen);
        for (transition, _) in all.filter(|(_, seen)| !**seen) {
            if matches!(transition.part, Part::Return | Part::Fail { branch: false }) {
                continue;
            }
            let text = format!("transition `{}` can never fire", transition.name);
            let finding = match self.rule {
                Rule::Rest => Finding::warning("pnt::check::never_fires", text),
                Rule::Closed => Finding::error("pnt::check::never_fires", text),
            };
            findings.push(finding.at(transition.at.clone()).help(
                "nothing ever marks its input places together; check their names and weights",
            ));
        }
    }
}
