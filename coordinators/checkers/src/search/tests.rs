//! The search against one that cuts nothing off, and what it must see.

use rand::{SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{Numbering, board::Colour};

fn position(fen: &str, variant: Variant) -> Position {
    Position::read(fen, variant, Numbering::Plain).unwrap()
}

fn found(position: &Position, variant: Variant, depth: u32) -> Found {
    // Enough for a shallow search, and no more room for known positions than that.
    let limits = Limits {
        nodes: (depth < 8).then_some(100_000),
        depth,
        stop: &mut || false,
    };
    search(position, variant, &[], None, limits)
}

/// The value by all moves, without windows, tables or an order.
fn plain(position: &Position, variant: Variant, depth: i32, ply: i32) -> i32 {
    let moves = position.moves(variant);
    let Some(first) = moves.first() else {
        return -WON + ply;
    };
    let captures = first.captured != 0;
    if depth <= 0 && !captures {
        return evaluate::value(position, &variant.rules());
    }
    let deeper = if captures && moves.len() == 1 {
        depth
    } else {
        depth - 1
    };
    let values = moves
        .iter()
        .map(|step| -plain(&position.after(*step), variant, deeper, ply + 1));
    values.max().unwrap_or(-WON)
}

#[test]
fn the_value_is_that_of_a_search_that_cuts_nothing_off() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for variant in Variant::ALL {
        let mut at = Position::start(variant.starts());
        for _ in 0..30 {
            for depth in 1..4 {
                let found = found(&at, variant, depth);
                let expected = plain(&at, variant, depth.cast_signed(), 0);
                let fen = at.fen(Numbering::Plain);
                assert_eq!(found.value, expected, "{variant:?} {fen} depth {depth}");
            }
            let moves = at.moves(variant);
            let Some(step) = moves.choose(&mut random) else {
                break;
            };
            at = at.after(*step);
        }
    }
}

#[test]
fn the_line_can_be_played_and_leads_to_the_value() {
    let variant = Variant::Russian;
    let start = Position::start(Colour::White);
    let found = found(&start, variant, 7);
    let mut at = start;
    for step in &found.line {
        assert!(at.moves(variant).contains(step));
        at = at.after(*step);
    }
    let sign = if at.turn == start.turn { 1 } else { -1 };
    assert_eq!(found.value, sign * evaluate::value(&at, &variant.rules()));
}

#[test]
fn an_end_that_is_in_reach_is_seen_with_its_distance() {
    // One man is given, and the way to the last piece is free.
    let won = found(
        &position("W:W22:B18", Variant::English),
        Variant::English,
        9,
    );
    assert_eq!((won.value, won.line.len()), (WON - 1, 1));
    // Two kings against one in the double corner's neighbourhood.
    let won = found(
        &position("W:WK15,K22:BK32", Variant::English),
        Variant::English,
        20,
    );
    assert!(won.value > PROVEN, "{}", won.value);
    let lost = found(
        &position("B:WK22:B13", Variant::Brazilian),
        Variant::Brazilian,
        12,
    );
    assert!(lost.value < -PROVEN, "{}", lost.value);
}

#[test]
fn a_position_that_occurred_before_is_a_draw() {
    let variant = Variant::English;
    let at = position("W:WK32:BK1", variant);
    let before: Vec<u64> = at
        .moves(variant)
        .iter()
        .map(|step| at.after(*step).key())
        .collect();
    let limits = Limits {
        nodes: None,
        depth: 1,
        stop: &mut || false,
    };
    assert_eq!(search(&at, variant, &before, None, limits).value, 0);
    assert_ne!(
        found(&position("W:WK32,K31:BK1", variant), variant, 1).value,
        0
    );
}

#[test]
fn a_search_stops_when_it_is_told_and_has_a_move_even_then() {
    let start = Position::start(Colour::White);
    let mut asked = 0;
    let limits = Limits {
        nodes: None,
        depth: 99,
        stop: &mut || {
            asked += 1;
            asked > 40
        },
    };
    let some = search(&start, Variant::Brazilian, &[], None, limits);
    assert!(some.nodes <= 41 * ASKED_EVERY && !some.line.is_empty());
    let limits = Limits {
        nodes: None,
        depth: 99,
        stop: &mut || true,
    };
    // However late it is, one half-move is looked ahead.
    let little = search(&start, Variant::Brazilian, &[], None, limits);
    assert!(little.depth > 0 && little.nodes <= ASKED_EVERY && !little.line.is_empty());
}
