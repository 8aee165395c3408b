//! Every process around an errand is killed at every phase of every transition, one after the other. All nets are durable, and each
//! process comes back.

use std::{
    collections::BTreeSet,
    io::Write as _,
    panic::{AssertUnwindSafe, catch_unwind},
    time::Duration,
};

use ctos::{
    boot::{Fault, FaultKind},
    time::Instant,
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::world::{
    CARRY, POSES, PUSHES, Place, Room, STAND_INS, World, motions, on, requests, tasks,
};
use crate::bench::{self, FAULTS, Fault as Wrong};

/// The tasks, each in a process of its own. The first [`DURABLE`] are durable.
const TASKS: [&str; 11] = [
    "dispatcher",
    "robot",
    "hand",
    "vision",
    "laser",
    "people",
    "pusher",
    "dom",
    "mcs",
    "gripper",
    "eyes",
];

const DURABLE: usize = 8;

/// The app with each task in a process that comes back.
fn app() -> (String, Vec<String>) {
    let mut text = bench::app(&tasks("seen"), &STAND_INS);
    let mut sets = Vec::new();
    for (number, task) in TASKS.iter().enumerate() {
        text += &format!(
            "[chassis.on_{task}]\nrestart = \"always\"\nmax_restarts = 100\nrestart_backoff_s = 0.05\n"
        );
        sets.push(format!("task.{task}.on=\"on_{task}\""));
        if number < DURABLE {
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

/// An errand; then whatever is in the hand is put back, and a field is pointed at.
fn run(kills: &[Fault]) -> World {
    let (text, sets) = app();
    bench::run_with(world(), (&text, &sets), &[CARRY, "put_back", POINT], kills)
}

fn kill(task: &str, at_ns: u64) -> Fault {
    let at = Instant::from_nanos(at_ns);
    Fault::on(format!("on_{task}"), FaultKind::Kill, at)
}

/// The field that is pointed at after an errand.
const POINT: &str = "point 5,5,0";

/// Moments at which something changes in a run that nobody disturbs, ns: every phase of every transition, a little later, when what
/// it changed is being stored, and in the midst of what takes longer.
fn moments() -> BTreeSet<u64> {
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
    let mut all = and_after(&phases);
    let phases: Vec<u64> = phases.into_iter().collect();
    let pauses = phases
        .windows(2)
        .filter(|pair| pair[1] - pair[0] > 20_000_000);
    all.extend(pauses.map(|pair| (pair[0] + pair[1]) / 2));
    all
}

fn is_near(place: &Place, field: &str) -> bool {
    matches!(place, Place::At(at) if (at - on(field)).norm() < 6e-3)
}

/// What must hold of a run, whatever went wrong besides.
fn is_true(world: &World, case: &str) {
    let case = format!(
        "{case}: {:?}; the thing was {:?}, now {:?}",
        world.bench.answers, world.at_answers, world.thing
    );
    assert!(!world.dropped, "dropped: {case}");
    assert!(world.rests(), "no rest: {case}");
    let (symbol, text) = &world.bench.answers[0];
    if symbol == "carried" {
        assert!(is_near(&world.at_answers[0], "4,5"), "{case}");
    } else {
        assert!(!text.is_empty(), "no reason: {case}");
    }
    let (symbol, _) = &world.bench.answers[1];
    let held = usize::from(world.thing == Place::InHand);
    assert!(
        held <= world.hand_full() as usize,
        "nobody knows of it: {case}"
    );
    assert_eq!(symbol == "put_down", world.hand_full() == 0, "{case}");
    let (symbol, text) = &world.bench.answers[2];
    assert!(symbol == "pointed" || !text.is_empty(), "no reason: {case}");
    if symbol == "pointed" {
        assert!(world.has_shown(&on("5,5")), "nothing was shown: {case}");
    }
    assert!(world.is_dark(), "the pointer is still lit: {case}");
}

/// What must hold of a run, whatever was killed.
fn must_hold(world: &World, case: &str) {
    is_true(world, case);
    let (symbol, text) = &world.bench.answers[0];
    let case = format!(
        "{case}: {:?}; the thing was {:?}, now {:?}",
        world.bench.answers, world.at_answers, world.thing
    );
    match symbol.as_str() {
        "carried" => {}
        "not_carried" => {
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

/// Tries cases one after the other: every one from `CTOS_CARRY_FIRST` on in a long run, else one of each `step`. How many there were,
/// and of how many `tries` was true.
fn tried<T>(
    cases: &[T],
    step: usize,
    name: impl Fn(&T) -> String,
    tries: impl Fn(&T, &str) -> bool,
) -> (usize, usize) {
    let (first, step) = if is_long() {
        (first(), 1)
    } else {
        (0, step.max(1))
    };
    let (mut count, mut well, mut failed) = (0, 0, Vec::new());
    for (number, case) in (first..).zip(cases.iter().skip(first)).step_by(step) {
        let name = name(case);
        count += 1;
        let ran = catch_unwind(AssertUnwindSafe(|| tries(case, &name)));
        if is_long() {
            let word = if ran.is_ok() { "well" } else { "FAILED" };
            let line = format!("{word}: {number} of {}: {name}\n", cases.len());
            std::io::stdout().write_all(line.as_bytes()).unwrap();
        }
        match ran {
            Ok(is_well) => well += usize::from(is_well),
            Err(_) => failed.push(name),
        }
    }
    assert!(
        failed.is_empty(),
        "{} of {count}: {failed:#?}",
        failed.len()
    );
    (count, well)
}

/// The moments at which something happens, and a little later, when what it changed is being stored.
fn and_after(moments: &BTreeSet<u64>) -> BTreeSet<u64> {
    moments
        .iter()
        .flat_map(|at| [*at, at + 1_000_000])
        .collect()
}

/// Each task, killed at each moment.
fn kills_of(tasks: &[&'static str], moments: &BTreeSet<u64>) -> Vec<(&'static str, u64)> {
    let all = tasks.iter();
    all.flat_map(|task| moments.iter().map(move |at| (*task, *at)))
        .collect()
}

#[test]
fn whoever_is_killed_at_any_phase_of_any_transition_the_answer_is_true_and_the_thing_is_in_one_place()
 {
    let all = kills_of(&TASKS, &moments());
    let name = |(task, at): &_| format!("{task} was killed at {} ms", *at as f64 / 1e6);
    let (count, carried) = tried(&all, all.len() / SHORT, name, |(task, at), case| {
        let world = run(&[kill(task, *at)]);
        must_hold(&world, case);
        world.bench.answers[0].0 == "carried"
    });
    // What died does not keep the thing from being carried, as a rule.
    assert!(
        10 * carried > 9 * count,
        "{carried} of {count} were carried"
    );
}

#[test]
fn an_arm_whose_motion_control_dies_on_a_way_goes_on_when_it_is_back_and_is_given_back() {
    let plain = run(&[]);
    for transition in [
        "do_descend",
        "do_lift",
        "do_set_down",
        "do_withdraw",
        "do_park",
    ] {
        let mut firings = plain.bench.firings.iter().map(|(_, event)| event);
        let begun = firings
            .find(|event| event.transition == transition && event.phase == "started")
            .unwrap_or_else(|| panic!("{transition} never started"));
        let world = run(&[kill("mcs", begun.at_ns + 100_000_000)]);
        must_hold(&world, transition);
        assert_eq!(
            world.bench.answers[0].0, "carried",
            "{transition}: {:?}",
            world.bench.answers
        );
    }
}

#[test]
fn a_pointer_whose_process_dies_while_it_points_points_again_and_is_out_in_the_end() {
    let plain = run(&[]);
    let mut firings = plain.bench.firings.iter().map(|(_, event)| event);
    let begun = firings.find(|event| event.transition == "do_point" && event.phase == "started");
    let begun = begun.unwrap().at_ns;
    // On the way there, and while it blinks.
    for (task, ms) in [("laser", 100), ("laser", 1200), ("mcs", 1200)] {
        let case = format!("{task} was killed {ms} ms after it began to point");
        let world = run(&[kill(task, begun + ms * 1_000_000)]);
        must_hold(&world, &case);
        let (symbol, text) = &world.bench.answers[2];
        assert!(symbol == "pointed" || task == "mcs", "{case}: {text}");
    }
}

/// An errand whose thing slips on the way to the target; people are asked whether it is fetched, and say so, or nothing.
fn asked(says: Option<&'static str>, kills: &[Fault]) -> World {
    let moves = motions(&requests());
    let mut world = world();
    world.bench.faults = vec![(moves[4], Wrong::Slips)];
    world.says = says;
    let (text, mut sets) = app();
    sets.push("task.dispatcher.args.lost=\"ask\"".to_owned());
    bench::run_with(world, (&text, &sets), &[CARRY, "put_back", POINT], kills)
}

#[test]
fn whoever_is_killed_while_people_are_asked_what_they_said_is_done_and_the_answer_is_true() {
    for (says, symbol) in [(Some("fetch"), "carried"), (None, "not_carried")] {
        let plain = asked(says, &[]);
        let answers = &plain.bench.answers;
        assert_eq!(answers[0].0, symbol, "{answers:?}");
        let firings = plain.bench.firings.iter();
        let asking = firings.filter(|(net, event)| {
            net == "people" || ["ask", "hear"].contains(&event.transition.as_str())
        });
        let phases: BTreeSet<u64> = asking.map(|(_, event)| event.at_ns).collect();
        let (first, last) = (phases.first().unwrap(), phases.last().unwrap());
        let mut moments = and_after(&phases);
        // While nobody has said anything yet.
        moments.insert(first + 15_000_000_000.min((last - first) / 2));
        // The person of these tests lives with the eyes.
        let all = kills_of(
            &["people", "dispatcher", "dom", "vision", "robot"],
            &moments,
        );
        let name = |(task, at): &_| {
            let ms = *at as f64 / 1e6;
            format!("{says:?}: {task} was killed at {ms} ms")
        };
        tried(&all, 3, name, |(task, at), case| {
            let world = asked(says, &[kill(task, *at)]);
            is_true(&world, case);
            let answers = &world.bench.answers;
            assert_eq!(answers[0].0, symbol, "{case}: {answers:?}");
            assert_eq!(world.hand_full(), 0, "{case}");
            true
        });
    }
}

/// A world in which the errand needs a look from another pose, or a push aside.
fn harder(what: &str) -> (World, &'static str) {
    let mut world = match what {
        "push" => World::crowded(),
        _ => World::default(),
    };
    world.motion = Duration::from_millis(400);
    if what == "look" {
        world.room = Room::Not;
    }
    (world, if what == "push" { PUSHES } else { POSES })
}

fn run_harder(what: &str, kills: &[Fault], seed: u64) -> World {
    let (world, way) = harder(what);
    let (text, mut sets) = app();
    sets.extend([way.to_owned(), format!("app.seed={seed}")]);
    bench::run_with(world, (&text, &sets), &[CARRY, "put_back", POINT], kills)
}

#[test]
fn whoever_is_killed_at_any_phase_of_a_look_from_another_pose_or_of_a_push_aside_the_answer_is_true()
 {
    for (what, nets) in [
        ("look", ["vision", "vision"]),
        ("push", ["pusher", "dispatcher"]),
    ] {
        let plain = run_harder(what, &[], 1);
        let answers = &plain.bench.answers;
        assert_eq!(answers[0].0, "carried", "{answers:?}");
        let firings = plain.bench.firings.iter();
        let own = firings.filter(|(net, _)| nets.contains(&net.as_str()));
        let phases: BTreeSet<u64> = own.map(|(_, event)| event.at_ns).collect();
        let tasks = [nets[0], "dispatcher", "mcs", "dom", "hand", "robot"];
        let all = kills_of(&tasks, &and_after(&phases));
        assert!(all.len() > 100, "{}", all.len());
        let name = |(task, at): &_| {
            let ms = *at as f64 / 1e6;
            format!("{what}: {task} was killed at {ms} ms")
        };
        let (count, carried) = tried(&all, all.len() / 12, name, |(task, at), case| {
            let world = run_harder(what, &[kill(task, *at)], 1);
            must_hold(&world, case);
            world.bench.answers[0].0 == "carried"
        });
        assert!(
            10 * carried > 9 * count,
            "{what}: {carried} of {count} were carried"
        );
    }
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
    let one = bench::run_with(world(), (&text, &sets), &commands[..1], &[]);
    let end = one.bench.firings.iter().map(|(_, event)| event.at_ns).max();
    let kill = kill("robot", end.unwrap() + 1_000_000);
    let world = bench::run_with(world(), (&text, &sets), &commands, &[kill]);
    let answers = &world.bench.answers;
    assert_eq!(answers[1].0, "carried", "{answers:?}");
    assert_eq!(
        (trials(&answers[0].1), trials(&answers[1].1)),
        (1, 2),
        "{answers:?}"
    );
}

/// Whether every case is tried.
fn is_long() -> bool {
    std::env::var("CTOS_CARRY_SEEDS").is_ok()
}

/// Seeds of the campaign; few unless `CTOS_CARRY_SEEDS` says how many.
fn seeds() -> usize {
    let given = std::env::var("CTOS_CARRY_SEEDS").ok();
    given.map_or(12, |text| text.parse().unwrap())
}

/// The first of them, and of all kills: `CTOS_CARRY_FIRST`, so that a long campaign can be parted.
fn first() -> usize {
    let given = std::env::var("CTOS_CARRY_FIRST").ok();
    given.map_or(0, |text| text.parse().unwrap())
}

/// What is drawn for a seed: the kills, and the errand with its faults.
fn drawn(seed: usize, end: u64) -> (Vec<Fault>, &'static str, Vec<(usize, Wrong)>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed as u64);
    let kills = (0..rng.random_range(1..4)).map(|_| {
        let task = TASKS[rng.random_range(0..TASKS.len())];
        kill(task, rng.random_range(0..end))
    });
    let kills = kills.collect();
    // Of four, one errand needs a look from another pose, and one a push aside.
    let what = ["", "", "look", "push"][rng.random_range(0..4)];
    let mut faults = Vec::new();
    for _ in 0..rng.random_range(0..3) {
        let wrong = match rng.random_range(0..=FAULTS.len()) {
            number if number < FAULTS.len() => FAULTS[number],
            _ => Wrong::Slips,
        };
        faults.push((rng.random_range(0..80), wrong));
    }
    (kills, what, faults)
}

#[test]
fn with_kills_and_faults_drawn_together_every_answer_is_true_and_the_markings_say_what_is_in_the_hand()
 {
    let end = moments().last().copied().unwrap();
    let all: Vec<usize> = (0..seeds()).collect();
    let name = |seed: &usize| format!("seed {seed}: {:?}", drawn(*seed, end));
    tried(&all, 1, name, |seed, case| {
        let (kills, what, faults) = drawn(*seed, end);
        let (mut world, way) = harder(what);
        world.bench.faults.extend(faults);
        let (text, mut sets) = app();
        sets.extend([way.to_owned(), format!("app.seed={seed}")]);
        let commands = [CARRY, "put_back", POINT];
        let world = bench::run_with(world, (&text, &sets), &commands, &kills);
        is_true(&world, case);
        true
    });
}
