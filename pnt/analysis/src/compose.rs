//! All nets of an app as one system for analysis. Remote places are joined, and firings with
//! actions are split into start, completion and failure. A commander at every input tape puts any
//! command as soon as the one before is answered. Knows how steps change a marking, not which are
//! reachable.
//!
//! Tokens for another net are put there with the firing that sends them, unless their arrival can keep
//! something from firing. It can if they go to a place with a capacity, an inhibitor or a reset arc, or
//! enable a more urgent transition. Then the delay of the message matters, and they are under way
//! first.

mod build;
pub mod tape;
#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, fmt, sync::Arc};

use ctos::diagnostic::{Finding, Findings, Place as At};

use pnt_language::net::{
    CommandId, Net, Outputs, Part, Place, PlaceId, RemoteArc, Role, Transition, TransitionId,
};

/// Whose tokens are on their way: of a request, which part of it.
fn sender(net: &Net, one: &Transition) -> String {
    let part = match one.part {
        Part::Whole | Part::Return => "",
        Part::Start => "the start of ",
        Part::End => "the end of ",
        Part::Fail { .. } => "the failure of ",
    };
    format!("{part}{}.{}", net.name(), one.written())
}

/// Number of a place of the system.
pub type SystemPlaceId = usize;

/// What a place of the system stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stands {
    /// A place of a net.
    Place(PlaceId),
    /// Firings of a transition between start and end.
    Firing(TransitionId),
    /// The commander may put a command.
    Idle,
    /// A command that can be read.
    OnTape(CommandId),
    /// A command in progress.
    InProgress(CommandId),
    /// What a place with a capacity holds, and what the running firings may yet put there.
    Filled(PlaceId),
    /// Tokens of a transition on their way to another net.
    OnTheWay(TransitionId),
    /// Whether a running firing of a transition has the command in progress, which another one may answer.
    Holds(TransitionId),
    /// Whether the commands so far have led to this state of the language that is on the tape.
    Word(usize),
}

impl Stands {
    /// Whether its tokens are no tokens of the nets, only kept for counting.
    #[must_use]
    pub fn is_count(self) -> bool {
        matches!(
            self,
            Self::Idle | Self::Filled(_) | Self::Holds(_) | Self::Word(_)
        )
    }
}

/// A place of the system.
#[derive(Debug, Clone)]
pub struct SystemPlace {
    /// Number of its net in [`System::nets`].
    pub net: usize,
    /// What it stands for.
    pub stands: Stands,
    /// `net.place`, or words for what else it stands for.
    pub name: String,
    /// Where it stands in a net text.
    pub at: At,
    /// Tokens at rest.
    pub tokens: u32,
    /// What it holds at most.
    pub capacity: Option<u32>,
}

/// Which part of a firing a step is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// A whole firing of a transition without action.
    Fire,
    /// Tokens taken, action begun.
    Start,
    /// Action complete, tokens put.
    Complete,
    /// Action failed.
    Fail,
    /// The commander puts a command.
    Put(CommandId),
    /// Tokens arrive at another net, whose number this is.
    Arrive(usize),
    /// All tapes have come to their end, and nothing is asked any more.
    End,
}

/// An atomic change of the system's marking.
#[derive(Debug, Clone)]
pub struct Step {
    /// Number of its net in [`System::nets`].
    pub net: usize,
    /// The transition; none for the commander.
    pub transition: Option<TransitionId>,
    /// Which part of its firing.
    pub phase: Phase,
    /// Tokens that it takes.
    pub takes: Vec<(SystemPlaceId, u32)>,
    /// Tokens that it needs and leaves.
    pub reads: Vec<(SystemPlaceId, u32)>,
    /// Enabled only while the place holds fewer.
    pub forbids: Vec<(SystemPlaceId, u32)>,
    /// Places that it empties, after taking.
    pub resets: Vec<SystemPlaceId>,
    /// Tokens that it puts.
    pub puts: Vec<(SystemPlaceId, u32)>,
    /// Enabling function (numbered over the system) and whether it is negated.
    pub when: Option<(usize, bool)>,
    /// Its urgency, for steps that the net chooses among: the transition's priority. An immediate
    /// one beside timed transitions is above all their priorities.
    pub priority: Option<u32>,
    /// Whether it writes an output symbol that answers no command in progress.
    pub unasked: bool,
    /// The place whose capacity it would exceed: the tokens are refused, and their sender stops.
    pub overfills: Option<SystemPlaceId>,
}

/// The composed nets.
#[derive(Debug, Clone)]
pub struct System {
    pub(crate) nets: Vec<Arc<Net>>,
    pub(crate) places: Vec<SystemPlace>,
    pub(crate) steps: Vec<Step>,
    /// Number of enabling functions.
    pub(crate) functions: usize,
}

impl System {
    /// Joins nets. What cannot be joined is reported and left out.
    #[must_use]
    pub fn compose(nets: &[Arc<Net>]) -> (Self, Findings) {
        (build::build(nets), Self::fit(nets))
    }

    /// What keeps nets from being joined, and warnings about that.
    #[must_use]
    pub fn fit(nets: &[Arc<Net>]) -> Findings {
        let mut findings = Findings::new();
        check_names(nets, &mut findings);
        let arriving = arriving(nets);
        for net in nets {
            check_remote(net, nets, &mut findings);
            check_partners(net, nets, &mut findings);
            check_retries(net, nets, &mut findings);
            check_unused(net, &arriving, &mut findings);
            check_resets(net, &mut findings);
        }
        findings
    }

    /// The nets.
    #[must_use]
    pub fn nets(&self) -> &[Arc<Net>] {
        &self.nets
    }

    /// The places.
    #[must_use]
    pub fn places(&self) -> &[SystemPlace] {
        &self.places
    }

    /// The steps.
    #[must_use]
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// A step in words, such as `motion.plan_path fails`.
    #[must_use]
    pub fn step_name(&self, step: &Step) -> impl fmt::Display + use<> {
        let net = &self.nets[step.net];
        let one = step.transition.map(|id| &net[id]);
        let transition = one.map_or("", Transition::written);
        match step.phase {
            Phase::Fire => {
                let step = one.map(Transition::step).unwrap_or_default();
                format!("{}.{step}", net.name())
            }
            Phase::Start => format!("{}.{transition} starts", net.name()),
            Phase::Complete => format!("{}.{transition} completes", net.name()),
            Phase::Fail => format!("{}.{transition} fails", net.name()),
            Phase::Put(command) => format!("command {} to {}", net[command].symbol, net.name()),
            Phase::End => "the end of all tapes".to_owned(),
            Phase::Arrive(other) => {
                let other = self.nets.get(other).map_or("", |net| net.name());
                let of = one.map(|one| sender(net, one)).unwrap_or_default();
                format!("tokens of {of} arrive at {other}")
            }
        }
    }

    /// A marking in words: the marked places with commas.
    #[must_use]
    pub fn marking_name(&self, marking: &[u32]) -> String {
        let marked: Vec<String> = self
            .places
            .iter()
            .zip(marking)
            .filter(|(place, tokens)| **tokens > 0 && !place.stands.is_count())
            .map(|(place, tokens)| match tokens {
                1 => place.name.clone(),
                _ => format!("{}*{tokens}", place.name),
            })
            .collect();
        if marked.is_empty() {
            "empty".to_owned()
        } else {
            marked.join(", ")
        }
    }
}

fn names(nets: &[Arc<Net>]) -> impl Iterator<Item = &str> {
    nets.iter().map(|net| net.name())
}

fn find<'a>(nets: &'a [Arc<Net>], name: &str) -> Option<&'a Arc<Net>> {
    nets.iter().find(|net| net.name() == name)
}

fn check_names(nets: &[Arc<Net>], findings: &mut Findings) {
    let mut known: BTreeMap<&str, &Net> = BTreeMap::new();
    for net in nets {
        let Some(first) = known.get(net.name()) else {
            known.insert(net.name(), net);
            continue;
        };
        let text = format!(
            "two nets are called `{}`; the other is at {}",
            net.name(),
            first.at()
        );
        findings.push(
            Finding::error("pnt::app::duplicate_net", text)
                .at(net.at().clone())
                .help("rename one of them"),
        );
    }
}

/// Every output of a net, with or without failure.
fn outputs(net: &Net) -> impl Iterator<Item = &Outputs> {
    net.transitions()
        .iter()
        .flat_map(|transition| std::iter::once(&transition.outputs).chain(&transition.fail))
}

fn unknown_net(name: &str, at: &At, nets: &[Arc<Net>]) -> Finding {
    Finding::error(
        "pnt::app::unknown_net",
        format!("the app has no net `{name}`"),
    )
    .at(at.clone())
    .suggest(name, names(nets))
}

/// Declared remote arcs; those of coordination structures are the business of `check_partners`.
fn check_remote(net: &Net, nets: &[Arc<Net>], findings: &mut Findings) {
    let declared = |arc: &&RemoteArc| arc.role == Role::Declared;
    for arc in outputs(net)
        .flat_map(|outputs| &outputs.remote)
        .filter(declared)
    {
        match find(nets, &arc.net) {
            None => findings.push(unknown_net(&arc.net, &arc.at, nets)),
            Some(other) if other.place(&arc.place).is_none() => findings.push(
                Finding::error(
                    "pnt::app::unknown_place",
                    format!("net `{}` has no place `{}`", arc.net, arc.place),
                )
                .at(arc.at.clone())
                .suggest(
                    &arc.place,
                    other.places().iter().map(|place| place.name.as_str()),
                ),
            ),
            Some(_) => {}
        }
    }
}

/// Both ends of every coordination structure must be there and agree on the requests.
fn check_partners(net: &Net, nets: &[Arc<Net>], findings: &mut Findings) {
    for side in net.coordinators() {
        let Some(other) = find(nets, &side.net) else {
            findings.push(unknown_net(&side.net, &side.at, nets));
            continue;
        };
        let Some(serves) = other
            .serves()
            .iter()
            .find(|serves| serves.net == net.name())
        else {
            findings.push(
                Finding::error(
                    "pnt::app::not_served",
                    format!("net `{}` does not serve net `{}`", side.net, net.name()),
                )
                .at(side.at.clone())
                .help(format!(
                    "add a line `serves {} : ... ; done ...` to net `{}`",
                    net.name(),
                    side.net
                )),
            );
            continue;
        };
        for (request, at) in &side.requests {
            if !serves.requests.iter().any(|(served, _)| served == request) {
                findings.push(
                    Finding::error(
                        "pnt::app::unknown_request",
                        format!("net `{}` does not serve the request `{request}`", side.net),
                    )
                    .at(at.clone())
                    .suggest(
                        request,
                        serves.requests.iter().map(|(served, _)| served.as_str()),
                    ),
                );
            }
        }
    }
    for side in net.serves() {
        let Some(other) = find(nets, &side.net) else {
            findings.push(unknown_net(&side.net, &side.at, nets));
            continue;
        };
        let asked = other
            .coordinators()
            .iter()
            .find(|asks| asks.net == net.name());
        for (request, at) in &side.requests {
            let used = asked.is_some_and(|a| a.requests.iter().any(|(name, _)| name == request));
            if !used {
                findings.push(
                    Finding::warning(
                        "pnt::app::never_asked",
                        format!("net `{}` never asks for `{request}`", side.net),
                    )
                    .at(at.clone())
                    .help("remove the request, or ask for it"),
                );
            }
        }
    }
}

/// Requests without failure branch to coordinators that can fail: the analysis would take it that
/// one of the tries succeeds at some time.
fn check_retries(net: &Net, nets: &[Arc<Net>], findings: &mut Findings) {
    for transition in net.transitions() {
        if transition.part != (Part::Fail { branch: false }) {
            continue;
        }
        let coordinator = transition
            .outputs
            .remote
            .iter()
            .find(|arc| arc.role == Role::Coordination);
        let can_fail = coordinator
            .and_then(|arc| find(nets, &arc.net))
            .is_some_and(|other| other.transition("tf_failed").is_some());
        if can_fail {
            findings.push(
                Finding::warning(
                    "pnt::app::asked_for_ever",
                    "a request that fails is asked again at once, as often as it fails",
                )
                .at(transition.at.clone())
                .help("add a `fail` line that says what to do when the coordinator has given up"),
            );
        }
    }
}

/// Ways in which the places that a transition empties may be filled, as many as are distinguished.
const MOST_RESETS: u64 = 4096;

/// Where a place reserves space for actions, what a reset arc takes out depends on the tokens there.
/// So each number of tokens becomes a step of its own.
fn check_resets(net: &Net, findings: &mut Findings) {
    for transition in net.transitions() {
        let ways = transition.resets.iter().map(|id| {
            let place = &net[*id];
            let kept = place.capacity.filter(|_| build::keeps_room(net, *id));
            kept.map_or(1, |capacity| u64::from(capacity) + 1)
        });
        if ways.fold(1, u64::saturating_mul) > MOST_RESETS {
            findings.push(
                Finding::error(
                    "pnt::app::wide_reset",
                    format!(
                        "transition `{}` empties places of large capacity in which actions are kept room: too many cases to look at",
                        transition.written()
                    ),
                )
                .at(transition.at.clone())
                .help(format!("let the capacities be smaller, {MOST_RESETS} cases together at most, or leave them away")),
            );
        }
    }
}

/// The arcs of all nets to places of others, by the name of the other.
fn arriving(nets: &[Arc<Net>]) -> BTreeMap<&str, Vec<&RemoteArc>> {
    let mut arriving: BTreeMap<&str, Vec<&RemoteArc>> = BTreeMap::new();
    let all = nets.iter().flat_map(|net| outputs(net));
    for arc in all.flat_map(|outputs| &outputs.remote) {
        arriving.entry(&arc.net).or_default().push(arc);
    }
    arriving
}

/// Declared places that no arc touches.
fn check_unused(net: &Net, arriving: &BTreeMap<&str, Vec<&RemoteArc>>, findings: &mut Findings) {
    let mut used = vec![false; net.places().len()];
    for transition in net.transitions() {
        let fail = transition.fail.iter().flat_map(|outputs| &outputs.local);
        let arcs = transition.inputs.iter().chain(&transition.reads);
        let arcs = arcs
            .chain(&transition.inhibitors)
            .chain(&transition.outputs.local);
        for arc in arcs.chain(fail) {
            used[arc.place.index()] = true;
        }
    }
    for arc in arriving.get(net.name()).into_iter().flatten() {
        if let Some(place) = net.place(&arc.place) {
            used[place.index()] = true;
        }
    }
    let unused = net.places().iter().zip(used);
    let unused = unused.filter(|(place, used)| !used && place.role == Role::Declared);
    let finding = |(place, _): (&Place, bool)| {
        let text = format!("no transition uses the place `{}`", place.name);
        Finding::warning("pnt::app::unused_place", text)
            .at(place.at.clone())
            .help("remove it, or name it in a transition")
    };
    push_some(unused.map(finding), findings);
}

/// How many findings of one kind about one net are reported; each costs as much as there are before it.
const MOST_ALIKE: usize = 200;

/// Tells findings of one kind, or of very many the first, and how many there are.
pub(crate) fn push_some(alike: impl Iterator<Item = Finding>, findings: &mut Findings) {
    let mut alike = alike;
    for finding in alike.by_ref().take(MOST_ALIKE) {
        findings.push(finding);
    }
    if let Some(mut more) = alike.next() {
        let others = alike.count();
        more.message = format!("{}, and so for {others} more", more.message);
        findings.push(more);
    }
}
