//! How games end.

use rand::{SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::*;

fn game(variant: Variant, fen: &str, words: &[&str]) -> Game {
    let numbering = Numbering::Plain;
    let mut game = Game::from(variant, Position::read(fen, variant, numbering).unwrap());
    for word in words {
        let written = Written::read(word, numbering).unwrap();
        game.play(&written, numbering).unwrap();
    }
    game
}

const ROUND: [&str; 4] = ["32-28", "1-5", "28-32", "5-1"];

#[test]
fn a_position_that_occurs_three_times_is_a_draw() {
    let once = game(Variant::English, "W:WK32,21:BK1,12", &ROUND);
    assert_eq!(once.status(), Status::Playing);
    let mut twice = game(
        Variant::English,
        "W:WK32,21:BK1,12",
        &[ROUND, ROUND].concat(),
    );
    assert_eq!(twice.status(), Status::Drawn(Drawn::Repetition));
    assert!(
        twice
            .make(twice.position().moves(Variant::English)[0])
            .is_err()
    );
    assert!(twice.take_back());
    assert_eq!(twice.status(), Status::Playing);
}

#[test]
fn a_move_of_a_man_begins_the_count_anew() {
    let words = [
        &ROUND[..],
        &["21-17", "1-5", "32-28", "5-1", "28-32", "12-16"],
    ]
    .concat();
    assert_eq!(
        game(Variant::English, "W:WK32,21:BK1,12", &words).status(),
        Status::Playing
    );
}

/// Kings wander, and capture nothing and leave nothing to capture; the longest of several such games.
fn wander(variant: Variant, fen: &str) -> Game {
    let games = (0..200).map(|seed| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut game = game(variant, fen, &[]);
        while game.status() == Status::Playing {
            let moves = game.position().moves(variant);
            let quiet = moves.iter().copied().filter(|step| {
                let next = game.position().after(*step);
                step.captured == 0 && !next.captures(variant)
            });
            let Some(step) = quiet.collect::<Vec<_>>().choose(&mut random).copied() else {
                break;
            };
            game.make(step).unwrap();
        }
        game
    });
    games.max_by_key(|game| game.moves().len()).unwrap()
}

#[test]
fn kings_that_only_move_for_15_moves_are_a_draw_in_russian_draughts() {
    let game = wander(Variant::Russian, "W:WK32,K31:BK1,K4");
    assert_eq!(game.moves().len(), 30);
    assert_eq!(game.status(), Status::Drawn(Drawn::QuietKings));
}

#[test]
fn three_kings_have_15_moves_against_one() {
    let game = wander(Variant::Brazilian, "W:WK32,K31,K30:BK4");
    assert_eq!(game.moves().len(), 30);
    assert_eq!(game.status(), Status::Drawn(Drawn::ThreeAgainstOne));
    let pool = wander(Variant::Pool, "W:WK32,K31,K30:BK4");
    assert_eq!(pool.status(), Status::Drawn(Drawn::ThreeAgainstOne));
    assert_eq!(pool.moves().len(), 26);
}

#[test]
fn a_side_without_a_move_has_lost_and_a_side_may_resign() {
    let blocked = game(Variant::Brazilian, "W:W13:B9,6", &[]);
    assert_eq!(blocked.status(), Status::Won(Colour::Black, Won::NoMove));
    let mut given_up = Game::new(Variant::Brazilian);
    given_up.resign(Colour::White);
    assert_eq!(given_up.status(), Status::Won(Colour::Black, Won::Resigned));
    assert_eq!(given_up.record().result, "0-1");
    let mut agreed = Game::new(Variant::Brazilian);
    agreed.agree();
    assert_eq!(agreed.status(), Status::Drawn(Drawn::Agreement));
}
