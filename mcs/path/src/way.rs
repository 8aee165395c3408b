//! A way that was found: its points, shorter where a straight way will do, and how much its corners may be rounded.

use mcs::Joints;
use mcs::model::Model;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::space::{Space, Touch, between};

/// Corners are rounded by no more, rad or m in each joint: more makes nothing quicker.
const WIDEST: f64 = 0.3;
/// Short cuts keep so much more than the margin, m, which corners are rounded in.
const CORNER_M: f64 = 0.03;

/// A way of an arm: straight in the space of its joints from point to point.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Way {
    /// Joint positions, rad or m, the start first and the goal last.
    pub points: Vec<Joints>,
    /// How far before and behind each point the way may be left to round its corner, in the joint that moves most there,
    /// rad or m: whatever all joints do between their positions at these places and at the point, they keep all distances. 0 at
    /// both ends.
    pub leeway: Vec<f64>,
    /// Its length: the sum over its parts of [`Space::distance`], m.
    pub length_m: f64,
    /// How long it takes at most at full speed with a stop at each point, s; parts of joints without limits are left out.
    pub full_speed_s: f64,
    /// The pair that is nearest on it, as far as it was looked at.
    pub nearest: Option<Touch>,
}

/// The length of a way through points, m.
pub(crate) fn length(space: &Space, points: &[Joints]) -> f64 {
    let parts = points.windows(2);
    parts.map(|part| space.distance(&part[0], &part[1])).sum()
}

/// Takes a short cut between two random places of a way, so many times where that is free; then leaves out every point
/// that is not needed. Both where there is room to spare: so corners have some.
pub(crate) fn shorten(
    space: &mut Space,
    points: &mut Vec<Joints>,
    (cuts, rng): (u32, &mut ChaCha8Rng),
) {
    let before = space.widen(CORNER_M);
    for _ in 0..cuts {
        if points.len() < 3 {
            break;
        }
        let all = length(space, points);
        let (one, other): (f64, f64) = (rng.random(), rng.random());
        let (first, from) = place(space, points, all * one.min(other));
        let (last, to) = place(space, points, all * one.max(other));
        if first == last || space.goes_free(&from, &to).is_err() {
            continue;
        }
        drop(points.splice(first + 1..=last, [from, to]));
        // A cut at a point of the way would leave that point twice.
        points.dedup();
    }
    let mut at = 1;
    while at + 1 < points.len() {
        match space.goes_free(&points[at - 1], &points[at + 1]) {
            Ok(()) => drop(points.remove(at)),
            Err(_) => at += 1,
        }
    }
    space.keep(before);
}

/// The part of a way (from its point of that number to the next one) in which a length (m) is behind, and the place.
fn place(space: &Space, points: &[Joints], behind: f64) -> (usize, Joints) {
    let mut left = behind;
    for (number, part) in points.windows(2).enumerate() {
        let length = space.distance(&part[0], &part[1]);
        if left <= length || number + 2 == points.len() {
            let share = if length > 0.0 { left / length } else { 1.0 };
            return (number, between(&part[0], &part[1], share.min(1.0)));
        }
        left -= length;
    }
    (0, points.first().copied().unwrap_or_default())
}

/// Looks at all of a way anew, point by point, so often that nothing moves by more than `resolution_m` between two looks.
///
/// # Errors
/// What is too near on it.
pub fn check(
    space: &mut Space,
    points: &[Joints],
    resolution_m: f64,
) -> Result<Option<Touch>, Touch> {
    let mut nearest: Option<(usize, f64)> = None;
    for part in points.windows(2) {
        let levers = space.levers().iter();
        let ways = levers.zip(part[0].iter().zip(&part[1]));
        let moves: f64 = ways.map(|(lever, (a, b))| lever * (b - a).abs()).sum();
        let steps = (moves / resolution_m).ceil().max(1.0);
        for step in 0..=steps as u64 {
            let at = between(&part[0], &part[1], step as f64 / steps);
            let near = space.look(&at)?;
            let least = nearest.map_or(f64::INFINITY, |(_, least)| least);
            nearest = near.filter(|(_, now)| *now < least).or(nearest);
        }
    }
    Ok(nearest.map(|(pair, distance)| space.touch(pair, distance)))
}

/// The time of a way with a stop at each point, s: that of the slowest joint of each part, none of which is quicker together.
fn at_full_speed(model: &Model, points: &[Joints]) -> f64 {
    let part = |part: &[Joints]| {
        let joints = model.joints().iter().zip(part[0].iter().zip(&part[1]));
        let times = joints.map(|(joint, (from, to))| {
            let limits = &joint.limits;
            let time = (to - from).abs() / limits.velocity + limits.velocity / limits.acceleration;
            if time.is_finite() { time } else { 0.0 }
        });
        times.fold(0.0, f64::max)
    };
    points.windows(2).map(part).sum()
}

/// How much each joint moves before or behind a point, whichever is more, as a part of the joint that moves most there.
fn parts_at(points: &[Joints], number: usize) -> Joints {
    let ways = |from: &Joints, to: &Joints| {
        let way = |joint: usize| (to[joint] - from[joint]).abs();
        let most = (0..from.len()).map(way).fold(0.0, f64::max);
        Joints::from_fn(from.len(), |joint| way(joint) / most)
    };
    let [before, at, behind] = [number - 1, number, number + 1].map(|number| points[number]);
    let (into, out) = (ways(&before, &at), ways(&at, &behind));
    Joints::from_fn(at.len(), |joint| into[joint].max(out[joint]))
}

/// What there is to say of a way through points that is free.
pub(crate) fn finished(space: &mut Space, points: Vec<Joints>, nearest: Option<Touch>) -> Way {
    let last = points.len().saturating_sub(1);
    let leeway = (0..points.len()).map(|number| match number == 0 || number == last {
        true => 0.0,
        false => space
            .leeway(&points[number], &parts_at(&points, number))
            .min(WIDEST),
    });
    let leeway = leeway.collect();
    Way {
        length_m: length(space, &points),
        full_speed_s: at_full_speed(space.model(), &points),
        points,
        leeway,
        nearest,
    }
}
