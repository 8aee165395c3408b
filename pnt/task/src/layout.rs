//! Where the nodes of a net are drawn: from a layout file, and by rule for those that it does not name.
//!
//! A drawing is made once, always the same for the same net and file; nodes never move by themselves. It
//! knows no screen: whoever shows it adds the marking.

mod coordinates;
mod drawing;
mod file;
mod layers;
mod order;
mod place;

#[cfg(test)]
mod tests;

pub use drawing::{Detail, Drawing, DrawnArc, DrawnNode, Kind, Way};
pub use file::{LayoutFile, NodeAt, beside};

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

/// A point, px: x to the right, y down.
pub type Point = (f64, f64);
