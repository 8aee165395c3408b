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

/// Both sides wander where `may` lets them, and capture nothing and leave nothing to capture; men move when kings alone have moved
/// for long. The longest of several such games.
fn wander(variant: Variant, fen: &str, may: impl Fn(&Position) -> bool) -> Game {
    let games = (0..200).map(|seed| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut game = game(variant, fen, &[]);
        while game.status() == Status::Playing {
            let quiet = game.before().len();
            let seen = |position: &Position| game.before().contains(&position.key());
            let moves = game.position().moves(variant);
            let moves = moves.iter().copied().filter(|step| {
                let next = game.position().after(*step);
                let patient = quiet >= 24 || !game.position().lasting(*step);
                step.captured == 0
                    && !next.captures(variant)
                    && may(&next)
                    && !seen(&next)
                    && patient
            });
            let Some(step) = moves.collect::<Vec<_>>().choose(&mut random).copied() else {
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
    let game = wander(Variant::Russian, "W:WK32,K31:BK1,K4", |_| true);
    assert_eq!(game.moves().len(), 30);
    assert_eq!(game.status(), Status::Drawn(Drawn::QuietKings));
}

#[test]
fn kings_that_only_move_for_40_moves_are_a_draw_in_the_other_variants() {
    let others = Variant::ALL
        .into_iter()
        .filter(|variant| !matches!(variant, Variant::Brazilian | Variant::Russian));
    for variant in others {
        let game = wander(variant, "W:WK32,K31,K30:BK1,K2,K3", |_| true);
        assert_eq!(game.moves().len(), 80, "{variant:?}: {:?}", game.status());
        assert_eq!(
            game.status(),
            Status::Drawn(Drawn::QuietKings),
            "{variant:?}"
        );
    }
}

#[test]
fn three_kings_have_15_moves_against_one() {
    let game = wander(Variant::Brazilian, "W:WK32,K31,K30:BK1", |_| true);
    assert_eq!(game.moves().len(), 30);
    assert_eq!(
        game.status(),
        Status::Drawn(Drawn::Ending(Ending::ThreeKings))
    );
    let pool = wander(Variant::Pool, "W:WK32,K31,K30:BK4", |_| true);
    assert_eq!(
        pool.status(),
        Status::Drawn(Drawn::Ending(Ending::ThreeKings))
    );
    assert_eq!(pool.moves().len(), 26);
}

#[test]
fn two_pieces_have_5_moves_against_a_king_but_not_in_pool() {
    for fen in [
        "W:WK32,K31:BK1",
        "W:WK32,9:BK4",
        "W:WK32:BK1",
        "B:WK1:BK32,21",
    ] {
        let game = wander(Variant::Russian, fen, |_| true);
        assert_eq!(game.moves().len(), 10, "{fen}");
        let ending = Drawn::Ending(Ending::TwoAgainstOne);
        assert_eq!(game.status(), Status::Drawn(ending), "{fen}");
    }
    assert!(
        wander(Variant::Pool, "W:WK32,K31:BK1", |_| true)
            .moves()
            .len()
            > 20
    );
}

#[test]
fn three_pieces_have_5_moves_against_a_king_that_stays_on_the_main_road() {
    let on_road = |position: &Position| {
        let king = position.black.trailing_zeros() + 1;
        [4, 8, 11, 15, 18, 22, 25, 29].contains(&king)
    };
    for fen in ["W:WK32,K31,K5:BK4", "W:WK32,K31,21:BK4", "W:WK32,28,21:BK4"] {
        let stays = wander(Variant::Brazilian, fen, on_road);
        assert_eq!(stays.moves().len(), 10, "{fen}");
        let ending = Drawn::Ending(Ending::MainRoad);
        assert_eq!(stays.status(), Status::Drawn(ending), "{fen}");
        // It is counted anew when the king comes back.
        let leaves = wander(Variant::Brazilian, fen, |_| true);
        assert!(leaves.moves().len() > 10, "{fen}");
    }
}

#[test]
fn five_pieces_have_30_moves_without_a_capture_or_a_crown_and_seven_60() {
    for (fen, moves) in [
        ("W:WK30,21,24:BK3,12", 60),
        ("W:WK30,29,32,31:BK3,1,4", 120),
    ] {
        let kings = |position: &Position| position.kings.count_ones() == 2;
        let game = wander(Variant::Russian, fen, kings);
        assert_eq!(game.moves().len(), moves, "{fen}: {:?}", game.status());
        assert!(matches!(
            game.status(),
            Status::Drawn(Drawn::Ending(Ending::Balance { .. }))
        ));
    }
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
