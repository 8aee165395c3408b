//! The plot of a game against a person (SORMA technical report, section 2.1.2), as a state machine: wait, see, accept or reject with
//! a reason, think, carry, verify, and so on until the game is over.
//!
//! It moves nothing and sees nothing. Whoever runs it tells it what was seen, thought and carried, and does what it answers.

use std::collections::VecDeque;

use crate::{
    board::{Colour, Position},
    carries::{Carry, Heaps, Place},
    game::{Game, Status},
    moves::Move,
    notation::Refusal,
    rules::Variant,
    watch::{Look, Verdict, Watch},
};

/// What is to be done next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Next {
    /// Look at the board: the person is to move, or has not finished.
    Look,
    /// Look at these squares again, from elsewhere.
    LookAgain(Vec<u8>),
    /// Say why the move is not accepted, show these squares, and look.
    Reject(String, Vec<u8>),
    /// Think about the position, and answer with [`Plot::thought`].
    Think,
    /// Carry this, and answer with [`Plot::carried`].
    Carry(Carry),
    /// Look whether the board is as it should be.
    Verify,
    /// These squares are not as they should be: call for help, then look.
    Wrong(Vec<u8>),
    /// The game is over.
    Over(Status),
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Phase {
    /// The person moves.
    Person,
    /// A move is sought.
    Thinking,
    /// What is still to be carried, the present carry first.
    Carrying(VecDeque<Carry>),
    /// The board is compared with the game.
    Verifying,
}

/// A game against a person.
#[derive(Debug, Clone)]
pub struct Plot {
    game: Game,
    /// The side of whoever carries.
    ours: Colour,
    heaps: Heaps,
    watch: Watch,
    phase: Phase,
}

impl Plot {
    /// A new game; `ours` is the side that is thought and carried for.
    #[must_use]
    pub fn new(game: Game, ours: Colour, watch: Watch) -> Self {
        let phase = if game.position().turn == ours {
            Phase::Thinking
        } else {
            Phase::Person
        };
        Self {
            game,
            ours,
            heaps: Heaps::default(),
            watch,
            phase,
        }
    }

    /// The game.
    #[must_use]
    pub const fn game(&self) -> &Game {
        &self.game
    }

    /// The captured discs.
    #[must_use]
    pub const fn heaps(&self) -> Heaps {
        self.heaps
    }

    /// What is to be done now.
    #[must_use]
    pub fn next(&self) -> Next {
        match &self.phase {
            Phase::Carrying(carries) => match carries.front() {
                Some(carry) => Next::Carry(*carry),
                None => Next::Verify,
            },
            Phase::Verifying => Next::Verify,
            // What was carried to the end is seen before the game is over.
            _ if self.game.status() != Status::Playing => Next::Over(self.game.status()),
            Phase::Person => Next::Look,
            Phase::Thinking => Next::Think,
        }
    }

    /// Takes a look at the board.
    pub fn see(&mut self, look: &Look) -> Next {
        match &self.phase {
            Phase::Person if self.game.status() == Status::Playing => self.see_person(look),
            Phase::Verifying => self.verify(look),
            _ => self.next(),
        }
    }

    fn see_person(&mut self, look: &Look) -> Next {
        let before = *self.game.position();
        match self.watch.see(look, &before, self.game.variant()) {
            Verdict::NotFinal | Verdict::Waiting => Next::Look,
            Verdict::Unsure(squares) => Next::LookAgain(squares),
            Verdict::Rejected(reason, squares) => Next::Reject(reason, squares),
            Verdict::Accepted(step) => {
                self.watch.again();
                if let Err(refusal) = self.game.make(step) {
                    return Next::Reject(refusal.to_string(), Vec::new());
                }
                // The person has carried the piece and what it captured; a crown is stacked for the person.
                let crown = self
                    .take_heaps(&before, step)
                    .into_iter()
                    .filter(|carry| matches!(carry.to, Place::Square(_, 1)));
                let crown: VecDeque<Carry> = crown.collect();
                self.phase = if crown.is_empty() {
                    Phase::Thinking
                } else {
                    Phase::Carrying(crown)
                };
                self.next()
            }
        }
    }

    fn verify(&mut self, look: &Look) -> Next {
        if look.hand {
            return Next::Verify;
        }
        let position = *self.game.position();
        let expected = Look::at(&position);
        let pairs = (0..).zip(look.squares.iter().zip(&expected.squares));
        let (mut wrong, mut unsure) = (Vec::new(), Vec::new());
        for (square, (seen, expected)) in pairs {
            if seen.confidence < self.watch.sure || seen.confidence.is_nan() {
                unsure.push(square);
            } else if seen.piece != expected.piece {
                wrong.push(square);
            }
        }
        if !wrong.is_empty() {
            return Next::Wrong(wrong);
        }
        if !unsure.is_empty() {
            return Next::LookAgain(unsure);
        }
        self.watch.again();
        self.phase = if position.turn == self.ours {
            Phase::Thinking
        } else {
            Phase::Person
        };
        self.next()
    }

    /// Takes the move that was thought of.
    ///
    /// # Errors
    /// Nothing is thought about now, or the move is not legal.
    pub fn thought(&mut self, step: Move) -> Result<Next, Refusal> {
        if self.next() != Next::Think {
            return Err(Refusal("no move is sought now".to_owned()));
        }
        let before = *self.game.position();
        self.game.make(step)?;
        let carries = self.take_heaps(&before, step);
        self.phase = Phase::Carrying(carries.into());
        Ok(self.next())
    }

    /// The carry that was asked for is done.
    ///
    /// # Errors
    /// Nothing is carried now.
    pub fn carried(&mut self) -> Result<Next, Refusal> {
        let Phase::Carrying(carries) = &mut self.phase else {
            return Err(Refusal("nothing is carried now".to_owned()));
        };
        carries.pop_front();
        if carries.is_empty() {
            self.phase = Phase::Verifying;
        }
        Ok(self.next())
    }

    /// The person gives up, or we do.
    pub fn resign(&mut self, side: Colour) -> Next {
        self.game.resign(side);
        self.next()
    }

    /// A new game from the first position; the discs are set up by whoever asks for it.
    pub fn new_game(&mut self, variant: Variant, ours: Colour) -> Next {
        *self = Self::new(Game::new(variant), ours, self.watch.clone());
        self.watch.again();
        self.next()
    }

    /// The carries of a move, which change the heaps.
    fn take_heaps(&mut self, before: &Position, step: Move) -> Vec<Carry> {
        let routes = before.routes(self.game.variant());
        let route = routes.iter().find(|route| route.step == step);
        route
            .map(|route| self.heaps.carries(before, route))
            .unwrap_or_default()
    }
}

#[cfg(test)]
mod tests;
