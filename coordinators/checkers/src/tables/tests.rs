//! Tables against the rules, against what is known of endgames, and files that are not as they should be.

use std::sync::LazyLock;

use rand::{RngExt, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{
    Numbering,
    board::bit,
    search::{Limits, search},
};

/// Three pieces of every variant.
static SMALL: LazyLock<Vec<Tables>> = LazyLock::new(|| {
    Variant::ALL
        .into_iter()
        .map(|variant| Tables::make(variant, 3))
        .collect()
});

/// Four pieces of the default.
static LARGE: LazyLock<Tables> = LazyLock::new(|| Tables::make(Variant::Brazilian, 4));

/// A position of the tables, by chance.
fn drawn_by_lot(random: &mut ChaCha8Rng, pieces: u32) -> Position {
    loop {
        let count = random.random_range(2..=pieces);
        let mut position = Position {
            white: 0,
            black: 0,
            kings: 0,
            turn: *[Colour::White, Colour::Black].choose(random).unwrap(),
        };
        for _ in 0..count {
            let square = bit(random.random_range(0..32));
            if (position.white | position.black) & square != 0 {
                continue;
            }
            let colour = *[Colour::White, Colour::Black].choose(random).unwrap();
            match colour {
                Colour::White => position.white |= square,
                Colour::Black => position.black |= square,
            }
            if random.random() || square & colour.crown_row() != 0 {
                position.kings |= square;
            }
        }
        if position.white != 0 && position.black != 0 {
            return position;
        }
    }
}

/// What a position is worth by those that follow it.
fn by_its_moves(tables: &Tables, position: &Position) -> Outcome {
    let mut outcomes = Vec::new();
    for step in position.moves(tables.variant()) {
        let next = position.after(step);
        outcomes.push(match tables.outcome(&next) {
            Some(outcome) => outcome,
            None => {
                assert_eq!(
                    next.own(),
                    0,
                    "a position without pieces of a side is no entry"
                );
                Outcome::Lost(0)
            }
        });
    }
    let won = outcomes.iter().filter_map(|outcome| match outcome {
        Outcome::Lost(plies) => Some(plies + 1),
        _ => None,
    });
    if let Some(plies) = won.min() {
        return Outcome::Won(plies);
    }
    let lost = outcomes.iter().map(|outcome| match outcome {
        Outcome::Won(plies) => Some(plies + 1),
        _ => None,
    });
    match lost.collect::<Option<Vec<u8>>>() {
        Some(plies) => Outcome::Lost(plies.into_iter().max().unwrap_or_default()),
        None => Outcome::Draw,
    }
}

#[test]
fn every_value_follows_from_the_moves_of_its_position() {
    let mut random = ChaCha8Rng::seed_from_u64(24);
    for tables in SMALL.iter() {
        follows(tables, &mut random);
    }
}

fn follows(tables: &Tables, random: &mut ChaCha8Rng) {
    for _ in 0..5000 {
        let position = drawn_by_lot(random, tables.pieces());
        let value = tables.outcome(&position).unwrap();
        let fen = position.fen(Numbering::Plain);
        let variant = tables.variant();
        assert_eq!(value, by_its_moves(tables, &position), "{variant:?} {fen}");
    }
}

fn outcome(tables: &Tables, fen: &str) -> Outcome {
    let position = Position::read(fen, tables.variant(), Numbering::Plain).unwrap();
    tables.outcome(&position).unwrap()
}

fn small(variant: Variant, fen: &str) -> Outcome {
    let tables = SMALL.iter().find(|tables| tables.variant() == variant);
    outcome(tables.unwrap(), fen)
}

#[test]
fn endgames_end_as_the_books_say() {
    // Two kings do not win against one that is not caught.
    assert_eq!(small(Variant::Russian, "W:WK30,K31:BK4"), Outcome::Draw);
    // Without flying kings two win against one.
    for variant in [Variant::English, Variant::Italian] {
        assert!(matches!(small(variant, "W:WK18,K19:BK1"), Outcome::Won(_)));
        // One does not.
        assert_eq!(small(variant, "W:WK32:BK1"), Outcome::Draw);
    }
}

/// One test, since the tables of four pieces take a while.
#[test]
fn four_pieces_are_right_and_a_search_keeps_their_value_with_tables_and_nearly_always_without() {
    let mut random = ChaCha8Rng::seed_from_u64(1000);
    // Petrov's triangle: three kings win against one that does not hold the main road, and not against one that does.
    assert!(matches!(
        outcome(&LARGE, "W:WK1,K2,K3:BK13"),
        Outcome::Won(_)
    ));
    assert_eq!(outcome(&LARGE, "W:WK1,K2,K3:BK18"), Outcome::Draw);
    follows(&LARGE, &mut random);
    for _ in 0..1000 {
        keeps(&drawn_by_lot(&mut random, 4), Some(&LARGE), 20_000);
    }
    let kept = (0..250).filter(|_| keeps(&drawn_by_lot(&mut random, 4), None, 20_000));
    let kept = kept.count();
    assert!(kept >= 247, "{kept} of 250");
}

/// Whether the move that a search plays keeps what the tables say.
fn keeps(position: &Position, with: Option<&Tables>, nodes: u64) -> bool {
    let variant = LARGE.variant();
    let mut never = || false;
    let limits = Limits {
        nodes: Some(nodes),
        depth: 99,
        stop: &mut never,
    };
    let found = search(position, variant, &[], with, limits);
    let before = LARGE.outcome(position).unwrap();
    let Some(step) = found.line.first() else {
        assert_eq!(before, Outcome::Lost(0));
        return true;
    };
    let next = position.after(*step);
    let after = LARGE.outcome(&next).unwrap_or(Outcome::Lost(0));
    let kept = match before {
        Outcome::Won(_) => matches!(after, Outcome::Lost(_)),
        Outcome::Draw => after == Outcome::Draw,
        Outcome::Lost(_) => true,
    };
    if with.is_some() {
        let fen = position.fen(Numbering::Plain);
        assert!(kept, "{fen}: {before:?}, {after:?}");
        assert_eq!(found.value, before.value(0), "{fen}");
    }
    kept
}

#[test]
fn tables_come_back_from_their_file() {
    let folder = tempfile::tempdir().unwrap();
    let tables = &SMALL[0];
    let file = tables.write(folder.path()).unwrap();
    assert_eq!(file.file_name().unwrap().to_str(), Some("brazilian.tables"));
    let read = Tables::read(folder.path(), Variant::Brazilian).unwrap();
    assert!(read.values == tables.values && read.pieces() == 3);
}

#[test]
fn a_file_that_is_not_as_it_should_be_is_refused_with_its_reason() {
    let good = Tables::make(Variant::English, 2).bytes();
    let refused = |bytes: &[u8]| Tables::parse(bytes, Variant::English).err().unwrap();
    assert!(Tables::parse(&good, Variant::English).is_ok());
    assert!(refused(b"").contains("no file of endgame tables"));
    assert!(refused(&good[..20]).contains("ends within its head"));
    assert!(refused(&good[..good.len() - 1]).contains("values"));
    let changed = |at: usize| {
        let mut bytes = good.clone();
        bytes[at] ^= 1;
        bytes
    };
    assert!(refused(&changed(0)).contains("no file"));
    assert!(refused(&changed(8)).contains("version"));
    assert!(refused(&changed(12)).contains("draughts, not of english"));
    assert!(refused(&changed(good.len() - 1)).contains("checksum"));
    assert!(refused(&changed(25)).contains("checksum"));
    let other = Tables::parse(&good, Variant::Czech).err().unwrap();
    assert_eq!(other, "it is of english draughts, not of czech");
    let missing = Tables::read(std::path::Path::new("no/such"), Variant::Czech);
    assert!(
        missing
            .err()
            .unwrap()
            .to_string()
            .contains("no/such/czech.tables")
    );
}
