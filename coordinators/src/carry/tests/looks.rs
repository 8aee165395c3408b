//! What is seen before and after, or not seen.

use mcs::client::Outcome as Motion;
use nalgebra::{Point3, Vector3};

use super::world::{
    BOARD, CARRY, Place, World, disc, motions, on, requests, run, run_all_with, run_with,
};
use crate::{
    bench::Fault,
    carry::board::{Board, Field},
};

#[test]
fn what_is_not_there_or_in_the_way_is_answered_by_name_before_anything_moves() {
    let world = run(World::default(), &["carry 2,2 4,5"]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "nothing_at_from", "{text}");
    let said = "no disc is seen on 2,2,0; seen are a red disc on 3.00,4.00,0";
    assert!(text.contains(said), "{text}");
    assert!(!world.moved(), "{:?}", world.bench.asked);

    let mut occupied = World::default();
    occupied.others.push(on("4,5"));
    let world = run(occupied, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "occupied", "{text}");
    assert!(text.contains("a blue disc stands on 4.00,5.00,0"), "{text}");
    assert!(!world.moved() && world.rests() && world.hand_full() == 0);

    let mut cluttered = World::default();
    cluttered.clutter = true;
    let world = run(cluttered, &[CARRY]);
    assert_eq!(
        world.bench.answers[0].0, "occupied",
        "{:?}",
        world.bench.answers
    );
    assert!(!world.moved());

    // Nothing lies on TO to set it down upon, and something lies upon what is to be taken.
    for (other, command, said) in [
        (None, "carry 3,4 4,5,1", "fewer than 1 lie on 4,5"),
        (Some("3,4,1"), CARRY, "is at height 1, not at 0"),
    ] {
        let mut world = World::default();
        world.others.extend(other.map(on));
        let world = run(world, &[command]);
        let (symbol, text) = &world.bench.answers[0];
        assert_eq!(symbol, "not_carried", "{text}");
        assert!(text.contains(said), "{text}");
        assert!(!world.moved());
    }
}

#[test]
fn a_board_that_was_pushed_and_a_thing_off_its_field_are_taken_where_they_are_seen() {
    let mut pushed = World::default();
    pushed.board.at = [0.54, -0.03, 0.42];
    pushed.board.yaw_deg = -35.0;
    let at = |board: &Board, field: &str| board.point(&field.parse().unwrap(), 0.01);
    let board = pushed.board;
    // 10 mm off the middle of its field.
    pushed.thing = Place::At(at(&board, "3,4") + board.pose() * Vector3::new(0.008, -0.006, 0.0));
    let world = run(pushed, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(text.contains("seen on 4,5,0: 0.0 mm"), "{text}");
    let stands = world.stands_at();
    assert!((stands - at(&board, "4,5")).norm() < 1e-6);
}

#[test]
fn a_thing_that_slipped_in_the_air_is_found_again_and_told_by_where_it_lies() {
    let moves = motions(&requests());
    // Approach, down in two parts, up, then the way to the target.
    let world = run(World::new(&[(moves[4], Fault::Slips)]), &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    let at = world.stands_at();
    let field: Field = BOARD.field(&(BOARD.pose().inverse() * at), 0.01);
    let said = format!("a red disc lies on {:.2},{:.2}", field.column, field.row);
    assert!(text.contains(&said), "{said}: {text}");
}

#[test]
fn cameras_that_see_nothing_end_an_errand_before_anything_moves_or_leave_it_to_the_configuration() {
    let mut dark = World::default();
    dark.dark_from = 0;
    let world = run(dark, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(text.contains("find: no camera sees the board"), "{text}");
    assert_eq!(world.looks, 3);
    assert!(!world.moved() && world.rests());

    let mut believing = World::default();
    believing.dark_from = 0;
    believing.believes = "seen_else_known";
    let world = run(believing, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(
        text.contains("taken to be where it is configured"),
        "{text}"
    );
    assert!(text.contains("nobody sees it"), "{text}");

    // Dark after the thing was set down.
    let mut later = World::default();
    later.dark_from = 1;
    let world = run(later, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(
        text.contains("it was set down, and nobody sees it"),
        "{text}"
    );
}

#[test]
fn things_that_are_stuck_together_are_named_and_nothing_moves() {
    let mut stuck = World::default();
    stuck.others.push(on("3,4") + Vector3::new(0.0, 0.037, 0.0));
    let world = run(stuck, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    assert!(
        text.contains("a blue disc on ") && text.contains("is stuck to it"),
        "{text}"
    );
    assert!(!world.moved());
}

#[test]
fn a_thing_that_another_one_sticks_to_weighs_too_much_is_set_back_and_told_as_that() {
    let mut stuck = World::default();
    stuck.is_stuck = true;
    let world = run(stuck, &[CARRY]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    let said = "lift: what was lifted weighs 0.39 N, and a disc 0.20 N: another one sticks to it";
    assert!(text.contains(said), "{text}");
    assert!((world.stands_at() - on("3,4")).norm() < 1e-9);
    assert!(!world.dropped && world.hand_full() == 0 && world.rests());
    // The grasp was not the reason.
    assert!(!text.contains("turned by"), "{text}");
}

#[test]
fn fingers_open_no_further_than_what_stands_beside_the_thing_allows_at_either_end() {
    let widths = |others: &[Point3<f64>]| {
        let mut world = World::default();
        world.others = others.to_vec();
        let world = run(world, &[CARRY]);
        assert_eq!(
            world.bench.answers[0].0, "carried",
            "{:?}",
            world.bench.answers
        );
        world.opened
    };
    let usual = disc().grasp.open_m;
    assert!(widths(&[]).iter().all(|open| *open == usual));
    // 50 mm beside it: 18 mm to its rim, and a jaw of 12 mm, of which 1 mm is left free.
    for field in ["3,4", "4,5"] {
        let near = on(field) + BOARD.pose() * Vector3::new(0.05, 0.0, 0.0);
        let opened = widths(&[near]);
        assert!(!opened.is_empty());
        for open in opened {
            assert!((open - 0.040).abs() < 1e-9, "{field}: {open}");
        }
    }
}

#[test]
fn a_thing_that_slipped_in_the_air_is_fetched_where_the_configuration_says_so_and_once_only() {
    let moves = motions(&requests());
    let slip = (moves[4], Fault::Slips);
    let world = run_with(
        World::new(&[slip]),
        &["task.dispatcher.args.lost=\"fetch\""],
    );
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(
        text.contains("a red disc lies on") && text.contains("it is fetched from"),
        "{text}"
    );
    assert!((world.stands_at() - on("4,5")).norm() < 1e-6, "{text}");
    // Whatever slips again and again is told.
    let slips: Vec<(usize, Fault)> = (moves[4]..500).map(|at| (at, Fault::Slips)).collect();
    let world = run_with(World::new(&slips), &["task.dispatcher.args.lost=\"fetch\""]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    assert_eq!(text.matches("it is fetched from").count(), 1, "{text}");
    assert!(world.rests());
}

#[test]
fn people_are_asked_whether_a_lost_thing_is_fetched_and_who_says_nothing_is_not_waited_for_for_ever()
 {
    let moves = motions(&requests());
    let ask = "task.dispatcher.args.lost=\"ask\"";
    let asked = |says| {
        let mut world = World::new(&[(moves[4], Fault::Slips)]);
        world.says = says;
        run_with(world, &[ask])
    };
    let world = asked(Some("fetch"));
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(text.contains("people said that it is fetched"), "{text}");
    assert!((world.stands_at() - on("4,5")).norm() < 1e-6, "{text}");
    // Who says it twice is told that nobody asks any more.
    assert_eq!(world.replies, ["heard", "nobody_asked"]);

    for (says, reply, said) in [
        (Some("leave"), "heard", "people said that it is left"),
        (
            Some("perhaps"),
            "not_understood",
            "question: nobody answered",
        ),
        (
            None,
            "",
            "question: nobody answered whether it shall be fetched",
        ),
    ] {
        let world = asked(says);
        let (symbol, text) = &world.bench.answers[0];
        assert_eq!(symbol, "not_carried", "{text}");
        assert!(text.contains(said), "{said}: {text}");
        assert!(says.is_none() || world.replies.contains(&reply.to_owned()));
        assert!(world.rests() && world.hand_full() == 0);
    }
}

#[test]
fn the_camera_on_the_hand_learns_from_four_places_and_corrects_what_the_cameras_of_the_room_see_amiss()
 {
    let squinting = || {
        let mut world = World::default();
        world.squint = Vector3::new(0.004, -0.003, 0.0);
        world
    };
    let commands = [CARRY, "carry 4,5 3,4"];
    let without = run(squinting(), &commands);
    assert_eq!(without.bench.answers[1].0, "not_carried");
    let wrist = "task.robot.args.wrist={ camera = \"hand\" }";
    let with = run_all_with(squinting(), &commands, &[wrist]);
    let (symbol, text) = &with.bench.answers[1];
    assert_eq!(symbol, "carried", "{text}");
    assert!(text.contains("saw it 5.0 mm beside"), "{text}");
    assert_eq!(with.taught, 4);
    assert!((with.stands_at() - on("3,4")).norm() < 1e-9);
    // What it tells far off is not believed.
    let most = "task.robot.args.wrist.most_m=0.004";
    let doubting = run_all_with(squinting(), &commands, &[wrist, most]);
    assert_eq!(doubting.bench.answers[1].0, "not_carried");
    // What it sees nothing of is carried as without it.
    let asked = run_all_with(World::default(), &commands, &[wrist])
        .bench
        .asked;
    let number = asked.iter().rposition(|request| request == "disk_offset");
    let fault = Fault::Meets(Motion::Fault);
    let blind = World::new(&[(number.unwrap(), fault)]);
    let blind = run_all_with(blind, &commands, &[wrist]);
    assert_eq!(blind.bench.answers[1].0, "carried");
}
