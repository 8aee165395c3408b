//! Parameterized self-organizing maps (PSOM): smooth maps through a few examples, read in every direction.
//!
//! A map has 1 to [`MOST_PARAMETERS`] parameters and a training vector at each node of a full grid of them. It goes
//! through every vector, and between them it is the product of Lagrange polynomials along the axes: M(s) = Σ H_a(s) w_a
//! (J. Walter, Rapid Learning in Robotics, 1996, equations 4.16 to 4.28). [`Psom::complete`] searches the point of the map
//! that is nearest to the known components of a vector, and so fills in the unknown ones.
//!
//! The module knows no camera, no robot and no unit: components are in the units of their training vectors.

mod basis;
mod search;
mod train;

pub use search::{Completion, Search, Unknown};
pub use train::{TrainError, chebyshev};

/// Most parameters of a map.
pub const MOST_PARAMETERS: usize = 6;

/// A map from parameters to vectors.
#[derive(Debug, Clone, PartialEq)]
pub struct Psom {
    /// The nodes of each axis, ascending, two or more.
    axes: Vec<Vec<f64>>,
    /// Components of a vector.
    components: usize,
    /// The training vectors, the last axis fastest.
    vectors: Vec<f64>,
    /// Largest minus smallest value of each component over the training vectors.
    spans: Vec<f64>,
}

/// Where a map is evaluated. Made once by [`Psom::scratch`], so that no evaluation allocates.
#[derive(Debug, Clone)]
pub struct Scratch {
    /// Lagrange polynomials of one axis and their slopes.
    basis: Vec<f64>,
    slopes: Vec<f64>,
    /// The tensor that shrinks to the value, and one for each axis that shrinks to a derivative.
    value: Vec<f64>,
    derivatives: Vec<Vec<f64>>,
    /// Nodes that a search begins at, nearest first, with their errors.
    starts: Vec<(f64, usize)>,
    /// The best that a search found.
    best: Vec<f64>,
}

impl Psom {
    /// How many parameters the map has.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.axes.len()
    }

    /// How many components a vector has.
    #[must_use]
    pub fn components(&self) -> usize {
        self.components
    }

    /// The nodes of each axis, ascending.
    #[must_use]
    pub fn axes(&self) -> &[Vec<f64>] {
        &self.axes
    }

    /// Largest minus smallest value of each component over the training vectors.
    #[must_use]
    pub fn spans(&self) -> &[f64] {
        &self.spans
    }

    /// The training vectors with the parameters of their nodes, the last axis fastest.
    pub fn nodes(&self) -> impl Iterator<Item = (Vec<f64>, &[f64])> {
        let vectors = self.vectors.chunks(self.components);
        vectors.enumerate().map(|(index, vector)| {
            let mut at = vec![0.0; self.axes.len()];
            self.node(index, &mut at);
            (at, vector)
        })
    }

    /// The parameters of a node.
    fn node(&self, mut index: usize, at: &mut [f64]) {
        for (axis, at) in self.axes.iter().zip(at).rev() {
            *at = axis.get(index % axis.len()).copied().unwrap_or_default();
            index /= axis.len();
        }
    }

    /// Room for evaluations of this map.
    #[must_use]
    pub fn scratch(&self) -> Scratch {
        let longest = self.axes.iter().map(Vec::len).max().unwrap_or_default();
        let last = self.axes.last().map_or(1, Vec::len);
        let contracted = vec![0.0; self.vectors.len() / last];
        Scratch {
            basis: vec![0.0; longest],
            slopes: vec![0.0; longest],
            value: contracted.clone(),
            derivatives: vec![contracted; self.axes.len()],
            starts: Vec::with_capacity(Search::MOST_RESTARTS + 1),
            best: vec![0.0; self.components],
        }
    }

    /// The vector at parameters `s`, which may lie outside the grid: there the polynomials go on.
    pub fn at<'s>(&self, scratch: &'s mut Scratch, s: &[f64]) -> &'s [f64] {
        self.evaluate(scratch, s);
        scratch.value.get(..self.components).unwrap_or_default()
    }

    /// Derivatives of the vector at `s`, row by row: components by parameters.
    ///
    /// `into` has room for `components * parameters` numbers; what it has beyond stays as it is.
    pub fn jacobian(&self, scratch: &mut Scratch, s: &[f64], into: &mut [f64]) {
        self.evaluate(scratch, s);
        for (component, row) in into.chunks_mut(self.axes.len()).enumerate() {
            for (slope, derivative) in row.iter_mut().zip(&scratch.derivatives) {
                *slope = derivative.get(component).copied().unwrap_or_default();
            }
        }
    }

    /// Leaves the value and all derivatives at the beginnings of their tensors, by contracting one axis after another.
    fn evaluate(&self, scratch: &mut Scratch, s: &[f64]) {
        let d = self.components;
        let Scratch {
            basis,
            slopes,
            value,
            derivatives,
            ..
        } = scratch;
        // Nodes of the axes before the one that is contracted.
        let mut outer = self.vectors.len() / d;
        for (axis, (nodes, s)) in self.axes.iter().zip(s).enumerate().rev() {
            let n = nodes.len();
            outer /= n;
            let (basis, slopes) = (&mut basis[..n], &mut slopes[..n]);
            basis::lagrange(nodes, *s, basis, slopes);
            if axis + 1 == self.axes.len() {
                basis::contract(&self.vectors, &mut derivatives[axis], slopes, outer, d);
                basis::contract(&self.vectors, value, basis, outer, d);
            } else {
                let (own, later) = derivatives[axis..].split_at_mut(1);
                basis::contract(value, &mut own[0], slopes, outer, d);
                basis::contract_in_place(value, basis, outer, d);
                for derivative in later {
                    basis::contract_in_place(derivative, basis, outer, d);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
