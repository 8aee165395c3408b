//! Where markings lead in the end: the strongly connected components of the reachability graph that
//! nothing leaves. From them follow liveness, home states and reversibility. Edges are not kept; a
//! marking is expanded again when its successors are asked for.

mod walk;

use super::{
    explicit::{Explored, Reached, Scratch},
    layout::linear,
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

/// Finds the terminal components of a complete reachability graph; `None` when that would take more
/// bytes than permitted.
#[must_use]
pub fn returns(explored: &Explored<'_>, bytes: usize) -> Option<Returns> {
    if explored.store.numbers() / 8 > bytes {
        return None;
    }
    // Where all firings are sure, what is reachable is reachable from wherever the initial marking is: all
    // that returns is one component.
    let walked = (!explored.rules.has_whens).then(|| walk::returning(explored));
    let Some(walked) = walked.flatten() else {
        let needed = components_bytes(explored, explored.store.numbers())?;
        if needed > bytes {
            return None;
        }
        return Components::new(explored, &|_| true).find(needed);
    };
    if !walked.lost.is_empty() {
        let needed = components_bytes(explored, walked.lost.len())?.checked_add(walked.bytes)?;
        if needed > bytes {
            return None;
        }
        return Components::new(explored, &|_| true).find_lost(&walked.lost, needed);
    }
    let mut live = vec![false; explored.model.label_count()];
    for (transition, seen) in explored.model.transitions.iter().zip(&explored.seen) {
        if let (Some(label), true) = (transition.label, seen) {
            live[label as usize] = true;
        }
    }
    Some(Returns {
        reversible: true,
        no_return: None,
        terminal: 1,
        home_states: explored.markings,
        live,
        bytes: walked.bytes,
    })
}

/// Whether from every reachable marking one as wanted can be reached: if not, a marking from which none
/// can. Nothing when the search was not complete, it was stopped, or more bytes than permitted would be needed.
#[must_use]
pub fn always_reachable(
    explored: &Explored<'_>,
    wanted: &dyn Fn(&[u32]) -> bool,
    bytes: usize,
) -> Option<Option<Vec<u32>>> {
    if !explored.complete() || components_bytes(explored, explored.store.numbers())? > bytes {
        return None;
    }
    let mut components = Components::new(explored, wanted);
    components.visit_all()?;
    Some(components.without_wanted.map(|reached| reached.marking))
}

/// Index and lowest index of every marking, and whether it returns; stack and call frame of those that are
/// visited, and where their firings lead.
fn components_bytes(explored: &Explored<'_>, visited: usize) -> Option<usize> {
    let numbers = explored.store.numbers().checked_mul(4 + 4 + 1)?;
    let stacks = visited.checked_mul(4 + size_of::<Frame>())?;
    let most = visited.saturating_mul(explored.model.transitions.len());
    let edges = most.min(usize::try_from(explored.edges).ok()?);
    let edges = edges.checked_mul(4)?;
    numbers.checked_add(stacks)?.checked_add(edges)
}

/// The markings by number, and the firings between them.
struct Graph<'a> {
    explored: &'a Explored<'a>,
    scratch: Scratch,
    /// The packed marking that was expanded last.
    from: Vec<u64>,
    /// Packed successors of it, their sums, and what finds them.
    targets: Vec<u64>,
    sums: Vec<u64>,
    looks: Looks,
    numbers: Vec<u32>,
}

impl<'a> Graph<'a> {
    fn new(explored: &'a Explored<'a>) -> Self {
        Self {
            explored,
            scratch: Scratch::default(),
            from: Vec::new(),
            targets: Vec::new(),
            sums: Vec::new(),
            looks: Looks::default(),
            numbers: Vec::new(),
        }
    }

    /// Looks at a marking: its sure firings are then `self.scratch.enabled`.
    fn expand(&mut self, node: usize) {
        let explored = self.explored;
        // Numbers have 32 bits.
        explored.store.read(node as u32, &mut self.from);
        let rules = &explored.rules;
        rules.enabled(&self.from, &mut self.scratch);
        if rules.has_whens {
            let mut sure = self.scratch.sure.iter();
            self.scratch.enabled.retain(|_| sure.next() == Some(&true));
        }
    }

    /// Puts the markings that the sure firings at a marking lead to, in order, into `self.numbers`. `None`
    /// when the search had stopped before one was found.
    fn successors(&mut self, node: usize) -> Option<()> {
        self.expand(node);
        self.targets.clear();
        self.sums.clear();
        for position in 0..self.scratch.enabled.len() {
            self.fire(position);
        }
        self.find()
    }

    /// Puts a firing at the marking that was expanded last beside those that are looked for; false when it
    /// has fewer.
    fn fire(&mut self, position: usize) -> bool {
        let rules = &self.explored.rules;
        let transition = self.scratch.enabled.get(position);
        let Some(packed) = transition.and_then(|number| rules.packed.get(*number as usize)) else {
            return false;
        };
        let sum = linear(&self.from);
        let sum = packed.fire_onto(&rules.layout, &self.from, sum, &mut self.targets);
        self.sums.push(sum);
        true
    }

    /// Looks for where the firings lead.
    fn find(&mut self) -> Option<()> {
        if self.explored.stop.is_set() {
            return None;
        }
        let (targets, looks) = (&self.targets, &mut self.looks);
        let store = &self.explored.store;
        store.find_all(targets, &self.sums, looks, &mut self.numbers)
    }

    /// Where a single firing at the marking that was expanded last leads.
    fn successor(&mut self, position: usize) -> Option<u32> {
        if self.explored.stop.is_set() {
            return None;
        }
        self.targets.clear();
        self.sums.clear();
        self.fire(position);
        self.explored.store.find(&self.targets, *self.sums.first()?)
    }

    /// All markings.
    fn nodes(&self) -> impl Iterator<Item = usize> + use<'a> {
        self.explored.levels.numbers().map(|number| number as usize)
    }

    /// The number of the initial marking.
    fn initial(&self) -> Option<usize> {
        let mut packed = Vec::new();
        let explored = self.explored;
        let initial = explored.model.initial();
        explored.rules.layout.pack(&initial, &mut packed);
        let number = explored.store.find(&packed, linear(&packed))?;
        Some(number as usize)
    }
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
    next: u32,
    live: Vec<bool>,
    terminal: usize,
    home_states: usize,
    /// Of nodes whose component is complete, whether a way leads to the initial marking.
    returns: Vec<bool>,
    wanted: &'a dyn Fn(&[u32]) -> bool,
    /// The nearest, and of those the least, marking of the terminal components that have none as wanted.
    without_wanted: Option<Reached>,
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
            index: vec![NEW; explored.store.numbers()],
            low: vec![NEW; explored.store.numbers()],
            open: Vec::new(),
            frames: Vec::new(),
            ahead: Vec::new(),
            next: 0,
            live: vec![true; explored.model.label_count()],
            terminal: 0,
            home_states: 0,
            returns: vec![false; explored.store.numbers()],
            wanted,
            without_wanted: None,
        }
    }

    fn find(mut self, bytes: usize) -> Option<Returns> {
        self.visit_all()?;
        Some(self.told(bytes))
    }

    /// The same where all markings return but these, which nothing leads out of.
    fn find_lost(mut self, lost: &[u32], bytes: usize) -> Option<Returns> {
        self.returns.fill(true);
        for node in lost {
            self.returns[*node as usize] = false;
        }
        let initial = self.graph.initial().unwrap_or(0);
        for root in lost {
            if self.index[*root as usize] == NEW {
                self.visit_from(*root as usize, initial)?;
            }
        }
        Some(self.told(bytes))
    }

    fn told(self, bytes: usize) -> Returns {
        let reversible = self.graph.nodes().all(|node| self.returns[node]);
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

    /// All components; `None` when that was stopped.
    fn visit_all(&mut self) -> Option<()> {
        let initial = self.graph.initial().unwrap_or(0);
        self.visit_from(initial, initial)?;
        // What only firings lead to that are not sure.
        for root in self.graph.nodes() {
            if self.index[root] == NEW {
                self.visit_from(root, initial)?;
            }
        }
        Some(())
    }

    /// All that is reached from here and was not visited before.
    fn visit_from(&mut self, root: usize, initial: usize) -> Option<()> {
        self.visit(root);
        while let Some(frame) = self.frames.last_mut() {
            if self.graph.explored.stop.is_set() {
                return None;
            }
            let node = frame.node;
            match self.ahead.get(frame.position).copied() {
                Some(successor) => {
                    frame.position += 1;
                    self.follow(node, successor as usize);
                }
                None => self.leave(initial),
            }
        }
        Some(())
    }

    /// The nearest marking from which no way leads to the initial one; of those, the least.
    fn no_return(&self) -> Option<Vec<u32>> {
        let lost = |marking: u32| !self.returns[marking as usize];
        self.graph.explored.nearest_number(lost)
    }

    fn visit(&mut self, node: usize) {
        self.index[node] = self.next;
        self.low[node] = self.next;
        self.next += 1;
        let start = self.ahead.len();
        // All were found: the graph is complete.
        if self.graph.successors(node).is_some() {
            self.ahead.extend_from_slice(&self.graph.numbers);
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
        let mut nearest: Option<Reached> = None;
        // The initial marking is visited first, so it is the root of its component.
        let returns = frame.returns || root as usize == initial;
        while let Some(node) = self.open.pop() {
            size += 1;
            self.index[node as usize] = DONE;
            self.returns[node as usize] = returns;
            if let Some(fires) = &mut fires {
                self.graph.expand(node as usize);
                let graph = &mut self.graph;
                let layout = &graph.explored.rules.layout;
                layout.unpack(&graph.from, &mut graph.scratch.marking);
                let marking = &self.graph.scratch.marking;
                wanted |= (self.wanted)(marking);
                if !wanted {
                    // Every node has a level.
                    let distance = self.graph.explored.levels.of(node).unwrap_or(usize::MAX);
                    let nearer =
                        |best: &Reached| (distance, marking) < (best.distance, &best.marking);
                    if nearest.as_ref().is_none_or(nearer) {
                        nearest = Some(Reached {
                            distance,
                            marking: marking.clone(),
                        });
                    }
                }
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
                let others = self.without_wanted.take();
                self.without_wanted = others.into_iter().chain(nearest).min();
            }
            self.terminal += 1;
            self.home_states = size;
            for (live, fires) in self.live.iter_mut().zip(fires) {
                *live &= fires;
            }
        }
    }
}
