//! Points to chains, chains to straight pieces.

use std::f64::consts::PI;

use super::{LinePoint, LinesOptions, Piece, unsigned};

/// Neighbours in a chain are no further apart, px.
const NEAR: isize = 2;
/// The direction of a line changes no more from one point to the next, rad.
const TURN: f64 = 0.5;

/// The straight pieces of all lines.
pub(super) fn pieces(found: &[(usize, LinePoint)], options: &LinesOptions) -> Vec<Piece> {
    let mut order: Vec<usize> = (0..found.len()).collect();
    let contrast = |at: &usize| found.get(*at).map_or(0.0, |(_, point)| point.contrast);
    order.sort_by(|a, b| contrast(b).total_cmp(&contrast(a)));
    let field = Field::new(found);
    let mut used = vec![false; found.len()];
    let mut pieces = Vec::new();
    for seed in order {
        if used.get(seed).copied().unwrap_or(true) {
            continue;
        }
        let chain = field.chain(seed, &mut used);
        pieces.extend(straight(&chain, options));
    }
    pieces.sort_by_key(|piece| std::cmp::Reverse(piece.points));
    pieces
}

/// Points that are found by their place.
struct Field<'a> {
    points: &'a [(usize, LinePoint)],
    /// Row and column of the pixel that is nearest to a point, and its index, in order.
    places: Vec<((isize, isize), usize)>,
}

impl<'a> Field<'a> {
    fn new(points: &'a [(usize, LinePoint)]) -> Self {
        let place = |(at, (_, point)): (usize, &(usize, LinePoint))| {
            ((point.v.round() as isize, point.u.round() as isize), at)
        };
        let mut places: Vec<_> = points.iter().enumerate().map(place).collect();
        places.sort_unstable();
        Self { points, places }
    }

    /// The points about a place.
    fn about(&self, place: &LinePoint) -> impl Iterator<Item = (usize, &LinePoint)> {
        let (u, v) = (place.u.round() as isize, place.v.round() as isize);
        (v - NEAR..=v + NEAR).flat_map(move |row| {
            let first = self.places.partition_point(|(at, _)| *at < (row, u - NEAR));
            let there = self.places.get(first..).unwrap_or_default().iter();
            let there = there.take_while(move |(at, _)| *at <= (row, u + NEAR));
            there.filter_map(|(_, at)| Some((*at, &self.points.get(*at)?.1)))
        })
    }

    /// The line through a point, from one end to the other as its points are directed.
    fn chain(&self, seed: usize, used: &mut [bool]) -> Vec<LinePoint> {
        let Some((_, start)) = self.points.get(seed) else {
            return Vec::new();
        };
        used[seed] = true;
        let mut ways = [0.0, PI].map(|turn| {
            let (mut way, mut last, mut heading) = (Vec::new(), start, start.direction + turn);
            while let Some((at, next, towards)) = self.next(last, heading, used) {
                used[at] = true;
                way.push(*next);
                (last, heading) = (next, towards);
            }
            way
        });
        ways[1].reverse();
        let [ahead, mut chain] = ways;
        chain.push(*start);
        chain.extend(ahead);
        chain
    }

    /// The nearest free point ahead, and where the line goes from there.
    fn next(
        &self,
        last: &LinePoint,
        heading: f64,
        used: &[bool],
    ) -> Option<(usize, &'a LinePoint, f64)> {
        let (along_u, along_v) = (heading.cos(), heading.sin());
        let ahead = self.about(last).filter_map(|(at, point)| {
            if used.get(at).copied().unwrap_or(true) {
                return None;
            }
            let (du, dv) = (point.u - last.u, point.v - last.v);
            let along = du * along_u + dv * along_v;
            let beside = (dv * along_u - du * along_v).abs();
            let turn = unsigned(point.direction - heading);
            (along > 0.2 && beside <= along && turn.abs() <= TURN).then_some((
                along + 2.0 * beside,
                at,
                heading + turn,
            ))
        });
        let (_, at, towards) = ahead.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
        Some((at, &self.points.get(at)?.1, towards))
    }
}

/// A chain, cut where it is not straight (U. Ramer, 1972), and a line through each part.
fn straight(chain: &[LinePoint], options: &LinesOptions) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let mut parts = vec![chain];
    while let Some(part) = parts.pop() {
        let [first, .., last] = part else {
            continue;
        };
        let (du, dv) = (last.u - first.u, last.v - first.v);
        let length = du.hypot(dv);
        // Of a ring the ends say nothing about its points.
        let off = |point: &LinePoint| {
            let (u, v) = (point.u - first.u, point.v - first.v);
            if length > 1.0 {
                (u * dv - v * du).abs() / length
            } else {
                u.hypot(v)
            }
        };
        let farthest = part.iter().enumerate().map(|(at, point)| (off(point), at));
        let farthest = farthest.max_by(|a, b| a.0.total_cmp(&b.0));
        let noise = part.iter().map(|point| point.sd).sum::<f64>() / part.len() as f64;
        match farthest {
            Some((far, at))
                if far > options.straight.max(4.0 * noise) && at > 0 && at + 1 < part.len() =>
            {
                parts.push(&part[..=at]);
                parts.push(&part[at..]);
            }
            _ => pieces.extend(fitted(part, options)),
        }
    }
    pieces
}

/// The line that is nearest to the points of a part, in the direction of these.
fn fitted(part: &[LinePoint], options: &LinesOptions) -> Option<Piece> {
    let count = part.len() as f64;
    let mean = |of: fn(&LinePoint) -> f64| part.iter().map(of).sum::<f64>() / count;
    let (u, v) = (mean(|point| point.u), mean(|point| point.v));
    let (mut uu, mut uv, mut vv) = (0.0, 0.0, 0.0);
    for point in part {
        let (du, dv) = (point.u - u, point.v - v);
        uu += du * du;
        uv += du * dv;
        vv += dv * dv;
    }
    let angle = 0.5 * (2.0 * uv).atan2(uu - vv);
    let (first, last) = (part.first()?, part.last()?);
    let turned = (last.u - first.u) * angle.cos() + (last.v - first.v) * angle.sin() < 0.0;
    let angle = if turned { angle + PI } else { angle };
    let (along_u, along_v) = (angle.cos(), angle.sin());
    let place = |point: &LinePoint| {
        let along = (point.u - u) * along_u + (point.v - v) * along_v;
        [u + along * along_u, v + along * along_v]
    };
    let (from, to) = (place(first), place(last));
    let length = (to[0] - from[0]).hypot(to[1] - from[1]);
    if part.len() < 3 || length < options.length {
        return None;
    }
    let square = |point: &LinePoint| ((point.v - v) * along_u - (point.u - u) * along_v).powi(2);
    let rms = (part.iter().map(square).sum::<f64>() / count).sqrt();
    let noise = (part.iter().map(|point| point.sd * point.sd).sum::<f64>() / count).sqrt();
    // Neighbours share their pixels: so long a part of the line says as much as one point.
    let shared = 2.0 * PI.sqrt() * options.sigma;
    let sd = noise.max(rms) / (length / shared).max(1.0).sqrt();
    Some(Piece {
        from,
        to,
        sd,
        sd_direction: sd * 12.0_f64.sqrt() / length,
        rms,
        contrast: mean(|point| point.contrast),
        points: part.len(),
    })
}
