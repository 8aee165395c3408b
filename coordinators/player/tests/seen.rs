//! Games before cameras over six daemons in virtual time, each from its seed.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

#[path = "seen/hands.rs"]
mod hands;

use std::{path::Path, sync::Arc};

use ctos::{
    boot::{End, Fault, FaultKind, Observer, simulate},
    config,
    registry::Registry,
    time::Instant,
};
use mcs::{control::LawRegistry, driver::DriverRegistry, guard::GuardRegistry};
use nalgebra::Point3;
use serde_json::Value;
use sim::cell::Cell;
use sorma::{Dictionary, daemon};
use vss::{catalog::VssExpander, source::FrameSources};

fn registry() -> Registry {
    let mut registry = Registry::new();
    let (mut drivers, mut sources) = (DriverRegistry::new(), FrameSources::new());
    sim::register(&mut registry, &mut drivers, &mut sources);
    vss::register(&mut registry, sources);
    let (mut laws, mut guards) = (LawRegistry::new(), GuardRegistry::new());
    mcs_collision::register(&mut registry, &mut guards);
    mcs_hand::register(&mut registry, &mut laws);
    mcs::register(&mut registry, drivers, laws, guards);
    coordinators::register(&mut registry);
    checkers_player::register(&mut registry);
    pnt::store::keep_states(&mut registry);
    pnt_net::register(&mut registry);
    daemon::register(&mut registry, Dictionary::default(), |_, sorm| {
        vss::services::register(sorm);
    });
    registry
}

/// How a game before cameras ends, with settings as `--set` takes them.
fn game(seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    play("checkers-seen.toml", seed, sets, faults)
}

fn play(app: &str, seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    play_watched(app, seed, sets, faults, registry())
}

fn play_watched(
    app: &str,
    seed: u64,
    sets: &[&str],
    faults: &[Fault],
    registry: Registry,
) -> Value {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let file = configs.join(app);
    let mut sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    sets.push(format!("app.seed={seed}"));
    sets.push("time.mode=\"virtual\"".to_owned());
    sets.push("task.player.args.nodes=150".to_owned());
    let app = config::load(&file, &sets, &[("vss", &VssExpander)]);
    let app = app.unwrap_or_else(|found| panic!("{found}"));
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
    record_of(folder, 8)
}

fn record_of(folder: &Path, plies: usize) -> String {
    let mut game = checkers::Game::new(checkers::Variant::Brazilian);
    for ply in 0..plies {
        let moves = game.position().moves(game.variant());
        game.make(moves[ply % moves.len()]).unwrap();
    }
    game.resign(checkers::Colour::White);
    let file = folder.join("game.pdn");
    std::fs::write(&file, game.record().write()).unwrap();
    format!("task.player.args.opponent={:?}", file.display().to_string())
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
    let kill = |daemon: &str, at_s: u64| {
        Fault::on(
            daemon,
            FaultKind::Kill,
            Instant::from_nanos(at_s * 1_000_000_000),
        )
    };
    let kills = [
        kill("vision", 20),
        kill("transform", 31),
        kill("vision", 45),
    ];
    let game = game(2, &[&opponent], &kills);
    assert_eq!(game["ok"], true, "{game:#}");
}
