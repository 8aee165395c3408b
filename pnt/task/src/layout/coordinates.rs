//! The third step: coordinates. Layers stand side by side. Within a layer every vertex is drawn to its
//! neighbours as strongly as its order allows. That is least squares under an order, solved exactly by
//! pooling neighbours that would change places (Ayer and others 1955).

use super::{layers::Layers, point::Point};

/// Px between two layers, and between two vertices of one, beside their own sizes.
const BETWEEN_LAYERS: f64 = 34.0;
const BETWEEN: f64 = 26.0;

const SWEEPS: usize = 12;

pub(super) fn assign(graph: &Layers) -> (Vec<Point>, Vec<Vec<Point>>) {
    let across = across(graph);
    let mut down = stacked(graph);
    for sweep in 0..SWEEPS {
        let count = graph.layers.len();
        for step in 0..count {
            let right = sweep % 2 == 0;
            let index = if right { step } else { count - 1 - step };
            // The last sweeps look at both sides, so that neither end decides.
            let both = sweep + 4 >= SWEEPS;
            settle(graph, index, right, both, &mut down);
        }
    }
    let top = (0..graph.vertices.len())
        .map(|one| down[one] - graph.vertices[one].height / 2.0)
        .fold(f64::INFINITY, f64::min);
    let top = if top.is_finite() { top } else { 0.0 };
    let at = |one: usize| (across[graph.vertices[one].layer], down[one] - top);
    let nodes = (0..graph.count).map(at).collect();
    let arcs = graph.points.iter();
    let arcs = arcs.map(|points| points.iter().map(|one| at(*one)).collect());
    (nodes, arcs.collect())
}

/// The middle of each layer.
fn across(graph: &Layers) -> Vec<f64> {
    let mut at = 0.0;
    graph
        .layers
        .iter()
        .map(|layer| {
            let widths = layer.iter().map(|one| graph.vertices[*one].width);
            let width = widths.fold(24.0, f64::max);
            let middle = at + width / 2.0;
            at += width + BETWEEN_LAYERS;
            middle
        })
        .collect()
}

fn apart(graph: &Layers, a: usize, b: usize) -> f64 {
    let (a, b) = (&graph.vertices[a], &graph.vertices[b]);
    // Two arcs may run closer to each other than two nodes.
    let space = if a.real || b.real {
        BETWEEN
    } else {
        BETWEEN / 2.0
    };
    (a.height + b.height) / 2.0 + space
}

/// Every layer as tight as it goes, around a common middle.
fn stacked(graph: &Layers) -> Vec<f64> {
    let mut down = vec![0.0; graph.vertices.len()];
    for layer in &graph.layers {
        let mut at = 0.0;
        for (index, &one) in layer.iter().enumerate() {
            if let Some(&before) = index.checked_sub(1).and_then(|index| layer.get(index)) {
                at += apart(graph, before, one);
            }
            down[one] = at;
        }
        for &one in layer {
            down[one] -= at / 2.0;
        }
    }
    down
}

fn settle(graph: &Layers, layer: usize, right: bool, both: bool, down: &mut [f64]) {
    let layer = &graph.layers[layer];
    // Positions without the space that the order needs: then the order is all that is left to keep.
    let mut offset = 0.0;
    let mut blocks: Vec<(f64, f64, usize)> = Vec::new();
    let mut offsets = Vec::with_capacity(layer.len());
    for (index, &one) in layer.iter().enumerate() {
        if let Some(&before) = index.checked_sub(1).and_then(|index| layer.get(index)) {
            offset += apart(graph, before, one);
        }
        offsets.push(offset);
        let (wanted, weight) = wanted(graph, one, right, both, down);
        blocks.push((wanted - offset, weight, 1));
        while let [.., (low, low_weight, _), (high, high_weight, _)] = blocks.as_slice() {
            if low <= high {
                break;
            }
            let weight = low_weight + high_weight;
            let middle = (low * low_weight + high * high_weight) / weight;
            let many = blocks.pop().map_or(0, |(_, _, many)| many);
            if let Some(last) = blocks.last_mut() {
                *last = (middle, weight, last.2 + many);
            }
        }
    }
    let settled = blocks
        .iter()
        .flat_map(|&(at, _, many)| std::iter::repeat_n(at, many));
    for ((&one, offset), at) in layer.iter().zip(offsets).zip(settled) {
        down[one] = at + offset;
    }
}

/// Where a vertex is drawn to, and how strongly.
fn wanted(graph: &Layers, one: usize, right: bool, both: bool, down: &[f64]) -> (f64, f64) {
    let vertex = &graph.vertices[one];
    let (first, second) = if right {
        (&vertex.before, &vertex.after)
    } else {
        (&vertex.after, &vertex.before)
    };
    let none: &[usize] = &[];
    let second: &[usize] = if both || first.is_empty() {
        second
    } else {
        none
    };
    let near: Vec<usize> = first.iter().chain(second).copied().collect();
    if near.is_empty() {
        return (down[one], 0.01);
    }
    let sum: f64 = near.iter().map(|other| down[*other]).sum();
    let count = near.len() as f64;
    // What is a point of an arc on both sides should be straight.
    let straight = !vertex.real && near.iter().any(|other| !graph.vertices[*other].real);
    (sum / count, if straight { 8.0 } else { count })
}
