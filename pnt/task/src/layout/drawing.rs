//! A net as it is drawn: nodes with positions, and arcs. In the author's words, a request to a coordinator
//! is one transition; in full, it is the places and transitions of its coordination structure.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{layered::layered, place::place, point::Point};
use crate::stream::{ArcView, NetView, RemoteView, RouteView, Side, TransitionView};

/// How much of a net is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Detail {
    /// As its author wrote it.
    #[default]
    Written,
    /// With the places and transitions of coordination structures.
    Full,
}

/// What a node is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A place, by number.
    Place(u32),
    /// A transition, or those that a request consists of, by number; and the place that is marked while the
    /// request is served.
    Transition(Vec<u32>, Option<u32>),
    /// A place of another net: the net and the place.
    Remote(String, String),
}

/// A node of a drawing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DrawnNode {
    /// Its name.
    pub name: String,
    /// What it is.
    pub kind: Kind,
    /// Its centre, px to the right.
    pub x: f64,
    /// Its centre, px down.
    pub y: f64,
    /// On which side its name stands.
    pub label: Side,
    /// Whether a transition's bar lies.
    pub lying: bool,
    /// Whether a layout file says where it is.
    pub pinned: bool,
}

/// What an arc does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// Takes tokens.
    Input,
    /// Puts tokens.
    Output,
    /// Puts tokens after a failure.
    Fail,
    /// Needs tokens and leaves them.
    Read,
    /// Waits while there are tokens.
    Inhibit,
    /// Takes all tokens.
    Reset,
}

/// An arc of a drawing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DrawnArc {
    /// Its first node, by position in the list.
    pub from: usize,
    /// Its second.
    pub to: usize,
    /// What it does.
    pub way: Way,
    /// Its weight.
    pub weight: u32,
    /// Points on its way, px.
    pub via: Vec<Point>,
}

/// A net as it is drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Drawing {
    /// Its nodes: places, transitions, places of other nets.
    pub nodes: Vec<DrawnNode>,
    /// Its arcs.
    pub arcs: Vec<DrawnArc>,
}

/// Px that a character of a name takes.
const LETTER: f64 = 6.4;
/// How far an arc leaves the straight line, px.
const BOW: f64 = 11.0;
/// Height of a node with its name.
const NODE_HEIGHT: f64 = 44.0;

impl Drawing {
    /// Draws a net: pinned nodes where the view says, the others by rule.
    #[must_use]
    pub fn new(view: &NetView, detail: Detail) -> Self {
        let mut sketch = Sketch::new(view, detail);
        for (index, one) in view.transitions.iter().enumerate() {
            sketch.transition(index, one);
        }
        sketch.finish()
    }

    /// Left, top, right and bottom of what is drawn, names included, px.
    #[must_use]
    pub fn bounds(&self) -> (f64, f64, f64, f64) {
        let none = (
            f64::INFINITY,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NEG_INFINITY,
        );
        let via = self.arcs.iter().flat_map(|arc| arc.via.iter().copied());
        let via = via.map(|(x, y)| (x, y, 4.0));
        let nodes = self.nodes.iter().map(|node| {
            let half = node.name.chars().count() as f64 * LETTER / 2.0;
            let sideways = matches!(node.label, Side::Left | Side::Right);
            (
                node.x,
                node.y,
                if sideways {
                    2.0 * half + 24.0
                } else {
                    half.max(20.0)
                },
            )
        });
        let all = nodes
            .chain(via)
            .fold(none, |(left, top, right, bottom), (x, y, half)| {
                (
                    left.min(x - half),
                    top.min(y - NODE_HEIGHT),
                    right.max(x + half),
                    bottom.max(y + NODE_HEIGHT),
                )
            });
        if all.0.is_finite() {
            all
        } else {
            (0.0, 0.0, 0.0, 0.0)
        }
    }
}

struct Sketch<'v> {
    view: &'v NetView,
    detail: Detail,
    nodes: Vec<DrawnNode>,
    places: Vec<Option<usize>>,
    transitions: BTreeMap<String, usize>,
    remote: BTreeMap<(String, String), usize>,
    arcs: Vec<DrawnArc>,
}

impl<'v> Sketch<'v> {
    fn new(view: &'v NetView, detail: Detail) -> Self {
        let mut sketch = Self {
            view,
            detail,
            nodes: Vec::new(),
            places: Vec::new(),
            transitions: BTreeMap::new(),
            remote: BTreeMap::new(),
            arcs: Vec::new(),
        };
        for (index, place) in view.places.iter().enumerate() {
            let drawn = detail == Detail::Full || !view.hidden(index);
            let node = drawn.then(|| sketch.node(&place.name, Kind::Place(number(index))));
            sketch.places.push(node);
        }
        sketch
    }

    fn node(&mut self, name: &str, kind: Kind) -> usize {
        self.nodes.push(DrawnNode {
            name: name.to_owned(),
            kind,
            x: 0.0,
            y: 0.0,
            label: Side::Below,
            lying: false,
            pinned: false,
        });
        self.nodes.len() - 1
    }

    fn transition(&mut self, index: usize, one: &TransitionView) {
        let written = self.detail == Detail::Written;
        let name = if written { &one.shown } else { &one.name };
        let known = self.transitions.get(name).copied();
        let node = known.unwrap_or_else(|| {
            let active = (written && one.part == "start")
                .then(|| self.view.place(&format!("{}_active", one.shown)))
                .flatten();
            self.node(name, Kind::Transition(Vec::new(), active.map(number)))
        });
        self.transitions.insert(name.clone(), node);
        if let Some(DrawnNode {
            kind: Kind::Transition(parts, _),
            ..
        }) = self.nodes.get_mut(node)
        {
            parts.push(number(index));
        }
        // A failure without a branch gives back what was taken: no arc says so.
        let (output, again) = match one.part.as_str() {
            "fail" if written => (Way::Fail, false),
            "back" if written => return,
            _ => (Way::Output, true),
        };
        if again || one.part != "fail" {
            self.arcs(node, &one.inputs, Way::Input);
        }
        self.arcs(node, &one.reads, Way::Read);
        self.arcs(node, &one.inhibitors, Way::Inhibit);
        self.arcs(node, &one.resets, Way::Reset);
        self.arcs(node, &one.outputs, output);
        self.arcs(node, &one.fails, Way::Fail);
        self.sends(node, &one.sends, output);
        self.sends(node, &one.fail_sends, Way::Fail);
    }

    fn arcs(&mut self, node: usize, arcs: &[ArcView], way: Way) {
        for arc in arcs {
            let place = self.places.get(arc.place as usize).copied().flatten();
            if let Some(place) = place {
                self.arc(node, place, way, arc.weight);
            }
        }
    }

    fn sends(&mut self, node: usize, sends: &[RemoteView], way: Way) {
        for arc in sends {
            if self.detail == Detail::Written && arc.wiring {
                continue;
            }
            let key = (arc.net.clone(), arc.place.clone());
            let known = self.remote.get(&key).copied();
            let place = known.unwrap_or_else(|| {
                let kind = Kind::Remote(arc.net.clone(), arc.place.clone());
                self.node(&format!("{}@{}", arc.place, arc.net), kind)
            });
            self.remote.insert(key, place);
            self.arc(node, place, way, arc.weight);
        }
    }

    fn arc(&mut self, node: usize, place: usize, way: Way, weight: u32) {
        let (from, to) = match way {
            Way::Output | Way::Fail => (node, place),
            _ => (place, node),
        };
        // A failure branch to where success leads needs no arc of its own.
        let same = |arc: &DrawnArc| (arc.from, arc.to) == (from, to);
        let covered =
            |arc: &DrawnArc| arc.way == way || (way == Way::Fail && arc.way == Way::Output);
        if self
            .arcs
            .iter()
            .rev()
            .take(64)
            .any(|arc| same(arc) && covered(arc))
        {
            return;
        }
        self.arcs.push(DrawnArc {
            from,
            to,
            way,
            weight,
            via: Vec::new(),
        });
    }

    fn finish(mut self) -> Drawing {
        let pins = &self.view.pins;
        for node in &mut self.nodes {
            if let Some(pin) = pins.get(&node.name) {
                (node.x, node.y) = (f64::from(pin.x), f64::from(pin.y));
                (node.label, node.lying, node.pinned) = (pin.label, pin.lying, true);
            }
        }
        if self.nodes.iter().any(|node| node.pinned) {
            self.fill_in();
        } else {
            self.arrange();
        }
        for RouteView { from, to, via } in &self.view.routes {
            for arc in &mut self.arcs {
                let named = |index: usize| self.nodes.get(index).map(|node| node.name.as_str());
                if named(arc.from) == Some(from) && named(arc.to) == Some(to) {
                    arc.via = via
                        .iter()
                        .map(|(x, y)| (f64::from(*x), f64::from(*y)))
                        .collect();
                }
            }
        }
        self.bow();
        Drawing {
            nodes: self.nodes,
            arcs: self.arcs,
        }
    }

    /// Straight arcs between the same two nodes would lie on each other: each is bowed to its right.
    fn bow(&mut self) {
        let mut between: BTreeMap<(usize, usize), u32> = BTreeMap::new();
        for arc in self.arcs.iter().filter(|arc| arc.via.is_empty()) {
            let ends = (arc.from.min(arc.to), arc.from.max(arc.to));
            *between.entry(ends).or_default() += 1;
        }
        let mut seen: BTreeMap<(usize, usize), u32> = BTreeMap::new();
        for arc in self.arcs.iter_mut().filter(|arc| arc.via.is_empty()) {
            let ends = (arc.from.min(arc.to), arc.from.max(arc.to));
            let (Some(from), Some(to)) = (self.nodes.get(arc.from), self.nodes.get(arc.to)) else {
                continue;
            };
            if between.get(&ends).is_none_or(|count| *count < 2) {
                continue;
            }
            // Those in the same direction go further and further out.
            let rank = seen.entry((arc.from, arc.to)).or_default();
            *rank += 1;
            let (dx, dy) = (to.x - from.x, to.y - from.y);
            let length = dx.hypot(dy).max(1.0);
            let out = BOW * f64::from(*rank) / length;
            arc.via = vec![(
                (f64::midpoint(from.x, to.x) - dy * out).round(),
                (f64::midpoint(from.y, to.y) + dx * out).round(),
            )];
        }
    }

    fn fill_in(&mut self) {
        let given: Vec<Option<Point>> = self
            .nodes
            .iter()
            .map(|node| node.pinned.then_some((node.x, node.y)))
            .collect();
        let mut near = vec![Vec::new(); self.nodes.len()];
        for arc in &self.arcs {
            near[arc.from].push(arc.to);
            near[arc.to].push(arc.from);
        }
        for (node, (x, y)) in self.nodes.iter_mut().zip(place(&given, &near)) {
            (node.x, node.y) = (x, y);
        }
    }

    /// Arranges each connected part by itself, one under the other.
    fn arrange(&mut self) {
        let part_of = parts(self.nodes.len(), &self.arcs);
        let count = part_of.iter().max().map_or(0, |last| last + 1);
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); count];
        for (node, part) in part_of.iter().enumerate() {
            members[*part].push(node);
        }
        let mut arcs_of: Vec<Vec<usize>> = vec![Vec::new(); count];
        for (index, arc) in self.arcs.iter().enumerate() {
            arcs_of[part_of[arc.from]].push(index);
        }
        let mut local = vec![0; self.nodes.len()];
        let mut top = 0.0;
        for (members, arcs) in members.iter().zip(&arcs_of) {
            for (index, node) in members.iter().enumerate() {
                local[*node] = index;
            }
            let sizes: Vec<(f64, f64)> = members
                .iter()
                .map(|node| {
                    let letters = self.nodes[*node].name.chars().count() as f64;
                    ((letters * LETTER).max(30.0), NODE_HEIGHT)
                })
                .collect();
            let ends: Vec<(usize, usize)> = arcs
                .iter()
                .map(|index| (local[self.arcs[*index].from], local[self.arcs[*index].to]))
                .collect();
            let (nodes, points) = layered(&sizes, &ends);
            let mut bottom = 0.0_f64;
            for (node, (x, y)) in members.iter().zip(nodes) {
                let node = &mut self.nodes[*node];
                (node.x, node.y) = (x.round(), (y + top).round());
                bottom = bottom.max(y);
            }
            for (index, points) in arcs.iter().zip(points) {
                let points = points.into_iter();
                self.arcs[*index].via = points
                    .map(|(x, y)| (x.round(), (y + top).round()))
                    .collect();
            }
            top += bottom + 2.0 * NODE_HEIGHT;
        }
    }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}

/// Which connected part each node belongs to, numbered by their first nodes.
fn parts(count: usize, arcs: &[DrawnArc]) -> Vec<usize> {
    let mut near = vec![Vec::new(); count];
    for arc in arcs {
        near[arc.from].push(arc.to);
        near[arc.to].push(arc.from);
    }
    let mut part = vec![usize::MAX; count];
    let mut next = 0;
    for root in 0..count {
        if part[root] != usize::MAX {
            continue;
        }
        let mut stack = vec![root];
        while let Some(one) = stack.pop() {
            if std::mem::replace(&mut part[one], next) == usize::MAX {
                stack.extend(near[one].iter().filter(|other| part[**other] == usize::MAX));
            }
        }
        next += 1;
    }
    part
}
