//! How many games there are from a position: the number that shows whether a generator of moves is right.

use crate::{
    board::Position,
    moves::MoveList,
    rules::{Rules, Variant},
};

/// More leaves are not counted.
pub const MOST_LEAVES: u64 = 20_000_000_000;

/// The deepest count.
pub const DEEPEST: u32 = 40;

/// What a count of leaves tells apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leaves {
    /// A move is from, to and the set of captured squares.
    Moves,
    /// Two orders of the same captures are two moves.
    Orders,
}

/// The number of sequences of `depth` legal moves; `None` when it is more than [`MOST_LEAVES`], or [`DEEPEST`] is passed.
#[must_use]
pub fn perft(position: &Position, variant: Variant, depth: u32, leaves: Leaves) -> Option<u64> {
    if depth > DEEPEST {
        return None;
    }
    let mut counter = Counter {
        rules: variant.rules(),
        variant,
        leaves,
        total: 0,
        visited: 0,
        scratch: MoveList::new(),
    };
    counter.visit(position, depth);
    (counter.total.max(counter.visited) <= MOST_LEAVES).then_some(counter.total)
}

struct Counter {
    rules: Rules,
    variant: Variant,
    leaves: Leaves,
    total: u64,
    visited: u64,
    scratch: MoveList,
}

impl Counter {
    fn visit(&mut self, position: &Position, depth: u32) {
        self.visited += 1;
        if self.total.max(self.visited) > MOST_LEAVES {
            return;
        }
        match (depth, self.leaves) {
            (0, _) => self.total += 1,
            (1, Leaves::Moves) => self.total += position.count(&self.rules, &mut self.scratch),
            (1, Leaves::Orders) => self.total += position.count_routes(&self.rules),
            (_, Leaves::Moves) => {
                for step in position.moves(self.variant) {
                    self.visit(&position.after(step), depth - 1);
                }
            }
            (_, Leaves::Orders) => {
                for route in position.routes(self.variant) {
                    self.visit(&position.after(route.step), depth - 1);
                }
            }
        }
    }
}
