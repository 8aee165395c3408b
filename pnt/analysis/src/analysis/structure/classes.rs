//! Classes of nets, by their arcs, and the rank theorem (Desel and Esparza 1995, theorem 6.17). The
//! arcs of a free-choice net alone tell whether some marking makes it live and bounded.

use super::{
    Arcs,
    semiflows::{place_invariants, transition_invariants},
};
use crate::analysis::model::Model;

/// What class a net is of. An ordinary net can be of several; another of none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Classes {
    /// Every transition takes from one place and puts into one place.
    pub state_machine: bool,
    /// Every place has one transition that puts into it and one that takes from it: no choice.
    pub marked_graph: bool,
    /// Transitions that share an input place share all: a choice is free.
    pub free_choice: bool,
}

/// The classes of a net.
#[must_use]
pub fn classes(arcs: &Arcs) -> Classes {
    let one = |lists: &[Vec<usize>]| lists.iter().all(|list| list.len() == 1);
    let same_inputs = |consumers: &Vec<usize>| {
        let mut inputs = consumers.iter().map(|transition| &arcs.inputs[*transition]);
        let first = inputs.next();
        inputs.all(|others| Some(others) == first)
    };
    Classes {
        state_machine: arcs.ordinary && one(&arcs.inputs) && one(&arcs.outputs),
        marked_graph: arcs.ordinary && one(&arcs.producers) && one(&arcs.consumers),
        free_choice: arcs.ordinary && arcs.consumers.iter().all(same_inputs),
    }
}

/// What the rank theorem tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rank {
    /// Rank of the effects.
    pub rank: usize,
    /// Clusters: transitions and places that depend on each other's choices.
    pub clusters: usize,
    /// Whether some initial marking makes the net live and bounded.
    pub well_formed: bool,
}

/// Applies the rank theorem to a connected free-choice net; nothing for other nets, or beyond a limit
/// of work.
#[must_use]
pub fn rank_theorem(model: &Model, most: usize) -> Option<Rank> {
    let arcs = Arcs::of(model);
    if !classes(&arcs).free_choice || model.transitions.is_empty() || !connected(&arcs) {
        return None;
    }
    let covered = |flows: Vec<Vec<u64>>, width: usize| {
        (0..width).all(|at| flows.iter().any(|weights| weights[at] > 0))
    };
    let places = covered(place_invariants(model, most)?, model.places.len());
    let transitions = covered(transition_invariants(model, most)?, model.transitions.len());
    let rank = rank(&arcs.effects)?;
    let clusters = clusters(&arcs);
    Some(Rank {
        rank,
        clusters,
        well_formed: places && transitions && rank + 1 == clusters,
    })
}

/// Sets that are joined step by step.
struct Joined(Vec<usize>);

impl Joined {
    fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    fn root(&mut self, mut at: usize) -> usize {
        while self.0[at] != at {
            self.0[at] = self.0[self.0[at]];
            at = self.0[at];
        }
        at
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a] = b;
    }

    fn count(&mut self) -> usize {
        (0..self.0.len()).filter(|at| self.root(*at) == *at).count()
    }
}

/// Places first, then transitions; joined where a transition takes from a place.
fn clusters(arcs: &Arcs) -> usize {
    let places = arcs.producers.len();
    let mut joined = Joined::new(places + arcs.inputs.len());
    for (transition, inputs) in arcs.inputs.iter().enumerate() {
        for place in inputs {
            joined.join(*place, places + transition);
        }
    }
    joined.count()
}

fn connected(arcs: &Arcs) -> bool {
    let places = arcs.producers.len();
    let mut joined = Joined::new(places + arcs.inputs.len());
    for (transition, (inputs, outputs)) in arcs.inputs.iter().zip(&arcs.outputs).enumerate() {
        for place in inputs.iter().chain(outputs) {
            joined.join(*place, places + transition);
        }
    }
    joined.count() == 1
}

/// The rank of a matrix, by elimination without fractions; `None` when numbers outgrow 128 bits.
fn rank(rows: &[Vec<i64>]) -> Option<usize> {
    let mut rows: Vec<Vec<i128>> = rows
        .iter()
        .map(|row| row.iter().map(|value| i128::from(*value)).collect())
        .collect();
    let columns = rows.first().map_or(0, Vec::len);
    let mut rank = 0;
    for column in 0..columns {
        let Some(pivot) = (rank..rows.len()).find(|row| rows[*row][column] != 0) else {
            continue;
        };
        rows.swap(rank, pivot);
        let (done, rest) = rows.split_at_mut(rank + 1);
        let Some(pivot) = done.last() else { break };
        for row in rest.iter_mut().filter(|row| row[column] != 0) {
            let (own, other) = (pivot[column], row[column]);
            let mut divisor = 0;
            for (value, above) in row.iter_mut().zip(pivot) {
                *value = value
                    .checked_mul(own)?
                    .checked_sub(above.checked_mul(other)?)?;
                divisor = gcd(value.unsigned_abs(), divisor);
            }
            let divisor = i128::try_from(divisor.max(1)).ok()?;
            row.iter_mut().for_each(|value| *value /= divisor);
        }
        rank += 1;
    }
    Some(rank)
}

fn gcd(a: u128, b: u128) -> u128 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::samples::{buffer, kanban, model, philosophers};

    #[test]
    fn classes_of_known_nets() {
        let of = |model: &Model| classes(&Arcs::of(model));
        let buffer = of(&buffer(2));
        assert!(buffer.marked_graph && buffer.free_choice && !buffer.state_machine);
        let kanban = of(&kanban(1));
        assert!(kanban.free_choice && !kanban.marked_graph);
        assert!(!of(&philosophers(3)).free_choice);
        let machine = of(&model(
            "net n\nplace a = 1, b\ntransition t\n  in a\n  out b\ntransition u\n  in b\n  out a\n",
        ));
        assert!(machine.state_machine && machine.marked_graph);
        let weighted = of(&model(
            "net n\nplace a = 2\ntransition t\n  in a*2\n  out a*2\n",
        ));
        assert!(!weighted.state_machine && !weighted.free_choice);
    }

    #[test]
    fn the_rank_theorem_tells_well_formed_nets_from_others() {
        let buffer = rank_theorem(&buffer(1), 1000).unwrap();
        // A connected marked graph of n transitions has rank n - 1.
        assert_eq!((buffer.rank, buffer.well_formed), (3, true));
        assert!(rank_theorem(&kanban(1), 1000).unwrap().well_formed);
        // A choice whose two ways must meet again never comes round (Desel and Esparza, figure 1.2).
        let bad = model(
            "net n\nplace a = 1, b, c\ntransition t\n  in a\n  out b\ntransition u\n  in a\n  out c\ntransition v\n  in b, c\n  out a\n",
        );
        assert!(!rank_theorem(&bad, 1000).unwrap().well_formed);
        assert_eq!(rank_theorem(&philosophers(3), 1000), None);
    }
}
