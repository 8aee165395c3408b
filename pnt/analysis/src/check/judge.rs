//! What is wrong with nets, judged by what was found about their markings.

use ctos::diagnostic::{Finding, Findings};
use pnt_language::net::{Command, Part, Transition};

use super::{
    ending::End,
    proof::{Counterexample, DEADLOCK, NOT_PROVED, Rule},
    words::Words,
};
use crate::{
    analysis::{
        explicit::{Reached, Stopped},
        model::Model,
        verdict::{Engine, Looked},
    },
    compose::{Step, System, push_some},
};

/// What was looked at, to be judged.
pub(super) struct Judge<'a> {
    pub(super) system: &'a System,
    pub(super) model: &'a Model,
    pub(super) rule: Rule,
    pub(super) looked: &'a Looked<'a>,
    /// Where tapes are given.
    pub(super) end: Option<&'a End>,
    pub(super) deadlocks: usize,
}

/// A finding and the sequence that shows it.
type Found = (Finding, Option<Counterexample>);

impl<'a> Judge<'a> {
    fn words(&self) -> Words<'a> {
        Words {
            system: self.system,
            model: self.model,
        }
    }

    pub(super) fn findings(&self, counterexamples: &mut Vec<Counterexample>) -> Findings {
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
        self.unwritten(&mut findings);
        findings
    }

    /// A shortest way to a marking that was found, and that in words.
    fn way_to(&self, code: &'static str, marking: &[u32]) -> (Counterexample, String) {
        let sequence = self.looked.explored.path(marking).unwrap_or_default();
        let words = self.words().after(&sequence);
        let counterexample = Counterexample {
            code,
            sequence,
            round: Vec::new(),
            marking: marking.to_vec(),
        };
        (counterexample, words)
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
                "`{}` can collect tokens without bound: {}, each round of {} adds to it",
                place.name,
                self.words().after(&growth.lead),
                self.words().steps(&growth.cycle)
            ),
        )
        .at(place.at.clone())
        .label("this place grows")
        .help("let the round take back the token it adds, or bound it with a semaphore place; docs/authoring-nets.md (Counters) shows how a net counts");
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
            return vec![self.dead_finding(counterexample, &self.words().after(sequence), &others)];
        }
        let symbolic = self.looked.verdict.engine == Engine::Symbolic;
        if symbolic && self.looked.verdict.deadlocks > 0 {
            // There are some, and the way to the nearest took too long.
            let text = format!(
                "there is a deadlock: {} of {} markings are dead",
                self.looked.verdict.deadlocks, self.looked.verdict.markings
            );
            let help = "a way to one is shown with `--engine explicit`";
            return vec![(Finding::error(DEADLOCK, text).help(help), None)];
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
        let (none, help) = match self.words().asks_functions() {
            true => (
                "no transition is sure to fire",
                "give this marking a way on; a single `when` may stay false for ever, so pair it with its negation",
            ),
            false => (
                "no transition can fire",
                "give this marking a way on: a transition that can fire there, or fewer ways into it",
            ),
        };
        let finding = Finding::error(
            DEADLOCK,
            format!(
                "{}: {way}, the marking is {}; {none}{others}",
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
        let finding = self.words().at_marking(finding, marking, true);
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
                "rest can get out of reach: {way}, the marking is {}; no way leads back to the initial marking",
                self.system.marking_name(marking)
            ),
        )
        .help("look for a token that is lost or left over, or a command that gets no answer");
        let finding = self.words().at_marking(finding, marking, false);
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
                "what is on the tape can get impossible to finish: {way}, the marking is {}; no way leads to its end with every command answered",
                self.system.marking_name(marking)
            ),
        )
        .help("look for a command that gets no answer, or give another tape");
        let finding = self.words().at_marking(finding, marking, false);
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
                    "tokens of `{}.{}` can find no room in `{}`, which refuses them, and their net stops: {way}",
                    sender.name(),
                    transition.written(),
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
                "transition `{}` can write `{symbol}` when no command waits for it: {way}",
                transition.written(),
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
            let never = match transition.part {
                Part::Whole | Part::Start | Part::Return => "fire",
                Part::End => "complete",
                Part::Fail { .. } => "fail",
            };
            let text = format!("transition `{}` can never {never}", transition.written());
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

    /// Answers that no transition writes: probably one was forgotten.
    fn unwritten(&self, findings: &mut Findings) {
        let commands = self.system.nets().iter().flat_map(|net| {
            let commands = net.commands().iter();
            commands.map(move |command| (net, command))
        });
        let answers = commands.flat_map(|(net, command)| {
            let written = move |answer: &&String| {
                let mut writes = net.transitions().iter().map(|one| one.write.as_ref());
                writes.any(|write| write == Some(*answer))
            };
            let unwritten = command
                .answers
                .iter()
                .filter(move |answer| !written(answer));
            unwritten.map(move |answer| (command, answer))
        });
        let finding = |(command, answer): (&Command, &String)| {
            let symbol = &command.symbol;
            let text = format!("no transition writes `{answer}`, an answer of `{symbol}`");
            Finding::warning("pnt::check::never_written", text)
                .at(command.at.clone())
                .help("write it where the command is done, or take it off the `command` line")
        };
        push_some(answers.map(finding), findings);
    }
}
