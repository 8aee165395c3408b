//! The three steps of a layered arrangement, one after the other.

use super::{coordinates, layers, order, point::Point};

/// A layered arrangement of a directed graph (Sugiyama, Tagawa, Toda 1981): arcs go to the right where
/// they can.
///
/// `sizes` are width and height of each node, px; `arcs` go from node to node. Returns the centre of
/// every node and the points that each arc passes.
#[must_use]
pub fn layered(sizes: &[(f64, f64)], arcs: &[(usize, usize)]) -> (Vec<Point>, Vec<Vec<Point>>) {
    let mut graph = layers::Layers::new(sizes, arcs);
    order::reduce_crossings(&mut graph);
    coordinates::assign(&graph)
}
