//! The inner corners of a chequer pattern: found as saddles, put in order as a grid, each placed to a fraction of a pixel.
//!
//! A saddle of the smoothed picture around which bright and dark change four times is a corner. From one of them the grid
//! grows along the two edges that cross there; colours change from corner to corner. Each is then fitted: two blurred
//! edges that cross, b + a erf(p) erf(q), whose least squares give the standard deviations, too. Knows pictures only.

mod corner;
mod grid;
mod near;

use crate::{frame::Frame, spot::noise_sd};
use corner::{Smooth, refined, saddles};
pub use near::corners_near;

/// A corner. Pixel centres are at whole numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InnerCorner {
    /// Column, px.
    pub u: f64,
    /// Row, px.
    pub v: f64,
    /// Predicted standard deviation of `u`, px.
    pub sd_u: f64,
    /// Predicted standard deviation of `v`, px.
    pub sd_v: f64,
}

/// Why there are no corners.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoChequer {
    /// No picture.
    #[error("the picture is empty, or its size is wrong")]
    NoPicture,
    /// Too small a pattern was asked for.
    #[error("a pattern has 3 x 3 inner corners or more, not {0} x {1}")]
    TooSmall(usize, usize),
    /// Fewer corners than the pattern has.
    #[error(
        "the picture has {found} corners of two bright and two dark fields, and the pattern {wanted}: is all of it in view, sharp, and lit?"
    )]
    TooFew {
        /// In the picture.
        found: usize,
        /// In the pattern.
        wanted: usize,
    },
    /// No grid of that size.
    #[error(
        "the corners make a grid of {columns} x {rows} (with {filled} corners), not {wanted_columns} x {wanted_rows} inner corners: is a part covered, or -inner wrong?"
    )]
    OtherSize {
        /// Columns of the largest grid.
        columns: usize,
        /// Rows of it.
        rows: usize,
        /// Corners in it.
        filled: usize,
        /// Asked for.
        wanted_columns: usize,
        /// Asked for.
        wanted_rows: usize,
    },
    /// A corner of the grid could not be placed.
    #[error(
        "the corner near ({0:.0}, {1:.0}) is no crossing of two edges: is it covered, or out of focus?"
    )]
    BadCorner(f64, f64),
}

/// The `columns` x `rows` inner corners of the pattern, row by row. Rows run right and downwards as far as the pattern's turn
/// allows; the first corner is the one of them nearest to the upper left of the picture that this order permits.
///
/// # Errors
/// [`NoChequer`] with what was found instead.
pub fn find_corners(
    frame: &Frame,
    columns: usize,
    rows: usize,
) -> Result<Vec<InnerCorner>, NoChequer> {
    if columns < 3 || rows < 3 {
        return Err(NoChequer::TooSmall(columns, rows));
    }
    if frame.width < 8 || frame.height < 8 || !frame.is_whole() {
        return Err(NoChequer::NoPicture);
    }
    let grey = frame.grey();
    let smooth = Smooth::of(&grey, frame.width);
    let found = saddles(&smooth);
    let wanted = columns.saturating_mul(rows);
    if found.len() < wanted {
        let found = found.len();
        return Err(NoChequer::TooFew { found, wanted });
    }
    let ordered = grid::ordered(&smooth, &found, columns, rows)?;
    let noise = noise_sd(&grey, frame.width);
    let reach = reaches(&ordered, &found, columns);
    let corners = ordered.iter().zip(reach).map(|(index, reach)| {
        let saddle = &found[*index];
        let bad = NoChequer::BadCorner(saddle.u, saddle.v);
        refined(&grey, frame.width, saddle, reach, noise).ok_or(bad)
    });
    corners.collect()
}

/// How far from each corner its edges are its own, px: a part of the way to the nearest other corner.
fn reaches(ordered: &[usize], found: &[corner::Saddle], columns: usize) -> Vec<f64> {
    let at = |k: usize| ordered.get(k).and_then(|index| found.get(*index));
    let gap = |a: usize, b: usize| {
        let (a, b) = (at(a)?, at(b)?);
        Some((a.u - b.u).hypot(a.v - b.v))
    };
    let reach = |k: usize| {
        let column = k % columns;
        let left = (column > 0).then(|| gap(k, k - 1)).flatten();
        let right = (column + 1 < columns).then(|| gap(k, k + 1)).flatten();
        let above = k.checked_sub(columns).and_then(|other| gap(k, other));
        let below = gap(k, k + columns);
        let gaps = [left, right, above, below].into_iter().flatten();
        (0.4 * gaps.fold(f64::INFINITY, f64::min)).clamp(3.0, 9.0)
    };
    (0..ordered.len()).map(reach).collect()
}

#[cfg(test)]
mod rendered;
#[cfg(test)]
mod tests;
