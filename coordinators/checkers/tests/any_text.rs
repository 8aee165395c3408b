//! Any text as a position, a move or a file of games: an answer or a reason, never a panic, and soon.

use checkers::{LONGEST, Numbering, Position, Variant, Written, pdn};
use proptest::{prelude::*, sample::select};

const NUMBERINGS: [Numbering; 3] = [Numbering::Plain, Numbering::Mirrored, Numbering::Turned];

/// Texts that are nearly right.
fn nearly() -> impl Strategy<Value = String> {
    const WORDS: &[&str] = &[
        "W",
        "B",
        ":",
        ",",
        "K",
        "-",
        "x",
        ".",
        "1",
        "12",
        "32",
        "33",
        "0",
        "99999999999999999999",
        "a1",
        "h8",
        "a8",
        "{",
        "}",
        "(",
        ")",
        "[",
        "]",
        "\"",
        "FEN",
        "GameType",
        "[GameType \"25\"]",
        "[FEN \"W:W18:B9\"]",
        "11-15",
        "22x13",
        "9x18x27",
        "c3-d4",
        "1-0",
        "*",
        "$1",
        "%",
        ";",
        "\n",
        "1.",
        "1...",
        "!?",
        "\\",
        "é",
        "\u{1F600}",
        "start",
        "?",
        "1-12",
        "12-1",
    ];
    proptest::collection::vec(prop_oneof![Just(" "), select(WORDS), select(WORDS)], 0..40)
        .prop_map(|words| words.concat())
}

fn answered(text: &str) -> Result<(), TestCaseError> {
    for variant in Variant::ALL {
        for numbering in NUMBERINGS {
            match Position::read(text, variant, numbering) {
                Ok(position) => {
                    // What is written is read as the same.
                    let fen = position.fen(numbering);
                    let again = Position::read(&fen, variant, numbering);
                    prop_assert_eq!(again, Ok(position));
                    let words = position.words(variant, numbering);
                    for (word, step) in words {
                        let written = Written::read(&word, numbering);
                        prop_assert!(written.is_ok(), "{}", word);
                        let found = position.find(
                            &written.unwrap_or(Written {
                                squares: vec![],
                                captures: None,
                            }),
                            variant,
                            numbering,
                        );
                        prop_assert!(found == Ok(step) || found.is_err());
                    }
                }
                Err(error) => {
                    prop_assert!(error.line >= 1 && error.column >= 1 && !error.reason.is_empty())
                }
            }
            if let Ok(written) = Written::read(text, numbering) {
                let start = Position::start(variant.starts());
                if let Err(refusal) = start.find(&written, variant, numbering) {
                    prop_assert!(!refusal.0.is_empty());
                }
            }
        }
        for game in pdn::read(text, variant) {
            match game {
                Ok(game) => {
                    let again = pdn::read(&game.write(), variant);
                    prop_assert_eq!(again.len(), 1);
                    prop_assert_eq!(again[0].as_ref().map(pdn::Record::end), Ok(game.end()));
                }
                Err(error) => {
                    prop_assert!(error.line >= 1 && error.column >= 1 && !error.reason.is_empty())
                }
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn any_bytes_are_answered(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        answered(&String::from_utf8_lossy(&bytes))?;
    }

    #[test]
    fn what_is_nearly_right_is_answered(text in nearly()) {
        answered(&text)?;
    }
}

#[test]
fn a_long_text_is_refused_before_it_is_read() {
    let long = format!("W:W{}", "1,".repeat(LONGEST));
    let error = Position::read(&long, Variant::Russian, Numbering::Plain);
    assert!(error.is_err_and(|error| error.reason.contains("at most")));
    let error = Written::read(&"1-".repeat(LONGEST), Numbering::Plain);
    assert!(error.is_err_and(|error| error.reason.contains("at most")));
    let long = " ".repeat(pdn::LONGEST_FILE + 1);
    assert!(pdn::read(&long, Variant::Russian).remove(0).is_err());
}

#[test]
fn deep_variations_and_many_games_are_read_in_one_pass() {
    let deep = format!("1. 22-18 {} *", "(".repeat(1_000_000));
    assert!(pdn::read(&deep, Variant::Brazilian).remove(0).is_err());
    let many = "1. 22-18 *\n".repeat(100_000);
    let games = pdn::read(&many, Variant::Brazilian);
    assert!(games.len() == 100_000 && games.iter().all(Result::is_ok));
}

#[test]
fn positions_are_read_in_every_form_of_the_standard() {
    let read = |text: &str| Position::read(text, Variant::Brazilian, Numbering::Plain);
    let start = read("start").map(|position| position.fen(Numbering::Plain));
    let full = "W:W21,22,23,24,25,26,27,28,29,30,31,32:B1,2,3,4,5,6,7,8,9,10,11,12";
    assert_eq!(start.as_deref(), Ok(full));
    for text in [
        "W:W21-32:B1-12",
        "W:B1-12:W21-32",
        "W:W21-32:B1-12.",
        " W : W 21 - 32 : B 1 - 6 , 7-12 . \n",
        "w:w21-32:b1-12",
        "W:Wa1,c1,e1,g1,b2,d2,f2,h2,a3,c3,e3,g3:B1-12",
    ] {
        assert_eq!(read(text), read(full), "{text}");
    }
    assert_eq!(
        read("B:WK5,18:BK9-10,K12")
            .map(|position| position.fen(Numbering::Plain))
            .as_deref(),
        Ok("B:WK5,18:BK9,K10,K12")
    );
    assert!(read("W:W:B").is_ok() && read("B:W18:B").is_ok());
}

#[test]
fn a_wrong_position_is_refused_at_its_place() {
    let cases = [
        ("", "1:1 the side that moves is missing: W or B"),
        ("X:W1:B2", "1:1 the side that moves is W or B, not `X`"),
        (
            "?:W21:B2",
            "1:1 the side that moves must be known here: W or B, not `?`",
        ),
        ("W", "1:2 `:` and the first side's pieces are missing"),
        ("W:W21", "1:6 `:` and the other side's pieces are missing"),
        (
            "W:W21:W22",
            "1:7 White's pieces stand here for the second time",
        ),
        (
            "W:W21:\nB33",
            "2:2 there is no square 33: squares are 1 to 32",
        ),
        ("W:W0:B1", "1:4 there is no square 0: squares are 1 to 32"),
        ("W:W21,:B1", "1:7 `:` stands where a square should, 1 to 32"),
        (
            "W:W21 22:B1",
            "1:7 `2` stands where `:` and the other side's pieces should",
        ),
        ("W:W21:B21", "1:8 square 21 has a piece of White already"),
        ("W:W21,21:B1", "1:7 square 21 has a piece of White already"),
        ("W:W25-21:B1", "1:4 the range 25-21 runs backwards"),
        (
            "W:W1:B2",
            "1:4 a man of White cannot stand on 1, where it would be a king: write K1",
        ),
        ("W:Wb1:B2", "1:4 b1 is no square that is played on"),
        ("W:W21:B1..", "1:10 `.` stands behind the position"),
    ];
    for (text, expected) in cases {
        let error = Position::read(text, Variant::Brazilian, Numbering::Plain);
        assert_eq!(
            error.map_err(|error| error.to_string()),
            Err(expected.to_owned()),
            "{text}"
        );
    }
}
