//! Firings on decision diagrams. Saturation (Ciardo, Luettgen and Siminiceanu 2001): from the bottom
//! up, every node is closed under all firings that change nothing above it. Backwards it is the same
//! within a set that is not left (Zhao and Ciardo 2009).

use hashbrown::HashMap;

use super::{
    super::{model::Model, stop::Stop},
    Effort,
    diagram::{Condition, Diagram, Edge, Full, NONE, Node},
};

/// What a transition does to one level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Local {
    pub(super) condition: Condition,
    change: i64,
    /// What stands there afterwards, whatever stood there before.
    reset: Option<u32>,
}

impl Local {
    fn after(self, tokens: u32) -> Result<u32, Full> {
        match self.reset {
            Some(after) => Ok(after),
            None => u32::try_from(i64::from(tokens) + self.change).map_err(|_| Full),
        }
    }
}

/// What a transition does to the levels it looks at, from the top down.
pub(super) type Event = Vec<Local>;

/// The transitions of a model, in order.
pub(super) fn events(model: &Model, levels: &[u32]) -> Vec<Event> {
    let event = |transition: &super::super::model::Transition| {
        let mut locals: Event = Vec::new();
        let mut at = |place: u32| {
            let level = levels[place as usize];
            if let Some(index) = locals.iter().position(|l| l.condition.level == level) {
                return index;
            }
            locals.push(Local {
                condition: Condition {
                    level,
                    need: 0,
                    below: u32::MAX,
                },
                change: 0,
                reset: None,
            });
            locals.len() - 1
        };
        let needs: Vec<_> = transition
            .needs()
            .iter()
            .map(|(p, w)| (at(*p), *w))
            .collect();
        let forbids = transition.forbids(&model.places);
        let forbids: Vec<_> = forbids.iter().map(|(p, w)| (at(*p), *w)).collect();
        let changes: Vec<_> = transition
            .changes()
            .iter()
            .map(|(p, c)| (at(*p), *c))
            .collect();
        let resets = transition.after_reset();
        let resets: Vec<_> = resets.iter().map(|(p, after)| (at(*p), *after)).collect();
        for (index, weight) in needs {
            locals[index].condition.need = weight;
        }
        for (index, weight) in forbids {
            let below = &mut locals[index].condition.below;
            *below = weight.min(*below);
        }
        for (index, change) in changes {
            locals[index].change = change;
        }
        for (index, after) in resets {
            locals[index].reset = Some(after);
        }
        locals.sort_unstable_by_key(|local| local.condition.level);
        locals
    };
    model.transitions.iter().map(event).collect()
}

pub(super) struct Firing<'a> {
    pub(super) diagram: Diagram,
    pub(super) events: &'a [Event],
    /// Per level, the transitions that change something and whose topmost level it is.
    by_top: Vec<Vec<usize>>,
    saturated: HashMap<Node, Node>,
    fired: HashMap<(usize, Node), Node>,
    returned: HashMap<(Node, Node), Node>,
    unfired: HashMap<(usize, Node, Node), Node>,
}

impl<'a> Firing<'a> {
    pub(super) fn new(events: &'a [Event], levels: usize, most: Effort, stop: Stop) -> Self {
        let mut by_top = vec![Vec::new(); levels];
        for (number, event) in events.iter().enumerate() {
            let changes = event.iter().any(|l| l.change != 0 || l.reset.is_some());
            if let (true, Some(top)) = (changes, event.first()) {
                by_top[top.condition.level as usize].push(number);
            }
        }
        Self {
            diagram: Diagram::new(most, stop),
            events,
            by_top,
            saturated: HashMap::new(),
            fired: HashMap::new(),
            returned: HashMap::new(),
            unfired: HashMap::new(),
        }
    }

    fn note_cached(&mut self) {
        self.diagram.cached =
            self.saturated.len() + self.fired.len() + self.returned.len() + self.unfired.len();
    }

    /// Everything that can be reached from a set.
    pub(super) fn closure(&mut self, set: Node, level: usize) -> Result<Node, Full> {
        if level == self.by_top.len() || set == NONE {
            return Ok(set);
        }
        if let Some(known) = self.saturated.get(&set) {
            return Ok(*known);
        }
        let mut edges = self.diagram.copied(set);
        for (_, child) in &mut edges {
            *child = self.closure(*child, level + 1)?;
        }
        let node = self.fire_all(level, edges)?;
        self.saturated.insert(set, node);
        self.note_cached();
        Ok(node)
    }

    /// Fires what begins at this level until nothing is new. The nodes below are closed.
    fn fire_all(&mut self, level: usize, mut edges: Vec<Edge>) -> Result<Node, Full> {
        loop {
            let mut changed = false;
            for turn in 0..self.by_top[level].len() {
                let number = self.by_top[level][turn];
                let Some(local) = self.events[number].first().copied() else {
                    continue;
                };
                // By position, because new values may come in below it or above.
                let values: Vec<u32> = edges.iter().map(|edge| edge.0).collect();
                for tokens in values {
                    let Ok(at) = edges.binary_search_by_key(&tokens, |edge| edge.0) else {
                        continue;
                    };
                    if !local.condition.holds(tokens) {
                        continue;
                    }
                    let below = self.fire(number, 1, edges[at].1, level + 1)?;
                    changed |= self.add(&mut edges, local.after(tokens)?, below)?;
                }
            }
            if !changed {
                return self.diagram.node(&edges);
            }
        }
    }

    /// Adds a set below a number of tokens; whether that is new.
    fn add(&mut self, edges: &mut Vec<Edge>, tokens: u32, below: Node) -> Result<bool, Full> {
        if below == NONE {
            return Ok(false);
        }
        match edges.binary_search_by_key(&tokens, |edge| edge.0) {
            Ok(at) => {
                let united = self.diagram.union(edges[at].1, below)?;
                let new = united != edges[at].1;
                edges[at].1 = united;
                Ok(new)
            }
            Err(at) => {
                edges.insert(at, (tokens, below));
                Ok(true)
            }
        }
    }

    /// What the rest of a transition makes of a set; the result is closed.
    fn fire(
        &mut self,
        number: usize,
        position: usize,
        set: Node,
        level: usize,
    ) -> Result<Node, Full> {
        if set == NONE {
            return Ok(NONE);
        }
        let Some(local) = self.events[number].get(position).copied() else {
            return Ok(set);
        };
        if let Some(known) = self.fired.get(&(number, set)) {
            return Ok(*known);
        }
        let mut after: Vec<Edge> = Vec::new();
        for (tokens, child) in self.diagram.copied(set) {
            if local.condition.level as usize > level {
                let below = self.fire(number, position, child, level + 1)?;
                self.add(&mut after, tokens, below)?;
            } else if local.condition.holds(tokens) {
                let below = self.fire(number, position + 1, child, level + 1)?;
                self.add(&mut after, local.after(tokens)?, below)?;
            }
        }
        let node = if after.is_empty() {
            NONE
        } else {
            self.fire_all(level, after)?
        };
        self.fired.insert((number, set), node);
        self.note_cached();
        Ok(node)
    }

    /// Everything in `within` from which a marking of `set` can be reached. The set is part of it.
    pub(super) fn returning(
        &mut self,
        set: Node,
        within: Node,
        level: usize,
    ) -> Result<Node, Full> {
        if level == self.by_top.len() || set == NONE {
            return Ok(set);
        }
        if set == within {
            return Ok(set);
        }
        if let Some(known) = self.returned.get(&(set, within)) {
            return Ok(*known);
        }
        let mut edges = self.diagram.copied(set);
        for (tokens, child) in &mut edges {
            let below = self.diagram.child(within, *tokens);
            *child = self.returning(*child, below, level + 1)?;
        }
        let node = self.unfire_all(level, edges, within)?;
        self.returned.insert((set, within), node);
        self.note_cached();
        Ok(node)
    }

    fn unfire_all(
        &mut self,
        level: usize,
        mut edges: Vec<Edge>,
        within: Node,
    ) -> Result<Node, Full> {
        loop {
            let mut changed = false;
            for turn in 0..self.by_top[level].len() {
                let number = self.by_top[level][turn];
                let Some(local) = self.events[number].first().copied() else {
                    continue;
                };
                for (before, allowed) in self.diagram.copied(within) {
                    let Some(child) = before_to_child(&edges, local, before)? else {
                        continue;
                    };
                    let below = self.unfire(number, 1, child, allowed, level + 1)?;
                    changed |= self.add(&mut edges, before, below)?;
                }
            }
            if !changed {
                return self.diagram.node(&edges);
            }
        }
    }

    /// The markings within a set that the rest of a transition turns into markings of another; closed.
    fn unfire(
        &mut self,
        number: usize,
        position: usize,
        set: Node,
        within: Node,
        level: usize,
    ) -> Result<Node, Full> {
        if set == NONE || within == NONE {
            return Ok(NONE);
        }
        let Some(local) = self.events[number].get(position).copied() else {
            let both = self.diagram.meet(set, within)?;
            return self.returning(both, within, level);
        };
        if let Some(known) = self.unfired.get(&(number, set, within)) {
            return Ok(*known);
        }
        let edges = self.diagram.copied(set);
        let mut found: Vec<Edge> = Vec::new();
        for (before, allowed) in self.diagram.copied(within) {
            let (child, position) = if local.condition.level as usize > level {
                (Some(self.diagram.child(set, before)), position)
            } else {
                (before_to_child(&edges, local, before)?, position + 1)
            };
            let Some(child) = child else { continue };
            let below = self.unfire(number, position, child, allowed, level + 1)?;
            self.add(&mut found, before, below)?;
        }
        let node = if found.is_empty() {
            NONE
        } else {
            self.unfire_all(level, found, within)?
        };
        self.unfired.insert((number, set, within), node);
        self.note_cached();
        Ok(node)
    }

    /// The markings of `within` from which one firing leads into `set`.
    pub(super) fn before(&mut self, set: Node, within: Node) -> Result<Node, Full> {
        // What was remembered of other layers is of no use any more.
        self.diagram.forget();
        self.before_any(set, within, 0, &mut HashMap::new(), &mut HashMap::new())
    }

    /// The same for all transitions that begin at this level or below.
    fn before_any(
        &mut self,
        set: Node,
        within: Node,
        level: usize,
        any: &mut HashMap<(Node, Node), Node>,
        one: &mut HashMap<(usize, Node, Node), Node>,
    ) -> Result<Node, Full> {
        if set == NONE || within == NONE || level == self.by_top.len() {
            return Ok(NONE);
        }
        if let Some(known) = any.get(&(set, within)) {
            return Ok(*known);
        }
        let edges = self.diagram.copied(set);
        let mut found: Vec<Edge> = Vec::new();
        for (before, allowed) in self.diagram.copied(within) {
            let same = self.diagram.child(set, before);
            let below = self.before_any(same, allowed, level + 1, any, one)?;
            self.add(&mut found, before, below)?;
            for turn in 0..self.by_top[level].len() {
                let number = self.by_top[level][turn];
                let Some(local) = self.events[number].first().copied() else {
                    continue;
                };
                let Some(child) = before_to_child(&edges, local, before)? else {
                    continue;
                };
                let below = self.before_one(number, 1, child, allowed, level + 1, one)?;
                self.add(&mut found, before, below)?;
            }
        }
        let node = self.diagram.node(&found)?;
        any.insert((set, within), node);
        Ok(node)
    }

    fn before_one(
        &mut self,
        number: usize,
        position: usize,
        set: Node,
        within: Node,
        level: usize,
        cache: &mut HashMap<(usize, Node, Node), Node>,
    ) -> Result<Node, Full> {
        if set == NONE || within == NONE {
            return Ok(NONE);
        }
        let Some(local) = self.events[number].get(position).copied() else {
            return self.diagram.meet(set, within);
        };
        if let Some(known) = cache.get(&(number, set, within)) {
            return Ok(*known);
        }
        let edges = self.diagram.copied(set);
        let mut found: Vec<Edge> = Vec::new();
        for (before, allowed) in self.diagram.copied(within) {
            let (child, position) = if local.condition.level as usize > level {
                (Some(self.diagram.child(set, before)), position)
            } else {
                (before_to_child(&edges, local, before)?, position + 1)
            };
            let Some(child) = child else { continue };
            let below = self.before_one(number, position, child, allowed, level + 1, cache)?;
            self.add(&mut found, before, below)?;
        }
        let node = self.diagram.node(&found)?;
        cache.insert((number, set, within), node);
        Ok(node)
    }
}

/// What stands below the tokens that a level holds after a firing, if it may fire at these before.
fn before_to_child(edges: &[Edge], local: Local, before: u32) -> Result<Option<Node>, Full> {
    if !local.condition.holds(before) {
        return Ok(None);
    }
    let after = local.after(before)?;
    let at = edges.binary_search_by_key(&after, |edge| edge.0).ok();
    Ok(at.and_then(|at| edges.get(at)).map(|edge| edge.1))
}
