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
    diagnostic::{Finding, Findings, Place as At, Severity},
    message::DataType,
    registry::Vocabulary,
};

use commands::Workflow;

use crate::{
    analysis::{
        cover::{Cover, cover},
        explicit::{Progress, Reached, Stopped},
        model::{Model, PlaceNumber, TransitionNumber},
        play::{Lack, Wanted, lacks},
        question::{Answer, Question},
        returns::always_reachable,
        verdict::{Engines, Looked, Verdict, list, look},
    },
    compose::{Phase, Stands, Step, System, SystemPlace, push_some, tape::Ends},
};
use pnt_language::{
    compile::endless,
    net::{Action, Net, Part, Transition},
};

pub use crate::analysis::explicit::Limits;
pub use tapes::Tape;

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
    /// Of nets without bound, what they can cover, where that can be told.
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
    /// Whether the nets are sound; nothing where a limit came before that is known.
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

/// The code of the finding that a limit came before a proof.
pub const NOT_PROVED: &str = "pnt::check::not_proved";

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

const DEADLOCK: &str = "pnt::check::deadlock";

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
    let Options { rule, limits, .. } = *options;
    let (mut system, mut findings) = System::compose(nets);
    let fits = !findings.has_errors();
    // What the executor refuses by itself.
    for net in nets.iter().filter(|_| rule != Rule::Closed) {
        findings.extend(endless(net));
    }
    if !fits {
        return Err(findings);
    }
    let given = !options.tapes.is_empty();
    let ends = given.then(|| system.with_tapes(&options.tapes));
    let model = Model::of_system(&system);
    let mut questions = Vec::new();
    let mut unread = Findings::new();
    for (asks, text) in &options.questions {
        let question = unread.keep(Question::parse(text, &model));
        questions.extend(question.map(|question| (question, *asks)));
    }
    if unread.has_errors() {
        findings.extend(unread);
        return Err(findings);
    }
    // What is told about nets with a tape, and of several dead markings, needs the markings one by one.
    let looked = if rule == Rule::Rest || !questions.is_empty() || options.deadlocks > 1 {
        list(&model, &limits, progress)
    } else if rule == Rule::Alone && options.engines == Engines::Both {
        // As far as a boot looks, in the same way, so that both say the same.
        let of_boot = Limits::default();
        let few = Limits {
            markings: limits.markings.min(of_boot.markings),
            ..limits
        };
        let listed = list(&model, &few, progress);
        let is_all = listed.verdict.stopped != Some(Stopped::Markings);
        if is_all {
            listed
        } else {
            drop(listed);
            look(&model, &limits, options.engines, progress)
        }
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
    let grows = looked.explored.growth.as_ref().map(|growth| growth.place);
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
        deadlocks: options.deadlocks,
    };
    let mut counterexamples = Vec::new();
    findings.extend(judge.findings(&mut counterexamples));
    let verdict = looked.verdict;
    Ok(Proof {
        cover: grows.and_then(|_| cover(&model, COVER_NODES)),
        grows,
        workflows,
        answers,
        system,
        model,
        verdict,
        findings,
        counterexamples,
    })
}

/// The nets in groups: those that name each other, directly or through others, are together. Each group is sound
/// or not by itself.
#[must_use]
pub fn systems(nets: &[Arc<Net>]) -> Vec<Vec<Arc<Net>>> {
    let mut groups: Vec<Vec<Arc<Net>>> = Vec::new();
    for net in nets {
        let (with, mut without): (Vec<_>, Vec<_>) = groups.into_iter().partition(|group| {
            group
                .iter()
                .any(|other| knows(net, other) || knows(other, net))
        });
        let mut together: Vec<Arc<Net>> = with.into_iter().flatten().collect();
        together.push(Arc::clone(net));
        without.push(together);
        groups = without;
    }
    groups
}

/// Whether one net names the other.
fn knows(net: &Net, other: &Net) -> bool {
    let partners = net.coordinators().iter().chain(net.serves());
    let mut names = partners
        .map(|partner| partner.net.as_str())
        .chain(net.remote_nets());
    names.any(|name| name == other.name())
}

/// Composes the nets of an app and checks them, each group of nets that name each other by itself. The markings
/// are only explored when the nets fit together.
#[must_use]
pub fn check(nets: &[Arc<Net>], limits: &Limits) -> (Report, Findings) {
    let mut report = Report {
        markings: 0,
        edges: 0,
        proved: false,
    };
    let mut findings = fit(nets);
    if findings.has_errors() {
        return (report, findings);
    }
    findings = Findings::new();
    report.proved = true;
    for nets in systems(nets) {
        match prove(&nets, &Options::new(Rule::Rest, *limits), &mut |_| {}) {
            Ok(proof) => {
                report.markings += proof.verdict.markings;
                report.edges += proof.verdict.edges;
                report.proved &= proof.verdict.reversible.is_some();
                findings.extend(proof.findings);
            }
            Err(found) => {
                report.proved = false;
                findings.extend(found);
            }
        }
    }
    (report, findings)
}

/// What keeps nets from being put together, and warnings about that; no marking is looked at.
#[must_use]
pub fn fit(nets: &[Arc<Net>]) -> Findings {
    System::fit(nets)
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
    deadlocks: usize,
}

/// A finding and the sequence that shows it.
type Found = (Finding, Option<Counterexample>);

impl Judge<'_> {
    fn findings(&self, counterexamples: &mut Vec<Counterexample>) -> Findings {
        let mut findings = Findings::new();
        let growth = self.growth().into_iter();
        let rest = [
            self.unasked(),
            self.overfilled(),
            self.trapped(),
            self.unproved().map(|finding| (finding, None)),
        ];
        let errors = growth.chain(self.dead()).chain(rest.into_iter().flatten());
        for (finding, counterexample) in errors {
            findings.push(finding);
            counterexamples.extend(counterexample);
        }
        if self.looked.verdict.complete {
            self.never(&mut findings);
        }
        findings
    }

    /// A shortest way to a marking that was found, and that in words.
    fn way_to(&self, code: &'static str, marking: &[u32]) -> (Counterexample, String) {
        let sequence = self.looked.explored.path(marking).unwrap_or_default();
        let words = self.steps(&sequence);
        let counterexample = Counterexample {
            code,
            sequence,
            round: Vec::new(),
            marking: marking.to_vec(),
        };
        (counterexample, words)
    }

    /// A whole sequence, so that it can be played.
    fn steps(&self, path: &[TransitionNumber]) -> String {
        if path.is_empty() {
            return "nothing".to_owned();
        }
        let names: Vec<&str> = path
            .iter()
            .filter_map(|number| self.model.transitions.get(*number as usize))
            .map(|transition| transition.name.as_str())
            .collect();
        names.join(", ")
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

    /// Points to what tells most about a marking that is dead or has no way back.
    fn at_marking(&self, finding: Finding, marking: &[u32], dead: bool) -> Finding {
        if let Some(place) = self.telling(marking) {
            let label = match (dead, self.asks_functions()) {
                (true, false) => "this is marked then, and nothing takes it on",
                (true, true) => "this is marked then, and nothing is sure to take it on",
                (false, _) => "this is marked then",
            };
            return finding.at(place.at.clone()).label(label);
        }
        match self.nearly(marking) {
            Some((place, label)) => finding.at(place.at.clone()).label(label),
            None => finding,
        }
    }

    fn asks_functions(&self) -> bool {
        self.system.steps().iter().any(|step| step.when.is_some())
    }

    /// Of the transitions that may not fire at a marking, what one with the fewest reasons waits for.
    fn nearly(&self, marking: &[u32]) -> Option<(&SystemPlace, String)> {
        let begins = (0..).zip(self.system.steps()).filter(|(_, step)| {
            step.transition.is_some() && matches!(step.phase, Phase::Fire | Phase::Start)
        });
        let of = |(number, step)| {
            let lacks = lacks(self.model, number, marking);
            let mut shown = lacks.iter().filter(|lack| self.shown(lack));
            Some((lacks.len(), *shown.next()?, step))
        };
        let (_, lack, step) = begins.filter_map(of).min_by_key(|(count, ..)| *count)?;
        let place = self.system.places().get(lack.place as usize)?;
        let net = self.system.nets().get(step.net)?;
        let transition = &net[step.transition?].name;
        let label = match lack.wanted {
            Wanted::AtLeast(needs) => format!(
                "this holds {} then, and `{transition}` needs {needs}",
                lack.holds
            ),
            Wanted::Below(below) => format!(
                "this holds {} then, and `{transition}` waits until it holds fewer than {below}",
                lack.holds
            ),
        };
        Some((place, label))
    }

    /// Whether a place is one that its author knows.
    fn shown(&self, lack: &Lack) -> bool {
        let place = self.system.places().get(lack.place as usize);
        place.is_some_and(|place| matches!(place.stands, Stands::Place(_)))
    }

    fn growth(&self) -> Option<Found> {
        const CODE: &str = "pnt::check::unbounded";
        let growth = self.looked.explored.growth.as_ref()?;
        let place = self.system.places().get(growth.place as usize)?;
        let counterexample = Counterexample {
            code: CODE,
            marking: self.model.replay(&growth.lead)?,
            sequence: growth.lead.clone(),
            round: growth.cycle.clone(),
        };
        let finding = Finding::error(
            CODE,
            format!(
                "`{}` can collect tokens without bound: after {}, each round of {} adds to it",
                place.name,
                self.steps(&growth.lead),
                self.steps(&growth.cycle)
            ),
        )
        .at(place.at.clone())
        .label("this place grows")
        .help("let the round take back the token it adds, or bound it with a semaphore place");
        Some((finding, Some(counterexample)))
    }

    /// Dead markings; other than rest where that may well have nothing to do.
    fn dead_ends(&self) -> impl Iterator<Item = &Reached> {
        let nearest = usize::from(self.rule != Rule::Closed);
        let dead = self.looked.explored.dead.iter();
        dead.filter(move |dead| dead.distance >= nearest)
    }

    /// Of dead markings the nearest ones, as many as are wanted.
    fn dead(&self) -> Vec<Found> {
        if let Some((sequence, marking)) = &self.looked.deadlock {
            let others = match self.looked.verdict.deadlocks {
                1 => String::new(),
                count => format!(" ({count} such markings in all)"),
            };
            let counterexample = Counterexample {
                code: DEADLOCK,
                sequence: sequence.clone(),
                round: Vec::new(),
                marking: marking.clone(),
            };
            return vec![self.dead_finding(counterexample, &self.steps(sequence), &others)];
        }
        let rest = self
            .looked
            .explored
            .dead
            .iter()
            .any(|dead| dead.distance == 0);
        let begins_dead = rest && self.rule == Rule::Alone;
        let rest = rest && self.rule != Rule::Closed;
        let initial = begins_dead.then(|| {
            let (counterexample, way) = self.way_to(DEADLOCK, &self.model.initial());
            self.dead_finding(counterexample, &way, "")
        });
        let all = self.looked.explored.dead_count - u64::from(rest);
        let wanted = self.dead_ends().take(self.deadlocks.max(1));
        let each = (1_u64..).zip(wanted).map(|(number, dead)| {
            let others = match (all, self.deadlocks) {
                (1, _) => String::new(),
                (_, 0 | 1) => format!(" ({all} such markings in all)"),
                _ => format!(" ({number} of {all} such markings)"),
            };
            let (counterexample, way) = self.way_to(DEADLOCK, &dead.marking);
            self.dead_finding(counterexample, &way, &others)
        });
        initial.into_iter().chain(each).collect()
    }

    fn dead_finding(&self, counterexample: Counterexample, way: &str, others: &str) -> Found {
        let marking = &counterexample.marking;
        let help = match self.asks_functions() {
            true => {
                "give this marking a way on; a single `when` may stay false for ever, so pair it with its negation"
            }
            false => {
                "give this marking a way on: a transition that can fire there, or fewer ways into it"
            }
        };
        let finding = Finding::error(
            DEADLOCK,
            format!(
                "{}: after {way} the marking is {}, and no transition is sure to fire{others}",
                match (self.end, self.rule) {
                    (Some(_), _) => "the nets can stop before the end of what is on the tape",
                    (None, Rule::Rest) => "the nets can stop short of rest",
                    (None, Rule::Alone) if !counterexample.sequence.is_empty() =>
                        "the nets can stop short of rest",
                    (None, Rule::Alone | Rule::Closed) => "there is a deadlock",
                },
                self.system.marking_name(marking)
            ),
        )
        .help(help);
        let finding = self.at_marking(finding, marking, true);
        (finding, Some(counterexample))
    }

    fn trapped(&self) -> Option<Found> {
        const CODE: &str = "pnt::check::no_return";
        // A dead end is the clearer finding.
        if self.rule == Rule::Closed || self.dead_ends().next().is_some() {
            return None;
        }
        if let Some(end) = self.end {
            return self.unfinished(end);
        }
        let Some(returns) = self.looked.returns.as_ref() else {
            // Diagrams know it without a way.
            let lost = self.looked.verdict.reversible == Some(false);
            let text =
                "rest can get out of reach: from some marking no way leads back to the initial one";
            let help = "a way there is shown with `--engine explicit`";
            return lost.then(|| (Finding::error(CODE, text).help(help), None));
        };
        let marking = returns.no_return.as_ref()?;
        let (counterexample, way) = self.way_to(CODE, marking);
        let finding = Finding::error(
            CODE,
            format!(
                "rest can get out of reach: after {way} the marking is {}, and no way leads back to the initial marking",
                self.system.marking_name(marking)
            ),
        )
        .help("look for a token that is lost or left over, or a command that gets no answer");
        let finding = self.at_marking(finding, marking, false);
        Some((finding, Some(counterexample)))
    }

    fn unfinished(&self, end: &End) -> Option<Found> {
        const CODE: &str = "pnt::check::no_end";
        let End::NotFrom(marking) = end else {
            return None;
        };
        let (counterexample, way) = self.way_to(CODE, marking);
        let finding = Finding::error(
            CODE,
            format!(
                "what is on the tape can get impossible to finish: after {way} the marking is {}, and no way leads to its end with every command answered",
                self.system.marking_name(marking)
            ),
        )
        .help("look for a command that gets no answer, or give another tape");
        let finding = self.at_marking(finding, marking, false);
        Some((finding, Some(counterexample)))
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

    /// The way to the nearest marking at which a step of a kind may be taken, and that step.
    fn way_to_step(
        &self,
        code: &'static str,
        reached: &Reached,
        step: &Step,
    ) -> (Counterexample, String) {
        let (mut counterexample, words) = self.way_to(code, &reached.marking);
        let steps = self.system.steps().iter();
        if let Some((number, _)) = (0..)
            .zip(steps)
            .find(|(_, other)| std::ptr::eq(*other, step))
        {
            counterexample.sequence.push(number);
            if let Some(after) = self.model.fire(number, &reached.marking) {
                counterexample.marking = after;
            }
        }
        (counterexample, words)
    }

    fn overfilled(&self) -> Option<Found> {
        const CODE: &str = "pnt::check::overfilled";
        let (reached, step) = self.nearest_step(|step| step.overfills.is_some())?;
        let place = self.system.places().get(step.overfills?)?;
        let sender = self.system.nets().get(step.net)?;
        let transition = &sender[step.transition?];
        let (counterexample, way) = self.way_to_step(CODE, &reached, step);
        let finding =
            Finding::error(
                CODE,
                format!(
                    "tokens of `{}.{}` can find no room in `{}`, which refuses them, and their net stops: after {way}",
                    sender.name(),
                    transition.name,
                    place.name,
                ),
            )
            .at(transition.at.clone())
            .help("let the receiver give back a token for each that it takes on, and the sender wait for it; or raise the capacity");
        Some((finding, Some(counterexample)))
    }

    fn unasked(&self) -> Option<Found> {
        const CODE: &str = "pnt::check::answer";
        let (reached, step) = self.nearest_step(|step| step.unasked)?;
        let transition = &self.system.nets().get(step.net)?[step.transition?];
        let symbol = transition.write.as_deref().unwrap_or_default();
        let (counterexample, way) = self.way_to_step(CODE, &reached, step);
        let finding = Finding::error(
            CODE,
            format!(
                "transition `{}` can write `{symbol}` when no command waits for it: after {way}",
                transition.name,
            ),
        )
        .at(transition.at.clone())
        .help("each command is answered once, by one of the output symbols of its `command` line");
        Some((finding, Some(counterexample)))
    }

    fn unproved(&self) -> Option<Finding> {
        let returns = match (self.rule, self.end) {
            (Rule::Closed, _) => true,
            (_, Some(end)) => *end != End::Unknown,
            (_, None) => self.looked.verdict.reversible.is_some(),
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
        let markings = self.looked.explored.markings;
        let (why, help) = match (self.looked.verdict.complete, self.looked.verdict.stopped) {
            (true, _) => (
                format!("the {markings} markings were not all followed to their ends"),
                "give it more time or memory",
            ),
            (false, Some(Stopped::Stop)) => (
                format!("ended after {markings} markings"),
                "give it more time",
            ),
            (false, Some(Stopped::Bytes)) => (
                format!(
                    "{markings} markings and what finds them need more memory than is permitted"
                ),
                "bound what can be in flight with semaphore places, or raise the limit of memory; docs/authoring-nets.md (Counters) shows how a net counts",
            ),
            (false, _) => (
                format!("more than {markings} markings"),
                "bound what can be in flight with semaphore places, or raise the limit of markings; docs/authoring-nets.md (Counters) shows how a net counts",
            ),
        };
        let text = format!(
            "not proved: {why}; `{}` has held up to {bound} tokens so far{lives}",
            place.name
        );
        Some(
            Finding::error(NOT_PROVED, text)
                .at(place.at.clone())
                .help(help),
        )
    }

    /// Transitions of no use: never enabled at any reachable marking.
    fn never(&self, findings: &mut Findings) {
        let transitions = self.system.nets().iter().flat_map(|net| net.transitions());
        let all = transitions.zip(&self.looked.verdict.seen);
        let meant = |part: Part| !matches!(part, Part::Return | Part::Fail { branch: false });
        let never = all.filter(|(transition, seen)| !**seen && meant(transition.part));
        let finding = |(transition, _): (&Transition, &bool)| {
            let text = format!("transition `{}` can never fire", transition.name);
            let finding = match self.rule {
                Rule::Rest => Finding::warning("pnt::check::never_fires", text),
                Rule::Alone | Rule::Closed => Finding::error("pnt::check::never_fires", text),
            };
            finding
                .at(transition.at.clone())
                .help("nothing ever marks its input places together; check their names and weights")
        };
        push_some(never.map(finding), findings);
    }
}
