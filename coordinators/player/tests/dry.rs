//! Dry games over six daemons in virtual time, each from its seed.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "helpers of tests, outside test functions"
)]

mod play;

use std::{collections::BTreeMap, time::Duration};

use ctos::{
    boot::{Fault, FaultKind},
    task::Context,
    time::Instant,
};
use play::{DAEMONS, kill, play_with, record_of};
use pnt::task::PutTape;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

/// Puts a word on the tape of `people` when some time has passed, as a person does.
async fn wish(cx: Context) {
    let words: Vec<String> = cx.args::<BTreeMap<String, Vec<String>>>().unwrap()["words"].clone();
    for line in words {
        cx.sleep(Duration::from_secs(60)).await;
        let mut line = line.split(' ').map(str::to_owned);
        let symbol = line.next().unwrap();
        let arguments = line.collect();
        let people = cx.task("people").await.unwrap();
        let answer = cx.call(&people, PutTape { symbol, arguments }).await;
        assert_eq!(answer.unwrap().symbol, "noted");
    }
}

/// How a game ends, with settings as `--set` takes them.
fn game(seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    play_with("checkers.toml", seed, sets, faults, |registry| {
        play::beside(registry, "test.wisher", wish);
    })
}

#[test]
fn a_game_of_a_file_is_played_to_its_end_and_the_same_again_from_the_same_seed() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 10);
    let written = folder.path().join("played.pdn");
    let pdn = format!("task.player.args.pdn={:?}", written.display().to_string());
    let sets = [opponent.as_str(), pdn.as_str()];
    let one = game(1, &sets, &[]);
    assert_eq!(one["ok"], true, "{one:#}");
    assert_eq!(one["result"], "Black has won: White gave up");
    assert_eq!(one["plies"], 10);
    let original = std::fs::read_to_string(folder.path().join("game.pdn")).unwrap();
    assert_eq!(std::fs::read_to_string(&written).unwrap(), original);
    assert_eq!(one, game(1, &sets, &[]));
    assert_ne!(one["seconds"], game(2, &sets, &[])["seconds"]);
}

#[test]
fn a_person_who_makes_every_error_is_told_the_rule_and_the_game_goes_on_to_a_true_end() {
    let sets = [
        "task.player.args.opponent=\"program\"",
        "task.room.args.errors=0.7",
        "task.room.args.slips=0.05",
    ];
    let mut errors = std::collections::BTreeSet::new();
    let mut said = String::new();
    let (mut slipped, mut moved) = (0, 0);
    for seed in 11..14 {
        if errors.len() == 7 && slipped > 0 && moved > 0 {
            break;
        }
        let game = game(seed, &sets, &[]);
        assert_eq!(game["ok"], true, "seed {seed}: {game:#}");
        let kinds = game["errors"].as_array().unwrap().iter();
        errors.extend(kinds.map(|kind| kind.as_str().unwrap().to_owned()));
        let words = game["said"].as_array().unwrap().iter();
        said.extend(words.map(|words| format!("{words}\n")));
        slipped += game["slipped"].as_u64().unwrap();
        moved += game["moved"].as_u64().unwrap();
    }
    assert!(slipped > 0 && moved > 0, "{slipped} {moved}");
    assert_eq!(errors.len(), 7, "{errors:?}");
    for words in [
        "not accepted: more than one piece was moved",
        "not accepted: from ",
        "a disc stands crooked: put it in the middle of",
        "please take your hand away",
        "I have lost",
        "the board was moved",
        "your turn",
        "game over",
    ] {
        assert!(said.contains(words), "`{words}` was not said:\n{said}");
    }
}

#[test]
fn a_draw_is_agreed_a_side_gives_up_and_a_new_game_begins_when_people_want_it() {
    let ends = |words: &str, opponent: &str| {
        let words = format!("task.player_daemon.args.words=[{words}]");
        let opponent = format!("task.player.args.opponent=\"{opponent}\"");
        let sets = [
            // In the place of a daemon that nobody asks.
            "task.player_daemon.handler=\"test.wisher\"",
            &words,
            &opponent,
        ];
        let game = game(3, &sets, &[]);
        assert_eq!(game["ok"], true, "{game:#}");
        game
    };
    let given_up = ends("\"new_game\", \"resign\"", "program");
    assert_eq!(given_up["result"], "White has won: Black gave up");
    let said = given_up["said"].to_string();
    assert!(said.contains("please set up the board"), "{said}");
    assert_eq!(said.matches("you play Black").count(), 2, "{said}");
    assert_eq!(ends("\"draw\"", "self")["result"], "drawn: both agreed");
}

/// A game during which people say words to `people`, a minute after one another.
fn wished(seed: u64, words: &[&str], more: &[&str]) -> Value {
    let words = format!("task.player_daemon.args.words={words:?}");
    // In the place of a daemon that nobody asks.
    let sets = ["task.player_daemon.handler=\"test.wisher\"", &*words];
    let game = game(seed, &[&sets[..], more].concat(), &[]);
    assert_eq!(game["ok"], true, "{game:#}");
    game
}

#[test]
fn people_set_how_much_is_said_and_a_robot_that_says_its_moves_says_each_of_them() {
    let quiet = "task.room.args.slips=0.0";
    let said = |words: &[&str]| wished(3, words, &[quiet])["said"].to_string();
    let all = said(&["verbosity 3", "resign"]);
    assert!(all.contains("I move "), "{all}");
    let usual = said(&["verbosity 2", "resign"]);
    assert!(!usual.contains("I move "), "{usual}");
    let bumped = "task.room.args.bumps=0.2";
    let few = wished(
        3,
        &["verbosity 1", "seconds 0.1", "depth 2", "resign"],
        &[quiet, bumped],
    );
    assert!(few["moved"].as_u64().unwrap() > 5, "{few:#}");
    let told = few["said"].to_string();
    let moved = told.matches("the board was moved").count() as u64;
    assert!(moved < few["moved"].as_u64().unwrap() / 2, "{told}");
    assert!(told.contains("game over"), "{told}");
}

#[test]
fn in_a_dry_run_the_arm_stays_where_it_is_and_people_make_the_moves_of_the_robot() {
    let dry = game(
        3,
        &["task.player.args.dry=true", "task.room.args.slips=1.0"],
        &[],
    );
    assert_eq!(dry["ok"], true, "{dry:#}");
    assert_eq!(dry["slipped"], 0);
    let asked = dry["said"]
        .to_string()
        .matches("please make my move: ")
        .count();
    assert!(asked as u64 >= dry["plies"].as_u64().unwrap(), "{dry:#}");
}

#[test]
fn in_a_dry_run_people_stack_the_crown_of_a_person() {
    let sets = [
        "task.player.args.dry=true",
        "task.player.args.opponent=\"program\"",
        "task.player.args.start=\"W:W24,23:B25\"",
        "task.player.args.opening=0",
    ];
    let dry = game(3, &sets, &[]);
    assert_eq!(dry["ok"], true, "{dry:#}");
    let said = dry["said"].to_string();
    assert!(said.contains("please stack the crown"), "{said}");
}

#[test]
fn where_the_robot_plays_both_sides_somebody_puts_right_what_stands_crooked() {
    let sets = [
        "task.player.args.opponent=\"self\"",
        "task.room.args.aside=[{ square = 22, by = [0.015, -0.008] }]",
    ];
    let said = wished(3, &["resign"], &sets)["said"].to_string();
    assert!(said.contains("put it in the middle of 22"), "{said}");
    assert!(said.contains("game over"), "{said}");
}

#[test]
fn a_dry_run_that_people_want_goes_on_after_kills_of_the_player() {
    let kills: Vec<Fault> = (0..8)
        .map(|nth| kill("player", 66.0 + 6.3 * f64::from(nth)))
        .collect();
    let sets = [
        "task.speaker_daemon.handler=\"test.wisher\"",
        "task.speaker_daemon.args.words=[\"dry 1\", \"resign\"]",
        "task.player.args.verbosity=3",
    ];
    let game = game(3, &sets, &kills);
    assert_eq!(game["ok"], true, "{game:#}");
    let said = game["said"].to_string();
    let (_, dry) = said.split_once("please make my move: ").unwrap();
    assert!(dry.contains("please make my move: "), "{said}");
    assert!(!dry.contains("I move "), "{said}");
}

#[test]
fn in_the_dark_the_robot_says_that_it_sees_too_little_and_goes_on_when_there_is_light() {
    let game = wished(3, &["light 0.1", "light 1", "resign"], &[]);
    let said = game["said"].to_string();
    assert!(said.contains("it is too dark"), "{said}");
}

#[test]
fn what_is_wrong_in_the_arguments_of_player_and_room_is_found_before_anything_runs_with_its_place()
{
    let registry = play::registry();
    for (set, says) in [
        ("task.player.args.start=\"W:W1,22:B18\"", "start"),
        ("task.player.args.start=\"W:W22:B22\"", "start"),
        ("task.player.args.pushes=100", "pushes"),
        ("task.player.args.depth=0", "depth"),
        ("task.player.args.verbosity=4", "verbosity"),
        (
            "task.room.args.aside=[{ square = 17, by = [0.0, 0.0] }]",
            "aside",
        ),
        (
            "task.room.args.aside=[{ square = 33, by = [0.0, 0.0] }]",
            "aside",
        ),
        (
            "task.room.args.aside=[{ square = 22, by = [0.0, 1.0] }]",
            "aside",
        ),
    ] {
        let app = play::app("checkers.toml", 1, &[set]).unwrap_or_else(|found| panic!("{found}"));
        let found = registry.check(&app).to_string();
        assert!(
            found.contains(says) && found.contains(":1:"),
            "{set}: {found}"
        );
    }
}

#[test]
fn on_a_mirrored_board_discs_are_carried_to_where_people_see_the_squares_of_its_rules() {
    for variant in [checkers::Variant::Italian, checkers::Variant::Spanish] {
        let folder = tempfile::tempdir().unwrap();
        let start = checkers::Game::new(variant);
        let opponent = play::record(folder.path(), start, 8, |ply, moves| {
            moves[ply % moves.len()]
        });
        let rules = format!(
            "task.player.args.variant={:?}",
            variant.name().to_lowercase()
        );
        let game = game(1, &[&opponent, &rules, "task.room.args.bumps=0.1"], &[]);
        assert_eq!(game["ok"], true, "{game:#}");
        assert!(game["moved"].as_u64().unwrap() > 0);
    }
}

#[test]
fn a_kill_of_each_daemon_in_each_part_of_a_move_continues_the_game() {
    for daemon in DAEMONS {
        // About a move of the robot takes 12 s: a look, thought, the way there, the grasp, the way back, the look after it.
        let kills: Vec<Fault> = (0..8)
            .map(|nth| kill(daemon, 13.0 + 12.7 * f64::from(nth)))
            .collect();
        let game = short_game(4, &kills);
        assert_eq!(game["ok"], true, "{daemon}: {game:#}");
        assert!(game["plies"].as_u64().unwrap() >= 6, "{daemon}: {game:#}");
    }
}

#[test]
fn people_are_told_what_keeps_the_arm_from_its_way_each_thing_in_its_own_words_and_the_game_goes_on()
 {
    let sets = [
        "task.player.args.opponent=\"program\"",
        "task.room.args.errors=0.3",
        "task.room.args.slips=0.1",
        "task.room.args.power=0.05",
        "task.room.args.bumps=0.05",
        "task.room.args.far=0.5",
    ];
    let games = [5, 11].map(|seed| game(seed, &sets, &[]));
    let mut said = String::new();
    for game in games {
        assert_eq!(game["ok"], true, "{game:#}");
        assert!(game["plies"].as_u64().unwrap() > 10);
        said += &game["said"].to_string();
    }
    for words in [
        "please take your hand away",
        "is out of my reach: please push the board to the middle of the table",
        "the robot needs power: please switch it on",
        "I have lost",
    ] {
        assert!(said.contains(words), "`{words}` was not said:\n{said}");
    }
}

/// A short game of a file, in which daemons die.
fn short_game(seed: u64, kills: &[Fault]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 10);
    game(seed, &[&opponent], kills)
}

/// Seeds of the campaign; few unless `CTOS_CHECKERS_SEEDS` says how many, or which: `36,56,100..120`.
fn seeds() -> Vec<u64> {
    let given = std::env::var("CTOS_CHECKERS_SEEDS").unwrap_or_else(|_| "2".to_owned());
    if let Ok(many) = given.parse() {
        return (0..many).collect();
    }
    let part = |part: &str| match part.split_once("..") {
        Some((from, to)) => from.parse().unwrap()..to.parse().unwrap(),
        None => {
            let seed = part.parse().unwrap();
            seed..seed + 1
        }
    };
    given
        .split(',')
        .filter(|text| !text.is_empty())
        .flat_map(part)
        .collect()
}

#[test]
fn games_with_errors_lost_discs_moved_boards_and_killed_daemons_end_truly() {
    let mut failed = Vec::new();
    for seed in seeds() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let variant = checkers::Variant::NAMES[rng.random_range(0..7)];
        let opponent = ["self", "program", "program"][rng.random_range(0..3)];
        let colour = ["white", "black"][rng.random_range(0..2)];
        let sets = [
            format!("task.player.args.variant=\"{variant}\""),
            format!("task.player.args.opponent=\"{opponent}\""),
            format!("task.player.args.colour=\"{colour}\""),
            format!("task.player.args.pushes={}", rng.random_range(0..3)),
            "task.room.args.errors=0.2".to_owned(),
            "task.room.args.slips=0.03".to_owned(),
            "task.room.args.power=0.01".to_owned(),
            "task.room.args.far=0.2".to_owned(),
            "task.room.args.lamps=0.002".to_owned(),
        ];
        let mut sets: Vec<&str> = sets.iter().map(String::as_str).collect();
        if std::env::var("CTOS_CHECKERS_SEEDS").is_err() {
            // A short game: the campaign has whole ones.
            sets.push("task.player.args.start=\"W:W18,21,22,26,29,30:B3,5,8,10,11,12\"");
        }
        let kills: Vec<Fault> = (0..rng.random_range(1..6))
            .map(|_| {
                let daemon = DAEMONS[rng.random_range(0..DAEMONS.len())];
                let at = rng.random_range(0..500_000_000_000);
                Fault::on(daemon, FaultKind::Kill, Instant::from_nanos(at))
            })
            .collect();
        let case = format!("seed {seed}, {sets:?}, {kills:?}");
        let ran = std::panic::catch_unwind(|| {
            let game = game(seed, &sets, &kills);
            assert_eq!(game["ok"], true, "{case}: {game:#}");
        });
        if ran.is_err() {
            failed.push(case);
        }
    }
    assert!(failed.is_empty(), "{}: {failed:#?}", failed.len());
}
