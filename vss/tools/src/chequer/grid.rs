//! Puts corners in order: a grid that grows from one corner along the edges that cross there.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::Vector2;

use super::{
    NoChequer,
    corner::{Saddle, Smooth},
};

/// So many corners are tried as the first one, the strongest first.
const MOST_SEEDS: usize = 24;
/// A neighbour lies this near to where it is expected, as a part of the step.
const NEAR: f64 = 0.3;
/// The first neighbours lie this near to the direction of their edge, rad.
const ALONG: f64 = 0.3;

/// Which corner stands at a place of the grid.
type Grid = BTreeMap<(i32, i32), usize>;

/// Indices of the corners of the pattern, row by row.
pub(super) fn ordered(
    smooth: &Smooth,
    found: &[Saddle],
    columns: usize,
    rows: usize,
) -> Result<Vec<usize>, NoChequer> {
    let mut largest = (0, 0, 0);
    let mut seen = vec![false; found.len()];
    let mut seeds = 0;
    for seed in 0..found.len() {
        if seen.get(seed).copied().unwrap_or(true) || seeds == MOST_SEEDS {
            continue;
        }
        seeds += 1;
        let Some(grid) = grown(smooth, found, seed) else {
            continue;
        };
        for index in grid.values() {
            if let Some(seen) = seen.get_mut(*index) {
                *seen = true;
            }
        }
        let (wide, high) = size(&grid);
        if grid.len() > largest.2 {
            largest = (wide, high, grid.len());
        }
        if grid.len() == columns * rows
            && ((wide, high) == (columns, rows) || (wide, high) == (rows, columns))
            && let Some(ordered) = in_order(found, &grid, columns, rows)
        {
            return Ok(ordered);
        }
    }
    let (wide, high, filled) = largest;
    Err(NoChequer::OtherSize {
        columns: wide.max(high),
        rows: wide.min(high),
        filled,
        wanted_columns: columns,
        wanted_rows: rows,
    })
}

fn place(saddle: &Saddle) -> Vector2<f64> {
    Vector2::new(saddle.u, saddle.v)
}

fn size(grid: &Grid) -> (usize, usize) {
    let span = |of: &dyn Fn(&(i32, i32)) -> i32| {
        let low = grid.keys().map(of).min().unwrap_or(0);
        let high = grid.keys().map(of).max().unwrap_or(-1);
        usize::try_from(high - low + 1).unwrap_or(0)
    };
    (span(&|at| at.0), span(&|at| at.1))
}

/// Whether two neighbours have their bright fields in other quadrants, as they must.
fn alternate(smooth: &Smooth, one: &Saddle, other: &Saddle) -> bool {
    let [a, b] = one.edges;
    let bright = |saddle: &Saddle, angle: f64| {
        let grey = smooth.on_ring(saddle.u, saddle.v, angle);
        grey.map(|grey| grey > saddle.middle)
    };
    let between = 0.5 * (a + b);
    bright(one, between).is_some() && bright(one, between) != bright(other, between)
}

/// The grid around a corner; `None` if it has no neighbours along both edges.
fn grown(smooth: &Smooth, found: &[Saddle], seed: usize) -> Option<Grid> {
    let first = found.get(seed)?;
    let steps: Option<Vec<Vector2<f64>>> = first
        .edges
        .iter()
        .map(|edge| first_step(smooth, found, seed, *edge))
        .collect();
    let steps = steps?;
    let [along, down] = steps.as_slice() else {
        return None;
    };
    let mut grid = Grid::from([((0, 0), seed)]);
    let mut taken = vec![false; found.len()];
    *taken.get_mut(seed)? = true;
    let mut open = VecDeque::from([((0, 0), seed, *along, *down)]);
    while let Some((at, index, along, down)) = open.pop_front() {
        let own = found.get(index)?;
        for (turn, step) in [
            ((1, 0), along),
            ((-1, 0), -along),
            ((0, 1), down),
            ((0, -1), -down),
        ] {
            let next = (at.0 + turn.0, at.1 + turn.1);
            if grid.contains_key(&next) {
                continue;
            }
            // What lies on the other side tells how the steps change.
            let behind = grid.get(&(at.0 - turn.0, at.1 - turn.1));
            let behind = behind.and_then(|index| found.get(*index));
            let step = behind.map_or(step, |other| place(own) - place(other));
            let expected = place(own) + step;
            let off = |saddle: &Saddle| (place(saddle) - expected).norm();
            let near = found.iter().enumerate().filter(|(other, saddle)| {
                !taken.get(*other).copied().unwrap_or(true) && off(saddle) < NEAR * step.norm()
            });
            let near = near.filter(|(_, saddle)| alternate(smooth, own, saddle));
            let Some((other, saddle)) = near.min_by(|a, b| off(a.1).total_cmp(&off(b.1))) else {
                continue;
            };
            if let Some(taken) = taken.get_mut(other) {
                *taken = true;
            }
            grid.insert(next, other);
            let way = place(saddle) - place(own);
            let (along, down) = match turn {
                (1, 0) => (way, down),
                (-1, 0) => (-way, down),
                (0, 1) => (along, way),
                _ => (along, -way),
            };
            open.push_back((next, other, along, down));
        }
    }
    Some(grid)
}

/// The way to the nearest neighbour along an edge, either way.
fn first_step(smooth: &Smooth, found: &[Saddle], seed: usize, edge: f64) -> Option<Vector2<f64>> {
    let own = found.get(seed)?;
    let direction = Vector2::new(edge.cos(), edge.sin());
    let ways = found.iter().enumerate().filter(|(index, _)| *index != seed);
    let ways = ways.filter(|(_, saddle)| alternate(smooth, own, saddle));
    let ways = ways.map(|(_, saddle)| place(saddle) - place(own));
    let along = ways.filter(|way| {
        let across = way.x * direction.y - way.y * direction.x;
        across.abs() < ALONG * way.norm()
    });
    let nearest = along.min_by(|a, b| a.norm().total_cmp(&b.norm()))?;
    Some(nearest * nearest.dot(&direction).signum())
}

/// A full grid row by row: of the orders that are not mirrored, the one that begins at the upper left.
fn in_order(found: &[Saddle], grid: &Grid, columns: usize, rows: usize) -> Option<Vec<usize>> {
    let low_i = grid.keys().map(|at| at.0).min()?;
    let low_j = grid.keys().map(|at| at.1).min()?;
    let (wide, high) = size(grid);
    let whole = |value: usize| i32::try_from(value).unwrap_or(i32::MAX);
    let mut best: Option<(f64, Vec<usize>)> = None;
    for swapped in [false, true] {
        let (across, down) = if swapped { (high, wide) } else { (wide, high) };
        if (across, down) != (columns, rows) {
            continue;
        }
        for flip in 0..4 {
            let at = |column: usize, row: usize| {
                let column = if flip & 1 == 0 {
                    column
                } else {
                    columns - 1 - column
                };
                let row = if flip & 2 == 0 { row } else { rows - 1 - row };
                let (i, j) = if swapped {
                    (row, column)
                } else {
                    (column, row)
                };
                grid.get(&(low_i + whole(i), low_j + whole(j))).copied()
            };
            let order = (0..columns * rows).map(|k| at(k % columns, k / columns));
            let order: Vec<usize> = order.collect::<Option<_>>()?;
            let corner = |k: usize| order.get(k).and_then(|index| found.get(*index)).map(place);
            let (first, right, below) = (
                corner(0)?,
                corner(columns - 1)?,
                corner(columns * (rows - 1))?,
            );
            let (right, below) = (right - first, below - first);
            let mirrored = right.x * below.y - right.y * below.x <= 0.0;
            let corner = first.x + first.y;
            if !mirrored && best.as_ref().is_none_or(|(least, _)| corner < *least) {
                best = Some((corner, order));
            }
        }
    }
    best.map(|(_, order)| order)
}
