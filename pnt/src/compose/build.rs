//! Building the composed system's places and steps.

use std::{collections::BTreeMap, sync::Arc};

use super::{Phase, Stands, Step, System, SystemPlace, SystemPlaceId};
use crate::net::{self, CommandId, Net, Outputs, PlaceId, Transition, TransitionId};

/// Composes nets whose names were checked; arcs that lead nowhere are left out.
pub(super) fn build(nets: &[Arc<Net>]) -> System {
    let mut builder = Builder {
        system: System {
            nets: nets.to_vec(),
            places: Vec::new(),
            steps: Vec::new(),
            functions: 0,
        },
        bases: Vec::new(),
        net: 0,
        functions: BTreeMap::new(),
    };
    for net in nets {
        builder.places(net);
        builder.net += 1;
    }
    builder.net = 0;
    for net in nets {
        for (index, transition) in (0..).zip(net.transitions()) {
            builder.transition(net, TransitionId(index), transition);
        }
        builder.commander(net);
        builder.net += 1;
    }
    builder.system.functions = builder.functions.len();
    builder.system
}

/// First system place of each group of a net's places.
struct Bases {
    places: SystemPlaceId,
    /// One for each transition that has an action.
    firings: BTreeMap<TransitionId, SystemPlaceId>,
    /// Idle; then on tape and in progress, per command.
    tape: SystemPlaceId,
}

struct Builder {
    system: System,
    bases: Vec<Bases>,
    /// The net in hand.
    net: usize,
    functions: BTreeMap<(usize, String), usize>,
}

impl Builder {
    fn places(&mut self, net: &Net) {
        let mut bases = Bases {
            places: self.system.places.len(),
            firings: BTreeMap::new(),
            tape: 0,
        };
        let name = net.name();
        for (index, place) in (0..).zip(net.places()) {
            let shown = format!("{name}.{}", place.name);
            self.place(
                Stands::Place(PlaceId(index)),
                shown,
                &place.at,
                place.tokens,
            );
            if let Some(last) = self.system.places.last_mut() {
                last.capacity = place.capacity;
            }
        }
        for (index, transition) in (0..).zip(net.transitions()) {
            if transition.action.is_some() {
                let id = TransitionId(index);
                bases.firings.insert(id, self.system.places.len());
                let shown = format!("{name}.{} in action", transition.name);
                self.place(Stands::Firing(id), shown, &transition.at, 0);
            }
        }
        bases.tape = self.system.places.len();
        if !net.commands().is_empty() {
            self.place(Stands::Idle, format!("{name} idle"), net.at(), 1);
        }
        for (index, command) in (0..).zip(net.commands()) {
            let id = CommandId(index);
            let shown = format!("{} on the tape of {name}", command.symbol);
            self.place(Stands::OnTape(id), shown, &command.at, 0);
            let shown = format!("{} in progress in {name}", command.symbol);
            self.place(Stands::InProgress(id), shown, &command.at, 0);
        }
        self.bases.push(bases);
    }

    fn place(&mut self, stands: Stands, name: String, at: &ctos::diagnostic::Place, tokens: u32) {
        self.system.places.push(SystemPlace {
            net: self.net,
            stands,
            name,
            at: at.clone(),
            tokens,
            capacity: None,
        });
    }

    fn base(&self) -> &Bases {
        &self.bases[self.net]
    }

    fn idle(&self) -> SystemPlaceId {
        self.base().tape
    }

    fn on_tape(&self, command: CommandId) -> SystemPlaceId {
        self.base().tape + 1 + 2 * command.index()
    }

    fn in_progress(&self, command: CommandId) -> SystemPlaceId {
        self.on_tape(command) + 1
    }

    fn local(&self, arcs: &[net::Arc]) -> Vec<(SystemPlaceId, u32)> {
        let base = self.base().places;
        arcs.iter()
            .map(|arc| (base + arc.place.index(), arc.weight))
            .collect()
    }

    fn resets(&self, transition: &Transition) -> Vec<SystemPlaceId> {
        let base = self.base().places;
        let places = transition.resets.iter();
        places.map(|place| base + place.index()).collect()
    }

    fn outputs(&self, outputs: &Outputs) -> Vec<(SystemPlaceId, u32)> {
        let mut puts = self.local(&outputs.local);
        for arc in &outputs.remote {
            let other = self
                .system
                .nets
                .iter()
                .position(|net| net.name() == arc.net);
            let place = other.and_then(|other| {
                let place = self.system.nets[other].place(&arc.place)?;
                Some(self.bases[other].places + place.index())
            });
            puts.extend(place.map(|place| (place, arc.weight)));
        }
        puts
    }

    fn transition(&mut self, net: &Net, id: TransitionId, transition: &Transition) {
        let mut first = Draft {
            takes: self.local(&transition.inputs),
            reads: self.local(&transition.reads),
            forbids: self.local(&transition.inhibitors),
            resets: self.resets(transition),
            puts: Vec::new(),
        };
        if let Some(command) = transition.tape {
            first.takes.push((self.on_tape(command), 1));
        }
        let puts = self.outputs(&transition.outputs);
        let Some(firing) = self.base().firings.get(&id).map(|place| (*place, 1)) else {
            first.puts = puts;
            self.ending(net, id, transition, Phase::Fire, first);
            return;
        };
        if let Some(command) = transition.tape {
            first.puts.push((self.in_progress(command), 1));
        }
        first.puts.push(firing);
        self.step(id, transition, Phase::Start, first, false);
        let complete = Draft {
            takes: vec![firing],
            puts,
            ..Draft::default()
        };
        self.ending(net, id, transition, Phase::Complete, complete);
        self.failure(id, transition, firing);
    }

    fn failure(&mut self, id: TransitionId, transition: &Transition, firing: (SystemPlaceId, u32)) {
        let mut fail = Draft {
            takes: vec![firing],
            ..Draft::default()
        };
        if let Some(branch) = &transition.fail {
            fail.puts = self.outputs(branch);
        } else {
            fail.puts = self.local(&transition.inputs);
            if let Some(command) = transition.tape {
                // If the command was answered meanwhile, its symbol does not go back.
                let mut answered = fail.clone();
                answered.forbids.push((self.in_progress(command), 1));
                self.step(id, transition, Phase::Fail, answered, false);
                fail.takes.push((self.in_progress(command), 1));
                fail.puts.push((self.on_tape(command), 1));
            }
        }
        self.step(id, transition, Phase::Fail, fail, false);
    }

    /// The step that puts a transition's outputs: one variant for each command that the symbol it
    /// writes may answer, and one for none of them being in progress.
    fn ending(
        &mut self,
        net: &Net,
        id: TransitionId,
        transition: &Transition,
        phase: Phase,
        step: Draft,
    ) {
        let reads_now = transition.tape.filter(|_| phase == Phase::Fire);
        let Some(symbol) = &transition.write else {
            let mut step = step;
            step.puts
                .extend(reads_now.map(|command| (self.in_progress(command), 1)));
            self.step(id, transition, phase, step, false);
            return;
        };
        let answered: Vec<CommandId> = (0..)
            .map(CommandId)
            .zip(net.commands())
            .filter(|(_, command)| command.answers.contains(symbol))
            .map(|(command, _)| command)
            .collect();
        if let Some(command) = reads_now {
            // The command just read is the only one in progress.
            let mut step = step;
            let asked = answered.contains(&command);
            let after = if asked {
                self.idle()
            } else {
                self.in_progress(command)
            };
            step.puts.push((after, 1));
            self.step(id, transition, phase, step, !asked);
            return;
        }
        let mut unasked = step.clone();
        for command in answered {
            let mut step = step.clone();
            step.takes.push((self.in_progress(command), 1));
            step.puts.push((self.idle(), 1));
            self.step(id, transition, phase, step, false);
            unasked.forbids.push((self.in_progress(command), 1));
        }
        self.step(id, transition, phase, unasked, true);
    }

    fn step(
        &mut self,
        id: TransitionId,
        transition: &Transition,
        phase: Phase,
        draft: Draft,
        unasked: bool,
    ) {
        let chosen = matches!(phase, Phase::Fire | Phase::Start);
        let when = transition.when.as_ref().filter(|_| chosen).map(|when| {
            let next = self.functions.len();
            let key = (self.net, when.function.clone());
            (*self.functions.entry(key).or_insert(next), when.negated)
        });
        let urgency = urgency(self.system.nets[self.net].transitions(), transition);
        self.system.steps.push(Step {
            net: self.net,
            transition: Some(id),
            phase,
            takes: summed(&draft.takes),
            reads: draft.reads,
            forbids: draft.forbids,
            resets: draft.resets,
            puts: summed(&draft.puts),
            when,
            priority: chosen.then_some(urgency),
            unasked,
        });
    }

    /// Puts any command when idle.
    fn commander(&mut self, net: &Net) {
        for (index, _) in (0..).zip(net.commands()) {
            let command = CommandId(index);
            self.system.steps.push(Step {
                net: self.net,
                transition: None,
                phase: Phase::Put(command),
                takes: vec![(self.idle(), 1)],
                reads: Vec::new(),
                forbids: Vec::new(),
                resets: Vec::new(),
                puts: vec![(self.on_tape(command), 1)],
                when: None,
                priority: None,
                unasked: false,
            });
        }
    }
}

/// Added to the priority of immediate transitions of a net that has timed ones as well.
const BEFORE_TIMED: u32 = 1 << 31;

/// How urgent a transition is among all of its net.
fn urgency(all: &[Transition], transition: &Transition) -> u32 {
    // What has an action starts at once, whatever time it is taken to last.
    let timed = |t: &Transition| !t.timing.is_immediate() && t.action.is_none();
    if all.iter().any(timed) && !timed(transition) {
        transition.priority.saturating_add(BEFORE_TIMED)
    } else {
        transition.priority.min(BEFORE_TIMED - 1)
    }
}

/// A step before its arcs are added up.
#[derive(Clone, Default)]
struct Draft {
    takes: Vec<(SystemPlaceId, u32)>,
    reads: Vec<(SystemPlaceId, u32)>,
    forbids: Vec<(SystemPlaceId, u32)>,
    resets: Vec<SystemPlaceId>,
    puts: Vec<(SystemPlaceId, u32)>,
}

/// Arcs by place, those of the same place added up.
fn summed(arcs: &[(SystemPlaceId, u32)]) -> Vec<(SystemPlaceId, u32)> {
    let mut sums: BTreeMap<SystemPlaceId, u32> = BTreeMap::new();
    for (place, weight) in arcs {
        let sum = sums.entry(*place).or_default();
        *sum = sum.saturating_add(*weight);
    }
    sums.into_iter().collect()
}
