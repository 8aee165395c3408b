//! A game that is being played: its moves, whose turn it is, and how it ends.

use crate::{
    board::{Colour, Position},
    ending::Ending,
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
    /// Nobody won this ending in time.
    Ending(Ending),
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
    /// The endings that the position is, and the half-moves since each arose.
    endings: Vec<(Ending, u32)>,
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
            endings: Ending::of(&start, variant.draws())
                .map(|ending| (ending, 0))
                .collect(),
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
        let before = std::mem::take(&mut self.endings);
        let count = |ending: Ending| {
            let mut before = before.iter();
            let found = before.find(|(other, _)| *other == ending);
            (ending, found.map_or(0, |(_, count)| count + 1))
        };
        let endings = Ending::of(&self.position, self.variant.draws());
        self.endings = endings.map(count).collect();
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
        let over = |(ending, count): &&(Ending, u32)| {
            ending.most(draws).is_some_and(|most| *count >= most)
        };
        if let Some((ending, _)) = self.endings.iter().find(over) {
            return Status::Drawn(Drawn::Ending(*ending));
        }
        let quiet = u32::try_from(self.keys.len() - 1).unwrap_or(u32::MAX);
        if quiet >= draws.quiet {
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

#[cfg(test)]
mod tests;
