//! What goes wrong at one request, one after the other, in every way.

use mcs::client::Outcome as Motion;

use super::world::{CARRY, Place, World, motions, on, requests, run};
use crate::bench::{Fault, faults_at};

/// What must hold of an errand in which one request met a fault.
pub(super) fn is_true(world: &World, (number, fault): (usize, Fault)) {
    let (symbol, text) = &world.bench.answers[0];
    let case = format!(
        "{fault:?} at {number}, {}: {symbol}: {text}; {:?}, hand_full {}",
        world.bench.asked[number],
        world.thing,
        world.hand_full()
    );
    assert!(!world.dropped, "dropped: {case}");
    assert!(world.rests(), "no rest: {case}");
    let arrived = matches!(world.thing, Place::At(at) if (at - on("4,5")).norm() < 6e-3);
    match symbol.as_str() {
        "carried" => assert!(arrived, "{case}"),
        "not_carried" => {
            assert!(!text.is_empty(), "no reason: {case}");
            // It may be on its field when only what comes after that failed, which the text says.
            let after = ["let_go", "withdraw", "park"];
            let late = after.iter().any(|request| text.contains(request));
            assert!(!arrived || late, "{case}");
        }
        _ => panic!("{case}"),
    }
    if world.thing == Place::InHand {
        assert_eq!(world.hand_full(), 1, "{case}");
    }
}

#[test]
fn whatever_goes_wrong_at_any_one_request_the_answer_is_true_and_nothing_is_dropped() {
    let requests = requests().len();
    assert!(requests > 20, "{requests}");
    for number in 0..requests {
        for fault in faults_at(number, 2).chain([Fault::Slips]) {
            let world = run(World::new(&[(number, fault)]), &[CARRY]);
            is_true(&world, (number, fault));
        }
    }
}

#[test]
fn what_stays_in_the_hand_is_put_back_when_somebody_says_so_and_meanwhile_nothing_is_taken() {
    // The arm fails over the target, and again on the way back.
    let moves = motions(&requests());
    // Approach, down, up, then the way to the target: an emergency stop.
    let world = World::new(&[(moves[3], Fault::Meets(Motion::Estopped))]);
    let stuck = run(world, &[CARRY, "carry 3,4 4,5"]);
    assert_eq!(stuck.bench.answers[0].0, "not_carried");
    assert_eq!(stuck.bench.answers[1].0, "not_carried");
    assert!(
        stuck.bench.answers[1].1.contains("put_back"),
        "{:?}",
        stuck.bench.answers
    );
    assert_eq!((stuck.thing, stuck.hand_full()), (Place::InHand, 1));
    // A fault there, and again on the way back: reserved, planned, moved.
    let fault = Fault::Meets(Motion::Fault);
    let world = World::new(&[(moves[3], fault), (moves[3] + 3, fault)]);
    let back = run(world, &[CARRY, "put_back"]);
    assert_eq!(back.bench.answers[0].0, "not_carried");
    assert_eq!(back.bench.answers[1].0, "put_down");
    let at = back.stands_at();
    assert!((at - on("3,4")).norm() < 1e-9);
}

#[test]
fn without_cameras_a_thing_that_is_not_there_or_cannot_be_set_down_is_told_and_stays_where_it_was()
{
    let mut blind = World::default();
    blind.believes = "known";
    let world = run(blind, &["carry 2,2 4,5"]);
    assert_eq!(world.looks, 0);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(text.contains("no disc is in the grasp"), "{text}");
    let mut occupied = World::default();
    occupied.believes = "known";
    occupied.others.push(on("4,5"));
    let world = run(occupied, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(
        text.contains("something stands there already, 10 mm high"),
        "{text}"
    );
    assert_eq!(world.thing, Place::At(on("3,4")));
    assert!(!world.dropped && world.hand_full() == 0);
}

#[test]
fn a_way_down_that_another_guard_than_the_touch_ends_is_not_taken_for_a_thing_that_stands() {
    let mut world = World::default();
    world.held_off = Some(0.003);
    let world = run(world, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    assert!(text.contains("set_down: table is near"), "{text}");
    assert!(!world.dropped);
    assert_eq!((world.thing, world.hand_full()), (Place::InHand, 1));
}
