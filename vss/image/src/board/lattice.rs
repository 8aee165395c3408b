//! Corners that form a lattice with a chequer pattern between them, grown from one corner and two of its neighbours.

use std::collections::{BTreeMap, VecDeque};

use super::light::Light;

/// So many of the sharpest corners are tried as the first.
const SEEDS: usize = 150;

/// So many of a corner's nearest are tried as its neighbours.
const NEAREST: usize = 10;

/// A corner lies within this part of a step of where it is expected.
const NEAR: f64 = 0.3;

/// Edges of less difference are none, grey values.
const LEAST: f64 = 5.0;

/// Inner corners of a board, a side.
const SIDE: i32 = 7;

/// Enough: what is missing is covered.
const ENOUGH: usize = 47;

/// Corners by their places in a lattice.
pub(super) struct Lattice(BTreeMap<(i32, i32), [f64; 2]>);

/// Pairs of a place in squares of a board and a place in the picture.
pub(super) type Window = Vec<([f64; 2], [f64; 2])>;

impl Lattice {
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// The first and the last place in both directions.
    fn bounds(&self) -> [(i32, i32); 2] {
        let of = |side: fn(&(i32, i32)) -> i32| {
            let sides = self.0.keys().map(side);
            (sides.clone().min().unwrap_or(0), sides.max().unwrap_or(0))
        };
        [of(|place| place.0), of(|place| place.1)]
    }

    /// Corners in both directions.
    pub(super) fn size(&self) -> (usize, usize) {
        let [x, y] = self
            .bounds()
            .map(|(first, last)| usize::try_from(last - first + 1).unwrap_or(0));
        (x, y)
    }

    /// The ways in which the lattice can be the inner corners of a board: one if it has seven a side; several where some are
    /// missing, or where it has too many.
    pub(super) fn windows(&self) -> Vec<Window> {
        let starts = |(first, last): (i32, i32)| {
            let other = last + 1 - SIDE;
            first.min(other)..=first.max(other)
        };
        let [across, down] = self.bounds();
        let places = starts(across).flat_map(|x| starts(down).map(move |y| (x, y)));
        let windows = places.map(|(x, y)| {
            let inside = |place: &(i32, i32)| {
                (x..x + SIDE).contains(&place.0) && (y..y + SIDE).contains(&place.1)
            };
            let pairs = self.0.iter().filter(|(place, _)| inside(place));
            let board =
                |place: &(i32, i32)| [f64::from(place.0 - x + 1), f64::from(place.1 - y + 1)];
            pairs.map(|(place, at)| (board(place), *at)).collect()
        });
        windows.collect()
    }
}

fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn plus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] + b[0], a[1] + b[1]]
}

fn length(a: [f64; 2]) -> f64 {
    a[0].mul_add(a[0], a[1] * a[1]).sqrt()
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// How much lighter it is beside the way from `p` to `q`, on the side to which its direction turns by a quarter from u to v.
fn edge(light: &Light, p: [f64; 2], q: [f64; 2]) -> f64 {
    let along = minus(q, p);
    let beside = [-0.14 * along[1], 0.14 * along[0]];
    let mut sum = 0.0;
    for share in [0.3, 0.5, 0.7] {
        let at = plus(p, along.map(|one| share * one));
        match (light.at(plus(at, beside)), light.at(minus(at, beside))) {
            (Some(one), Some(other)) => sum += one - other,
            _ => return 0.0,
        }
    }
    sum / 3.0
}

/// The largest lattice among the corners, which come with the sharpest first.
pub(super) fn largest(light: &Light, corners: &[[f64; 2]]) -> Option<Lattice> {
    let mut best: Option<Lattice> = None;
    for seed in corners.iter().take(SEEDS) {
        let mut near: Vec<[f64; 2]> = corners
            .iter()
            .filter(|other| *other != seed)
            .copied()
            .collect();
        near.sort_by(|a, b| length(minus(*a, *seed)).total_cmp(&length(minus(*b, *seed))));
        near.truncate(NEAREST);
        let edges: Vec<([f64; 2], f64)> = near
            .iter()
            .map(|other| (minus(*other, *seed), edge(light, *seed, *other)))
            .filter(|(_, difference)| difference.abs() > LEAST)
            .collect();
        for (x, across) in &edges {
            for (y, down) in &edges {
                let sine = cross(*x, *y) / (length(*x) * length(*y));
                // Beside the first way lies the square that the second one has on its other side.
                if sine < 0.35 || across * down > 0.0 {
                    continue;
                }
                let ratio = length(*x) / length(*y);
                if !(0.3..=3.0).contains(&ratio) {
                    continue;
                }
                let lattice = grown(light, corners, *seed, [*x, *y], *across);
                if best.as_ref().is_none_or(|best| lattice.len() > best.len()) {
                    best = Some(lattice);
                }
                if best.as_ref().is_some_and(|best| best.len() >= ENOUGH) {
                    return best;
                }
            }
        }
    }
    best
}

/// Grows a lattice from a corner and the steps to two of its neighbours.
fn grown(
    light: &Light,
    corners: &[[f64; 2]],
    seed: [f64; 2],
    steps: [[f64; 2]; 2],
    first: f64,
) -> Lattice {
    let mut lattice = BTreeMap::from([((0, 0), seed)]);
    let mut waiting = VecDeque::from([((0, 0), seed, steps)]);
    let least = LEAST.max(0.12 * first.abs());
    while let Some((place, at, steps)) = waiting.pop_front() {
        for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let mut next: (i32, i32) = place;
            if axis == 0 {
                next.0 += sign;
            } else {
                next.1 += sign;
            }
            if lattice.contains_key(&next) || next.0.abs() > 2 * SIDE || next.1.abs() > 2 * SIDE {
                continue;
            }
            let step = steps[axis].map(|one| f64::from(sign) * one);
            let expected = plus(at, step);
            let far = |corner: &[f64; 2]| length(minus(*corner, expected));
            let nearest = corners.iter().min_by(|a, b| far(a).total_cmp(&far(b)));
            let Some(found) = nearest.filter(|found| far(found) < NEAR * length(step)) else {
                continue;
            };
            if lattice.values().any(|other| other == found) {
                continue;
            }
            // Squares alternate: so do the signs of the edges, and those across and down are opposite.
            let (p, q) = if sign > 0 { (at, *found) } else { (*found, at) };
            let from = if sign > 0 { place } else { next };
            let even = (from.0 + from.1).rem_euclid(2) == 0;
            let expected = first.signum() * if even == (axis == 0) { 1.0 } else { -1.0 };
            if edge(light, p, q) * expected < least {
                continue;
            }
            let mut own = steps;
            own[axis] = minus(q, p);
            lattice.insert(next, *found);
            waiting.push_back((next, *found, own));
        }
    }
    Lattice(lattice)
}
