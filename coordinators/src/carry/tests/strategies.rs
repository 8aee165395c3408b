//! Which ways the Robot Coordinator takes, and what it learns of them.

use super::world::{CARRY, POSES, PUSHES, Room, World, on, run, run_seeded, run_with};

/// To and fro between two fields, so often.
fn tour(count: usize) -> Vec<&'static str> {
    let both = ["carry 3,4 4,5", "carry 4,5 3,4"];
    both.into_iter().cycle().take(count).collect()
}

/// How often something failed on the way, by errand; all of them were carried.
fn failures(world: &World, word: &str) -> Vec<usize> {
    let answers = world.bench.answers.iter();
    let failed = answers.map(|(symbol, text)| {
        assert_eq!(symbol, "carried", "{text}");
        text.matches(word).count()
    });
    failed.collect()
}

/// The answers at first and at last of several seeds.
fn early_and_late(world: impl Fn() -> World, word: &str) -> (usize, usize) {
    let (mut early, mut late) = (0, 0);
    for seed in 0..4 {
        let world = run_seeded(world(), &tour(40), seed);
        let failures = failures(&world, word);
        early += failures[..6].iter().sum::<usize>();
        late += failures[34..].iter().sum::<usize>();
    }
    (early, late)
}

#[test]
fn a_way_with_the_thing_that_is_made_bad_is_hardly_tried_first_any_more_after_some_errands() {
    let world = || {
        let mut world = World::default();
        world.blocked = vec!["arch"];
        world
    };
    let (early, late) = early_and_late(world, "transfer: arch failed");
    assert!(
        3 * late < early,
        "{early} ways failed at first, {late} at last"
    );
}

#[test]
fn a_turn_of_the_gripper_that_meets_something_gives_way_to_another_and_is_hardly_tried_any_more() {
    let world = || {
        let mut world = World::default();
        world.blocked_turns = vec![0.0];
        world
    };
    let (early, late) = early_and_late(world, "grasp of disc: turned by 0 degrees failed");
    assert!(
        3 * late < early,
        "{early} grasps failed at first, {late} at last"
    );
}

#[test]
fn where_every_way_is_blocked_the_answer_has_the_reason_of_each_and_nothing_was_touched() {
    let mut world = World::default();
    world.blocked = vec!["arch", "line", "joint"];
    let world = run(world, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    for way in ["arch", "line", "joint"] {
        let said = format!("approach: {way} failed");
        assert!(text.contains(&said), "{said}: {text}");
    }
    assert_eq!(world.stands_at(), on("3,4"));
    assert!(world.rests());
}

#[test]
fn where_every_turn_meets_something_the_thing_is_not_carried_after_two_tries() {
    let mut world = World::default();
    world.blocked_turns = [0.0_f64, 90.0, 45.0, -45.0].map(f64::to_radians).to_vec();
    let world = run(world, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    assert_eq!(text.matches("grasp of disc: turned").count(), 2, "{text}");
    assert_eq!(world.stands_at(), on("3,4"));
}

#[test]
fn the_answer_tells_which_ways_were_gone_and_what_is_believed_of_all() {
    let world = run(World::default(), &[CARRY]);
    let (_, text) = &world.bench.answers[0];
    for said in [
        "approach: ",
        "grasp of disc: turned by",
        "transfer: ",
        "believed of transfer: ",
    ] {
        assert!(text.contains(said), "{said}: {text}");
    }
}

#[test]
fn the_same_seed_takes_the_same_ways() {
    let answers = |seed| run_seeded(World::default(), &tour(4), seed).bench.answers;
    assert_eq!(answers(3), answers(3));
}

/// The only simpler way is blocked, and the planner is known.
fn around(mut world: World) -> World {
    world.blocked.push("arch");
    let ways = "[{ way = \"arch\", cost_s = 2.0 }, { way = \"planned\", cost_s = 8.0 }]";
    let sets = ["approach", "transfer"].map(|step| format!("task.robot.args.ways.{step}={ways}"));
    run_with(world, &sets.each_ref().map(String::as_str))
}

#[test]
fn a_way_around_everything_is_gone_where_the_simpler_one_is_blocked() {
    let world = around(World::default());
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    for said in ["approach: planned, 2 points", "transfer: planned, 2 points"] {
        assert!(text.contains(said), "{said}: {text}");
    }
    assert!((world.stands_at() - on("4,5")).norm() < 1e-9);
}

#[test]
fn where_the_planner_finds_no_way_the_answer_says_so_and_nothing_was_touched() {
    let mut walled = World::default();
    walled.is_walled_in = true;
    let world = around(walled);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    assert!(text.contains("approach: planned failed"), "{text}");
    assert_eq!(world.stands_at(), on("3,4"));
    assert!(world.rests());
}

#[test]
fn a_way_without_a_choice_that_a_guard_ends_is_gone_around_everything_where_the_app_has_a_planner()
{
    let mut world = World::default();
    world.blocked = vec!["joint"];
    let world = around(world);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    // The arm is parked by joints.
    assert!(!world.bench.reserved);
    let mut blocked = World::default();
    blocked.blocked = vec!["joint"];
    let world = run_with(blocked, &[]);
    assert_eq!(world.bench.answers[0].0, "not_carried");
    assert!(world.bench.answers[0].1.contains("park: post is near"));
}

#[test]
fn what_every_coordinator_believes_of_its_ways_is_shown_to_people() {
    let mut world = World::crowded();
    world.room = Room::InDoubt;
    let world = run_with(world, &[POSES, PUSHES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    let choices = &world.bench.choices;
    // Of the Vision Coordinator, the Dispatcher, and the Robot Coordinator.
    let steps = [
        "look",
        "push aside",
        "approach",
        "transfer",
        "grasp of disc",
    ];
    let shown: Vec<&str> = choices.keys().map(String::as_str).collect();
    for step in steps {
        let shown = choices
            .get(step)
            .unwrap_or_else(|| panic!("{step}: {shown:?}"));
        let chosen = shown.chosen.as_ref().unwrap();
        let figures = shown
            .figures
            .iter()
            .find(|one| one.name == *chosen)
            .unwrap();
        assert!(figures.trials > 0, "{step}: {shown:?}");
    }
}
