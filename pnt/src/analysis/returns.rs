//! Where markings lead in the end: the strongly connected components of the reachability graph that
//! nothing leaves. From them follow liveness, home states and reversibility. Edges are not kept; a
//! marking is expanded again when its successors are asked for.

use super::{
    explicit::{Explored, Scratch},
    layout::linear,
    model::TransitionNumber,
    store::Looks,
};

/// What the reachability graph says about the long run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Returns {
    /// Whether the initial marking can be reached from every reachable marking.
    pub reversible: bool,
    /// The nearest marking, by distance, from which there is no way back to the initial one.
    pub no_return: Option<Vec<u32>>,
    /// Terminal components: once a run is inside, it stays there.
    pub terminal: usize,
    /// Markings that can be reached from every reachable one; none unless there is one terminal
    /// component.
    pub home_states: usize,
    /// Per label of the model, whether one of its transitions can become enabled again from every
    /// reachable marking.
    pub live: Vec<bool>,
    /// Bytes that this took at most.
    pub bytes: usize,
}

impl Returns {
    /// Whether every transition is live.
    #[must_use]
    pub fn all_live(&self) -> bool {
        self.live.iter().all(|live| *live)
    }
}

/// Finds the terminal components of a complete reachability graph; nothing when that would take more
/// bytes than permitted.
#[must_use]
pub fn returns(explored: &Explored<'_>, bytes: usize) -> Option<Returns> {
    if explored.markings / 8 > bytes {
        return None;
    }
    // Where all firings are sure, what is reachable is reachable from wherever the initial marking is.
    let quick = (!explored.rules.has_whens).then(|| all_return(explored));
    if let Some(bytes) = quick.flatten() {
        let mut live = vec![false; explored.model.label_count()];
        for (transition, seen) in explored.model.transitions.iter().zip(&explored.seen) {
            if let (Some(label), true) = (transition.label, seen) {
                live[label as usize] = true;
            }
        }
        return Some(Returns {
            reversible: true,
            no_return: None,
            terminal: 1,
            home_states: explored.markings,
            live,
            bytes,
        });
    }
    let needed = components_bytes(explored)?;
    (needed <= bytes).then(|| Components::new(explored, &|_| true).find(needed))
}

/// Whether from every reachable marking one as wanted can be reached: if not, a marking from which none
/// can. Nothing when the search was not complete, or more bytes than permitted would be needed.
#[must_use]
pub fn always_reachable(
    explored: &Explored<'_>,
    wanted: &dyn Fn(&[u32]) -> bool,
    bytes: usize,
) -> Option<Option<Vec<u32>>> {
    if !explored.complete() || components_bytes(explored)? > bytes {
        return None;
    }
    let mut components = Components::new(explored, wanted);
    components.visit_all();
    Some(components.without_wanted)
}

/// Index, lowest index, stack and call frame of every marking, whether it returns, and where its firings
/// lead.
fn components_bytes(explored: &Explored<'_>) -> Option<usize> {
    let each = 4 + 4 + 4 + size_of::<Frame>() + 1;
    let edges = usize::try_from(explored.edges).ok()?.checked_mul(4)?;
    explored.markings.checked_mul(each)?.checked_add(edges)
}

/// The markings of all workers numbered through, and the firings between them.
struct Graph<'a> {
    explored: &'a Explored<'a>,
    /// The first number of each worker.
    offsets: Vec<usize>,
    scratch: Scratch,
    /// Packed successor.
    target: Vec<u64>,
    /// Packed successors of one marking, their sums, and what finds them.
    targets: Vec<u64>,
    sums: Vec<u64>,
    looks: Looks,
    numbers: Vec<u32>,
}

impl<'a> Graph<'a> {
    fn new(explored: &'a Explored<'a>) -> Self {
        let mut next = 0;
        let offsets = explored.stores().iter().map(|worker| {
            let first = next;
            next += worker.len();
            first
        });
        Self {
            offsets: offsets.collect(),
            explored,
            scratch: Scratch::default(),
            target: vec![0; explored.rules.layout.words],
            targets: Vec::new(),
            sums: Vec::new(),
            looks: Looks::default(),
            numbers: Vec::new(),
        }
    }

    fn packed(&self, node: usize) -> &'a [u64] {
        let worker = self
            .offsets
            .partition_point(|first| *first <= node)
            .saturating_sub(1);
        // A number within one worker has 32 bits.
        self.explored.stores()[worker]
            .store()
            .get((node - self.offsets[worker]) as u32)
    }

    /// Looks at a marking: its sure firings are then `self.scratch.enabled`.
    fn expand(&mut self, node: usize) {
        let rules = &self.explored.rules;
        rules
            .layout
            .unpack(self.packed(node), &mut self.scratch.marking);
        rules.enabled(&mut self.scratch);
        let mut sure = self.scratch.sure.iter();
        self.scratch.enabled.retain(|_| sure.next() == Some(&true));
    }

    /// The marking that a firing leads to; nothing when the search had stopped before it was found.
    fn successor(&mut self, node: usize, transition: TransitionNumber) -> Option<usize> {
        let rules = &self.explored.rules;
        let from = self.packed(node);
        let packed = rules.packed.get(transition as usize)?;
        let sum = packed.fire(&rules.layout, from, linear(from), &mut self.target);
        let worker = self.explored.owner(sum);
        let id = self.explored.stores()[worker]
            .store()
            .find(&self.target, sum)?;
        Some(self.offsets[worker] + id as usize)
    }

    /// The markings that the sure firings at a marking lead to, in order; nothing when the search had
    /// stopped before one was found.
    fn successors(&mut self, node: usize, successors: &mut Vec<usize>) -> Option<()> {
        self.expand(node);
        successors.clear();
        let explored = self.explored;
        let [worker] = explored.stores() else {
            let enabled = std::mem::take(&mut self.scratch.enabled);
            for transition in &enabled {
                successors.push(self.successor(node, *transition)?);
            }
            self.scratch.enabled = enabled;
            return Some(());
        };
        let rules = &explored.rules;
        let from = self.packed(node);
        let sum = linear(from);
        self.targets.clear();
        self.sums.clear();
        for transition in &self.scratch.enabled {
            let packed = rules.packed.get(*transition as usize)?;
            let sum = packed.fire_onto(&rules.layout, from, sum, &mut self.targets);
            self.sums.push(sum);
        }
        let store = worker.store();
        store.find_all(
            &self.targets,
            &self.sums,
            &mut self.looks,
            &mut self.numbers,
        )?;
        successors.extend(self.numbers.iter().map(|number| *number as usize));
        Some(())
    }

    /// The number of the initial marking.
    fn initial(&self) -> Option<usize> {
        let mut packed = Vec::new();
        self.explored
            .rules
            .layout
            .pack(&self.explored.model.initial(), &mut packed);
        let sum = linear(&packed);
        let worker = self.explored.owner(sum);
        let id = self.explored.stores()[worker].store().find(&packed, sum)?;
        Some(self.offsets[worker] + id as usize)
    }
}

/// A quick answer for most nets: walks from every marking until it meets one that is known to return.
/// All markings on the walk return as well. What leads only to markings of the walk itself is left aside
/// and looked at again when more is known. The bytes it took, when all return; nothing when that is not
/// so, or not found in this way.
fn all_return(explored: &Explored<'_>) -> Option<usize> {
    const UNKNOWN: u8 = 0;
    const SEEN: u8 = 1;
    const RETURNS: u8 = 2;
    let mut graph = Graph::new(explored);
    let mut state = vec![UNKNOWN; explored.markings];
    state[graph.initial()?] = RETURNS;
    let mut walk: Vec<(usize, u32)> = Vec::new();
    let mut longest = 0;
    let mut aside: Vec<usize> = Vec::new();
    let mut successors = Vec::new();
    for root in 0..explored.markings {
        if state[root] != UNKNOWN {
            continue;
        }
        state[root] = SEEN;
        walk.push((root, 0));
        while let Some((node, tried)) = walk.last().copied() {
            graph.successors(node, &mut successors)?;
            if successors.is_empty() {
                return None;
            }
            let mut next = None;
            for (position, successor) in (0_u32..).zip(&successors).skip(tried as usize) {
                match state[*successor] {
                    RETURNS => {
                        next = Some(None);
                        break;
                    }
                    UNKNOWN if next.is_none() => next = Some(Some((position, *successor))),
                    _ => {}
                }
            }
            match next {
                Some(None) => {
                    for (node, _) in walk.drain(..) {
                        state[node] = RETURNS;
                    }
                }
                Some(Some((position, successor))) => {
                    if let Some(top) = walk.last_mut() {
                        top.1 = position + 1;
                    }
                    state[successor] = SEEN;
                    walk.push((successor, 0));
                    longest = longest.max(walk.len());
                }
                None => {
                    walk.pop();
                    aside.push(node);
                }
            }
        }
    }
    let most = aside.len();
    // What was put aside last leads to what was on the walk longest.
    while !aside.is_empty() {
        let before = aside.len();
        let mut left = Vec::new();
        for node in aside.into_iter().rev() {
            graph.successors(node, &mut successors)?;
            let returns = successors.iter().any(|to| state[*to] == RETURNS);
            if returns {
                state[node] = RETURNS;
            } else {
                left.push(node);
            }
        }
        // The other way will tell which of them do not.
        if left.len() == before {
            return None;
        }
        left.reverse();
        aside = left;
    }
    let lists = longest * size_of::<(usize, u32)>() + 2 * most * size_of::<usize>();
    Some(explored.markings + lists)
}

/// Tarjan's algorithm (1972) with a stack of its own.
struct Components<'a> {
    graph: Graph<'a>,
    index: Vec<u32>,
    low: Vec<u32>,
    /// Nodes whose component is not complete.
    open: Vec<u32>,
    frames: Vec<Frame>,
    /// Where the firings at the markings of the frames lead, one frame's behind the other's.
    ahead: Vec<u32>,
    successors: Vec<usize>,
    next: u32,
    live: Vec<bool>,
    terminal: usize,
    home_states: usize,
    /// Of nodes whose component is complete, whether a way leads to the initial marking.
    returns: Vec<bool>,
    wanted: &'a dyn Fn(&[u32]) -> bool,
    /// A marking of a terminal component that has none as wanted.
    without_wanted: Option<Vec<u32>>,
}

struct Frame {
    node: u32,
    /// Where its successors begin in the list of all, and the one to be followed next.
    start: usize,
    position: usize,
    /// Whether something leaves the part of the component found so far.
    leaves: bool,
    /// Whether something leads to a marking from which a way leads to the initial one.
    returns: bool,
}

/// Not visited.
const NEW: u32 = u32::MAX;
/// In a component that is complete.
const DONE: u32 = u32::MAX - 1;

impl<'a> Components<'a> {
    fn new(explored: &'a Explored<'a>, wanted: &'a dyn Fn(&[u32]) -> bool) -> Self {
        Self {
            graph: Graph::new(explored),
            index: vec![NEW; explored.markings],
            low: vec![NEW; explored.markings],
            open: Vec::new(),
            frames: Vec::new(),
            ahead: Vec::new(),
            successors: Vec::new(),
            next: 0,
            live: vec![true; explored.model.label_count()],
            terminal: 0,
            home_states: 0,
            returns: vec![false; explored.markings],
            wanted,
            without_wanted: None,
        }
    }

    fn find(mut self, bytes: usize) -> Returns {
        self.visit_all();
        let reversible = self.returns.iter().all(|returns| *returns);
        let no_return = (!reversible).then(|| self.no_return()).flatten();
        Returns {
            reversible,
            no_return,
            terminal: self.terminal,
            home_states: if self.terminal == 1 {
                self.home_states
            } else {
                0
            },
            live: self.live,
            bytes,
        }
    }

    /// All components.
    fn visit_all(&mut self) {
        let initial = self.graph.initial().unwrap_or(0);
        self.visit_from(initial, initial);
        // What only firings lead to that are not sure.
        for root in 0..self.index.len() {
            if self.index[root] == NEW {
                self.visit_from(root, initial);
            }
        }
    }

    /// All that is reached from here and was not visited before.
    fn visit_from(&mut self, root: usize, initial: usize) {
        self.visit(root);
        while let Some(frame) = self.frames.last_mut() {
            let node = frame.node;
            match self.ahead.get(frame.position).copied() {
                Some(successor) => {
                    frame.position += 1;
                    self.follow(node, successor as usize);
                }
                None => self.leave(initial),
            }
        }
    }

    /// The nearest marking from which no way leads to the initial one.
    fn no_return(&self) -> Option<Vec<u32>> {
        let explored = self.graph.explored;
        let mut best: Option<(usize, Vec<u32>)> = None;
        for (worker, first) in explored.stores().iter().zip(&self.graph.offsets) {
            let lost = (0..worker.len()).find(|id| !self.returns[first + id]);
            if let Some(id) = lost {
                // A number within one worker has 32 bits.
                let id = id as u32;
                let mut marking = Vec::new();
                explored
                    .rules
                    .layout
                    .unpack(worker.store().get(id), &mut marking);
                let found = (worker.level_of(id), marking);
                best = Some(best.map_or(found.clone(), |best| best.min(found)));
            }
        }
        best.map(|(_, marking)| marking)
    }

    fn visit(&mut self, node: usize) {
        self.index[node] = self.next;
        self.low[node] = self.next;
        self.next += 1;
        let start = self.ahead.len();
        // All were found: the graph is complete.
        if self.graph.successors(node, &mut self.successors).is_some() {
            // Fewer than 2^32 markings in all: their lists are in memory.
            self.ahead
                .extend(self.successors.iter().map(|to| *to as u32));
        }
        let node = node as u32;
        self.open.push(node);
        self.frames.push(Frame {
            node,
            start,
            position: start,
            leaves: false,
            returns: false,
        });
    }

    /// Follows a firing of the top frame's marking.
    fn follow(&mut self, node: u32, successor: usize) {
        let Some(frame) = self.frames.last_mut() else {
            return;
        };
        match self.index[successor] {
            NEW => {
                self.visit(successor);
            }
            DONE => {
                frame.leaves = true;
                frame.returns |= self.returns[successor];
            }
            index => {
                let low = &mut self.low[node as usize];
                *low = (*low).min(index);
            }
        }
    }

    /// All successors of the top frame are looked at.
    fn leave(&mut self, initial: usize) {
        let Some(frame) = self.frames.pop() else {
            return;
        };
        self.ahead.truncate(frame.start);
        let node = frame.node as usize;
        let low = self.low[node];
        let complete = low == self.index[node];
        if complete {
            self.complete(&frame, initial);
        }
        if let Some(parent) = self.frames.last_mut() {
            parent.returns |= frame.returns || self.returns[node];
            if complete {
                parent.leaves = true;
            } else {
                parent.leaves |= frame.leaves;
                let above = &mut self.low[parent.node as usize];
                *above = (*above).min(low);
            }
        }
    }

    /// The nodes from that of the frame up on the open stack are a component.
    fn complete(&mut self, frame: &Frame, initial: usize) {
        let root = frame.node;
        let mut fires = (!frame.leaves).then(|| vec![false; self.live.len()]);
        let mut size = 0;
        let mut wanted = false;
        // The initial marking is visited first, so it is the root of its component.
        let returns = frame.returns || root as usize == initial;
        while let Some(node) = self.open.pop() {
            size += 1;
            self.index[node as usize] = DONE;
            self.returns[node as usize] = returns;
            if let Some(fires) = &mut fires {
                self.graph.expand(node as usize);
                wanted |= (self.wanted)(&self.graph.scratch.marking);
                let transitions = &self.graph.explored.model.transitions;
                for transition in &self.graph.scratch.enabled {
                    if let Some(label) = transitions[*transition as usize].label {
                        fires[label as usize] = true;
                    }
                }
            }
            if node == root {
                break;
            }
        }
        if let Some(fires) = fires {
            if !wanted {
                self.graph.expand(root as usize);
                self.without_wanted = Some(self.graph.scratch.marking.clone());
            }
            self.terminal += 1;
            self.home_states = size;
            for (live, fires) in self.live.iter_mut().zip(fires) {
                *live &= fires;
            }
        }
    }
}
