//! Whole-picture steps before a spot is looked for: smoothing, noise, histogram, tilt. And a picture as a fit reads it.

use super::SATURATED;
use crate::frame::Frame;

/// Side of the tiles whose medians show a tilted background, px.
const TILE: usize = 16;
/// What a tilted background changes by over the picture, at least, grey values.
const LEAST_TILT: f64 = 4.0;

/// A round Gaussian.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bell {
    pub u: f64,
    pub v: f64,
    /// Above the background, grey values.
    pub amplitude: f64,
    pub sigma: f64,
}

impl Bell {
    /// Its mean over a pixel, grey values.
    fn at(&self, u: usize, v: usize) -> f64 {
        let mean = |pixel: usize, centre: f64| {
            let along = super::gauss::axis((pixel, pixel + 1), centre, self.sigma);
            along.first().map_or(0.0, |[mean, ..]| *mean)
        };
        self.amplitude * mean(u, self.u) * mean(v, self.v)
    }
}

/// A picture without the spots that are known already.
pub(super) struct Picture<'a> {
    frame: &'a Frame,
    /// The other spots.
    others: Vec<Bell>,
}

impl<'a> Picture<'a> {
    /// The picture as it is.
    pub(super) fn of(frame: &'a Frame) -> Self {
        Self::without(frame, Vec::new())
    }

    /// The picture less these spots.
    pub(super) fn without(frame: &'a Frame, others: Vec<Bell>) -> Self {
        Self { frame, others }
    }

    pub(super) fn width(&self) -> usize {
        self.frame.width
    }

    pub(super) fn height(&self) -> usize {
        self.frame.height
    }

    /// The grey value of a pixel; `None` where it is saturated.
    pub(super) fn value(&self, u: usize, v: usize) -> Option<f64> {
        let grey = self.frame.get(u, v).filter(|grey| *grey < SATURATED)?;
        let others: f64 = self.others.iter().map(|bell| bell.at(u, v)).sum();
        Some(f64::from(grey) - others)
    }
}

/// A background that rises evenly: its grey value at the first pixel, and its slopes along u and v per px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tilt {
    pub start: f64,
    pub along_u: f64,
    pub along_v: f64,
}

impl Tilt {
    /// The tilt that most of the picture agrees on, whatever stands in the rest: medians of the slopes between tiles that are
    /// an eighth of the picture apart (after H. Theil and P. Sen). A tilt that changes little over the picture is none.
    pub(super) fn of(pixels: &[u8], width: usize) -> Self {
        let columns = width.div_ceil(TILE).max(1);
        let rows: Vec<&[u8]> = pixels.chunks_exact(width.max(1)).collect();
        let mut tiles = Vec::new();
        for band in rows.chunks(TILE) {
            for column in 0..columns {
                let span = column * TILE..((column + 1) * TILE).min(width);
                let greys = band
                    .iter()
                    .filter_map(|row| row.get(span.clone()))
                    .flatten();
                let (count, sum) = greys.fold((0_u32, 0.0), |(count, sum), grey| {
                    (count + 1, sum + f64::from(*grey))
                });
                tiles.push(sum / f64::from(count.max(1)));
            }
        }
        let bands = tiles.len() / columns;
        let at = |column: usize, band: usize| tiles.get(band * columns + column).copied();
        let slope = |right: usize, down: usize| {
            let mut slopes = Vec::new();
            for band in 0..bands.saturating_sub(down) {
                for column in 0..columns.saturating_sub(right) {
                    if let (Some(a), Some(b)) = (at(column, band), at(column + right, band + down))
                    {
                        slopes.push((b - a) / ((right + down) * TILE) as f64);
                    }
                }
            }
            middle(slopes)
        };
        let steep = |slope: f64, length: usize| {
            if (slope * length as f64).abs() < LEAST_TILT {
                0.0
            } else {
                slope
            }
        };
        let along_u = steep(slope((columns / 8).max(1), 0), width);
        let along_v = steep(slope(0, (bands / 8).max(1)), rows.len());
        let greys = rows.iter().enumerate().step_by(3).flat_map(|(v, row)| {
            let row = row.iter().enumerate().step_by(3);
            row.map(move |(u, grey)| f64::from(*grey) - along_u * u as f64 - along_v * v as f64)
        });
        Self {
            start: middle(greys.collect()),
            along_u,
            along_v,
        }
    }

    pub(super) fn is_level(&self) -> bool {
        self.along_u == 0.0 && self.along_v == 0.0
    }

    /// Its grey value at a pixel.
    pub(super) fn at(&self, u: usize, v: usize) -> f64 {
        self.start + self.along_u * u as f64 + self.along_v * v as f64
    }
}

/// The median; 0 of nothing.
fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// The picture convolved with the 5x5 binomial filter (1 4 6 4 1)/16 in both directions; the border is continued.
/// `pixels` holds whole rows of `width` (not 0).
pub(super) fn smooth(pixels: &[u8], width: usize) -> Vec<u8> {
    let rows: Vec<&[u8]> = pixels.chunks_exact(width).collect();
    let Some(last) = rows.len().checked_sub(1) else {
        return Vec::new();
    };
    let mut padded = vec![0_u16; width + 4];
    let mut result = Vec::with_capacity(pixels.len());
    for v in 0..rows.len() {
        let row = |offset: usize| rows[(v + offset).saturating_sub(2).min(last)];
        // Columns first: at most 16 * 255.
        let five = row(0)
            .iter()
            .zip(row(1))
            .zip(row(2))
            .zip(row(3))
            .zip(row(4));
        for (sum, ((((a, b), c), d), e)) in padded.iter_mut().skip(2).zip(five) {
            let [a, b, c, d, e] = [a, b, c, d, e].map(|value| u16::from(*value));
            *sum = a + e + 4 * (b + d) + 6 * c;
        }
        padded[0] = padded[2];
        padded[1] = padded[2];
        padded[width + 2] = padded[width + 1];
        padded[width + 3] = padded[width + 1];
        // Then along the row: at most 256 * 255 + 128, which still fits 16 bits.
        result.extend(padded.windows(5).map(|w| {
            let sum = w[0] + w[4] + 4 * (w[1] + w[3]) + 6 * w[2];
            ((sum + 128) >> 8) as u8
        }));
    }
    result
}

/// How often each grey value occurs.
pub(super) fn histogram(pixels: &[u8]) -> [u32; 256] {
    let mut counts = [0; 256];
    for value in pixels {
        counts[usize::from(*value)] += 1;
    }
    counts
}

/// The median grey value; 0 without pixels.
pub(super) fn median(histogram: &[u32; 256]) -> u8 {
    let total: u64 = histogram.iter().map(|count| u64::from(*count)).sum();
    let mut below = 0;
    for (value, count) in (0..=u8::MAX).zip(histogram) {
        below += u64::from(*count);
        if 2 * below >= total {
            return value;
        }
    }
    u8::MAX
}

/// Standard deviation of the picture's noise, grey values, at least that of rounding to whole numbers.
///
/// From the median absolute value of second differences along the rows (a - 2 b + c, whose variance is six
/// times the noise's): smooth shading drops out, and edges and spots are too few to move a median.
/// `width` is that of a row; fewer than 3 columns carry no second difference.
#[must_use]
pub fn noise_sd(pixels: &[u8], width: usize) -> f64 {
    let rounding = (1.0_f64 / 12.0).sqrt();
    let mut counts = [0_u32; 1024];
    if width >= 3 {
        // Every second row is plenty, and takes half the time.
        for row in pixels.chunks_exact(width).step_by(2) {
            for w in row.windows(3) {
                let d = i32::from(w[0]) - 2 * i32::from(w[1]) + i32::from(w[2]);
                counts[d.unsigned_abs() as usize] += 1;
            }
        }
    }
    let sd = median_absolute(&counts) / 0.674_489_75 / 6_f64.sqrt();
    sd.max(rounding)
}

/// The median of |d| where `counts[k]` of the d were rounded to ±k: value 0 stands for |d| < ½, k for k ± ½.
fn median_absolute(counts: &[u32]) -> f64 {
    let total: u64 = counts.iter().map(|count| u64::from(*count)).sum();
    let half = total as f64 / 2.0;
    let mut below = 0.0;
    for (value, count) in counts.iter().enumerate() {
        let count = f64::from(*count);
        if count > 0.0 && below + count >= half {
            let (low, span) = if value == 0 {
                (0.0, 0.5)
            } else {
                (value as f64 - 0.5, 1.0)
            };
            return low + span * (half - below) / count;
        }
        below += count;
    }
    0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn smoothing_keeps_constants_and_spreads_a_point_binomially() {
        assert_eq!(smooth(&[7; 12], 4), vec![7; 12]);
        assert_eq!(smooth(&[255; 1], 1), vec![255]);
        let mut point = vec![0; 81];
        point[40] = 128;
        let result = smooth(&point, 9);
        assert_eq!(result[40], 18); // 128 * 36 / 256
        assert_eq!(result[41], 12); // 128 * 24 / 256
        assert_eq!(result[42], 3); // 128 * 6 / 256
        assert_eq!(result[43], 0);
    }

    #[test]
    fn the_noise_is_measured_under_shading_and_edges() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for sd in [1.0, 4.0, 11.0] {
            let normal = Normal::new(0.0, sd).unwrap();
            let pixels: Vec<u8> = (0..200 * 200)
                .map(|i| {
                    let (u, v) = (i % 200, i / 200);
                    let shade =
                        60.0 + 0.2 * f64::from(u) + if v > 120 && u > 70 { 50.0 } else { 0.0 };
                    (shade + normal.sample(&mut rng)).round() as u8
                })
                .collect();
            let found = noise_sd(&pixels, 200);
            let expected = (sd * sd + 1.0 / 12.0_f64).sqrt();
            assert!(
                (found / expected - 1.0).abs() < 0.05,
                "{found} for {expected}"
            );
        }
    }

    #[test]
    fn tiny_pictures_have_the_noise_of_rounding() {
        assert!((noise_sd(&[], 0) - 0.2887).abs() < 1e-3);
        assert!((noise_sd(&[1, 255], 2) - 0.2887).abs() < 1e-3);
    }
}
