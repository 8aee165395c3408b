//! What a quiet position is worth when nothing more is known of it.
//!
//! The sum, in hundredths of a man, for the side that moves: a man 100, a king 300 where it flies and 150 where it does not; 3 for
//! each row that a man has gone; 6 for each man that guards the row where the other side's men are crowned; 4 for each
//! piece in the middle; 20 for the longest diagonal where kings fly.

use crate::{
    board::{Colour, Position, Squares},
    rules::Rules,
};

/// A man.
pub(crate) const MAN: i32 = 100;

const MIDDLE: Squares = 0x0066_6600;

/// a1 to h8.
const MAIN_ROAD: Squares =
    (1 << 28) | (1 << 24) | (1 << 21) | (1 << 17) | (1 << 14) | (1 << 10) | (1 << 7) | (1 << 3);

pub(crate) fn value(position: &Position, rules: &Rules) -> i32 {
    let worth = |colour: Colour| {
        let all = position.side(colour);
        let (men, kings) = (all & !position.kings, all & position.kings);
        let count = |set: Squares| i32::try_from(set.count_ones()).unwrap_or_default();
        let king = if rules.flying { 3 * MAN } else { MAN + MAN / 2 };
        let mut worth = MAN * count(men) + king * count(kings);
        for row in 0..8 {
            let gone = match colour {
                Colour::White => 7 - row,
                Colour::Black => row,
            };
            worth += 3 * gone * count(men & (0xF << (4 * row)));
        }
        worth += 6 * count(men & colour.other().crown_row());
        worth += 4 * count(all & MIDDLE);
        if rules.flying && kings & MAIN_ROAD != 0 {
            worth += 20;
        }
        worth
    };
    worth(position.turn) - worth(position.turn.other())
}
