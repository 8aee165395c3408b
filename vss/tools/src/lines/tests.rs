//! Lines and edges against drawn ones, whose places are known.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;

const SIDE: usize = 120;

/// A picture of a function of the distance from a line through a place.
fn drawn(
    through: [f64; 2],
    direction: f64,
    sd: f64,
    seed: u64,
    grey: impl Fn(f64) -> f64,
) -> Frame {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let pixels = (0..SIDE * SIDE).map(|at| {
        let (u, v) = (
            (at % SIDE) as f64 - through[0],
            (at / SIDE) as f64 - through[1],
        );
        let across = v * direction.cos() - u * direction.sin();
        let noise: f64 = rng.sample(StandardNormal);
        (grey(across) + sd * noise).round() as u8
    });
    let pixels: Vec<u8> = pixels.collect();
    Frame::grey8(SIDE, SIDE, pixels)
}

/// A line of light 90 grey values high, as wide as `sigma`.
fn light(sigma: f64) -> impl Fn(f64) -> f64 {
    move |across| 30.0 + 90.0 * (-0.5 * (across / sigma).powi(2)).exp()
}

/// A lens blurs a step.
fn step(across: f64) -> f64 {
    40.0 + 60.0 * (1.0 + libm::erf(across / 1.0))
}

fn beside(point: [f64; 2], through: [f64; 2], direction: f64) -> f64 {
    (point[1] - through[1]) * direction.cos() - (point[0] - through[0]) * direction.sin()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_line_is_one_straight_piece_where_it_was_drawn(
        direction in -1.57..1.57_f64, u in 50.0..70.0_f64, v in 50.0..70.0_f64, sigma in 0.9..2.5_f64, dark in any::<bool>(),
    ) {
        let high = light(sigma);
        let frame = if dark {
            drawn([u, v], direction, 0.0, 0, |across| 200.0 - high(across))
        } else {
            drawn([u, v], direction, 0.0, 0, high)
        };
        let kind = if dark { Kind::Dark } else { Kind::Bright };
        let found = find_lines(&frame, None, &LinesOptions { kind, ..LinesOptions::default() }).unwrap();
        prop_assert_eq!(found.pieces.len(), 1, "{:?}", &found.pieces);
        let piece = found.pieces[0];
        for end in [piece.from, piece.to] {
            prop_assert!(beside(end, [u, v], direction).abs() < 0.02, "{:?}", piece);
        }
        prop_assert!((piece.to[0] - piece.from[0]).hypot(piece.to[1] - piece.from[1]) > 80.0);
        prop_assert!(piece.rms < 0.03, "{:?}", piece);
        for point in &found.points {
            prop_assert!(beside([point.u, point.v], [u, v], direction).abs() < 0.05, "{:?}", point);
        }
    }

    #[test]
    fn an_edge_is_found_with_its_bright_side_on_the_right(
        direction in -3.1..3.1_f64, u in 50.0..70.0_f64, v in 50.0..70.0_f64,
    ) {
        let frame = drawn([u, v], direction, 0.0, 0, step);
        let options = LinesOptions { kind: Kind::Edge, ..LinesOptions::default() };
        let found = find_lines(&frame, None, &options).unwrap();
        prop_assert_eq!(found.pieces.len(), 1, "{:?}", &found.pieces);
        let piece = found.pieces[0];
        for end in [piece.from, piece.to] {
            prop_assert!(beside(end, [u, v], direction).abs() < 0.02, "{:?}", piece);
        }
        let way = (piece.to[0] - piece.from[0]) * direction.cos() + (piece.to[1] - piece.from[1]) * direction.sin();
        prop_assert!(way > 80.0, "{:?}", piece);
    }

    #[test]
    fn no_picture_panics(
        pixels in prop::collection::vec(any::<u8>(), 0..900), width in 0..40_usize, sigma in 0.0..12.0_f64, kind in 0..3,
    ) {
        let height = pixels.len().checked_div(width).unwrap_or(0);
        let frame = Frame::grey8(width, height, pixels[..width * height].to_vec());
        let kind = [Kind::Bright, Kind::Dark, Kind::Edge][kind as usize];
        let options = LinesOptions { kind, sigma, contrast: 0.0, length: 0.0, ..LinesOptions::default() };
        match find_lines(&frame, Some(&frame), &options) {
            Ok(found) => prop_assert!(found.points.is_empty()),
            Err(why) => prop_assert!(!SIGMAS.contains(&sigma) || !frame.is_whole(), "{}", why),
        }
        if let Ok(found) = find_lines(&frame, None, &options) {
            for point in &found.points {
                prop_assert!((0.0..width as f64).contains(&point.u) && point.sd > 0.0, "{:?}", point);
            }
        }
    }
}

/// Over many pictures: errors of points, of pieces' middles and of their directions are as large as they say.
#[test]
fn errors_have_the_size_of_the_answered_standard_deviations() {
    for kind in [Kind::Bright, Kind::Edge] {
        let (mut points, mut middle, mut turn, mut count) = (0.0, 0.0, 0.0, 0.0);
        let (mut pieces, pictures) = (0.0, 40);
        for seed in 0..pictures {
            let direction = -1.5 + 0.075 * seed as f64;
            let through = [60.3, 59.1];
            let frame = match kind {
                Kind::Edge => drawn(through, direction, 4.0, seed, step),
                _ => drawn(through, direction, 4.0, seed, light(1.5)),
            };
            let options = LinesOptions {
                kind,
                ..LinesOptions::default()
            };
            let found = find_lines(&frame, None, &options).unwrap();
            let piece = found.pieces[0];
            assert!(piece.points > 90, "{kind:?} {seed}: {piece:?}");
            for point in &found.points {
                let off = beside([point.u, point.v], through, direction);
                // What noise alone makes elsewhere would be far off.
                assert!(off.abs() < 1.0, "{kind:?} {seed}: {point:?}");
                points += (off / point.sd).powi(2);
                count += 1.0;
            }
            let centre = [0, 1].map(|k| 0.5 * (piece.from[k] + piece.to[k]));
            middle += (beside(centre, through, direction) / piece.sd).powi(2);
            let way = (piece.to[1] - piece.from[1]).atan2(piece.to[0] - piece.from[0]);
            turn += (unsigned(way - direction) / piece.sd_direction).powi(2);
            pieces += 1.0;
        }
        let rms = [points / count, middle / pieces, turn / pieces].map(f64::sqrt);
        assert!((0.9..1.1).contains(&rms[0]), "{kind:?}: {rms:?}");
        // 40 pieces scatter by 11 %.
        assert!(
            rms[1..].iter().all(|rms| (0.65..1.35).contains(rms)),
            "{kind:?}: {rms:?}"
        );
    }
}

#[test]
fn a_bent_line_is_two_pieces_and_spots_and_noise_are_none() {
    let (mut pixels, mut rng) = (vec![0_u8; SIDE * SIDE], ChaCha8Rng::seed_from_u64(7));
    for (at, pixel) in pixels.iter_mut().enumerate() {
        let (u, v) = ((at % SIDE) as f64, (at / SIDE) as f64);
        // It jumps by 14 px where it climbs a step, and bends at the end.
        let line = if u < 50.0 {
            40.0
        } else {
            54.0 + (u - 80.0).max(0.0)
        };
        let height = if u < 80.0 {
            v - line
        } else {
            (v - line) / 2.0_f64.sqrt()
        };
        let spot = (u - 20.0).hypot(v - 100.0);
        let noise: f64 = rng.sample(StandardNormal);
        let grey = 25.0
            + 100.0 * (-0.5 * (height / 1.4).powi(2)).exp()
            + 150.0 * (-0.5 * (spot / 1.6).powi(2)).exp();
        *pixel = (grey + 3.0 * noise).clamp(0.0, 255.0) as u8;
    }
    let frame = Frame::grey8(SIDE, SIDE, pixels.clone());
    let found = find_lines(&frame, None, &LinesOptions::default()).unwrap();
    let mut along: Vec<f64> = found
        .pieces
        .iter()
        .map(|piece| (piece.to[1] - piece.from[1]).atan2(piece.to[0] - piece.from[0]))
        .collect();
    along.sort_by(f64::total_cmp);
    assert_eq!(along.len(), 3, "{:?}", found.pieces);
    assert!(along[0].abs() < 0.02 && along[1].abs() < 0.02, "{along:?}");
    assert!((along[2] - PI / 4.0).abs() < 0.05, "{along:?}");
    // Without the light nothing is left, and less itself neither.
    let dark = find_lines(&frame, Some(&frame), &LinesOptions::default()).unwrap();
    assert_eq!(dark, Lines::default());
    let other = Frame::grey8(SIDE, SIDE - 1, pixels[SIDE..].to_vec());
    let refused = find_lines(&frame, Some(&other), &LinesOptions::default()).unwrap_err();
    assert!(refused.to_string().contains("120 x 119"), "{refused}");
}
