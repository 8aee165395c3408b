//! The Vision Coordinator between stand-ins, and what counts as a miss.

use std::sync::Arc;

use super::*;
use crate::{
    objects::{OBSERVATIONS, Observations},
    rig::{Answer, Rig, run, spot},
};

fn refusing_east(when: &'static [usize]) -> Rig {
    Rig {
        script: Arc::new(move |command, detail, occurrence| match (command, detail) {
            ("spot_find", "east") if when.contains(&occurrence) => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    }
}

#[test]
fn only_the_cameras_that_missed_look_again() {
    let run = run(&refusing_east(&[0, 1]));
    assert_eq!(run.answer().0, "calibration_done");
    assert_eq!(run.asked("spot_find", "west"), 16);
    assert_eq!(run.asked("spot_find", "east"), 18);
    let observations: Observations = run.object(OBSERVATIONS).unwrap();
    assert!(observations.cameras.iter().all(|table| table.missed == 0));
}

#[test]
fn after_the_last_try_the_spot_is_skipped_and_the_other_camera_keeps_its_own() {
    let run = run(&refusing_east(&[0, 1, 2]));
    assert_eq!(run.answer().0, "calibration_done");
    assert_eq!(run.asked("spot_find", "east"), 18);
    let observations: Observations = run.object(OBSERVATIONS).unwrap();
    let counts: Vec<_> = observations
        .cameras
        .iter()
        .map(|table| (table.points.len(), table.missed))
        .collect();
    assert_eq!(counts, [(16, 0), (15, 1)]);
    let skipped = run.firings("vision");
    let skipped = skipped
        .iter()
        .filter(|one| *one == "skip_spot fired")
        .count();
    assert_eq!(skipped, 1);
}

#[test]
fn a_vision_system_that_fails_once_is_asked_again() {
    let run = run(&Rig {
        script: Arc::new(|command, detail, occurrence| match (command, detail) {
            ("spot_find", "east") if occurrence < 2 => Answer::Silent,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    assert_eq!(run.answer().0, "calibration_done");
    let observations: Observations = run.object(OBSERVATIONS).unwrap();
    assert!(observations.cameras.iter().all(|table| table.missed == 0));
}

fn error(fault: Fault) -> Look {
    Look::from(Err(CallError {
        from: "vision".to_owned(),
        to: "vsm".to_owned(),
        command: "spot_find".to_owned(),
        fault,
    }))
}

#[test]
fn a_spot_at_the_border_counts_as_missed() {
    let mut report = spot("west", 3.26, 250.0);
    assert!(matches!(Look::from(Ok(report.clone())), Look::Seen(_)));
    report.flags.touches_border = true;
    let reason = "camera `west`: the spot at 3.3, 250.0 touches the border".to_owned();
    assert_eq!(Look::from(Ok(report)), Look::Missed { reason });
}

#[test]
fn a_refusal_is_a_miss_and_anything_else_is_a_failure() {
    let text = "camera `west`: no spot".to_owned();
    let reason = text.clone();
    assert_eq!(error(Fault::Refused { text }), Look::Missed { reason });
    assert!(matches!(
        error(Fault::NoReply),
        Look::Failed { gone: false, .. }
    ));
}

#[test]
fn a_vision_system_that_is_gone_is_a_failure_that_is_not_tried_again() {
    let chassis = "cage_vision".to_owned();
    let look = error(Fault::PeerDown { chassis });
    let args = args();
    let mut vision = Vision {
        args: Rc::new(args),
        store: DomStore::new("dom"),
        spots: Spots::default(),
        tries_left: 2,
    };
    vision.take("west".to_owned(), look);
    assert_eq!(vision.tries_left, 0);
    let failure = vision.spots.failure.unwrap();
    assert!(
        failure.contains("chassis `cage_vision` is gone"),
        "{failure}"
    );
}

fn args() -> VisionArgs {
    VisionArgs {
        cameras: vec!["west".to_owned()],
        vsm: vsm_task(),
        dom: crate::dom_task(),
        retries: retries(),
    }
}
