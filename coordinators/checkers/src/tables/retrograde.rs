//! Retrograde analysis: from ended games back, slice by slice.
//!
//! A capture or a crowning leads to a slice that is done. All other moves stay in a slice and the one with the sides exchanged, so
//! these two are done together, in the order of the half-moves to the end.

use super::{
    Outcome, decoded,
    index::{Index, Slice},
    to_white,
};
use crate::{
    board::{Colour, Position, Way, bit, each},
    capture,
    moves::MoveList,
    rules::{Rules, Variant},
};

/// A position that can reach a draw is never lost.
const NEVER: u8 = u8::MAX;

/// Longer games are told as if they were this long, or one less: whether it is won stays right.
const LONGEST: usize = 253;

/// The value of each place.
pub(super) fn values(variant: Variant, index: &Index) -> Vec<u8> {
    let mut analysis = Analysis {
        index,
        variant,
        rules: variant.rules(),
        values: vec![0; index.len()],
        open: vec![0; index.len()],
        worst: vec![0; index.len()],
        due: Vec::new(),
    };
    for slice in index.slices() {
        let [a, b, c, d] = slice.counts;
        let exchanged = [c, d, a, b];
        if slice.counts > exchanged {
            continue;
        }
        analysis.begin(slice);
        if let Some(other) = index.slice(exchanged).filter(|other| *other != slice) {
            analysis.begin(other);
        }
        analysis.run();
    }
    analysis.values
}

struct Analysis<'a> {
    index: &'a Index,
    variant: Variant,
    rules: Rules,
    values: Vec<u8>,
    /// How many moves within the slices are not known to lose, or [`NEVER`].
    open: Vec<u8>,
    /// The longest loss among moves that are known to lose.
    worst: Vec<u8>,
    /// By half-moves to the end: positions that end so.
    due: Vec<Vec<Position>>,
}

impl Analysis<'_> {
    fn due(&mut self, plies: usize, position: Position) {
        if self.due.len() <= plies {
            self.due.resize_with(plies + 1, Vec::new);
        }
        if let Some(due) = self.due.get_mut(plies) {
            due.push(position);
        }
    }

    /// Notes what is known at once: ended games, and moves that leave the slices.
    fn begin(&mut self, slice: &Slice) {
        let mut moves = MoveList::new();
        for place in 0..slice.len {
            let Some(position) = self.index.position(slice, place) else {
                continue;
            };
            position.moves_into(self.variant, &mut moves);
            let (mut open, mut worst, mut never) = (0_u8, 0, false);
            let mut soonest: Option<u8> = None;
            for step in &moves {
                if step.captured == 0 && !step.crowned {
                    open += 1;
                    continue;
                }
                let next = position.after(*step);
                let outcome = if next.own() == 0 {
                    Outcome::Lost(0)
                } else {
                    let place = self.index.place(&to_white(&next));
                    let value = place.and_then(|place| self.values.get(place)).copied();
                    decoded(value.unwrap_or_default())
                };
                match outcome {
                    Outcome::Draw => never = true,
                    Outcome::Won(plies) => worst = worst.max(plies),
                    Outcome::Lost(plies) => {
                        never = true;
                        soonest = Some(soonest.map_or(plies, |other| other.min(plies)));
                    }
                }
            }
            let at = slice.begin + place;
            if let (Some(open_at), Some(worst_at)) = (self.open.get_mut(at), self.worst.get_mut(at))
            {
                *open_at = if never { NEVER } else { open };
                *worst_at = worst;
            }
            if let Some(plies) = soonest {
                self.due(usize::from(plies) + 1, position);
            } else if moves.is_empty() {
                self.due(0, position);
            } else if !never && open == 0 {
                self.due(usize::from(worst) + 1, position);
            }
        }
    }

    fn run(&mut self) {
        let mut plies = 0;
        while plies < self.due.len() {
            let due = self
                .due
                .get_mut(plies)
                .map(std::mem::take)
                .unwrap_or_default();
            for position in due {
                let Some(value) = self
                    .index
                    .place(&position)
                    .and_then(|at| self.values.get_mut(at))
                else {
                    continue;
                };
                // A shorter way was found before.
                if *value != 0 {
                    continue;
                }
                *value = encoded(plies);
                self.before(&position, plies);
            }
            plies += 1;
        }
        self.due.clear();
    }

    /// Tells the positions from which a quiet move leads here.
    fn before(&mut self, position: &Position, plies: usize) {
        // Black has moved.
        let empty = position.empty();
        for to in each(position.black) {
            let king = position.kings & bit(to) != 0;
            let ways: &[Way] = if king {
                &Way::ALL
            } else {
                &[Way::UpLeft, Way::UpRight]
            };
            for way in ways {
                let mut from = way.step(bit(to)) & empty;
                while from != 0 {
                    self.one_before(position, bit(to), from, king, plies);
                    from = if king && self.rules.flying {
                        way.step(from) & empty
                    } else {
                        0
                    };
                }
            }
        }
    }

    fn one_before(&mut self, position: &Position, to: u32, from: u32, king: bool, plies: usize) {
        let kings = if king {
            position.kings & !to | from
        } else {
            position.kings
        };
        let earlier = Position {
            white: position.white,
            black: position.black & !to | from,
            kings,
            turn: Colour::Black,
        };
        let earlier = earlier.turned();
        let Some(at) = self.index.place(&earlier) else {
            return;
        };
        if self.values.get(at).is_none_or(|value| *value != 0) {
            return;
        }
        // Where a capture is possible it is compulsory.
        if capture::any(&earlier, &self.rules) {
            return;
        }
        if plies.is_multiple_of(2) {
            self.due(plies + 1, earlier);
            return;
        }
        let (Some(open), Some(worst)) = (self.open.get_mut(at), self.worst.get_mut(at)) else {
            return;
        };
        if *open == NEVER || *open == 0 {
            return;
        }
        *open -= 1;
        *worst = (*worst).max(u8::try_from(plies).unwrap_or(LONGEST as u8));
        if *open == 0 {
            let plies = usize::from(*worst) + 1;
            self.due(plies, earlier);
        }
    }
}

fn encoded(plies: usize) -> u8 {
    let plies = if plies > LONGEST {
        LONGEST - usize::from(plies % 2 != LONGEST % 2)
    } else {
        plies
    };
    u8::try_from(plies + 1).unwrap_or(u8::MAX)
}
