//! Games as files have them, and files that are wrong.

use super::*;

fn one(text: &str, variant: Variant) -> Record {
    let mut games = read(text, variant);
    assert_eq!(games.len(), 1);
    games.remove(0).unwrap()
}

fn wrong(text: &str, variant: Variant) -> String {
    let games = read(text, variant);
    let error = games.into_iter().find_map(Result::err);
    error.unwrap().to_string()
}

const CHECKERS: &str = "\
% a line for programs
[Event \"A \\\"short\\\" game\"]
[GameType \"21\"]
[Result \"1-0\"]

1. 11-15 {the Old Fourteenth} 23-19 $2 2. 8-11 (8-12 (4-8) 19-10) 22-17 3.4-8 17-13! 4... 15-18 ; the main line
24-20 5. 11-15 1-0
";

#[test]
fn a_game_is_read_with_everything_that_is_for_people() {
    let game = one(CHECKERS, Variant::Brazilian);
    assert_eq!(game.variant, Variant::English);
    assert_eq!(game.moves.len(), 9);
    assert_eq!(game.result, "1-0");
    assert_eq!(
        game.tags[0],
        ("Event".to_owned(), "A \"short\" game".to_owned())
    );
    let end = "W:W13,19,20,21,25,26,27,28,29,30,31,32:B1,2,3,5,6,7,8,9,10,12,15,18";
    assert_eq!(game.end().fen(Numbering::Plain), end);
}

#[test]
fn a_game_is_written_as_it_is_read() {
    let game = one(CHECKERS, Variant::Brazilian);
    let again = one(&game.write(), Variant::Brazilian);
    assert_eq!(again.moves, game.moves);
    assert_eq!(again.end(), game.end());
    assert_eq!(again.result, game.result);
}

#[test]
fn letters_and_colons_are_read_in_russian_games() {
    let text = "[GameType \"25,W,8,8,A0,0\"]\n1. c3-d4 d6-c5 2. b2-c3 f6-g5 3. c3-b4 g5-h4 4. b4:d6 e7:c5 *";
    let game = one(text, Variant::Brazilian);
    assert_eq!((game.variant, game.moves.len()), (Variant::Russian, 8));
}

#[test]
fn a_file_has_several_games_and_a_wrong_one_hides_no_other() {
    let text = "[GameType \"26\"]\n1. 21-17 *\n[GameType \"26\"]\n1. 21-16 *\n\n[GameType \"29\"]\n1. 22-18 9-13\n[GameType \"21\"]\n";
    let games = read(text, Variant::Brazilian);
    let counts: Vec<Option<usize>> = games
        .iter()
        .map(|game| game.as_ref().ok().map(|game| game.moves.len()))
        .collect();
    assert_eq!(counts, [Some(1), None, Some(2), Some(0)]);
    assert_eq!(games[1].as_ref().unwrap_err().line, 4);
    assert_eq!(games[1].as_ref().unwrap_err().column, 4);
}

#[test]
fn spanish_files_number_the_squares_from_the_other_corner() {
    let plain = one("1. 22-18 10-14 *", Variant::Spanish);
    let turned = one(
        "[GameType \"24,W,8,8,N1,1\"]\n1. 11-15 23-19 *",
        Variant::Brazilian,
    );
    assert_eq!(plain.moves, turned.moves);
    assert_eq!(turned.variant, Variant::Spanish);
}

#[test]
fn an_ambiguous_capture_is_refused_with_what_it_may_be() {
    // From c1 to c5 by a3 or by e3.
    let text = "[FEN \"W:W30:B25,17,26,18\"]\n1. 30x14 *";
    let expected = "2:4 30x14: this can be any of 30x21x14, 30x23x14: write more of its squares";
    assert_eq!(wrong(text, Variant::English), expected);
    let text = "[FEN \"W:W30:B25,17,26,18\"]\n1. 30x23x14 *";
    let game = one(text, Variant::English);
    assert_eq!(game.end().fen(Numbering::Plain), "B:W14:B17,25");
    // It is written so that it can be read.
    assert!(game.write().contains("1... 30x23x14 *"));
}

#[test]
fn what_is_wrong_with_a_file_is_said_with_its_place() {
    let cases = [
        (
            "1. 22-18 {no end",
            "1:10 a comment has no end: `}` is missing",
        ),
        (
            "1. 22-18 (9-13",
            "1:10 a variation has no end: `)` is missing",
        ),
        (
            "1. 22-18 ) 9-13",
            "1:10 `)` ends a variation that has not begun",
        ),
        (
            "[Event \"x]\n1. 22-18",
            "1:1 the value of a tag has no end: `\"` is missing",
        ),
        (
            "[Event x]\n1. 22-18",
            "1:1 the value of a tag stands in quotes: [Name \"value\"]",
        ),
        (
            "[GameType \"20\"]",
            "1:1 GameType 20 is not played here: 21 English, 22 Italian, 23 pool, 24 Spanish, 25 Russian, 26 Brazilian, 28 Portuguese, 29 Czech",
        ),
        (
            "[GameType \"26,W,10,10,N2,0\"]",
            "1:1 GameType has the form 25,W,8,8,A0,0, with a board of 8,8",
        ),
        (
            "[FEN \"W:W33:B1\"]",
            "1:1 FEN, at its character 4: there is no square 33: squares are 1 to 32",
        ),
        (
            "1. 22-18\n 2. 9-99",
            "2:7 there is no square 99: squares are 1 to 32",
        ),
        (
            "1. 22-18 9-14\n2. 21-17",
            "2:4 21-17: captures are compulsory: 18x9",
        ),
        (
            "1. 22-15",
            "1:4 22-15: a man moves to the next square forwards, not from 22 to 15",
        ),
        (
            "1. 11-15",
            "1:4 11-15: it is White's turn, and 11 is not White's",
        ),
        ("1. 18-15", "1:4 18-15: nothing stands on 18"),
        ("hello", "1:1 `h` stands where a square should, 1 to 32"),
    ];
    for (text, expected) in cases {
        let found = wrong(text, Variant::Brazilian);
        assert!(
            found.starts_with(expected),
            "{text}: {found}, not {expected}"
        );
    }
}
