//! Which pixels of a picture belong together, where that lies, and what is around it.

use std::collections::VecDeque;

use crate::frame::Frame;

/// Pixels by index, in the order in which they were reached.
pub(super) type Region = Vec<usize>;

/// Longer over shorter axis of second moments (uu, uv, vv), each widened by `more`.
pub(super) fn axes_ratio([uu, uv, vv]: [f64; 3], more: f64) -> f64 {
    let middle = 0.5 * (uu + vv);
    let half = (0.25 * (uu - vv) * (uu - vv) + uv * uv).sqrt();
    // Nothing in a picture of pixels is narrower than they are.
    let axis = |moment: f64| (moment + more).max(1.0 / 12.0);
    (axis(middle + half) / axis(middle - half)).sqrt()
}

/// Where a region lies and how long it is.
pub(super) struct Shape {
    pub u: f64,
    pub v: f64,
    /// Of the centre, when each pixel of its edge is in or out by chance.
    pub sd_u: f64,
    pub sd_v: f64,
    pub ratio: f64,
}

impl Shape {
    pub fn of(map: &Map, region: &Region) -> Self {
        let n = region.len().max(1) as f64;
        let places = || {
            region.iter().map(|at| {
                let (u, v) = map.place(*at);
                (u as f64, v as f64)
            })
        };
        let (u, v) = places().fold((0.0, 0.0), |sum, at| (sum.0 + at.0 / n, sum.1 + at.1 / n));
        let (mut uu, mut uv, mut vv) = (0.0, 0.0, 0.0);
        for (column, row) in places() {
            let (du, dv) = (column - u, row - v);
            uu += du * du / n;
            uv += du * dv / n;
            vv += dv * dv / n;
        }
        // Each pixel is a square and not a point, so that small spots do not look long.
        let ratio = axes_ratio([uu, uv, vv], 1.0 / 12.0);
        let edge = (4.0 * n.sqrt()).sqrt() / n;
        Self {
            u,
            v,
            sd_u: edge * uu.sqrt().max(0.3),
            sd_v: edge * vv.sqrt().max(0.3),
            ratio,
        }
    }
}

/// Which region each pixel belongs to.
pub(super) struct Map {
    width: usize,
    height: usize,
    /// 0 for none.
    labels: Vec<u32>,
    last: u32,
}

impl Map {
    pub fn new(frame: &Frame) -> Self {
        Self {
            width: frame.width,
            height: frame.height,
            labels: vec![0; frame.pixels.len()],
            last: 0,
        }
    }

    pub fn of(&self, at: usize) -> u32 {
        self.labels.get(at).copied().unwrap_or_default()
    }

    pub fn place(&self, at: usize) -> (usize, usize) {
        (at % self.width, at / self.width)
    }

    /// All 8-connected regions of pixels that are inside, in the order of their first pixels.
    pub fn regions(&mut self, inside: impl Fn(usize) -> bool) -> Vec<Region> {
        (0..self.labels.len())
            .filter_map(|start| self.flood(start, &inside))
            .collect()
    }

    /// The region around a pixel, when it is inside and in none yet.
    pub fn flood(&mut self, start: usize, inside: impl Fn(usize) -> bool) -> Option<Region> {
        if self.of(start) != 0 || !inside(start) {
            return None;
        }
        self.last += 1;
        let mut region = Region::new();
        let mut open = VecDeque::from([start]);
        if let Some(label) = self.labels.get_mut(start) {
            *label = self.last;
        }
        while let Some(at) = open.pop_front() {
            region.push(at);
            for next in self.within(at, 1) {
                if inside(next)
                    && let Some(label) = self.labels.get_mut(next)
                    && *label == 0
                {
                    *label = self.last;
                    open.push_back(next);
                }
            }
        }
        Some(region)
    }

    /// The pixels at most `reach` columns and rows away, itself included.
    fn within(&self, at: usize, reach: usize) -> impl Iterator<Item = usize> + use<> {
        let (u, v) = self.place(at);
        let width = self.width;
        let (right, low) = ((u + reach).min(width - 1), (v + reach).min(self.height - 1));
        (v.saturating_sub(reach)..=low)
            .flat_map(move |v| (u.saturating_sub(reach)..=right).map(move |u| v * width + u))
    }

    /// The pixels of a region and those at most `reach` away from it, each once, in order.
    pub fn around(&self, region: &Region, reach: usize) -> impl Iterator<Item = usize> + use<> {
        let (left, top, right, low) = self.frame_of(region, reach);
        let (width, across) = (self.width, right - left + 1);
        let mut near = vec![false; across * (low - top + 1)];
        for other in region.iter().flat_map(|at| self.within(*at, reach)) {
            let (u, v) = self.place(other);
            if let Some(mark) = near.get_mut((v - top) * across + (u - left)) {
                *mark = true;
            }
        }
        let marked = near.into_iter().enumerate().filter(|(_, mark)| *mark);
        marked.map(move |(at, _)| (top + at / across) * width + left + at % across)
    }

    /// The pixels of the rectangle around a region, `reach` wider on every side.
    pub fn rectangle(&self, region: &Region, reach: usize) -> impl Iterator<Item = usize> + use<> {
        let (left, top, right, low) = self.frame_of(region, reach);
        let width = self.width;
        (top..=low).flat_map(move |v| (left..=right).map(move |u| v * width + u))
    }

    /// First column and row and last column and row of that rectangle.
    fn frame_of(&self, region: &Region, reach: usize) -> (usize, usize, usize, usize) {
        let (mut left, mut top, mut right, mut low) = (self.width, self.height, 0, 0);
        for (u, v) in region.iter().map(|at| self.place(*at)) {
            (left, top) = (left.min(u), top.min(v));
            (right, low) = (right.max(u), low.max(v));
        }
        (
            left.saturating_sub(reach),
            top.saturating_sub(reach),
            (right + reach).min(self.width - 1),
            (low + reach).min(self.height - 1),
        )
    }

    /// Whether a region is so near that its edge still shows.
    pub fn touches_any(&self, at: usize) -> bool {
        self.within(at, 2).any(|near| self.of(near) != 0)
    }

    pub fn touches_border(&self, region: &Region) -> bool {
        region.iter().any(|at| {
            let (u, v) = self.place(*at);
            u == 0 || v == 0 || u + 1 == self.width || v + 1 == self.height
        })
    }
}
