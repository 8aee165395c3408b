//! Markings per second of the explicit state space, on one thread and two; counting by decision
//! diagrams; and the whole check of a net as large as a robot's.
//!
//! Peers and their figures stand in `docs/benchmarks.md`.

#![allow(
    clippy::unwrap_used,
    reason = "a benchmark may end when its input is wrong"
)]

use std::{fmt::Write as _, sync::Arc};

use ctos::diagnostic::Source;
use divan::{Bencher, counter::ItemsCount};
use pnt::{
    analysis::{
        explicit::{Limits, explore},
        model::{Model, Place, Transition},
        symbolic,
        verdict::Engines,
    },
    check::{Options, Rule, prove},
    compile,
    compose::System,
    net::Net,
};

fn main() {
    divan::main();
}

fn net(text: &str) -> Arc<Net> {
    Arc::new(compile::net(&Source::new("bench.net", text)).unwrap())
}

fn model(text: &str) -> Model {
    let (system, _) = System::compose(&[net(text)]);
    Model::of_system(&system)
}

/// Four-cell Kanban system (Ciardo and Tilgner 1996).
fn kanban(cards: usize) -> Model {
    let mut text = String::from("net kanban\n");
    for i in 1..=4 {
        let _ = write!(
            text,
            "place pm{i}, pback{i}, pout{i}, pkan{i} = {cards}
transition tok{i}\n  in pm{i}\n  out pout{i}
transition tredo{i}\n  in pm{i}\n  out pback{i}
transition tback{i}\n  in pback{i}\n  out pm{i}\n"
        );
    }
    text.push_str(
        "transition tin1\n  in pkan1\n  out pm1
transition tsynch1\n  in pout1, pkan2, pkan3\n  out pkan1, pm2, pm3
transition tsynch2\n  in pout2, pout3, pkan4\n  out pkan2, pkan3, pm4
transition tout4\n  in pout4\n  out pkan4\n",
    );
    model(&text)
}

/// Philosophers who take either fork first: 3^n markings.
fn philosophers(count: usize) -> String {
    let mut text = String::from("net philosophers\n");
    for i in 0..count {
        let next = (i + 1) % count;
        let _ = write!(
            text,
            "place think{i} = 1, fork{i} = 1, left{i}, right{i}, eat{i}
transition take_left{i}\n  in think{i}, fork{i}\n  out left{i}
transition then_right{i}\n  in left{i}, fork{next}\n  out eat{i}
transition take_right{i}\n  in think{i}, fork{next}\n  out right{i}
transition then_left{i}\n  in right{i}, fork{i}\n  out eat{i}
transition end{i}\n  in eat{i}\n  out think{i}, fork{i}, fork{next}\n"
        );
    }
    text
}

/// 400 places and 1,000 transitions, one-safe: 40 tokens, each on a ring of ten places of its own with
/// a step and a jump at each place, and 200 transitions that move two neighbours together.
fn wide() -> Model {
    let places = (0..400_u32).map(|number| Place {
        name: format!("p{number}"),
        tokens: u32::from(number % 10 == 0),
        capacity: None,
    });
    let mut transitions = Vec::new();
    let mut add = |takes: Vec<u32>, puts: Vec<u32>| {
        let arcs = |mut places: Vec<u32>| {
            places.sort_unstable();
            places.into_iter().map(|place| (place, 1)).collect()
        };
        transitions.push(Transition {
            name: format!("t{}", transitions.len()),
            takes: arcs(takes),
            puts: arcs(puts),
            label: u32::try_from(transitions.len()).ok(),
            ..Transition::default()
        });
    };
    let at = |ring: u32, step: u32| ring * 10 + step % 10;
    for ring in 0..40 {
        for step in 0..10 {
            add(vec![at(ring, step)], vec![at(ring, step + 1)]);
            add(vec![at(ring, step)], vec![at(ring, step + 3)]);
        }
        for step in 0..5 {
            let next = (ring + 1) % 40;
            add(
                vec![at(ring, 2 * step), at(next, step)],
                vec![at(ring, 2 * step + 1), at(next, step + 5)],
            );
        }
    }
    Model {
        places: places.collect(),
        transitions,
    }
}

/// Items are markings (published number).
#[divan::bench(args = [1, 2], sample_count = 3, sample_size = 1)]
fn kanban_5_explicit_on_threads(bencher: Bencher, threads: usize) {
    let model = kanban(5);
    let limits = Limits {
        markings: usize::MAX,
        threads,
        ..Limits::default()
    };
    bencher
        .counter(ItemsCount::new(2_546_432_usize))
        .bench_local(|| {
            let found = explore(&model, &limits);
            assert_eq!((found.markings, found.edges), (2_546_432, 24_460_016));
            assert!(
                found.peak_bytes / found.markings <= 24,
                "{}",
                found.peak_bytes
            );
        });
}

/// Items are markings; the net has far more of them than are looked for here.
#[divan::bench(args = [1, 2], sample_count = 3, sample_size = 1)]
fn wide_net_explicit_on_threads(bencher: Bencher, threads: usize) {
    let model = wide();
    let limits = Limits {
        markings: 300_000,
        threads,
        ..Limits::default()
    };
    bencher
        .counter(ItemsCount::new(300_000_usize))
        .bench_local(|| explore(&model, &limits).markings);
}

#[divan::bench(args = [20, 40], sample_count = 3, sample_size = 1)]
fn philosophers_by_diagrams(bencher: Bencher, count: usize) {
    let model = model(&philosophers(count));
    bencher.bench_local(|| symbolic::count(&model, 256 << 20).unwrap().markings);
}

#[divan::bench(args = [5, 10], sample_count = 3, sample_size = 1)]
fn kanban_by_diagrams(bencher: Bencher, cards: usize) {
    let model = kanban(cards);
    bencher.bench_local(|| symbolic::count(&model, 256 << 20).unwrap().markings);
}

/// 40 places and 40 transitions, 2,187 markings: from the compiled net to the verdict.
#[divan::bench]
fn whole_check_of_a_robots_net(bencher: Bencher) {
    let nets = [net(&philosophers(7))];
    let options = Options {
        engines: Engines::Both,
        ..Options::new(Rule::Closed, Limits::default())
    };
    bencher.bench_local(|| prove(&nets, &options, &mut |_| {}).unwrap().verdict);
}
