//! Dry games over six daemons in virtual time, each from its seed.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "helpers of tests, outside test functions"
)]

use std::{collections::BTreeMap, path::Path, sync::Arc, time::Duration};

use ctos::{
    boot::{End, Fault, FaultKind, Observer, simulate},
    config,
    message::Message,
    registry::Registry,
    task::{Context, EventHandler, Handled, Phase},
    time::Instant,
};
use pnt::task::PutTape;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use sorma::{Dictionary, daemon};

/// The six daemons.
const DAEMONS: [&str; 6] = ["player", "speaker", "transform", "vision", "robot", "hand"];

/// Puts a word on the tape of `people` when some time has passed, as a person does.
struct Wisher;

impl EventHandler for Wisher {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        let words: Vec<String> = cx.args::<BTreeMap<String, Vec<String>>>()?["words"].clone();
        if phase == Phase::Run {
            let cx = cx.clone();
            cx.clone().spawn(async move {
                for symbol in words {
                    cx.sleep(Duration::from_secs(60)).await;
                    let arguments = Vec::new();
                    let people = cx.task("people").await.unwrap();
                    let answer = cx.call(&people, PutTape { symbol, arguments }).await;
                    assert_eq!(answer.unwrap().symbol, "noted");
                }
            });
        }
        Ok(())
    }
}

/// How a game ends, with settings as `--set` takes them.
fn game(seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/checkers.toml");
    let mut sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    sets.push(format!("app.seed={seed}"));
    sets.push("time.mode=\"virtual\"".to_owned());
    sets.push("task.player.args.nodes=150".to_owned());
    let app = config::load(&file, &sets, &[]).unwrap_or_else(|found| panic!("{found}"));
    let mut registry = Registry::new();
    coordinators::register(&mut registry);
    checkers_player::register(&mut registry);
    pnt::store::keep_states(&mut registry);
    pnt_net::register(&mut registry);
    daemon::register(&mut registry, Dictionary::default(), |_, _| {});
    registry.handler("test.wisher", &[], |_| Ok(Wisher));
    let observer: Observer = Arc::new(|_| {});
    match simulate(app, registry, faults, &observer).unwrap().end {
        End::Finished(result) => serde_json::from_str(&result.json).unwrap_or_else(|_| {
            panic!("seed {seed}: {}", result.text);
        }),
        other => panic!("seed {seed}: {other:?}"),
    }
}

/// A file with a game of some half-moves, after which White gives up.
fn record(folder: &Path) -> String {
    let mut game = checkers::Game::new(checkers::Variant::Brazilian);
    for ply in 0..10 {
        let moves = game.position().moves(game.variant());
        game.make(moves[ply % moves.len()]).unwrap();
    }
    game.resign(checkers::Colour::White);
    let file = folder.join("game.pdn");
    std::fs::write(&file, game.record().write()).unwrap();
    file.display().to_string()
}

#[test]
fn a_game_of_a_file_is_played_to_its_end_and_the_same_again_from_the_same_seed() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = format!("task.player.args.opponent={:?}", record(folder.path()));
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
    let game = game(5, &sets, &[]);
    assert_eq!(game["ok"], true, "{game:#}");
    let said = game["said"].to_string();
    for words in [
        "please take your hand away",
        "is out of my reach: please push the board to the middle of the table",
        "the robot needs power: please switch it on",
        "I have lost",
    ] {
        assert!(said.contains(words), "`{words}` was not said:\n{said}");
    }
    assert!(game["plies"].as_u64().unwrap() > 10);
}

/// Seeds of the campaign; few unless `CTOS_CHECKERS_SEEDS` says how many.
fn seeds() -> u64 {
    let given = std::env::var("CTOS_CHECKERS_SEEDS").ok();
    given.map_or(2, |text| text.parse().unwrap())
}

#[test]
fn games_with_errors_lost_discs_moved_boards_and_killed_daemons_end_truly() {
    let mut failed = Vec::new();
    for seed in 0..seeds() {
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
        ];
        let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
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
