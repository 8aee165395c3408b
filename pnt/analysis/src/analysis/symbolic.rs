//! The reachable markings of a model as a decision diagram. It is for nets whose markings are too many
//! to be listed, and whose places hang together loosely enough. Counts are exact.
//!
//! Needs a net without priorities and enabling functions.

mod diagram;
mod order;
mod saturate;

#[cfg(test)]
mod tests;

use hashbrown::HashMap;

use super::{
    model::{Model, TransitionNumber},
    stop::Stop,
};
use diagram::{Condition, Full, NONE, Node};
use saturate::{Event, Firing, events};

/// The diagrams recurse once per place; so much is enough for tens of thousands.
const STACK_BYTES: usize = 512 << 20;

/// What counting may take at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Bytes of the diagrams.
    pub bytes: usize,
    /// Nodes that are made or found again.
    pub steps: u64,
}

/// Counting has come to no end with the effort that it was allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GaveUp {
    /// The steps it took.
    pub steps: u64,
}

/// What was counted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counted {
    /// Reachable markings.
    pub markings: u128,
    /// Pairs of a reachable marking and a transition enabled in it.
    pub edges: u128,
    /// The most tokens in each place.
    pub bounds: Vec<u32>,
    /// The most tokens in a marking.
    pub most_tokens: u64,
    /// Dead markings.
    pub deadlocks: u128,
    /// A shortest firing sequence to the nearest of them, and that marking, unless the effort was not enough.
    pub deadlock: Option<(Vec<TransitionNumber>, Vec<u32>)>,
    /// Per transition, whether it is enabled somewhere.
    pub seen: Vec<bool>,
    /// Whether the initial marking can be reached from every reachable one; `None` when the effort
    /// was not enough.
    pub reversible: Option<bool>,
    /// Per label of the model, whether it can become enabled again from every reachable marking;
    /// none when the effort was not enough.
    pub live: Option<bool>,
    /// Bytes held at the end, which is when they are most.
    pub bytes: usize,
    /// Steps taken.
    pub steps: u64,
}

impl Counted {
    /// Whether nothing was left out.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        let way = self.deadlocks == 0 || self.deadlock.is_some();
        way && self.reversible.is_some() && self.live.is_some()
    }
}

/// Whether the model is one that diagrams can count.
#[must_use]
pub fn fits(model: &Model) -> bool {
    !model.has_priorities() && model.transitions.iter().all(|t| t.when.is_none())
}

/// Counts the reachable markings.
///
/// # Errors
/// When the model does not [fit](fits), or when it is stopped. Also when it needs more effort or larger numbers
/// than permitted, as every net without a bound does.
pub fn count(model: &Model, effort: Effort, stop: Stop) -> Result<Counted, GaveUp> {
    if !fits(model) {
        return Err(GaveUp { steps: 0 });
    }
    // The calling thread's stack may be small.
    std::thread::scope(|scope| {
        let counting = std::thread::Builder::new()
            .stack_size(STACK_BYTES)
            .spawn_scoped(scope, || Counter::count(model, effort, stop));
        match counting.map_err(|_| GaveUp { steps: 0 })?.join() {
            Ok(counted) => counted,
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// A firing sequence and the marking in which it ends.
type Way = (Vec<TransitionNumber>, Vec<u32>);

struct Counter<'a> {
    model: &'a Model,
    firing: Firing<'a>,
    /// The place of each level.
    order: Vec<u32>,
    events: &'a [Event],
    initial: Node,
    reachable: Node,
}

impl Counter<'_> {
    fn count(model: &Model, effort: Effort, stop: Stop) -> Result<Counted, GaveUp> {
        let order = order::order(model);
        let mut levels = vec![0_u32; order.len()];
        for (level, place) in (0..).zip(&order) {
            levels[*place as usize] = level;
        }
        let events = events(model, &levels);
        let mut counter = Counter {
            model,
            firing: Firing::new(&events, order.len(), effort, stop),
            order,
            events: &events,
            initial: NONE,
            reachable: NONE,
        };
        let counted = counter.reach().and_then(|()| counter.counted());
        counted.map_err(|Full| GaveUp {
            steps: counter.firing.diagram.steps(),
        })
    }

    fn reach(&mut self) -> Result<(), Full> {
        let start = self.model.initial();
        let start: Vec<u32> = self
            .order
            .iter()
            .map(|place| start[*place as usize])
            .collect();
        self.initial = self.firing.diagram.single(&start)?;
        self.reachable = self.firing.closure(self.initial, 0)?;
        Ok(())
    }

    fn counted(&mut self) -> Result<Counted, Full> {
        let mut counts = HashMap::new();
        let markings = self.firing.diagram.count(self.reachable, &mut counts)?;
        let mut edges = 0_u128;
        let mut seen = Vec::with_capacity(self.events.len());
        let mut dead = self.reachable;
        for event in self.events {
            let conditions = conditions(event);
            let enabled = self
                .firing
                .diagram
                .restrict(self.reachable, &conditions, true)?;
            let count = self.firing.diagram.count(enabled, &mut counts)?;
            edges = edges.checked_add(count).ok_or(Full)?;
            seen.push(count > 0);
            dead = self.firing.diagram.restrict(dead, &conditions, false)?;
        }
        let deadlocks = self.firing.diagram.count(dead, &mut counts)?;
        let (by_level, most_tokens) = self.firing.diagram.most(self.reachable, self.order.len());
        let mut bounds = vec![0; self.order.len()];
        for (place, bound) in self.order.iter().zip(by_level) {
            bounds[*place as usize] = bound;
        }
        // From here on, running out of effort leaves an answer out.
        let deadlock = if dead == NONE {
            None
        } else {
            self.nearest(dead).ok().flatten()
        };
        let reversible = self.reversible().ok();
        let live = self.live(reversible, dead, &seen).ok();
        Ok(Counted {
            markings,
            edges,
            bounds,
            most_tokens,
            deadlocks,
            deadlock,
            seen,
            reversible,
            live,
            bytes: self.firing.diagram.bytes(),
            steps: self.firing.diagram.steps(),
        })
    }

    fn reversible(&mut self) -> Result<bool, Full> {
        let returning = self.firing.returning(self.initial, self.reachable, 0)?;
        Ok(returning == self.reachable)
    }

    fn live(&mut self, reversible: Option<bool>, dead: Node, seen: &[bool]) -> Result<bool, Full> {
        let labels = self.model.label_count();
        if labels == 0 {
            return Ok(true);
        }
        let mut fires = vec![false; labels];
        for (transition, seen) in self.model.transitions.iter().zip(seen) {
            if let (Some(label), true) = (transition.label, seen) {
                fires[label as usize] = true;
            }
        }
        if dead != NONE || fires.contains(&false) {
            return Ok(false);
        }
        if reversible == Some(true) {
            return Ok(true);
        }
        for label in (0..).take(labels) {
            let mut enabled = NONE;
            for (transition, event) in self.model.transitions.iter().zip(self.events) {
                if transition.label == Some(label) {
                    let some =
                        self.firing
                            .diagram
                            .restrict(self.reachable, &conditions(event), true)?;
                    enabled = self.firing.diagram.union(enabled, some)?;
                }
            }
            if self.firing.returning(enabled, self.reachable, 0)? != self.reachable {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// A shortest firing sequence into a set, and the marking it ends in. It goes back through the
    /// sets that are one firing, two firings and so on away, until the initial marking is in one.
    /// Then it goes forward again.
    fn nearest(&mut self, set: Node) -> Result<Option<Way>, Full> {
        let mut layers = vec![set];
        let mut known = set;
        let start = self.firing.diagram.first(self.initial);
        let mut front = set;
        while !self.firing.diagram.contains(front, &start) {
            let before = self.firing.before(front, self.reachable)?;
            front = self.firing.diagram.minus(before, known)?;
            if front == NONE {
                return Ok(None);
            }
            known = self.firing.diagram.union(known, front)?;
            layers.push(front);
        }
        layers.pop();
        let mut marking = self.model.initial();
        let mut sequence = Vec::new();
        while let Some(layer) = layers.pop() {
            let next = (0..).take(self.model.transitions.len()).find_map(|number| {
                let after = self.model.fire(number, &marking)?;
                let by_level: Vec<u32> = self
                    .order
                    .iter()
                    .map(|place| after[*place as usize])
                    .collect();
                let inside = self.firing.diagram.contains(layer, &by_level);
                inside.then_some((number, after))
            });
            let Some((number, after)) = next else {
                return Ok(None);
            };
            sequence.push(number);
            marking = after;
        }
        Ok(Some((sequence, marking)))
    }
}

fn conditions(event: &Event) -> Vec<Condition> {
    event.iter().map(|local| local.condition).collect()
}
