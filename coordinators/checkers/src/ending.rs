//! Endings in which a side must win within so many moves from when they arose: the FMJD's rules on 64 squares, 7.2.4 and 7.2.6
//! to 7.2.8.

use crate::{
    board::{Position, Squares},
    rules::DrawRules,
};

/// Such an ending.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// Three kings or more against one king (7.2.4).
    ThreeKings,
    /// Both sides have kings; nothing was captured and no man crowned since there were so many (7.2.6).
    Balance {
        /// Of both sides, men and kings: 4 to 7.
        pieces: u32,
        /// The kings among them.
        kings: u32,
    },
    /// Three pieces with a king among them against one king that stays on the main road (7.2.7).
    MainRoad,
    /// A king, with another piece or alone, against one king (7.2.8).
    TwoAgainstOne,
}

/// The longest diagonal, squares 4, 8, 11, 15, 18, 22, 25 and 29.
const MAIN_ROAD: Squares = squares(&[4, 8, 11, 15, 18, 22, 25, 29]);

const fn squares(numbers: &[u8]) -> Squares {
    let (mut set, mut rest) = (0, numbers);
    while let [number, others @ ..] = rest {
        set |= crate::board::bit(*number - 1);
        rest = others;
    }
    set
}

impl Ending {
    /// Those that a position is, by the rules of a variant.
    pub(crate) fn of(position: &Position, draws: DrawRules) -> impl Iterator<Item = Self> {
        let Position {
            white,
            black,
            kings,
            ..
        } = *position;
        let (strong, weak) = match white.count_ones() >= black.count_ones() {
            true => (white, black),
            false => (black, white),
        };
        let pieces = position.pieces();
        let king = strong & kings != 0;
        let alone = weak.count_ones() == 1 && weak & kings == weak;
        let three = strong.count_ones() >= 3 && strong & kings == strong;
        let found = [
            (alone && three).then_some(Self::ThreeKings),
            (king && weak & kings != 0 && (4..=7).contains(&pieces)).then_some(Self::Balance {
                pieces,
                kings: kings.count_ones(),
            }),
            (alone && king && pieces == 4 && weak & MAIN_ROAD != 0).then_some(Self::MainRoad),
            (alone && king && pieces <= 3).then_some(Self::TwoAgainstOne),
        ];
        let found = found.into_iter().flatten();
        found.filter(move |ending| ending.most(draws).is_some())
    }

    /// After so many half-moves of it a game is drawn.
    pub(crate) const fn most(self, draws: DrawRules) -> Option<u32> {
        match self {
            Self::ThreeKings => draws.three_against_one,
            Self::Balance { pieces: 4 | 5, .. } if draws.few_pieces => Some(60),
            Self::Balance { .. } if draws.few_pieces => Some(120),
            Self::MainRoad | Self::TwoAgainstOne if draws.few_pieces => Some(10),
            _ => None,
        }
    }
}
