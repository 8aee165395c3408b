//! What the nets of an app prove before anything moves. They are bounded, have no end but rest, and
//! use every transition. Rest is always within reach, and every command is answered by one of its
//! output symbols. What they do not prove becomes findings that point into the net texts.

pub mod commands;
mod ending;
mod functions;
mod judge;
pub mod objects;
mod proof;
pub mod tapes;
mod words;

#[cfg(test)]
mod tests;

use std::{collections::BTreeSet, sync::Arc};

use ctos::diagnostic::{Finding, Findings};
use ending::end;
use judge::Judge;
use pnt_language::{compile::endless, net::Net};

use crate::{
    analysis::{
        cover::cover,
        explicit::{Progress, Stopped},
        model::Model,
        question::Question,
        verdict::{Engines, Looked, list, look, look_for_deadlock},
    },
    compose::System,
};

pub use crate::analysis::explicit::Limits;
pub use functions::{FunctionNames, functions};
pub use proof::{Answered, Asks, Counterexample, NOT_PROVED, Options, Proof, Rule};
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
    let Options {
        rule, limits, boot, ..
    } = *options;
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
    let (looked, beyond_boot) = look_as_boot_first(&model, options, progress);
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
    let mut proof = Proof {
        cover: grows.and_then(|_| cover(&model, COVER_NODES)),
        grows,
        workflows,
        answers,
        system,
        model,
        verdict,
        findings,
        counterexamples,
    };
    if beyond_boot && proof.sound() == Some(true) {
        let markings = proof.verdict.markings;
        proof.findings.push(too_large(&boot, markings));
    }
    Ok(proof)
}

/// What is seen of nets, and whether the check before a boot sees less. Of nets that are to be run, it first sees
/// what that check sees, in the same way, so that both say the same.
fn look_as_boot_first<'a>(
    model: &'a Model,
    options: &Options,
    progress: &mut dyn FnMut(&Progress),
) -> (Looked<'a>, bool) {
    let Options {
        rule,
        limits,
        boot,
        engines,
        ..
    } = *options;
    // The report about nets with a tape, and of several dead markings, needs the markings one by one.
    let one_by_one = rule == Rule::Rest || !options.questions.is_empty() || options.deadlocks > 1;
    let all = |progress: &mut dyn FnMut(&Progress)| match one_by_one {
        true => list(model, &limits, progress),
        false => look(model, &limits, engines, progress),
    };
    if rule == Rule::Closed {
        return (all(progress), false);
    }
    if !one_by_one && engines == Engines::Symbolic {
        let looked = all(progress);
        let beyond = looked.verdict.markings > boot.markings as u128;
        return (looked, beyond);
    }
    let first = Limits {
        markings: limits.markings.min(boot.markings),
        bytes: limits.bytes.min(boot.bytes),
        ..limits
    };
    let mut looked = list(model, &first, progress);
    let ended = match looked.verdict.stopped {
        None => looked.returns.is_none() && !limits.stop.is_set(),
        Some(stopped) => matches!(stopped, Stopped::Markings | Stopped::Bytes),
    };
    if !ended {
        return (looked, false);
    }
    if first == limits && (one_by_one || engines == Engines::Explicit) {
        if !one_by_one {
            look_for_deadlock(&mut looked, &limits, progress);
        }
        return (looked, false);
    }
    drop(looked);
    let beyond = first.markings == boot.markings && first.bytes == boot.bytes;
    (all(progress), beyond)
}

/// Nets that are sound, but not for the check before a boot.
fn too_large(boot: &Limits, markings: u128) -> Finding {
    let text = format!(
        "an app with these nets does not boot: its check looks at no more than {} markings in {} MiB, and they have {markings}",
        boot.markings,
        boot.bytes >> 20,
    );
    Finding::warning("pnt::check::too_large", text)
        .help("bound what can be in flight with semaphore places, or split the nets where they ask each other")
}

/// The nets in groups: those that name each other, directly or through others, are together. Each group is sound
/// or not by itself.
#[must_use]
pub fn systems(nets: &[Arc<Net>]) -> Vec<Vec<Arc<Net>>> {
    type Named<'n> = (&'n Arc<Net>, BTreeSet<&'n str>);
    let mut groups: Vec<Vec<Named<'_>>> = Vec::new();
    for net in nets {
        let named = (net, named(net));
        let (with, mut without): (Vec<_>, Vec<_>) = groups
            .into_iter()
            .partition(|group| group.iter().any(|other| know(&named, other)));
        let mut together: Vec<Named<'_>> = with.into_iter().flatten().collect();
        together.push(named);
        without.push(together);
        groups = without;
    }
    let whole = |group: Vec<Named<'_>>| group.into_iter().map(|(net, _)| Arc::clone(net)).collect();
    groups.into_iter().map(whole).collect()
}

/// The other nets that a net names.
fn named(net: &Net) -> BTreeSet<&str> {
    let partners = net.coordinators().iter().chain(net.serves());
    let partners = partners.map(|partner| partner.net.as_str());
    partners.chain(net.remote_nets()).collect()
}

/// Whether one of two nets names the other.
fn know(one: &(&Arc<Net>, BTreeSet<&str>), other: &(&Arc<Net>, BTreeSet<&str>)) -> bool {
    one.1.contains(other.0.name()) || other.1.contains(one.0.name())
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

/// What keeps nets from being put together, and warnings about that; the check looks at no marking.
#[must_use]
pub fn fit(nets: &[Arc<Net>]) -> Findings {
    System::fit(nets)
}
