//! Place invariants: weighted sums of tokens that no firing changes (Murata 1989, section VII).
//! All minimal non-negative ones, by Farkas' algorithm, within a limit of work.

use crate::analysis::structure::semiflows::semiflows;
use pnt_language::net::Net;

/// Weight per place, in order of place number.
pub type PlaceInvariant = Vec<u64>;

/// The minimal non-negative place invariants of a net, or `None` when more than `most` candidates
/// arise on the way. Firings to other nets count with what they do to this net's places only.
#[must_use]
pub fn place_invariants(net: &Net, most: usize) -> Option<Vec<PlaceInvariant>> {
    let columns = effects(net);
    let rows: Vec<Vec<i64>> = (0..net.places().len())
        .map(|place| columns.iter().map(|column| column[place]).collect())
        .collect();
    semiflows(&rows, most)
}

/// Per way that a firing can end, what it does to each place.
fn effects(net: &Net) -> Vec<Vec<i64>> {
    let mut columns = Vec::new();
    for transition in net.transitions() {
        for outputs in std::iter::once(&transition.outputs).chain(&transition.fail) {
            let mut column = vec![0; net.places().len()];
            for arc in &transition.inputs {
                column[arc.place.index()] -= i64::from(arc.weight);
            }
            for arc in &outputs.local {
                column[arc.place.index()] += i64::from(arc.weight);
            }
            columns.push(column);
        }
    }
    columns
}

#[cfg(test)]
#[path = "../../tests/shared/random_nets.rs"]
mod random_nets;

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use ctos::diagnostic::Source;
    use pnt_language::{compile, exec::Execution, net::TransitionId};
    use proptest::{collection::vec, prelude::*};

    use super::{
        random_nets::{random_net, random_transitions},
        *,
    };

    fn invariants(text: &str) -> Vec<PlaceInvariant> {
        let net = compile::net(&Source::new("t", text)).unwrap_or_else(|f| panic!("{f}"));
        let mut found = place_invariants(&net, 1000).unwrap();
        found.sort_unstable();
        found
    }

    #[test]
    fn producer_consumer_and_buffer_are_three_invariants() {
        let found = invariants(
            "net pc
place ready = 1, made, idle = 1, got, items, room = 3
transition make\n  in ready\n  out made
transition put\n  in made, room\n  out ready, items
transition get\n  in idle, items\n  out got, room
transition use\n  in got\n  out idle\n",
        );
        let expected = [
            vec![0, 0, 0, 0, 1, 1],
            vec![0, 0, 1, 1, 0, 0],
            vec![1, 1, 0, 0, 0, 0],
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn weights_and_failure_branches_count() {
        let pairs = "net n\nplace a = 4, b\ntransition t\n  in a*2\n  do f\n  out b\n";
        assert_eq!(invariants(pairs), [vec![1, 2]]);
        let lossy = format!("{pairs}  fail a\n");
        assert!(invariants(&lossy).is_empty());
    }

    proptest! {
        #[test]
        fn firing_conserves_every_place_invariant(transitions in random_transitions(), picks in vec(any::<prop::sample::Index>(), 0..60)) {
            let net = compile::net(&Source::new("random.net", random_net(&transitions))).unwrap();
            let mut execution = Execution::new(Arc::new(net));
            let Some(found) = place_invariants(execution.net(), 1000) else { return Ok(()) };
            let sum = |weights: &[u64], execution: &Execution| -> u64 {
                weights.iter().zip(execution.marking()).map(|(w, t)| w * u64::from(*t)).sum()
            };
            let before: Vec<u64> = found.iter().map(|weights| sum(weights, &execution)).collect();
            for pick in picks {
                let choices: Vec<TransitionId> = execution.enabled().collect();
                if choices.is_empty() { break; }
                execution.fire(*pick.get(&choices)).unwrap();
                for (weights, sum_before) in found.iter().zip(&before) {
                    prop_assert_eq!(sum(weights, &execution), *sum_before);
                }
            }
        }
    }
}
