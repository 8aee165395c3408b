//! Discs on a table, for tests: what a hand can do, and what it cannot.

use crate::{
    board::{Colour, Position, Squares, bit},
    carries::{Carry, Heaps, Place},
};

/// The discs on each square from the bottom, and on the heaps.
pub(crate) struct Table {
    squares: [Vec<Colour>; 32],
    heaps: Heaps,
    spares: usize,
}

impl Table {
    pub(crate) fn of(position: &Position) -> Self {
        let stack = |square: usize| {
            let piece = position.piece(u8::try_from(square).unwrap_or_default());
            piece.map_or_else(Vec::new, |piece| {
                vec![piece.colour; 1 + usize::from(piece.king)]
            })
        };
        Self {
            squares: std::array::from_fn(stack),
            heaps: Heaps::default(),
            spares: 0,
        }
    }

    /// Carries discs; an error when they are not there, or there is no room.
    pub(crate) fn carry(&mut self, carry: Carry) -> Result<(), String> {
        let wrong = || Err(format!("{carry:?}"));
        let colour = match carry.from {
            Place::Square(square, height) => {
                let stack = &mut self.squares[usize::from(square)];
                if stack.len() != usize::from(height + carry.discs) {
                    return wrong();
                }
                let colour = stack[0];
                stack.truncate(usize::from(height));
                colour
            }
            Place::Heap(colour, height) => {
                let heap = self.heap(colour);
                if *heap != height + carry.discs {
                    return wrong();
                }
                *heap = height;
                colour
            }
            Place::Spare(colour) => {
                self.spares += usize::from(carry.discs);
                colour
            }
        };
        match carry.to {
            Place::Square(square, height) => {
                let stack = &mut self.squares[usize::from(square)];
                if stack.len() != usize::from(height) || stack.iter().any(|disc| *disc != colour) {
                    return wrong();
                }
                stack.extend(vec![colour; usize::from(carry.discs)]);
            }
            Place::Heap(of, height) => {
                let heap = self.heap(of);
                if of != colour || *heap != height {
                    return wrong();
                }
                *heap += carry.discs;
            }
            Place::Spare(_) => return wrong(),
        }
        Ok(())
    }

    fn heap(&mut self, colour: Colour) -> &mut u8 {
        match colour {
            Colour::White => &mut self.heaps.white,
            Colour::Black => &mut self.heaps.black,
        }
    }

    /// The squares where another piece stands than in a position.
    pub(crate) fn differs(&self, position: &Position) -> Squares {
        let expected = Self::of(position);
        (0..32_u8)
            .filter(|square| {
                self.squares[usize::from(*square)] != expected.squares[usize::from(*square)]
            })
            .fold(0, |all, square| all | bit(square))
    }

    pub(crate) const fn heaps(&self) -> Heaps {
        self.heaps
    }

    pub(crate) fn discs(&self) -> usize {
        let board: usize = self.squares.iter().map(Vec::len).sum();
        board + usize::from(self.heaps.white) + usize::from(self.heaps.black)
    }

    pub(crate) const fn spares(&self) -> usize {
        self.spares
    }
}
