//! Corners of rendered patterns, with perspective, lens, blur and noise.

use super::rendered::{camera, rendered, truth};
use super::*;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn corners_are_found_in_order_and_as_exactly_as_they_say() {
    let turns = [
        Vector3::new(0.02, 0.01, 0.07),
        Vector3::new(0.5, 0.2, 0.1),
        Vector3::new(-0.4, 0.5, -0.3),
    ];
    for noise in [0.0, 4.0] {
        let (mut squares, mut ratios, mut count) = (0.0, 0.0, 0.0);
        for (seed, turn) in (0..).zip(turns) {
            let camera = camera(turn, 22.0, 8, 5);
            let picture = rendered(&camera, 8, 5, noise, seed);
            let found = find_corners(&picture, 8, 5).unwrap();
            for (corner, truth) in found.iter().zip(truth(&camera, 8, 5)) {
                let (du, dv) = (corner.u - truth.x, corner.v - truth.y);
                assert!(
                    du.hypot(dv) < 0.05 + 0.05 * noise,
                    "{noise} {turn}: {corner:?} {truth}"
                );
                squares += du * du + dv * dv;
                ratios += (du / corner.sd_u).powi(2) + (dv / corner.sd_v).powi(2);
                count += 1.0;
            }
        }
        let (rms, ratio) = ((squares / count).sqrt(), (ratios / (2.0 * count)).sqrt());
        let told = format!("noise {noise}: rms {rms}, error over sd {ratio}");
        assert!(rms < 0.02 + 0.015 * noise, "{told}");
        if noise > 0.0 {
            assert!((0.75..1.3).contains(&ratio), "{told}");
        }
    }
}

#[test]
fn a_square_pattern_begins_at_the_upper_left_whatever_its_turn() {
    for quarter in 0..4 {
        let turn = Vector3::new(
            0.0,
            0.0,
            0.15 + f64::from(quarter) * std::f64::consts::FRAC_PI_2,
        );
        let camera = camera(turn, 22.0, 5, 5);
        let found = find_corners(&rendered(&camera, 5, 5, 1.0, 1), 5, 5).unwrap();
        let first = found[0];
        assert!(found.iter().all(|one| one.u + one.v >= first.u + first.v));
        let (right, below) = (found[4], found[20]);
        assert!(
            right.u > first.u + 50.0 && below.v > first.v + 50.0,
            "{quarter}"
        );
    }
}

#[test]
fn what_is_no_such_pattern_is_refused_with_what_was_found() {
    let camera = camera(Vector3::new(0.3, 0.2, 0.1), 22.0, 7, 5);
    let picture = rendered(&camera, 7, 5, 2.0, 1);
    assert!(matches!(
        find_corners(&picture, 6, 5),
        Err(NoChequer::OtherSize {
            columns: 7,
            rows: 5,
            filled: 35,
            ..
        })
    ));
    assert!(matches!(
        find_corners(&picture, 9, 6),
        Err(NoChequer::TooFew { .. })
    ));
    // A hand over a part of it.
    let mut pixels = picture.grey().to_vec();
    for v in 90..130 {
        for u in 130..190 {
            pixels[v * 320 + u] = 120;
        }
    }
    let covered = Frame::grey8(320, 240, pixels);
    assert!(find_corners(&covered, 7, 5).is_err());
    let noise = |seed| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let pixels: Vec<u8> = (0..320 * 240).map(|_| rng.random()).collect();
        Frame::grey8(320, 240, pixels)
    };
    for seed in 0..3 {
        assert!(find_corners(&noise(seed), 7, 5).is_err());
    }
    assert!(find_corners(&Frame::grey8(320, 240, vec![90; 320 * 240]), 7, 5).is_err());
    assert_eq!(
        find_corners(&Frame::grey8(0, 0, Vec::new()), 7, 5),
        Err(NoChequer::NoPicture)
    );
    assert_eq!(find_corners(&picture, 2, 5), Err(NoChequer::TooSmall(2, 5)));
}
