//! Finds all spots of a picture, bright or dark, each to a fraction of a pixel.
//!
//! Without a threshold the picture is smoothed and what stands out of its noise makes regions; each
//! spot is then what lies above half of its own height, so that the area of a spot depends neither on its
//! brightness nor on that of the others. With a threshold, spots are what lies at or above it. The
//! centre comes from a fitted Gaussian where one fits, and else from the centroid of grey values.

use std::collections::VecDeque;

use super::{
    Guess, NoSpot, SMOOTHED_NOISE,
    gauss::{self, Fit},
    noise_sd, picture,
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
        collected(judged.collect())
    }

    /// Spots by what stands out of the noise.
    fn standing_out(&self) -> Spots {
        let smooth = picture::smooth(&self.frame.pixels, self.frame.width);
        let histogram = picture::histogram(&smooth);
        let background = f64::from(picture::median(&histogram));
        let brightest = histogram.iter().rposition(|count| *count > 0).unwrap_or(0) as f64;
        // Rounding the smoothed values adds half a grey value at most, which matters in noiseless pictures.
        let lowest = background + (CONTRAST_SD * self.noise * SMOOTHED_NOISE).max(1.5);
        if brightest < lowest {
            let nothing = NoSpot::Dark {
                brightest,
                threshold: lowest,
                background,
                noise: self.noise,
            };
            return Spots {
                spots: Vec::new(),
                refused: 0,
                nothing: Some(nothing),
            };
        }
        let threshold = lowest.max(background + FAINTEST * (brightest - background));
        let mut coarse = Map::new(self.frame);
        let regions = coarse.regions(|at| {
            smooth
                .get(at)
                .is_some_and(|grey| f64::from(*grey) >= threshold)
        });
        let mut fine = Map::new(self.frame);
        let mut judged = Vec::new();
        let raw = &self.frame.pixels;
        for region in &regions {
            let under = self.background(&coarse, region).unwrap_or(background);
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
                    judged.push((part, under));
                }
            }
        }
        let judged = judged
            .iter()
            .map(|(part, under)| self.judge(&fine, part, *under));
        collected(judged.collect())
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

    /// The spot that a region is, or `None`.
    fn judge(&self, map: &Map, region: &Region, background: f64) -> Option<(usize, FoundSpot)> {
        let area = region.len() as u64;
        let sized = (self.options.min_area..=self.options.max_area).contains(&area);
        if !sized || !self.options.border && map.touches_border(region) {
            return None;
        }
        let shape = Shape::of(map, region);
        if shape.ratio > self.options.max_ratio {
            return None;
        }
        let (u, v) = self
            .fitted(&shape, area)
            .or_else(|| self.centroid(map, region, background))
            .unwrap_or((shape.u, shape.v));
        let first = region.iter().min().copied()?;
        Some((first, FoundSpot { u, v, area }))
    }

    /// The centre of the Gaussian, where one fits.
    fn fitted(&self, shape: &Shape, area: u64) -> Option<(f64, f64)> {
        let sigma = (area as f64 / std::f64::consts::PI).sqrt() / HALF_WIDTH;
        let guess = Guess {
            u: shape.u,
            v: shape.v,
            sigma: sigma.max(0.3),
        };
        let fit: Fit = gauss::fit(self.frame, guess, self.noise).ok()?;
        let allowed = (MISFIT * fit.amplitude).powi(2) + 2.0 * self.noise.powi(2);
        let stayed = (fit.u - shape.u).hypot(fit.v - shape.v) < 1.0 + 0.5 * sigma;
        let fits = stayed && fit.amplitude > 0.0 && fit.residual.powi(2) <= allowed;
        (fits && !fit.window.cut).then_some((fit.u, fit.v))
    }

    /// The centroid of the grey values above the background, over the region and a margin around it.
    fn centroid(&self, map: &Map, region: &Region, background: f64) -> Option<(f64, f64)> {
        let own = region.first().map(|at| map.of(*at))?;
        let (mut sum, mut sum_u, mut sum_v) = (0.0, 0.0, 0.0);
        let others = |at: &usize| map.of(*at) == 0 || map.of(*at) == own;
        for at in map.around(region, MARGIN).filter(others) {
            let weight = f64::from(*self.frame.pixels.get(at)?) - background;
            let (u, v) = map.place(at);
            sum += weight;
            sum_u += weight * u as f64;
            sum_v += weight * v as f64;
        }
        (sum > 0.0).then_some((sum_u / sum, sum_v / sum))
    }
}

/// Orders what was judged by first pixels.
fn collected(judged: Vec<Option<(usize, FoundSpot)>>) -> Spots {
    let all = judged.len();
    let mut spots: Vec<(usize, FoundSpot)> = judged.into_iter().flatten().collect();
    spots.sort_by_key(|(first, _)| *first);
    Spots {
        refused: all - spots.len(),
        spots: spots.into_iter().map(|(_, spot)| spot).collect(),
        nothing: None,
    }
}

/// Where a region lies and how long it is.
struct Shape {
    u: f64,
    v: f64,
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
        let middle = 0.5 * (uu + vv);
        let half = (0.25 * (uu - vv) * (uu - vv) + uv * uv).sqrt();
        // Each pixel is a square and not a point, so that small spots do not look long.
        let (long, short) = (middle + half, (middle - half).max(0.0));
        let ratio = ((long + 1.0 / 12.0) / (short + 1.0 / 12.0)).sqrt();
        Self { u, v, ratio }
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
