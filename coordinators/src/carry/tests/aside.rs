//! What is stuck to the thing is pushed aside before that is grasped.

use mcs::client::Outcome as Motion;
use nalgebra::Vector3;

use super::{
    failures::is_true,
    world::{BOARD, CARRY, PUSHES, Place, World, disc, on, run, run_all_with, run_with},
};
use crate::bench::{Fault, faults_at};

#[test]
fn a_thing_with_another_one_stuck_to_it_is_carried_after_that_was_pushed_aside_and_not_without_pushing()
 {
    let without = run(World::crowded(), &[CARRY]);
    let (symbol, text) = &without.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    assert!(text.contains("is stuck to it"), "{text}");
    let world = run_with(World::crowded(), &[PUSHES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    for said in [
        "it is pushed aside",
        "push aside: to the ",
        "believed of push aside: ",
    ] {
        assert!(text.contains(said), "{said}: {text}");
    }
    assert_eq!(world.pushed, 1);
    assert!((world.stands_at() - on("4,5")).norm() < 1e-9);
    assert!(!world.bench.reserved && world.rests() && world.hand_full() == 0);
}

#[test]
fn what_was_pushed_stands_where_fingers_open_as_usual_beside_the_thing() {
    let world = run_with(World::crowded(), &[PUSHES]);
    let usual = disc().grasp.open_m;
    let opened = &world.opened;
    assert!(
        !opened.is_empty() && opened.iter().all(|open| *open == usual),
        "{opened:?}"
    );
}

#[test]
fn to_a_side_where_there_is_no_room_nothing_is_pushed_and_with_none_at_either_it_says_why() {
    // Beside what is stuck to it, to the left of the thing, to the right, or to both.
    let beside = |side: f64| {
        let (thing, stuck) = (on("3,4"), World::crowded().others[0]);
        let away = (stuck - thing).normalize();
        let left = Vector3::new(-away.y, away.x, 0.0);
        stuck + left * side * 0.06
    };
    let mut world = World::crowded();
    world.others.extend([beside(1.0), beside(-1.0)]);
    let world = run_with(world, &[PUSHES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    for side in ["left", "right"] {
        let said = format!("push aside: not to the {side}: something else is in the way there");
        assert!(text.contains(&said), "{text}");
    }
    assert!(!world.moved(), "{:?}", world.bench.asked);
    // Beside a disc of the first column it would fall off the board to the left, and beside one of the last to the right.
    for (column, away, side) in [("1", 1.0, "to the right"), ("8", 1.0, "to the left")] {
        let (along, field) = (Vector3::new(0.0, away * 0.037, 0.0), format!("{column},4"));
        let mut world = World::default();
        world.thing = Place::At(on(&field));
        world.others = vec![on(&field) + BOARD.pose() * along];
        let world = run_all_with(world, &[&format!("carry {field} 4,5")], &[PUSHES]);
        let (symbol, text) = &world.bench.answers[0];
        assert_eq!(symbol, "carried", "{text}");
        assert!(text.contains(&format!("push aside: {side}")), "{text}");
    }
}

#[test]
fn where_a_push_to_one_side_is_ended_the_other_side_is_tried_and_where_both_are_the_answer_says_so()
{
    for vain in [1.0, -1.0] {
        let mut world = World::crowded();
        world.vain_side = vain;
        let world = run_with(world, &[PUSHES]);
        let (symbol, text) = &world.bench.answers[0];
        assert_eq!(symbol, "carried", "{text}");
        assert_eq!(world.pushed, 1);
    }
    // One push only, and that in vain for some seeds.
    let mut answers = Vec::new();
    for seed in 0..6 {
        let mut world = World::crowded();
        world.vain_side = 1.0;
        let seed = format!("app.seed={seed}");
        let sets = ["task.dispatcher.args.pushes=1", &seed];
        let world = run_with(world, &sets);
        let (symbol, text) = &world.bench.answers[0];
        assert!(symbol == "carried" || text.contains("force 12 N"), "{text}");
        assert!(!world.bench.reserved && world.rests(), "{text}");
        answers.push(symbol.clone());
    }
    assert!(answers.contains(&"not_carried".to_owned()), "{answers:?}");
}

#[test]
fn a_side_that_is_made_bad_is_hardly_tried_first_any_more_after_some_errands() {
    let tour: Vec<&str> = ["carry 3,4 4,5", "carry 4,5 3,4"]
        .into_iter()
        .cycle()
        .take(40)
        .collect();
    let (mut early, mut late) = (0, 0);
    for seed in 0..4 {
        let mut world = World::crowded();
        world.vain_side = 1.0;
        let seed = format!("app.seed={seed}");
        let world = run_all_with(world, &tour, &[PUSHES, &seed]);
        let failed = world.bench.answers.iter().map(|(symbol, text)| {
            assert_eq!(symbol, "carried", "{text}");
            text.matches("push aside: to the left failed").count()
        });
        let failed: Vec<usize> = failed.collect();
        early += failed[..6].iter().sum::<usize>();
        late += failed[34..].iter().sum::<usize>();
    }
    assert!(
        3 * late < early,
        "{early} pushes failed at first, {late} at last"
    );
}

#[test]
fn whatever_goes_wrong_at_any_one_request_of_a_push_the_answer_is_true() {
    let plain = run_with(World::crowded(), &[PUSHES]).bench.asked;
    let (first, last) = (
        1,
        plain
            .iter()
            .rposition(|request| request == "look_over")
            .unwrap(),
    );
    assert!(last > first + 20, "{plain:?}");
    let asked = plain.len();
    for number in first..asked {
        for fault in faults_at(number, 2) {
            let mut world = World::crowded();
            world.bench.faults = vec![(number, fault)];
            let world = run_with(world, &[PUSHES]);
            is_true(&world, (number, fault));
        }
    }
}

#[test]
fn an_emergency_stop_in_a_push_is_told_by_its_kind_and_the_hand_is_known_to_be_empty() {
    let plain = run_with(World::crowded(), &[PUSHES]).bench.asked;
    let mut moves = plain
        .iter()
        .enumerate()
        .filter(|(_, request)| *request == "move");
    let (third, _) = moves.nth(2).unwrap();
    let mut world = World::crowded();
    world.bench.faults = vec![(third, Fault::Meets(Motion::Estopped))];
    let world = run_with(world, &[PUSHES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    assert!(
        text.contains("push aside: push: Estopped on purpose"),
        "{text}"
    );
    assert!(world.rests() && world.hand_full() == 0);
}
