//! Which markings return to the initial one. From every marking a walk goes on until it meets one that is
//! known to return: then all markings on the walk return as well. What leads only to markings of the walk
//! itself is left aside, and looked at again when more is known. Most markings take one look: at the first
//! firing, which leads to one that returns.

use super::{Explored, Graph};

const UNKNOWN: u8 = 0;
/// On the walk, left aside, or lost.
const SEEN: u8 = 1;
const RETURNS: u8 = 2;

/// Markings that are looked at together before a walk begins at each that is left, so that the waiting for
/// memory overlaps.
const TOGETHER: usize = if cfg!(test) { 4 } else { 256 };

/// Looks at all that was left aside, after which the way by components is the shorter one.
const LOOKS: usize = 16;

/// What returns, and what does not.
pub(super) struct Returning {
    /// Markings from which no way leads to the initial one. Nothing leads out of them.
    pub(super) lost: Vec<u32>,
    /// Bytes that this took at most.
    pub(super) bytes: usize,
}

/// A marking on the walk, and how many of its firings were tried.
type Step = (u32, u32);

struct Walker<'a> {
    graph: Graph<'a>,
    state: Vec<u8>,
    walk: Vec<Step>,
    longest: usize,
    /// What may return yet.
    aside: Vec<u32>,
    lost: Vec<u32>,
}

/// Looks at all markings of a graph without enabling functions. Nothing when that is not found in this way.
pub(super) fn returning(explored: &Explored<'_>) -> Option<Returning> {
    let graph = Graph::new(explored);
    let mut state = vec![UNKNOWN; explored.store.numbers()];
    state[graph.initial()?] = RETURNS;
    let mut walker = Walker {
        graph,
        state,
        walk: Vec::new(),
        longest: 0,
        aside: Vec::new(),
        lost: Vec::new(),
    };
    let mut numbers = explored.levels.numbers();
    let mut roots = Vec::with_capacity(TOGETHER);
    loop {
        roots.clear();
        roots.extend(numbers.by_ref().take(TOGETHER));
        if roots.is_empty() {
            break;
        }
        walker.look(&mut roots)?;
        for root in &roots {
            walker.walk_from(*root)?;
        }
    }
    let most = walker.aside.len();
    walker.look_again()?;
    let lists = walker.longest * size_of::<Step>() + (2 * most + walker.lost.len()) * 4;
    Some(Returning {
        bytes: walker.state.len() + lists,
        lost: walker.lost,
    })
}

impl Walker<'_> {
    /// Leaves of some markings those of which it is not known whether they return, nor from their first
    /// firing.
    fn look(&mut self, roots: &mut Vec<u32>) -> Option<()> {
        roots.retain(|root| self.state[*root as usize] == UNKNOWN);
        let graph = &mut self.graph;
        graph.targets.clear();
        graph.sums.clear();
        let mut asked = 0;
        for at in 0..roots.len() {
            let root = roots[at];
            graph.expand(root as usize);
            if graph.fire(0) {
                // Those with a firing come first.
                roots.swap(at, asked);
                asked += 1;
            }
        }
        graph.find()?;
        let mut found = graph.numbers.iter();
        let state = &mut self.state;
        roots.retain(|root| {
            let returns = found
                .next()
                .is_some_and(|to| state[*to as usize] == RETURNS);
            if returns {
                state[*root as usize] = RETURNS;
            }
            !returns
        });
        Some(())
    }

    /// Walks from a marking until one returns, or nothing is left to try.
    fn walk_from(&mut self, root: u32) -> Option<()> {
        if self.state[root as usize] != UNKNOWN {
            return Some(());
        }
        let aside = self.aside.len();
        self.state[root as usize] = SEEN;
        self.walk.push((root, 0));
        while let Some((node, tried)) = self.walk.last().copied() {
            let (state, next) = self.next(node, tried)?;
            if let Some(top) = self.walk.last_mut() {
                top.1 = next.1;
            }
            match state {
                RETURNS => {
                    for (node, _) in self.walk.drain(..) {
                        self.state[node as usize] = RETURNS;
                    }
                }
                UNKNOWN => {
                    self.state[next.0 as usize] = SEEN;
                    self.walk.push((next.0, 0));
                    self.longest = self.longest.max(self.walk.len());
                }
                _ => {
                    self.walk.pop();
                    self.aside.push(node);
                }
            }
        }
        // All that was seen from here leads to nothing that may return yet.
        if aside == 0 && self.state[root as usize] == SEEN {
            self.lost.append(&mut self.aside);
        }
        Some(())
    }

    /// Of the untried firings at a marking, the first that leads to a marking that returns or is not
    /// known. It gives the firing, where it leads, and how many are tried then. All others have been seen.
    fn next(&mut self, node: u32, tried: u32) -> Option<(u8, Step)> {
        self.graph.expand(node as usize);
        let firings = self.graph.scratch.enabled.len();
        for position in tried as usize..firings {
            let to = self.graph.successor(position)?;
            let state = self.state[to as usize];
            if state != SEEN {
                return Some((state, (to, position as u32 + 1)));
            }
        }
        Some((SEEN, (node, firings as u32)))
    }

    /// Looks at what was left aside, to and fro, until no more of it returns: the rest is lost.
    fn look_again(&mut self) -> Option<()> {
        let mut aside = std::mem::take(&mut self.aside);
        for _ in 0..LOOKS {
            let before = aside.len();
            let mut left = Vec::new();
            // What was put aside last leads to what was on the walk longest.
            for node in aside.into_iter().rev() {
                if self.leads_back(node)? {
                    self.state[node as usize] = RETURNS;
                } else {
                    left.push(node);
                }
            }
            aside = left;
            if aside.len() == before {
                self.lost.append(&mut aside);
                return Some(());
            }
        }
        None
    }

    /// Whether a firing leads to a marking that is known to return.
    fn leads_back(&mut self, node: u32) -> Option<bool> {
        self.graph.expand(node as usize);
        for position in 0..self.graph.scratch.enabled.len() {
            let to = self.graph.successor(position)?;
            if self.state[to as usize] == RETURNS {
                return Some(true);
            }
        }
        Some(false)
    }
}
