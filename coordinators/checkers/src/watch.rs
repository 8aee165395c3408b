//! Seeing what a person plays: pictures of the board against the positions that legal moves lead to (SORMA technical report,
//! section 2.1.2: a move is final when the board does not change any more; then it is accepted, or rejected with a reason).
//!
//! It knows no camera: a look is, for each square, what is seen there and how surely.

use crate::{
    board::{Colour, Position, Squares, bit, each},
    moves::Move,
    notation::{Numbering, Written},
    rules::Variant,
};

/// What is seen on a square.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// The colour of what stands there. Whether it is a king follows from the game.
    pub piece: Option<Colour>,
    /// How surely, 0 to 1.
    pub confidence: f64,
}

/// A look at the board: its 32 squares, and whether something is over it.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// By square.
    pub squares: [Sight; 32],
    /// Whether a hand, or anything else that is no piece, is seen.
    pub hand: bool,
}

impl Look {
    /// A look that sees a position as it is, surely.
    #[must_use]
    pub fn at(position: &Position) -> Self {
        let sight = |square: usize| {
            let piece = u8::try_from(square)
                .ok()
                .and_then(|square| position.piece(square));
            Sight {
                piece: piece.map(|piece| piece.colour),
                confidence: 1.0,
            }
        };
        Self {
            squares: std::array::from_fn(sight),
            hand: false,
        }
    }

    /// The squares that are seen surely, and the pieces of both colours among them.
    fn sure(&self, least: f64) -> Seen {
        let mut seen = Seen::default();
        for (square, sight) in (0..).zip(&self.squares) {
            // A confidence that is no number is none.
            if sight.confidence < least || sight.confidence.is_nan() {
                continue;
            }
            seen.sure |= bit(square);
            match sight.piece {
                Some(Colour::White) => seen.white |= bit(square),
                Some(Colour::Black) => seen.black |= bit(square),
                None => {}
            }
        }
        seen
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Seen {
    sure: Squares,
    white: Squares,
    black: Squares,
}

impl Seen {
    /// Whether a position can be what is seen.
    const fn may_be(&self, position: &Position) -> bool {
        position.white & self.sure == self.white && position.black & self.sure == self.black
    }
}

/// What a look says about the game.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// Not final yet: a hand is seen, or the board has changed since the last look.
    NotFinal,
    /// The board is as before: nobody has moved yet.
    Waiting,
    /// These squares are to be looked at again, from elsewhere: what was moved depends on them.
    Unsure(Vec<u8>),
    /// A legal move.
    Accepted(Move),
    /// No legal move: the rule in words, and the squares to show.
    Rejected(String, Vec<u8>),
}

/// Watches the board for a move.
#[derive(Debug, Clone)]
pub struct Watch {
    /// So many equal looks make a move final.
    pub looks: u32,
    /// A square that is seen less surely is unknown.
    pub sure: f64,
    last: Option<Seen>,
    equal: u32,
}

impl Default for Watch {
    fn default() -> Self {
        Self {
            looks: 2,
            sure: 0.8,
            last: None,
            equal: 0,
        }
    }
}

impl Watch {
    /// Forgets what it has seen: a new move is waited for.
    pub fn again(&mut self) {
        self.last = None;
        self.equal = 0;
    }

    /// Takes a look while the side that moves in `before` is to move a piece.
    pub fn see(&mut self, look: &Look, before: &Position, variant: Variant) -> Verdict {
        if look.hand {
            self.again();
            return Verdict::NotFinal;
        }
        let seen = look.sure(self.sure);
        self.equal = if self.last == Some(seen) {
            self.equal + 1
        } else {
            1
        };
        self.last = Some(seen);
        if self.equal < self.looks {
            return Verdict::NotFinal;
        }
        let moves = before.moves(variant);
        let reached: Vec<(Move, Position)> = (moves.iter())
            .map(|step| (*step, before.after(*step)))
            .filter(|(_, position)| seen.may_be(position))
            .collect();
        let same = seen.may_be(before);
        match reached.as_slice() {
            [] if same => Verdict::Waiting,
            [] => {
                let (reason, squares) = reason(before, &seen, variant);
                Verdict::Rejected(reason, squares)
            }
            [(first, _), ..] => {
                // Squares where the positions that it may be, and the one before, differ.
                let mut positions: Vec<&Position> = vec![before];
                positions.extend(reached.iter().map(|(_, position)| position));
                let unsure = differing(&positions) & !seen.sure;
                if unsure != 0 {
                    return Verdict::Unsure(each(unsure).collect());
                }
                // Several only when two pieces could make the same circle, which leads to the same position.
                Verdict::Accepted(*first)
            }
        }
    }
}

fn differing(positions: &[&Position]) -> Squares {
    let Some((first, rest)) = positions.split_first() else {
        return 0;
    };
    rest.iter().fold(0, |all, other| {
        all | (first.white ^ other.white) | (first.black ^ other.black)
    })
}

/// What was done instead of a legal move, in words, and the squares that show it.
fn reason(before: &Position, seen: &Seen, variant: Variant) -> (String, Vec<u8>) {
    let numbering = Numbering::of(variant);
    let list = |set: Squares| {
        let numbers: Vec<String> = each(set)
            .map(|square| numbering.number(square).to_string())
            .collect();
        numbers.join(", ")
    };
    let (own_seen, foe_seen) = match before.turn {
        Colour::White => (seen.white, seen.black),
        Colour::Black => (seen.black, seen.white),
    };
    let (own, foe) = (before.own() & seen.sure, before.foe() & seen.sure);
    let (gone, come) = (own & !own_seen, own_seen & !own);
    let (foe_gone, foe_come) = (foe & !foe_seen, foe_seen & !foe);
    let squares = |set: Squares| each(set).collect::<Vec<u8>>();
    let (turn, other) = (before.turn.name(), before.turn.other().name());
    let told = |text: String, set: Squares| (text, squares(set));
    if foe_come != 0 {
        let text = if foe_gone == 0 {
            format!("there is a piece of {other} too many on {}", list(foe_come))
        } else {
            format!(
                "{other}'s piece was moved from {} to {}",
                list(foe_gone),
                list(foe_come)
            )
        };
        return told(text, foe_gone | foe_come);
    }
    match (gone.count_ones(), come.count_ones()) {
        (0, 0) => told(
            format!(
                "{other}'s piece on {} was taken away, and nothing was moved",
                list(foe_gone)
            ),
            foe_gone,
        ),
        (0, _) => told(
            format!("there is a piece of {turn} too many on {}", list(come)),
            come,
        ),
        (_, 0) => told(
            format!("{turn}'s piece on {} was taken away", list(gone)),
            gone,
        ),
        (1, 1) => {
            let (from, to) = (gone.trailing_zeros() as u8, come.trailing_zeros() as u8);
            let written = Written {
                squares: vec![from, to],
                captures: None,
            };
            let (from_number, to_number) = (numbering.number(from), numbering.number(to));
            let moves = before.moves(variant);
            let same = moves.iter().find(|step| step.from == from && step.to == to);
            if let Some(step) = same {
                let forgotten = step.captured & seen.sure & foe_seen;
                let wrongly = foe_gone & !step.captured;
                if wrongly != 0 {
                    let text = format!(
                        "{} was not captured from {from_number} to {to_number}",
                        list(wrongly)
                    );
                    return told(text, wrongly);
                }
                let text = format!("what was captured is to be taken away: {}", list(forgotten));
                return told(text, forgotten);
            }
            let why = match before.find(&written, variant, numbering) {
                Err(refusal) => refusal.to_string(),
                Ok(_) => "this is no legal move".to_owned(),
            };
            told(
                format!("from {from_number} to {to_number}: {why}"),
                gone | come,
            )
        }
        _ => told(
            format!(
                "more than one piece was moved: from {} to {}",
                list(gone),
                list(come)
            ),
            gone | come,
        ),
    }
}

#[cfg(test)]
mod tests;
