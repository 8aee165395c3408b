//! The game of checkers on 8x8 boards: rules of seven variants, search, endgame tables, FEN and PDN.
//!
//! The engine alone: it knows no robot, no camera, no task and no clock. What plays with it says when a search stops.

mod board;
mod capture;
mod carries;
mod ending;
mod evaluate;
mod fen;
mod game;
mod judge;
mod moves;
mod notation;
pub mod pdn;
mod perft;
mod rules;
mod search;
#[cfg(test)]
mod table;
mod tables;
mod watch;

pub use board::{Colour, Piece, Position, Squares, each};
pub use carries::{Carry, Heaps, Place};
pub use ending::Ending;
pub use game::{Drawn, Game, Status, Won};
pub use moves::{Move, MoveList, Route};
pub use notation::{LONGEST, Numbering, Refusal, TextError, Written};
pub use perft::{DEEPEST, Leaves, MOST_LEAVES, perft};
pub use rules::{DrawRules, Variant};
pub use search::{Found, Limits, PROVEN, WON, search};
pub use tables::{MOST_PIECES, Outcome, TableError, Tables, file_name};
pub use watch::{Look, Sight, Verdict, Watch};
