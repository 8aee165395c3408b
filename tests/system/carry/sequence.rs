//! The sequence of a carry (SORMA technical report, figure 2.4), with a gripper and with three fingers, and with another object.

use std::time::Duration;

use nalgebra::{Isometry3, Translation3};

use super::{
    carry_with,
    layout::{board, error, turned},
    person::{Answer, Step, seen_by, seen_in},
};
use crate::harness::Scratch;

#[test]
fn a_disc_is_carried_to_its_field_within_a_millimetre_and_onto_another_disc_and_off_again_corrected_by_the_hands_camera()
 {
    let list = "task.operator.args.list=\"carry/short_tour.txt\"";
    let ended = carry_with(&["--profile", "wrist"], &[list]);
    ended.must_exit(0);
    // It learns from the first disc, and tells of the last.
    ended.must_say("the camera on the hand corrects the arm");
    // Each choice stands in the log with its numbers.
    ended.must_say("a way was chosen");
    ended.must_say("arch 0.50 for 2.0 (0 tried), line 0.50 for 4.0 (0 tried)");
    assert!(
        ended.json()["error_m"].as_f64().unwrap() < 1e-3,
        "{}",
        ended.told
    );
}

/// A green button of the cell in place of the red disc, and the file that a newcomer writes for it: size, colour and grasp.
fn with_a_button() -> Scratch {
    let scratch = Scratch::new();
    let (disc, button) = (
        "radius = 0.018\nheight = 0.01\nmass = 0.02\nfriction = 0.6\ncolour = [190.0, 45.0, 40.0]\nposition = [0.41, -0.03, 0.425]",
        "radius = 0.015\nheight = 0.014\nmass = 0.012\nfriction = 0.6\ncolour = [40.0, 150.0, 60.0]\nposition = [0.41, -0.03, 0.427]",
    );
    let cell = scratch.read("configs/carry-cell.toml");
    assert!(cell.contains(disc));
    scratch.write("configs/carry-cell.toml", cell.replace(disc, button));
    let thing = "name = \"button\"\nwidth_m = 0.030\ntolerance_m = 0.003\nheight_m = 0.014\nmass_kg = 0.012\n\
        [grasp]\nforce_n = 8.0\nopen_m = 0.046\nabove_m = 0.016\nturns_deg = [0.0, 90.0]\n\
        [[colour]]\nname = \"green\"\nrgb = [40.0, 150.0, 60.0]\n";
    scratch.write("configs/carry/button.toml", thing);
    scratch
}

#[test]
fn all_that_is_said_of_another_object_is_one_file() {
    let thing = "[task.dispatcher.args]\nthing = \"carry/button.toml\"\n";
    let carried = vec![Step::Carry("3,4 4,5".to_owned())];
    let seen = seen_in(&with_a_button(), thing, carried);
    let all = seen.answers.lock().unwrap();
    assert_eq!(all[0].symbol, "carried", "{}", all[0].text);
    assert!(all[0].text.contains("grasp of button"), "{}", all[0].text);
    assert!(error(&all[0], [4.0, 5.0]) < 1.5e-3, "{all:?}");
}

/// A disc of the app of carry-hand.toml, which is 30 mm high, on a field of the board there.
fn high_disc(body: &'static str, [column, row]: [f64; 2]) -> Step {
    let (x, y) = ((column - 4.5) * 0.06, (row - 4.5) * 0.06);
    let at = board(0.5, 0.0, 0.0) * Translation3::new(x, y, 0.0152);
    Step::Put(body, at)
}

#[test]
fn three_fingers_carry_a_disc_from_beside_another_one_and_tell_when_it_is_lost_in_the_air() {
    let lost = Duration::from_millis(9000);
    let steps = vec![
        high_disc("disc", [3.0, 4.0]),
        // 60 mm beside both ends.
        high_disc("other_disc", [3.0, 5.0]),
        Step::Carry("3,4 4,5".to_owned()),
        high_disc("disc", [3.0, 4.0]),
        Step::Later(lost, "disc", Isometry3::translation(0.9, -0.4, 0.4152)),
        Step::Carry("3,4 6,3".to_owned()),
    ];
    let seen = seen_by("carry-hand.toml", &Scratch::new(), "", steps);
    let all = seen.answers.lock().unwrap();
    assert_eq!(all[0].symbol, "carried", "{}", all[0].text);
    assert!(error(&all[0], [4.0, 5.0]) < 1.5e-3, "{all:?}");
    assert!(turned(&all[0]) < 0.035, "{all:?}");
    assert!(
        all[0].text.contains("fingers open 46 mm"),
        "{}",
        all[0].text
    );
    let Answer { symbol, text, .. } = &all[1];
    assert_eq!(symbol, "not_carried", "{text}");
    assert!(text.contains("no disc is in the grasp"), "{text}");
    assert!(text.contains("a red disc lies beside the board"), "{text}");
    let shown = "the pointer in the hand has shown where it lies";
    assert!(text.contains(shown), "{text}");
    // Nothing but fingers was pressed on.
    let touches = seen.touches.lock().unwrap();
    for (link, most) in &*touches {
        let is_finger = link.starts_with("hand.tip") || link.starts_with("hand.distal");
        assert!(is_finger && *most < 12.0, "{touches:?}");
    }
}
