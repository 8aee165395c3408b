//! Firings per second of the executor, for chains of transitions with tokens flowing through.
//! The executor must not get slower with the net's size or
//! the number of tokens.

#![allow(
    clippy::unwrap_used,
    reason = "a benchmark may end when its input is wrong"
)]

use std::{fmt::Write as _, sync::Arc};

use ctos::diagnostic::Source;
use divan::{Bencher, black_box, counter::ItemsCount};
use pnt::{
    compile,
    exec::{Conflicts, Execution},
    net::Net,
};

fn main() {
    divan::main();
}

fn net(text: &str) -> Arc<Net> {
    Arc::new(compile::net(&Source::new("bench.net", text)).unwrap())
}

fn chain(length: usize, tokens: usize) -> Arc<Net> {
    let mut text = format!("net chain\nplace p0 = {tokens}\n");
    for index in 0..length {
        let next = index + 1;
        let _ = writeln!(
            text,
            "place p{next}\ntransition t{index}\n  in p{index}\n  out p{next}"
        );
    }
    net(&text)
}

/// Every token goes through the whole chain, one firing after the other.
#[divan::bench(args = [(10, 1), (10, 100), (10, 10_000), (100, 1), (100, 100), (100, 10_000), (1000, 1), (1000, 100)])]
fn chain_of_transitions_and_tokens(bencher: Bencher, (length, tokens): (usize, usize)) {
    let start = Execution::new(chain(length, tokens));
    bencher
        .counter(ItemsCount::new(length * tokens))
        .with_inputs(|| start.clone())
        .bench_local_refs(|execution| {
            let mut conflicts = Conflicts::Declared;
            while let Some(id) = execution.choose(&mut conflicts, |_| true) {
                black_box(execution.fire(id).unwrap());
            }
        });
}

/// The same in two phases: every firing is started and completed.
#[divan::bench(args = [(10, 100), (1000, 100)])]
fn two_phases(bencher: Bencher, (length, tokens): (usize, usize)) {
    let start = Execution::new(chain(length, tokens));
    bencher
        .counter(ItemsCount::new(length * tokens))
        .with_inputs(|| start.clone())
        .bench_local_refs(|execution| {
            let mut conflicts = Conflicts::Declared;
            while let Some(id) = execution.choose(&mut conflicts, |_| true) {
                let firing = execution.start(id).unwrap();
                black_box(execution.complete(firing).unwrap());
            }
        });
}
