//! Boards anywhere, with discs anywhere: every carry ends as asked, within the bounds.

use std::io::Write as _;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    layout::{board, error, laid, nothing_was_hit, other, reached, turned},
    person::{Step, seen_in},
};
use crate::harness::Scratch;

/// Seeds of the campaign; few unless `CTOS_CARRY_SEEDS` says how many.
fn seeds() -> u64 {
    let given = std::env::var("CTOS_CARRY_SEEDS").ok();
    given.map_or(2, |text| text.parse().unwrap())
}

#[test]
fn on_boards_anywhere_with_discs_anywhere_every_carry_ends_as_asked_within_1_5_mm_and_1_degree_rms()
{
    let (mut squares, mut worst, mut turns) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut steps, mut targets) = (Vec::new(), Vec::new());
    for seed in 0..seeds() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let surface = board(
            rng.random_range(0.52..0.62),
            rng.random_range(-0.12..0.12),
            rng.random_range(-180.0..180.0),
        );
        let fields = reached(&surface);
        let mut draw = || fields[rng.random_range(0..fields.len())];
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let from = draw();
        let to = std::iter::repeat_with(&mut draw).find(|to| apart(*to, from) > 0.9);
        let to = to.unwrap();
        let clear = |one: &[f64; 2]| apart(*one, from) > 1.5 && apart(*one, to) > 1.5;
        let blue = std::iter::repeat_with(&mut draw).find(clear).unwrap();
        let (angle, far) = (
            rng.random_range(0.0..std::f64::consts::TAU),
            rng.random_range(0.0..0.010),
        );
        steps.extend(laid(&surface, from, [far * angle.cos(), far * angle.sin()]));
        steps.push(other(&surface, blue));
        let line = format!("{},{} {},{}", from[0], from[1], to[0], to[1]);
        steps.push(Step::Carry(line));
        targets.push(to);
    }
    let seen = seen_in(&Scratch::new(), "", steps);
    let all = seen.answers.lock().unwrap();
    nothing_was_hit(&seen);
    for (seed, (answer, target)) in all.iter().zip(&targets).enumerate() {
        assert_eq!(answer.symbol, "carried", "seed {seed}: {}", answer.text);
        let error = error(answer, *target);
        worst = worst.max(error);
        squares += error * error;
        turns += turned(answer).powi(2);
    }
    let rms = (squares / targets.len() as f64).sqrt();
    let rms_deg = (turns / targets.len() as f64).sqrt().to_degrees();
    let (count, touches) = (targets.len(), seen.touches.lock().unwrap());
    let (mean_mm, worst_mm) = (rms * 1e3, worst * 1e3);
    let numbers = format!(
        "{count} carries: rms {mean_mm:.2} mm and {rms_deg:.2} degrees, worst {worst_mm:.2} mm; pressed on, N: {touches:?}\n"
    );
    std::io::stdout().write_all(numbers.as_bytes()).unwrap();
    assert!(
        rms < 1.5e-3 && worst < 3e-3 && rms_deg < 1.0,
        "rms {rms} m, {rms_deg} degrees, worst {worst} m: {all:?}"
    );
}
