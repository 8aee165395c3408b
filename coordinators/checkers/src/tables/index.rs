//! The place of a position in a table: positions with the same numbers of men and kings stand together in a slice.

use crate::board::{Colour, Position, Squares, each};

/// How many men and kings there are: White's men, White's kings, Black's men, Black's kings. White is to move.
pub(super) type Counts = [u8; 4];

/// A man can stand on 28 squares: not in the row where it would be a king.
const SQUARES: [u32; 4] = [28, 32, 28, 32];

/// Where the first of these squares is.
const OFFSET: [u32; 4] = [4, 0, 0, 0];

/// A slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Slice {
    pub counts: Counts,
    pub begin: usize,
    pub len: usize,
}

pub(super) struct Index {
    pieces: u32,
    slices: Vec<Slice>,
    /// The number of a slice and 1 by its counts, in base 8.
    by_counts: Vec<u8>,
    len: usize,
}

impl Index {
    pub(super) fn new(pieces: u32) -> Self {
        let most = u8::try_from(pieces).unwrap_or_default();
        let mut all = Vec::new();
        for key in 0..8_usize.pow(4) {
            let part = |shift: usize| (key >> shift & 7) as u8;
            let counts = [part(9), part(6), part(3), part(0)];
            let [a, b, c, d] = counts;
            if a + b > 0 && c + d > 0 && a + b + c + d <= most {
                all.push(counts);
            }
        }
        // What a capture or a crowning leads to stands before.
        all.sort_by_key(|[a, b, c, d]| (a + b + c + d, a + c));
        let mut index = Self {
            pieces,
            slices: Vec::with_capacity(all.len()),
            by_counts: vec![0; 8_usize.pow(4)],
            len: 0,
        };
        for counts in all {
            let len = counts
                .iter()
                .zip(SQUARES)
                .map(|(count, squares)| choose(squares, u32::from(*count)))
                .product();
            index.slices.push(Slice {
                counts,
                begin: index.len,
                len,
            });
            index.len += len;
            if let Some(number) = index.by_counts.get_mut(key(counts)) {
                *number = u8::try_from(index.slices.len()).unwrap_or_default();
            }
        }
        index
    }

    pub(super) const fn pieces(&self) -> u32 {
        self.pieces
    }

    pub(super) const fn len(&self) -> usize {
        self.len
    }

    pub(super) fn slices(&self) -> &[Slice] {
        &self.slices
    }

    pub(super) fn slice(&self, counts: Counts) -> Option<&Slice> {
        let number = *self.by_counts.get(key(counts))?;
        self.slices.get(usize::from(number).checked_sub(1)?)
    }

    /// The place of a position with White to move; `None` when it is not in the tables.
    pub(super) fn place(&self, position: &Position) -> Option<usize> {
        let sets = sets(position);
        let counts = sets.map(|set| set.count_ones() as u8);
        if counts.iter().any(|count| *count > 7) {
            return None;
        }
        let slice = self.slice(counts)?;
        let mut place = 0;
        for ((set, squares), offset) in sets.into_iter().zip(SQUARES).zip(OFFSET) {
            let set = set >> offset;
            place = place * choose(squares, set.count_ones()) + rank(set);
        }
        (place < slice.len).then_some(slice.begin + place)
    }

    /// The position at a place of a slice; `None` where two pieces would stand on one square.
    pub(super) fn position(&self, slice: &Slice, place: usize) -> Option<Position> {
        let mut rest = place;
        let mut sets = [0; 4];
        for at in (0..4).rev() {
            let count = u32::from(*slice.counts.get(at)?);
            let squares = *SQUARES.get(at)?;
            let many = choose(squares, count);
            *sets.get_mut(at)? = unrank(rest % many, count, squares) << OFFSET.get(at)?;
            rest /= many;
        }
        let [white_men, white_kings, black_men, black_kings] = sets;
        let all = sets.iter().fold(0, |all, set| all | set);
        let count: u32 = sets.iter().map(|set: &Squares| set.count_ones()).sum();
        (all.count_ones() == count).then_some(Position {
            white: white_men | white_kings,
            black: black_men | black_kings,
            kings: white_kings | black_kings,
            turn: Colour::White,
        })
    }
}

fn sets(position: &Position) -> [Squares; 4] {
    let Position {
        white,
        black,
        kings,
        ..
    } = position;
    [white & !kings, white & kings, black & !kings, black & kings]
}

fn key([a, b, c, d]: Counts) -> usize {
    [a, b, c, d]
        .into_iter()
        .fold(0, |key, count| key << 3 | usize::from(count & 7))
}

/// In how many ways up to four of up to 32 squares can be chosen: Pascal's triangle.
const WAYS: [[u32; 5]; 33] = {
    let mut ways = [[0; 5]; 33];
    let mut squares = 0;
    while squares <= 32 {
        ways[squares][0] = 1;
        let mut count = 1;
        while count <= 4 && squares > 0 {
            ways[squares][count] = ways[squares - 1][count - 1] + ways[squares - 1][count];
            count += 1;
        }
        squares += 1;
    }
    ways
};

/// In how many ways `count` of `squares` can be chosen.
#[inline]
fn choose(squares: u32, count: u32) -> usize {
    let row = WAYS.get(squares as usize);
    let ways = row.and_then(|row| row.get(count as usize)).copied();
    ways.unwrap_or_default() as usize
}

/// The number of a set among those with as many squares (combinatorial number system).
fn rank(set: Squares) -> usize {
    (1..)
        .zip(each(set))
        .map(|(count, square)| choose(u32::from(square), count))
        .sum()
}

/// The set of a number.
fn unrank(mut number: usize, count: u32, squares: u32) -> Squares {
    let mut set = 0;
    let mut above = squares;
    for count in (1..=count).rev() {
        let square = (0..above)
            .rev()
            .find(|square| choose(*square, count) <= number);
        let square = square.unwrap_or_default();
        number -= choose(square, count);
        set |= 1 << square;
        above = square;
    }
    set
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_position_is_at_its_own_place() {
        let index = Index::new(3);
        let mut seen = 0;
        for slice in index.slices() {
            for place in 0..slice.len {
                let Some(position) = index.position(slice, place) else {
                    continue;
                };
                assert_eq!(index.place(&position), Some(slice.begin + place));
                seen += 1;
            }
        }
        assert_eq!(seen, counted());
    }

    /// All ways to put white and black pieces on two or three squares, and not those of one colour.
    fn counted() -> usize {
        let white = |square: u8| 1 + usize::from(square >= 4);
        let black = |square: u8| 1 + usize::from(square < 28);
        let ways = |squares: &[u8]| {
            let both: usize = squares.iter().map(|at| white(*at) + black(*at)).product();
            let white: usize = squares.iter().map(|at| white(*at)).product();
            let black: usize = squares.iter().map(|at| black(*at)).product();
            both - white - black
        };
        let mut count = 0;
        for a in 0..32 {
            for b in 0..a {
                count += ways(&[a, b]);
                for c in 0..b {
                    count += ways(&[a, b, c]);
                }
            }
        }
        count
    }
}
