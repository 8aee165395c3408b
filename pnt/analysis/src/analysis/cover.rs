//! What an unbounded net can cover: markings in which omega stands for as many tokens as one likes
//! (Karp and Miller 1969), with weighted arcs. Equal markings are one node; of the result the largest
//! ones are kept, which no other covers.
//!
//! Needs a net without inhibitor arcs, reset arcs, capacities and priorities: with those, more tokens
//! may enable less, and the construction would tell falsehoods.

use std::collections::VecDeque;

use hashbrown::HashMap;

use super::model::{Model, PlaceNumber, Transition};

/// Tokens of a place, or omega.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Tokens {
    /// So many.
    Exactly(u32),
    /// As many as one likes.
    Omega,
}

/// What can be covered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cover {
    /// The largest markings, none of which covers another: every reachable marking is covered by one.
    pub markings: Vec<Vec<Tokens>>,
    /// Nodes of the coverability graph.
    pub nodes: usize,
    /// Per transition, whether it is enabled somewhere.
    pub seen: Vec<bool>,
}

/// Whether the model is of the kind that can be covered.
#[must_use]
pub fn fits(model: &Model) -> bool {
    let plain = |t: &Transition| t.inhibitors.is_empty() && t.resets.is_empty();
    !model.has_priorities()
        && model.transitions.iter().all(plain)
        && model.places.iter().all(|place| place.capacity.is_none())
}

/// Builds the coverability graph. `None` when the model does not [fit](fits), or the graph has more
/// nodes than permitted. Also when tokens outgrow 32 bits before they are known to have no bound.
#[must_use]
pub fn cover(model: &Model, most: usize) -> Option<Cover> {
    if !fits(model) {
        return None;
    }
    let initial: Vec<Tokens> = model.initial().into_iter().map(Tokens::Exactly).collect();
    let mut graph = Graph {
        nodes: vec![(initial.clone(), 0)],
        known: HashMap::from([(initial, 0)]),
    };
    let mut seen = vec![false; model.transitions.len()];
    let mut waiting = VecDeque::from([0]);
    while let Some(node) = waiting.pop_front() {
        for (transition, seen) in model.transitions.iter().zip(&mut seen) {
            let (from, _) = &graph.nodes[node];
            if !is_enabled(transition, from) {
                continue;
            }
            *seen = true;
            let mut to = fire(transition, from)?;
            graph.accelerate(node, &mut to);
            if graph.known.contains_key(&to) {
                continue;
            }
            let number = graph.nodes.len();
            if number >= most {
                return None;
            }
            graph.known.insert(to.clone(), number);
            graph.nodes.push((to, node));
            waiting.push_back(number);
        }
    }
    let nodes = graph.nodes.len();
    Some(Cover {
        markings: largest(
            graph
                .nodes
                .into_iter()
                .map(|(marking, _)| marking)
                .collect(),
        ),
        nodes,
        seen,
    })
}

struct Graph {
    /// Markings, with the node from which each was found first.
    nodes: Vec<(Vec<Tokens>, usize)>,
    known: HashMap<Vec<Tokens>, usize>,
}

impl Graph {
    /// Where the marking covers one on the way to it and holds more, it can hold as much as one likes.
    /// Again from the start whenever that happens: more may be covered now.
    fn accelerate(&self, from: usize, to: &mut [Tokens]) {
        let mut at = from;
        loop {
            let (before, parent) = &self.nodes[at];
            let mut grew = false;
            if covers(to, before) {
                for (after, before) in to.iter_mut().zip(before) {
                    if *after > *before && *after != Tokens::Omega {
                        *after = Tokens::Omega;
                        grew = true;
                    }
                }
            }
            if grew {
                at = from;
            } else if at == 0 {
                return;
            } else {
                at = *parent;
            }
        }
    }
}

fn covers(large: &[Tokens], small: &[Tokens]) -> bool {
    large.iter().zip(small).all(|(large, small)| large >= small)
}

fn is_enabled(transition: &Transition, marking: &[Tokens]) -> bool {
    let mut needs = transition.takes.iter().chain(&transition.reads);
    needs.all(|(place, weight)| marking[*place as usize] >= Tokens::Exactly(*weight))
}

fn fire(transition: &Transition, from: &[Tokens]) -> Option<Vec<Tokens>> {
    let mut to = from.to_vec();
    for (place, change) in transition.changes() {
        if let Tokens::Exactly(tokens) = &mut to[place as usize] {
            *tokens = u32::try_from(i64::from(*tokens) + change).ok()?;
        }
    }
    Some(to)
}

fn largest(mut markings: Vec<Vec<Tokens>>) -> Vec<Vec<Tokens>> {
    markings.sort_unstable();
    markings.dedup();
    let all = markings.clone();
    markings.retain(|marking| {
        !all.iter()
            .any(|other| other != marking && covers(other, marking))
    });
    markings
}

impl Cover {
    /// The most tokens of each place.
    #[must_use]
    pub fn bounds(&self) -> Vec<Tokens> {
        let width = self.markings.first().map_or(0, Vec::len);
        let most = |place: usize| {
            let tokens = self.markings.iter().map(|marking| marking[place]);
            tokens.max().unwrap_or(Tokens::Exactly(0))
        };
        (0..width).map(most).collect()
    }

    /// The places without bound.
    pub fn unbounded(&self) -> impl Iterator<Item = PlaceNumber> {
        let bounds = self.bounds().into_iter();
        (0..)
            .zip(bounds)
            .filter(|(_, bound)| *bound == Tokens::Omega)
            .map(|(place, _)| place)
    }

    /// Whether a reachable marking has at least these tokens.
    #[must_use]
    pub fn can_cover(&self, wanted: &[(PlaceNumber, u32)]) -> bool {
        let holds = |marking: &Vec<Tokens>| {
            wanted
                .iter()
                .all(|(place, tokens)| marking[*place as usize] >= Tokens::Exactly(*tokens))
        };
        self.markings.iter().any(holds)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::analysis::{
        explicit::{Limits, explore},
        samples::{model, random_model},
    };
    use Tokens::{Exactly, Omega};

    #[test]
    fn weights_count_and_growing_places_are_omega() {
        // Each round puts two more on the heap; the bin holds at most the one it began with.
        let net = model(
            "net n\nplace a = 1, b, heap, bin = 1\ntransition go\n  in a\n  out b\ntransition back\n  in b\n  out a, heap*2\ntransition shovel\n  in heap*3, bin\n  out bin, heap\n",
        );
        let cover = cover(&net, 1000).unwrap();
        assert_eq!(cover.bounds(), [Exactly(1), Exactly(1), Omega, Exactly(1)]);
        assert_eq!(cover.markings.len(), 2);
        assert!(cover.seen.iter().all(|seen| *seen));
        assert!(cover.can_cover(&[(0, 1), (2, 1_000_000)]));
        assert!(!cover.can_cover(&[(0, 1), (1, 1)]));
        assert_eq!(cover.unbounded().collect::<Vec<_>>(), [2]);
    }

    #[test]
    fn tokens_of_the_initial_marking_keep_their_number() {
        // A peer forgets them: two tokens can be in `b` at once.
        let net = model(
            "net n\nplace a = 2, b, heap\ntransition go\n  in a\n  out b\ntransition back\n  in b\n  out a, heap\n",
        );
        assert!(cover(&net, 1000).unwrap().can_cover(&[(1, 2)]));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn it_agrees_with_the_list_of_markings(mut net in random_model()) {
            for place in &mut net.places {
                place.capacity = None;
            }
            for transition in &mut net.transitions {
                transition.inhibitors.clear();
                transition.resets.clear();
            }
            let limits = Limits { markings: 2_000, ..Limits::default() };
            let listed = explore(&net, &limits);
            let Some(cover) = cover(&net, 20_000) else { return Ok(()) };
            if listed.complete() {
                let bounds: Vec<Tokens> = listed.bounds.iter().map(|b| Exactly(*b)).collect();
                prop_assert_eq!(cover.bounds(), bounds);
                prop_assert_eq!(&cover.seen, &listed.seen);
            } else if let Some(growth) = &listed.growth {
                prop_assert_eq!(cover.bounds()[growth.place as usize], Omega);
            } else {
                // It has found so many markings that the place it says is bounded must not exceed that.
                for (bound, most) in cover.bounds().iter().zip(&listed.bounds) {
                    prop_assert!(*bound >= Exactly(*most));
                }
            }
        }
    }
}
