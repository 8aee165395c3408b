//! Numbers of games that others published.
//!
//! Rein Halbersma, "Perft for all recognized draughts variants" (damforum.nl, topic 2822), and the tests of his
//! `dctl` (test/src/algo/traversal), with and without captures that differ only in their order; Aart Bik, "perft for 8x8
//! checkers" (talkchess.com, topic 27814), for English; the positions of Ed Gilbert for Italian.

use checkers::{Leaves, Numbering, Position, Variant, perft};

fn counts(position: &Position, variant: Variant, leaves: Leaves, depths: usize) -> Vec<u64> {
    (1..)
        .take(depths)
        .map(|depth| perft(position, variant, depth, leaves).unwrap_or_default())
        .collect()
}

const FIRST: [u64; 4] = [7, 49, 302, 1469];

/// From depth 5 on: moves, then orders.
const PUBLISHED: [(Variant, [u64; 6], [u64; 6]); 7] = [
    (
        Variant::Brazilian,
        [7_473, 37_628, 187_302, 907_830, 4_431_766, 21_560_022],
        [7_473, 37_628, 187_302, 907_836, 4_431_847, 21_566_606],
    ),
    (
        Variant::Pool,
        [7_482, 37_986, 190_146, 929_896, 4_570_534, 22_435_955],
        [7_482, 37_986, 190_146, 929_902, 4_570_615, 22_442_551],
    ),
    (
        Variant::Russian,
        [7_482, 37_986, 190_146, 929_899, 4_570_586, 22_444_032],
        [7_482, 37_986, 190_146, 929_905, 4_570_667, 22_450_628],
    ),
    (
        Variant::English,
        [7_361, 36_768, 179_740, 845_931, 3_963_680, 18_391_564],
        [7_361, 36_768, 179_740, 845_931, 3_963_680, 18_391_564],
    ),
    (
        Variant::Czech,
        [7_361, 36_768, 179_740, 845_931, 3_963_671, 18_368_918],
        [7_361, 36_768, 179_740, 845_931, 3_963_671, 18_368_918],
    ),
    (
        Variant::Spanish,
        [7_361, 36_473, 177_532, 828_783, 3_860_866, 17_743_464],
        [7_361, 36_473, 177_532, 828_783, 3_860_866, 17_743_464],
    ),
    (
        Variant::Italian,
        [7_361, 36_473, 177_532, 828_783, 3_860_875, 17_761_384],
        [7_361, 36_473, 177_532, 828_783, 3_860_875, 17_761_384],
    ),
];

#[test]
fn every_variant_has_the_published_number_of_games_to_depth_10() {
    for (variant, moves, _) in PUBLISHED {
        let start = Position::start(variant.starts());
        let expected = [FIRST.as_slice(), &moves].concat();
        assert_eq!(
            counts(&start, variant, Leaves::Moves, 10),
            expected,
            "{variant:?}"
        );
    }
}

#[test]
fn every_variant_has_the_published_number_of_games_to_depth_10_when_orders_of_captures_count() {
    for (variant, _, orders) in PUBLISHED {
        let start = Position::start(variant.starts());
        let expected = [FIRST.as_slice(), &orders].concat();
        assert_eq!(
            counts(&start, variant, Leaves::Orders, 10),
            expected,
            "{variant:?}"
        );
    }
}

#[test]
fn positions_of_ed_gilbert_have_the_published_numbers_of_italian_games() {
    let cases: [(&str, &[u64]); 3] = [
        (
            "W:W30,26,27,22,23,24,17,18,20:B14,15,16,9,11,5,6,1,3",
            &[
                5, 13, 42, 107, 360, 1_099, 3_736, 12_495, 43_686, 164_177, 628_686, 2_643_623,
            ],
        ),
        (
            "B:W30,21,22,17,20,K6:B25,28,9,5,1,3",
            &[6, 47, 271, 1_916, 10_810, 73_137, 389_809, 2_469_050],
        ),
        (
            "W:WK27,K28,17,20,9,K12,8:B21,24,K19,K13,14,K11,4",
            &[13, 112, 828, 6_756, 46_241, 368_908, 2_468_110],
        ),
    ];
    for (fen, expected) in cases {
        let position = Position::read(fen, Variant::Italian, Numbering::Mirrored).unwrap();
        let found = counts(&position, Variant::Italian, Leaves::Orders, expected.len());
        assert_eq!(found, expected, "{fen}");
    }
}
