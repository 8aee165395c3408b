//! A marking that a search has come to.

/// Dead markings that are kept; the others are only counted.
pub const DEAD_KEPT: usize = 1000;

/// A marking and its distance from the initial one.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Reached {
    /// Firings on a shortest way to it.
    pub distance: usize,
    /// The marking.
    pub marking: Vec<u32>,
}
