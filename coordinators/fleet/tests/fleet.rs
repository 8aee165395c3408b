//! A whole fleet in virtual time: `configs/fleet.toml` with faults, kills, cuts and rollouts. In each run the referee
//! counts, and a fleet whose agents ignore their leases shows that it would find what is doubled.

#![allow(clippy::expect_used, reason = "a test that cannot be set up fails")]

use std::{
    path::Path,
    sync::{Arc, OnceLock},
    time::Duration,
};

use ctos::{
    boot::{End, Observer},
    config::{App, Expander, Selection},
    registry::Registry,
    simulation::{Fault, FaultKind, Faults, Setup, run_shared},
    time::Instant,
};
use fleet::{agent::Leases, table::FleetExpander};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// The fleet with so many cells, and settings of one's own.
fn app(cells: u64, profiles: &[&str], sets: &[&str]) -> App {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/fleet.toml");
    let sets = [format!("fleet.cells={cells}"), "fleet.sites=2".to_owned()]
        .into_iter()
        .chain(sets.iter().map(|set| (*set).to_owned()));
    let selection = Selection {
        profiles: profiles.iter().map(|one| (*one).to_owned()).collect(),
        sets: sets.collect(),
        ..Selection::new(file)
    };
    let expanders: [(&'static str, &dyn Expander); 1] = [("fleet", &FleetExpander)];
    selection
        .load(&expanders)
        .expect("a configuration that is right")
}

fn registry(leases: Leases) -> Arc<Registry> {
    let make = |leases| {
        let mut registry = Registry::new();
        fleet::register_with(&mut registry, leases);
        pnt::store::keep_states(&mut registry);
        Arc::new(registry)
    };
    static KEPT: OnceLock<Arc<Registry>> = OnceLock::new();
    match leases {
        Leases::Kept => KEPT.get_or_init(|| make(leases)).clone(),
        Leases::Ignored => make(leases),
    }
}

/// How a run ended: whether it was well, and what it said.
fn ends(mut app: App, seed: u64, faults: Faults, leases: Leases) -> (bool, serde_json::Value) {
    app.seed = seed;
    let setup = Setup {
        faults,
        stop_after: Some(Duration::from_secs(20_000)),
        ..Setup::default()
    };
    let observer: Observer = Arc::new(|_| ());
    let run =
        run_shared(Arc::new(app), registry(leases), setup, &observer).expect("chassis of the app");
    match run.outcome.end {
        End::Finished(result) => {
            let json = serde_json::from_str(&result.json);
            (result.ok, json.unwrap_or_else(|_| result.text.into()))
        }
        other => (false, format!("{other:?}: {:?}", run.faults).into()),
    }
}

fn at(seconds: f64) -> Instant {
    Instant::START + Duration::from_secs_f64(seconds)
}

/// Kills and cuts at moments of their own: cells, offices and the head die, cells are cut off from their sites, and sites
/// from the company.
fn wild(seed: u64, cells: u64) -> Faults {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut script = Vec::new();
    for _ in 0..cells * 4 {
        let cell = rng.random_range(1..=cells);
        let site = (cell - 1) * 2 / cells + 1;
        let ws = format!("cell{cell}.ws");
        let office = format!("site{site}.office");
        let when = at(rng.random_range(2.0..120.0));
        let lasts = Duration::from_secs_f64(rng.random_range(0.5..300.0));
        let part = ["ws", "robot", "vision"][rng.random_range(0..3)];
        script.push(match rng.random_range(0..10) {
            0..4 => Fault::on(format!("cell{cell}.{part}"), FaultKind::Kill, when),
            4..7 => Fault::between(&ws, &office, FaultKind::Break, when).until(when + lasts),
            7 => Fault::between("head", &office, FaultKind::Break, when).until(when + lasts),
            8 => Fault::on(&office, FaultKind::Kill, when),
            _ => Fault::on("head", FaultKind::Kill, when),
        });
    }
    Faults::of_script("wild", script)
}

#[test]
fn nets_and_arguments_of_the_fleet_are_sound() {
    let app = app(4, &[], &[]);
    let found = registry(Leases::Kept).check(&app);
    assert!(found.is_empty(), "{found}");
}

#[test]
fn without_faults_every_job_is_done_once() {
    let (ok, said) = ends(app(6, &[], &[]), 1, Faults::none(), Leases::Kept);
    assert!(ok, "{said}");
    assert_eq!(said["jobs"], 30);
    let again = ends(app(6, &[], &[]), 1, Faults::none(), Leases::Kept);
    assert_eq!(again, (ok, said), "the same seed is the same run");
}

#[test]
fn a_job_costs_no_more_messages_among_many_cells_than_among_few() {
    let costs = |cells| {
        let (ok, said) = ends(app(cells, &[], &[]), 1, Faults::none(), Leases::Kept);
        assert!(ok, "{said}");
        said["messages_per_job"].as_f64().expect("a number")
    };
    let (few, many) = (costs(4), costs(24));
    assert!(many < few * 1.1, "{few} among few, {many} among many");
}

#[test]
fn no_job_is_lost_or_doubled_whoever_dies_or_is_cut_off() {
    let app = app(4, &[], &[]);
    for seed in 0..20 {
        let (ok, said) = ends(app.clone(), seed, wild(seed, 4), Leases::Kept);
        assert!(ok, "seed {seed}: {said}");
        assert_eq!(said["jobs"], 20, "seed {seed}");
    }
}

#[test]
fn what_a_dead_cell_has_not_begun_is_soon_lent_to_another_one() {
    let app = app(4, &[], &["fleet.cell.chassis.ws.restart_backoff_s=60.0"]);
    let mut moved = 0;
    for moment in 0..40 {
        // A carry takes some 13 s, and it begins half a second after the job came.
        let when = at(10.0 + f64::from(moment) * 0.35);
        let kill = Fault::on("cell1.ws", FaultKind::Kill, when);
        let faults = Faults::of_script("one dies", vec![kill]);
        let (ok, said) = ends(app.clone(), 1, faults, Leases::Kept);
        assert!(ok, "killed at {when}: {said}");
        if said["moved"] != 0 {
            moved += 1;
            let most = said["moved_s"]["most"].as_f64();
            assert!(
                most.is_some_and(|most| most < 20.0),
                "killed at {when}: {said}"
            );
        }
    }
    assert!(moved > 0, "no job of a cell that died went elsewhere");
}

#[test]
fn the_referee_finds_cells_that_ignore_their_leases() {
    let app = app(4, &[], &[]);
    let doubled = (0..20).any(|seed| {
        let (ok, said) = ends(app.clone(), seed, wild(seed, 4), Leases::Ignored);
        !ok && said["doubled"]
            .as_array()
            .is_some_and(|jobs| !jobs.is_empty())
    });
    assert!(doubled);
}

#[test]
fn a_worse_net_comes_back_after_few_cells_and_a_better_one_reaches_all() {
    for seed in 0..3 {
        let few = app(8, &["worse"], &[]);
        let (ok, said) = ends(few, seed, Faults::none(), Leases::Kept);
        assert!(ok, "seed {seed}: {said}");
        assert_eq!(said["rollout"]["reached_all"], false, "seed {seed}: {said}");
        assert_eq!(said["rollout"]["cells_at_most"], 2, "seed {seed}: {said}");
        let all = app(8, &["better"], &[]);
        let (ok, said) = ends(all, seed, Faults::none(), Leases::Kept);
        assert!(ok, "seed {seed}: {said}");
        assert_eq!(said["rollout"]["reached_all"], true, "seed {seed}: {said}");
    }
}
