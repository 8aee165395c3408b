//! The board: its 32 playing squares as bits, and what stands on them. Knows no rule.
//!
//! Bit 0 is the left square of Black's first row as White sees it, bit 31 the right one of White's; four bits make a row.
//! White's men move up, towards bit 0. A mirrored board (Italian, Spanish) is the same to the rules; only the numbers of its
//! squares differ, which [`Numbering`](crate::Numbering) knows.

/// A set of squares.
pub type Squares = u32;

/// The squares whose upper left neighbour is four bits away: rows 8, 6, 4 and 2.
const RIGHT_ROWS: Squares = 0x0F0F_0F0F;
const LEFT_ROWS: Squares = 0xF0F0_F0F0;
const FIRST_COLUMN: Squares = 0x1111_1111;
const LAST_COLUMN: Squares = 0x8888_8888;

/// One of the four ways along diagonals, as White sees the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    UpLeft,
    UpRight,
    DownLeft,
    DownRight,
}

impl Way {
    pub(crate) const ALL: [Self; 4] =
        [Self::UpLeft, Self::UpRight, Self::DownLeft, Self::DownRight];

    /// The two ways at right angles to this one.
    pub(crate) const fn across(self) -> [Self; 2] {
        match self {
            Self::UpLeft | Self::DownRight => [Self::UpRight, Self::DownLeft],
            Self::UpRight | Self::DownLeft => [Self::UpLeft, Self::DownRight],
        }
    }

    /// The neighbours of all squares of a set; those beyond the border are left out.
    #[inline(always)]
    pub(crate) const fn step(self, from: Squares) -> Squares {
        match self {
            Self::UpLeft => ((from & RIGHT_ROWS) >> 4) | ((from & LEFT_ROWS & !FIRST_COLUMN) >> 5),
            Self::UpRight => ((from & RIGHT_ROWS & !LAST_COLUMN) >> 3) | ((from & LEFT_ROWS) >> 4),
            Self::DownLeft => {
                ((from & RIGHT_ROWS) << 4) | ((from & LEFT_ROWS & !FIRST_COLUMN) << 3)
            }
            Self::DownRight => {
                ((from & RIGHT_ROWS & !LAST_COLUMN) << 5) | ((from & LEFT_ROWS) << 4)
            }
        }
    }

    /// The neighbours the other way.
    #[inline(always)]
    pub(crate) const fn back(self, from: Squares) -> Squares {
        match self {
            Self::UpLeft => Self::DownRight.step(from),
            Self::UpRight => Self::DownLeft.step(from),
            Self::DownLeft => Self::UpRight.step(from),
            Self::DownRight => Self::UpLeft.step(from),
        }
    }
}

/// The colour of a side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Colour {
    /// Its men move up.
    White,
    /// Its men move down.
    Black,
}

impl Colour {
    /// The other side.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::White => Self::Black,
            Self::Black => Self::White,
        }
    }

    /// The letter of FEN.
    #[must_use]
    pub const fn letter(self) -> char {
        match self {
            Self::White => 'W',
            Self::Black => 'B',
        }
    }

    /// The name for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::White => "White",
            Self::Black => "Black",
        }
    }

    /// The row where its men become kings.
    #[must_use]
    pub const fn crown_row(self) -> Squares {
        match self {
            Self::White => 0x0000_000F,
            Self::Black => 0xF000_0000,
        }
    }

    /// The two ways of its men.
    #[inline(always)]
    pub(crate) const fn forward(self) -> [Way; 2] {
        match self {
            Self::White => [Way::UpLeft, Way::UpRight],
            Self::Black => [Way::DownLeft, Way::DownRight],
        }
    }
}

/// What stands on a square.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Piece {
    /// Whose it is.
    pub colour: Colour,
    /// Whether it is a king.
    pub king: bool,
}

/// Where all pieces stand, and whose turn it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Position {
    /// White's men and kings.
    pub white: Squares,
    /// Black's men and kings.
    pub black: Squares,
    /// The kings of both.
    pub kings: Squares,
    /// Who moves.
    pub turn: Colour,
}

impl Position {
    /// Twelve men a side in three rows.
    #[must_use]
    pub const fn start(turn: Colour) -> Self {
        Self {
            white: 0xFFF0_0000,
            black: 0x0000_0FFF,
            kings: 0,
            turn,
        }
    }

    /// The pieces of one side.
    #[inline(always)]
    #[must_use]
    pub const fn side(&self, colour: Colour) -> Squares {
        match colour {
            Colour::White => self.white,
            Colour::Black => self.black,
        }
    }

    /// The pieces of the side that moves.
    #[inline(always)]
    #[must_use]
    pub const fn own(&self) -> Squares {
        self.side(self.turn)
    }

    /// The pieces of the side that waits.
    #[inline(always)]
    #[must_use]
    pub const fn foe(&self) -> Squares {
        self.side(self.turn.other())
    }

    /// The squares where nothing stands.
    #[inline(always)]
    #[must_use]
    pub const fn empty(&self) -> Squares {
        !(self.white | self.black)
    }

    /// How many pieces there are.
    #[must_use]
    pub const fn pieces(&self) -> u32 {
        (self.white | self.black).count_ones()
    }

    /// What stands on a square, 0 to 31.
    #[must_use]
    pub fn piece(&self, square: u8) -> Option<Piece> {
        let bit = bit(square);
        let king = self.kings & bit != 0;
        let colour = match (self.white & bit != 0, self.black & bit != 0) {
            (true, _) => Colour::White,
            (_, true) => Colour::Black,
            _ => return None,
        };
        Some(Piece { colour, king })
    }

    /// The board turned by half, and the colours exchanged: the same position for the other side.
    #[must_use]
    pub const fn turned(&self) -> Self {
        Self {
            white: self.black.reverse_bits(),
            black: self.white.reverse_bits(),
            kings: self.kings.reverse_bits(),
            turn: self.turn.other(),
        }
    }

    /// A number that two positions hardly share.
    #[must_use]
    pub const fn key(&self) -> u64 {
        // The finisher of SplitMix64 (Steele, Lea, Flood 2014), once for each half.
        let sides = ((self.white as u64) << 32) | self.black as u64;
        let rest = ((self.kings as u64) << 1) | matches!(self.turn, Colour::Black) as u64;
        mix(mix(sides) ^ rest.wrapping_mul(0x9E37_79B9_7F4A_7C15))
    }
}

const fn mix(number: u64) -> u64 {
    let number = (number ^ (number >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    number ^ (number >> 31)
}

/// The set of one square, 0 to 31.
#[inline(always)]
pub(crate) const fn bit(square: u8) -> Squares {
    1 << (square & 31)
}

/// The first square of a set that is not empty.
#[inline(always)]
pub(crate) const fn first(set: Squares) -> u8 {
    (set.trailing_zeros() & 31) as u8
}

/// The squares of a set, in order.
#[inline(always)]
pub fn each(mut set: Squares) -> impl Iterator<Item = u8> {
    std::iter::from_fn(move || {
        let square = (set != 0).then(|| first(set));
        set &= set.wrapping_sub(1);
        square
    })
}
