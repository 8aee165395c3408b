//! Components of a net that have no choice, or no concurrency, and how fast those without choice can
//! run. Once every choice of a robot's net is settled, what is left is a marked graph. Its timing can
//! be computed exactly (Freedman 1991, the architecture report's reference 2).

use super::{
    Arcs,
    semiflows::{place_invariants, transition_invariants},
};
use crate::analysis::model::Model;

/// A part of a net, by its numbers, sorted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Component {
    /// Its places.
    pub places: Vec<usize>,
    /// Its transitions.
    pub transitions: Vec<usize>,
}

/// A marked-graph component and the choices that lead into it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MarkedGraph {
    /// The component.
    pub part: Component,
    /// At each of these places another transition could take the token; this is the one that does.
    pub choices: Vec<(usize, usize)>,
}

/// State-machine components: strongly connected, and every transition takes one token and puts one.
/// With a place invariant of its own each, one token in it stays one. Nothing beyond the limit of work.
#[must_use]
pub fn state_machines(model: &Model, most: usize) -> Option<Vec<Component>> {
    let arcs = Arcs::of(model);
    let parts = place_invariants(model, most)?
        .into_iter()
        .filter_map(|weights| {
            let places = support(&weights)?;
            let transitions = around(&places, &arcs.producers, &arcs.consumers);
            let one = |lists: &[Vec<usize>], transition: usize| {
                lists[transition]
                    .iter()
                    .filter(|place| places.contains(place))
                    .count()
                    == 1
            };
            let single = |t: &usize| one(&arcs.inputs, *t) && one(&arcs.outputs, *t);
            transitions.iter().all(single).then_some(Component {
                places,
                transitions,
            })
        });
    Some(
        parts
            .filter(|part| strongly_connected(&arcs, part))
            .collect(),
    )
}

/// Marked-graph components: strongly connected, and every place has one transition that puts into it
/// and one that takes from it. Nothing beyond the limit of work.
#[must_use]
pub fn marked_graphs(model: &Model, most: usize) -> Option<Vec<MarkedGraph>> {
    let arcs = Arcs::of(model);
    let parts = transition_invariants(model, most)?
        .into_iter()
        .filter_map(|weights| {
            let transitions = support(&weights)?;
            let places = around(&transitions, &arcs.inputs, &arcs.outputs);
            let one = |lists: &[Vec<usize>], place: usize| {
                lists[place]
                    .iter()
                    .filter(|t| transitions.contains(t))
                    .count()
                    == 1
            };
            let single =
                |place: &usize| one(&arcs.producers, *place) && one(&arcs.consumers, *place);
            places.iter().all(single).then_some(Component {
                places,
                transitions,
            })
        });
    let parts = parts.filter(|part| strongly_connected(&arcs, part));
    Some(parts.map(|part| with_choices(&arcs, part)).collect())
}

/// The numbers with weight one; `None` when another weight occurs.
fn support(weights: &[u64]) -> Option<Vec<usize>> {
    let plain = weights.iter().all(|weight| *weight <= 1);
    plain.then(|| {
        (0..weights.len())
            .filter(|number| weights[*number] == 1)
            .collect()
    })
}

fn around(nodes: &[usize], before: &[Vec<usize>], after: &[Vec<usize>]) -> Vec<usize> {
    let mut found: Vec<usize> = nodes
        .iter()
        .flat_map(|node| before[*node].iter().chain(&after[*node]))
        .copied()
        .collect();
    found.sort_unstable();
    found.dedup();
    found
}

fn with_choices(arcs: &Arcs, part: Component) -> MarkedGraph {
    let choice = |place: &usize| {
        let consumers = &arcs.consumers[*place];
        let taken = consumers.iter().find(|t| part.transitions.contains(t))?;
        (consumers.len() > 1).then_some((*place, *taken))
    };
    MarkedGraph {
        choices: part.places.iter().filter_map(choice).collect(),
        part,
    }
}

fn strongly_connected(arcs: &Arcs, part: &Component) -> bool {
    let Some(first) = part.transitions.first() else {
        return false;
    };
    let reached = |forward: bool| {
        let (from_transition, from_place) = if forward {
            (&arcs.outputs, &arcs.consumers)
        } else {
            (&arcs.inputs, &arcs.producers)
        };
        let mut seen = vec![*first];
        let mut waiting = vec![*first];
        while let Some(transition) = waiting.pop() {
            let places = from_transition[transition]
                .iter()
                .filter(|p| part.places.contains(p));
            for next in places.flat_map(|place| &from_place[*place]) {
                if part.transitions.contains(next) && !seen.contains(next) {
                    seen.push(*next);
                    waiting.push(*next);
                }
            }
        }
        seen.len()
    };
    reached(true) == part.transitions.len() && reached(false) == part.transitions.len()
}

/// How fast a marked graph runs at best.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// Time from one firing of a transition to its next, on average, in the unit of the delays.
    pub time: f64,
    /// The circuit that holds the others up: its transitions in order.
    pub bottleneck: Vec<usize>,
    /// Tokens in it.
    pub tokens: u32,
}

/// The cycle time of a marked graph and its bottleneck. That is the circuit with the largest sum of
/// delays per token (Ramamoorthy and Ho 1980; the maximum cycle mean of the max-plus matrix). Delays are
/// by transition of the model. Nothing when a circuit holds no token: then nothing in it ever fires.
#[must_use]
pub fn cycle(model: &Model, part: &Component, delays: &[f64]) -> Option<Cycle> {
    let arcs = Arcs::of(model);
    let initial = model.initial();
    let index = |transition: usize| part.transitions.binary_search(&transition).ok();
    // From transition to transition, with the tokens of the place between.
    let mut edges: Vec<(usize, usize, u32)> = Vec::new();
    for place in &part.places {
        let from = arcs.producers[*place].iter().find_map(|t| index(*t));
        let to = arcs.consumers[*place].iter().find_map(|t| index(*t));
        if let (Some(from), Some(to)) = (from, to) {
            edges.push((from, to, initial[*place]));
        }
    }
    let delay = |node: usize| delays.get(part.transitions[node]).copied().unwrap_or(0.0);
    let unmarked = |(_, _, tokens): &(usize, usize, u32)| if *tokens == 0 { 1.0 } else { 0.0 };
    let count = part.transitions.len();
    // A circuit without a token would be worth more the more often it is gone round.
    let empty: Vec<(usize, usize, f64)> = edges
        .iter()
        .filter(|edge| edge.2 == 0)
        .map(|edge| (edge.0, edge.1, unmarked(edge)))
        .collect();
    if positive_circuit(count, &empty).is_some() {
        return None;
    }
    // Newton's method: a circuit that is longer than the guess is the next guess.
    let mut best: Option<Cycle> = None;
    loop {
        let guess = best.as_ref().map_or(-1.0, |best| best.time);
        let weights: Vec<(usize, usize, f64)> = edges
            .iter()
            .map(|(from, to, tokens)| (*from, *to, delay(*from) - guess * f64::from(*tokens)))
            .collect();
        let Some(circuit) = positive_circuit(count, &weights) else {
            return best;
        };
        let tokens: u32 = circuit.iter().map(|edge| edges[*edge].2).sum();
        let total: f64 = circuit.iter().map(|edge| delay(edges[*edge].0)).sum();
        let time = total / f64::from(tokens);
        if time <= guess {
            return best;
        }
        best = Some(Cycle {
            time,
            bottleneck: circuit
                .iter()
                .map(|edge| part.transitions[edges[*edge].0])
                .collect(),
            tokens,
        });
    }
}

/// A circuit whose weights add up to more than rounding explains, as numbers of its edges in order
/// (Bellman and Ford, for longest ways).
fn positive_circuit(nodes: usize, edges: &[(usize, usize, f64)]) -> Option<Vec<usize>> {
    let largest = edges.iter().map(|edge| edge.2.abs()).fold(1.0, f64::max);
    let least = largest * 1e-12;
    let mut longest = vec![0.0_f64; nodes];
    let mut by: Vec<Option<usize>> = vec![None; nodes];
    let mut last = None;
    for _ in 0..=nodes {
        last = None;
        for (number, (from, to, weight)) in edges.iter().enumerate() {
            if longest[*from] + weight > longest[*to] + least {
                longest[*to] = longest[*from] + weight;
                by[*to] = Some(number);
                last = Some(*to);
            }
        }
        last?;
    }
    // So many steps back lead into the circuit.
    let mut at = last?;
    for _ in 0..nodes {
        at = edges[by[at]?].0;
    }
    let start = at;
    let mut circuit = Vec::new();
    loop {
        let edge = by[at]?;
        circuit.push(edge);
        at = edges[edge].0;
        if at == start {
            circuit.reverse();
            return Some(circuit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::samples::{buffer, kanban, model};

    #[test]
    fn the_components_of_a_buffer_are_three_machines_and_the_whole() {
        let net = buffer(2);
        let machines = state_machines(&net, 1000).unwrap();
        assert_eq!(machines.len(), 3);
        let graphs = marked_graphs(&net, 1000).unwrap();
        assert_eq!(graphs.len(), 1);
        assert_eq!(graphs[0].part.transitions, [0, 1, 2, 3]);
        assert!(graphs[0].choices.is_empty());
    }

    #[test]
    fn a_loop_that_is_repeated_or_left_has_a_component_for_each_choice() {
        let net = model(
            "net n\nplace start = 1, ready, tried\ntransition begin\n  in start\n  out ready\ntransition try\n  in ready\n  out tried\ntransition again\n  in tried\n  out ready\ntransition done\n  in tried\n  out start\n",
        );
        let graphs = marked_graphs(&net, 1000).unwrap();
        let tried = net.place("n.tried").unwrap() as usize;
        let mut choices: Vec<_> = graphs.iter().map(|graph| graph.choices.clone()).collect();
        choices.sort_unstable();
        assert_eq!(choices, [[(tried, 2)], [(tried, 3)]]);
    }

    #[test]
    fn rework_in_a_kanban_cell_is_a_component_of_its_own() {
        assert_eq!(marked_graphs(&kanban(1), 1000).unwrap().len(), 5);
        assert_eq!(state_machines(&kanban(1), 1000).unwrap().len(), 6);
    }

    #[test]
    fn the_slowest_circuit_sets_the_cycle_time() {
        // Producing takes 1 + 2, using 1 + 4, and a slot of the buffer is held for 2 + 1.
        let delays = [1.0, 2.0, 1.0, 4.0];
        for (items, time, bottleneck) in [(1, 5.0, [2, 3]), (3, 5.0, [2, 3])] {
            let net = buffer(items);
            let graphs = marked_graphs(&net, 1000).unwrap();
            let cycle = cycle(&net, &graphs[0].part, &delays).unwrap();
            assert!((cycle.time - time).abs() < 1e-9);
            let mut found = cycle.bottleneck;
            found.sort_unstable();
            assert_eq!(found, bottleneck);
        }
        // With slow hand-over, one slot is the bottleneck, and two slots are not.
        let delays = [1.0, 6.0, 7.0, 1.0];
        let of = |items| {
            let net = buffer(items);
            let graphs = marked_graphs(&net, 1000).unwrap();
            cycle(&net, &graphs[0].part, &delays).unwrap()
        };
        assert!((of(1).time - 13.0).abs() < 1e-9 && (of(2).time - 8.0).abs() < 1e-9);
        assert_eq!((of(1).tokens, of(1).bottleneck.len()), (1, 2));
    }

    #[test]
    fn a_circuit_without_tokens_has_no_cycle_time() {
        let net = model(
            "net n\nplace a, b\ntransition t\n  in a\n  out b\ntransition u\n  in b\n  out a\n",
        );
        let graphs = marked_graphs(&net, 1000).unwrap();
        assert_eq!(cycle(&net, &graphs[0].part, &[1.0, 1.0]), None);
    }
}
