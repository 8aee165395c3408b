//! An order of the places for decision diagrams: places that transitions connect should stand close
//! together. FORCE (Aloul, Markov and Sakallah 2003): every transition pulls its places to their
//! centre of gravity, again and again.

use super::super::model::{Model, PlaceNumber};

/// Rounds of pulling.
const ROUNDS: usize = 60;

/// The places, from the top level down.
pub(super) fn order(model: &Model) -> Vec<PlaceNumber> {
    let hyperedges: Vec<Vec<usize>> = model.transitions.iter().map(places_of).collect();
    let mut order: Vec<usize> = (0..model.places.len()).collect();
    let mut best = (span(&hyperedges, &order), order.clone());
    for _ in 0..ROUNDS {
        let before = order.clone();
        pull(&hyperedges, &mut order);
        let span = span(&hyperedges, &order);
        if span < best.0 {
            best = (span, order.clone());
        }
        if order == before {
            break;
        }
    }
    let numbers = best
        .1
        .into_iter()
        .filter_map(|place| PlaceNumber::try_from(place).ok());
    numbers.collect()
}

fn places_of(transition: &super::super::model::Transition) -> Vec<usize> {
    let arcs = transition.takes.iter().chain(&transition.reads);
    let arcs = arcs.chain(&transition.inhibitors).chain(&transition.puts);
    let places = arcs.map(|(place, _)| place).chain(&transition.resets);
    let mut places: Vec<usize> = places.map(|place| *place as usize).collect();
    places.sort_unstable();
    places.dedup();
    places
}

fn positions(order: &[usize]) -> Vec<usize> {
    let mut positions = vec![0; order.len()];
    for (position, place) in order.iter().enumerate() {
        positions[*place] = position;
    }
    positions
}

/// The levels that all transitions together reach over.
fn span(hyperedges: &[Vec<usize>], order: &[usize]) -> usize {
    let positions = positions(order);
    let span = |places: &Vec<usize>| {
        let at = || places.iter().map(|place| positions[*place]);
        at().max().unwrap_or(0) - at().min().unwrap_or(0)
    };
    hyperedges.iter().map(span).sum()
}

fn pull(hyperedges: &[Vec<usize>], order: &mut [usize]) {
    let positions = positions(order);
    // Sum of centres and number of transitions, per place.
    let mut pulls = vec![(0.0_f64, 0_u32); order.len()];
    for places in hyperedges.iter().filter(|places| !places.is_empty()) {
        let sum: usize = places.iter().map(|place| positions[*place]).sum();
        let centre = sum as f64 / places.len() as f64;
        for place in places {
            pulls[*place].0 += centre;
            pulls[*place].1 += 1;
        }
    }
    let wanted = |place: usize| match pulls[place] {
        (_, 0) => positions[place] as f64,
        (sum, count) => sum / f64::from(count),
    };
    // Equal wishes keep their order, so the result is the same every time.
    order.sort_by(|a, b| wanted(*a).total_cmp(&wanted(*b)));
}
