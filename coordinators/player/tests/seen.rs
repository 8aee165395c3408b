//! Games before cameras over six daemons in virtual time, each from its seed.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

mod play;

use std::path::Path;

use nalgebra::Point3;
use play::{kill, play, record, record_of};
use serde_json::Value;
use sim::cell::Cell;

/// How a game before cameras ends, with settings as `--set` takes them.
fn game(seed: u64, sets: &[&str]) -> Value {
    play("checkers-seen.toml", seed, sets, &[])
}

#[test]
fn the_known_points_of_the_maps_are_those_of_the_cell() {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let cell = Cell::read(&configs.join("checkers-seen-cell.toml")).unwrap();
    for name in ["left", "right", "far"] {
        let camera = cell.camera(name).unwrap().truth.camera();
        let table = std::fs::read_to_string(configs.join(format!("checkers/{name}.csv"))).unwrap();
        let mut rows = 0;
        for row in table.lines().skip(1) {
            let numbers: Vec<f64> = row.split(',').map(|x| x.parse().unwrap()).collect();
            let pixel = camera
                .project(&Point3::new(numbers[0], numbers[1], 0.42))
                .unwrap();
            let off = (pixel.x - numbers[2]).hypot(pixel.y - numbers[3]);
            assert!(off < 0.5, "{name}: {row} is {off} px off");
            rows += 1;
        }
        assert_eq!(rows, 25);
    }
}

#[test]
fn a_game_before_cameras_is_read_right_and_ends_truly() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 8);
    let game = game(1, &[&opponent, "task.room.args.glare=0.0"]);
    assert_eq!(game["ok"], true, "{game:#}");
    assert_eq!(game["result"], "Black has won: White gave up");
    assert_eq!(game["looks"]["wrong"], 0, "{game:#}");
}

/// Seeds of the campaign; none unless `CTOS_CHECKERS_SEEN_SEEDS` says how many: a game takes half a minute of a core.
fn seeds() -> u64 {
    let given = std::env::var("CTOS_CHECKERS_SEEN_SEEDS").ok();
    given.map_or(0, |text| text.parse().unwrap())
}

#[test]
fn whole_games_before_cameras_with_errors_lost_discs_and_moved_boards_end_truly() {
    let mut failed = Vec::new();
    for seed in 0..seeds() {
        let sets = [
            [
                "task.player.args.opponent=\"self\"",
                "task.player.args.opponent=\"program\"",
            ][seed as usize % 2],
            "task.room.args.slips=0.03",
        ];
        let ran = std::panic::catch_unwind(|| {
            let game = game(seed, &sets);
            tracing::info!(%game, seed);
            if let Ok(file) = std::env::var("CTOS_CHECKERS_SEEN_LOG") {
                std::fs::write(format!("{file}.{seed}"), format!("{game:#}")).unwrap();
            }
            assert_eq!(game["ok"], true, "seed {seed}, {sets:?}: {game:#}");
        });
        if ran.is_err() {
            failed.push(seed);
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn a_killed_vision_or_transform_learns_again_and_the_game_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 8);
    let kills = [
        kill("vision", 20.0),
        kill("transform", 31.0),
        kill("vision", 45.0),
    ];
    let game = play("checkers-seen.toml", 2, &[&opponent], &kills);
    assert_eq!(game["ok"], true, "{game:#}");
}

#[test]
fn whole_games_are_carried_by_an_arm_and_a_gripper() {
    for seed in 0..hands() {
        let game = play("checkers-hands.toml", seed, &[], &[]);
        if let Ok(file) = std::env::var("CTOS_CHECKERS_SEEN_LOG") {
            std::fs::write(format!("{file}.hands.{seed}"), format!("{game:#}")).unwrap();
        }
        assert_eq!(game["ok"], true, "{game:#}");
    }
}

/// Seeds of the campaign with hands; none unless `CTOS_CHECKERS_HANDS_SEEDS` says how many: a game takes some minutes of a core.
fn hands() -> u64 {
    let given = std::env::var("CTOS_CHECKERS_HANDS_SEEDS").ok();
    given.map_or(0, |text| text.parse().unwrap())
}

/// A file with a game from a position, in which a man is crowned as soon as it can and a king goes as far as it can.
fn record_from(folder: &Path, fen: &str, plies: usize) -> String {
    use checkers::{Game, Move, Numbering, Position, Variant};
    let start = Position::read(fen, Variant::Brazilian, Numbering::Plain).unwrap();
    let far = |step: &&Move| (step.crowned, step.from.abs_diff(step.to));
    let game = Game::from(Variant::Brazilian, start);
    record(folder, game, plies, |_, moves| {
        *moves.iter().max_by_key(far).unwrap()
    })
}

#[test]
fn a_disc_that_stands_crooked_is_pushed_to_its_middle_by_closed_jaws_and_then_carried() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_from(folder.path(), "W:W22,32:B1,12", 1);
    let aside = "task.room.args.aside=[{ square = 22, by = [0.012, -0.008] }]";
    let game = play("checkers-hands.toml", 1, &[&opponent, aside], &[]);
    assert_eq!(game["ok"], true, "{game:#}");
    let said = game["said"].to_string();
    assert!(
        said.contains("I push the disc on 22 to the middle"),
        "{said}"
    );
    assert!(!said.contains("crooked"), "{said}");
}

#[test]
fn moves_are_carried_by_an_arm_and_a_gripper_in_a_world_with_physics() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 4);
    let game = play("checkers-hands.toml", 1, &[&opponent], &[]);
    assert_eq!(game["ok"], true, "{game:#}");
    assert_eq!(game["plies"], 4);
}
