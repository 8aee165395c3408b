//! Every process around an errand is killed at every phase of every transition, one after the other. All nets are durable, and each
//! process comes back.

use std::{collections::BTreeSet, time::Duration};

use ctos::{
    boot::{Fault, FaultKind},
    time::Instant,
};

use super::world::{CARRY, Place, STAND_INS, World, on, tasks};
use crate::bench;

/// The tasks, each in a process of its own. The first five are durable.
const TASKS: [&str; 8] = [
    "dispatcher",
    "robot",
    "hand",
    "vision",
    "dom",
    "mcs",
    "gripper",
    "eyes",
];

/// The app with each task in a process that comes back.
fn app() -> (String, Vec<String>) {
    let mut text = bench::app(&tasks("seen"), &STAND_INS);
    let mut sets = Vec::new();
    for (number, task) in TASKS.iter().enumerate() {
        text += &format!(
            "[chassis.on_{task}]\nrestart = \"always\"\nmax_restarts = 100\nrestart_backoff_s = 0.05\n"
        );
        sets.push(format!("task.{task}.on=\"on_{task}\""));
        if number < 5 {
            sets.push(format!("task.{task}.args.durable=true"));
        }
    }
    (text, sets)
}

/// A world in which motions take a while, so that a process may die in one.
fn world() -> World {
    let mut world = World::default();
    world.motion = Duration::from_millis(400);
    world
}

/// An errand, and then whatever is in the hand is put back.
fn run(kills: &[Fault]) -> World {
    let (text, sets) = app();
    bench::run_with(world(), (&text, &sets), &[CARRY, "put_back"], kills)
}

/// Moments at which something changes in a run that nobody disturbs, ns: every phase of every transition, a little later, when what
/// it changed is being stored, and in the midst of what takes longer.
fn moments() -> Vec<u64> {
    let plain = run(&[]);
    assert_eq!(
        plain.bench.answers[0].0, "carried",
        "{:?}",
        plain.bench.answers
    );
    let phases: BTreeSet<u64> = plain
        .bench
        .firings
        .iter()
        .map(|(_, event)| event.at_ns)
        .collect();
    let first = plain.bench.firings.iter();
    let mut first = first.map(|(_, event)| event.transition.as_str());
    assert!(
        first.any(|transition| transition == "begin"),
        "the beginning is not known"
    );
    assert!(phases.len() > 50, "{}", phases.len());
    let phases: Vec<u64> = phases.into_iter().collect();
    let mut all: BTreeSet<u64> = phases.iter().flat_map(|at| [*at, at + 1_000_000]).collect();
    let pauses = phases
        .windows(2)
        .filter(|pair| pair[1] - pair[0] > 20_000_000);
    all.extend(pauses.map(|pair| (pair[0] + pair[1]) / 2));
    all.into_iter().collect()
}

fn is_near(place: &Place, field: &str) -> bool {
    matches!(place, Place::At(at) if (at - on(field)).norm() < 6e-3)
}

/// What must hold of a run, whatever was killed.
fn must_hold(world: &World, case: &str) {
    let (symbol, text) = &world.bench.answers[0];
    let case = format!(
        "{case}: {:?}; the thing was {:?}, now {:?}",
        world.bench.answers, world.at_answers, world.thing
    );
    assert!(!world.dropped, "dropped: {case}");
    assert!(world.rests(), "no rest: {case}");
    match symbol.as_str() {
        "carried" => assert!(is_near(&world.at_answers[0], "4,5"), "{case}"),
        "not_carried" => {
            assert!(!text.is_empty(), "no reason: {case}");
            let late = ["let_go", "withdraw", "park", "verify", "4.00,5.00"];
            let is_told = late.iter().any(|word| text.contains(word));
            let has_arrived = is_near(&world.at_answers[0], "4,5");
            assert!(
                !has_arrived || is_told,
                "it is there, and nobody says so: {case}"
            );
        }
        _ => panic!("{case}"),
    }
    // Whatever was left in the hand has been put back by now.
    assert_eq!(world.bench.answers[1].0, "put_down", "{case}");
    let stands = ["3,4", "4,5"]
        .iter()
        .any(|field| is_near(&world.thing, field));
    assert!(stands && world.hand_full() == 0, "{case}");
    assert!(!world.bench.reserved, "nobody gave the arm back: {case}");
}

/// How many kills are tried in the short run; every one with `CTOS_CARRY_SEEDS`.
const SHORT: usize = 24;

#[test]
fn whoever_is_killed_at_any_phase_of_any_transition_the_answer_is_true_and_the_thing_is_in_one_place()
 {
    let moments = moments();
    let all: Vec<(&str, u64)> = TASKS
        .iter()
        .flat_map(|task| moments.iter().map(move |at| (*task, *at)))
        .collect();
    let every = std::env::var("CTOS_CARRY_SEEDS").is_ok();
    let step = if every { 1 } else { (all.len() / SHORT).max(1) };
    let (mut carried, mut tried) = (0, 0);
    let mut failed = Vec::new();
    for (task, at) in all.iter().step_by(step) {
        let kill = Fault::on(
            format!("on_{task}"),
            FaultKind::Kill,
            Instant::from_nanos(*at),
        );
        let case = format!("{task} was killed at {} ms", *at as f64 / 1e6);
        tried += 1;
        let ran = std::panic::catch_unwind(|| {
            let world = run(&[kill]);
            must_hold(&world, &case);
            world.bench.answers[0].0 == "carried"
        });
        match ran {
            Ok(was_carried) => carried += usize::from(was_carried),
            Err(_) => failed.push(case),
        }
    }
    assert!(
        failed.is_empty(),
        "{} of {tried}: {failed:#?}",
        failed.len()
    );
    // What died does not keep the thing from being carried, as a rule.
    assert!(
        10 * carried > 9 * tried,
        "{carried} of {tried} were carried"
    );
}

/// How often ways were tried that an answer's last line tells about.
fn trials(text: &str) -> u32 {
    let line = text.lines().last().unwrap_or_default();
    let words = line.split(['(', ')']);
    let counts = words.filter_map(|words| words.strip_suffix(" tried")?.parse::<u32>().ok());
    counts.sum()
}

#[test]
fn what_is_believed_of_ways_outlasts_the_process_that_believes_it() {
    let (text, sets) = app();
    let commands = [CARRY, "carry 4,5 3,4"];
    let kills = |at| Fault::on("on_robot", FaultKind::Kill, Instant::from_nanos(at));
    let one = bench::run_with(world(), (&text, &sets), &commands[..1], &[]);
    let end = one.bench.firings.iter().map(|(_, event)| event.at_ns).max();
    let kill = kills(end.unwrap() + 1_000_000);
    let world = bench::run_with(world(), (&text, &sets), &commands, &[kill]);
    let answers = &world.bench.answers;
    assert_eq!(answers[1].0, "carried", "{answers:?}");
    assert_eq!(
        (trials(&answers[0].1), trials(&answers[1].1)),
        (1, 2),
        "{answers:?}"
    );
}
