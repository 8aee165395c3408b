//! Pictures with several spots of every kind: where they are, how well that is known, and what is flagged.

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
        let spots = places.map(|(x, y, sigma, height, _)| height * gaussian(u, v, (x, y), sigma));
        let long =
            100.0 * (-0.5 * ((u - 80.4) / 4.0).powi(2) - 0.5 * ((v - 70.2) / 1.6).powi(2)).exp();
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

/// What is left of a round spot at the border is not round.
#[test]
fn a_cut_spot_is_cut_and_not_elongated_besides() {
    for at in [(0.3, 25.4), (40.2, 49.1), (78.8, 20.3), (-0.4, 49.6)] {
        let frame = picture(80, 50, 0.0, |u, v| 30.0 + 150.0 * gaussian(u, v, at, 2.5));
        let spots = found(&frame, &SpotsOptions::default());
        let [spot] = spots[..] else {
            panic!("{at:?}: {spots:?}");
        };
        assert!(
            spot.flags.touches_border && !spot.flags.elongated,
            "{spot:?}"
        );
    }
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

/// Discs of any size, and a wall, are centroids: how many evaluations a fit takes does not grow with them.
#[test]
fn what_is_much_larger_than_a_spot_is_found_and_fitted_to_some_of_its_pixels() {
    for radius in [15.0, 60.0, 400.0] {
        let size = 1000;
        let pixels: Vec<u8> = (0..size * size)
            .map(|at| {
                let far = ((at % size) as f64 - 500.25).hypot((at / size) as f64 - 499.5);
                (20.0 + 160.0 / (1.0 + ((far - radius) / 0.8).exp())) as u8 + (at % 3) as u8
            })
            .collect();
        let found =
            find_spots(&Frame::grey8(size, size, pixels), &SpotsOptions::default()).unwrap();
        let [spot] = found.spots[..] else {
            panic!("{radius}: {found:?}");
        };
        assert!(
            (spot.u - 500.25).abs() < 0.05 && (spot.v - 499.5).abs() < 0.05,
            "{spot:?}"
        );
        assert!(!spot.gaussian, "{spot:?}");
    }
}
