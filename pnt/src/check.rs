//! What the nets of an app prove before anything moves: bounded, no end but rest, every transition
//! of use, rest always within reach, every command answered by one of its output symbols. What they
//! do not prove becomes findings that point into the net texts.

#[cfg(test)]
mod tests;

use std::{collections::BTreeSet, sync::Arc};

use ctos::diagnostic::{Finding, Findings, Place as At};

use crate::{
    compose::{Phase, Stands, System, SystemPlace},
    net::{Action, Net, Part},
    space::{self, Limits, Space},
};

/// Steps of a firing sequence that are shown; the ones before are counted.
const SHOWN_STEPS: usize = 16;

/// What was looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Report {
    /// Reachable markings.
    pub markings: usize,
    /// Edges between them.
    pub edges: usize,
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
                "enabling function",
                &when.function,
                &when.at,
                &names.enabling,
            );
        }
        if let Some(Action::Local { function, at, .. }) = &transition.action {
            unknown("local function", function, at, &names.actions);
        }
    }
}

/// Composes the nets of an app and checks them. The markings are only explored when the nets fit
/// together.
#[must_use]
pub fn check(nets: &[Arc<Net>], limits: &Limits) -> (Report, Findings) {
    let (system, mut findings) = System::compose(nets);
    if findings.has_errors() {
        let report = Report {
            markings: 0,
            edges: 0,
            proved: false,
        };
        return (report, findings);
    }
    let space = space::explore(&system, limits);
    let judge = Judge {
        system: &system,
        space: &space,
    };
    findings.extend(judge.findings());
    let report = Report {
        markings: space.markings,
        edges: space.edges,
        proved: space.complete,
    };
    (report, findings)
}

struct Judge<'a> {
    system: &'a System,
    space: &'a Space,
}

impl Judge<'_> {
    fn findings(&self) -> Findings {
        let mut findings = Findings::new();
        let errors = [
            self.growth(),
            self.dead(),
            self.unasked(),
            self.trapped(),
            self.unproved(),
        ];
        for finding in errors.into_iter().flatten() {
            findings.push(finding);
        }
        if self.space.complete {
            self.never(&mut findings);
        }
        findings
    }

    fn steps(&self, path: &[usize]) -> String {
        if path.is_empty() {
            return "nothing".to_owned();
        }
        let skipped = path.len().saturating_sub(SHOWN_STEPS);
        let names: Vec<String> = path
            .iter()
            .skip(skipped)
            .filter_map(|number| self.system.steps().get(*number))
            .map(|step| self.system.step_name(step).to_string())
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
                let declared = net.is_some_and(|net| net[id].role == crate::net::Role::Declared);
                if declared { 0 } else { 2 }
            }
            Stands::OnTape(_) | Stands::Firing(_) => 1,
            Stands::InProgress(_) => 3,
            Stands::Idle => 4,
        };
        self.system
            .places()
            .iter()
            .zip(marking)
            .filter(|(place, tokens)| **tokens > place.tokens)
            .map(|(place, _)| place)
            .min_by_key(|place| importance(place))
    }

    fn at_marking(&self, finding: Finding, marking: &[u32]) -> Finding {
        let emptied = || {
            let pairs = self.system.places().iter().zip(marking);
            pairs
                .filter(|(place, tokens)| **tokens < place.tokens)
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
        let growth = self.space.growth.as_ref()?;
        let place = self.system.places().get(growth.place)?;
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

    fn dead(&self) -> Option<Finding> {
        let dead = *self.space.dead.first()?;
        let path = self.space.path(dead);
        let marking = Space::replay(self.system, &path);
        let others = match self.space.dead.len() {
            1 => String::new(),
            count => format!(" ({count} such markings in all)"),
        };
        let finding = Finding::error(
            "pnt::check::deadlock",
            format!(
                "the nets can stop short of rest: after {} the marking is {}, and no transition is sure to fire{others}",
                self.steps(&path),
                self.system.marking_name(&marking)
            ),
        )
        .help("give this marking a way on; a single `when` may stay false for ever, so pair it with its negation");
        Some(self.at_marking(finding, &marking))
    }

    fn trapped(&self) -> Option<Finding> {
        // A dead end is the clearer finding.
        if !self.space.dead.is_empty() {
            return None;
        }
        let path = self.space.path(self.space.trapped?);
        let marking = Space::replay(self.system, &path);
        let finding = Finding::error(
            "pnt::check::no_return",
            format!(
                "rest can get out of reach: after {} the marking is {}, and no way leads back to the initial marking",
                self.steps(&path),
                self.system.marking_name(&marking)
            ),
        )
        .help("look for a token that is lost or left over, or a command that gets no answer");
        Some(self.at_marking(finding, &marking))
    }

    fn unasked(&self) -> Option<Finding> {
        let (marking, number) = self.space.unasked?;
        let step = self.system.steps().get(number)?;
        let transition = &self.system.nets().get(step.net)?[step.transition?];
        let symbol = transition.write.as_deref().unwrap_or_default();
        Some(
            Finding::error(
                "pnt::check::answer",
                format!(
                    "transition `{}` can write `{symbol}` when no command waits for it: after {}",
                    transition.name,
                    self.steps(&self.space.path(marking))
                ),
            )
            .at(transition.at.clone())
            .help(
                "each command is answered once, by one of the output symbols of its `command` line",
            ),
        )
    }

    fn unproved(&self) -> Option<Finding> {
        if self.space.complete || self.space.growth.is_some() {
            return None;
        }
        let place = self.system.places().iter().zip(&self.space.bounds);
        let (place, bound) = place.max_by_key(|(_, bound)| **bound)?;
        Some(
            Finding::error(
                "pnt::check::not_proved",
                format!(
                    "not proved: more than {} markings; `{}` has held up to {bound} tokens so far",
                    self.space.markings, place.name
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
        let nets = self.system.nets();
        let mut fired: BTreeSet<(usize, usize)> = BTreeSet::new();
        for (step, seen) in self.system.steps().iter().zip(&self.space.seen) {
            let begins = matches!(step.phase, Phase::Fire | Phase::Start);
            if let (true, true, Some(id)) = (*seen, begins, step.transition) {
                fired.insert((step.net, id.index()));
            }
        }
        for (net_index, net) in nets.iter().enumerate() {
            for (index, transition) in net.transitions().iter().enumerate() {
                let generated =
                    matches!(transition.part, Part::Return | Part::Fail { branch: false });
                if !generated && !fired.contains(&(net_index, index)) {
                    findings.push(
                        Finding::warning(
                            "pnt::check::never_fires",
                            format!("transition `{}` can never fire", transition.name),
                        )
                        .at(transition.at.clone())
                        .help("nothing ever marks its input places together; check their names and weights"),
                    );
                }
            }
        }
    }
}
