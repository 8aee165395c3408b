//! Maps from tables of nodes, maps of a part of a grid, and good places for nodes.

use super::{MOST_PARAMETERS, Psom, Search, Unknown};

/// Values of one axis that differ by less than this share of its length are one node.
const SAME: f64 = 1e-9;

/// Why a table makes no map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// There are no parameters, or too many.
    #[error("a map has 1 to {MOST_PARAMETERS} parameters, not {0}")]
    Parameters(usize),
    /// Nothing stands behind the parameters.
    #[error("a row has {0} numbers, and so no component behind its parameters")]
    Components(usize),
    /// A number is none.
    #[error("row {0} has a number that is not finite (counted from 1)")]
    Number(usize),
    /// An axis has one node.
    #[error(
        "parameter {0} has the same value in every row; a map needs two or more (counted from 1)"
    )]
    OneNode(usize),
    /// Two rows for one node.
    #[error("rows {0} and {1} are for one node (counted from 1)")]
    Twice(usize, usize),
    /// The grid has a hole.
    #[error("the grid of {nodes:?} nodes has no row for {missing:?}")]
    Missing {
        /// Nodes of each axis.
        nodes: Vec<usize>,
        /// The parameters of the first node without a row.
        missing: Vec<f64>,
    },
}

/// The zeros of the Chebyshev polynomial of degree `n` between two ends, ascending: nodes there lower the worst error of a
/// polynomial at no cost (Walter 1996, section 6.4).
#[must_use]
pub fn chebyshev(n: usize, from: f64, to: f64) -> Vec<f64> {
    let zero = |j: usize| {
        let angle = std::f64::consts::PI * (2 * j + 1) as f64 / (2 * n) as f64;
        0.5 * (from + to) - 0.5 * (to - from) * angle.cos()
    };
    (0..n).map(zero).collect()
}

impl Psom {
    /// A map from rows of `width` numbers in any order: first the parameters of a node, then its vector. There is a row
    /// for each node of a full grid, whose spacing is free.
    ///
    /// # Errors
    /// What the table lacks, by rows counted from 1.
    pub fn train(rows: &[f64], width: usize, parameters: usize) -> Result<Self, TrainError> {
        if !(1..=MOST_PARAMETERS).contains(&parameters) {
            return Err(TrainError::Parameters(parameters));
        }
        if width <= parameters {
            return Err(TrainError::Components(width));
        }
        if let Some(at) = rows.iter().position(|number| !number.is_finite()) {
            return Err(TrainError::Number(at / width + 1));
        }
        let axes: Vec<Vec<f64>> = (0..parameters)
            .map(|axis| nodes(rows.iter().copied().skip(axis).step_by(width)))
            .collect();
        if let Some(axis) = axes.iter().position(|nodes| nodes.len() < 2) {
            return Err(TrainError::OneNode(axis + 1));
        }
        let components = width - parameters;
        let counts: Vec<usize> = axes.iter().map(Vec::len).collect();
        let missing = |places: Vec<usize>| {
            let at = places.iter().zip(&axes).map(|(place, axis)| axis[*place]);
            TrainError::Missing {
                nodes: counts.clone(),
                missing: at.collect(),
            }
        };
        // A table that cannot fill its grid is refused before there is room for that.
        let all = counts
            .iter()
            .try_fold(1_usize, |n, count| n.checked_mul(*count));
        let rows: Vec<&[f64]> = rows.chunks_exact(width).collect();
        let all = all.filter(|all| *all <= 2 * rows.len());
        let places = |row: &[f64]| -> Vec<usize> {
            let pairs = row.iter().zip(&axes);
            pairs.map(|(value, axis)| nearest(axis, *value)).collect()
        };
        let Some(all) = all else {
            return Err(missing(hole(&rows, &counts, places)));
        };
        let mut owner = vec![None; all];
        for (index, row) in rows.iter().enumerate() {
            let node = position(&places(row), &counts);
            if let Some(first) = owner[node].replace(index) {
                return Err(TrainError::Twice(first + 1, index + 1));
            }
        }
        let mut vectors = Vec::with_capacity(all * components);
        for (node, owner) in owner.iter().enumerate() {
            let Some(row) = owner else {
                return Err(missing(unfolded(node, &counts)));
            };
            vectors.extend_from_slice(&rows[*row][parameters..]);
        }
        Ok(Self::of(axes, components, vectors))
    }

    fn of(axes: Vec<Vec<f64>>, components: usize, vectors: Vec<f64>) -> Self {
        let span = |component: usize| {
            let values = vectors.iter().skip(component).step_by(components);
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (x.min(low), x.max(high))
            });
            high - low
        };
        Self {
            spans: (0..components).map(span).collect(),
            axes,
            components,
            vectors,
        }
    }

    /// Completes a vector in the part of `size` nodes a side that is about the answer (a local PSOM, Walter 1996,
    /// section 6.2). With an even size the answer lies in the part's middle interval, and the map is continuous.
    /// Allocates the parts it looks at. Answers the values, the parameters, E, and
    /// whether that is good.
    ///
    /// # Errors
    /// As [`Psom::complete`].
    pub fn complete_locally(
        &self,
        size: usize,
        known: &[f64],
        weights: &[f64],
        search: &Search,
    ) -> Result<(Vec<f64>, Vec<f64>, f64, bool), Unknown> {
        let mut scratch = self.scratch();
        let whole = self.complete(&mut scratch, known, weights, search)?;
        let mut about = whole.parameters;
        // Parts that lead to one another end after some turns.
        for turn in 0.. {
            let starts: Vec<usize> = self
                .axes
                .iter()
                .zip(about)
                .map(|(nodes, s)| first_of_part(nodes, s, size))
                .collect();
            let part = self.part(&starts, size);
            let mut scratch = part.scratch();
            let found = part.complete(&mut scratch, known, weights, search)?;
            let next = self.axes.iter().zip(found.parameters);
            let same = next
                .zip(&starts)
                .all(|((nodes, s), start)| first_of_part(nodes, s, size) == *start);
            if same || turn == 8 {
                let parameters = found.parameters[..self.axes.len()].to_vec();
                let good = found.error <= self.good_error(weights, search);
                return Ok((found.values.to_vec(), parameters, found.error, good));
            }
            about = found.parameters;
        }
        Err(Unknown::Nothing)
    }

    /// The map of the nodes from `starts`, `size` a side.
    fn part(&self, starts: &[usize], size: usize) -> Self {
        let windows = self.axes.iter().zip(starts);
        let axes: Vec<Vec<f64>> = windows
            .map(|(nodes, start)| nodes.iter().skip(*start).take(size).copied().collect())
            .collect();
        let counts: Vec<usize> = self.axes.iter().map(Vec::len).collect();
        let kept = self.vectors.chunks(self.components).enumerate();
        let kept = kept.filter(|(node, _)| {
            let places = unfolded(*node, &counts);
            let mut pairs = places.iter().zip(starts);
            pairs.all(|(place, start)| (*start..start + size).contains(place))
        });
        let vectors = kept.flat_map(|(_, vector)| vector).copied().collect();
        Self::of(axes, self.components, vectors)
    }
}

/// The first node of the part of an axis that has `s` in its middle.
fn first_of_part(nodes: &[f64], s: f64, size: usize) -> usize {
    let middle = if size.is_multiple_of(2) {
        let below = nodes.partition_point(|node| *node <= s);
        below.saturating_sub(1).saturating_sub(size / 2 - 1)
    } else {
        nearest(nodes, s).saturating_sub(size / 2)
    };
    middle.min(nodes.len().saturating_sub(size))
}

/// The different values, ascending.
fn nodes(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    let length = match (values.first(), values.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    };
    values.dedup_by(|later, earlier| *later - *earlier <= SAME * length);
    values
}

/// The index of the nearest node.
fn nearest(nodes: &[f64], value: f64) -> usize {
    let after = nodes.partition_point(|node| *node < value);
    let before = after.saturating_sub(1);
    let off = |at: usize| {
        nodes
            .get(at)
            .map_or(f64::INFINITY, |node| (node - value).abs())
    };
    if off(before) <= off(after) {
        before
    } else {
        after
    }
}

/// The position of a node, the last axis fastest.
fn position(places: &[usize], counts: &[usize]) -> usize {
    let pairs = places.iter().zip(counts);
    pairs.fold(0, |sum, (place, count)| sum * count + place)
}

fn unfolded(mut node: usize, counts: &[usize]) -> Vec<usize> {
    let mut places = vec![0; counts.len()];
    for (place, count) in places.iter_mut().zip(counts).rev() {
        (*place, node) = (node % count, node / count);
    }
    places
}

/// The first node that no row is for, in a grid with more nodes than rows.
fn hole(rows: &[&[f64]], counts: &[usize], places: impl Fn(&[f64]) -> Vec<usize>) -> Vec<usize> {
    let mut taken: Vec<Vec<usize>> = rows.iter().map(|row| places(row)).collect();
    taken.sort_unstable();
    taken.dedup();
    let mut wanted = vec![0; counts.len()];
    for row in taken {
        if row != wanted {
            break;
        }
        for (place, count) in wanted.iter_mut().zip(counts).rev() {
            *place += 1;
            if *place < *count {
                break;
            }
            *place = 0;
        }
    }
    wanted
}
