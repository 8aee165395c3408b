//! What the player knows of a game: plain data, stored as it is.

use checkers::{Game, Move, Refusal};
use serde::{Deserialize, Serialize};

use crate::wire::{Errand, Gaze, Hue, Why};

/// Discs of each colour that are no part of the game at its beginning.
pub const SPARE: u8 = 12;

/// What is expected next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// People set up the discs.
    Setting,
    /// The person moves.
    Person,
    /// The robot moves, or stacks a crown.
    Robot,
}

/// What is still to be carried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Task {
    /// What to do with the disc.
    pub from: End,
    /// Where it comes to stand.
    pub to: End,
    /// One disc or two.
    pub discs: u8,
    /// Whose disc it is.
    pub hue: Hue,
}

impl Task {
    /// A disc that is pushed to the middle of its square.
    pub(crate) const fn push(square: u8, hue: Hue) -> Self {
        Self {
            from: End::Square(square, 0),
            to: End::Square(square, 0),
            discs: 1,
            hue,
        }
    }

    /// Whether it is one.
    pub(crate) fn is_push(&self) -> bool {
        self.from == self.to
    }
}

/// An end of a carry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// A square, and how many discs stand beneath.
    Square(u8, u8),
    /// The tray of captured discs, or the spare ones when it is empty.
    Tray,
    /// Nobody knows: it slipped out of the hand.
    Lost,
}

/// A move as it is stored: from, to, whether crowned, and what was captured.
pub type Step = (u8, u8, bool, u32);

/// A stored move.
pub fn step_of((from, to, crowned, captured): Step) -> Move {
    Move {
        from,
        to,
        crowned,
        captured,
    }
}

/// A game after moves that were stored; `game` is as it begins.
///
/// # Errors
/// One of them is not legal.
pub fn replayed(mut game: Game, moves: &[Step]) -> Result<Game, Refusal> {
    for step in moves {
        game.make(step_of(*step))?;
    }
    Ok(game)
}

/// A game as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The first position, FEN.
    pub start: String,
    pub moves: Vec<Step>,
    /// How it ended otherwise than by the rules: who gave up; `None` inside when both agreed.
    pub ended: Option<Option<Hue>>,
    /// What is expected next.
    pub phase: Phase,
    /// The present carry first.
    pub tasks: Vec<Task>,
    /// The squares where White's and Black's discs should stand now.
    pub expected: [u32; 2],
    /// Discs in each place of the trays of White's and Black's discs, and those that are no part of the game.
    pub trays: [Vec<u8>; 2],
    pub spare: [u8; 2],
    /// The errand in work.
    pub errand: Errand,
    /// What is to be said, and the number of it.
    pub words: Vec<String>,
    pub said: u32,
    /// What was said last, and how many looks ago.
    pub last: (String, u32),
    /// The wish that was taken up last.
    pub wish: u32,
    /// From which pose it looks, and how often it has looked again.
    pub gaze: u8,
    /// What vision was told of it last.
    pub told: Option<Gaze>,
    pub again: u32,
    /// How often crooked discs were pushed since all stood well.
    pub pushed: u32,
    /// How often what was lost has been looked for, and where it lies.
    pub searched: u32,
    pub found: Option<[f64; 2]>,
    /// How often the hand found nothing.
    pub missed: u32,
    /// Whether it holds something, and what kept the arm from its way last.
    pub holds: bool,
    pub why: Option<Why>,
    /// What the look was good for.
    pub moved: bool,
    pub ready: bool,
    /// The squares that the laser shows with the words, and what people are asked to do in a dry run.
    pub shown: Vec<u8>,
    pub asked: Option<String>,
    /// Where discs stand, in the board's frame.
    pub places: Vec<[f64; 2]>,
}
