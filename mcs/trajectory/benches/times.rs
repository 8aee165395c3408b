//! What jerk-limited times of six joints cost, beside rsruckig for the same motions, with its scratch kept as its users keep it:
//! `cargo bench -p mcs-trajectory`. Each row makes a hundred motions.

#![allow(
    clippy::unwrap_used,
    reason = "a benchmark whose set-up fails has nothing to measure"
)]

use std::sync::Arc;

use divan::{Bencher, black_box};
use mcs_model::{Joints, Model, built_in, file::Inertias};
use mcs_trajectory::timing::{self, JointBounds, JointState, Motion, Timer};
use mcs_trajectory::{CartesianLimits, Planner};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rsruckig::prelude::{InputParameter, Ruckig, ThrowErrorHandler, Trajectory};

const MOTIONS: usize = 100;

fn main() {
    divan::main();
}

fn puma() -> Model {
    built_in::model("puma560", Inertias::Identified)
        .unwrap()
        .unwrap()
}

/// Motions of a PUMA between places within its limits: from rest to rest, or from any state to any other.
fn motions(at_rest: bool) -> Vec<[Motion; 6]> {
    let model = puma();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut motion = |joint: usize| {
        let limits = &model.joints()[joint].limits;
        let bounds = JointBounds::of(limits, (1.0, 1.0), true);
        let mut state = || {
            let mut share = || {
                if at_rest {
                    0.0
                } else {
                    random.random_range(-0.7..0.7)
                }
            };
            let (speed, pull) = (share(), share());
            JointState {
                position: random.random_range(limits.lower..limits.upper),
                velocity: speed * bounds.velocity,
                acceleration: pull * bounds.acceleration,
            }
        };
        (state(), state(), bounds)
    };
    (0..MOTIONS)
        .map(|_| std::array::from_fn(&mut motion))
        .collect()
}

fn ours(bencher: Bencher, at_rest: bool) {
    let motions = motions(at_rest);
    let mut timer = Timer::new(6);
    bencher.bench_local(|| {
        let times = motions
            .iter()
            .map(|motion| timer.between(black_box(motion)).unwrap().together);
        times.sum::<f64>()
    });
}

fn rsruckig(bencher: Bencher, at_rest: bool) {
    let motions = motions(at_rest);
    let mut ruckig = Ruckig::<6, ThrowErrorHandler>::new(None, 1.0);
    let mut input = InputParameter::<6>::new(None);
    let mut trajectory = Trajectory::<6>::new(None);
    bencher.bench_local(|| {
        let times = motions.iter().map(|motion| {
            for (joint, (from, to, bounds)) in black_box(motion).iter().enumerate() {
                input.current_position[joint] = from.position;
                input.current_velocity[joint] = from.velocity;
                input.current_acceleration[joint] = from.acceleration;
                input.target_position[joint] = to.position;
                input.target_velocity[joint] = to.velocity;
                input.target_acceleration[joint] = to.acceleration;
                input.max_velocity[joint] = bounds.velocity;
                input.max_acceleration[joint] = bounds.acceleration;
                input.max_jerk[joint] = bounds.jerk;
            }
            ruckig.calculate(&input, &mut trajectory).unwrap();
            trajectory.duration
        });
        times.sum::<f64>()
    });
}

/// The whole segment as the servo gets it.
#[divan::bench]
fn rest_to_rest_planned(bencher: Bencher) {
    let planner = Planner::new(Arc::new(puma()), CartesianLimits::default(), 0.018).unwrap();
    let planner = planner.limiting_jerk(true);
    let ends = motions(true).into_iter().map(|motion| {
        [
            Joints::from_fn(6, |joint| motion[joint].0.position),
            Joints::from_fn(6, |joint| motion[joint].1.position),
        ]
    });
    let ends: Vec<[Joints; 2]> = ends.collect();
    bencher.bench_local(|| {
        let times = ends
            .iter()
            .map(|[from, to]| planner.joint(black_box(from), to, 1.0).unwrap().duration());
        times.sum::<f64>()
    });
}

#[divan::bench]
fn rest_to_rest_timed(bencher: Bencher) {
    ours(bencher, true);
}

/// With a new scratch for each motion.
#[divan::bench]
fn rest_to_rest_timed_once(bencher: Bencher) {
    let motions = motions(true);
    bencher.bench_local(|| {
        let times = motions
            .iter()
            .map(|motion| timing::between(black_box(motion)).unwrap().together);
        times.sum::<f64>()
    });
}

#[divan::bench]
fn rest_to_rest_rsruckig(bencher: Bencher) {
    rsruckig(bencher, true);
}

#[divan::bench]
fn any_states_timed(bencher: Bencher) {
    ours(bencher, false);
}

#[divan::bench]
fn any_states_rsruckig(bencher: Bencher) {
    rsruckig(bencher, false);
}
