//! Nets joined into one that has neither actions nor tapes nor other nets, which token game and
//! analysis both run. A firing with an action becomes its start, a place that is marked while it runs,
//! and its end after the transition's time. A tape becomes places and a commander that puts commands.

use std::{collections::BTreeMap, sync::Arc};

use super::error::PerfError;
use pnt_language::net::{
    self, CommandId, Net, Outputs, Place, PlaceId, Role, Servers, Timing, Transition,
};

/// What a transition of the model is of one of the nets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// All of a firing.
    Fire,
    /// The start of an action.
    Start,
    /// Its end.
    Complete,
}

impl Part {
    /// Whether it ends a firing.
    pub(super) fn is_end(self) -> bool {
        self != Self::Start
    }
}

/// What says how many firings of a transition go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Busy {
    /// Servers of the model's transitions.
    Servers,
    /// Tokens in a place of the model.
    Tokens(usize),
}

/// A transition of one of the nets.
#[derive(Debug, Clone)]
pub(super) struct Origin {
    pub(super) index: usize,
    pub(super) name: String,
    /// Its transitions in the model.
    pub(super) parts: Vec<(Part, usize)>,
    /// Present when it takes time or has an action.
    pub(super) busy: Option<Busy>,
    pub(super) servers: Servers,
}

/// The joined nets.
#[derive(Debug)]
pub(super) struct Model {
    pub(super) net: Arc<Net>,
    pub(super) transitions: Vec<Origin>,
    /// Per transition of the model, the transition that it is a part of.
    pub(super) origin_of: Vec<Option<usize>>,
    pub(super) notes: Vec<String>,
    /// Names of the places that the nets declare, for as many as are shown.
    shown: Vec<Option<String>>,
}

impl Model {
    pub(super) fn new(nets: &[Arc<Net>]) -> Result<Self, PerfError> {
        let mut builder = Builder::new(nets);
        for number in 0..nets.len() {
            builder.places(number)?;
        }
        for number in 0..nets.len() {
            builder.net(number);
        }
        builder.build()
    }

    /// Number and name of every place that the nets declare.
    pub(super) fn shown_places(&self) -> impl Iterator<Item = (usize, &str)> {
        let shown = self.shown.iter().enumerate();
        shown.filter_map(|(index, name)| Some((index, name.as_deref()?)))
    }

    /// A marking in words.
    pub(super) fn words(&self, marking: &[u32]) -> String {
        let marked: Vec<String> = self
            .net
            .places()
            .iter()
            .zip(marking)
            .filter(|(place, tokens)| **tokens > 0 && !place.name.starts_with(ROOM))
            .map(|(place, tokens)| match tokens {
                1 => place.name.clone(),
                _ => format!("{}*{tokens}", place.name),
            })
            .collect();
        if marked.is_empty() {
            "no tokens at all".to_owned()
        } else {
            marked.join(", ")
        }
    }
}

/// Begins the name of a place that counts the free capacity of another one.
const ROOM: &str = "room in ";

/// Where a net's places begin in the model.
struct Base {
    places: usize,
    /// Per place: its free capacity, when that is a place of the model.
    rooms: Vec<Option<usize>>,
    /// Per transition with an action: the place of its firings.
    going: Vec<Option<usize>>,
    /// Idle; then on tape and in progress, per command.
    tape: usize,
}

struct Builder<'a> {
    nets: &'a [Arc<Net>],
    bases: Vec<Base>,
    places: Vec<Place>,
    shown: Vec<Option<String>>,
    flat: Vec<Transition>,
    origin_of: Vec<Option<usize>>,
    origins: Vec<Origin>,
}

impl<'a> Builder<'a> {
    fn new(nets: &'a [Arc<Net>]) -> Self {
        Self {
            nets,
            bases: Vec::new(),
            places: Vec::new(),
            shown: Vec::new(),
            flat: Vec::new(),
            origin_of: Vec::new(),
            origins: Vec::new(),
        }
    }

    fn qualified(&self, number: usize, name: &str) -> String {
        match self.nets {
            [_] => name.to_owned(),
            nets => format!("{}.{name}", nets[number].name()),
        }
    }

    fn place(&mut self, name: String, tokens: u32, at: &ctos::diagnostic::Place) -> usize {
        self.places.push(Place {
            name,
            tokens,
            capacity: None,
            data: None,
            role: Role::Declared,
            at: at.clone(),
        });
        self.shown.push(None);
        self.places.len() - 1
    }

    fn places(&mut self, number: usize) -> Result<(), PerfError> {
        let net = Arc::clone(&self.nets[number]);
        let base = self.places.len();
        for place in net.places() {
            let name = self.qualified(number, &place.name);
            let index = self.place(name.clone(), place.tokens, &place.at);
            self.places[index].capacity = place.capacity;
            self.shown[index] = Some(name);
        }
        let mut rooms = vec![None; net.places().len()];
        for (index, place) in net.places().iter().enumerate() {
            let Some(capacity) = place.capacity.filter(|_| promised(&net, index)) else {
                continue;
            };
            let resets = |t: &&Transition| t.resets.iter().any(|reset| reset.index() == index);
            if let Some(by) = net
                .transitions()
                .iter()
                .filter(resets)
                .find(|t| !can_be_told_apart(&net, t))
            {
                return Err(PerfError::ResetOfPromised {
                    place: place.name.clone(),
                    transition: by.name.clone(),
                });
            }
            let name = format!("{ROOM}{}", self.places[base + index].name);
            let left = capacity.saturating_sub(place.tokens);
            rooms[index] = Some(self.place(name, left, &place.at));
            self.places[base + index].capacity = None;
        }
        let mut going = vec![None; net.transitions().len()];
        for (index, transition) in net.transitions().iter().enumerate() {
            if transition.action.is_some() {
                let name = self.qualified(number, &transition.name);
                going[index] = Some(self.place(format!("{name} in action"), 0, &transition.at));
            }
        }
        let tape = self.places.len();
        if !net.commands().is_empty() {
            self.place(format!("{} idle", net.name()), 1, net.at());
        }
        for command in net.commands() {
            let tape = format!("{} on the tape of {}", command.symbol, net.name());
            self.place(tape, 0, &command.at);
            let progress = format!("{} in progress in {}", command.symbol, net.name());
            self.place(progress, 0, &command.at);
        }
        self.bases.push(Base {
            places: base,
            rooms,
            going,
            tape,
        });
        Ok(())
    }

    fn net(&mut self, number: usize) {
        let net = Arc::clone(&self.nets[number]);
        for (index, transition) in net.transitions().iter().enumerate() {
            self.transition(number, &net, index, transition);
        }
        let Some(template) = net.transitions().first() else {
            return;
        };
        // The commander: any command when idle.
        for index in 0..net.commands().len() {
            let mut put = bare(
                template,
                format!("command {}", net.commands()[index].symbol),
            );
            put.inputs = vec![self.arc(self.bases[number].tape, 1)];
            put.outputs.local = vec![self.arc(self.on_tape(number, index), 1)];
            self.flat.push(put);
            self.origin_of.push(None);
        }
    }

    fn arc(&self, place: usize, weight: u32) -> net::Arc {
        net::Arc {
            place: PlaceId(u32::try_from(place).unwrap_or(u32::MAX)),
            weight,
        }
    }

    fn on_tape(&self, number: usize, command: usize) -> usize {
        self.bases[number].tape + 1 + 2 * command
    }

    fn in_progress(&self, number: usize, command: usize) -> usize {
        self.on_tape(number, command) + 1
    }

    fn moved(&self, number: usize, arcs: &[net::Arc]) -> Vec<net::Arc> {
        let base = self.bases[number].places;
        let arcs = arcs.iter();
        arcs.map(|arc| self.arc(base + arc.place.index(), arc.weight))
            .collect()
    }

    fn outputs(&self, number: usize, outputs: &Outputs) -> Vec<net::Arc> {
        let mut puts = self.moved(number, &outputs.local);
        for arc in &outputs.remote {
            let other = self.nets.iter().position(|net| net.name() == arc.net);
            let place = other.and_then(|other| {
                let place = self.nets[other].place(&arc.place)?;
                Some(self.bases[other].places + place.index())
            });
            puts.extend(place.map(|place| self.arc(place, arc.weight)));
        }
        puts
    }

    fn transition(&mut self, number: usize, net: &Net, index: usize, transition: &Transition) {
        let origin = self.origins.len();
        let going = self.bases[number].going[index];
        self.origins.push(Origin {
            index: origin,
            name: self.qualified(number, &transition.step()),
            parts: Vec::new(),
            busy: match going {
                Some(place) => Some(Busy::Tokens(place)),
                None if transition.timing.is_immediate() => None,
                None => Some(Busy::Servers),
            },
            servers: transition.servers,
        });
        let mut first = bare(transition, transition.name.clone());
        first.inputs = self.moved(number, &transition.inputs);
        first.reads = self.moved(number, &transition.reads);
        first.inhibitors = self.moved(number, &transition.inhibitors);
        let base = self.bases[number].places;
        first.resets = transition
            .resets
            .iter()
            .map(|place| self.arc(base + place.index(), 1).place)
            .collect();
        first.priority = transition.priority;
        first.weight = transition.weight;
        if let Some(command) = transition.tape {
            let tape = self.on_tape(number, command.index());
            first.inputs.push(self.arc(tape, 1));
        }
        let puts = self.outputs(number, &transition.outputs);
        let Some(going) = going else {
            first.timing = transition.timing;
            first.servers = transition.servers;
            first.outputs.local = puts;
            for (first, held) in self.resets_apart(number, net, transition, first) {
                let mut first = first;
                self.rooms(number, transition, &mut first, Part::Fire, &held);
                self.ending(origin, Part::Fire, number, net, transition, first);
            }
            return;
        };
        if let Some(command) = transition.tape {
            let progress = self.in_progress(number, command.index());
            first.outputs.local.push(self.arc(progress, 1));
        }
        first.outputs.local.push(self.arc(going, 1));
        if let Servers::Limit(limit) = transition.servers {
            first.inhibitors.push(self.arc(going, limit.get()));
        }
        for (first, held) in self.resets_apart(number, net, transition, first) {
            let mut first = first;
            self.rooms(number, transition, &mut first, Part::Start, &held);
            self.push(origin, Part::Start, first);
        }
        let mut complete = bare(transition, transition.name.clone());
        complete.inputs = vec![self.arc(going, 1)];
        complete.outputs.local = puts;
        complete.timing = transition.timing;
        complete.servers = Servers::Many;
        // An action that takes no time is over before anything else.
        complete.priority = u32::MAX;
        let nothing = Held::new();
        self.rooms(number, transition, &mut complete, Part::Complete, &nothing);
        self.ending(origin, Part::Complete, number, net, transition, complete);
    }

    /// One transition of the model for each way to fill the places that it empties and that reserve
    /// space for actions. The freed space depends on their tokens.
    fn resets_apart(
        &self,
        number: usize,
        net: &Net,
        of: &Transition,
        part: Transition,
    ) -> Vec<(Transition, Held)> {
        let mut ways = vec![(part, Held::new())];
        for id in &of.resets {
            let (Some(_), Some(capacity)) =
                (self.bases[number].rooms[id.index()], net[*id].capacity)
            else {
                continue;
            };
            let emptied = self.arc(self.bases[number].places + id.index(), 1).place;
            ways = ways
                .iter()
                .flat_map(|(part, held)| {
                    (0..=capacity).filter_map(move |tokens| {
                        let (mut part, mut held) = (part.clone(), held.clone());
                        let mut needs = part.inputs.iter().chain(&part.reads);
                        if needs.any(|arc| arc.place == emptied && arc.weight > tokens) {
                            return None;
                        }
                        held.insert(id.index(), tokens);
                        part.resets.retain(|place| *place != emptied);
                        part.inputs.retain(|arc| arc.place != emptied);
                        part.reads.retain(|arc| arc.place != emptied);
                        if tokens > 0 {
                            part.inputs.push(net::Arc {
                                place: emptied,
                                weight: tokens,
                            });
                        }
                        part.inhibitors.push(net::Arc {
                            place: emptied,
                            weight: tokens.saturating_add(1),
                        });
                        Some((part, held))
                    })
                })
                .collect();
        }
        ways
    }

    /// Takes and gives back capacity of the places that actions fill. `held` is what the places
    /// hold that this part empties.
    fn rooms(
        &self,
        number: usize,
        of: &Transition,
        part: &mut Transition,
        which: Part,
        held: &Held,
    ) {
        let sum = |arcs: &[net::Arc], place: usize| -> u32 {
            let arcs = arcs.iter().filter(|arc| arc.place.index() == place);
            arcs.map(|arc| arc.weight).fold(0, u32::saturating_add)
        };
        for (place, room) in self.bases[number].rooms.iter().enumerate() {
            let Some(room) = *room else { continue };
            let (takes, puts) = (sum(&of.inputs, place), sum(&of.outputs.local, place));
            let fails = of
                .fail
                .as_ref()
                .map_or(0, |branch| sum(&branch.local, place));
            let promise = puts.max(fails).max(takes);
            let gone = held.get(&place).copied().unwrap_or(takes);
            let (before, after) = match which {
                Part::Fire => (puts, gone),
                Part::Start => (promise, gone),
                Part::Complete => (0, promise - puts),
            };
            if before > after {
                part.inputs.push(self.arc(room, before - after));
            } else if after > before {
                part.outputs.local.push(self.arc(room, after - before));
            }
        }
    }

    /// The end of a firing. It has one variant for each command that the symbol it writes may answer,
    /// and one for none of them being in progress.
    fn ending(
        &mut self,
        origin: usize,
        part: Part,
        number: usize,
        net: &Net,
        transition: &Transition,
        end: Transition,
    ) {
        let idle = self.bases[number].tape;
        let reads_now = transition.tape.filter(|_| part == Part::Fire);
        let answers = |command: CommandId| {
            let symbol = transition.write.as_ref();
            symbol.is_some_and(|symbol| net[command].answers.contains(symbol))
        };
        if let Some(command) = reads_now {
            let mut end = end;
            let after = if answers(command) {
                idle
            } else {
                self.in_progress(number, command.index())
            };
            end.outputs.local.push(self.arc(after, 1));
            return self.push(origin, part, end);
        }
        let mut unasked = end.clone();
        for command in (0..).map(CommandId).take(net.commands().len()) {
            if answers(command) {
                let progress = self.arc(self.in_progress(number, command.index()), 1);
                let mut variant = end.clone();
                variant.inputs.push(progress);
                variant.outputs.local.push(self.arc(idle, 1));
                unasked.inhibitors.push(progress);
                self.push(origin, part, variant);
            }
        }
        self.push(origin, part, unasked);
    }

    fn push(&mut self, origin: usize, part: Part, transition: Transition) {
        self.origins[origin].parts.push((part, self.flat.len()));
        self.origin_of.push(Some(origin));
        self.flat.push(transition);
    }

    fn build(self) -> Result<Model, PerfError> {
        let timed = self.flat.iter().any(|t| !t.timing.is_immediate());
        let (Some(first), true) = (self.nets.first(), timed) else {
            return Err(PerfError::NothingTimed);
        };
        Ok(Model {
            net: Arc::new(first.flattened(self.places, self.flat)),
            transitions: self.origins,
            origin_of: self.origin_of,
            notes: notes(self.nets),
            shown: self.shown,
        })
    }
}

/// Per place that a firing empties, in which capacity is reserved for actions: what it holds.
type Held = BTreeMap<usize, u32>;

/// Ways in which the places that a transition empties may be filled, as many as are distinguished.
const MOST_WAYS: u64 = 4096;

/// Whether a transition that empties places with capacity reserved for actions can be one transition of the
/// model for each number of tokens there. Each has a clock of its own, which begins again when the number
/// changes. That is the same only if the transition waits no time, or an exponential time with one
/// server.
fn can_be_told_apart(net: &Net, transition: &Transition) -> bool {
    let waits = match (transition.action.is_some(), transition.timing) {
        (true, _) | (false, Timing::Immediate) => false,
        (false, Timing::Exponential { .. }) => {
            !matches!(transition.servers, Servers::Limit(limit) if limit.get() == 1)
        }
        (false, _) => true,
    };
    let ways = transition.resets.iter().map(|place| {
        let capacity = net[*place].capacity.unwrap_or(0);
        u64::from(capacity) + 1
    });
    !waits && ways.fold(1, u64::saturating_mul) <= MOST_WAYS
}

/// Whether an action may fill a place.
fn promised(net: &Net, place: usize) -> bool {
    net.transitions()
        .iter()
        .filter(|t| t.action.is_some())
        .any(|t| {
            let fail = t.fail.iter().flat_map(|branch| &branch.local);
            let arcs = t.inputs.iter().chain(&t.outputs.local).chain(fail);
            arcs.into_iter().any(|arc| arc.place.index() == place)
        })
}

/// A transition with nothing but a name.
fn bare(template: &Transition, name: String) -> Transition {
    let mut bare = template.clone();
    bare.name = name;
    bare.inputs = Vec::new();
    bare.reads = Vec::new();
    bare.inhibitors = Vec::new();
    bare.resets = Vec::new();
    bare.tape = None;
    bare.when = None;
    bare.action = None;
    bare.outputs = Outputs::default();
    bare.fail = None;
    bare.write = None;
    bare.priority = 0;
    bare.within = None;
    bare.timing = Timing::Immediate;
    bare.weight = 1.0;
    bare.servers = Servers::Many;
    bare
}

/// What is taken for granted of these nets, in sentences.
fn notes(nets: &[Arc<Net>]) -> Vec<String> {
    let transitions = || nets.iter().flat_map(|net| net.transitions());
    let mut notes = Vec::new();
    if transitions().any(|t| t.when.is_some()) {
        notes.push(
            "enabling functions let pass: of a function and its negation the weights decide".into(),
        );
    }
    if transitions().any(|t| t.action.is_some()) {
        notes.push("actions always succeed, and last what the transition's `time` says".into());
    }
    let at_once = |t: &&Transition| t.action.is_some() && t.timing.is_immediate();
    let names: Vec<&str> = transitions()
        .filter(at_once)
        .map(|t| t.name.as_str())
        .collect();
    if !names.is_empty() {
        notes.push(format!(
            "actions without `time` last no time: {}",
            names.join(", ")
        ));
    }
    if nets.iter().any(|net| !net.commands().is_empty()) {
        notes.push(
            "a new command comes as soon as the one before is answered, each as probable".into(),
        );
    }
    notes
}
