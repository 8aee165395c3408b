//! What one servo period of 18 joints costs with limits, guards and collision detection, without hardware:
//! `cargo bench -p mcs-collision --bench tick`.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "its output is what it is for; a benchmark whose set-up fails has nothing to measure"
)]

#[path = "../tests/rig/mod.rs"]
mod rig;

use std::time::Duration;

use ctos::time::Clock;
use divan::Bencher;
use mcs::servo::MotionPhase;

/// How often the same motion is made: of each of its ticks the quickest counts, which nobody interrupted.
const MOTIONS: u32 = 20;

fn main() {
    // Not when the tests only look whether it runs.
    if std::env::args().any(|argument| argument == "--bench") {
        each_tick();
    }
    divan::main();
}

/// The times of the ticks of a motion: the ones that half of them, and 99 of 100, keep, and the longest.
fn each_tick() {
    let clock = Clock::real();
    for (limit_jerk, limits) in [
        (false, "speed and acceleration"),
        (true, "speed, acceleration and jerk"),
    ] {
        for recipes in [0, rig::RECIPES.len() - 1, rig::RECIPES.len()] {
            let mut took: Vec<Duration> = Vec::new();
            for _ in 0..MOTIONS {
                let (mut servo, _port) = rig::servo(recipes, limit_jerk);
                for index in 0.. {
                    let began = clock.now();
                    servo.tick(0);
                    let now = clock.now().since(began);
                    if servo.status().motion.phase != MotionPhase::Moving {
                        break;
                    }
                    match took.get_mut(index) {
                        Some(quickest) => *quickest = now.min(*quickest),
                        None => took.push(now),
                    }
                }
            }
            took.sort_unstable();
            let at = |share: f64| {
                let place = (share * (took.len() - 1) as f64) as usize;
                1e6 * took[place].as_secs_f64()
            };
            println!(
                "a tick of 18 joints, limits of {limits}, {recipes} guards: p50 {:.1} µs, p99 {:.1} µs, longest {:.1} µs of {}",
                at(0.5),
                at(0.99),
                at(1.0),
                took.len()
            );
        }
    }
}

/// A hundred ticks of 18 joints: without guards, with workspace, speed and force, and with collision detection as well.
#[divan::bench(args = [0, 3, 4])]
fn hundred_ticks_with_guards(bencher: Bencher, recipes: usize) {
    bencher
        .with_inputs(|| rig::servo(recipes, false))
        .bench_local_refs(|(servo, _port)| {
            for _ in 0..100 {
                servo.tick(0);
            }
        });
}
