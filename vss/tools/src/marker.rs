//! Round markers: components that are what they should be, each with its middle weighted by how far its light is from
//! that around it, and the standard deviation of that. Knows a picture and a mask of it, no task.

use nalgebra::Vector2;

use crate::components::{Component, Connectivity, Doubt, Expectation, connected};

/// How far around a component its background is looked at, px.
const AROUND: usize = 3;
/// Turns a median of absolute normal deviates into their standard deviation.
const MEDIAN_TO_SD: f64 = 1.482_602_218_505_602;
/// Noise of a picture that shows none: grey values are rounded.
const LEAST_NOISE: f64 = 0.5;
/// Light that differs by less than so many standard deviations is background.
const DIFFERENT: f64 = 3.0;
/// No marker is placed better, px.
const LEAST_SD_PX: f64 = 0.01;

/// A marker in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// Its middle, px.
    pub place: Vector2<f64>,
    /// Standard deviations of u and v, px.
    pub sd: [f64; 2],
    /// Its pixels.
    pub component: Component,
}

/// What looks like a marker, and what does not, with why.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Markers {
    /// As expected, in the order of their first pixels.
    pub found: Vec<Marker>,
    /// The others.
    pub others: Vec<(Component, Vec<Doubt>)>,
}

/// The markers among the pixels that `mask` (0 or more, as many as pixels) has, in a grey picture of rows of `width`.
#[must_use]
pub fn markers(grey: &[u8], mask: &[u8], width: usize, expected: &Expectation) -> Markers {
    let mut all = Markers::default();
    let height = mask.len().checked_div(width).unwrap_or_default();
    for component in connected(mask, width, 1, Connectivity::Eight) {
        let doubts = expected.doubts(&component, width, height);
        if doubts.is_empty() {
            all.found.push(placed(grey, (width, height), component));
        } else {
            all.others.push((component, doubts));
        }
    }
    all
}

fn placed(grey: &[u8], (width, height): (usize, usize), component: Component) -> Marker {
    let (left, right) = (
        component.u_min.saturating_sub(AROUND),
        (component.u_max + AROUND).min(width.saturating_sub(1)),
    );
    let (top, bottom) = (
        component.v_min.saturating_sub(AROUND),
        (component.v_max + AROUND).min(height.saturating_sub(1)),
    );
    let light = |u: usize, v: usize| f64::from(grey.get(v * width + u).copied().unwrap_or(0));
    let all = || (top..=bottom).flat_map(|v| (left..=right).map(move |u| (u, v)));
    let border = all().filter(|(u, v)| *u == left || *u == right || *v == top || *v == bottom);
    let mut border: Vec<f64> = border.map(|(u, v)| light(u, v)).collect();
    let background = median(&mut border);
    let mut off: Vec<f64> = border.iter().map(|one| (one - background).abs()).collect();
    let noise = (MEDIAN_TO_SD * median(&mut off)).max(LEAST_NOISE);
    // Its own pixels say whether it is lighter or darker than what is around it.
    let (u, v) = component.centroid();
    let sign = (light(u.round() as usize, v.round() as usize) - background).signum();
    let (mut sum, mut moment) = (0.0, Vector2::zeros());
    let weighted: Vec<(Vector2<f64>, f64)> = all()
        .map(|(u, v)| {
            let weight = sign * (light(u, v) - background);
            (Vector2::new(u as f64, v as f64), weight)
        })
        .filter(|(_, weight)| *weight > DIFFERENT * noise)
        .collect();
    for (at, weight) in &weighted {
        sum += weight;
        moment += *weight * at;
    }
    if sum <= 0.0 {
        // A marker of the same light and another colour: half a pixel is what its border may be off.
        let sd = 0.5 / (component.area as f64).powf(0.25);
        return Marker {
            place: Vector2::new(u, v),
            sd: [sd; 2],
            component,
        };
    }
    let place = moment / sum;
    let spread = weighted
        .iter()
        .map(|(at, _)| (at - place).map(|one| one * one));
    let spread: Vector2<f64> = spread.sum();
    let sd = spread.map(|one| (noise * one.sqrt() / sum).max(LEAST_SD_PX));
    Marker {
        place,
        sd: sd.into(),
        component,
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// Discs with smooth borders on a plain ground, and noise.
    #[test]
    fn middles_are_as_good_as_their_standard_deviations_say() {
        let (width, height) = (60, 50);
        let expected = Expectation {
            area: (20, 2000),
            eccentricity: 0.6,
            holes: Some(0),
        };
        let (mut squares, mut count) = (0.0, 0.0);
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for round in 0..200 {
            let light = if round % 2 == 0 { 120.0 } else { -80.0 };
            let middle = Vector2::new(rng.random_range(20.0..40.0), rng.random_range(20.0..30.0));
            let radius = rng.random_range(4.0..12.0);
            let pixels: Vec<u8> = (0..width * height)
                .map(|at| {
                    let at = Vector2::new((at % width) as f64, (at / width) as f64);
                    let covered = (radius + 0.5 - (at - middle).norm()).clamp(0.0, 1.0);
                    let noise: f64 = rng.sample(StandardNormal);
                    (110.0 + light * covered + 2.0 * noise)
                        .round()
                        .clamp(0.0, 255.0) as u8
                })
                .collect();
            let mask: Vec<u8> = pixels
                .iter()
                .map(|grey| {
                    u8::from(light.signum() * (f64::from(*grey) - 110.0) > 0.5 * light.abs())
                })
                .collect();
            let all = markers(&pixels, &mask, width, &expected);
            assert_eq!(
                (all.found.len(), all.others.len()),
                (1, 0),
                "{:?}",
                all.others
            );
            let found = &all.found[0];
            for (error, sd) in (found.place - middle).iter().zip(found.sd) {
                squares += (error / sd).powi(2);
                count += 1.0;
                assert!(error.abs() < 0.1);
            }
        }
        let rms = f64::sqrt(squares / count);
        assert!((0.7..1.3).contains(&rms), "{rms}");
    }
}
