//! What a display must know of a net that does not change while it runs.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::event::{Event, EventPhase};

use pnt_language::net::{Action, Arc, Net, Outputs, Part, Place, RemoteArc, Role, SetTo};

/// A net as displays know it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetView {
    /// Its name.
    pub name: String,
    /// One sentence about it; may be empty.
    pub title: String,
    /// The file that it was read from.
    pub file: String,
    /// Its places, by number.
    pub places: Vec<PlaceView>,
    /// Its transitions, by number.
    pub transitions: Vec<TransitionView>,
    /// The commands of its input tape.
    pub commands: Vec<CommandView>,
    /// Where its author put nodes, from the layout file beside it.
    pub pins: BTreeMap<String, PinView>,
    /// Arcs that are not straight, from the layout file.
    pub routes: Vec<RouteView>,
    /// Values of declared data, by number.
    #[serde(default)]
    pub data: Vec<DataView>,
}

/// A value of declared data.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataView {
    /// Its name; of a field, that of the data, a point and its own.
    pub name: String,
    /// Its type; of a float with a unit, the unit.
    pub kind: String,
    /// Its value at first.
    pub initial: String,
    /// The place that names the data, or that is marked when a reply is stored as it; by number.
    pub place: Option<u32>,
}

/// A place.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlaceView {
    /// Its name.
    pub name: String,
    /// Tokens of the initial marking.
    pub tokens: u32,
    /// The most tokens that it holds.
    pub capacity: Option<u32>,
    /// The data object whose validity it says.
    pub data: Option<String>,
    /// Whether it belongs to a coordination structure.
    pub wiring: bool,
    /// Where it stands in the net text, `file:line:column`.
    pub at: String,
}

/// An arc.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArcView {
    /// The place, by number.
    pub place: u32,
    /// Its weight.
    pub weight: u32,
}

/// An arc to a place of another net.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemoteView {
    /// The other net.
    pub net: String,
    /// Its place.
    pub place: String,
    /// Its weight.
    pub weight: u32,
    /// Whether it belongs to a coordination structure.
    pub wiring: bool,
}

/// A transition.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionView {
    /// Its name.
    pub name: String,
    /// The name that its author wrote, which several parts of a request share.
    pub shown: String,
    /// Which part of a request it is: `start`, `end`, `fail`, `back` (a failure without a branch), `return`, or
    /// nothing.
    pub part: String,
    /// Tokens it takes.
    pub inputs: Vec<ArcView>,
    /// Tokens it needs and leaves.
    pub reads: Vec<ArcView>,
    /// It waits while these hold as many tokens.
    pub inhibitors: Vec<ArcView>,
    /// It empties these; weights say nothing here.
    pub resets: Vec<ArcView>,
    /// Tokens it puts.
    pub outputs: Vec<ArcView>,
    /// Tokens it sends to other nets.
    pub sends: Vec<RemoteView>,
    /// Whether it has a failure branch.
    pub branches: bool,
    /// Tokens it puts when its action has failed.
    pub fails: Vec<ArcView>,
    /// Tokens it sends to other nets when its action has failed.
    pub fail_sends: Vec<RemoteView>,
    /// The symbol it reads from the input tape.
    pub tape: Option<String>,
    /// Its enabling function, with `not` before it if it is negated.
    pub when: Option<String>,
    /// What its action calls: `task.command`, or a local function; empty without an action.
    pub target: String,
    /// The task that its action is a message to, or the coordinator that it asks.
    pub task: Option<String>,
    /// The symbol it writes to the output tape.
    pub write: Option<String>,
    /// Higher goes first.
    pub priority: u32,
    /// Limit of its action, ms; 0: none of its own.
    pub within_ms: u64,
    /// Where it stands in the net text, `file:line:column`.
    pub at: String,
}

/// A command of the input tape.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommandView {
    /// The input symbol.
    pub symbol: String,
    /// The output symbols that may answer it.
    pub answers: Vec<String>,
}

/// Where a node is drawn. Units are pixels at scale 1, x to the right, y down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinView {
    /// To the right.
    pub x: i32,
    /// Down.
    pub y: i32,
    /// On which side its name stands.
    pub label: Side,
    /// Whether a transition's bar lies, for arcs from above and below.
    pub lying: bool,
}

/// An arc that is not straight.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RouteView {
    /// The name of its first node.
    pub from: String,
    /// The name of its second.
    pub to: String,
    /// The points that it passes, px.
    pub via: Vec<(i32, i32)>,
}

/// A side of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Above.
    Above,
    /// Below.
    #[default]
    Below,
    /// To the left.
    Left,
    /// To the right.
    Right,
}

/// The declared data of a net.
fn data(net: &Net) -> Vec<DataView> {
    let declared = net.declared();
    let stored = |name: &str| {
        let mut transitions = net.transitions().iter();
        transitions.find_map(|one| match &one.action {
            Some(Action::Written { sets, .. }) => {
                let mut sets = sets.iter().filter(|set| set.name == name);
                sets.any(|set| matches!(set.to, SetTo::Reply))
                    .then(|| one.outputs.local.first().map(|arc| arc.place.index()))?
            }
            _ => None,
        })
    };
    let of_place = |name: &str| {
        let names = |place: &Place| place.data.as_deref() == Some(name);
        let place = net.places().iter().position(names);
        place
            .or_else(|| stored(name))
            .and_then(|place| u32::try_from(place).ok())
    };
    let views = declared.data.iter().flat_map(|data| {
        let (place, slots) = (of_place(&data.name), declared.slots.get(data.slots.clone()));
        slots.into_iter().flatten().map(move |slot| DataView {
            name: slot.name.clone(),
            kind: slot.kind.to_string(),
            initial: slot.initial.to_string(),
            place,
        })
    });
    views.collect()
}

impl NetView {
    /// A net, without pins.
    #[must_use]
    pub fn new(net: &Net) -> Self {
        let transitions = net.transitions().iter();
        Self {
            name: net.name().to_owned(),
            title: net.title().unwrap_or_default().to_owned(),
            file: net.at().source.name().to_owned(),
            places: net
                .places()
                .iter()
                .map(|place| PlaceView {
                    name: place.name.clone(),
                    tokens: place.tokens,
                    capacity: place.capacity,
                    data: place.data.clone(),
                    wiring: place.role == Role::Coordination,
                    at: place.at.to_string(),
                })
                .collect(),
            transitions: transitions.map(|one| transition(net, one)).collect(),
            commands: net
                .commands()
                .iter()
                .map(|command| CommandView {
                    symbol: command.symbol.clone(),
                    answers: command.answers.clone(),
                })
                .collect(),
            pins: BTreeMap::new(),
            routes: Vec::new(),
            data: data(net),
        }
    }

    /// What its nodes are called where they are drawn.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let places = self.places.iter().map(|place| place.name.as_str());
        places.chain(self.transitions.iter().map(|one| one.shown.as_str()))
    }

    /// Whether `name` is `PLACE@NET`, a place of another net to which this one sends tokens.
    #[must_use]
    pub fn sends_to(&self, name: &str) -> bool {
        let Some((place, net)) = name.split_once('@') else {
            return false;
        };
        let sends = self.transitions.iter();
        let mut sends = sends.flat_map(|one| one.sends.iter().chain(&one.fail_sends));
        sends.any(|arc| arc.place == place && arc.net == net)
    }

    /// The node, as its author calls it, that stands at `file:line:column` of the net text.
    #[must_use]
    pub fn node_at(&self, at: &str) -> Option<&str> {
        let place = self.places.iter().find(|place| place.at == at);
        let transition = || self.transitions.iter().find(|one| one.at == at);
        let place = place.map(|place| place.name.as_str());
        place.or_else(|| transition().map(|one| one.shown.as_str()))
    }

    /// Whether the place is hidden where requests are drawn as their author wrote them. Such a place is
    /// part of a coordination structure, and no request comes in by it.
    #[must_use]
    pub fn hidden(&self, place: usize) -> bool {
        let place = self.places.get(place);
        place.is_some_and(|place| place.wiring && !place.name.starts_with("I_"))
    }

    /// The number of the place called `name`.
    #[must_use]
    pub fn place(&self, name: &str) -> Option<usize> {
        self.places.iter().position(|place| place.name == name)
    }

    /// What an event says to a person: the transition as its author wrote it, and what happened to it.
    #[must_use]
    pub fn told<'v>(&'v self, event: &'v Event) -> (&'v str, EventPhase) {
        let number = self.transition(&event.transition);
        match number.and_then(|number| self.transitions.get(number)) {
            None => (&event.transition, event.phase),
            Some(one) => (&one.shown, event.phase.of_part(&one.part)),
        }
    }

    /// The number of the transition called `name`.
    #[must_use]
    pub fn transition(&self, name: &str) -> Option<usize> {
        self.transitions.iter().position(|one| one.name == name)
    }
}

impl TransitionView {
    /// What people call it: a request by its author's name, and its ends by their own.
    #[must_use]
    pub fn called(&self) -> &str {
        match self.part.as_str() {
            "start" => &self.shown,
            _ => &self.name,
        }
    }
}

fn transition(net: &Net, one: &pnt_language::net::Transition) -> TransitionView {
    let part = part(one.part);
    let fail = one.fail.clone().unwrap_or_default();
    // A request goes to the coordinator whose place it marks.
    let coordinator = (one.part == Part::Start).then(|| one.outputs.remote.first());
    let coordinator = coordinator.flatten().map(|arc| arc.net.clone());
    let task = match &one.action {
        Some(Action::Message { task, .. }) => Some(task.clone()),
        _ => coordinator,
    };
    TransitionView {
        name: one.name.clone(),
        shown: one.written().to_owned(),
        part: part.to_owned(),
        inputs: arcs(&one.inputs),
        reads: arcs(&one.reads),
        inhibitors: arcs(&one.inhibitors),
        resets: one
            .resets
            .iter()
            .map(|place| ArcView {
                place: place.0,
                weight: 1,
            })
            .collect(),
        outputs: arcs(&one.outputs.local),
        sends: remote(&one.outputs),
        branches: one.fail.is_some(),
        fails: arcs(&fail.local),
        fail_sends: remote(&fail),
        tape: one.tape.map(|id| net[id].symbol.clone()),
        when: one.when.as_ref().map(|when| {
            let not = if when.negated { "not " } else { "" };
            format!("{not}{}", when.function)
        }),
        target: target(one.action.as_ref()),
        task,
        write: one.write.clone(),
        priority: one.priority,
        within_ms: one.within.map_or(0, |limit| {
            u64::try_from(limit.as_millis()).unwrap_or(u64::MAX)
        }),
        at: one.at.to_string(),
    }
}

/// Which part of a request a transition is.
pub(crate) fn part(part: Part) -> &'static str {
    match part {
        Part::Whole => "",
        Part::Start => "start",
        Part::End => "end",
        Part::Fail { branch: true } => "fail",
        Part::Fail { branch: false } => "back",
        Part::Return => "return",
    }
}

/// What an action calls, as events name it.
pub(super) fn target(action: Option<&Action>) -> String {
    action.map(Action::called).unwrap_or_default()
}

fn arcs(arcs: &[Arc]) -> Vec<ArcView> {
    let view = |arc: &Arc| ArcView {
        place: arc.place.0,
        weight: arc.weight,
    };
    arcs.iter().map(view).collect()
}

fn remote(outputs: &Outputs) -> Vec<RemoteView> {
    let view = |arc: &RemoteArc| RemoteView {
        net: arc.net.clone(),
        place: arc.place.clone(),
        weight: arc.weight,
        wiring: arc.role == Role::Coordination,
    };
    outputs.remote.iter().map(view).collect()
}
