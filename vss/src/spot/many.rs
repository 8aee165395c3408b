//! Finds all spots of a picture, bright or dark, each to a fraction of a pixel.
//!
//! Without a threshold the picture is smoothed, a tilt of its background is taken out, and what stands out of its noise
//! makes regions; each spot is then what lies above half of its own height, so that the area of a spot depends neither on
//! its brightness nor on that of the others. With a threshold, spots are what lies at or above it. The centre
//! comes from a fitted Gaussian where one fits, and else from the centroid of grey values. Spots whose light reaches one
//! another are fitted in turns, each on the picture without the others.

use std::collections::VecDeque;

use super::{
    Guess, NoSpot, SMOOTHED_NOISE, SpotFlags,
    gauss::{self, Fit},
    noise_sd,
    picture::{self, Bell, Picture, Tilt},
};
use crate::frame::Frame;

/// Parts of the brightest spot's height below which nothing counts as a spot, unless a threshold is given.
const FAINTEST: f64 = 0.15;
/// Standard deviations of the smoothed noise that a spot must stand out.
const CONTRAST_SD: f64 = 8.0;
/// The centroid is taken over a spot and this much around it, px: half of its edge lies outside.
const MARGIN: usize = 2;
/// The background under a spot is the median over the rectangle around it that is so much wider, px.
const RIM: usize = 5;
/// Half-width at half height of a Gaussian of width 1.
const HALF_WIDTH: f64 = 1.177_410_022_515_474_7;
/// What a fitted Gaussian may leave, as a part of its height.
const MISFIT: f64 = 0.05;
/// Ratio of the axes above which a spot is flagged as elongated.
const ELONGATED: f64 = 1.3;
/// Where the rim of a spot lies, out of which it must stand, px from its edge.
const SURROUNDINGS: (usize, usize) = (2, 3);
/// How often spots that reach one another are fitted in turns: at three widths apart, a turn leaves a tenth of the error.
const TURNS: usize = 4;

/// What counts as a spot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpotsOptions {
    /// Grey value from which (for dark spots: down from which) a pixel belongs to a spot; `None` finds it.
    pub threshold: Option<u8>,
    /// Whether spots are darker than what is around them.
    pub dark: bool,
    /// Fewest pixels of a spot.
    pub min_area: u64,
    /// Most pixels of a spot.
    pub max_area: u64,
    /// Largest ratio of a spot's axes.
    pub max_ratio: f64,
    /// Whether spots that the picture's border cuts count.
    pub border: bool,
}

impl Default for SpotsOptions {
    fn default() -> Self {
        Self {
            threshold: None,
            dark: false,
            min_area: 2,
            max_area: 1_000_000,
            max_ratio: 5.0,
            border: true,
        }
    }
}

/// One of the spots. Pixel centres are at whole numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoundSpot {
    /// Column of the centre, px.
    pub u: f64,
    /// Row of the centre, px.
    pub v: f64,
    /// Number of its pixels.
    pub area: u64,
    /// Width of the Gaussian (its σ), or of the one with the same area at half height, px.
    pub sigma: f64,
    /// Height above the background (dark spots: depth below it), grey values.
    pub amplitude: f64,
    /// Predicted standard deviation of `u`, px.
    pub sd_u: f64,
    /// Predicted standard deviation of `v`, px.
    pub sd_v: f64,
    /// What is doubtful about it.
    pub flags: SpotFlags,
    /// Whether it is a Gaussian; else centre and standard deviations are those of a centroid.
    pub gaussian: bool,
}

/// What a picture holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Spots {
    /// The spots, in the order of their first pixels, row by row.
    pub spots: Vec<FoundSpot>,
    /// Things that stood out and were no spots, for their area, their ratio or the border.
    pub refused: usize,
    /// Why nothing stands out, when nothing does.
    pub nothing: Option<NoSpot>,
}

/// All spots of a picture.
///
/// # Errors
/// [`NoSpot::Empty`] and [`NoSpot::WrongSize`] for what is no picture. A picture without spots is none.
pub fn find_spots(frame: &Frame, options: &SpotsOptions) -> Result<Spots, NoSpot> {
    super::check(frame)?;
    let inverted = options.dark.then(|| Frame {
        pixels: frame.pixels.iter().map(|grey| u8::MAX - grey).collect(),
        ..frame.clone()
    });
    let frame = inverted.as_ref().unwrap_or(frame);
    let search = Search {
        frame,
        options,
        noise: noise_sd(&frame.pixels, frame.width),
    };
    Ok(match options.threshold {
        Some(given) => search.above(if options.dark { u8::MAX - given } else { given }),
        None => search.standing_out(),
    })
}

/// Pixels by index, in the order in which they were reached.
type Region = Vec<usize>;

struct Search<'a> {
    frame: &'a Frame,
    options: &'a SpotsOptions,
    noise: f64,
}

impl Search<'_> {
    /// Spots by a threshold that was given.
    fn above(&self, threshold: u8) -> Spots {
        let raw = &self.frame.pixels;
        let mut map = Map::new(self.frame);
        let regions = map.regions(|at| raw.get(at).is_some_and(|grey| *grey >= threshold));
        let background = f64::from(picture::median(&picture::histogram(raw)));
        let judged = regions.iter().map(|region| {
            let under = self.background(&map, region).unwrap_or(background);
            self.judge(&map, region, under)
        });
        let judged = judged.collect();
        self.fitted(judged)
    }

    /// Spots by what stands out of the noise.
    fn standing_out(&self) -> Spots {
        let raw = &self.frame.pixels;
        let smooth = picture::smooth(raw, self.frame.width);
        let tilt = Tilt::of(raw, self.frame.width);
        let background = f64::from(picture::median(&picture::histogram(&smooth)));
        let place = |at: usize| (at % self.frame.width, at / self.frame.width);
        let level = |at: usize| {
            let (u, v) = place(at);
            if tilt.is_level() {
                background
            } else {
                tilt.at(u, v)
            }
        };
        let height = |at: usize| {
            smooth
                .get(at)
                .map_or(0.0, |grey| f64::from(*grey) - level(at))
        };
        let highest = (0..smooth.len()).map(height).fold(0.0, f64::max);
        // Rounding the smoothed values adds half a grey value at most, which matters in noiseless pictures.
        let least = (CONTRAST_SD * self.noise * SMOOTHED_NOISE).max(1.5);
        if highest < least {
            let nothing = NoSpot::Dark {
                brightest: background + highest,
                threshold: background + least,
                background,
                noise: self.noise,
            };
            return Spots {
                spots: Vec::new(),
                refused: 0,
                nothing: Some(nothing),
            };
        }
        let needed = least.max(FAINTEST * highest);
        let mut coarse = Map::new(self.frame);
        let regions = coarse.regions(|at| at < smooth.len() && height(at) >= needed);
        let mut fine = Map::new(self.frame);
        let mut parts = Vec::new();
        for region in &regions {
            let here = region.first().map_or(background, |at| level(*at));
            let under = self.background(&coarse, region).unwrap_or(here);
            let greys = region.iter().filter_map(|at| raw.get(*at));
            let peak = f64::from(greys.max().copied().unwrap_or_default());
            let half = 0.5 * (under + peak);
            let own = region.first().map(|at| coarse.of(*at));
            let inside = |at: usize| {
                let bright = raw.get(at).is_some_and(|grey| f64::from(*grey) >= half);
                bright && Some(coarse.of(at)) == own
            };
            let mut starts = region.clone();
            starts.sort_unstable();
            for start in starts {
                if let Some(part) = fine.flood(start, inside) {
                    parts.push((part, under));
                }
            }
        }
        let judged = parts.iter().map(|(part, under)| {
            let stands_out = stands_out(&fine, part, &smooth, least);
            stands_out
                .then(|| self.judge(&fine, part, *under))
                .flatten()
        });
        let judged = judged.collect();
        self.fitted(judged)
    }

    /// The median around a region, its neighbours left out; `None` when there is nothing around it.
    fn background(&self, map: &Map, region: &Region) -> Option<f64> {
        let mut greys: Vec<u8> = map
            .rectangle(region, RIM)
            .filter(|at| map.of(*at) == 0 && !map.touches_any(*at))
            .filter_map(|at| self.frame.pixels.get(at).copied())
            .collect();
        greys.sort_unstable();
        greys.get(greys.len() / 2).map(|grey| f64::from(*grey))
    }

    /// The spot that a region is, before it is fitted, or `None`.
    fn judge(&self, map: &Map, region: &Region, background: f64) -> Option<(usize, FoundSpot)> {
        let area = region.len() as u64;
        let sized = (self.options.min_area..=self.options.max_area).contains(&area);
        let touches_border = map.touches_border(region);
        if !sized || !self.options.border && touches_border {
            return None;
        }
        let shape = Shape::of(map, region);
        if shape.ratio > self.options.max_ratio {
            return None;
        }
        let greys = region.iter().filter_map(|at| self.frame.pixels.get(*at));
        let peak = greys.max().copied().unwrap_or_default();
        let centroid = self.centroid(map, region, background);
        let centroid = centroid.unwrap_or(Centroid {
            u: shape.u,
            v: shape.v,
            sd_u: shape.sd_u,
            sd_v: shape.sd_v,
            ratio: shape.ratio,
        });
        let first = region.iter().min().copied()?;
        let width = (area as f64 / std::f64::consts::PI).sqrt() / HALF_WIDTH;
        Some((
            first,
            FoundSpot {
                u: centroid.u,
                v: centroid.v,
                area,
                sigma: width.max(0.3),
                amplitude: (f64::from(peak) - background).max(0.0),
                sd_u: centroid.sd_u,
                sd_v: centroid.sd_v,
                flags: SpotFlags {
                    touches_border,
                    saturated: peak == super::SATURATED,
                    elongated: centroid.ratio > ELONGATED,
                    ..SpotFlags::default()
                },
                gaussian: false,
            },
        ))
    }

    /// The centroid of the grey values above the background, over the region and a margin around it.
    fn centroid(&self, map: &Map, region: &Region, background: f64) -> Option<Centroid> {
        let own = region.first().map(|at| map.of(*at))?;
        let (mut sum, mut sum_u, mut sum_v) = (0.0, 0.0, 0.0);
        let others = |at: &usize| map.of(*at) == 0 || map.of(*at) == own;
        let around: Vec<(f64, f64, f64)> = map
            .around(region, MARGIN)
            .filter(others)
            .filter_map(|at| {
                let weight = f64::from(*self.frame.pixels.get(at)?) - background;
                let (u, v) = map.place(at);
                Some((weight, u as f64, v as f64))
            })
            .collect();
        for (weight, u, v) in &around {
            sum += weight;
            sum_u += weight * u;
            sum_v += weight * v;
        }
        if sum <= 0.0 {
            return None;
        }
        let (u, v) = (sum_u / sum, sum_v / sum);
        let (mut moments, mut lever_u, mut lever_v) = ([0.0; 3], 0.0, 0.0);
        for (weight, column, row) in &around {
            let (du, dv) = (column - u, row - v);
            moments[0] += weight * du * du / sum;
            moments[1] += weight * du * dv / sum;
            moments[2] += weight * dv * dv / sum;
            lever_u += du * du;
            lever_v += dv * dv;
        }
        Some(Centroid {
            u,
            v,
            sd_u: self.noise * lever_u.sqrt() / sum,
            sd_v: self.noise * lever_v.sqrt() / sum,
            ratio: axes_ratio(moments, 0.0),
        })
    }

    /// Fits a Gaussian to each of the spots that were judged to be some, and orders them by first pixels.
    fn fitted(&self, judged: Vec<Option<(usize, FoundSpot)>>) -> Spots {
        let all = judged.len();
        let mut found: Vec<(usize, FoundSpot)> = judged.into_iter().flatten().collect();
        found.sort_by_key(|(first, _)| *first);
        let rough: Vec<FoundSpot> = found.into_iter().map(|(_, spot)| spot).collect();
        let mut bells: Vec<Bell> = rough.iter().map(bell).collect();
        let near: Vec<Vec<usize>> = (0..bells.len())
            .map(|one| neighbours(&bells, one))
            .collect();
        let mut fits: Vec<Option<Fit>> = vec![None; rough.len()];
        for turn in 0..TURNS {
            for (index, (spot, near)) in rough.iter().zip(&near).enumerate() {
                // Without neighbours the first fit is the last.
                if turn > 0 && near.is_empty() {
                    continue;
                }
                let others = near.iter().filter_map(|other| bells.get(*other).copied());
                let picture = Picture::without(self.frame, others.collect());
                let guess = Guess {
                    u: spot.u,
                    v: spot.v,
                    sigma: spot.sigma,
                };
                let fit = gauss::fit(&picture, guess, self.noise).ok();
                let fit = fit.filter(|fit| {
                    let away = (fit.u - spot.u).hypot(fit.v - spot.v);
                    away < 1.0 + 0.5 * spot.sigma
                });
                if let (Some(fit), Some(bell)) = (&fit, bells.get_mut(index)) {
                    *bell = fit.bell();
                }
                if let Some(place) = fits.get_mut(index) {
                    *place = fit;
                }
            }
        }
        let spots = rough.iter().zip(&near).zip(fits).enumerate();
        let spots = spots.map(|(index, ((spot, near), fit))| {
            let mut spot = *spot;
            spot.flags.second = !near.is_empty();
            let fit = fit.filter(|fit| self.fits(fit));
            if let Some(fit) = fit {
                // What two Gaussians share is uncertain in both.
                let widened = near.iter().filter_map(|other| {
                    let (one, other) = (bells.get(index)?, bells.get(*other)?);
                    let apart = (one.u - other.u).powi(2) + (one.v - other.v).powi(2);
                    let width = one.sigma.powi(2) + other.sigma.powi(2);
                    Some(1.0 - (-apart / width).exp())
                });
                let widened = widened.product::<f64>().max(0.01).sqrt();
                spot.flags.touches_border |= fit.window.cut;
                spot.flags.saturated |= fit.saturated > 0;
                spot.flags.structured = fit.structured;
                spot = FoundSpot {
                    u: fit.u,
                    v: fit.v,
                    sigma: fit.sigma,
                    amplitude: fit.amplitude,
                    sd_u: fit.sd_u / widened,
                    sd_v: fit.sd_v / widened,
                    gaussian: true,
                    ..spot
                };
            }
            spot
        });
        let spots: Vec<FoundSpot> = spots.collect();
        Spots {
            refused: all - spots.len(),
            spots,
            nothing: None,
        }
    }

    /// Whether what a fit left is small enough for a Gaussian.
    fn fits(&self, fit: &Fit) -> bool {
        let allowed = (MISFIT * fit.amplitude).powi(2) + 2.0 * self.noise.powi(2);
        fit.residual.powi(2) <= allowed && fit.amplitude >= fit.variation
    }
}

/// A spot as a Gaussian, before it is fitted.
fn bell(spot: &FoundSpot) -> Bell {
    Bell {
        u: spot.u,
        v: spot.v,
        amplitude: spot.amplitude,
        sigma: spot.sigma,
    }
}

/// Those whose light reaches the window of one of them.
fn neighbours(bells: &[Bell], one: usize) -> Vec<usize> {
    let Some(own) = bells.get(one) else {
        return Vec::new();
    };
    let near = |(index, other): (usize, &Bell)| {
        let reach = gauss::REACH * (own.sigma + other.sigma);
        let near = (own.u - other.u).hypot(own.v - other.v) < reach;
        (near && index != one).then_some(index)
    };
    bells.iter().enumerate().filter_map(near).collect()
}

/// Whether a part of the picture is higher than what is around it, and no ripple on a slope.
fn stands_out(map: &Map, part: &Region, smooth: &[u8], least: f64) -> bool {
    let of = |at: usize| smooth.get(at).map_or(0.0, |grey| f64::from(*grey));
    let highest = part.iter().map(|at| of(*at)).fold(0.0, f64::max);
    let (near, far) = SURROUNDINGS;
    let inner: std::collections::HashSet<usize> = map.around(part, near - 1).collect();
    let rim = map.around(part, far).filter(|at| !inner.contains(at));
    let mut greys: Vec<f64> = rim.map(of).collect();
    greys.sort_by(f64::total_cmp);
    greys
        .get(greys.len() / 2)
        .is_none_or(|middle| highest - middle >= least)
}

/// A centre, how well it is known, and how long what it is the centre of is.
struct Centroid {
    u: f64,
    v: f64,
    sd_u: f64,
    sd_v: f64,
    ratio: f64,
}

/// Longer over shorter axis of second moments (uu, uv, vv), each widened by `more`.
fn axes_ratio([uu, uv, vv]: [f64; 3], more: f64) -> f64 {
    let middle = 0.5 * (uu + vv);
    let half = (0.25 * (uu - vv) * (uu - vv) + uv * uv).sqrt();
    // Nothing in a picture of pixels is narrower than they are.
    let axis = |moment: f64| (moment + more).max(1.0 / 12.0);
    (axis(middle + half) / axis(middle - half)).sqrt()
}

/// Where a region lies and how long it is.
struct Shape {
    u: f64,
    v: f64,
    /// Of the centre, when each pixel of its edge is in or out by chance.
    sd_u: f64,
    sd_v: f64,
    ratio: f64,
}

impl Shape {
    fn of(map: &Map, region: &Region) -> Self {
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
struct Map {
    width: usize,
    height: usize,
    /// 0 for none.
    labels: Vec<u32>,
    last: u32,
}

impl Map {
    fn new(frame: &Frame) -> Self {
        Self {
            width: frame.width,
            height: frame.height,
            labels: vec![0; frame.pixels.len()],
            last: 0,
        }
    }

    fn of(&self, at: usize) -> u32 {
        self.labels.get(at).copied().unwrap_or_default()
    }

    fn place(&self, at: usize) -> (usize, usize) {
        (at % self.width, at / self.width)
    }

    /// All 8-connected regions of pixels that are inside, in the order of their first pixels.
    fn regions(&mut self, inside: impl Fn(usize) -> bool) -> Vec<Region> {
        (0..self.labels.len())
            .filter_map(|start| self.flood(start, &inside))
            .collect()
    }

    /// The region around a pixel, when it is inside and in none yet.
    fn flood(&mut self, start: usize, inside: impl Fn(usize) -> bool) -> Option<Region> {
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
    fn around(&self, region: &Region, reach: usize) -> impl Iterator<Item = usize> + use<> {
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
    fn rectangle(&self, region: &Region, reach: usize) -> impl Iterator<Item = usize> + use<> {
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
    fn touches_any(&self, at: usize) -> bool {
        self.within(at, 2).any(|near| self.of(near) != 0)
    }

    fn touches_border(&self, region: &Region) -> bool {
        region.iter().any(|at| {
            let (u, v) = self.place(*at);
            u == 0 || v == 0 || u + 1 == self.width || v + 1 == self.height
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    /// A picture whose grey value at a point is `grey(u, v)`, each pixel the mean over its square.
    fn picture(width: usize, height: usize, noise: f64, grey: impl Fn(f64, f64) -> f64) -> Frame {
        const PARTS: usize = 9;
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let part = |k: usize| (k as f64 + 0.5) / PARTS as f64 - 0.5;
        let pixels = (0..width * height).map(|at| {
            let (u, v) = ((at % width) as f64, (at / width) as f64);
            let mut sum = 0.0;
            for k in 0..PARTS * PARTS {
                sum += grey(u + part(k % PARTS), v + part(k / PARTS));
            }
            let drawn: f64 = rng.sample(StandardNormal);
            (sum / (PARTS * PARTS) as f64 + noise * drawn)
                .round()
                .clamp(0.0, 255.0) as u8
        });
        Frame::grey8(width, height, pixels.collect::<Vec<u8>>())
    }

    fn gaussian(u: f64, v: f64, at: (f64, f64), sigma: f64) -> f64 {
        (-0.5 * ((u - at.0).powi(2) + (v - at.1).powi(2)) / sigma.powi(2)).exp()
    }

    fn found(frame: &Frame, options: &SpotsOptions) -> Vec<FoundSpot> {
        find_spots(frame, options).unwrap().spots
    }

    #[test]
    fn bright_spots_of_different_height_are_found_with_their_area_at_half_height() {
        let places = [
            (20.3, 15.6, 200.0),
            (60.75, 14.2, 60.0),
            (41.5, 44.9, 120.0),
        ];
        let frame = picture(90, 60, 1.0, |u, v| {
            let spots = places.map(|(x, y, height)| height * gaussian(u, v, (x, y), 1.8));
            25.0 + spots.iter().sum::<f64>()
        });
        let mut spots = found(&frame, &SpotsOptions::default());
        assert_eq!(spots.len(), 3);
        spots.sort_by(|a, b| a.u.total_cmp(&b.u));
        for (spot, (u, v, _)) in spots.iter().zip([places[0], places[2], places[1]]) {
            assert!((spot.u - u).hypot(spot.v - v) < 0.05, "{spot:?} {u} {v}");
            let half = std::f64::consts::PI * (HALF_WIDTH * 1.8_f64).powi(2);
            assert!(
                (spot.area as f64 / half - 1.0).abs() < 0.3,
                "{spot:?} {half}"
            );
        }
    }

    #[test]
    fn dark_discs_on_white_are_found_by_the_other_polarity_only() {
        let places = [(14.25, 14.5), (48.6, 20.1), (30.0, 47.4)];
        let frame = picture(64, 64, 1.5, |u, v| {
            let inside = places.iter().any(|(x, y)| (u - x).hypot(v - y) < 6.0);
            if inside { 40.0 } else { 230.0 }
        });
        let dark = SpotsOptions {
            dark: true,
            ..SpotsOptions::default()
        };
        let spots = found(&frame, &dark);
        assert_eq!(spots.len(), 3);
        let area = std::f64::consts::PI * 36.0;
        for (u, v) in places {
            let near = spots
                .iter()
                .find(|spot| (spot.u - u).hypot(spot.v - v) < 0.05);
            assert!(
                (near.unwrap().area as f64 / area - 1.0).abs() < 0.05,
                "{near:?}"
            );
        }
        let given = SpotsOptions {
            threshold: Some(135),
            ..dark
        };
        assert_eq!(found(&frame, &given).len(), 3);
        // Bright, the white around the discs is one thing and no spot.
        let bright = SpotsOptions {
            max_area: 1000,
            ..SpotsOptions::default()
        };
        assert!(found(&frame, &bright).is_empty());
    }

    #[test]
    fn a_tilted_background_makes_no_spots() {
        for (slope, noise) in [(0.3, 0.0), (0.3, 3.0), (-0.4, 2.0), (0.15, 8.0)] {
            let frame = picture(300, 200, noise, |u, v| {
                let lamp = 90.0 * gaussian(u, v, (201.3, 88.7), 2.0);
                90.0 + slope * (u - 150.0) + 0.1 * v + lamp
            });
            let spots = found(&frame, &SpotsOptions::default());
            assert_eq!(spots.len(), 1, "{slope} {noise}: {spots:?}");
            let (du, dv) = (spots[0].u - 201.3, spots[0].v - 88.7);
            assert!(
                du.hypot(dv) < 0.02 + 0.05 * noise / 3.0,
                "{slope} {noise}: {spots:?}"
            );
            assert_eq!(spots[0].flags.sum(), 0, "{slope} {noise}: {spots:?}");
        }
        // Without a lamp, there is nothing.
        let frame = picture(300, 200, 3.0, |u, v| 60.0 + 0.3 * u + 0.1 * v);
        assert!(found(&frame, &SpotsOptions::default()).is_empty());
    }

    #[test]
    fn spots_that_touch_are_parted_or_flagged() {
        let noise_free = |apart: f64| {
            let frame = picture(60, 50, 0.0, |u, v| {
                let one = gaussian(u, v, (25.3, 24.6), 2.0);
                let other = gaussian(u, v, (25.3 + 0.8 * apart, 24.6 + 0.6 * apart), 2.0);
                30.0 + 120.0 * one + 100.0 * other
            });
            found(&frame, &SpotsOptions::default())
        };
        for apart in [8.0, 10.0, 13.0] {
            let spots = noise_free(apart);
            assert_eq!(spots.len(), 2, "{apart}: {spots:?}");
            let places = [(25.3, 24.6), (25.3 + 0.8 * apart, 24.6 + 0.6 * apart)];
            for (spot, (u, v)) in spots.iter().zip(places) {
                let off = (spot.u - u).hypot(spot.v - v);
                assert!(off < 0.02 && spot.flags.second, "{apart}: {off} {spot:?}");
            }
        }
        for apart in [4.0, 6.5] {
            let merged = noise_free(apart);
            assert_eq!(merged.len(), 1);
            assert!(merged[0].flags.elongated, "{merged:?}");
        }
        assert!(!noise_free(20.0)[0].flags.second);
    }

    #[test]
    fn spots_are_answered_with_width_height_and_flags() {
        let places = [
            (20.3, 20.6, 1.5, 100.0, 0),
            (60.2, 1.3, 1.5, 100.0, 1),
            (100.4, 20.7, 2.0, 400.0, 2),
        ];
        let frame = picture(130, 90, 1.0, |u, v| {
            let spots =
                places.map(|(x, y, sigma, height, _)| height * gaussian(u, v, (x, y), sigma));
            let long = 100.0
                * (-0.5 * ((u - 80.4) / 4.0).powi(2) - 0.5 * ((v - 70.2) / 1.6).powi(2)).exp();
            30.0 + spots.iter().sum::<f64>() + long
        });
        let spots = found(&frame, &SpotsOptions::default());
        assert_eq!(spots.len(), 4, "{spots:?}");
        for (u, v, sigma, height, flags) in places {
            let near = spots
                .iter()
                .find(|spot| (spot.u - u).hypot(spot.v - v) < 0.5);
            let spot = near.unwrap();
            assert_eq!(spot.flags.sum(), flags, "{spot:?}");
            assert!(
                spot.gaussian && (spot.sigma / sigma - 1.0).abs() < 0.1,
                "{spot:?}"
            );
            assert!((spot.amplitude / height - 1.0).abs() < 0.15, "{spot:?}");
            let off = (spot.u - u).hypot(spot.v - v);
            assert!(off < 5.0 * spot.sd_u.hypot(spot.sd_v), "{off} {spot:?}");
        }
        let long = spots
            .iter()
            .find(|spot| (spot.u - 80.4).abs() < 1.0)
            .unwrap();
        assert!(
            long.flags.elongated && !long.flags.touches_border,
            "{long:?}"
        );
        assert!((long.u - 80.4).hypot(long.v - 70.2) < 0.1, "{long:?}");
    }

    #[test]
    fn options_say_what_counts() {
        let frame = picture(80, 40, 0.0, |u, v| {
            let small = (u - 10.0).hypot(v - 20.0) < 2.0;
            let large = (u - 35.0).hypot(v - 20.0) < 8.0;
            let long = (u - 60.0).abs() < 1.5 && (v - 20.0).abs() < 15.0;
            let cut = (u - 79.0).hypot(v - 5.0) < 4.0;
            if small || large || long || cut {
                200.0
            } else {
                10.0
            }
        });
        let count = |change: &dyn Fn(&mut SpotsOptions)| {
            let mut options = SpotsOptions::default();
            change(&mut options);
            let spots = find_spots(&frame, &options).unwrap();
            (spots.spots.len(), spots.refused)
        };
        assert_eq!(count(&|_| {}), (3, 1), "the bar is too long");
        assert_eq!(count(&|o| o.max_ratio = 20.0), (4, 0));
        assert_eq!(count(&|o| o.min_area = 20), (2, 2));
        assert_eq!(count(&|o| o.max_area = 100), (2, 2));
        assert_eq!(count(&|o| o.border = false), (2, 2));
        assert_eq!(count(&|o| o.threshold = Some(201)), (0, 0));
        assert_eq!(
            count(&|o| o.threshold = Some(0)),
            (1, 0),
            "all of the picture"
        );
    }

    #[test]
    fn a_picture_with_nothing_in_it_says_why_and_no_picture_is_an_error() {
        let spots = find_spots(&picture(50, 40, 2.0, |_, _| 30.0), &SpotsOptions::default());
        let spots = spots.unwrap();
        assert!(spots.spots.is_empty());
        assert!(matches!(spots.nothing, Some(NoSpot::Dark { .. })));
        let mut wrong = picture(5, 5, 0.0, |_, _| 0.0);
        wrong.width = 0;
        assert!(matches!(
            find_spots(&wrong, &SpotsOptions::default()),
            Err(NoSpot::Empty { .. })
        ));
        wrong.width = 7;
        assert!(matches!(
            find_spots(&wrong, &SpotsOptions::default()),
            Err(NoSpot::WrongSize { .. })
        ));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn a_centre_is_right_wherever_it_lies_between_pixels(
            du in -0.5..0.5_f64, dv in -0.5..0.5_f64, size in 1.0..4.0_f64, disc in any::<bool>(), dark in any::<bool>(),
        ) {
            let at = (20.0 + du, 18.0 + dv);
            let frame = picture(40, 38, 0.0, |u, v| {
                let height = if !disc {
                    gaussian(u, v, at, size)
                } else if (u - at.0).hypot(v - at.1) < 2.0 * size {
                    1.0
                } else {
                    0.0
                };
                if dark { 220.0 - 180.0 * height } else { 30.0 + 180.0 * height }
            });
            let spots = found(&frame, &SpotsOptions { dark, ..SpotsOptions::default() });
            prop_assert_eq!(spots.len(), 1);
            let off = (spots[0].u - at.0).hypot(spots[0].v - at.1);
            prop_assert!(off < 0.03, "{off} {:?}", spots);
        }

        #[test]
        fn no_picture_panics(
            width in 1..12_usize, height in 1..12_usize, seed in any::<u64>(), dark in any::<bool>(),
            threshold in prop::option::of(any::<u8>()),
        ) {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let pixels: Vec<u8> = (0..width * height).map(|_| rng.random()).collect();
            let frame = Frame::grey8(width, height, pixels);
            let options = SpotsOptions { threshold, dark, ..SpotsOptions::default() };
            for spot in found(&frame, &options) {
                prop_assert!(spot.u.is_finite() && spot.v.is_finite() && spot.area > 0);
            }
        }
    }
}
