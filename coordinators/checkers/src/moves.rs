//! Moves: what they are, which are legal, and what a board is after one. Captures stand in `capture.rs`.

use smallvec::SmallVec;

use crate::{
    board::{Colour, Position, Squares, Way, bit, each, first},
    capture,
    rules::{Rules, Variant},
};

/// A move: two orders of the same captures are one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Move {
    /// From which square, 0 to 31.
    pub from: u8,
    /// To which square, 0 to 31.
    pub to: u8,
    /// Whether a man becomes a king by it.
    pub crowned: bool,
    /// The squares of all pieces that it captures.
    pub captured: Squares,
}

/// The moves of a position; hardly ever more than stand here without an allocation.
pub type MoveList = SmallVec<[Move; 32]>;

/// A move with its route: what it captures in order, and on which squares it lands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Route {
    /// The move.
    pub step: Move,
    /// The squares of the captured pieces, in the order of the captures.
    pub over: SmallVec<[u8; 12]>,
    /// The squares where it lands, the last of which is [`Move::to`].
    pub landings: SmallVec<[u8; 12]>,
}

impl Position {
    /// All legal moves.
    #[must_use]
    pub fn moves(&self, variant: Variant) -> MoveList {
        let mut list = MoveList::new();
        self.moves_into(variant, &mut list);
        list
    }

    /// All legal moves, into a list that is emptied first.
    #[inline]
    pub fn moves_into(&self, variant: Variant, list: &mut MoveList) {
        list.clear();
        let rules = &variant.rules();
        if !capture::collect(self, rules, list) {
            self.quiet_moves(rules, list);
        }
    }

    /// All legal moves with their routes; two orders of the same captures are two.
    #[must_use]
    pub fn routes(&self, variant: Variant) -> Vec<Route> {
        let rules = &variant.rules();
        let mut routes = Vec::new();
        if !capture::collect(self, rules, &mut routes) {
            let mut list = MoveList::new();
            self.quiet_moves(rules, &mut list);
            let route = |step: Move| Route {
                step,
                over: SmallVec::new(),
                landings: SmallVec::from_slice(&[step.to]),
            };
            routes = list.into_iter().map(route).collect();
        }
        routes
    }

    /// How many legal moves there are.
    #[inline]
    pub(crate) fn count(&self, rules: &Rules, scratch: &mut MoveList) -> u64 {
        scratch.clear();
        if capture::collect(self, rules, scratch) {
            return scratch.len() as u64;
        }
        self.count_quiet(rules)
    }

    /// How many legal moves there are when two orders of the same captures are two.
    pub(crate) fn count_routes(&self, rules: &Rules) -> u64 {
        let mut count = capture::Count(0);
        if capture::collect(self, rules, &mut count) {
            return count.0;
        }
        self.count_quiet(rules)
    }

    /// Whether the side that moves must capture.
    #[must_use]
    pub fn captures(&self, variant: Variant) -> bool {
        capture::any(self, &variant.rules())
    }

    /// The board after a move of its list.
    #[inline]
    #[must_use]
    pub const fn after(&self, step: Move) -> Self {
        let (from, to) = (bit(step.from), bit(step.to));
        let king = self.kings & from != 0 || step.crowned;
        let kings = self.kings & !from & !step.captured;
        let kings = if king { kings | to } else { kings };
        let own = (self.own() & !from) | to;
        let foe = self.foe() & !step.captured;
        let (white, black) = match self.turn {
            Colour::White => (own, foe),
            Colour::Black => (foe, own),
        };
        Self {
            white,
            black,
            kings,
            turn: self.turn.other(),
        }
    }

    /// Whether a move can never be taken back: it captures, or a man moves.
    #[must_use]
    pub const fn lasting(&self, step: Move) -> bool {
        step.captured != 0 || self.kings & bit(step.from) == 0
    }

    #[inline]
    fn count_quiet(&self, rules: &Rules) -> u64 {
        let (own, empty) = (self.own(), self.empty());
        let men = own & !self.kings;
        let mut count = 0;
        for way in self.turn.forward() {
            count += (way.step(men) & empty).count_ones();
        }
        let kings = own & self.kings;
        if kings != 0 {
            for way in Way::ALL {
                let mut reached = way.step(kings) & empty;
                while reached != 0 {
                    count += reached.count_ones();
                    // No square is reached twice one way: of two kings on a line the nearer one is in the way.
                    reached = if rules.flying {
                        way.step(reached) & empty
                    } else {
                        0
                    };
                }
            }
        }
        u64::from(count)
    }

    fn quiet_moves(&self, rules: &Rules, list: &mut MoveList) {
        let (own, empty) = (self.own(), self.empty());
        let crown = self.turn.crown_row();
        let men = own & !self.kings;
        for way in self.turn.forward() {
            for from in each(men & way.back(empty)) {
                let to = way.step(bit(from));
                list.push(Move {
                    from,
                    to: first(to),
                    crowned: to & crown != 0,
                    captured: 0,
                });
            }
        }
        for from in each(own & self.kings) {
            for way in Way::ALL {
                let mut to = way.step(bit(from)) & empty;
                while to != 0 {
                    list.push(Move {
                        from,
                        to: first(to),
                        crowned: false,
                        captured: 0,
                    });
                    to = if rules.flying {
                        way.step(to) & empty
                    } else {
                        0
                    };
                }
            }
        }
    }
}
