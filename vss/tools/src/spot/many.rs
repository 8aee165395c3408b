//! Finds all spots of a picture, bright or dark, each to a fraction of a pixel.
//!
//! Without a threshold the picture is smoothed, a tilt of its background is taken out, and what stands out of its noise
//! makes regions; each spot is then what lies above half of its own height, so that the area of a spot depends neither on
//! its brightness nor on that of the others. With a threshold, spots are what lies at or above it. The centre
//! comes from a fitted Gaussian where one fits, and else from the centroid of grey values. Spots whose light reaches one
//! another are fitted in turns, each on the picture without the others.

mod regions;

use super::{
    Guess, NoSpot, SMOOTHED_NOISE, SpotFlags,
    gauss::{self, Fit},
    noise_sd,
    picture::{self, Bell, Picture, Tilt},
};
use crate::frame::Frame;
use regions::{Map, Region, Shape, axes_ratio};

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
    /// Most spots: the time of their fits grows with the square of their number.
    pub most: usize,
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
            most: 10_000,
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
    match options.threshold {
        Some(given) => search.above(if options.dark { u8::MAX - given } else { given }),
        None => search.standing_out(),
    }
}

struct Search<'a> {
    frame: &'a Frame,
    options: &'a SpotsOptions,
    noise: f64,
}

impl Search<'_> {
    /// Spots by a threshold that was given.
    fn above(&self, threshold: u8) -> Result<Spots, NoSpot> {
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
    fn standing_out(&self) -> Result<Spots, NoSpot> {
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
            return Ok(Spots {
                spots: Vec::new(),
                refused: 0,
                nothing: Some(nothing),
            });
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
                    // What the border cuts is short or long by that.
                    elongated: !touches_border && centroid.ratio > ELONGATED,
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
    fn fitted(&self, judged: Vec<Option<(usize, FoundSpot)>>) -> Result<Spots, NoSpot> {
        let all = judged.len();
        let mut found: Vec<(usize, FoundSpot)> = judged.into_iter().flatten().collect();
        if found.len() > self.options.most {
            return Err(NoSpot::TooMany(found.len(), self.options.most));
        }
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
        Ok(Spots {
            refused: all - spots.len(),
            spots,
            nothing: None,
        })
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

#[cfg(test)]
mod tests;
