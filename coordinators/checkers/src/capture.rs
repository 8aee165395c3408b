//! Captures: who can capture what, in which order, and which of these captures a variant allows.
//!
//! The pieces are lifted after the move: a captured piece stands in the way until then and is not jumped again, while the
//! square where the capture began is empty. A capture goes on as long as it can; a flying king must land where it can go on.

use smallvec::SmallVec;

use crate::{
    board::{Position, Squares, Way, bit, each, first},
    moves::{Move, MoveList, Route},
    rules::{Priority, Rules},
};

/// More pieces than this cannot be captured: so many squares there are.
const MOST: usize = 32;

/// Takes captures.
pub(crate) trait Collect {
    /// Forgets what it has: something better was found.
    fn restart(&mut self);
    /// Takes a capture.
    fn take(&mut self, step: Move, over: &[u8], landings: &[u8]);
}

impl Collect for MoveList {
    fn restart(&mut self) {
        self.clear();
    }

    fn take(&mut self, step: Move, _over: &[u8], _landings: &[u8]) {
        if !self.contains(&step) {
            self.push(step);
        }
    }
}

impl Collect for Vec<Route> {
    fn restart(&mut self) {
        self.clear();
    }

    fn take(&mut self, step: Move, over: &[u8], landings: &[u8]) {
        self.push(Route {
            step,
            over: SmallVec::from_slice(over),
            landings: SmallVec::from_slice(landings),
        });
    }
}

/// Only counts; two orders of the same captures are two.
pub(crate) struct Count(pub u64);

impl Collect for Count {
    fn restart(&mut self) {
        self.0 = 0;
    }

    fn take(&mut self, _step: Move, _over: &[u8], _landings: &[u8]) {
        self.0 += 1;
    }
}

/// Men of `men` that can capture one way.
#[inline(always)]
fn men_that_capture(way: Way, men: Squares, prey: Squares, empty: Squares) -> Squares {
    men & way.back(prey & way.back(empty))
}

/// The men that can begin a capture.
#[inline(always)]
fn capturing_men(position: &Position, rules: &Rules) -> Squares {
    let men = position.own() & !position.kings;
    let prey = prey_of_men(position, rules);
    let empty = position.empty();
    let [left, right] = position.turn.forward();
    let mut found =
        men_that_capture(left, men, prey, empty) | men_that_capture(right, men, prey, empty);
    if rules.men_back {
        let [left, right] = position.turn.other().forward();
        found |=
            men_that_capture(left, men, prey, empty) | men_that_capture(right, men, prey, empty);
    }
    found
}

#[inline(always)]
fn prey_of_men(position: &Position, rules: &Rules) -> Squares {
    if rules.men_take_kings {
        position.foe()
    } else {
        position.foe() & !position.kings
    }
}

/// The piece that a king meets first one way and can capture, or nothing.
#[inline(always)]
fn met(way: Way, from: Squares, prey: Squares, empty: Squares, flying: bool) -> Squares {
    let mut at = way.step(from);
    if flying {
        while at & empty != 0 {
            at = way.step(at);
        }
    }
    if at & prey != 0 && way.step(at) & empty != 0 {
        at
    } else {
        0
    }
}

/// Whether there is a capture.
pub(crate) fn any(position: &Position, rules: &Rules) -> bool {
    if capturing_men(position, rules) != 0 {
        return true;
    }
    let (prey, empty) = (position.foe(), position.empty());
    each(position.own() & position.kings).any(|king| {
        Way::ALL
            .iter()
            .any(|way| met(*way, bit(king), prey, empty, rules.flying) != 0)
    })
}

/// Hands out all captures that the rules allow, and says whether there is one.
#[inline]
pub(crate) fn collect(position: &Position, rules: &Rules, to: &mut impl Collect) -> bool {
    let men = capturing_men(position, rules);
    let kings = position.own() & position.kings;
    if men | kings == 0 {
        return false;
    }
    let mut hunt = Hunt {
        position,
        rules,
        to,
        from: 0,
        king: false,
        empty: 0,
        prey: 0,
        depth: 0,
        over: [0; MOST],
        landings: [0; MOST],
        best: 0,
        found: false,
    };
    for king in each(kings) {
        hunt.begin(king, true);
        hunt.king(bit(king), 0, &Way::ALL);
    }
    for man in each(men) {
        hunt.begin(man, false);
        hunt.man(bit(man), 0);
    }
    hunt.found
}

/// The search for captures of one piece after the other.
struct Hunt<'a, C> {
    position: &'a Position,
    rules: &'a Rules,
    to: &'a mut C,
    from: u8,
    king: bool,
    /// What is empty while the piece moves.
    empty: Squares,
    prey: Squares,
    depth: usize,
    over: [u8; MOST],
    landings: [u8; MOST],
    /// How good the best capture is.
    best: u64,
    found: bool,
}

impl<C: Collect> Hunt<'_, C> {
    fn begin(&mut self, from: u8, king: bool) {
        self.from = from;
        self.king = king;
        self.empty = self.position.empty() | bit(from);
        self.prey = if king {
            self.position.foe()
        } else {
            prey_of_men(self.position, self.rules)
        };
        self.depth = 0;
    }

    /// Notes a capture of the way, at the place that `depth` says.
    fn note(&mut self, over: Squares, landing: Squares) {
        if let (Some(over_at), Some(landing_at)) = (
            self.over.get_mut(self.depth),
            self.landings.get_mut(self.depth),
        ) {
            *over_at = first(over);
            *landing_at = first(landing);
        }
    }

    /// Goes on as a man; says whether it could.
    fn man(&mut self, at: Squares, taken: Squares) -> bool {
        let turn = self.position.turn;
        let [a, b] = turn.forward();
        let [c, d] = turn.other().forward();
        let ways = [a, b, c, d];
        let count = if self.rules.men_back { 4 } else { 2 };
        let mut any = false;
        for way in ways.into_iter().take(count) {
            let over = way.step(at) & self.prey & !taken;
            let landing = way.step(over) & self.empty;
            if landing == 0 {
                continue;
            }
            any = true;
            self.note(over, landing);
            self.depth += 1;
            let taken = taken | over;
            let last_row = landing & turn.crown_row() != 0;
            let crowned = last_row && self.rules.crowned_in_passing;
            let on = if crowned {
                self.king(landing, taken, &Way::ALL)
            } else {
                self.man(landing, taken)
            };
            if !on {
                self.done(landing, taken, last_row);
            }
            self.depth -= 1;
        }
        any
    }

    /// Goes on as a king; says whether it could.
    fn king(&mut self, at: Squares, taken: Squares, ways: &[Way]) -> bool {
        let mut any = false;
        for way in ways {
            let prey = self.prey & !taken;
            let over = met(*way, at, prey, self.empty, self.rules.flying);
            if over != 0 {
                any = true;
                self.king_over(*way, over, taken | over);
            }
        }
        any
    }

    /// Has captured `over`, and lands behind it.
    fn king_over(&mut self, way: Way, over: Squares, taken: Squares) {
        let crowned = !self.king;
        let behind = way.step(over);
        if !self.rules.flying {
            self.note(over, behind);
            self.depth += 1;
            if !self.king(behind, taken, &Way::ALL) {
                self.done(behind, taken, crowned);
            }
            self.depth -= 1;
            return;
        }
        let mut any = false;
        let mut landing = behind;
        while landing & self.empty != 0 {
            self.note(over, landing);
            self.depth += 1;
            any |= self.king(landing, taken, &way.across());
            self.depth -= 1;
            landing = way.step(landing);
        }
        // Straight on: where it lands in between makes no difference, the nearest square is told.
        if landing & self.prey & !taken != 0 && way.step(landing) & self.empty != 0 {
            any = true;
            self.note(over, behind);
            self.depth += 1;
            self.king_over(way, landing, taken | landing);
            self.depth -= 1;
        }
        if any {
            return;
        }
        let mut landing = behind;
        while landing & self.empty != 0 {
            self.note(over, landing);
            self.depth += 1;
            self.done(landing, taken, crowned);
            self.depth -= 1;
            landing = way.step(landing);
        }
    }

    /// A capture that goes on no more.
    fn done(&mut self, to: Squares, captured: Squares, crowned: bool) {
        self.found = true;
        let over = self.over.get(..self.depth).unwrap_or_default();
        let landings = self.landings.get(..self.depth).unwrap_or_default();
        let kings = self.position.kings;
        let count = u64::from(captured.count_ones());
        let taken_kings = u64::from((captured & kings).count_ones());
        let worth = match self.rules.priority {
            Priority::Free => 0,
            Priority::WithKing => u64::from(self.king),
            Priority::Most => count,
            Priority::MostThenKings => count << 8 | taken_kings,
            Priority::Italian => {
                // Kings early: the first capture is the highest bit.
                let early = over.iter().fold(0_u64, |early, square| {
                    early << 1 | u64::from(bit(*square) & kings != 0)
                });
                count << 48 | u64::from(self.king) << 40 | taken_kings << 32 | early
            }
        };
        if worth < self.best {
            return;
        }
        if worth > self.best {
            self.best = worth;
            self.to.restart();
        }
        let step = Move {
            from: self.from,
            to: first(to),
            crowned,
            captured,
        };
        self.to.take(step, over, landings);
    }
}
