//! The Vision Coordinator between stand-ins, and what counts as a miss.

use std::sync::Arc;

use super::*;
use crate::outcome::Outcome;
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

fn error(outcome: Vss, reason: &str) -> Look {
    Look::from(Err(VisionError::new(outcome, reason)))
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
fn only_what_was_not_seen_is_a_miss_and_anything_else_is_a_failure_of_its_kind() {
    let reason = "camera `west`: no spot".to_owned();
    let missed = error(Vss::Unseen, &reason);
    assert_eq!(missed, Look::Missed { reason });
    for (vss, outcome) in [
        (Vss::Fault, Outcome::Fault),
        (Vss::Lost, Outcome::Lost),
        (Vss::Refused, Outcome::Refused),
    ] {
        let failed = Failure::new(outcome, "no signal");
        assert_eq!(error(vss, "no signal"), Look::Failed(failed));
    }
}

#[test]
fn a_vision_system_that_fails_is_not_asked_by_the_net_again() {
    let mut vision = Vision {
        args: Rc::new(args()),
        store: DomStore::new("dom"),
        spots: Spots::default(),
        tries_left: 2,
    };
    vision.take("west".to_owned(), error(Vss::Fault, "no signal"));
    assert_eq!(vision.tries_left, 0);
    let failure = vision.spots.failure.unwrap();
    assert_eq!(failure.to_string(), "fault: no signal");
}

#[test]
fn a_vision_system_that_is_lost_is_waited_for_and_no_position_is_burnt() {
    // Both cameras, for some seconds, in the midst of the run.
    let run = run(&Rig {
        script: Arc::new(|command, _, occurrence| match command {
            "spot_find" if (5..25).contains(&occurrence) => Answer::Meet(Outcome::Lost),
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    assert_eq!(run.answer().0, "calibration_done", "{}", run.answer().1);
    let observations: Observations = run.object(OBSERVATIONS).unwrap();
    assert_eq!(observations.reached, 16);
    assert!(observations.cameras.iter().all(|table| table.missed == 0));
}

#[test]
fn a_vision_system_that_stays_lost_fails_the_command_with_that_outcome() {
    let run = run(&Rig {
        script: Arc::new(|command, _, occurrence| match command {
            "spot_find" if occurrence >= 5 => Answer::Meet(Outcome::Lost),
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_failed");
    assert!(
        text.contains("the vision system has failed: lost:"),
        "{text}"
    );
    assert_eq!(run.done("move", ""), 6);
    assert!(!crate::rig::lock(&run.world).lamp_on);
}

fn args() -> VisionArgs {
    VisionArgs {
        cameras: vec!["west".to_owned()],
        vsm: vsm_task(),
        dom: crate::dom_task(),
        retries: retries(),
        service_within_s: crate::service_within_s(),
    }
}
