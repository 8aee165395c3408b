//! What programs of checkers get wrong, rule by rule; the moves follow from the text of the rules, which stands beside each.
//!
//! Squares are written as on the plain board (1 is b8, 32 is g1) for all variants but where the Italian rule book is quoted.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use Variant::{Brazilian, Czech, English, Italian, Pool, Russian, Spanish};
use checkers::{Leaves, Numbering, Position, Variant, Written, perft};

const ALL: &[Variant] = &Variant::ALL;

/// The rule, the variants where it is so, a position, and its moves.
type Trap = (
    &'static str,
    &'static [Variant],
    &'static str,
    &'static [&'static str],
);

const TRAPS: &[Trap] = &[
    ("a capture is compulsory", ALL, "W:W22,32:B18", &["22x15"]),
    (
        "men capture backwards too",
        &[Brazilian, Russian, Pool],
        "W:W15:B19",
        &["15x24"],
    ),
    (
        "men do not capture backwards",
        &[English, Italian, Spanish, Czech],
        "W:W15:B19",
        &["15-10", "15-11"],
    ),
    (
        "the largest number must be captured",
        &[Brazilian, Italian, Spanish],
        "W:W22,24:B17,19,10",
        &["24x15x6"],
    ),
    (
        "any capture will do, but it goes on to its end",
        &[Russian, Pool, English, Czech],
        "W:W22,24:B17,19,10",
        &["22x13", "24x15x6"],
    ),
    (
        "a man that only passes the last row goes on as a man",
        &[Brazilian, Pool],
        "W:W9:B6,7",
        &["9x2x11"],
    ),
    (
        "a man that reaches the last row goes on as a king at once",
        &[Russian],
        "W:W9:B6,7",
        &["9x2x11", "9x2x16", "9x2x20"],
    ),
    (
        "a man that reaches the last row has ended its move",
        &[English, Italian, Spanish, Czech],
        "W:W9:B6,7",
        &["9x2"],
    ),
    (
        "a man crowned in passing captures at a distance",
        &[Russian],
        "W:W9:B6,16",
        &["9x2x20"],
    ),
    (
        "a man crowned at its end captures no more",
        &[Brazilian, Pool, English, Italian, Spanish, Czech],
        "W:W9:B6,16",
        &["9x2"],
    ),
    (
        "captured pieces are lifted after the move: the piece on 18 is in the way from 9 to 23 (Turkish strike)",
        &[Brazilian, Spanish],
        "W:WK25:B18,7,6,23",
        &["25x11x2x13", "25x11x2x9"],
    ),
    (
        "two orders of the same captures are one move, and the square where it began is empty",
        &[Brazilian, Russian, Pool],
        "W:W26:B22,14,15,23",
        &["26x17x10x19x26"],
    ),
    (
        "kings that do not fly capture in a circle",
        &[English, Italian],
        "W:WK26:B22,14,15,23",
        &["26x17x10x19x26"],
    ),
    (
        "a king must land where it can go on",
        &[Brazilian, Russian, Pool, Spanish, Czech],
        "W:WK29:B22,10",
        &["29x15x1", "29x15x6"],
    ),
    (
        "a king captures two pieces on one line, and where it lands between them is no difference",
        &[Brazilian, Russian, Pool, Spanish, Czech],
        "W:WK29:B22,11",
        &["29x18x4", "29x18x8"],
    ),
    (
        "two pieces without an empty square between them cannot be jumped",
        ALL,
        "W:WK29:B25,22",
        &[],
    ),
    (
        "two pieces behind one another stop a king",
        ALL,
        "W:WK29:B22,18",
        &["29-25"],
    ),
    (
        "a king that does not fly captures only what is beside it, backwards too",
        &[English, Italian],
        "W:WK15:B18,6",
        &["15x22"],
    ),
    (
        "where a king can capture, a king must",
        &[Czech],
        "W:WK29,24:B22,19",
        &["29x11", "29x15", "29x18", "29x4", "29x8"],
    ),
    (
        "a king has no precedence",
        &[Brazilian, Russian, Pool, Spanish],
        "W:WK29,24:B22,19",
        &["24x15", "29x11", "29x15", "29x18", "29x4", "29x8"],
    ),
    (
        "of as many pieces, most kings must be captured",
        &[Spanish],
        "W:W22,24:BK17,19",
        &["22x13"],
    ),
    (
        "kings are worth no more than men",
        &[Brazilian, Russian, Pool, English, Czech],
        "W:W22,24:BK17,19",
        &["22x13", "24x15"],
    ),
    (
        "a man may not capture a king",
        &[Italian],
        "W:W22:BK17",
        &["22-18"],
    ),
    (
        "a side that cannot move has no move",
        ALL,
        "W:W13:B9,6",
        &[],
    ),
    ("a side without pieces has no move", ALL, "W:W:B9", &[]),
    ("Black's men go down", ALL, "B:W:B9", &["9-13", "9-14"]),
];

fn words(position: &Position, variant: Variant, numbering: Numbering) -> Vec<String> {
    let words = position.words(variant, numbering);
    words.into_iter().map(|(word, _)| word).collect()
}

#[test]
fn every_trap_has_the_moves_of_its_rule() {
    for (rule, variants, fen, expected) in TRAPS {
        for variant in *variants {
            let position = Position::read(fen, *variant, Numbering::Plain).unwrap();
            assert_eq!(
                words(&position, *variant, Numbering::Plain),
                *expected,
                "{variant:?}, {fen}: {rule}"
            );
        }
    }
}

#[test]
fn a_circle_counts_once_as_a_move_and_twice_as_orders() {
    let position = Position::read("W:W26:B22,14,15,23", Brazilian, Numbering::Plain).unwrap();
    assert_eq!(perft(&position, Brazilian, 1, Leaves::Moves), Some(1));
    assert_eq!(perft(&position, Brazilian, 1, Leaves::Orders), Some(2));
}

fn after(fen: &str, word: &str, variant: Variant) -> String {
    let numbering = Numbering::Plain;
    let position = Position::read(fen, variant, numbering).unwrap();
    let written = Written::read(word, numbering).unwrap();
    let step = position.find(&written, variant, numbering).unwrap();
    position.after(step).fen(numbering)
}

#[test]
fn what_passes_the_last_row_becomes_a_king_only_where_the_rules_say_so() {
    assert_eq!(after("W:W9:B6,7", "9x2x11", Brazilian), "B:W11:B");
    assert_eq!(after("W:W9:B6,7", "9x11", Pool), "B:W11:B");
    assert_eq!(after("W:W9:B6,7", "9x2x11", Russian), "B:WK11:B");
    assert_eq!(after("W:W9:B6,7", "9x2", English), "B:WK2:B7");
    assert_eq!(after("W:W9:B6,16", "9x2", Brazilian), "B:WK2:B16");
    assert_eq!(after("W:W6:B12", "6-1", Czech), "B:WK1:B12");
}

#[test]
fn a_landing_between_two_captured_pieces_may_be_written_as_any_of_its_squares() {
    for word in ["29x18x8", "29x15x8", "29x8", "29:15:8", "a1xe5xg7", "a1:g7"] {
        assert_eq!(after("W:WK29:B22,11", word, Russian), "B:WK8:B", "{word}");
    }
}

/// The regulations of the Italian federation (FID), chapter I, articles 5.3 to 6.10, with Italian numbers; the FENs are those of
/// `dctl` by Rein Halbersma, test/src/actions/rulebook/italian.cpp and regressions/italian.cpp.
#[test]
fn the_positions_of_the_italian_rule_book_have_its_moves() {
    let cases: [(&str, &str, &[&str]); 12] = [
        ("5.6", "W:W30:B27", &["30x23"]),
        ("5.7", "W:W31:B12,20,28", &["31x8"]),
        ("5.8", "W:WK22:B18,19,27", &["22x13", "22x15", "22x31"]),
        ("5.9", "W:WK27:B5,6,13,15,21,23", &["27x25"]),
        ("6.6", "W:WK21,31:B10,18,27", &["31x6"]),
        ("6.7", "W:WK23,31:B19,26,27", &["23x21"]),
        ("6.8", "W:WK23:B19,K28", &["23x32"]),
        ("6.9", "W:WK30:B10,12,18,K20,K26,27", &["30x5"]),
        ("6.9, Alioto", "W:WK30:B10,K12,K18,20,K26,K27", &["30x5"]),
        ("6.10", "W:WK31:B18,20,K27,K28", &["31x13", "31x15"]),
        ("5.3 b", "W:W32:BK28", &[]),
        ("5.3 b", "W:W30:BK26", &["30-27"]),
    ];
    for (article, fen, expected) in cases {
        let position = Position::read(fen, Italian, Numbering::Mirrored).unwrap();
        let moves = position.moves(Italian);
        let mut found: Vec<String> = moves
            .iter()
            .map(|step| Numbering::Mirrored.short(*step, 'x'))
            .collect();
        found.sort();
        assert_eq!(found, expected, "article {article}");
    }
}
