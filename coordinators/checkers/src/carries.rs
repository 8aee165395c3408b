//! A move as what a hand does: carry a piece, carry what it captured to the heap, crown by stacking (SORMA technical report,
//! sections 2.1.2 and 2.1.4: targets are board coordinates with a height, so that discs stand on heaps).

use crate::{
    board::{Colour, Position, bit},
    moves::Route,
};

/// Where discs stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// On a square; the height counts the discs beneath.
    Square(u8, u8),
    /// On the heap of captured discs of a colour, on so many.
    Heap(Colour, u8),
    /// From the discs of a colour that are no part of the game.
    Spare(Colour),
}

/// One carry: a disc, or a king's stack of two in one grasp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Carry {
    /// Where the lowest disc of it is.
    pub from: Place,
    /// Where it comes to stand.
    pub to: Place,
    /// One disc or two.
    pub discs: u8,
}

/// How many captured discs of each colour there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Heaps {
    /// White discs.
    pub white: u8,
    /// Black discs.
    pub black: u8,
}

impl Heaps {
    const fn of(&mut self, colour: Colour) -> &mut u8 {
        match colour {
            Colour::White => &mut self.white,
            Colour::Black => &mut self.black,
        }
    }

    /// The carries of a move, in their order; the heaps are as they are afterwards. The captured pieces go when the move is made,
    /// in the order of their capture; a man is crowned with a captured disc of its colour, or with a spare one.
    pub fn carries(&mut self, before: &Position, route: &Route) -> Vec<Carry> {
        let step = route.step;
        let discs = |square: u8| 1 + u8::from(before.kings & bit(square) != 0);
        let mut all = Vec::new();
        if step.from != step.to {
            all.push(Carry {
                from: Place::Square(step.from, 0),
                to: Place::Square(step.to, 0),
                discs: discs(step.from),
            });
        }
        let prey = before.turn.other();
        for square in &route.over {
            let discs = discs(*square);
            let heap = self.of(prey);
            all.push(Carry {
                from: Place::Square(*square, 0),
                to: Place::Heap(prey, *heap),
                discs,
            });
            *heap += discs;
        }
        if step.crowned {
            let heap = self.of(before.turn);
            let from = match heap.checked_sub(1) {
                Some(below) => {
                    *heap = below;
                    Place::Heap(before.turn, below)
                }
                None => Place::Spare(before.turn),
            };
            all.push(Carry {
                from,
                to: Place::Square(step.to, 1),
                discs: 1,
            });
        }
        all
    }
}

#[cfg(test)]
mod tests;
