//! Finds the one bright spot of a picture, to a fraction of a pixel, or says why there is none; [`find_spots`]
//! finds all of them.
//!
//! The picture is smoothed (5x5 binomial) and its noise measured; thresholds go down from near the brightest
//! value to the noise, and the brightest component that is small, compact and fits a Gaussian is the
//! spot. So something large and bright (a lit wall) does not hide a lamp, and is not taken for one.
//! The centre then comes from a least-squares fit of a Gaussian to the picture as taken, which reaches the
//! bound that the noise sets: a standard deviation of sqrt(2/π) noise/amplitude per coordinate for a
//! well-sampled spot, whatever its width. What stands behind the spot is part of the fit: a constant, a plane or the
//! edge of something else. This module knows pictures and no tasks.

mod gauss;
mod many;
mod picture;

use serde::{Deserialize, Serialize};

use crate::{
    components::{Component, components},
    frame::Frame,
};
use gauss::{Fit, Guess};
pub use many::{FoundSpot, Spots, SpotsOptions, find_spots};
use picture::Picture;
pub use picture::noise_sd;

/// Thresholds that are tried, as parts of the way from the background to the brightest value.
const LEVELS: [f64; 7] = [0.7, 0.5, 0.35, 0.25, 0.17, 0.12, 0.08];
/// Components that are looked at per threshold, brightest first.
const CANDIDATES: usize = 8;
/// What the 5x5 binomial filter leaves of white noise: 70/256.
const SMOOTHED_NOISE: f64 = 70.0 / 256.0;
/// Grey value from which a pixel counts as saturated.
const SATURATED: u8 = 255;

/// What counts as a spot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpotOptions {
    /// Smallest width of the Gaussian (its σ), px.
    pub min_sigma_px: f64,
    /// Largest width of the Gaussian (its σ), px.
    pub max_sigma_px: f64,
    /// How far the smoothed spot must stand out of the background, in standard deviations of the smoothed noise.
    pub min_contrast_sd: f64,
    /// Ratio of the axes above which a spot is flagged as elongated.
    pub elongated_ratio: f64,
    /// Ratio of the axes above which something is no spot.
    pub max_ratio: f64,
    /// Largest predicted standard deviation per coordinate that still counts as a measurement, px.
    pub max_sd_px: f64,
}

impl Default for SpotOptions {
    fn default() -> Self {
        Self {
            min_sigma_px: 0.3,
            max_sigma_px: 8.0,
            min_contrast_sd: 8.0,
            elongated_ratio: 1.5,
            max_ratio: 3.0,
            max_sd_px: 1.0,
        }
    }
}

/// A spot. Pixel centres are at whole numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spot {
    /// Column of the centre, px.
    pub u: f64,
    /// Row of the centre, px.
    pub v: f64,
    /// Predicted standard deviation of `u`, px.
    pub sd_u: f64,
    /// Predicted standard deviation of `v`, px.
    pub sd_v: f64,
    /// Number of pixels above the threshold that found it.
    pub area: u64,
    /// Height of the Gaussian above the background, grey values.
    pub amplitude: f64,
    /// Width of the Gaussian (its σ), px.
    pub sigma: f64,
    /// Background under the spot, grey values.
    pub background: f64,
    /// Standard deviation of the noise at the spot, grey values.
    pub noise: f64,
    /// What is doubtful about it.
    pub flags: SpotFlags,
}

/// What is doubtful about a spot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct SpotFlags {
    /// Its window is cut by the picture's border.
    pub touches_border: bool,
    /// It has saturated pixels; they were left out of the fit.
    pub saturated: bool,
    /// It is not round: motion, or two spots, or partly covered.
    pub elongated: bool,
    /// Another spot is so near that its light reaches this one's window.
    pub second: bool,
    /// The edge of something else lies behind it; the standard deviations hold what that leaves open.
    pub structured: bool,
}

impl SpotFlags {
    /// As a sum: 1 cut by the border, 2 saturated, 4 elongated, 8 a second spot near, 16 an edge behind it.
    #[must_use]
    pub fn sum(&self) -> i64 {
        let flags = [
            self.touches_border,
            self.saturated,
            self.elongated,
            self.second,
            self.structured,
        ];
        let values = flags.iter().zip([1, 2, 4, 8, 16]);
        values
            .filter(|(set, _)| **set)
            .map(|(_, value)| value)
            .sum()
    }
}

/// Why there is no spot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum NoSpot {
    /// The picture has no pixels.
    #[error("the picture is empty ({width} x {height})")]
    Empty {
        /// Its width, px.
        width: usize,
        /// Its height, px.
        height: usize,
    },
    /// The picture's parts contradict each other.
    #[error("the picture says {width} x {height} and has {pixels} pixels")]
    WrongSize {
        /// Its width, px.
        width: usize,
        /// Its height, px.
        height: usize,
        /// The pixels it has.
        pixels: usize,
    },
    /// So many that the options must be wrong.
    #[error("{0} spots, more than the {1} that are fitted")]
    TooMany(usize, usize),
    /// Nothing stands out.
    #[error(
        "nothing stands out: brightest {brightest:.0}, needed {threshold:.1} \
         (background {background:.0}, noise {noise:.1}); is the lamp on and in view?"
    )]
    Dark {
        /// The brightest value of the smoothed picture, grey values.
        brightest: f64,
        /// What it would have had to be.
        threshold: f64,
        /// Median of the smoothed picture.
        background: f64,
        /// Standard deviation of the picture's noise.
        noise: f64,
    },
    /// Something stands out, and nothing of it is a spot.
    #[error(
        "{candidates} bright things (brightest {brightest:.0}, threshold down to {threshold:.1}) \
         and none is a spot; the brightest {reason}"
    )]
    NotASpot {
        /// How many components were looked at.
        candidates: usize,
        /// The brightest value of the smoothed picture, grey values.
        brightest: f64,
        /// The lowest threshold tried, grey values.
        threshold: f64,
        /// Why the brightest is none.
        reason: NotASpot,
    },
}

/// Why a bright thing is no spot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum NotASpot {
    /// Too many pixels.
    #[error("covers {area} px, more than {limit}")]
    TooLarge {
        /// Its pixels.
        area: u64,
        /// The most a spot may have.
        limit: u64,
    },
    /// Not compact.
    #[error("is {ratio:.1} times as long as wide, more than {limit:.1}")]
    TooLong {
        /// Ratio of its axes.
        ratio: f64,
        /// The largest for a spot.
        limit: f64,
    },
    /// No Gaussian fits.
    #[error("does not look like a spot: {0}")]
    BadFit(String),
}

/// The brightest spot of a picture.
///
/// # Errors
/// [`NoSpot`] with the numbers that speak against one; never panics, whatever the picture.
pub fn find_spot(frame: &Frame, options: &SpotOptions) -> Result<Spot, NoSpot> {
    check(frame)?;
    let width = frame.width;
    let smooth = picture::smooth(&frame.pixels, width);
    let noise = noise_sd(&frame.pixels, width);
    let histogram = picture::histogram(&smooth);
    let background = f64::from(picture::median(&histogram));
    let brightest = histogram.iter().rposition(|count| *count > 0).unwrap_or(0) as f64;
    // Rounding the smoothed values adds half a grey value at most, which matters in noiseless pictures.
    let lowest = background + (options.min_contrast_sd * noise * SMOOTHED_NOISE).max(1.5);
    if brightest < lowest {
        return Err(NoSpot::Dark {
            brightest,
            threshold: lowest,
            background,
            noise,
        });
    }
    let search = Search {
        frame,
        smooth: &smooth,
        background,
        noise,
        options,
    };
    search.run(brightest, lowest)
}

/// Whether a frame is a picture at all.
fn check(frame: &Frame) -> Result<(), NoSpot> {
    let (width, height, pixels) = (frame.width, frame.height, frame.pixels.len());
    if width == 0 || height == 0 {
        return Err(NoSpot::Empty { width, height });
    }
    if width.checked_mul(height) != Some(pixels) {
        return Err(NoSpot::WrongSize {
            width,
            height,
            pixels,
        });
    }
    Ok(())
}

struct Search<'a> {
    frame: &'a Frame,
    smooth: &'a [u8],
    background: f64,
    noise: f64,
    options: &'a SpotOptions,
}

impl Search<'_> {
    fn run(&self, brightest: f64, lowest: f64) -> Result<Spot, NoSpot> {
        let mut first_reason = None;
        let (mut candidates, mut tried) = (0, f64::INFINITY);
        for level in LEVELS {
            let threshold = (self.background + level * (brightest - self.background))
                .max(lowest)
                .ceil();
            // Once the noise stops the descent, further levels are the same.
            if threshold >= tried {
                break;
            }
            tried = threshold;
            let mut found = components(self.smooth, self.frame.width, threshold as u8);
            found.sort_by_key(|component| std::cmp::Reverse(component.peak));
            for component in found.iter().take(CANDIDATES) {
                candidates += 1;
                match self.examine(component, threshold) {
                    Ok(mut spot) => {
                        let reach = 2.0 * gauss::REACH * spot.sigma;
                        spot.flags.second = found.iter().any(|other| {
                            let (u, v) = other.centroid();
                            other.first != component.first && (u - spot.u).hypot(v - spot.v) < reach
                        });
                        return Ok(spot);
                    }
                    Err(reason) => first_reason = first_reason.or(Some(reason)),
                }
            }
        }
        Err(match first_reason {
            Some(reason) => NoSpot::NotASpot {
                candidates,
                brightest,
                threshold: tried,
                reason,
            },
            None => NoSpot::Dark {
                brightest,
                threshold: lowest,
                background: self.background,
                noise: self.noise,
            },
        })
    }

    fn examine(&self, component: &Component, threshold: f64) -> Result<Spot, NotASpot> {
        // A Gaussian of the largest width is above a tenth of its height over 2π σ² ln 10 pixels.
        let widest = self.options.max_sigma_px.powi(2) + 1.0;
        let limit = (std::f64::consts::TAU * widest * 10_f64.ln()).ceil() as u64;
        if component.area > limit {
            return Err(NotASpot::TooLarge {
                area: component.area,
                limit,
            });
        }
        let ratio = axis_ratio(component);
        if ratio > self.options.max_ratio {
            return Err(NotASpot::TooLong {
                ratio,
                limit: self.options.max_ratio,
            });
        }
        let guess = self.guess(component, threshold);
        let picture = Picture::of(self.frame);
        let fit = gauss::fit(&picture, guess, self.noise).map_err(NotASpot::BadFit)?;
        self.judge(&fit, component).map_err(NotASpot::BadFit)?;
        Ok(Spot {
            u: fit.u,
            v: fit.v,
            sd_u: fit.sd_u,
            sd_v: fit.sd_v,
            area: component.area,
            amplitude: fit.amplitude,
            sigma: fit.sigma,
            background: fit.background,
            noise: fit.noise,
            flags: SpotFlags {
                touches_border: fit.window.cut,
                saturated: fit.saturated > 0,
                elongated: ratio > self.options.elongated_ratio,
                second: false,
                structured: fit.structured,
            },
        })
    }

    /// Where the fit starts: the component's centroid, and the width of the Gaussian that is above the threshold
    /// over the component's area, standing on the background around the component.
    fn guess(&self, component: &Component, threshold: f64) -> Guess {
        let (u, v) = component.centroid();
        let peak = f64::from(component.peak);
        let local = self.rim_median(component).min(threshold - 1.0);
        let fraction = ((threshold - 0.5 - local) / (peak + 0.5 - local)).clamp(0.02, 0.95);
        let smoothed = component.area as f64 / (std::f64::consts::TAU * (1.0 / fraction).ln());
        // The filter added a variance of 1 px².
        let sigma = (smoothed - 1.0).max(0.25).sqrt();
        Guess {
            u,
            v,
            sigma: sigma.clamp(self.options.min_sigma_px, self.options.max_sigma_px),
        }
    }

    /// The median of the smoothed picture on a rectangle around the component, at about its own size from it.
    fn rim_median(&self, component: &Component) -> f64 {
        let c = component;
        let margin = 3 + (c.u_max - c.u_min).max(c.v_max - c.v_min) / 2;
        let (right, low) = (self.frame.width - 1, self.frame.height - 1);
        let (u0, u1) = (
            c.u_min.saturating_sub(margin),
            (c.u_max + margin).min(right),
        );
        let (v0, v1) = (c.v_min.saturating_sub(margin), (c.v_max + margin).min(low));
        let across = (u0..=u1).flat_map(|u| [(u, v0), (u, v1)]);
        let down = (v0..=v1).flat_map(|v| [(u0, v), (u1, v)]);
        let mut rim: Vec<u8> = across
            .chain(down)
            .filter_map(|(u, v)| self.smooth.get(v * self.frame.width + u).copied())
            .collect();
        rim.sort_unstable();
        rim.get(rim.len() / 2)
            .map_or(self.background, |grey| f64::from(*grey))
    }

    fn judge(&self, fit: &Fit, component: &Component) -> Result<(), String> {
        let options = self.options;
        if fit.sigma < options.min_sigma_px || fit.sigma > options.max_sigma_px {
            return Err(format!(
                "its width is {:.2} px, not within {} to {}",
                fit.sigma, options.min_sigma_px, options.max_sigma_px
            ));
        }
        let (u, v) = component.centroid();
        if (fit.u - u).hypot(fit.v - v) > 2.0 + 1.5 * fit.sigma {
            return Err("the fit ran away from it".to_owned());
        }
        let contrast = fit.amplitude * fit.sigma.powi(2) / (fit.sigma.powi(2) + 1.0);
        let needed = options.min_contrast_sd * self.noise * SMOOTHED_NOISE;
        if contrast < needed.max(1.0) {
            return Err(format!(
                "it stands out by {contrast:.1} only, needed {needed:.1}"
            ));
        }
        // On a background of its own, a Gaussian fits the end of an arm well enough, too.
        if fit.amplitude < fit.variation {
            return Err(format!(
                "what is behind it changes by {:.1} grey values, and it stands out by {:.1}",
                fit.variation, fit.amplitude
            ));
        }
        if fit.structured && fit.window.cut {
            return Err(
                "before an edge, and cut by the border, it may be what an edge leaves".to_owned(),
            );
        }
        if fit.sd_u.max(fit.sd_v) > options.max_sd_px {
            return Err(format!(
                "its centre would be uncertain by {:.2} px, more than {}",
                fit.sd_u.max(fit.sd_v),
                options.max_sd_px
            ));
        }
        // What is left beyond the noise: a lamp's picture is a little flatter than a Gaussian; a corner or an end
        // of something else is not like one at all. The noise's own estimate scatters by sqrt(2/n) of its square.
        let scatter = 4.0 * (2.0 / fit.degrees_of_freedom).sqrt() * self.noise.powi(2);
        let allowed = (0.1 * fit.amplitude).powi(2) + scatter + self.noise.powi(2);
        if fit.residual.powi(2) > allowed {
            return Err(format!(
                "a Gaussian leaves {:.1} grey values, more than {:.1}",
                fit.residual,
                allowed.sqrt()
            ));
        }
        Ok(())
    }
}

/// Longer over shorter axis of the component, each pixel taken as a square and not a point, so that small
/// components do not look long.
fn axis_ratio(component: &Component) -> f64 {
    let (long, short) = component.moments().eigenvalues();
    ((long + 1.0 / 12.0) / (short + 1.0 / 12.0)).sqrt()
}

#[cfg(test)]
mod tests;
