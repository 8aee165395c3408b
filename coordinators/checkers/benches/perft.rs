//! What the generator of moves costs: leaves of the tree of the first position; what endgame tables cost, and a search.

use checkers::{Leaves, Limits, MOST_PIECES, Position, Tables, Variant, perft, search};
use divan::{Bencher, counter::ItemsCount};

fn main() {
    divan::main();
}

#[divan::bench(args = Variant::ALL, sample_count = 3)]
fn leaves(bencher: Bencher, variant: Variant) {
    const DEPTH: u32 = 9;
    let start = Position::start(variant.starts());
    let count = || perft(&start, variant, DEPTH, Leaves::Moves).unwrap_or_default();
    bencher.counter(ItemsCount::new(count())).bench(count);
}

#[divan::bench(args = [Variant::Brazilian, Variant::English], sample_count = 1)]
fn tables(variant: Variant) -> Tables {
    Tables::make(variant, MOST_PIECES)
}

#[divan::bench(args = [Variant::Brazilian, Variant::English], sample_count = 3)]
fn positions_searched(bencher: Bencher, variant: Variant) {
    const NODES: u64 = 1_000_000;
    let start = Position::start(variant.starts());
    bencher.counter(ItemsCount::new(NODES)).bench(|| {
        let limits = Limits {
            nodes: Some(NODES),
            depth: 99,
            stop: &mut || false,
        };
        search(&start, variant, &[], None, limits)
    });
}
