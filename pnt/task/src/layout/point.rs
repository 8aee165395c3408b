//! Points of a drawing.

/// A point, px: x to the right, y down.
pub type Point = (f64, f64);
