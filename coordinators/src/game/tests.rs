//! The class `game` by its textual requests.

use std::fs;

use futures_util::FutureExt as _;
use sorma::{Dictionary, Reply};

use super::*;

fn manager() -> Sorm {
    let sorm = Sorm::new(Dictionary::new());
    register(&sorm);
    sorm
}

fn ask(sorm: &Sorm, line: &str) -> Transport {
    let told = sorm.tell(&sorma::Alone, line, "").now_or_never().unwrap();
    told.parse::<Reply>().unwrap().body
}

fn told(line: &str) -> Transport {
    let reply = ask(&manager(), line);
    assert!(reply.is_ok(), "{line}: {:?}", reply.reports);
    reply
}

fn refused(sorm: &Sorm, line: &str) -> (i32, String) {
    let reply = ask(sorm, line);
    assert!(!reply.is_ok(), "{line}");
    assert!(reply.floats.is_empty() && reply.ints.is_empty() && reply.text.is_empty());
    (reply.code, reply.reports.last().unwrap().text.clone())
}

#[test]
fn the_contracts_of_the_class_are_kept() {
    let reply = told("game EXEC TMSG 'moves W:W21-32:B1-12'");
    assert_eq!(reply.text, "21-17 22-17 22-18 23-18 23-19 24-19 24-20");
    assert_eq!(reply.ints, [7]);
    let reply = told("game EXEC TMSG 'moves W:W26:B22,14,15,23'");
    assert_eq!(
        (reply.text.as_str(), reply.ints.as_slice()),
        ("26x17x10x19x26", &[1][..])
    );
    assert_eq!(told("game EXEC TMSG 'perft 5 start'").ints, [7473]);
    assert_eq!(
        told("game EXEC TMSG 'perft 1 W:W26:B22,14,15,23'").ints,
        [1]
    );
    assert_eq!(
        told("game EXEC TMSG 'perft_paths 1 W:W26:B22,14,15,23'").ints,
        [2]
    );
    assert_eq!(told("game EXEC TMSG 'perft 0 W:W:B'").ints, [1]);
    let reply = told("game EXEC TMSG 'play W:W21-32:B1-12 22-18'");
    assert_eq!(
        reply.text,
        "B:W18,21,23,24,25,26,27,28,29,30,31,32:B1,2,3,4,5,6,7,8,9,10,11,12"
    );
    assert_eq!(
        told("game EXEC TMSG 'moves W : W 18 , K22 : B .'").ints,
        [8]
    );
}

#[test]
fn the_variant_is_switched() {
    let sorm = manager();
    for (variant, count) in [
        ("brazilian", 7473),
        ("russian", 7482),
        ("pool", 7482),
        ("english", 7361),
        ("italian", 7361),
        ("spanish", 7361),
        ("czech", 7361),
    ] {
        ask(&sorm, &format!("game CTRL -variant {variant}"));
        assert_eq!(
            ask(&sorm, "game EXEC TMSG 'perft 5 start'").ints,
            [count],
            "{variant}"
        );
    }
    ask(&sorm, "game CTRL -variant italian");
    assert_eq!(ask(&sorm, "game EXEC TMSG 'moves W:W30:B27'").text, "30x23");
    ask(&sorm, "game CTRL -board plain");
    let plain = ask(&sorm, "game EXEC TMSG 'moves W:W30:B26'");
    assert_eq!(plain.text, "30x23");
    assert!(
        ask(&sorm, "game CTRL -dump")
            .text
            .contains("-variant italian")
    );
    assert!(!ask(&sorm, "game CTRL -variant chinese").is_ok());
}

#[test]
fn a_search_by_positions_repeats_exactly_and_a_search_by_time_ends() {
    let sorm = manager();
    ask(&sorm, "game CTRL -nodes 20000");
    let first = ask(&sorm, "game EXEC TMSG 'best 1 start'");
    let again = ask(&sorm, "game EXEC TMSG 'best 0 start'");
    assert_eq!(
        (&first.text, &first.floats, &first.ints),
        (&again.text, &again.floats, &again.ints)
    );
    assert!(
        first.ints[0] >= 5 && first.ints[1] == 20_000,
        "{:?}",
        first.ints
    );
    let behind = ask(&sorm, "game EXEC TMSG 'best 1 start -nodes 1000'");
    assert_eq!(behind.ints[1], 1000);
    ask(&sorm, "game CTRL -nodes 0");
    let timed = ask(&sorm, "game EXEC TMSG 'best 0.02 start'");
    assert!(timed.is_ok() && !timed.text.is_empty());
    // The line can be played.
    let mut fen = "start".to_owned();
    for word in timed.text.split(' ') {
        fen = ask(&sorm, &format!("game EXEC TMSG 'play {fen} {word}'")).text;
        assert!(!fen.is_empty(), "{word}");
    }
    // A win that is seen: the only piece is captured.
    let won = ask(&sorm, "game EXEC TMSG 'best 1 W:W22:B18'");
    assert_eq!((won.text.as_str(), won.floats[0]), ("22x15", 299.99));
    let lost = ask(&sorm, "game EXEC TMSG 'best 1 W:W:B18'");
    assert_eq!(
        (lost.text.as_str(), lost.floats[0], lost.ints.as_slice()),
        ("", -300.0, &[0, 0][..])
    );
}

#[test]
fn what_is_wrong_is_told_with_its_place_or_its_rule() {
    let sorm = manager();
    let cases = [
        (
            "moves W:W33:B1",
            code::TEXT,
            "1:4 there is no square 33: squares are 1 to 32",
        ),
        (
            "moves hello",
            code::TEXT,
            "1:1 the side that moves is W or B, not `h`",
        ),
        (
            "perft many start",
            code::TEXT,
            "1:1 depth: a whole number from 0 to 40 stands before the position",
        ),
        (
            "best -1 start",
            code::TEXT,
            "1:1 seconds: a number from 0 to 600 stands before the position",
        ),
        (
            "best nan start",
            code::TEXT,
            "1:1 seconds: a number from 0 to 600 stands before the position",
        ),
        (
            "best 1 start -nodes few",
            code::TEXT,
            "1:7 -nodes takes a whole number of positions from 1",
        ),
        (
            "play start 22+18",
            code::TEXT,
            "1:3 move `22+18`: `+` stands where `-`, `x` or `:` should",
        ),
        (
            "play start 22-13",
            code::ILLEGAL,
            "22-13: a man moves to the next square forwards, not from 22 to 13",
        ),
        (
            "pdn no/such.pdn",
            code::FILE,
            "cannot read `no/such.pdn`: No such file or directory (os error 2)",
        ),
        ("pdn .", code::FILE, "cannot read `.`: it is no file"),
    ];
    for (request, number, text) in cases {
        let found = refused(&sorm, &format!("game EXEC TMSG '{request}'"));
        assert_eq!(found, (number, text.to_owned()), "{request}");
    }
    assert_eq!(
        refused(&sorm, "game EXEC TMSG 'moves'").0,
        sorma::report::code::UNSUPPORTED
    );
}

#[test]
fn a_file_of_games_is_answered_line_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two games.pdn");
    fs::write(
        &path,
        b"[White \"M\xFCller\"]\n1. 22-18 9-14 *\n1. 22-18 9-14\n2. 21-17 *\n",
    )
    .unwrap();
    let reply = told(&format!("game EXEC TMSG 'pdn {}'", path.display()));
    let expected = "2 W:W18,21,23,24,25,26,27,28,29,30,31,32:B1,2,3,4,5,6,7,8,10,11,12,14\n\
                    4:4 21-17: captures are compulsory: 18x9";
    assert_eq!(reply.text, expected);
}

#[test]
fn tables_are_made_read_and_refused() {
    let sorm = manager();
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().display();
    assert_eq!(
        refused(&sorm, &format!("game CTRL -tables {at}")).0,
        code::FILE
    );
    let made = ask(&sorm, &format!("game EXEC TMSG 'tables {at}'"));
    assert!(made.is_ok() && made.text.ends_with("brazilian.tables") && made.ints[0] > 1_000_000);
    assert!(ask(&sorm, &format!("game CTRL -tables {at}")).is_ok());
    // Three kings against one that does not hold the main road.
    let best = ask(&sorm, "game EXEC TMSG 'best 0 W:WK1,K2,K3:BK13'");
    assert!(best.floats[0] > 290.0, "{:?}", best.floats);
    // Another variant has other tables, and is not chosen without them.
    assert_eq!(refused(&sorm, "game CTRL -variant russian").0, code::FILE);
    let file = folder.path().join("brazilian.tables");
    let mut bytes = fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&file, bytes).unwrap();
    let (_, reason) = refused(&sorm, &format!("game CTRL -tables {at}"));
    assert!(reason.contains("checksum"), "{reason}");
}
