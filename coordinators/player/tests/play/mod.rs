//! Whole games of the apps of `configs/` in virtual time, each from its seed.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    dead_code,
    reason = "helpers of tests, of which each file uses some"
)]

use std::{path::Path, sync::Arc};

use checkers::{Game, Move};
use ctos::{
    boot::{End, Fault, FaultKind, Observer, simulate},
    config::{self, App},
    diagnostic::Findings,
    message::Message,
    registry::Registry,
    task::{Context, EventHandler, Handled, Phase},
    time::Instant,
};
use mcs::{control::LawRegistry, driver::DriverRegistry, guard::GuardRegistry};
use serde_json::Value;
use sorma::{Dictionary, daemon};
use vss::{catalog::VssExpander, source::FrameSources};

/// The six daemons.
pub const DAEMONS: [&str; 6] = ["player", "speaker", "transform", "vision", "robot", "hand"];

/// What the apps are made of.
pub fn registry() -> Registry {
    let mut registry = Registry::new();
    let (mut drivers, mut sources) = (DriverRegistry::new(), FrameSources::new());
    sim::register(&mut registry, &mut drivers, &mut sources);
    vss::register(&mut registry, sources);
    let (mut laws, mut guards) = (LawRegistry::new(), GuardRegistry::new());
    mcs_collision::register(&mut registry, &mut guards);
    mcs_hand::register(&mut registry, &mut laws);
    mcs_path::register(&mut registry);
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

/// An app of `configs/` with settings as `--set` takes them.
pub fn app(app: &str, seed: u64, sets: &[&str]) -> Result<App, Findings> {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let mut sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    sets.push(format!("app.seed={seed}"));
    sets.push("time.mode=\"virtual\"".to_owned());
    sets.push("task.player.args.nodes=150".to_owned());
    config::load(&configs.join(app), &sets, &[("vss", &VssExpander)])
}

/// How a run of an app ends, with handlers of a test besides.
pub fn simulated(
    file: &str,
    seed: u64,
    sets: &[&str],
    faults: &[Fault],
    register: impl FnOnce(&mut Registry),
) -> End {
    let app = app(file, seed, sets).unwrap_or_else(|found| panic!("{found}"));
    let mut registry = registry();
    register(&mut registry);
    let observer: Observer = Arc::new(|_| {});
    simulate(app, registry, faults, &observer).unwrap().end
}

/// How a game of an app ends, with handlers of a test besides.
pub fn play_with(
    file: &str,
    seed: u64,
    sets: &[&str],
    faults: &[Fault],
    register: impl FnOnce(&mut Registry),
) -> Value {
    match simulated(file, seed, sets, faults, register) {
        End::Finished(result) => serde_json::from_str(&result.json).unwrap_or_else(|_| {
            panic!("seed {seed}: {}", result.text);
        }),
        other => panic!("seed {seed}: {other:?}"),
    }
}

/// A handler that does something beside a game.
struct Companion<F>(F);

impl<F, R> EventHandler for Companion<F>
where
    F: Fn(Context) -> R + 'static,
    R: Future<Output = ()> + 'static,
{
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            cx.spawn(self.0(cx.clone()));
        }
        Ok(())
    }
}

/// Registers a handler that does this beside a game.
pub fn beside<R: Future<Output = ()> + 'static>(
    registry: &mut Registry,
    name: &str,
    run: impl Fn(Context) -> R + Clone + Send + Sync + 'static,
) {
    registry.handler(name, &[], move |_| Ok(Companion(run.clone())));
}

/// How a game of an app ends.
pub fn play(file: &str, seed: u64, sets: &[&str], faults: &[Fault]) -> Value {
    play_with(file, seed, sets, faults, |_| {})
}

/// A daemon dies so many seconds after the start.
pub fn kill(daemon: &str, at_s: f64) -> Fault {
    let at = Instant::from_nanos((at_s * 1e9) as u64);
    Fault::on(daemon, FaultKind::Kill, at)
}

/// A file with a game of some half-moves, each chosen by a function, after which White gives up: what sets it as the opponent.
pub fn record(
    folder: &Path,
    mut game: Game,
    plies: usize,
    choose: impl Fn(usize, &[Move]) -> Move,
) -> String {
    for ply in 0..plies {
        let moves = game.position().moves(game.variant());
        game.make(choose(ply, &moves)).unwrap();
    }
    game.resign(checkers::Colour::White);
    let file = folder.join("game.pdn");
    std::fs::write(&file, game.record().write()).unwrap();
    format!("task.player.args.opponent={:?}", file.display().to_string())
}

/// The same from the first position of Brazilian rules, with one move after the other of the lists.
pub fn record_of(folder: &Path, plies: usize) -> String {
    let game = Game::new(checkers::Variant::Brazilian);
    record(folder, game, plies, |ply, moves| moves[ply % moves.len()])
}
