//! What goes wrong: what cannot be done is told, and what was lost is found again and shown.

use std::time::Duration;

use nalgebra::{Isometry3, Translation3, Vector3};
use vss::laser::{Plane, on_plane};

use super::{
    carry,
    layout::{board, error, laid, nothing_was_hit, turned},
    person::{Answer, Picture, Step, seen_in},
};
use crate::harness::Scratch;

#[test]
fn without_cameras_a_disc_whose_target_is_occupied_is_back_where_it_was_and_the_answer_says_why() {
    let ended = carry(&[
        "task.operator.args.arguments=[\"3,4\", \"6,6\"]",
        "task.vision.args.board=\"known\"",
    ]);
    ended.must_say("something stands there already");
    // Nobody looked, so nobody says where it is.
    ended.must_say("said: disc not carried");
    ended.must_say("object=sound").must_not_say("disc lost");
    assert_ne!(ended.code, Some(0));
}

#[test]
fn a_hand_that_finds_nothing_between_its_jaws_tells_people_itself_where_it_is_configured_so() {
    let ended = carry(&[
        "task.operator.args.arguments=[\"2,2\", \"4,5\"]",
        "task.vision.args.board=\"known\"",
        "task.dispatcher.args.tries=1",
        "task.hand.args.speaker=\"fork.sound@speaker\"",
    ]);
    assert_ne!(ended.code, Some(0));
    // One is the hand's, the other the Dispatcher's; both are said aloud.
    ended.must_say("said: no disc is in the grasp");
    ended.must_say("said: disc not carried");
}

#[test]
fn two_discs_that_are_lifted_as_one_weigh_too_much_and_are_set_back_where_they_were() {
    let scratch = Scratch::new();
    let cell = scratch.read("configs/carry-cell.toml");
    let single = "height = 0.01\nmass = 0.02\nfriction = 0.6\ncolour = [190.0, 45.0, 40.0]\nposition = [0.41, -0.03, 0.425]";
    let double = "height = 0.02\nmass = 0.04\nfriction = 0.6\ncolour = [190.0, 45.0, 40.0]\nposition = [0.41, -0.03, 0.43]";
    assert!(cell.contains(single));
    scratch.write("configs/carry-cell.toml", cell.replace(single, double));
    let seen = seen_in(&scratch, "", vec![Step::Carry("3,4,1 4,5".to_owned())]);
    let all = seen.answers.lock().unwrap();
    let Answer { symbol, text, .. } = &all[0];
    assert_eq!(symbol, "not_carried", "{text}");
    assert!(text.contains("another one sticks to it"), "{text}");
    assert!(error(&all[0], [3.0, 4.0]) < 3e-3, "{all:?}");
    assert!(turned(&all[0]) < 0.035, "{all:?}");
    nothing_was_hit(&seen);
}

/// How far a spot that is in one picture and not in the other is from the middle of the disc's upper side, m.
fn spot_error([lit, out]: [&Picture; 2]) -> f64 {
    let (bright, dark) = (lit.frame.grey(), out.frame.grey());
    let mut sum = Vector3::zeros();
    for (at, (bright, dark)) in bright.iter().zip(dark.iter()).enumerate() {
        let rise = f64::from(*bright) - f64::from(*dark);
        if rise > 30.0 {
            let (u, v) = (at % lit.frame.width, at / lit.frame.width);
            sum += rise * Vector3::new(u as f64, v as f64, 1.0);
        }
    }
    assert!(sum.z > 0.0, "there is no spot");
    let top = lit.disc.translation.vector + Vector3::z() * 0.005;
    let level = Plane {
        normal: Vector3::z_axis(),
        distance: top.z,
    };
    let met = on_plane(&lit.camera, sum.xy() / sum.z, &level).unwrap();
    (met.place.coords - top).norm()
}

#[test]
fn a_disc_that_is_lost_in_the_air_is_found_again_and_pointed_at_by_a_spot_that_blinks_and_cameras_see()
 {
    let surface = board(0.5, 0.0, 0.0);
    // The disc is in the air from about 5 to 9 s after the command.
    let lost = Duration::from_millis(7200);
    let mut steps = laid(&surface, [3.0, 4.0], [0.0; 2]);
    let table = Isometry3::translation(0.9, -0.4, 0.4052);
    steps.push(Step::Watch);
    steps.push(Step::Later(lost, "disc", table));
    steps.push(Step::Carry("3,4 4,5".to_owned()));
    // Somebody pushes the board while the disc is in the air.
    steps.extend(laid(&surface, [3.0, 4.0], [0.0; 2]));
    let pushed = board(0.54, 0.0, 0.0) * Translation3::new(0.0, 0.0, -0.01);
    steps.push(Step::Later(lost, "board", pushed));
    steps.push(Step::Carry("3,4 4,5".to_owned()));
    let seen = seen_in(&Scratch::new(), "", steps);
    let (all, pictures) = (seen.answers.lock().unwrap(), seen.pictures.lock().unwrap());
    for (answer, said) in all.iter().zip([
        "a red disc lies beside the board at x 0.90",
        "the board was moved by 40 mm",
    ]) {
        assert_eq!(answer.symbol, "not_carried", "{}", answer.text);
        assert!(answer.text.contains(said), "{said}: {}", answer.text);
    }
    assert!(
        all[1].text.contains("no disc is seen on 4,5,0"),
        "{}",
        all[1].text
    );
    for answer in &*all {
        let said = "the pointer in the hand has shown where it lies";
        assert!(answer.text.contains(said), "{}", answer.text);
    }
    // Six times each, on and off.
    assert_eq!(pictures.len(), 24);
    for pair in pictures.chunks_exact(2) {
        assert!(pair[0].lit && !pair[1].lit);
        let error = spot_error([&pair[0], &pair[1]]);
        assert!(error < 5e-3, "{error}");
    }
}
