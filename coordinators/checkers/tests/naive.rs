//! The moves again, by a generator that shares nothing with the one that is tried: squares in a table, and naive recursion.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::collections::BTreeSet;

use checkers::{Colour, Leaves, Piece, Position, Variant, perft};
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

type At = (i32, i32);

/// A capture: where it lands in the end, and what it captured in order.
type Capture = (At, Vec<At>);

/// From, to, what in order.
type Allowed = (At, At, Vec<At>);

/// A move, with the squares of what it captures.
type Found = BTreeSet<(u8, u8, BTreeSet<u8>)>;

fn at(square: u8) -> At {
    let row = i32::from(square) / 4;
    let column = 2 * (i32::from(square) % 4) + i32::from(row % 2 == 0);
    (column, row)
}

fn square((column, row): At) -> u8 {
    u8::try_from(row * 4 + column / 2).unwrap()
}

struct Naive {
    variant: Variant,
    turn: Colour,
    board: Vec<Vec<Option<Piece>>>,
}

impl Naive {
    fn new(position: &Position, variant: Variant) -> Self {
        let mut board = vec![vec![None; 8]; 8];
        for number in 0..32 {
            let (column, row) = at(number);
            board[row as usize][column as usize] = position.piece(number);
        }
        Self {
            variant,
            turn: position.turn,
            board,
        }
    }

    fn on_board((column, row): At) -> bool {
        (0..8).contains(&column) && (0..8).contains(&row)
    }

    fn get(&self, (column, row): At) -> Option<Piece> {
        self.board[row as usize][column as usize]
    }

    fn flying(&self) -> bool {
        !matches!(self.variant, Variant::English | Variant::Italian)
    }

    fn forward(&self) -> i32 {
        if self.turn == Colour::White { -1 } else { 1 }
    }

    fn last_row(&self) -> i32 {
        if self.turn == Colour::White { 0 } else { 7 }
    }

    fn captures(&self, from: At, king: bool, taken: &[At], here: At) -> Vec<Capture> {
        let men_back = matches!(
            self.variant,
            Variant::Brazilian | Variant::Russian | Variant::Pool
        );
        let free =
            |place: At| Self::on_board(place) && (place == from || self.get(place).is_none());
        let mut all = Vec::new();
        for (dx, dy) in [(-1, -1), (1, -1), (-1, 1), (1, 1)] {
            if !king && !men_back && dy != self.forward() {
                continue;
            }
            let mut over = (here.0 + dx, here.1 + dy);
            while king && self.flying() && free(over) {
                over = (over.0 + dx, over.1 + dy);
            }
            if !Self::on_board(over) || over == from || taken.contains(&over) {
                continue;
            }
            let Some(prey) = self.get(over).filter(|prey| prey.colour != self.turn) else {
                continue;
            };
            if self.variant == Variant::Italian && !king && prey.king && !self.is_king(from) {
                continue;
            }
            let mut landings = Vec::new();
            let mut landing = (over.0 + dx, over.1 + dy);
            while free(landing) {
                landings.push(landing);
                if !(king && self.flying()) {
                    break;
                }
                landing = (landing.0 + dx, landing.1 + dy);
            }
            let mut longer = Vec::new();
            for landing in &landings {
                let mut taken = taken.to_vec();
                taken.push(over);
                let crowned = self.variant == Variant::Russian && landing.1 == self.last_row();
                longer.extend(self.captures(from, king || crowned, &taken, *landing));
            }
            if longer.is_empty() {
                let mut taken = taken.to_vec();
                taken.push(over);
                longer = landings.into_iter().map(|to| (to, taken.clone())).collect();
            }
            all.extend(longer);
        }
        all
    }

    fn is_king(&self, place: At) -> bool {
        self.get(place).is_some_and(|piece| piece.king)
    }

    /// All captures that the rules allow: from, to, what in order.
    fn allowed(&self) -> Vec<Allowed> {
        let mut all = Vec::new();
        for number in 0..32 {
            let from = at(number);
            if let Some(piece) = self.get(from).filter(|piece| piece.colour == self.turn) {
                let captures = self.captures(from, piece.king, &[], from);
                all.extend(captures.into_iter().map(|(to, over)| (from, to, over)));
            }
        }
        let keep = |all: &mut Vec<Allowed>, worth: &dyn Fn(&Allowed) -> Vec<bool>| {
            let best = all.iter().map(worth).max().unwrap_or_default();
            all.retain(|capture| worth(capture) == best);
        };
        let many = |count: usize| (0..32).map(|at| at < count).collect::<Vec<bool>>();
        let count = |capture: &Allowed| many(capture.2.len());
        let with_king = |capture: &Allowed| vec![self.is_king(capture.0)];
        let kings =
            |capture: &Allowed| many(capture.2.iter().filter(|over| self.is_king(**over)).count());
        let early = |capture: &Allowed| {
            capture
                .2
                .iter()
                .map(|over| self.is_king(*over))
                .collect::<Vec<bool>>()
        };
        match self.variant {
            Variant::Brazilian => keep(&mut all, &count),
            Variant::Czech => keep(&mut all, &with_king),
            Variant::Spanish => {
                keep(&mut all, &count);
                keep(&mut all, &kings);
            }
            Variant::Italian => {
                keep(&mut all, &count);
                keep(&mut all, &with_king);
                keep(&mut all, &kings);
                keep(&mut all, &early);
            }
            Variant::Russian | Variant::Pool | Variant::English => {}
        }
        all
    }

    fn quiet(&self) -> Vec<(At, At)> {
        let mut all = Vec::new();
        for number in 0..32 {
            let from = at(number);
            let Some(piece) = self.get(from).filter(|piece| piece.colour == self.turn) else {
                continue;
            };
            for (dx, dy) in [(-1, -1), (1, -1), (-1, 1), (1, 1)] {
                if !piece.king && dy != self.forward() {
                    continue;
                }
                let mut to = (from.0 + dx, from.1 + dy);
                while Self::on_board(to) && self.get(to).is_none() {
                    all.push((from, to));
                    if !(piece.king && self.flying()) {
                        break;
                    }
                    to = (to.0 + dx, to.1 + dy);
                }
            }
        }
        all
    }
}

fn agree(position: &Position, variant: Variant) -> Result<(), TestCaseError> {
    let naive = Naive::new(position, variant);
    let allowed = naive.allowed();
    let found: Found = position
        .moves(variant)
        .into_iter()
        .map(|step| (step.from, step.to, checkers::each(step.captured).collect()))
        .collect();
    let (expected, orders): (Found, usize) = if allowed.is_empty() {
        let quiet = naive.quiet();
        let count = quiet.len();
        let moves = quiet.into_iter();
        (
            moves
                .map(|(from, to)| (square(from), square(to), BTreeSet::new()))
                .collect(),
            count,
        )
    } else {
        let orders: BTreeSet<_> = allowed.iter().cloned().collect();
        let moves = allowed.into_iter().map(|(from, to, over)| {
            (
                square(from),
                square(to),
                over.into_iter().map(square).collect(),
            )
        });
        (moves.collect(), orders.len())
    };
    prop_assert_eq!(
        &found,
        &expected,
        "{:?} {}",
        variant,
        position.fen(checkers::Numbering::Plain)
    );
    prop_assert_eq!(
        perft(position, variant, 1, Leaves::Moves),
        Some(expected.len() as u64)
    );
    prop_assert_eq!(
        perft(position, variant, 1, Leaves::Orders),
        Some(orders as u64)
    );
    prop_assert_eq!(
        position.captures(variant),
        found.iter().any(|step| !step.2.is_empty())
    );
    Ok(())
}

/// A position anyhow: men not in their last row.
fn scattered(random: &mut impl Rng, full: f64) -> Position {
    let mut position = Position {
        white: 0,
        black: 0,
        kings: 0,
        turn: if random.random() {
            Colour::White
        } else {
            Colour::Black
        },
    };
    for square in 0..32 {
        if !random.random_bool(full) {
            continue;
        }
        let bit = 1_u32 << square;
        let white = random.random();
        let colour = if white { Colour::White } else { Colour::Black };
        if white {
            position.white |= bit;
        } else {
            position.black |= bit;
        }
        if colour.crown_row() & bit != 0 || random.random_bool(0.3) {
            position.kings |= bit;
        }
    }
    position
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn positions_of_random_games_have_the_moves_of_a_naive_generator(seed: u64) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for variant in Variant::ALL {
            let mut position = Position::start(variant.starts());
            for _ in 0..120 {
                agree(&position, variant)?;
                let moves = position.moves(variant);
                let Some(step) = moves.choose(&mut random) else { break };
                position = position.after(*step);
            }
        }
    }

    #[test]
    fn scattered_pieces_have_the_moves_of_a_naive_generator(seed: u64, full in 0.1..0.8_f64) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for variant in Variant::ALL {
            for _ in 0..8 {
                agree(&scattered(&mut random, full), variant)?;
            }
        }
    }

    #[test]
    fn the_turned_board_has_as_many_games(seed: u64, full in 0.1..0.6_f64) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let position = scattered(&mut random, full);
        for variant in Variant::ALL {
            for leaves in [Leaves::Moves, Leaves::Orders] {
                prop_assert_eq!(
                    perft(&position, variant, 2, leaves),
                    perft(&position.turned(), variant, 2, leaves)
                );
            }
        }
    }
}
