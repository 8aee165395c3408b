//! The reachable markings of a composed system, one by one, breadth first, so that every path found
//! is a shortest one. Knows how to find markings and paths, not what a finding about them says.

mod store;

#[cfg(test)]
mod tests;

use crate::compose::{Step, System, SystemPlaceId};
use store::{Cell, Store};

/// Number of a marking, in the order of discovery; 0 is the marking at rest.
pub type MarkingId = u32;

/// How far to look.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Markings to find at most.
    pub markings: usize,
    /// Whether to keep the edges, which finding the ways back to rest needs.
    pub edges: bool,
}

impl Default for Limits {
    /// One million markings, with edges.
    fn default() -> Self {
        Self {
            markings: 1_000_000,
            edges: true,
        }
    }
}

/// A proof that a place can grow without bound.
#[derive(Debug, Clone)]
pub struct Growth {
    /// The place.
    pub place: SystemPlaceId,
    /// Steps (numbers in [`System::steps`]) from rest to where the growing begins.
    pub lead: Vec<usize>,
    /// Steps that can be repeated for ever, each time with more tokens in the place.
    pub cycle: Vec<usize>,
}

/// What was found.
#[derive(Debug, Clone, Default)]
pub struct Space {
    /// Reachable markings found.
    pub markings: usize,
    /// Edges between them.
    pub edges: usize,
    /// Whether these are all.
    pub complete: bool,
    /// Markings other than rest that nothing is sure to leave, in order of distance.
    pub dead: Vec<MarkingId>,
    /// Per step, whether it is enabled somewhere.
    pub seen: Vec<bool>,
    /// The first marking and step that writes an output symbol nobody asked for.
    pub unasked: Option<(MarkingId, usize)>,
    /// Why the markings have no end, if that was found; then nothing else is complete.
    pub growth: Option<Growth>,
    /// The nearest marking from which there is no sure way back to rest, when edges were kept and
    /// all markings found.
    pub trapped: Option<MarkingId>,
    /// The most tokens seen in each place.
    pub bounds: Vec<u32>,
    /// Bytes that hold the markings themselves, per marking.
    pub marking_bytes: usize,
    parents: Vec<(MarkingId, u32)>,
}

impl Space {
    /// A shortest sequence of steps (numbers in [`System::steps`]) from rest to a marking.
    #[must_use]
    pub fn path(&self, to: MarkingId) -> Vec<usize> {
        self.path_between(0, to)
    }

    fn path_between(&self, from: MarkingId, to: MarkingId) -> Vec<usize> {
        let mut path = Vec::new();
        let mut at = to;
        while at != from {
            let Some((parent, step)) = self.parents.get(at as usize) else {
                break;
            };
            path.push(*step as usize);
            at = *parent;
        }
        path.reverse();
        path
    }

    /// The marking that a sequence of steps leads to from rest.
    #[must_use]
    pub fn replay(system: &System, path: &[usize]) -> Vec<u32> {
        let mut marking: Vec<u32> = system.places().iter().map(|place| place.tokens).collect();
        for step in path.iter().filter_map(|step| system.steps().get(*step)) {
            for (place, change) in &step.changes {
                if let Some(tokens) = marking.get_mut(*place) {
                    *tokens = u32::try_from(i64::from(*tokens) + change).unwrap_or(0);
                }
            }
        }
        marking
    }
}

/// Finds the reachable markings of a system.
#[must_use]
pub fn explore(system: &System, limits: &Limits) -> Space {
    // One byte per place is enough for nearly all nets; the others are explored again.
    Explorer::<u8>::run(system, limits)
        .or_else(|TooWide| Explorer::<u32>::run(system, limits))
        .unwrap_or_default()
}

/// A marking holds more tokens than a cell can.
struct TooWide;

struct Explorer<'a, C> {
    system: &'a System,
    store: Store<C>,
    space: Space,
    /// Targets of all edges and, per marking, where its edges begin.
    targets: Vec<MarkingId>,
    starts: Vec<usize>,
    /// Whether any transition has a priority.
    priorities: bool,
    /// Places that some inhibitor arc looks at.
    inhibiting: Vec<bool>,
    /// Per enabling function: asserted and negated transitions enabled at the marking in hand.
    polarities: Vec<[bool; 2]>,
}

impl<'a, C: Cell> Explorer<'a, C> {
    fn run(system: &'a System, limits: &Limits) -> Result<Space, TooWide> {
        let mut rest = Vec::with_capacity(system.places().len());
        for place in system.places() {
            rest.push(C::try_from(place.tokens).map_err(|_| TooWide)?);
        }
        let mut inhibiting = vec![false; rest.len()];
        for (place, _) in system.steps().iter().flat_map(|step| &step.forbids) {
            inhibiting[*place] = true;
        }
        let mut explorer = Self {
            system,
            store: Store::new(rest.len()),
            space: Space {
                seen: vec![false; system.steps().len()],
                bounds: system.places().iter().map(|place| place.tokens).collect(),
                marking_bytes: rest.len() * size_of::<C>(),
                parents: vec![(0, 0)],
                ..Space::default()
            },
            targets: Vec::new(),
            starts: Vec::new(),
            priorities: system.steps().iter().any(|step| step.priority > Some(0)),
            inhibiting,
            polarities: vec![[false; 2]; system.functions],
        };
        explorer.store.insert(&rest);
        explorer.all(&mut rest, limits)?;
        Ok(explorer.finish(limits))
    }

    fn all(&mut self, marking: &mut Vec<C>, limits: &Limits) -> Result<(), TooWide> {
        let mut from: MarkingId = 0;
        let mut enabled: Vec<usize> = Vec::new();
        let mut sure: Vec<bool> = Vec::new();
        while (from as usize) < self.store.len() {
            marking.clear();
            marking.extend_from_slice(self.store.get(from));
            self.enabled(marking, &mut enabled, &mut sure);
            if from != 0 && !sure.contains(&true) {
                self.space.dead.push(from);
            }
            self.starts.push(self.targets.len());
            for (step, sure) in enabled.iter().zip(&sure) {
                let target = self.fire(from, *step, marking)?;
                self.space.edges += 1;
                if limits.edges && *sure {
                    self.targets.push(target);
                }
                if self.space.growth.is_some() {
                    return Ok(());
                }
            }
            if self.store.len() > limits.markings {
                return Ok(());
            }
            from += 1;
        }
        self.space.complete = true;
        Ok(())
    }

    /// The steps enabled at a marking and whether each is sure to stay possible: one with an
    /// enabling function is only sure when its negation is enabled as well, so that one of the two
    /// must be allowed.
    fn enabled(&mut self, marking: &[C], enabled: &mut Vec<usize>, sure: &mut Vec<bool>) {
        enabled.clear();
        sure.clear();
        let steps = self.system.steps();
        for (number, step) in steps.iter().enumerate() {
            if is_enabled(step, marking) {
                enabled.push(number);
            }
        }
        if self.priorities {
            self.drop_low_priorities(enabled);
        }
        let functions = |number: &usize| steps[*number].when;
        for (function, negated) in enabled.iter().filter_map(functions) {
            self.polarities[function][usize::from(negated)] = true;
        }
        for number in enabled.iter() {
            self.space.seen[*number] = true;
            sure.push(
                functions(number)
                    .is_none_or(|(function, _)| self.polarities[function] == [true; 2]),
            );
        }
        for (function, _) in enabled.iter().filter_map(functions) {
            self.polarities[function] = [false; 2];
        }
    }

    /// A net never starts a transition while a more urgent one without enabling function waits.
    fn drop_low_priorities(&self, enabled: &mut Vec<usize>) {
        let steps = self.system.steps();
        let mut most = vec![0; self.system.nets().len()];
        for step in enabled.iter().map(|number| &steps[*number]) {
            if step.when.is_none() {
                most[step.net] = step.priority.unwrap_or(0).max(most[step.net]);
            }
        }
        enabled.retain(|number| {
            let step = &steps[*number];
            step.priority
                .is_none_or(|priority| priority >= most[step.net])
        });
    }

    /// Fires a step and returns the marking it leads to.
    fn fire(
        &mut self,
        from: MarkingId,
        number: usize,
        marking: &mut [C],
    ) -> Result<MarkingId, TooWide> {
        let step = &self.system.steps()[number];
        if step.unasked && self.space.unasked.is_none() {
            self.space.unasked = Some((from, number));
        }
        let mut record = false;
        for (place, change) in &step.changes {
            let tokens =
                u32::try_from(i64::from(marking[*place].into()) + change).map_err(|_| TooWide)?;
            marking[*place] = C::try_from(tokens).map_err(|_| TooWide)?;
            if tokens > self.space.bounds[*place] {
                self.space.bounds[*place] = tokens;
                record = true;
            }
        }
        let (target, new) = self.store.insert(marking);
        if new {
            // Step numbers are far below 2^32: each takes memory.
            self.space
                .parents
                .push((from, u32::try_from(number).unwrap_or(u32::MAX)));
            // In a bounded net records are rare; in an unbounded one they never end. The sample
            // catches growth beside the path of the record.
            if record || target.is_multiple_of(64) {
                self.look_for_growth(target, marking);
            }
        }
        for (place, change) in &step.changes {
            let tokens = i64::from(marking[*place].into()) - change;
            marking[*place] = u32::try_from(tokens)
                .ok()
                .and_then(|tokens| C::try_from(tokens).ok())
                .unwrap_or(marking[*place]);
        }
        Ok(target)
    }

    /// A marking that covers one on its own path and is larger somewhere can be left in the same
    /// way again, and again: the place that grew has no bound. That holds unless a place that grew
    /// is looked at by an inhibitor arc, or priorities change what may fire.
    fn look_for_growth(&mut self, target: MarkingId, marking: &[C]) {
        let mut at = target;
        while at != 0 {
            at = self.space.parents[at as usize].0;
            let before = self.store.get(at);
            let covers = before.iter().zip(marking).all(|(b, a)| b <= a);
            if !covers {
                continue;
            }
            let grown = || (0..marking.len()).filter(|place| before[*place] < marking[*place]);
            if let Some(place) = grown().next()
                && !grown().any(|place| self.inhibiting[place])
                && !self.priorities
            {
                self.space.growth = Some(Growth {
                    place,
                    lead: self.space.path(at),
                    cycle: self.space.path_between(at, target),
                });
                return;
            }
        }
    }

    fn finish(mut self, limits: &Limits) -> Space {
        self.space.markings = self.store.len();
        if self.space.complete && limits.edges {
            self.space.trapped = self.trapped();
        }
        self.space
    }

    /// The first marking that does not lead back to rest, by a search against the edges.
    fn trapped(&self) -> Option<MarkingId> {
        let count = self.store.len();
        // The edges sorted by target: `first[t]..first[t + 1]` are the sources of target t.
        let mut first = vec![0_usize; count + 1];
        for target in &self.targets {
            first[*target as usize + 1] += 1;
        }
        for index in 0..count {
            first[index + 1] += first[index];
        }
        let mut next = first.clone();
        let mut sources: Vec<MarkingId> = vec![0; self.targets.len()];
        for (source, start) in (0..).zip(&self.starts) {
            let end = self.starts.get(source as usize + 1).copied();
            for target in &self.targets[*start..end.unwrap_or(self.targets.len())] {
                let slot = &mut next[*target as usize];
                sources[*slot] = source;
                *slot += 1;
            }
        }
        let mut returns = vec![false; count];
        let mut waiting = vec![0_usize];
        returns[0] = true;
        while let Some(target) = waiting.pop() {
            for source in &sources[first[target]..first[target + 1]] {
                let source = *source as usize;
                if !returns[source] {
                    returns[source] = true;
                    waiting.push(source);
                }
            }
        }
        let index = returns.iter().position(|returns| !returns)?;
        u32::try_from(index).ok()
    }
}

fn is_enabled<C: Cell>(step: &Step, marking: &[C]) -> bool {
    step.needs
        .iter()
        .all(|(place, weight)| marking[*place].into() >= *weight)
        && step
            .forbids
            .iter()
            .all(|(place, weight)| marking[*place].into() < *weight)
}
