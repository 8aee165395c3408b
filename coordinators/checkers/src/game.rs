//! A game that is being played: its moves, whose turn it is, and how it ends.

use crate::{
    board::{Colour, Position},
    moves::Move,
    notation::{Numbering, Refusal, Written},
    pdn::Record,
    rules::Variant,
};

/// Why a game has ended without a winner.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawn {
    /// The position occurred three times.
    Repetition,
    /// Kings only moved for too long.
    QuietKings,
    /// Three kings did not win against one in time.
    ThreeAgainstOne,
    /// Both agreed.
    Agreement,
}

/// Why a side has won.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Won {
    /// The other side has no move.
    NoMove,
    /// The other side gave up.
    Resigned,
}

/// How a game stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// It goes on.
    Playing,
    /// A side has won.
    Won(Colour, Won),
    /// Nobody has won.
    Drawn(Drawn),
}

/// A game.
#[derive(Debug, Clone)]
pub struct Game {
    variant: Variant,
    start: Position,
    moves: Vec<Move>,
    position: Position,
    /// The keys of the positions since the last capture or move of a man, with this one.
    keys: Vec<u64>,
    /// Half-moves since three kings stood against one.
    three: Option<u32>,
    ended: Option<Status>,
}

impl Game {
    /// A new game from the first position.
    #[must_use]
    pub fn new(variant: Variant) -> Self {
        Self::from(variant, Position::start(variant.starts()))
    }

    /// A new game from a position.
    #[must_use]
    pub fn from(variant: Variant, start: Position) -> Self {
        Self {
            variant,
            start,
            moves: Vec::new(),
            position: start,
            keys: vec![start.key()],
            three: three_against_one(&start).then_some(0),
            ended: None,
        }
    }

    /// The rules.
    #[must_use]
    pub const fn variant(&self) -> Variant {
        self.variant
    }

    /// How the board stands.
    #[must_use]
    pub const fn position(&self) -> &Position {
        &self.position
    }

    /// What was played.
    #[must_use]
    pub fn moves(&self) -> &[Move] {
        &self.moves
    }

    /// The keys of earlier positions that can occur again, for [`search`](crate::search).
    #[must_use]
    pub fn before(&self) -> &[u64] {
        self.keys.split_last().map_or(&[], |(_, before)| before)
    }

    /// Plays a move that is written.
    ///
    /// # Errors
    /// The rule that it breaks; the game is as before.
    pub fn play(&mut self, written: &Written, numbering: Numbering) -> Result<Move, Refusal> {
        let step = self.position.find(written, self.variant, numbering)?;
        self.make(step)?;
        Ok(step)
    }

    /// Plays a move.
    ///
    /// # Errors
    /// The game has ended, or the move is not one of its list.
    pub fn make(&mut self, step: Move) -> Result<(), Refusal> {
        if self.status() != Status::Playing {
            return Err(Refusal("the game is over".to_owned()));
        }
        if !self.position.moves(self.variant).contains(&step) {
            return Err(Refusal("this is no legal move".to_owned()));
        }
        if self.position.lasting(step) {
            self.keys.clear();
        }
        self.position = self.position.after(step);
        self.keys.push(self.position.key());
        self.three = match (three_against_one(&self.position), self.three) {
            (false, _) => None,
            (true, None) => Some(0),
            (true, Some(count)) => Some(count + 1),
        };
        self.moves.push(step);
        Ok(())
    }

    /// Takes the last move back; says whether there was one. A result that was agreed is taken back first.
    pub fn take_back(&mut self) -> bool {
        if self.ended.take().is_some() {
            return true;
        }
        let mut moves = std::mem::take(&mut self.moves);
        let some = moves.pop().is_some();
        let mut again = Self::from(self.variant, self.start);
        for step in moves {
            if again.make(step).is_err() {
                break;
            }
        }
        *self = again;
        some
    }

    /// A side gives up.
    pub fn resign(&mut self, side: Colour) {
        if self.status() == Status::Playing {
            self.ended = Some(Status::Won(side.other(), Won::Resigned));
        }
    }

    /// Both agree that nobody wins.
    pub fn agree(&mut self) {
        if self.status() == Status::Playing {
            self.ended = Some(Status::Drawn(Drawn::Agreement));
        }
    }

    /// How the game stands.
    #[must_use]
    pub fn status(&self) -> Status {
        if let Some(ended) = self.ended {
            return ended;
        }
        if self.position.moves(self.variant).is_empty() {
            return Status::Won(self.position.turn.other(), Won::NoMove);
        }
        let draws = self.variant.draws();
        let now = self.position.key();
        if self.keys.iter().filter(|key| **key == now).count() >= draws.repetitions {
            return Status::Drawn(Drawn::Repetition);
        }
        let limit = |limit: u32, count: u32| count >= limit;
        if let (Some(most), Some(count)) = (draws.three_against_one, self.three)
            && limit(most, count)
        {
            return Status::Drawn(Drawn::ThreeAgainstOne);
        }
        let quiet = u32::try_from(self.keys.len() - 1).unwrap_or(u32::MAX);
        if limit(draws.quiet, quiet) {
            return Status::Drawn(Drawn::QuietKings);
        }
        Status::Playing
    }

    /// The game as a record; its result is White's first.
    #[must_use]
    pub fn record(&self) -> Record {
        let result = match self.status() {
            Status::Playing => "*",
            Status::Won(Colour::White, _) => "1-0",
            Status::Won(Colour::Black, _) => "0-1",
            Status::Drawn(_) => "1/2-1/2",
        };
        Record {
            tags: Vec::new(),
            variant: self.variant,
            start: self.start,
            moves: self.moves.clone(),
            result: result.to_owned(),
        }
    }
}

/// Three kings or more, and nothing else, against one king.
fn three_against_one(position: &Position) -> bool {
    let only_kings = (position.white | position.black) & !position.kings == 0;
    let (white, black) = (position.white.count_ones(), position.black.count_ones());
    only_kings && ((white >= 3 && black == 1) || (white == 1 && black >= 3))
}

#[cfg(test)]
mod tests;
