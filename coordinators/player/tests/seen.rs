//! Games before cameras over six daemons in virtual time, each from its seed.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

#[path = "seen/hands.rs"]
mod hands;

#[path = "seen/looked.rs"]
mod looked;

#[path = "play/mod.rs"]
mod play;

use std::path::Path;

use nalgebra::Point3;
use serde_json::Value;
use sim::cell::Cell;

use ctos::boot::Fault;
use play::{kill, record_of};

/// How a game before cameras ends, with settings as `--set` takes them.
fn game(seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    play::play("checkers-seen.toml", seed, sets, faults)
}

/// A file with a game of some half-moves, after which White gives up.
fn record(folder: &Path) -> String {
    record_of(folder, 8)
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
    let opponent = record(folder.path());
    let game = game(1, &[&opponent, "task.room.args.glare=0.0"], &[]);
    assert_eq!(game["ok"], true, "{game:#}");
    assert_eq!(game["result"], "Black has won: White gave up");
    assert_eq!(game["looks"]["wrong"], 0, "{game:#}");
}

#[test]
fn before_cameras_a_board_that_is_turned_as_its_rules_want_is_read_right_and_its_discs_are_carried()
{
    let folder = tempfile::tempdir().unwrap();
    let start = checkers::Game::new(checkers::Variant::Italian);
    let opponent = play::record(folder.path(), start, 2, |ply, moves| moves[ply]);
    let sets = [
        &*opponent,
        "task.player.args.variant=\"italian\"",
        "task.room.args.glare=0.0",
        "task.room.args.bumps=0.05",
    ];
    let game = game(2, &sets, &[]);
    assert_eq!(game["ok"], true, "{game:#}");
    assert_eq!(game["plies"], 2);
    assert_eq!(game["looks"]["wrong"], 0, "{game:#}");
    assert!(game["looks"]["right"].as_u64().unwrap() > 5, "{game:#}");
}

#[test]
fn in_dim_and_in_strong_light_a_board_is_read_right_or_unsurely_and_the_game_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), 3);
    let sets = [
        &*opponent,
        "task.room.args.glare=0.0",
        "task.room.args.lamps=0.3",
    ];
    let game = game(3, &sets, &[]);
    assert_eq!(game["ok"], true, "{game:#}");
    assert_eq!(game["looks"]["wrong"], 0, "{game:#}");
    for way in 0..2 {
        assert!(game["lit"][way].as_u64().unwrap() > 0, "{game:#}");
    }
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
            "task.room.args.lamps=0.01",
        ];
        let ran = std::panic::catch_unwind(|| {
            let game = game(seed, &sets, &[]);
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
    let opponent = record(folder.path());
    let kills = [
        kill("vision", 20.0),
        kill("transform", 31.0),
        kill("vision", 45.0),
    ];
    let game = game(2, &[&opponent], &kills);
    assert_eq!(game["ok"], true, "{game:#}");
}
