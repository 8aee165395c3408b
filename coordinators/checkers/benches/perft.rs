//! What the generator of moves costs: leaves of the tree of the first position.

use checkers::{Leaves, Position, Variant, perft};
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
