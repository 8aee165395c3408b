//! The second step: the order within each layer, by medians of neighbours and by swaps, so that few arcs
//! cross (Gansner, Koutsofios, North, Vo 1993).

use super::layers::Layers;

/// Sweeps from left to right and back without any gain before it is enough.
const PATIENCE: usize = 4;
const MOST_SWEEPS: usize = 24;

pub(super) fn reduce_crossings(graph: &mut Layers) {
    let mut best = (crossings(graph), graph.layers.clone());
    let mut idle = 0;
    for sweep in 0..MOST_SWEEPS {
        if best.0 == 0 || idle == PATIENCE {
            break;
        }
        sort_by_medians(graph, sweep % 2 == 0);
        swap_neighbours(graph);
        let count = crossings(graph);
        if count < best.0 {
            best = (count, graph.layers.clone());
            idle = 0;
        } else {
            idle += 1;
        }
    }
    graph.layers = best.1;
}

fn positions(graph: &Layers) -> Vec<usize> {
    let mut positions = vec![0; graph.vertices.len()];
    for layer in &graph.layers {
        for (position, &one) in layer.iter().enumerate() {
            positions[one] = position;
        }
    }
    positions
}

fn sort_by_medians(graph: &mut Layers, to_the_right: bool) {
    let mut positions = positions(graph);
    let count = graph.layers.len();
    for step in 1..count {
        let layer = if to_the_right { step } else { count - 1 - step };
        let mut keyed: Vec<(f64, usize)> = graph.layers[layer]
            .iter()
            .map(|&one| {
                let vertex = &graph.vertices[one];
                let near = if to_the_right {
                    &vertex.before
                } else {
                    &vertex.after
                };
                let mut near: Vec<usize> = near.iter().map(|other| positions[*other]).collect();
                near.sort_unstable();
                (median(&near).unwrap_or(positions[one] as f64), one)
            })
            .collect();
        keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (position, &(_, one)) in keyed.iter().enumerate() {
            positions[one] = position;
        }
        graph.layers[layer] = keyed.into_iter().map(|(_, one)| one).collect();
    }
}

/// The middle one; of two middle ones, that between them which leans to the denser side.
fn median(sorted: &[usize]) -> Option<f64> {
    let middle = sorted.len() / 2;
    let at = |index: usize| sorted.get(index).map(|position| *position as f64);
    if sorted.len() % 2 == 1 || sorted.is_empty() {
        return at(middle);
    }
    let (low, high) = (at(middle - 1)?, at(middle)?);
    if sorted.len() == 2 {
        return Some(f64::midpoint(low, high));
    }
    let left = low - at(0)?;
    let right = at(sorted.len() - 1)? - high;
    let whole = left + right;
    Some(if whole == 0.0 {
        f64::midpoint(low, high)
    } else {
        (low * right + high * left) / whole
    })
}

/// Swaps two that stand side by side as long as that saves a crossing.
fn swap_neighbours(graph: &mut Layers) {
    let mut positions = positions(graph);
    for layer in 0..graph.layers.len() {
        let mut better = true;
        let mut rounds = 0;
        while better && rounds < 8 {
            better = false;
            rounds += 1;
            for index in 1..graph.layers[layer].len() {
                let (a, b) = (graph.layers[layer][index - 1], graph.layers[layer][index]);
                if between(graph, &positions, b, a) < between(graph, &positions, a, b) {
                    graph.layers[layer].swap(index - 1, index);
                    positions.swap(a, b);
                    better = true;
                }
            }
        }
    }
}

/// How many arcs of `a` and `b` cross when `a` stands first.
fn between(graph: &Layers, positions: &[usize], a: usize, b: usize) -> usize {
    let (a, b) = (&graph.vertices[a], &graph.vertices[b]);
    let crossing = |a: &[usize], b: &[usize]| {
        let pairs = a.iter().flat_map(|a| b.iter().map(move |b| (*a, *b)));
        pairs.filter(|(a, b)| positions[*a] > positions[*b]).count()
    };
    crossing(&a.before, &b.before) + crossing(&a.after, &b.after)
}

/// How many arcs cross (Barth, Jünger, Mutzel 2002: inversions, counted in a tree of sums).
pub(super) fn crossings(graph: &Layers) -> usize {
    let positions = positions(graph);
    let mut count = 0;
    for (index, layer) in graph.layers.iter().enumerate() {
        let width = graph.layers.get(index + 1).map_or(0, Vec::len);
        let mut sums = vec![0_usize; width + 1];
        let mut seen = 0;
        for &one in layer {
            let mut ends: Vec<usize> = graph.vertices[one]
                .after
                .iter()
                .map(|to| positions[*to])
                .collect();
            ends.sort_unstable();
            for &end in &ends {
                // Those before that end further on.
                let mut at = end + 1;
                let mut not_further = 0;
                while at > 0 {
                    not_further += sums[at];
                    at &= at - 1;
                }
                count += seen - not_further;
            }
            for end in ends {
                seen += 1;
                let mut at = end + 1;
                while at <= width {
                    sums[at] += 1;
                    at += at & at.wrapping_neg();
                }
            }
        }
    }
    count
}
