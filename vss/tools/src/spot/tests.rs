//! Spots against the bound that noise sets, and against pictures that have none.

use super::*;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

pub(super) fn frame(width: usize, height: usize, pixels: Vec<u8>) -> Frame {
    Frame::grey8(width, height, pixels)
}

/// A grey value for each place.
type Behind = fn(f64, f64) -> f64;

struct Scene {
    size: usize,
    background: f64,
    noise: f64,
    /// u, v, amplitude, sigma.
    spots: Vec<(f64, f64, f64, f64)>,
    /// Grey value of a large bright box in the lower left corner.
    wall: f64,
    /// What else is behind: a grey value for each place.
    behind: Behind,
}

impl Scene {
    fn of(u: f64, v: f64, amplitude: f64, sigma: f64, noise: f64) -> Self {
        Self {
            size: 64,
            background: 40.0,
            noise,
            spots: vec![(u, v, amplitude, sigma)],
            wall: 0.0,
            behind: |_, _| 0.0,
        }
    }

    /// Each pixel is the mean of the scene over its square (4x4 samples).
    fn light(&self) -> Vec<f64> {
        let mut light = Vec::new();
        for v in 0..self.size {
            for u in 0..self.size {
                let mut value = self.background;
                for k in 0..16 {
                    let (x, y) = (
                        f64::from(k % 4) * 0.25 - 0.375,
                        f64::from(k / 4) * 0.25 - 0.375,
                    );
                    value += (self.behind)(u as f64 + x, v as f64 + y) / 16.0;
                }
                if u < self.size / 3 && v > self.size / 2 {
                    value += self.wall;
                }
                for (su, sv, amplitude, sigma) in &self.spots {
                    let near = (u as f64 - su).hypot(v as f64 - sv) < 6.0 * sigma + 2.0;
                    for k in 0..if near { 16 } else { 0 } {
                        let x = u as f64 + f64::from(k % 4) * 0.25 - 0.375 - su;
                        let y = v as f64 + f64::from(k / 4) * 0.25 - 0.375 - sv;
                        value +=
                            amplitude / 16.0 * (-(x * x + y * y) / (2.0 * sigma * sigma)).exp();
                    }
                }
                light.push(value);
            }
        }
        light
    }

    /// The same with noise, rounded.
    fn render(&self, rng: &mut ChaCha8Rng) -> Frame {
        let noisy = |value: f64| {
            let deviate: f64 = StandardNormal.sample(rng);
            (value + self.noise * deviate).round().clamp(0.0, 255.0) as u8
        };
        let pixels = self.light().into_iter().map(noisy).collect();
        frame(self.size, self.size, pixels)
    }

    /// The Cramér-Rao bound of the centre (rms of its distance), when height, width and background are unknown, too, and
    /// rounding adds a twelfth to the variance of the noise.
    fn bound(&self) -> f64 {
        let (u, v, amplitude, sigma) = self.spots[0];
        let changed = |du: f64, dv: f64, da: f64, ds: f64| Self {
            spots: vec![(u + du, v + dv, amplitude + da, sigma + ds)],
            ..*self
        };
        let slopes: Vec<Vec<f64>> = [
            (1e-3, 0.0, 0.0, 0.0),
            (0.0, 1e-3, 0.0, 0.0),
            (0.0, 0.0, 1e-3, 0.0),
            (0.0, 0.0, 0.0, 1e-3),
        ]
        .iter()
        .map(|(a, b, c, d)| {
            let (more, less) = (
                changed(*a, *b, *c, *d).light(),
                changed(-a, -b, -c, -d).light(),
            );
            more.iter()
                .zip(less)
                .map(|(more, less)| (more - less) / 2e-3)
                .collect()
        })
        .chain([vec![1.0; self.size * self.size]])
        .collect();
        let information = nalgebra::Matrix5::from_fn(|i, j| {
            slopes[i]
                .iter()
                .zip(&slopes[j])
                .map(|(a, b)| a * b)
                .sum::<f64>()
        });
        let unit = information.try_inverse().unwrap();
        ((unit[(0, 0)] + unit[(1, 1)]) * (self.noise * self.noise + 1.0 / 12.0)).sqrt()
    }
}

/// Finds spots at random sub-pixel places; returns the rms error (2-D), the rms predicted, and how many were found.
fn monte_carlo(amplitude: f64, sigma: f64, noise: f64, trials: usize) -> (f64, f64, usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut squares, mut predicted, mut found) = (0.0, 0.0, 0);
    for _ in 0..trials {
        let (u, v) = (rng.random_range(20.0..44.0), rng.random_range(20.0..44.0));
        let picture = Scene::of(u, v, amplitude, sigma, noise).render(&mut rng);
        if let Ok(spot) = find_spot(&picture, &SpotOptions::default()) {
            squares += (spot.u - u).powi(2) + (spot.v - v).powi(2);
            predicted += spot.sd_u.powi(2) + spot.sd_v.powi(2);
            found += 1;
        }
    }
    let n = found as f64;
    ((squares / n).sqrt(), (predicted / n).sqrt(), found)
}

#[test]
fn the_centre_is_within_1_25_of_the_bound_and_its_predicted_sd_is_true() {
    for (amplitude, sigma, noise) in [
        (180.0, 1.0, 2.0),
        (180.0, 1.5, 4.0),
        (180.0, 2.5, 4.0),
        (180.0, 4.0, 8.0),
        (90.0, 1.5, 11.0),
        (90.0, 2.5, 11.0),
        (90.0, 2.0, 17.0),
    ] {
        let trials = places(100);
        let (error, predicted, found) = monte_carlo(amplitude, sigma, noise, trials);
        // Rounding to whole grey values adds a twelfth to the variance.
        let bound =
            2.0 / std::f64::consts::PI.sqrt() * (noise * noise + 1.0 / 12.0_f64).sqrt() / amplitude;
        let case = format!(
            "A {amplitude} sigma {sigma} noise {noise}: {error:.4} bound {bound:.4} said {predicted:.4}"
        );
        assert_eq!(found, trials, "{case}");
        assert!(error < 1.25 * bound, "{case}");
        assert!((0.85..1.2).contains(&(error / predicted)), "{case}");
    }
}

/// So many random places are tried; the long run tries a thousand.
fn places(few: usize) -> usize {
    std::env::var("CTOS_PLACES").map_or(few, |places| places.parse().unwrap())
}

/// The rows of the project's table of estimators, at many places between pixels each.
fn reaches_the_bound(sigma: f64, noise: f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut squares, mut ratios) = (0.0, 0.0);
    let trials = places(250);
    for _ in 0..trials {
        let (u, v) = (rng.random_range(15.0..17.0), rng.random_range(15.0..17.0));
        let scene = Scene {
            size: 33,
            ..Scene::of(u, v, 180.0, sigma, noise)
        };
        let spot = find_spot(&scene.render(&mut rng), &SpotOptions::default()).unwrap();
        let (du, dv) = (spot.u - u, spot.v - v);
        squares += du * du + dv * dv;
        ratios += 0.5 * ((du / spot.sd_u).powi(2) + (dv / spot.sd_v).powi(2));
    }
    let (rms, ratio) = (
        (squares / trials as f64).sqrt(),
        (ratios / trials as f64).sqrt(),
    );
    // It hardly depends on the place.
    let bound = Scene {
        size: 33,
        ..Scene::of(16.2, 15.9, 180.0, sigma, noise)
    }
    .bound();
    let told = format!(
        "sigma {sigma} noise {noise}: rms {rms:.4}, bound {bound:.4}, error over sd {ratio:.3}"
    );
    assert!(rms <= 1.15 * bound, "{told}");
    assert!((0.9..1.1).contains(&ratio), "{told}");
}

#[test]
fn spots_of_1_0_px_are_within_1_15_of_the_bound() {
    reaches_the_bound(1.0, 2.0);
}

#[test]
fn spots_of_1_5_px_are_within_1_15_of_the_bound() {
    reaches_the_bound(1.5, 4.0);
}

#[test]
fn spots_of_2_5_px_are_within_1_15_of_the_bound() {
    reaches_the_bound(2.5, 4.0);
}

#[test]
fn spots_of_4_0_px_are_within_1_15_of_the_bound() {
    reaches_the_bound(4.0, 8.0);
}

/// The edge of an arm, a tilted sheet, and a round end, behind the lamp at each of many places.
#[test]
fn noise_free_spots_before_structures_are_within_0_02_px_and_edges_are_named() {
    let behind: [(Behind, f64, bool); 4] = [
        (
            |u, v| if 0.8 * u + 0.6 * v > 44.0 { 30.0 } else { 0.0 },
            0.02,
            true,
        ),
        (
            |u, v| if u - 0.3 * v > 22.0 { 20.0 } else { 0.0 },
            0.02,
            true,
        ),
        (|u, v| 0.8 * u + 0.5 * v, 0.02, false),
        (
            |u, v| {
                if (u - 20.0).hypot(v - 45.0) < 14.0 {
                    25.0
                } else {
                    0.0
                }
            },
            0.03,
            true,
        ),
    ];
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for (index, (behind, allowed, structured)) in behind.into_iter().enumerate() {
        let mut named = 0;
        for _ in 0..30 {
            let (u, v) = (rng.random_range(28.0..36.0), rng.random_range(28.0..36.0));
            let scene = Scene {
                behind,
                ..Scene::of(u, v, 120.0, 1.8, 0.0)
            };
            let spot = find_spot(&scene.render(&mut rng), &SpotOptions::default()).unwrap();
            let off = (spot.u - u).hypot(spot.v - v);
            assert!(
                off < allowed,
                "background {index} at {u} {v}: {off} {spot:?}"
            );
            named += usize::from(spot.flags.structured);
        }
        if structured {
            assert!(named >= 10, "background {index}: {named}");
        } else {
            assert_eq!(named, 0, "background {index}");
        }
    }
}

/// As the lamp before the arm: errors must not be larger than they are said to be.
#[test]
fn predicted_errors_hold_before_edges_in_noise() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    let (mut ratios, mut found) = (0.0, 0.0);
    let trials = places(250);
    for _ in 0..trials {
        let (u, v) = (rng.random_range(26.0..38.0), rng.random_range(26.0..38.0));
        let scene = Scene {
            behind: |u, v| if 0.8 * u + 0.6 * v > 44.0 { 10.0 } else { 0.0 },
            ..Scene::of(u, v, 60.0, 1.8, 13.0)
        };
        if let Ok(spot) = find_spot(&scene.render(&mut rng), &SpotOptions::default()) {
            ratios +=
                0.5 * ((spot.u - u) / spot.sd_u).powi(2) + 0.5 * ((spot.v - v) / spot.sd_v).powi(2);
            found += 1.0;
        }
    }
    assert!(found >= 0.98 * trials as f64, "{found}");
    let ratio = (ratios / found).sqrt();
    assert!((0.88..1.12).contains(&ratio), "{ratio}");
}

#[test]
fn narrow_spots_are_found_without_a_bias_towards_pixel_centres() {
    let (error, _, found) = monte_carlo(180.0, 0.6, 2.0, 200);
    assert_eq!(found, 200);
    assert!(error < 0.04, "{error}");
}

#[test]
fn a_lamp_is_found_beside_and_in_front_of_something_large_and_bright() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (u, v) in [(45.3, 20.2), (10.4, 48.7)] {
        let scene = Scene {
            wall: 60.0,
            ..Scene::of(u, v, 90.0, 2.0, 8.0)
        };
        let spot = find_spot(&scene.render(&mut rng), &SpotOptions::default()).unwrap();
        assert!((spot.u - u).hypot(spot.v - v) < 0.5, "{spot:?}");
    }
    // Brighter than the lamp.
    let scene = Scene {
        wall: 150.0,
        ..Scene::of(45.3, 20.2, 90.0, 2.0, 8.0)
    };
    let spot = find_spot(&scene.render(&mut rng), &SpotOptions::default()).unwrap();
    assert!((spot.u - 45.3).hypot(spot.v - 20.2) < 0.5, "{spot:?}");
}

#[test]
fn a_bright_wall_without_a_lamp_is_no_spot_and_the_reason_says_so() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for seed in 0..50 {
        let scene = Scene {
            size: 200,
            spots: vec![],
            wall: 50.0 + f64::from(seed),
            ..Scene::of(0.0, 0.0, 0.0, 1.0, 9.0)
        };
        let refused = find_spot(&scene.render(&mut rng), &SpotOptions::default()).unwrap_err();
        assert!(matches!(refused, NoSpot::NotASpot { .. }), "{refused}");
    }
}

/// A bar with a round end, as a lit arm looks from above, brightest at its end; bars of many widths.
#[test]
fn the_end_of_an_arm_is_no_spot() {
    let (fewest, most) = (10, 40);
    let trials = places(fewest).clamp(fewest, most);
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let options = SpotOptions {
        max_sigma_px: 4.0,
        ..SpotOptions::default()
    };
    for trial in 0..trials {
        let half = 5.0 + 4.0 * trial as f64 / trials as f64;
        let pixels = (0..150 * 150).map(|k| {
            let (u, v) = (f64::from(k % 150), f64::from(k / 150));
            let away = (u - 75.0).hypot((v - 60.0).min(0.0));
            let arm = if away < half {
                40.0 - 0.2 * (v - 60.0).abs()
            } else {
                0.0
            };
            let deviate: f64 = StandardNormal.sample(&mut rng);
            (40.0 + arm + 11.0 * deviate).round().clamp(0.0, 255.0) as u8
        });
        let picture = frame(150, 150, pixels.collect());
        let refused = find_spot(&picture, &options);
        assert!(
            matches!(refused, Err(NoSpot::NotASpot { .. })),
            "{refused:?}"
        );
    }
}

#[test]
fn noise_alone_is_no_spot() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for noise in [0.0, 0.3, 2.0, 11.0, 30.0] {
        for _ in 0..10 {
            let scene = Scene {
                size: 300,
                spots: vec![],
                background: 60.0,
                ..Scene::of(0.0, 0.0, 0.0, 1.0, noise)
            };
            let refused = find_spot(&scene.render(&mut rng), &SpotOptions::default());
            assert!(refused.is_err(), "{noise}: {refused:?}");
        }
    }
}

#[test]
fn flags_say_what_is_doubtful() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let options = SpotOptions::default();
    let mut find = |scene: &Scene| find_spot(&scene.render(&mut rng), &options).unwrap();
    assert_eq!(
        find(&Scene::of(30.2, 31.7, 150.0, 2.0, 3.0)).flags,
        SpotFlags::default()
    );
    let border = find(&Scene::of(3.0, 31.7, 150.0, 2.0, 3.0));
    assert!(border.flags.touches_border && (border.u - 3.0).abs() < 0.1);
    let bright = find(&Scene::of(30.2, 31.7, 400.0, 2.0, 3.0));
    assert!(bright.flags.saturated && !bright.flags.elongated);
    assert!(
        (bright.u - 30.2).abs() < 0.05 && (bright.amplitude / 400.0 - 1.0).abs() < 0.2,
        "{bright:?}"
    );
    let mut two = Scene::of(30.0, 30.0, 100.0, 1.5, 3.0);
    two.spots.push((33.5, 30.0, 100.0, 1.5));
    assert!(find(&two).flags.elongated);
}

#[test]
fn odd_pictures_are_refused_with_their_reason() {
    let options = SpotOptions::default();
    let refused =
        |width, height, pixels| find_spot(&frame(width, height, pixels), &options).unwrap_err();
    assert_eq!(
        refused(0, 0, vec![]),
        NoSpot::Empty {
            width: 0,
            height: 0
        }
    );
    assert_eq!(
        refused(5, 5, vec![1; 24]),
        NoSpot::WrongSize {
            width: 5,
            height: 5,
            pixels: 24
        }
    );
    assert_eq!(
        refused(usize::MAX, 3, vec![1; 24]),
        NoSpot::WrongSize {
            width: usize::MAX,
            height: 3,
            pixels: 24
        }
    );
    assert!(matches!(
        refused(50, 50, vec![255; 2500]),
        NoSpot::Dark { .. }
    ));
    assert!(matches!(
        refused(50, 50, vec![0; 2500]),
        NoSpot::Dark { .. }
    ));
    assert!(
        refused(50, 50, vec![9; 2500])
            .to_string()
            .contains("brightest 9, needed 10.5")
    );
}

proptest! {
    #[test]
    fn no_picture_panics_and_every_spot_is_inside_it(
        width in 1_usize..40, height in 1_usize..40, seed in any::<u64>(), kind in 0..4, sparse in 0.0..1.0_f64,
    ) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let pixels: Vec<u8> = (0..width * height).map(|_| match kind {
            0 => rng.random(),
            1 => if rng.random_bool(sparse) { 255 } else { 0 },
            2 => if rng.random_bool(sparse) { 254 } else { 250 },
            _ => if rng.random_bool(0.01) { 200 } else { 10 },
        }).collect();
        if let Ok(spot) = find_spot(&frame(width, height, pixels), &SpotOptions::default()) {
            prop_assert!(spot.u >= -0.5 && spot.u <= width as f64 && spot.v >= -0.5 && spot.v <= height as f64);
            prop_assert!(spot.sd_u.is_finite() && spot.sd_v.is_finite() && spot.sigma.is_finite());
        }
    }
}
