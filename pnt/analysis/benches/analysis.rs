//! Markings per second of the explicit state space, on one thread and two. Also counting by
//! decision diagrams, and the whole check of a net as large as a robot's.
//!
//! With `-- threads`, instead of all this: one thread and two in turns, wall and processor time, and the
//! ratios.
//!
//! Peers and their figures stand in `docs/benchmarks.md`.

#![allow(
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    clippy::print_stdout,
    reason = "a benchmark may end when its input is wrong; its figures are rounded"
)]

use std::{
    collections::{HashSet, VecDeque},
    fmt::Write as _,
    sync::Arc,
};

use ctos::{diagnostic::Source, time::Clock};
use divan::{Bencher, counter::ItemsCount};
use pnt_analysis::{
    analysis::{
        explicit::{Limits, explore},
        model::{Model, Place, Transition},
        stop::Stop,
        symbolic,
        verdict::Engines,
    },
    check::{Options, Rule, prove},
    compose::System,
};
use pnt_language::{compile, net::Net};

const EFFORT: symbolic::Effort = symbolic::Effort {
    bytes: 256 << 20,
    steps: u64::MAX,
};

fn main() {
    if std::env::args().any(|word| word == "threads") {
        compare_threads("Kanban with 5 cards", &kanban(5), usize::MAX);
        compare_threads("400 places, 1,000 transitions", &wide(), 300_000);
    } else {
        divan::main();
    }
}

/// Wall and processor time of a listing, ms.
fn listed(model: &Model, markings: usize, threads: usize) -> [f64; 2] {
    let limits = Limits {
        markings,
        threads,
        ..Limits::default()
    };
    let clock = Clock::real();
    let processor = || {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
    };
    let (wall, used) = (clock.now(), processor());
    divan::black_box(explore(model, &limits).markings);
    let wall = (clock.now() - wall).as_secs_f64() * 1e3;
    [wall, processor() - used]
}

fn median(of: impl Iterator<Item = f64>) -> f64 {
    let mut all: Vec<f64> = of.collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// Lists a state space on one thread and on two, in turns.
fn compare_threads(name: &str, model: &Model, markings: usize) {
    let round = |_| [1, 2].map(|threads| listed(model, markings, threads));
    let rounds: Vec<[[f64; 2]; 2]> = (0..11).map(round).collect();
    let of = |threads: usize, what: usize| median(rounds.iter().map(|r| r[threads][what]));
    println!(
        "{name}, medians of {} rounds: one thread {:.0} ms, two threads {:.0} ms",
        rounds.len(),
        of(0, 0),
        of(1, 0)
    );
    println!(
        "  two threads are {:.2} times as fast, and take {:.2} of the processor time ({:.0} and {:.0} ms)",
        median(rounds.iter().map(|r| r[0][0] / r[1][0])),
        median(rounds.iter().map(|r| r[1][1] / r[0][1])),
        of(0, 1),
        of(1, 1)
    );
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

/// 400 places and 1,000 transitions, one-safe: 40 tokens, each on a ring of ten places of its own.
/// There is a step and a jump at each place, and 200 transitions move two neighbours together.
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

/// The peer: every marking a vector of bytes in the standard library's hash set, every transition tried.
fn plain_hash_set(model: &Model) -> usize {
    let byte = |tokens: u32| u8::try_from(tokens).unwrap();
    let transitions: Vec<_> = model
        .transitions
        .iter()
        .map(|transition| (transition.needs(), transition.changes()))
        .collect();
    let first: Box<[u8]> = model.initial().into_iter().map(byte).collect();
    let mut seen = HashSet::from([first.clone()]);
    let mut open = VecDeque::from([first]);
    while let Some(marking) = open.pop_front() {
        for (needs, changes) in &transitions {
            let held = |place: u32| u32::from(marking[place as usize]);
            if needs.iter().any(|(place, weight)| held(*place) < *weight) {
                continue;
            }
            let mut next = marking.clone();
            for (place, change) in changes {
                let tokens = &mut next[*place as usize];
                *tokens = u8::try_from(i64::from(*tokens) + change).unwrap();
            }
            if !seen.contains(&next) {
                seen.insert(next.clone());
                open.push_back(next);
            }
        }
    }
    seen.len()
}

/// Items are markings.
#[divan::bench(sample_count = 3, sample_size = 1)]
fn kanban_5_by_a_plain_hash_set(bencher: Bencher) {
    let model = kanban(5);
    bencher
        .counter(ItemsCount::new(2_546_432_usize))
        .bench_local(|| assert_eq!(plain_hash_set(&model), 2_546_432));
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
    bencher.bench_local(|| {
        symbolic::count(&model, EFFORT, Stop::default())
            .unwrap()
            .markings
    });
}

#[divan::bench(args = [5, 10], sample_count = 3, sample_size = 1)]
fn kanban_by_diagrams(bencher: Bencher, cards: usize) {
    let model = kanban(cards);
    bencher.bench_local(|| {
        symbolic::count(&model, EFFORT, Stop::default())
            .unwrap()
            .markings
    });
}

/// From the texts to the verdict, as `ctos net check` does it, with every command by itself.
fn whole_check(texts: &[String]) -> u128 {
    let nets: Vec<Arc<Net>> = texts.iter().map(|text| net(text)).collect();
    let rule = match Rule::of(&nets) {
        Rule::Rest => Rule::Rest,
        Rule::Alone | Rule::Closed => Rule::Closed,
    };
    let options = Options {
        engines: Engines::Both,
        workflows: rule == Rule::Rest,
        ..Options::new(rule, Limits::default())
    };
    let proof = prove(&nets, &options, &mut |_| {}).unwrap();
    proof.verdict.markings
}

fn configured(names: &str) -> Vec<String> {
    let read = |name: &str| {
        let path = format!(
            "{}/../../configs/nets/{name}.net",
            env!("CARGO_MANIFEST_DIR")
        );
        std::fs::read_to_string(path).unwrap()
    };
    names.split(' ').map(read).collect()
}

/// The nets of the configurations; the first are one system of 78 nodes.
#[divan::bench(args = ["dispatcher motion vision", "cell", "hello"])]
fn whole_check_of_configured_nets(bencher: Bencher, names: &str) {
    let texts = configured(names);
    bencher.bench_local(|| whole_check(&texts));
}

/// As many places as transitions: 70 nodes and 2,187 markings, 80 and 6,561, 100 and 59,049.
#[divan::bench(args = [7, 8, 10])]
fn whole_check_of_philosophers(bencher: Bencher, count: usize) {
    let texts = [philosophers(count)];
    bencher.bench_local(|| whole_check(&texts));
}
