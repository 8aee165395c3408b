//! Firings per second of the executor, beside what a hand-written loop over the same marking takes (the
//! limit of memory and arithmetic). A firing must cost the
//! same in small and in large nets, with few tokens and with many.

#![allow(
    clippy::unwrap_used,
    reason = "a benchmark may end when its input is wrong"
)]

use std::{
    fmt::Write as _,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use crossbeam_queue::ArrayQueue;
use ctos::diagnostic::Source;
use divan::{Bencher, black_box, counter::ItemsCount};
use pnt_language::{
    compile,
    exec::{Conflicts, Execution, FiringId, Race},
    net::{Net, TransitionId},
};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// Firings of one sample.
const FIRINGS: usize = 1_000_000;

/// Events that are kept while the log is on.
const LOG_ROOM: usize = 1024;

fn main() {
    divan::main();
}

fn net(text: &str) -> Arc<Net> {
    Arc::new(compile::net(&Source::new("bench.net", text)).unwrap())
}

/// A ring of transitions with its tokens spread evenly over the places.
fn ring(length: usize, tokens: usize, more: &str) -> Arc<Net> {
    let mut text = String::from("net ring\n");
    for index in 0..length {
        let here = (index + 1) * tokens / length - index * tokens / length;
        let next = (index + 1) % length;
        let _ = writeln!(
            text,
            "place p{index} = {here}\ntransition t{index}\n  in p{index}\n  out p{next}\n{more}"
        );
    }
    net(&text)
}

/// Fires whatever is chosen.
fn run(execution: &mut Execution, conflicts: &mut Conflicts, firings: usize) {
    for _ in 0..firings {
        if let Some(id) = execution.choose(conflicts, |_| true) {
            black_box(execution.fire(id).unwrap());
        }
    }
}

const SIZES: [(usize, usize); 9] = [
    (10, 1),
    (10, 100),
    (10, 100_000),
    (100, 10),
    (1_000, 1),
    (1_000, 1_000),
    (10_000, 100),
    (100_000, 1),
    (100_000, 100_000),
];

/// Recording off; arguments are transitions and tokens.
#[divan::bench(args = SIZES, sample_count = 5)]
fn inline(bencher: Bencher, (length, tokens): (usize, usize)) {
    let mut execution = Execution::new(ring(length, tokens, ""));
    bencher.counter(ItemsCount::new(FIRINGS)).bench_local(|| {
        run(&mut execution, &mut Conflicts::Declared, FIRINGS);
    });
}

/// With the event log.
#[divan::bench(args = SIZES, sample_count = 5)]
fn inline_with_log(bencher: Bencher, (length, tokens): (usize, usize)) {
    let mut execution = Execution::new(ring(length, tokens, ""));
    execution.record_events(LOG_ROOM);
    bencher.counter(ItemsCount::new(FIRINGS)).bench_local(|| {
        run(&mut execution, &mut Conflicts::Declared, FIRINGS);
    });
}

/// Conflicts decided by chance among all enabled ones.
#[divan::bench(args = SIZES, sample_count = 5)]
fn by_chance(bencher: Bencher, (length, tokens): (usize, usize)) {
    let mut execution = Execution::new(ring(length, tokens, ""));
    let mut conflicts = Conflicts::Random(Box::new(ChaCha8Rng::seed_from_u64(1)));
    bencher.counter(ItemsCount::new(FIRINGS)).bench_local(|| {
        run(&mut execution, &mut conflicts, FIRINGS);
    });
}

/// Every firing is started and completed.
#[divan::bench(args = SIZES, sample_count = 5)]
fn two_phases(bencher: Bencher, (length, tokens): (usize, usize)) {
    let mut execution = Execution::new(ring(length, tokens, "  do something\n"));
    bencher.counter(ItemsCount::new(FIRINGS)).bench_local(|| {
        for _ in 0..FIRINGS {
            if let Some(id) = execution.choose(&mut Conflicts::Declared, |_| true) {
                let firing = execution.start(id).unwrap();
                black_box(execution.complete(firing).unwrap());
            }
        }
    });
}

/// Actions that are done by worker threads (arguments: how many). The net's thread starts firings and
/// completes those that come back; the workers take what is started. The actions themselves do nothing.
#[divan::bench(args = [1, 2], sample_count = 5)]
fn through_workers(bencher: Bencher, workers: usize) {
    let mut execution = Execution::new(ring(100, 1_000, "  do something\n"));
    let started: ArrayQueue<(FiringId, TransitionId)> = ArrayQueue::new(1024);
    let ended: ArrayQueue<(FiringId, bool)> = ArrayQueue::new(1024);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    while let Some((firing, id)) = started.pop() {
                        let succeeded = black_box(id.index()) != usize::MAX;
                        ended.push((firing, succeeded)).unwrap();
                    }
                    std::thread::yield_now();
                }
            });
        }
        bencher.counter(ItemsCount::new(FIRINGS)).bench_local(|| {
            let (mut begun, mut done) = (0, 0);
            while done < FIRINGS {
                while begun < FIRINGS && begun - done < 1024 {
                    let Some(id) = execution.choose(&mut Conflicts::Declared, |_| true) else {
                        break;
                    };
                    started.push((execution.start(id).unwrap(), id)).unwrap();
                    begun += 1;
                }
                while let Some((firing, succeeded)) = ended.pop() {
                    assert!(succeeded);
                    black_box(execution.complete(firing).unwrap());
                    done += 1;
                }
            }
        });
        over.store(true, Ordering::Relaxed);
    });
}

/// Every transition takes an exponential time; the race decides.
#[divan::bench(args = [(10, 1), (10, 100), (1_000, 100), (100_000, 10)], sample_count = 5)]
fn timed(bencher: Bencher, (length, tokens): (usize, usize)) {
    let mut execution = Execution::new(ring(length, tokens, "  time exponential 1 ms\n"));
    let mut race = Race::new(&execution, ChaCha8Rng::seed_from_u64(1));
    bencher.counter(ItemsCount::new(FIRINGS)).bench_local(|| {
        for _ in 0..FIRINGS {
            race.refresh(&mut execution, |_| true);
            let next = race.next(&execution).unwrap();
            execution.advance_to(next.due_ns);
            let id = race.pop(&execution).unwrap();
            black_box(execution.fire(id).unwrap());
        }
    });
}

/// What the same ring costs when a loop is written for it by hand. Which transition fires is known
/// before, and nothing but the marking is kept.
#[divan::bench(args = [(10, 1), (1_000, 1), (100_000, 1)], sample_count = 5)]
fn by_hand(bencher: Bencher, (length, tokens): (usize, u32)) {
    let mut marking = vec![0_u32; length];
    marking[0] = tokens;
    bencher.counter(ItemsCount::new(FIRINGS)).bench_local(|| {
        let mut at = 0;
        for _ in 0..FIRINGS {
            let next = if at + 1 == length { 0 } else { at + 1 };
            let marking = black_box(&mut marking);
            if marking[at] > 0 {
                marking[at] -= 1;
                marking[next] += 1;
            }
            at = next;
        }
    });
}
