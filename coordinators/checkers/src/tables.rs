//! Endgame tables: for all positions of few pieces who wins, and in how many half-moves, by retrograde analysis.
//!
//! A position is looked up as White's to move; Black's is turned by half. The rules of draws (repetition, moves of kings only)
//! are not known to the tables.

mod file;
mod index;
mod retrograde;

pub use file::{TableError, file_name};

use crate::{
    board::{Colour, Position},
    moves::Move,
    rules::Variant,
    search::Found,
};
use index::Index;

/// Tables are made for so many pieces at most.
pub const MOST_PIECES: u32 = 4;

/// A line of the tables is shown so far, half-moves.
const LONGEST_LINE: usize = 40;

/// How a game ends when both play their best, for the side that moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Nobody wins.
    Draw,
    /// The side that moves wins in so many half-moves.
    Won(u8),
    /// The side that moves loses in so many half-moves.
    Lost(u8),
}

/// The tables of a variant.
pub struct Tables {
    variant: Variant,
    index: Index,
    /// By index: 0 for a draw, or the half-moves to the end and 1. Even half-moves are a loss.
    values: Vec<u8>,
}

impl Tables {
    /// Makes the tables for up to `pieces` pieces, 2 to [`MOST_PIECES`].
    #[must_use]
    pub fn make(variant: Variant, pieces: u32) -> Self {
        let index = Index::new(pieces.clamp(2, MOST_PIECES));
        let values = retrograde::values(variant, &index);
        Self {
            variant,
            index,
            values,
        }
    }

    /// Whose rules they are of.
    #[must_use]
    pub const fn variant(&self) -> Variant {
        self.variant
    }

    /// How many pieces their positions have at most.
    #[must_use]
    pub const fn pieces(&self) -> u32 {
        self.index.pieces()
    }

    /// How a position ends; `None` when the tables do not have it.
    #[must_use]
    pub fn outcome(&self, position: &Position) -> Option<Outcome> {
        if position.pieces() > self.index.pieces() {
            return None;
        }
        let place = self.index.place(&to_white(position))?;
        Some(decoded(*self.values.get(place)?))
    }

    /// The best move by the tables, and the line that follows.
    pub(crate) fn found(&self, position: &Position) -> Option<Found> {
        let value = self.outcome(position)?.value(0);
        let mut line = Vec::new();
        let mut nodes = 0;
        let mut at = *position;
        while line.len() < LONGEST_LINE {
            let moves = at.moves(self.variant);
            nodes += moves.len() as u64;
            let worth = |step: &Move| {
                self.outcome(&at.after(*step))
                    .map(|outcome| outcome.value(0))
            };
            let Some(best) = moves.iter().min_by_key(|step| worth(step)) else {
                break;
            };
            line.push(*best);
            at = at.after(*best);
            if self.outcome(&at) == Some(Outcome::Draw) {
                break;
            }
        }
        let depth = u32::try_from(line.len()).unwrap_or_default();
        Some(Found {
            line,
            value,
            depth,
            nodes,
        })
    }
}

const fn decoded(value: u8) -> Outcome {
    match value {
        0 => Outcome::Draw,
        _ if value % 2 == 1 => Outcome::Lost(value - 1),
        _ => Outcome::Won(value - 1),
    }
}

fn to_white(position: &Position) -> Position {
    match position.turn {
        Colour::White => *position,
        Colour::Black => position.turned(),
    }
}

#[cfg(test)]
mod tests;
