//! What the cameras of the room do not see, or not for sure, the camera on the hand looks for from other poses.

use ctos::{config, registry::Registry};

use super::{
    failures::is_true,
    world::{CARRY, POSES, Room, STAND_INS, World, on, run, run_all_with, run_with, tasks},
};
use crate::bench::{self, faults_at};

fn dim(room: Room) -> World {
    let mut world = World::default();
    world.room = room;
    world
}

#[test]
fn what_no_camera_of_the_room_sees_is_seen_from_another_pose_of_the_hand_and_carried_and_not_without_that()
 {
    let without = run(dim(Room::Not), &[CARRY]);
    let (symbol, text) = &without.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    let world = run_with(dim(Room::Not), &[POSES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    for said in [
        "look: the room failed after",
        "seen from pose",
        "seen on 4,5,0",
    ] {
        assert!(text.contains(said), "{said}: {text}");
    }
    assert!((world.stands_at() - on("4,5")).norm() < 1e-9);
    assert!(!world.bench.reserved && world.rests());
}

#[test]
fn what_one_camera_sees_alone_is_in_doubt_and_looked_at_from_another_pose_which_may_not_help() {
    let world = run_with(dim(Room::InDoubt), &[POSES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    let doubt = "only one camera sees the board, which does not tell heights";
    assert!(
        text.contains(doubt) && text.contains("seen from pose"),
        "{text}"
    );
    // From no pose: what one camera sees is better than nothing.
    let mut world = dim(Room::InDoubt);
    world.blind_poses = vec![1, 2];
    let world = run_with(world, &[POSES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    for said in [
        doubt,
        "no board is seen from pose 1",
        "what was seen in doubt is believed",
    ] {
        assert!(text.contains(said), "{said}: {text}");
    }
    assert!(!world.bench.reserved);
    // A board whose place is not known well enough.
    let sets = [POSES, "task.vision.args.another.doubt_m=0.0001"];
    let world = run_with(dim(Room::Well), &sets);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    let said = "the standard deviation of the board's place is 0.1 mm, more than 0.1 mm";
    assert!(text.contains(said), "{text}");
}

#[test]
fn from_the_pose_that_sees_it_the_other_one_is_tried_first_or_not_and_where_none_does_all_are_told()
{
    for blind in [1, 2] {
        let mut world = dim(Room::Not);
        world.blind_poses = vec![blind];
        let world = run_with(world, &[POSES]);
        let (symbol, text) = &world.bench.answers[0];
        assert_eq!(symbol, "carried", "{text}");
    }
    let mut world = dim(Room::Not);
    world.blind_poses = vec![1, 2];
    let world = run_with(world, &[POSES]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_carried", "{text}");
    for said in ["covered", "from pose 1", "from pose 2"] {
        assert!(text.contains(said), "{said}: {text}");
    }
    assert_eq!(world.stands_at(), on("3,4"));
    assert!(!world.bench.reserved && world.rests());
    // The configured place is believed where that is said.
    let mut believing = dim(Room::Not);
    believing.believes = "seen_else_known";
    believing.blind_poses = vec![1, 2];
    let world = run_with(believing, &[POSES]);
    assert_eq!(
        world.bench.answers[0].0, "carried",
        "{:?}",
        world.bench.answers
    );
}

#[test]
fn with_cameras_that_see_well_the_arm_is_not_moved_to_look() {
    let (plain, with) = (
        run(World::default(), &[CARRY]),
        run_with(World::default(), &[POSES]),
    );
    assert_eq!(plain.bench.asked, with.bench.asked);
}

#[test]
fn cameras_that_are_made_bad_are_hardly_asked_first_any_more_after_some_errands() {
    let tour: Vec<&str> = ["carry 3,4 4,5", "carry 4,5 3,4"]
        .into_iter()
        .cycle()
        .take(30)
        .collect();
    let (mut early, mut late) = (0, 0);
    for seed in 0..4 {
        let seed = format!("app.seed={seed}");
        let world = run_all_with(dim(Room::Not), &tour, &[POSES, &seed]);
        let failed = world.bench.answers.iter().map(|(symbol, text)| {
            assert_eq!(symbol, "carried", "{text}");
            text.matches("look: the room failed").count()
        });
        let failed: Vec<usize> = failed.collect();
        early += failed[..5].iter().sum::<usize>();
        late += failed[25..].iter().sum::<usize>();
    }
    assert!(
        3 * late < early,
        "{early} looks failed at first, {late} at last"
    );
}

#[test]
fn whatever_goes_wrong_at_any_one_request_of_a_look_from_another_pose_the_answer_is_true() {
    for room in [Room::Not, Room::InDoubt] {
        let asked = run_with(dim(room), &[POSES]).bench.asked.len();
        for number in 0..asked {
            for fault in faults_at(number, 1) {
                let mut world = dim(room);
                world.bench.faults = vec![(number, fault)];
                is_true(&run_with(world, &[POSES]), (number, fault));
            }
        }
    }
}

#[test]
fn what_the_camera_on_the_hand_does_not_see_from_above_the_thing_it_sees_from_beside() {
    let wrist = "task.robot.args.wrist={ camera = \"hand\" }";
    let commands = [CARRY, "carry 4,5 3,4"];
    let squinting = || {
        let mut world = World::default();
        world.squint = nalgebra::Vector3::new(0.004, -0.003, 0.0);
        world
    };
    let plain = run_all_with(squinting(), &commands, &[wrist]).bench.asked;
    let last = plain.iter().rposition(|request| request == "disk_offset");
    let mut world = squinting();
    world.bench.faults = vec![(last.unwrap(), bench::FAULTS[0])];
    let world = run_all_with(world, &commands, &[wrist]);
    let (symbol, text) = &world.bench.answers[1];
    // Uncorrected, the jaws would miss it.
    assert_eq!(symbol, "carried", "{text}");
    assert!(
        text.contains("adjust: ") && text.contains(" failed after"),
        "{text}"
    );
    assert!(text.contains("saw it 5.0 mm beside"), "{text}");
    assert!((world.stands_at() - on("3,4")).norm() < 1e-9);
}

#[test]
fn poses_and_pushes_that_make_no_sense_are_found_with_their_place_before_anything_moves() {
    let found = |set: &str| {
        let app = bench::app(&tasks("seen"), &STAND_INS);
        let sets = [POSES.to_owned(), set.to_owned()];
        let app = config::load_texts(&[("app.toml", &app)], &sets, &[]).unwrap();
        let mut registry = Registry::new();
        crate::register(&mut registry);
        registry.check(&app).to_string()
    };
    let another = "task.vision.args.another";
    for (set, said) in [
        (format!("{another}.poses=[]"), "`another.poses` has 0"),
        (
            format!("{another}.poses=[{{ at_deg = [[0, 0, 0, 0, 0, 0]] }}]"),
            "needs 2 places or more",
        ),
        (
            format!("{another}.poses=[{{ at_deg = [[0], [0]] }}]"),
            "each with 6 joints",
        ),
        (format!("{another}.doubt_m=0"), "`another.doubt_m` is 0"),
        (format!("{another}.speed=3"), "`speed` is 3"),
        (format!("{another}.snap=\"nobody\""), "nobody"),
        (
            "task.dispatcher.args.pushes=99".to_owned(),
            "`pushes` is 99",
        ),
    ] {
        let text = found(&set);
        assert!(text.contains(said), "{set}: {text}");
    }
}
