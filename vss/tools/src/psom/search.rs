//! The search of the point of a map that is nearest to what is known of a vector.

use nalgebra::{Matrix6, Vector6};

use super::{MOST_PARAMETERS, Psom, Scratch};

/// How a search goes.
#[derive(Debug, Clone, PartialEq)]
pub struct Search {
    /// From how many more nodes it begins anew while the error is not good, at most [`Search::MOST_RESTARTS`].
    pub restarts: usize,
    /// A distance is good when it is below this share of the spans of the known components (root of the mean square).
    pub good: f64,
    /// Most steps from each start.
    pub steps: usize,
    /// How far outside the grid parameters may lie, as a share of each axis.
    pub reach: f64,
}

impl Search {
    /// Most restarts of a search.
    pub const MOST_RESTARTS: usize = 16;
}

impl Default for Search {
    fn default() -> Self {
        Self {
            restarts: 3,
            good: 0.01,
            steps: 60,
            reach: 0.5,
        }
    }
}

/// The point of a map that is nearest to what was known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Completion<'s> {
    /// The whole vector there: known components smoothed, unknown ones filled in.
    pub values: &'s [f64],
    /// Its parameters; what follows those of the map is 0.
    pub parameters: [f64; MOST_PARAMETERS],
    /// E = half the sum of weight times squared difference over the known components. A large one says that no point of
    /// the map is near: an occlusion, a wrong correspondence, or a place outside the training.
    pub error: f64,
    /// Whether the error is below what [`Search::good`] asks.
    pub good: bool,
}

/// Why there is no completion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unknown {
    /// No weight is above 0.
    #[error("no component is known: every weight is 0")]
    Nothing,
    /// A weight is negative or no number, or a known value is no number.
    #[error(
        "component {0} has no finite value, or a weight that is negative or not finite (counted from 1)"
    )]
    Number(usize),
}

/// Where a search stands.
struct At {
    s: [f64; MOST_PARAMETERS],
    error: f64,
    /// Gradient of the error, and the Gauss-Newton part of its second derivatives.
    gradient: Vector6<f64>,
    curvature: Matrix6<f64>,
}

/// A step is no step below this share of an axis.
const STANDS: f64 = 1e-13;

/// Beyond this damping no step helps.
const MOST_DAMPING: f64 = 1e12;

impl Psom {
    /// Completes a vector: the point of the map with the least E, found by Levenberg and Marquardt's method from the node
    /// that is nearest in the known components, and from the next ones while E is not good.
    ///
    /// `known` and `weights` have a number for each component. A weight of 0 means unknown; others are inverse variances,
    /// or whatever makes the components comparable.
    ///
    /// # Errors
    /// When nothing is known, or a number is none.
    pub fn complete<'s>(
        &self,
        scratch: &'s mut Scratch,
        known: &[f64],
        weights: &[f64],
        search: &Search,
    ) -> Result<Completion<'s>, Unknown> {
        for (index, (x, p)) in known.iter().zip(weights).enumerate() {
            if !(p.is_finite() && *p >= 0.0) || (*p > 0.0 && !x.is_finite()) {
                return Err(Unknown::Number(index + 1));
            }
        }
        if weights.iter().all(|p| *p == 0.0) {
            return Err(Unknown::Nothing);
        }
        let good = self.good_error(weights, search);
        self.rank(scratch, known, weights, search.restarts);
        let mut best = (f64::INFINITY, [0.0; MOST_PARAMETERS]);
        for start in 0..scratch.starts.len() {
            let (_, node) = scratch.starts[start];
            let found = self.descend(scratch, node, known, weights, search);
            if found.error < best.0 {
                best = (found.error, found.s);
            }
            if best.0 <= good {
                break;
            }
        }
        self.evaluate(scratch, &best.1);
        let Scratch {
            value, best: kept, ..
        } = scratch;
        kept.copy_from_slice(&value[..self.components]);
        Ok(Completion {
            values: kept,
            parameters: best.1,
            error: best.0,
            good: best.0 <= good,
        })
    }

    /// The largest E that is good: that of [`Search::good`] of the spans of the known components.
    pub(super) fn good_error(&self, weights: &[f64], search: &Search) -> f64 {
        let pairs = weights.iter().zip(&self.spans);
        let scale: f64 = pairs.map(|(p, span)| 0.5 * p * span * span).sum();
        scale * search.good * search.good
    }

    /// Notes the nodes that are nearest in the known components.
    fn rank(&self, scratch: &mut Scratch, known: &[f64], weights: &[f64], restarts: usize) {
        let most = restarts.min(Search::MOST_RESTARTS) + 1;
        let starts = &mut scratch.starts;
        starts.clear();
        for (node, vector) in self.vectors.chunks_exact(self.components).enumerate() {
            let error = distance(vector, known, weights);
            let place = starts.partition_point(|(other, _)| *other <= error);
            if place < most {
                starts.truncate(most - 1);
                starts.insert(place, (error, node));
            }
        }
    }

    fn descend(
        &self,
        scratch: &mut Scratch,
        node: usize,
        known: &[f64],
        weights: &[f64],
        search: &Search,
    ) -> At {
        let mut s = [0.0; MOST_PARAMETERS];
        self.node(node, &mut s[..self.axes.len()]);
        let mut here = self.look(scratch, s, known, weights);
        let mut damping = 1e-3;
        for _ in 0..search.steps {
            let Some(there) = self.step(&here, damping, search.reach) else {
                break;
            };
            let next = self.look(scratch, there, known, weights);
            if next.error < here.error {
                here = next;
                damping = (damping * 0.1).max(1e-12);
            } else {
                damping *= 10.0;
            }
            if damping > MOST_DAMPING {
                break;
            }
        }
        here
    }

    /// Where the next step leads, within reach of the grid; `None` when it stands still.
    fn step(&self, here: &At, damping: f64, reach: f64) -> Option<[f64; MOST_PARAMETERS]> {
        let mut damped = here.curvature;
        let steepest = here.curvature.diagonal().max();
        for axis in 0..MOST_PARAMETERS {
            damped[(axis, axis)] += damping * (here.curvature[(axis, axis)] + 1e-9 * steepest);
            if axis >= self.axes.len() || damped[(axis, axis)] <= 0.0 {
                // What no parameter moves stays where it is.
                damped[(axis, axis)] = 1.0;
            }
        }
        let way = damped.cholesky()?.solve(&-here.gradient);
        let mut there = here.s;
        let mut moved = false;
        for (axis, nodes) in self.axes.iter().enumerate() {
            let (first, last) = (nodes.first()?, nodes.last()?);
            let length = last - first;
            let (low, high) = (first - reach * length, last + reach * length);
            there[axis] = (here.s[axis] + way[axis]).clamp(low, high);
            moved |= (there[axis] - here.s[axis]).abs() > STANDS * length;
        }
        moved.then_some(there)
    }

    fn look(
        &self,
        scratch: &mut Scratch,
        s: [f64; MOST_PARAMETERS],
        known: &[f64],
        weights: &[f64],
    ) -> At {
        self.evaluate(scratch, &s);
        let mut at = At {
            s,
            error: distance(&scratch.value, known, weights),
            gradient: Vector6::zeros(),
            curvature: Matrix6::zeros(),
        };
        let derivatives = &scratch.derivatives;
        for (component, (x, p)) in known.iter().zip(weights).enumerate() {
            if *p == 0.0 {
                continue;
            }
            let off = p * (scratch.value[component] - x);
            for (row, one) in derivatives.iter().enumerate() {
                at.gradient[row] += off * one[component];
                for (column, other) in derivatives.iter().enumerate() {
                    at.curvature[(row, column)] += p * one[component] * other[component];
                }
            }
        }
        at
    }
}

/// E of a vector.
fn distance(vector: &[f64], known: &[f64], weights: &[f64]) -> f64 {
    let pairs = vector.iter().zip(known).zip(weights);
    let squares = pairs.filter(|(_, p)| **p > 0.0);
    0.5 * squares
        .map(|((m, x), p)| p * (x - m) * (x - m))
        .sum::<f64>()
}
