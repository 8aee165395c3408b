//! Strategies with physics: a neighbour is pushed aside first, and what the cameras of the room do not see is looked at from another
//! pose of the hand.

use nalgebra::{Isometry3, Translation3};
use sim::scene::CameraFault;

use super::{
    layout::{board, disc_on, error, laid, nothing_was_hit, other},
    person::{Step, seen_by, seen_in},
};
use crate::harness::{CTOS, Scratch};

/// The blue disc stands right beside the red one on 3,4, along the columns or the rows, 1 mm from rim to rim.
pub(super) fn stuck(surface: &Isometry3<f64>, [x, y]: [f64; 2]) -> Vec<Step> {
    let mut steps = laid(surface, [3.0, 4.0], [0.0; 2]);
    let beside = disc_on(surface, [3.0, 4.0], [x * 0.037, y * 0.037]);
    steps.push(Step::Put("other_disc", beside));
    steps
}

#[test]
fn a_disc_that_another_one_is_stuck_to_is_carried_after_that_was_pushed_aside_and_not_without_pushing()
 {
    let mut steps = Vec::new();
    for (surface, beside) in [
        (board(0.5, 0.0, 0.0), [1.0, 0.0]),
        (board(0.55, -0.04, 30.0), [0.0, -1.0]),
    ] {
        steps.extend(stuck(&surface, beside));
        steps.push(Step::Carry("3,4 6,5".to_owned()));
    }
    let seen = seen_in(&Scratch::new(), "", steps.clone());
    let all = seen.answers.lock().unwrap();
    for answer in &*all {
        assert_eq!(answer.symbol, "carried", "{}", answer.text);
        assert!(error(answer, [6.0, 5.0]) < 1.5e-3, "{answer:?}");
        let said = answer.text.contains("push aside: to the ");
        assert!(
            said && answer.text.contains("is stuck to it"),
            "{}",
            answer.text
        );
    }
    nothing_was_hit(&seen);
    let never = "[task.dispatcher.args]\npushes = 0\n";
    let seen = seen_in(&Scratch::new(), never, steps);
    let all = seen.answers.lock().unwrap();
    for answer in &*all {
        assert_eq!(answer.symbol, "not_carried", "{}", answer.text);
        assert!(error(answer, [3.0, 4.0]) < 3e-3, "{answer:?}");
    }
}

/// The camera on the hand belongs to the app, as in the profile `wrist`.
pub(super) fn by_hand(steps: Vec<Step>) -> super::person::Seen {
    let scratch = Scratch::new();
    let app = scratch.read("configs/carry.toml");
    let (_, rest) = app.split_once("[profile.wrist.vss]").unwrap();
    let (profile, rest) = rest.split_once("# With `--profile planned`").unwrap();
    let profile = format!("[profile.wrist.vss]{profile}");
    assert!(!rest.contains("profile.wrist"));
    let services = "\nservices = [\"SpotFind\"]\n";
    assert!(rest.contains(services));
    let app = app
        .replace(&profile, "")
        .replace(services, "\nservices = [\"SpotFind\", \"DiskFind\"]\n");
    let (_, profile) = profile.split_once("\n\n").unwrap();
    let app = app + "\n" + &profile.replace("[profile.wrist.", "[");
    scratch.write("configs/carry.toml", app);
    seen_by("carry.toml", &scratch, "", steps)
}

pub(super) fn covered(camera: &'static str) -> Step {
    Step::Camera(camera, Some(CameraFault::Cover))
}

#[test]
fn a_disc_that_no_camera_of_the_room_sees_is_seen_by_the_hand_from_another_pose_and_placed_within_3_mm()
 {
    let surface = board(0.5, 0.0, 0.0);
    let mut steps = laid(&surface, [3.0, 4.0], [0.004, -0.003]);
    steps.push(other(&surface, [6.0, 6.0]));
    steps.extend([covered("left"), covered("right")]);
    steps.push(Step::Carry("3,4 4,5".to_owned()));
    // One camera alone is in doubt.
    steps.extend([
        Step::Camera("right", None),
        Step::Carry("4,5 5,3".to_owned()),
    ]);
    let seen = by_hand(steps);
    let all = seen.answers.lock().unwrap();
    for (answer, field) in all.iter().zip([[4.0, 5.0], [5.0, 3.0]]) {
        assert_eq!(answer.symbol, "carried", "{}", answer.text);
        assert!(answer.text.contains("seen from pose"), "{}", answer.text);
        assert!(error(answer, field) < 3e-3, "{answer:?}");
    }
    let doubt = "only one camera sees the board";
    assert!(all[1].text.contains(doubt), "{}", all[1].text);
    nothing_was_hit(&seen);
}

#[test]
fn from_the_pose_of_the_hand_a_stack_is_told_from_a_single_disc() {
    let surface = board(0.5, 0.0, 0.0);
    let mut steps = vec![Step::Put(
        "board",
        surface * Translation3::new(0.0, 0.0, -0.01),
    )];
    steps.push(other(&surface, [3.0, 4.0]));
    let upper = Translation3::new(0.0, 0.0, 0.0102) * disc_on(&surface, [3.0, 4.0], [0.0; 2]);
    steps.push(Step::Put("disc", upper));
    steps.extend([covered("left"), covered("right")]);
    steps.push(Step::Carry("3,4,0 4,5".to_owned()));
    steps.push(Step::Carry("3,4,1 4,5".to_owned()));
    let seen = by_hand(steps);
    let all = seen.answers.lock().unwrap();
    assert!(all[0].text.contains("is at height 1"), "{}", all[0].text);
    assert_eq!(all[1].symbol, "carried", "{}", all[1].text);
    assert!(error(&all[1], [4.0, 5.0]) < 3e-3, "{all:?}");
}

#[test]
fn the_overview_displays_of_all_coordinators_name_only_what_their_nets_have() {
    let check = |scratch: &Scratch| {
        let app = "include = [\"carry.toml\"]\n[task.display]\nhandler = \"pnt.display\"\non = \"ws1/main\"\n";
        scratch.write("configs/shown.toml", app);
        let shown = ["check", "configs/shown.toml"];
        scratch.start(CTOS, &shown, &[]).end()
    };
    let scratch = Scratch::new();
    let whole = check(&scratch);
    whole.must_exit(0);
    whole.must_not_say("pnt::display");
    let displays = scratch.read("configs/displays/carry.toml");
    for net in [
        "dispatcher",
        "robot",
        "hand",
        "vision",
        "pusher",
        "laser",
        "people",
    ] {
        assert!(displays.contains(&format!("\"{net}/")), "{net}");
    }
    scratch.write(
        "configs/displays/carry.toml",
        displays.replace("vision/*", "vision/nobody"),
    );
    check(&scratch).must_say("vision/nobody");
}
