//! Building the composed system's places and steps.

use std::{collections::BTreeMap, sync::Arc};

use super::{Phase, Stands, Step, System, SystemPlace, SystemPlaceId, sender};
use pnt_language::net::{
    self, CommandId, Net, Outputs, PlaceId, Servers, Transition, TransitionId,
};

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
        watched: Vec::new(),
        net: 0,
        functions: BTreeMap::new(),
    };
    for net in nets {
        builder.places(net);
        builder.net += 1;
    }
    builder.watched = nets.iter().map(|net| watched(net)).collect();
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
    /// Per place in which capacity is reserved for actions: what it holds and is promised.
    filled: BTreeMap<PlaceId, SystemPlaceId>,
    /// One for each transition that has an action.
    firings: BTreeMap<TransitionId, SystemPlaceId>,
    /// Per transition whose firing may put its command back while another has answered it: whether one of
    /// its firings still has the command in progress.
    holders: BTreeMap<TransitionId, SystemPlaceId>,
    /// Idle; then on tape and in progress, per command.
    tape: SystemPlaceId,
}

struct Builder {
    system: System,
    bases: Vec<Bases>,
    /// Per net and place, whether more tokens may keep something from firing.
    watched: Vec<Vec<bool>>,
    /// The net in hand.
    net: usize,
    functions: BTreeMap<(usize, String), usize>,
}

impl Builder {
    fn places(&mut self, net: &Net) {
        let mut bases = Bases {
            places: self.system.places.len(),
            filled: BTreeMap::new(),
            firings: BTreeMap::new(),
            holders: BTreeMap::new(),
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
        for (id, place) in (0..).map(PlaceId).zip(net.places()) {
            if place.capacity.is_some() && keeps_room(net, id) {
                bases.filled.insert(id, self.system.places.len());
                let shown = format!("filled of {name}.{}", place.name);
                self.place(Stands::Filled(id), shown, &place.at, place.tokens);
                if let Some(last) = self.system.places.last_mut() {
                    last.capacity = place.capacity;
                }
                self.system.places[bases.places + id.index()].capacity = None;
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
        for (id, transition) in (0..).map(TransitionId).zip(net.transitions()) {
            if may_be_answered_for(net, id) {
                bases.holders.insert(id, self.system.places.len());
                let shown = format!("command of {name}.{}", transition.written());
                self.place(Stands::Holds(id), shown, &transition.at, 0);
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

    /// What a firing of a transition puts at its end; what must take its time to other nets is then on
    /// its way.
    fn outputs(&mut self, id: TransitionId, outputs: &Outputs) -> Vec<(SystemPlaceId, u32)> {
        let mut puts = self.local(&outputs.local);
        let mut messages: BTreeMap<usize, Vec<(PlaceId, u32)>> = BTreeMap::new();
        let nets = self.system.nets.clone();
        for arc in &outputs.remote {
            let Some(other) = nets.iter().position(|net| net.name() == arc.net) else {
                continue;
            };
            let place = nets[other].place(&arc.place);
            let message = messages.entry(other).or_default();
            message.extend(place.map(|place| (place, arc.weight)));
        }
        for (other, message) in messages {
            if message
                .iter()
                .any(|(place, _)| self.watched[other][place.index()])
            {
                puts.push((self.on_the_way(id, other, &message), 1));
            } else {
                let base = self.bases[other].places;
                puts.extend(message.iter().map(|(place, w)| (base + place.index(), *w)));
            }
        }
        puts
    }

    /// The place of a message on its way, with the steps of its arrival.
    fn on_the_way(
        &mut self,
        id: TransitionId,
        other: usize,
        message: &[(PlaceId, u32)],
    ) -> SystemPlaceId {
        let (from, to) = (&self.system.nets[self.net], &self.system.nets[other]);
        let shown = format!("tokens of {} for {}", sender(from, &from[id]), to.name());
        let (at, to) = (from[id].at.clone(), Arc::clone(to));
        let way = self.system.places.len();
        self.place(Stands::OnTheWay(id), shown, &at, 0);
        let mut sums: BTreeMap<PlaceId, u32> = BTreeMap::new();
        for (place, weight) in message {
            let sum = sums.entry(*place).or_default();
            *sum = sum.saturating_add(*weight);
        }
        let base = &self.bases[other];
        let mut arrival = Draft {
            takes: vec![(way, 1)],
            ..Draft::default()
        };
        let mut refusals = Vec::new();
        for (place, weight) in sums {
            let tokens = base.places + place.index();
            arrival.puts.push((tokens, weight));
            let filled = base.filled.get(&place).copied();
            arrival.puts.extend(filled.map(|filled| (filled, weight)));
            if let Some(capacity) = to[place].capacity {
                // Too full when it already holds so many.
                let full = (capacity.saturating_add(1)).saturating_sub(weight);
                refusals.push((tokens, filled.unwrap_or(tokens), full));
            }
        }
        let bare = self.transition_of(id);
        self.step(id, &bare, Phase::Arrive(other), arrival, false);
        for (place, held, full) in refusals {
            let refusal = Draft {
                takes: vec![(way, 1)],
                reads: (full > 0).then_some((held, full)).into_iter().collect(),
                ..Draft::default()
            };
            self.step(id, &bare, Phase::Arrive(other), refusal, false);
            if let Some(step) = self.system.steps.last_mut() {
                step.overfills = Some(place);
            }
        }
        way
    }

    fn transition_of(&self, id: TransitionId) -> Transition {
        self.system.nets[self.net][id].clone()
    }

    /// Keeps up what the places with reserved capacity hold and are promised.
    fn fill(&self, transition: &Transition, phase: Phase, branch: bool, draft: &mut Draft) {
        for (place, filled) in &self.base().filled {
            let around = Around::of(transition, *place);
            let (takes, puts) = match phase {
                Phase::Fire => (around.takes, around.completes),
                Phase::Start => (around.takes, around.claim()),
                Phase::Complete => (around.claim(), around.completes),
                Phase::Fail if branch => (around.claim(), around.fails),
                Phase::Fail => (around.claim(), around.takes),
                Phase::Put(_) | Phase::Arrive(_) | Phase::End => (0, 0),
            };
            for (list, weight) in [(&mut draft.takes, takes), (&mut draft.puts, puts)] {
                if weight > 0 {
                    list.push((*filled, weight));
                }
            }
        }
    }

    /// A step for each way in which the places with reserved capacity that it empties may be filled.
    fn resets_apart(&self, net: &Net, transition: &Transition, draft: Draft) -> Vec<Draft> {
        let mut drafts = vec![draft];
        for id in &transition.resets {
            let (Some(filled), Some(capacity)) =
                (self.base().filled.get(id).copied(), net[*id].capacity)
            else {
                continue;
            };
            let place = self.base().places + id.index();
            let around = Around::of(transition, *id);
            let least = around.takes.max(around.reads);
            drafts = drafts
                .iter()
                .flat_map(|draft| {
                    (least..=capacity).map(move |held| {
                        let mut draft = draft.clone();
                        draft.resets.retain(|reset| *reset != place);
                        draft.reads.retain(|(read, _)| *read != place);
                        draft
                            .takes
                            .retain(|(taken, _)| *taken != place && *taken != filled);
                        if held > 0 {
                            draft.takes.extend([(place, held), (filled, held)]);
                        }
                        draft.forbids.push((place, held.saturating_add(1)));
                        draft
                    })
                })
                .collect();
        }
        drafts
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
        let puts = self.outputs(id, &transition.outputs);
        let Some(firing) = self.base().firings.get(&id).map(|place| (*place, 1)) else {
            first.puts = puts;
            self.fill(transition, Phase::Fire, false, &mut first);
            for first in self.resets_apart(net, transition, first) {
                self.ending(net, id, transition, Phase::Fire, first);
            }
            return;
        };
        if let Some(command) = transition.tape {
            first.puts.push((self.in_progress(command), 1));
        }
        first.puts.push(firing);
        let holder = self.base().holders.get(&id).copied();
        first.puts.extend(holder.map(|holder| (holder, 1)));
        if let Servers::Limit(limit) = transition.servers {
            first.forbids.push((firing.0, limit.get()));
        }
        self.fill(transition, Phase::Start, false, &mut first);
        for first in self.resets_apart(net, transition, first) {
            self.step(id, transition, Phase::Start, first, false);
        }
        let mut complete = Draft {
            takes: vec![firing],
            puts,
            ..Draft::default()
        };
        self.fill(transition, Phase::Complete, false, &mut complete);
        for complete in self.with_or_without_command(id, complete) {
            self.ending(net, id, transition, Phase::Complete, complete);
        }
        self.failure(id, transition, firing);
    }

    /// The end of a firing that has its command still, and that of one whose command another transition
    /// has answered.
    fn with_or_without_command(&self, id: TransitionId, end: Draft) -> Vec<Draft> {
        let base = self.base();
        let (Some(holder), Some(firing)) = (base.holders.get(&id), base.firings.get(&id)) else {
            return vec![end];
        };
        let (mut with, mut none_has, mut other_has) = (end.clone(), end.clone(), end);
        with.takes.push((*holder, 1));
        none_has.forbids.push((*holder, 1));
        other_has.reads.extend([(*holder, 1), (*firing, 2)]);
        vec![with, none_has, other_has]
    }

    fn failure(&mut self, id: TransitionId, transition: &Transition, firing: (SystemPlaceId, u32)) {
        let mut fail = Draft {
            takes: vec![firing],
            ..Draft::default()
        };
        self.fill(
            transition,
            Phase::Fail,
            transition.fail.is_some(),
            &mut fail,
        );
        if let Some(branch) = &transition.fail {
            let puts = self.outputs(id, branch);
            fail.puts.extend(puts);
        } else {
            fail.puts.extend(self.local(&transition.inputs));
            if let Some(command) = transition.tape {
                let back = |mut fail: Draft| {
                    fail.takes.push((self.in_progress(command), 1));
                    fail.puts.push((self.on_tape(command), 1));
                    fail
                };
                // If the command was answered meanwhile, its symbol does not go back.
                let mut ends = self.with_or_without_command(id, fail).into_iter();
                let with = ends.next().map(back);
                let ends: Vec<Draft> = with.into_iter().chain(ends).collect();
                for end in ends {
                    self.step(id, transition, Phase::Fail, end, false);
                }
                return;
            }
        }
        self.step(id, transition, Phase::Fail, fail, false);
    }

    /// The step that puts a transition's outputs. It has one variant for each command that the
    /// symbol it writes may answer, and one for none of them being in progress.
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
            for step in self.whoever_has(net, command, step) {
                self.step(id, transition, phase, step, false);
            }
            unasked.forbids.push((self.in_progress(command), 1));
        }
        self.step(id, transition, phase, unasked, true);
    }

    /// A step that answers a command: which firing had it has it no more.
    fn whoever_has(&self, net: &Net, command: CommandId, step: Draft) -> Vec<Draft> {
        let holders = self.base().holders.iter();
        let holders = holders.filter(|(id, _)| net[**id].tape == Some(command));
        let holders: Vec<SystemPlaceId> = holders.map(|(_, holder)| *holder).collect();
        // The end of the firing that has it has taken that already.
        if step.takes.iter().any(|(place, _)| holders.contains(place)) {
            return vec![step];
        }
        let mut steps = Vec::new();
        let mut nobody = step.clone();
        for holder in holders {
            let mut one = step.clone();
            // The end of another firing of the same transition only looks whether one has it.
            one.reads.retain(|(place, _)| *place != holder);
            one.takes.push((holder, 1));
            nobody.forbids.push((holder, 1));
            steps.push(one);
        }
        steps.push(nobody);
        steps
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
            overfills: None,
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
                overfills: None,
            });
        }
    }
}

/// Added to the priority of immediate transitions of a net that has timed ones as well.
const BEFORE_TIMED: u32 = 1 << 31;

/// How urgent a transition is among all of its net.
fn urgency(all: &[Transition], transition: &Transition) -> u32 {
    // A transition with an action starts at once, whatever time its action is taken to last.
    let timed = |t: &Transition| !t.timing.is_immediate() && t.action.is_none();
    if all.iter().any(timed) && !timed(transition) {
        transition.priority.saturating_add(BEFORE_TIMED)
    } else {
        transition.priority.min(BEFORE_TIMED - 1)
    }
}

/// The arcs between a transition and one place of its net, those of a kind added up.
struct Around {
    takes: u32,
    reads: u32,
    completes: u32,
    fails: u32,
    /// Whether there is an action between taking and putting.
    acts: bool,
}

impl Around {
    fn of(transition: &Transition, place: PlaceId) -> Self {
        let sum = |arcs: &[net::Arc]| {
            let arcs = arcs.iter().filter(|arc| arc.place == place);
            arcs.fold(0, |sum: u32, arc| sum.saturating_add(arc.weight))
        };
        let reads = transition.reads.iter().filter(|arc| arc.place == place);
        Self {
            takes: sum(&transition.inputs),
            reads: reads.map(|arc| arc.weight).max().unwrap_or(0),
            completes: sum(&transition.outputs.local),
            fails: transition
                .fail
                .as_ref()
                .map_or(0, |branch| sum(&branch.local)),
            acts: transition.action.is_some(),
        }
    }

    /// What a running firing may put, for which capacity is reserved.
    fn claim(&self) -> u32 {
        self.completes.max(self.fails).max(self.takes)
    }
}

/// Whether a firing of a transition may still go on when another transition has answered its command, and
/// would then not put it back.
fn may_be_answered_for(net: &Net, id: TransitionId) -> bool {
    let reader = &net[id];
    let Some(command) = reader
        .tape
        .filter(|_| reader.action.is_some() && reader.fail.is_none())
    else {
        return false;
    };
    let answers = |t: &Transition| {
        let symbol = t.write.as_ref();
        symbol.is_some_and(|symbol| net[command].answers.contains(symbol))
    };
    let transitions = (0..).map(TransitionId).zip(net.transitions());
    transitions
        .into_iter()
        .any(|(other, t)| other != id && answers(t))
}

/// Whether capacity of a place, if it has any limit, may be reserved for a running firing.
pub(super) fn keeps_room(net: &Net, place: PlaceId) -> bool {
    net.transitions().iter().any(|transition| {
        let around = Around::of(transition, place);
        around.acts && around.claim() > 0
    })
}

/// Per place of a net, whether more tokens there may keep a transition from firing: then it matters when
/// tokens of other nets come.
fn watched(net: &Net) -> Vec<bool> {
    let mut watched: Vec<bool> = net.places().iter().map(|p| p.capacity.is_some()).collect();
    let transitions = net.transitions();
    let lowest = transitions.iter().map(|t| urgency(transitions, t)).min();
    for transition in transitions {
        let looks = transition.inhibitors.iter().map(|arc| arc.place);
        let looks = looks.chain(transition.resets.iter().copied());
        let calls = transition.inputs.iter().chain(&transition.reads);
        let urgent = Some(urgency(transitions, transition)) > lowest;
        let calls = calls.map(|arc| arc.place).filter(|_| urgent);
        for place in looks.chain(calls) {
            watched[place.index()] = true;
        }
    }
    watched
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
