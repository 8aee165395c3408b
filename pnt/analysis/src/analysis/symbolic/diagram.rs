//! Multi-valued decision diagrams: a set of markings as a graph that shares equal parts. Each level is
//! a place; a node lists, by number of tokens, the sets of what may stand in the places below. Equal
//! sets are the same node. Knows sets, not firings.

use std::hash::BuildHasher as _;

use hashbrown::{DefaultHashBuilder, HashMap, HashTable};

use super::{super::stop::Stop, Effort};

pub(super) type Node = u32;

/// The empty set.
pub(super) const NONE: Node = 0;

/// The set of the empty marking, below the last level.
pub(super) const UNIT: Node = 1;

/// Tokens of a place, and what may stand below.
pub(super) type Edge = (u32, Node);

/// The diagram has taken all the effort that it may, or numbers have outgrown their size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Full;

/// A condition on the tokens of one level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Condition {
    pub(super) level: u32,
    /// At least so many.
    pub(super) need: u32,
    /// Fewer than this.
    pub(super) below: u32,
}

impl Condition {
    pub(super) fn holds(self, tokens: u32) -> bool {
        (self.need..self.below).contains(&tokens)
    }
}

pub(super) struct Diagram {
    /// Where the edges of each node begin, and how many there are.
    nodes: Vec<(u32, u32)>,
    edges: Vec<Edge>,
    unique: HashTable<Node>,
    hasher: DefaultHashBuilder,
    unions: HashMap<(Node, Node), Node>,
    meets: HashMap<(Node, Node), Node>,
    /// Entries of caches that others keep.
    pub(super) cached: usize,
    steps: u64,
    most: Effort,
    stop: Stop,
}

impl Diagram {
    /// An empty diagram that may take so much effort, until it is stopped.
    pub(super) fn new(most: Effort, stop: Stop) -> Self {
        Self {
            // The two terminal nodes.
            nodes: vec![(0, 0); 2],
            edges: Vec::new(),
            unique: HashTable::new(),
            hasher: DefaultHashBuilder::default(),
            unions: HashMap::new(),
            meets: HashMap::new(),
            cached: 0,
            steps: 0,
            most,
            stop,
        }
    }

    /// Nodes that were made or found again so far.
    pub(super) fn steps(&self) -> u64 {
        self.steps
    }

    /// Bytes held, caches included.
    pub(super) fn bytes(&self) -> usize {
        let cached = self.unions.len() + self.meets.len() + self.cached;
        self.nodes.len() * (8 + 5) + self.edges.len() * 8 + cached * 20
    }

    fn range(&self, node: Node) -> std::ops::Range<usize> {
        let (start, length) = self.nodes[node as usize];
        start as usize..(start + length) as usize
    }

    pub(super) fn edges(&self, node: Node) -> &[Edge] {
        &self.edges[self.range(node)]
    }

    /// The edges of a node, for a caller who changes the diagram meanwhile.
    pub(super) fn copied(&self, node: Node) -> Vec<Edge> {
        self.edges(node).to_vec()
    }

    pub(super) fn child(&self, node: Node, tokens: u32) -> Node {
        let edges = self.edges(node);
        match edges.binary_search_by_key(&tokens, |edge| edge.0) {
            Ok(at) => edges[at].1,
            Err(_) => NONE,
        }
    }

    fn hash(&self, edges: &[Edge]) -> u64 {
        self.hasher.hash_one(edges)
    }

    /// The node with these edges, sorted by tokens and none of them to [`NONE`]. Nodes of different
    /// levels never have the same edges, but for the empty set.
    pub(super) fn node(&mut self, edges: &[Edge]) -> Result<Node, Full> {
        if edges.is_empty() {
            return Ok(NONE);
        }
        self.steps += 1;
        if self.steps > self.most.steps {
            return Err(Full);
        }
        let hash = self.hash(edges);
        if let Some(node) = self.unique.find(hash, |node| self.edges(*node) == edges) {
            return Ok(*node);
        }
        if self.bytes() > self.most.bytes || self.stop.is_set() {
            return Err(Full);
        }
        let node = Node::try_from(self.nodes.len()).map_err(|_| Full)?;
        let start = u32::try_from(self.edges.len()).map_err(|_| Full)?;
        let length = u32::try_from(edges.len()).map_err(|_| Full)?;
        start.checked_add(length).ok_or(Full)?;
        self.edges.extend_from_slice(edges);
        self.nodes.push((start, length));
        let (nodes, all, hasher) = (&self.nodes, &self.edges, &self.hasher);
        self.unique.insert_unique(hash, node, |node| {
            let (start, length) = nodes[*node as usize];
            hasher.hash_one(&all[start as usize..(start + length) as usize])
        });
        Ok(node)
    }

    /// The set of one marking.
    pub(super) fn single(&mut self, marking: &[u32]) -> Result<Node, Full> {
        let mut node = UNIT;
        for tokens in marking.iter().rev() {
            node = self.node(&[(*tokens, node)])?;
        }
        Ok(node)
    }

    pub(super) fn contains(&self, set: Node, marking: &[u32]) -> bool {
        marking
            .iter()
            .fold(set, |node, tokens| self.child(node, *tokens))
            == UNIT
    }

    /// A marking of a set that is not empty: the first one by tokens, level by level.
    pub(super) fn first(&self, set: Node) -> Vec<u32> {
        let mut marking = Vec::new();
        let mut node = set;
        while let Some((tokens, child)) = self.edges(node).first() {
            marking.push(*tokens);
            node = *child;
        }
        marking
    }

    /// What is in either set.
    pub(super) fn union(&mut self, a: Node, b: Node) -> Result<Node, Full> {
        if a == b || b == NONE {
            return Ok(a);
        }
        if a == NONE {
            return Ok(b);
        }
        let key = (a.min(b), a.max(b));
        if let Some(known) = self.unions.get(&key) {
            return Ok(*known);
        }
        let (left, right) = (self.copied(a), self.copied(b));
        let mut merged: Vec<Edge> = Vec::with_capacity(left.len() + right.len());
        let (mut left, mut right) = (left.into_iter().peekable(), right.into_iter().peekable());
        loop {
            match (left.peek().copied(), right.peek().copied()) {
                (Some(one), Some(other)) if one.0 == other.0 => {
                    merged.push((one.0, self.union(one.1, other.1)?));
                    left.next();
                    right.next();
                }
                (Some(one), Some(other)) if one.0 < other.0 => {
                    merged.push(one);
                    left.next();
                }
                (Some(one), None) => {
                    merged.push(one);
                    left.next();
                }
                (_, Some(other)) => {
                    merged.push(other);
                    right.next();
                }
                (None, None) => break,
            }
        }
        let node = self.node(&merged)?;
        self.unions.insert(key, node);
        Ok(node)
    }

    /// What is in both sets.
    pub(super) fn meet(&mut self, a: Node, b: Node) -> Result<Node, Full> {
        if a == b || a == NONE {
            return Ok(a);
        }
        if b == NONE {
            return Ok(NONE);
        }
        let key = (a.min(b), a.max(b));
        if let Some(known) = self.meets.get(&key) {
            return Ok(*known);
        }
        let mut common = Vec::new();
        for (tokens, child) in self.copied(a) {
            let both = self.meet(child, self.child(b, tokens))?;
            if both != NONE {
                common.push((tokens, both));
            }
        }
        let node = self.node(&common)?;
        self.meets.insert(key, node);
        Ok(node)
    }

    /// Empties the caches.
    pub(super) fn forget(&mut self) {
        self.unions.clear();
        self.meets.clear();
    }

    /// What is in the first set only.
    pub(super) fn minus(&mut self, a: Node, b: Node) -> Result<Node, Full> {
        self.minus_cached(a, b, &mut HashMap::new())
    }

    fn minus_cached(
        &mut self,
        a: Node,
        b: Node,
        cache: &mut HashMap<(Node, Node), Node>,
    ) -> Result<Node, Full> {
        if a == b || a == NONE {
            return Ok(NONE);
        }
        if b == NONE {
            return Ok(a);
        }
        if let Some(known) = cache.get(&(a, b)) {
            return Ok(*known);
        }
        let mut rest = Vec::new();
        for (tokens, child) in self.copied(a) {
            let left = self.minus_cached(child, self.child(b, tokens), cache)?;
            if left != NONE {
                rest.push((tokens, left));
            }
        }
        let node = self.node(&rest)?;
        cache.insert((a, b), node);
        Ok(node)
    }

    /// The markings of a set for which all conditions hold, or (`keep` false) for which not all do.
    /// Conditions are sorted by level.
    pub(super) fn restrict(
        &mut self,
        set: Node,
        conditions: &[Condition],
        keep: bool,
    ) -> Result<Node, Full> {
        self.restrict_at(set, 0, conditions, keep, &mut HashMap::new())
    }

    fn restrict_at(
        &mut self,
        set: Node,
        level: u32,
        conditions: &[Condition],
        keep: bool,
        cache: &mut HashMap<Node, Node>,
    ) -> Result<Node, Full> {
        let Some((first, rest)) = conditions.split_first() else {
            return Ok(if keep { set } else { NONE });
        };
        if set == NONE {
            return Ok(NONE);
        }
        if let Some(known) = cache.get(&set) {
            return Ok(*known);
        }
        let mut kept = Vec::new();
        for (tokens, child) in self.copied(set) {
            let below = if first.level > level {
                self.restrict_at(child, level + 1, conditions, keep, cache)?
            } else if first.holds(tokens) {
                self.restrict_at(child, level + 1, rest, keep, cache)?
            } else if keep {
                NONE
            } else {
                child
            };
            if below != NONE {
                kept.push((tokens, below));
            }
        }
        let node = self.node(&kept)?;
        cache.insert(set, node);
        Ok(node)
    }

    /// How many markings a set has.
    pub(super) fn count(&self, set: Node, cache: &mut HashMap<Node, u128>) -> Result<u128, Full> {
        match set {
            NONE => return Ok(0),
            UNIT => return Ok(1),
            _ => {}
        }
        if let Some(known) = cache.get(&set) {
            return Ok(*known);
        }
        let mut sum = 0_u128;
        for (_, child) in self.edges(set) {
            sum = sum.checked_add(self.count(*child, cache)?).ok_or(Full)?;
        }
        cache.insert(set, sum);
        Ok(sum)
    }

    /// The most tokens in each level, and in a whole marking.
    pub(super) fn most(&self, set: Node, levels: usize) -> (Vec<u32>, u64) {
        let mut bounds = vec![0; levels];
        let sum = self.most_at(set, 0, &mut bounds, &mut HashMap::new());
        (bounds, sum)
    }

    fn most_at(
        &self,
        node: Node,
        level: usize,
        bounds: &mut [u32],
        cache: &mut HashMap<Node, u64>,
    ) -> u64 {
        if node <= UNIT {
            return 0;
        }
        if let Some(known) = cache.get(&node) {
            return *known;
        }
        let mut most = 0;
        for (tokens, child) in self.edges(node) {
            bounds[level] = bounds[level].max(*tokens);
            let below = self.most_at(*child, level + 1, bounds, cache);
            most = most.max(u64::from(*tokens).saturating_add(below));
        }
        cache.insert(node, most);
        most
    }
}
