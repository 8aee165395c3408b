//! What is in the hand, and who knows of it.

use ctos::message::Command;
use mcs::client::{Move, Outcome as Motion};
use mcs_hand::command::{Grasp, Open, ReadHeld};

use super::world::{CARRY, Place, World, on, requests, run};
use crate::bench::Fault;

/// What must hold of a run, whatever was refused.
fn is_known(world: &World, case: &str) {
    let (answers, thing) = (&world.bench.answers, world.thing);
    let case = format!(
        "{case}: {answers:?}; {thing:?}, hand_full {}",
        world.hand_full()
    );
    assert!(!world.dropped, "dropped: {case}");
    assert!(world.rests(), "no rest: {case}");
    let held = u32::from(thing == Place::InHand);
    assert!(held <= world.hand_full(), "nobody knows of it: {case}");
    let there = matches!(world.thing, Place::At(at) if (at - on("4,5")).norm() < 6e-3);
    let (symbol, text) = &answers[0];
    assert!(there || symbol != "carried", "{case}");
    assert!(symbol == "carried" || !text.is_empty(), "no reason: {case}");
}

/// What may go wrong for good. After a protective stop somebody resumes.
const FOR_GOOD: [Fault; 4] = [
    Fault::Meets(Motion::Lost),
    Fault::AnswerLost,
    Fault::Meets(Motion::Estopped),
    Fault::Meets(Motion::Fault),
];

#[test]
fn whatever_is_refused_from_any_moment_on_and_for_good_who_holds_the_thing_is_known() {
    let requests = requests();
    let hand = vec![Grasp::NAME, Open::NAME, ReadHeld::NAME];
    let everything = vec![Grasp::NAME, Open::NAME, ReadHeld::NAME, Move::NAME];
    for names in [hand, vec![Open::NAME], vec![Move::NAME], everything] {
        let numbers = 0..requests.len();
        for number in numbers.filter(|at| names.contains(&requests[*at].as_str())) {
            let fault = FOR_GOOD[number % FOR_GOOD.len()];
            let mut world = World::default();
            world.bench.refuses = Some((number, names.clone(), fault));
            let world = run(world, &[CARRY]);
            is_known(&world, &format!("{names:?} from {number} on: {fault:?}"));
        }
    }
}

#[test]
fn a_thing_that_was_grasped_while_the_answer_was_lost_and_jaws_that_do_not_open_are_told() {
    let requests = requests();
    // The first time it is felt whether the hand is empty.
    let mut grasps = (0..requests.len()).filter(|at| requests[*at] == Grasp::NAME);
    let grasp = grasps.nth(1).unwrap();
    let mut world = World::new(&[(grasp, Fault::AnswerLost), (grasp + 1, Fault::AnswerLost)]);
    world.bench.refuses = Some((
        grasp + 1,
        vec![Grasp::NAME, Open::NAME],
        Fault::Meets(Motion::Fault),
    ));
    let world = run(world, &[CARRY]);
    is_known(&world, "the jaws do not open");
    assert_eq!((world.thing, world.hand_full()), (Place::InHand, 1));
}

#[test]
fn a_thing_that_is_in_the_hand_from_an_earlier_life_is_felt_before_the_jaws_open() {
    let mut world = World::default();
    world.thing = Place::InHand;
    world.others = vec![on("3,4")];
    let world = run(world, &[CARRY, "carry 3,4 5,5"]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(
        text.contains("36.0 mm wide is in the hand already"),
        "{text}"
    );
    assert_eq!((world.thing, world.hand_full()), (Place::InHand, 1));
    assert!(world.bench.answers[1].1.contains("put_back"));
    assert!(!world.bench.asked.iter().any(|asked| asked == Move::NAME));
    // Where nothing stands it is put down.
    let mut world = World::default();
    world.thing = Place::InHand;
    world.believes = "known";
    let world = run(world, &[CARRY, "put_back"]);
    assert_eq!(
        world.bench.answers[1].0, "put_down",
        "{:?}",
        world.bench.answers
    );
    assert!((world.stands_at() - on("3,4")).norm() < 1e-9 && !world.dropped);
}
