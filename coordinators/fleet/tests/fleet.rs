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
    task::{Context, Handled, HandlerError, Phase},
    time::Instant,
};
use fleet::{agent::Leases, table::FleetExpander, world};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use scene_summary::{Decide, Mark, Question, Step, SumUp, Summary};

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
fn ends(app: App, seed: u64, faults: Faults, leases: Leases) -> (bool, serde_json::Value) {
    ends_with(app, seed, faults, registry(leases))
}

fn ends_with(
    mut app: App,
    seed: u64,
    faults: Faults,
    registry: Arc<Registry>,
) -> (bool, serde_json::Value) {
    app.seed = seed;
    let setup = Setup {
        faults,
        stop_after: Some(Duration::from_secs(20_000)),
        ..Setup::default()
    };
    let observer: Observer = Arc::new(|_| ());
    let run = run_shared(Arc::new(app), registry, setup, &observer).expect("chassis of the app");
    match run.outcome.end {
        End::Finished(result) => {
            let json = serde_json::from_str(&result.json);
            (result.ok, json.unwrap_or_else(|_| result.text.into()))
        }
        other => (false, format!("{other:?}: {:?}", run.faults).into()),
    }
}

/// So many seeds as `CTOS_FLEET_SEEDS` says, or this share of them.
#[allow(
    clippy::unwrap_used,
    reason = "a helper of tests, outside test functions"
)]
fn seeds(few: u64) -> std::ops::Range<u64> {
    let said = std::env::var("CTOS_FLEET_SEEDS");
    0..said.map_or(few, |count| count.parse().unwrap())
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
    for seed in seeds(6) {
        let (ok, said) = ends(app.clone(), seed, wild(seed, 4), Leases::Kept);
        assert!(ok, "seed {seed}: {said}");
        assert_eq!(said["jobs"], 20, "seed {seed}");
    }
}

#[test]
fn what_a_dead_cell_has_not_begun_is_soon_lent_to_another_one() {
    let away = "fleet.cell.chassis.ws.restart_backoff_s=60.0";
    let app = app(4, &[], &[away, "task.company.args.jobs_per_cell=2"]);
    let mut moved = 0;
    for moment in 0..30 {
        // A carry takes some 13 s, and it begins half a second after the job came.
        let when = at(10.0 + f64::from(moment) * 0.45);
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

/// A person who looks at the summary now and then, and answers each question by what lies on the board, or refuses to.
struct Person;

#[ctos::handler]
impl Person {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let here = cx.clone();
            cx.spawn(async move {
                let mut heard = Summary::default();
                let mut after = None;
                loop {
                    here.sleep(Duration::from_secs(10)).await;
                    // The company may just be away.
                    let Ok(step) = sum_up(&here, after).await else {
                        after = None;
                        continue;
                    };
                    after = step.mark;
                    heard.take(step);
                    let whole = heard.since(None);
                    for question in whole.questions.into_iter().flatten() {
                        answer(&here, &question).await;
                    }
                }
            });
        }
        Ok(())
    }
}

async fn sum_up(cx: &Context, after: Option<Mark>) -> Result<Step, HandlerError> {
    let company = cx.task("company").await?;
    Ok(cx.call(&company, SumUp { after }).await?)
}

async fn answer(cx: &Context, question: &Question) {
    let job = question.key.split(' ').nth(1).expect("a job");
    let cell = question.text.split(' ').next().expect("a cell");
    let job = job.parse().expect("a number");
    let lies = world::see(cx, "the board", |world| world.lies(cell, job)).expect("a world");
    let choice = if lies { "carried" } else { "not_carried" };
    let company = cx.task("company").await.expect("a company");
    let decide = |choice: &str| Decide {
        key: question.key.clone(),
        choice: choice.to_owned(),
        by: "a person".to_owned(),
    };
    let refused = cx.call(&company, decide("perhaps")).await;
    assert!(refused.is_err(), "{refused:?}");
    // Somebody may have been faster, or the cell is back.
    let _ = cx.call(&company, decide(choice)).await;
}

#[test]
fn a_job_that_has_begun_in_a_cell_that_never_comes_back_is_settled_by_a_person_and_not_without() {
    // Cells that die stay away longer than anybody waits.
    let away = "fleet.cell.chassis.ws.restart_backoff_s=900.0";
    let person = [
        away,
        "chassis.desk={}",
        "task.person={ handler = \"person\", on = \"desk\" }",
    ];
    let mut with_person = Registry::new();
    fleet::register(&mut with_person);
    pnt::store::keep_states(&mut with_person);
    with_person.handler("person", &Person::COMMANDS, |_| Ok(Person));
    let with_person = Arc::new(with_person);
    let mut settled = 0;
    for moment in 0..4 {
        // A carry takes some 13 s: at these moments it has begun, is in its midst, and is about to end.
        let when = at(10.0 + f64::from(moment) * 3.2);
        let faults = || {
            let kill = Fault::on("cell1.ws", FaultKind::Kill, when);
            Faults::of_script("one dies for good", vec![kill])
        };
        let alone = ends(app(4, &[], &[away]), 1, faults(), Leases::Kept);
        let (ok, said) = ends_with(app(4, &[], &person), 1, faults(), with_person.clone());
        assert!(ok, "killed at {when}: {said}");
        assert_eq!(said["jobs"], 20, "killed at {when}");
        // Where nobody is, the app does not end before the cell is back.
        let took = |said: &serde_json::Value| 20.0 / said["jobs_per_hour"].as_f64().unwrap_or(0.1);
        settled += u32::from(took(&alone.1) > 0.24 && took(&said) < 0.12);
    }
    assert!(settled >= 2, "{settled} of 4");
}

#[test]
fn worse_arguments_of_a_task_come_back_after_few_cells_and_better_ones_reach_all_under_kills() {
    for seed in seeds(1) {
        let few = app(8, &["hasty-hand"], &[]);
        let (ok, said) = ends(few, seed, Faults::none(), Leases::Kept);
        assert!(ok, "seed {seed}: {said}");
        assert_eq!(said["rollout"]["reached_all"], false, "seed {seed}: {said}");
        assert_eq!(said["rollout"]["cells_at_most"], 2, "seed {seed}: {said}");
        let all = app(8, &["gentle-hand"], &[]);
        let (ok, said) = ends(all, seed, wild(seed, 8), Leases::Kept);
        assert!(ok, "seed {seed}: {said}");
        assert_eq!(said["rollout"]["reached_all"], true, "seed {seed}: {said}");
    }
}

#[test]
fn wrong_arguments_are_refused_by_the_check_with_their_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let found = |task: &str, text: &str| {
        let file = folder.path().join("args.toml");
        std::fs::write(&file, text).expect("a file");
        let args = format!("task.company.args.rollout.args={:?}", file.display());
        let task = format!("task.company.args.rollout.task={task:?}");
        let app = app(2, &["hasty-hand"], &[&args, &task]);
        registry(Leases::Kept).check(&app).to_string()
    };
    for (text, place, says) in [
        ("\ntime = \"fleet/times.toml\"\n", "args.toml:2:1", "time"),
        ("times = 3\n", "args.toml:1:9", "times"),
        ("asks = [\"nobody\"]\n", "args.toml:1:9", "nobody"),
        ("times = \"fleet/no.toml\"\n", "no.toml", "no.toml"),
        ("times = [\n", "args.toml:", "args.toml"),
    ] {
        let told = found("hand", text);
        assert!(
            told.contains(place) && told.contains(says),
            "{text}: {told}"
        );
    }
    let told = found("agent", "needs_s = 1\n");
    assert!(told.contains("takes no other arguments"), "{told}");
    let told = found("mcs", "asks = []\n");
    assert!(told.contains("would forget"), "{told}");
    let told = found("foot", "asks = []\n");
    assert!(told.contains("cell1.foot"), "{told}");
    assert_eq!(
        found("hand", "times = \"fleet/hand/gentle-times.toml\"\n"),
        ""
    );
}

#[test]
fn a_worse_net_comes_back_after_few_cells_and_a_better_one_reaches_all() {
    for seed in seeds(1) {
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
