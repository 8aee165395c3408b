//! How squares and moves are written: PDN's numbers, and letters with digits.

use std::fmt;

use crate::{
    board::{Position, bit, each, first},
    moves::{Move, Route},
    rules::Variant,
};

/// A longer text of a position or a move is not read, bytes.
pub const LONGEST: usize = 4096;

/// What is wrong with a text, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{line}:{column} {reason}")]
pub struct TextError {
    /// The line, from 1.
    pub line: usize,
    /// The column in characters, from 1.
    pub column: usize,
    /// What is wrong, and what would be right.
    pub reason: String,
}

impl TextError {
    /// An error at a byte of a text.
    #[must_use]
    pub fn at(text: &str, byte: usize, reason: impl Into<String>) -> Self {
        let before = text.get(..byte).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let start = before.rfind('\n').map_or(0, |at| at + 1);
        let column = before.get(start..).unwrap_or_default().chars().count() + 1;
        Self {
            line,
            column,
            reason: reason.into(),
        }
    }
}

/// The numbers of squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Numbering {
    /// 1 is b8, 4 is h8, 29 is a1, 32 is g1: PDN's A0, and N1 and N2 without the invert flag.
    Plain,
    /// 1 is a8, 4 is g8, 29 is b1, 32 is h1: N2 with the invert flag, Italian.
    Mirrored,
    /// 1 is h1, 4 is b1, 32 is a8: N1 with the invert flag, seen by White; Spanish files.
    Turned,
}

impl Numbering {
    /// The numbers that a variant's positions and moves are written with.
    #[must_use]
    pub const fn of(variant: Variant) -> Self {
        if variant.mirrored() {
            Self::Mirrored
        } else {
            Self::Plain
        }
    }

    /// The number of a square, 1 to 32.
    #[must_use]
    pub const fn number(self, square: u8) -> u8 {
        match self {
            Self::Plain => square + 1,
            // A row runs the other way.
            Self::Mirrored => (square ^ 3) + 1,
            Self::Turned => 32 - (square ^ 3),
        }
    }

    /// The square of a number.
    #[must_use]
    pub const fn square(self, number: u32) -> Option<u8> {
        if number < 1 || number > 32 {
            return None;
        }
        let at = (number - 1) as u8;
        Some(match self {
            Self::Plain => at,
            Self::Mirrored => at ^ 3,
            Self::Turned => (31 - at) ^ 3,
        })
    }

    /// Letter and digit of a square, such as `a1`.
    #[must_use]
    pub fn name(self, square: u8) -> String {
        let (row, column) = (square / 4, square % 4);
        let file = 2 * column + u8::from(row.is_multiple_of(2));
        let file = if self == Self::Plain { file } else { 7 - file };
        format!("{}{}", char::from(b'a' + file), 8 - row)
    }

    /// The square of letter and digit; `None` for a square that is not played on.
    #[must_use]
    pub fn named(self, file: u8, rank: u8) -> Option<u8> {
        let file = file.to_ascii_lowercase();
        if !(b'a'..=b'h').contains(&file) || !(b'1'..=b'8').contains(&rank) {
            return None;
        }
        let file = file - b'a';
        let file = if self == Self::Plain { file } else { 7 - file };
        let row = b'8' - rank;
        (file % 2 == u8::from(row.is_multiple_of(2))).then(|| row * 4 + file / 2)
    }

    /// A move with all squares where it lands, such as `9x18x27`.
    #[must_use]
    pub fn route(self, route: &Route, sign: char) -> String {
        let mut word = self.number(route.step.from).to_string();
        let sign = if route.step.captured == 0 { '-' } else { sign };
        for landing in &route.landings {
            word.push(sign);
            word.push_str(&self.number(*landing).to_string());
        }
        word
    }

    /// A move by its first and last square, such as `9x27`; more moves may have the same.
    #[must_use]
    pub fn short(self, step: Move, sign: char) -> String {
        let sign = if step.captured == 0 { '-' } else { sign };
        let (from, to) = (self.number(step.from), self.number(step.to));
        format!("{from}{sign}{to}")
    }
}

impl Position {
    /// The legal moves, each with its word: of several orders of the same captures the first word of the alphabet.
    #[must_use]
    pub fn words(&self, variant: Variant, numbering: Numbering) -> Vec<(String, Move)> {
        let routes = self.routes(variant);
        let word = |route: &Route| (numbering.route(route, 'x'), route.step);
        let mut words: Vec<_> = routes.iter().map(word).collect();
        words.sort_by(|a, b| a.0.cmp(&b.0));
        let mut kept: Vec<(String, Move)> = Vec::with_capacity(words.len());
        for (word, step) in words {
            if kept.iter().all(|(_, other)| *other != step) {
                kept.push((word, step));
            }
        }
        kept
    }

    /// The position as FEN, such as `W:W18,K22:B9`.
    #[must_use]
    pub fn fen(&self, numbering: Numbering) -> String {
        let list = |set| {
            let mut pieces: Vec<(u8, bool)> = each(set)
                .map(|square| (numbering.number(square), self.kings & bit(square) != 0))
                .collect();
            pieces.sort_unstable();
            let words: Vec<String> = pieces
                .into_iter()
                .map(|(number, king)| format!("{}{number}", if king { "K" } else { "" }))
                .collect();
            words.join(",")
        };
        let turn = self.turn.letter();
        format!("{turn}:W{}:B{}", list(self.white), list(self.black))
    }
}

/// The squares of a move that a person or a file wrote.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// First, in between, last; at least two.
    pub squares: Vec<u8>,
    /// Whether the sign says that it captures; `None` for letters without a sign (`c3e5`).
    pub captures: Option<bool>,
}

impl Written {
    /// Reads a move: `11-15`, `9x27`, `9x18x27`, `9:27`, `c3-d4`, `c3xe5`, `c3e5`. It need not be legal.
    ///
    /// # Errors
    /// What is wrong with the word, at its place in the word.
    pub fn read(word: &str, numbering: Numbering) -> Result<Self, TextError> {
        let wrong = |at: usize, reason: String| Err(TextError::at(word, at, reason));
        if word.len() > LONGEST {
            return wrong(0, format!("a move has at most {LONGEST} bytes"));
        }
        let bytes = word.as_bytes();
        let (mut squares, mut captures): (Vec<u8>, Option<bool>) = (Vec::new(), None);
        let mut at = 0;
        loop {
            let (square, next) = read_square(word, at, numbering)?;
            squares.push(square);
            at = next;
            let sign = match bytes.get(at) {
                None => break,
                Some(b'-') => Some(false),
                Some(b'x' | b'X' | b':') => Some(true),
                // Letters without a sign.
                Some(b'a'..=b'h' | b'A'..=b'H') => None,
                Some(_) => {
                    let other = word.get(at..).and_then(|rest| rest.chars().next());
                    let other = other.unwrap_or(' ').escape_debug();
                    return wrong(at, format!("`{other}` stands where `-`, `x` or `:` should"));
                }
            };
            if squares.len() > 1 && sign != captures {
                let reason = "a move has one sign throughout: `-`, or `x` or `:` for a capture";
                return wrong(at, reason.to_owned());
            }
            if squares.len() > 1 && sign == Some(false) {
                let reason = "a move that captures nothing has two squares";
                return wrong(at, reason.to_owned());
            }
            captures = sign;
            at += usize::from(sign.is_some());
        }
        if squares.len() < 2 {
            return wrong(
                at,
                "a move has two squares or more, such as `11-15`".to_owned(),
            );
        }
        Ok(Self { squares, captures })
    }
}

/// Reads the square at a byte of a text; answers it and the byte behind.
pub(crate) fn read_square(
    text: &str,
    at: usize,
    numbering: Numbering,
) -> Result<(u8, usize), TextError> {
    let rest = text.get(at..).unwrap_or_default();
    let wrong = |reason: String| Err(TextError::at(text, at, reason));
    let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    if digits > 0 {
        let number = rest.get(..digits).unwrap_or_default();
        let square = number
            .parse()
            .ok()
            .and_then(|number| numbering.square(number));
        return match square {
            Some(square) => Ok((square, at + digits)),
            None => {
                let shown: String = number.chars().take(12).collect();
                wrong(format!("there is no square {shown}: squares are 1 to 32"))
            }
        };
    }
    let mut bytes = rest.bytes();
    if let (Some(file), Some(rank)) = (bytes.next(), bytes.next())
        && file.is_ascii_alphabetic()
        && rank.is_ascii_digit()
    {
        return match numbering.named(file, rank) {
            Some(square) => Ok((square, at + 2)),
            None => wrong(format!(
                "{}{} is no square that is played on",
                char::from(file),
                char::from(rank)
            )),
        };
    }
    match rest.chars().next() {
        Some(other) => {
            let other = other.escape_debug();
            wrong(format!("`{other}` stands where a square should, 1 to 32"))
        }
        None => wrong("a square is missing, 1 to 32".to_owned()),
    }
}

/// Why a written move is not a move.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal(pub String);

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Refusal {}

/// All squares that a route goes over or lands on, in order, without those of captured pieces.
pub(crate) fn travelled(route: &Route) -> Vec<u8> {
    let mut squares = vec![route.step.from];
    let mut at = route.step.from;
    for landing in &route.landings {
        // Two squares on one line; the way between them is found by walking it.
        let line = crate::board::Way::ALL.into_iter().find_map(|way| {
            let (mut here, mut line) = (way.step(bit(at)), Vec::new());
            while here != 0 {
                line.push(first(here));
                if here == bit(*landing) {
                    return Some(line);
                }
                here = way.step(here);
            }
            None
        });
        let over = |square: &u8| route.step.captured & bit(*square) == 0;
        squares.extend(line.unwrap_or_default().into_iter().filter(over));
        at = *landing;
    }
    squares
}
