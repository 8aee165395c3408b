//! Where the nodes of a net are drawn: from a layout file, and by rule for those that it does not name.
//!
//! A drawing is made once, always the same for the same net and file; nodes never move by themselves. It
//! knows no screen: the display adds the marking.

mod coordinates;
mod drawing;
mod file;
mod layered;
mod layers;
mod order;
mod place;
mod point;

#[cfg(test)]
mod tests;

pub use drawing::{Detail, Drawing, DrawnArc, DrawnNode, Kind, Way};
pub use file::{LayoutFile, NodeAt, beside};
pub use layered::layered;
pub use point::Point;
