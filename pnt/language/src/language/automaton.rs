//! From an expression to the smallest automaton that knows it: Thompson's construction (1968), sets of
//! its nodes, and Moore's partition (1956). Each of its states can still come to the end of a word.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use super::{Expression, SymbolNumber};

/// Steps of the first construction, which has a node for every symbol as often as it is repeated.
const MOST_NODES: usize = 10_000;

/// States of the automaton.
const MOST_STATES: usize = 2_000;

/// Pairs of a state and a symbol that may come there.
const MOST_EDGES: usize = 100_000;

/// Nodes visited while the states are found.
const MOST_VISITS: usize = 20_000_000;

/// A state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct State {
    /// Whether a word may end here.
    pub ends: bool,
    /// Symbols that may come, in order, and the state after each.
    pub next: Vec<(SymbolNumber, usize)>,
}

/// A regular language over symbols `0..n`, as its smallest automaton. State 0 is the first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Language {
    states: Vec<State>,
}

/// The automaton has too many states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the language is too large: it has more than {MOST_STATES} different situations, or {MOST_EDGES} ways on from them"
)]
pub struct TooLarge;

impl Language {
    /// The language of an expression over `symbols` symbols.
    ///
    /// # Errors
    /// When the automaton gets too large.
    pub fn new(expression: &Expression<SymbolNumber>, symbols: usize) -> Result<Self, TooLarge> {
        let mut nodes = Nodes {
            list: vec![Node::End],
            steps: 0,
        };
        let first = nodes.before(expression, 0)?;
        let states = nodes.determined(first, symbols)?;
        Ok(Self {
            states: smallest(&states),
        })
    }

    /// The states.
    #[must_use]
    pub fn states(&self) -> &[State] {
        &self.states
    }

    /// The states after which nothing more may come: one at most, because all such are alike.
    #[must_use]
    pub fn last(&self) -> Option<usize> {
        self.states.iter().position(|state| state.next.is_empty())
    }

    /// A shortest word that leads to a state.
    #[must_use]
    pub fn way(&self, state: usize) -> Vec<SymbolNumber> {
        // Before each state, the one from which it was come to first.
        let mut before: Vec<Option<(usize, SymbolNumber)>> = vec![None; self.states.len()];
        let mut open = VecDeque::from([0]);
        while let Some(from) = open.pop_front() {
            for (symbol, to) in self.states.get(from).iter().flat_map(|state| &state.next) {
                if let Some(new) = before.get_mut(*to).filter(|b| *to != 0 && b.is_none()) {
                    *new = Some((from, *symbol));
                    open.push_back(*to);
                }
            }
        }
        let mut way = Vec::new();
        let mut at = state;
        while let Some((from, symbol)) = before.get(at).copied().flatten() {
            way.push(symbol);
            at = from;
        }
        way.reverse();
        way
    }
}

/// A node of the first construction.
enum Node {
    /// A word may end.
    End,
    /// This symbol, or any one; then a node.
    Read(Option<SymbolNumber>, usize),
    /// Any of these nodes, without a symbol.
    Either(Vec<usize>),
}

struct Nodes {
    list: Vec<Node>,
    steps: usize,
}

impl Nodes {
    fn push(&mut self, node: Node) -> usize {
        self.list.push(node);
        self.list.len() - 1
    }

    /// The node at which an expression begins that is followed by the node `next`.
    fn before(
        &mut self,
        expression: &Expression<SymbolNumber>,
        next: usize,
    ) -> Result<usize, TooLarge> {
        // Repetitions of nothing make no nodes, and must come to an end as well.
        self.steps += 1;
        if self.steps > MOST_NODES {
            return Err(TooLarge);
        }
        match expression {
            Expression::Symbol(symbol) => Ok(self.push(Node::Read(Some(*symbol), next))),
            Expression::Any => Ok(self.push(Node::Read(None, next))),
            Expression::Sequence(parts) => {
                let parts = parts.iter().rev();
                parts
                    .into_iter()
                    .try_fold(next, |next, part| self.before(part, next))
            }
            Expression::Choice(parts) => {
                let firsts: Result<Vec<usize>, TooLarge> =
                    parts.iter().map(|part| self.before(part, next)).collect();
                Ok(self.push(Node::Either(firsts?)))
            }
            Expression::Repeat(inner, least, most) => {
                let mut first = match most {
                    None => {
                        let again = self.push(Node::Either(Vec::new()));
                        let body = self.before(inner, again)?;
                        self.list[again] = Node::Either(vec![body, next]);
                        again
                    }
                    Some(most) => (*least..*most).try_fold(next, |after, _| {
                        let body = self.before(inner, after)?;
                        Ok(self.push(Node::Either(vec![body, next])))
                    })?,
                };
                for _ in 0..*least {
                    first = self.before(inner, first)?;
                }
                Ok(first)
            }
        }
    }

    /// The nodes that read or end, of all that can be come to without a symbol.
    fn closed(&self, from: Vec<usize>, visits: &mut usize) -> Vec<usize> {
        let mut seen = BTreeSet::new();
        let mut open = from;
        while let Some(node) = open.pop() {
            *visits += 1;
            if seen.insert(node)
                && let Node::Either(firsts) = &self.list[node]
            {
                open.extend(firsts);
            }
        }
        let told = |node: &usize| !matches!(self.list[*node], Node::Either(_));
        seen.into_iter().filter(told).collect()
    }

    /// Sets of nodes as states.
    fn determined(&self, first: usize, symbols: usize) -> Result<Vec<State>, TooLarge> {
        let (mut visits, mut edges) = (0, 0);
        let mut sets = vec![self.closed(vec![first], &mut visits)];
        let mut numbers = BTreeMap::from([(sets[0].clone(), 0)]);
        let mut states: Vec<State> = Vec::new();
        while let Some(set) = sets.get(states.len()) {
            let ends = set.iter().any(|node| matches!(self.list[*node], Node::End));
            let mut any: Vec<usize> = Vec::new();
            let mut some: BTreeMap<SymbolNumber, Vec<usize>> = BTreeMap::new();
            for node in set {
                match &self.list[*node] {
                    Node::Read(Some(symbol), next) => some.entry(*symbol).or_default().push(*next),
                    Node::Read(None, next) => any.push(*next),
                    Node::End | Node::Either(_) => {}
                }
            }
            if !any.is_empty() {
                for symbol in 0..symbols {
                    some.entry(symbol).or_default().extend(&any);
                }
            }
            let mut next = Vec::new();
            for (symbol, nodes) in some {
                let to = self.closed(nodes, &mut visits);
                let new = sets.len();
                let number = *numbers.entry(to.clone()).or_insert(new);
                if number == new {
                    sets.push(to);
                }
                next.push((symbol, number));
            }
            edges += next.len();
            states.push(State { ends, next });
            if sets.len() > MOST_STATES || edges > MOST_EDGES || visits > MOST_VISITS {
                return Err(TooLarge);
            }
        }
        Ok(states)
    }
}

/// What tells states apart: their class, and the classes that each symbol leads to.
type Signature = (usize, Vec<(SymbolNumber, usize)>);

/// States after which the same words may come are one; numbered as they are come to.
fn smallest(states: &[State]) -> Vec<State> {
    let mut classes: Vec<usize> = states.iter().map(|state| usize::from(state.ends)).collect();
    let mut count = 0;
    loop {
        let mut numbers: BTreeMap<Signature, usize> = BTreeMap::new();
        let finer: Vec<usize> = states
            .iter()
            .zip(&classes)
            .map(|(state, class)| {
                let next = state.next.iter().map(|(s, to)| (*s, classes[*to]));
                let new = numbers.len();
                *numbers.entry((*class, next.collect())).or_insert(new)
            })
            .collect();
        classes = finer;
        // Finer classes are as many or more; as many are the same.
        if numbers.len() == count {
            break;
        }
        count = numbers.len();
    }
    // The first state is looked at first, so its class is 0, and others follow as they are come to.
    let mut smallest: Vec<Option<State>> = vec![None; count];
    for (state, class) in states.iter().zip(&classes) {
        let next = state.next.iter().map(|(s, to)| (*s, classes[*to]));
        smallest[*class].get_or_insert_with(|| State {
            ends: state.ends,
            next: next.collect(),
        });
    }
    smallest.into_iter().flatten().collect()
}
