//! The way of an errand, and commands that make none.

use super::world::{CARRY, World, disc, on, run};

#[test]
fn a_thing_is_carried_from_field_to_field_and_the_arm_is_given_back() {
    let world = run(World::default(), &[CARRY]);
    assert_eq!(
        world.bench.answers[0].0, "carried",
        "{:?}",
        world.bench.answers
    );
    let at = world.stands_at();
    assert!((at - on("4,5")).norm() < 1e-9);
    assert!(!world.bench.reserved && world.is_open && world.rests() && world.hand_full() == 0);
}

#[test]
fn the_first_turn_with_which_the_arm_reaches_everything_is_taken() {
    let mut world = World::default();
    world.unreachable = vec![0.0];
    let world = run(world, &[CARRY]);
    assert_eq!(
        world.bench.answers[0].0, "carried",
        "{:?}",
        world.bench.answers
    );
    let mut nowhere = World::default();
    let turns = disc().grasp.turns_deg;
    nowhere.unreachable = turns.iter().map(|turn| turn.to_radians()).collect();
    let world = run(nowhere, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(text.contains("`from` cannot be reached"), "{text}");
}

#[test]
fn a_command_that_names_no_two_fields_is_refused_in_words_and_moves_nothing() {
    let world = run(World::default(), &["carry", "carry 3,4 9,9", "carry a b"]);
    for (symbol, text) in &world.bench.answers {
        assert_eq!(symbol, "not_carried");
        assert!(
            text.contains("FROM") || text.contains("field") || text.contains("board"),
            "{text}"
        );
    }
    assert!(world.bench.asked.is_empty(), "{:?}", world.bench.asked);
}
