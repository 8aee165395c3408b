//! Nodes that a layout file does not name, where it names others. Each is put on the nearest free spot
//! near its neighbours, and nothing else moves.

use std::collections::BTreeMap;

use super::point::Point;

/// Distance of spots, px.
const SPOT: (f64, f64) = (84.0, 54.0);

/// Fills in the missing positions; `near` are the neighbours of each node.
pub(super) fn place(given: &[Option<Point>], near: &[Vec<usize>]) -> Vec<Point> {
    let mut at: Vec<Option<Point>> = given.to_vec();
    let mut taken: BTreeMap<(i64, i64), ()> = BTreeMap::new();
    for point in given.iter().flatten() {
        taken.insert(spot(*point), ());
    }
    let bottom = given
        .iter()
        .flatten()
        .map(|point| point.1)
        .fold(0.0, f64::max);
    let left = given
        .iter()
        .flatten()
        .map(|point| point.0)
        .fold(f64::INFINITY, f64::min);
    let start = (if left.is_finite() { left } else { 0.0 }, bottom + SPOT.1);
    loop {
        // The one that has most neighbours in place; the first of several.
        let placed = |one: usize| -> Vec<Point> {
            let near = near.get(one).map_or(&[][..], Vec::as_slice);
            near.iter()
                .filter_map(|other| at.get(*other).copied().flatten())
                .collect()
        };
        let next = (0..at.len())
            .filter(|one| at[*one].is_none())
            .map(|one| (placed(one), one))
            .max_by(|a, b| a.0.len().cmp(&b.0.len()).then(b.1.cmp(&a.1)));
        let Some((around, one)) = next else { break };
        let wanted = if around.is_empty() {
            start
        } else {
            let count = around.len() as f64;
            let (x, y) = around
                .iter()
                .fold((0.0, 0.0), |(x, y), at| (x + at.0, y + at.1));
            (
                x / count + if around.len() == 1 { SPOT.0 } else { 0.0 },
                y / count,
            )
        };
        let free = free_spot(spot(wanted), &taken);
        taken.insert(free, ());
        at[one] = Some((free.0 as f64 * SPOT.0, free.1 as f64 * SPOT.1));
    }
    at.into_iter().map(Option::unwrap_or_default).collect()
}

#[allow(
    clippy::cast_possible_truncation,
    reason = "coordinates are within a million"
)]
fn spot((x, y): Point) -> (i64, i64) {
    ((x / SPOT.0).round() as i64, (y / SPOT.1).round() as i64)
}

/// The nearest spot that nobody has, in rings around the wanted one.
fn free_spot(wanted: (i64, i64), taken: &BTreeMap<(i64, i64), ()>) -> (i64, i64) {
    for ring in 0_i64.. {
        let around = (-ring..=ring).flat_map(|dx| (-ring..=ring).map(move |dy| (dx, dy)));
        let mut around: Vec<(i64, i64)> = around
            .filter(|(dx, dy)| dx.abs().max(dy.abs()) == ring)
            .collect();
        around.sort_by_key(|(dx, dy)| (dx * dx + dy * dy, *dy, *dx));
        let found = around
            .into_iter()
            .map(|(dx, dy)| (wanted.0 + dx, wanted.1 + dy))
            .find(|spot| !taken.contains_key(spot));
        if let Some(found) = found {
            return found;
        }
    }
    wanted
}
