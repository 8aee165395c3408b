//! The pointer in the hand: what was lost is pointed at, and a field on demand.

use mcs::client::Outcome as Motion;
use nalgebra::Vector3;

use super::world::{BLINKS, CARRY, Place, World, disc, motions, on, requests, run, run_with};
use crate::bench::{Fault, faults_at};

/// Slips out of the hand on the way to the target.
fn slipping() -> World {
    let moves = motions(&requests());
    // Approach, down in two parts, up, then the way to the target.
    World::new(&[(moves[4], Fault::Slips)])
}

#[test]
fn what_was_lost_is_pointed_at_by_a_light_that_blinks_and_is_out_in_the_end() {
    let world = run(slipping(), &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(text.contains("has shown where it lies"), "{text}");
    let top = world.stands_at() + Vector3::z() * disc().height_m;
    assert_eq!(world.blinks_at(&top), BLINKS);
    assert!(world.is_dark() && !world.bench.reserved && world.rests());
}

#[test]
fn nothing_is_pointed_at_where_the_configuration_says_so_or_the_thing_was_not_lost() {
    let plain = run(World::default(), &[CARRY]);
    let mut stuck = World::default();
    stuck.blocked_turns = [0.0_f64, 90.0, 45.0, -45.0].map(f64::to_radians).to_vec();
    let stuck = run(stuck, &[CARRY]);
    let told = run_with(slipping(), &["task.dispatcher.args.show=false"]);
    for world in [&plain, &stuck, &told] {
        assert!(world.light.iter().all(|(lit, _)| *lit == 0.0));
    }
    assert_eq!(told.bench.answers[0].0, "not_carried");
}

#[test]
fn a_field_is_pointed_at_on_demand_and_what_is_none_or_out_of_reach_is_told() {
    let commands = ["point 5,5,0", "point 2,7,1", "point", "point 9,9,0"];
    let world = run(World::default(), &commands);
    let answers = &world.bench.answers;
    let symbols: Vec<&str> = answers.iter().map(|(symbol, _)| symbol.as_str()).collect();
    assert_eq!(
        symbols,
        ["pointed", "pointed", "not_pointed", "not_pointed"]
    );
    assert!(world.has_shown(&on("5,5")) && world.has_shown(&on("2,7,1")));
    assert!(answers[2].1.contains("takes a field"), "{answers:?}");
    assert!(answers[3].1.contains("not on the board"), "{answers:?}");
    let mut far = World::default();
    far.nothing_in_reach = true;
    let far = run(far, &commands[..1]);
    let (symbol, text) = &far.bench.answers[0];
    assert_eq!(symbol, "not_pointed");
    assert!(text.contains("from nowhere"), "{text}");
    assert!(far.rests() && !far.bench.reserved);
}

#[test]
fn a_hand_that_is_full_points_at_nothing() {
    let moves = motions(&requests());
    let world = World::new(&[(moves[3], Fault::Meets(Motion::Estopped))]);
    let world = run(world, &[CARRY, "point 5,5,0"]);
    let (symbol, text) = &world.bench.answers[1];
    assert_eq!(symbol, "not_pointed");
    assert!(text.contains("put_back"), "{text}");
    assert_eq!((world.thing, world.hand_full()), (Place::InHand, 1));
    assert!(world.light.iter().all(|(lit, _)| *lit == 0.0));
}

#[test]
fn whatever_goes_wrong_while_it_points_the_light_is_out_in_the_end_and_the_answer_is_true() {
    let point = ["point 5,5,0"];
    let asked = run(World::default(), &point).bench.asked;
    assert!(asked.iter().any(|request| request == "set_output"));
    for (number, request) in asked.iter().enumerate() {
        for fault in faults_at(number, 1) {
            let world = run(World::new(&[(number, fault)]), &point);
            let (symbol, text) = &world.bench.answers[0];
            let case = format!("{fault:?} at {number}, {request}: {symbol}: {text}");
            assert!(world.rests(), "no rest: {case}");
            assert!(world.is_dark() || world.bench.estopped, "lit: {case}");
            match symbol.as_str() {
                "pointed" => assert!(world.has_shown(&on("5,5")), "{case}"),
                _ => assert!(symbol == "not_pointed" && !text.is_empty(), "{case}"),
            }
        }
    }
}
