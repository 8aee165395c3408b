//! What the general model costs: one arm of 6 joints and two of 9 in one tree. The names have Pinocchio's time for the same,
//! ns (C++, -O3 -march=native), on the machine for which the project measured it; on another, compare with
//! the package `pin` there.

#![allow(
    clippy::panic,
    reason = "a benchmark whose set-up fails has nothing to measure"
)]

use std::hint::black_box;

use divan::Bencher;
use mcs_model::{
    Data, DynamicsOptions, Model, Placement, built_in,
    file::Inertias,
    inverse::{ClosedForm, Preferences, Search},
};

fn main() {
    divan::main();
}

/// A model with scratch and a state.
struct Arm {
    model: Model,
    data: Data,
    q: Vec<f64>,
    qd: Vec<f64>,
    qdd: Vec<f64>,
}

fn arm(name: &str) -> Arm {
    let Some(Ok(model)) = built_in::model(name, Inertias::Identified) else {
        panic!("{name} is no model");
    };
    let wave = |step: f64| {
        (0..model.dof())
            .map(|joint| 0.3 * (step * joint as f64 + 1.0).sin())
            .collect()
    };
    Arm {
        data: model.data(),
        q: wave(1.0),
        qd: wave(2.0),
        qdd: wave(3.0),
        model,
    }
}

const OPTIONS: DynamicsOptions = DynamicsOptions::WITH_ROTORS;

fn jacobian(bencher: Bencher, name: &str) {
    let Arm {
        model, mut data, q, ..
    } = arm(name);
    let tip = model.tip();
    bencher.bench_local(|| model.jacobian(&mut data, black_box(&q), tip)[(0, 0)]);
}

fn rnea(bencher: Bencher, name: &str) {
    let Arm {
        model,
        mut data,
        q,
        qd,
        qdd,
    } = arm(name);
    bencher.bench_local(|| model.inverse_dynamics(&mut data, black_box(&q), &qd, &qdd, OPTIONS)[0]);
}

fn crba(bencher: Bencher, name: &str) {
    let Arm {
        model, mut data, q, ..
    } = arm(name);
    bencher.bench_local(|| model.mass_matrix(&mut data, black_box(&q), OPTIONS)[(0, 0)]);
}

fn aba(bencher: Bencher, name: &str) {
    let Arm {
        model,
        mut data,
        q,
        qd,
        qdd,
    } = arm(name);
    bencher.bench_local(|| {
        model
            .forward_dynamics(&mut data, black_box(&q), &qd, &qdd, OPTIONS)
            .map(|rates| rates[0])
    });
}

#[divan::bench(name = "jacobian 6, Pinocchio 302")]
fn jacobian_6(bencher: Bencher) {
    jacobian(bencher, "puma560");
}

/// Pinocchio computes the columns of both arms; here the tip has one arm.
#[divan::bench(name = "jacobian 2x9, Pinocchio 765")]
fn jacobian_2x9(bencher: Bencher) {
    jacobian(bencher, "testbed18");
}

#[divan::bench(name = "rnea 6, Pinocchio 659")]
fn rnea_6(bencher: Bencher) {
    rnea(bencher, "puma560");
}

#[divan::bench(name = "rnea 2x9, Pinocchio 1945")]
fn rnea_2x9(bencher: Bencher) {
    rnea(bencher, "testbed18");
}

#[divan::bench(name = "crba 6, Pinocchio 319")]
fn crba_6(bencher: Bencher) {
    crba(bencher, "puma560");
}

#[divan::bench(name = "crba 2x9, Pinocchio 990")]
fn crba_2x9(bencher: Bencher) {
    crba(bencher, "testbed18");
}

#[divan::bench(name = "aba 6, Pinocchio 1431")]
fn aba_6(bencher: Bencher) {
    aba(bencher, "puma560");
}

#[divan::bench(name = "aba 2x9, Pinocchio 4383")]
fn aba_2x9(bencher: Bencher) {
    aba(bencher, "testbed18");
}

#[divan::bench(name = "gravity 6, Pinocchio 418")]
fn gravity_6(bencher: Bencher) {
    let Arm {
        model, mut data, q, ..
    } = arm("puma560");
    bencher.bench_local(|| model.gravity_torques(&mut data, black_box(&q))[0]);
}

#[divan::bench]
fn closed_form_all_eight(bencher: Bencher) {
    let Arm {
        model, mut data, ..
    } = arm("puma560");
    let q = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
    let goal = model.placement(&mut data, &q, model.tip());
    let Some(closed) = ClosedForm::of(&model, model.tip()) else {
        panic!("a PUMA has a closed form");
    };
    bencher.bench_local(|| closed.inverse(black_box(&goal), &q));
}

#[divan::bench]
fn search_of_nine_joints(bencher: Bencher) {
    let Arm {
        model,
        mut data,
        q,
        qd,
        ..
    } = arm("testbed9");
    let goal: Placement = model.placement(&mut data, &q, model.tip());
    let mut search = Search::new(&model, model.tip(), true, Preferences::default());
    bencher.bench_local(|| search.solve(&model, black_box(&goal), &qd).is_ok());
}
