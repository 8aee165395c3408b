//! The Motion Coordinator between stand-ins.

use std::sync::Arc;

use super::*;
use crate::{
    objects::Observations,
    rig::{Answer, Rig, lock, positions, run},
};

#[test]
fn the_other_elbow_is_tried_when_the_nearest_is_refused() {
    let run = run(&Rig {
        script: Arc::new(|command, detail, _| match (command, detail) {
            ("plan", "None") => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    assert_eq!(run.answer().0, "calibration_done");
    assert_eq!(run.done("plan", "Some(Above)"), 16);
    assert_eq!(run.asked("plan", "Some(Below)"), 0);
    assert_eq!(run.done("move", ""), 16);
}

#[test]
fn the_manipulator_is_reserved_once_and_given_back_once_per_command() {
    let run = run(&Rig {
        commands: 2,
        ..Rig::default()
    });
    assert_eq!(run.answers.len(), 2);
    assert_eq!((run.done("acquire", ""), run.done("release", "")), (2, 2));
    assert!(!lock(&run.world).reserved);
    let log: MotionLog = run.object(MOTIONS).unwrap();
    assert_eq!(log.moves, 16, "the log is that of the last command");
    assert_eq!(log.max_tracking_error_rad, 0.01);
    assert_eq!(log.max_final_error_rad, 0.001);
}

#[test]
fn a_reservation_whose_answer_is_lost_is_asked_for_again_and_costs_nothing() {
    let run = run(&Rig {
        script: Arc::new(|command, _, occurrence| match (command, occurrence) {
            ("acquire", 0) => Answer::Lost,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    assert_eq!(run.answer().0, "calibration_done");
    let observations: Observations = run.object(crate::objects::OBSERVATIONS).unwrap();
    assert_eq!(observations.reached, 16);
    assert!(!lock(&run.world).reserved);
}

#[test]
fn a_move_that_is_not_answered_is_cancelled_and_the_command_fails() {
    let run = run(&Rig {
        script: Arc::new(|command, _, occurrence| match (command, occurrence) {
            ("move", 1) => Answer::Late,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_failed");
    assert!(
        text.contains("lost: `mcs` did not answer `move` from `motion`"),
        "{text}"
    );
    assert_eq!(run.done("cancel", ""), 1);
    assert_eq!(run.asked("move", ""), 2);
    assert!(!lock(&run.world).reserved);
}

#[test]
fn whatever_ends_a_motion_but_a_position_out_of_reach_fails_the_command_in_its_name() {
    for outcome in [
        Outcome::Estopped,
        Outcome::Guard,
        Outcome::Fault,
        Outcome::Lost,
        Outcome::Refused,
    ] {
        for (request, detail, occurrence, moves) in [
            ("acquire", "", 0, 0),
            ("plan", "None", 3, 3),
            ("move", "", 3, 3),
        ] {
            let run = run(&Rig {
                script: Arc::new(move |command, with, n| {
                    // A service that stays lost is given up.
                    let lasting = outcome == Outcome::Lost && n > occurrence;
                    match command == request && with == detail && (n == occurrence || lasting) {
                        true => Answer::Meet(outcome),
                        false => Answer::Work,
                    }
                }),
                ..Rig::default()
            });
            let (symbol, text) = run.answer();
            let case = format!("{request}: {outcome}: {text}");
            assert_eq!(symbol, "calibration_failed", "{case}");
            assert!(text.contains(&format!("{outcome}: {request}")), "{case}");
            assert_eq!(run.done("move", ""), moves, "{case}");
            let world = lock(&run.world);
            assert!(!world.reserved && !world.lamp_on, "{case}");
        }
    }
}

#[test]
fn a_manipulator_that_is_no_longer_reserved_for_it_is_lost_and_not_taken_again() {
    // After the fourth position, in the midst of the command.
    let run = run(&Rig {
        script: Arc::new(|command, _, n| match (command, n) {
            ("move", 3) => Answer::Taken,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_failed");
    assert!(
        text.contains("lost: the manipulator is no longer reserved for `motion`"),
        "{text}"
    );
    assert_eq!(run.done("move", ""), 4);
    assert_eq!(run.done("acquire", ""), 1);
}

fn stopped_at_the_fourth(resume_at_s: Option<f64>) -> Rig {
    Rig {
        resume_at_s,
        script: Arc::new(|command, _, n| match (command, n) {
            ("move", 3) => Answer::Meet(Outcome::Stopped),
            _ => Answer::Work,
        }),
        ..Rig::default()
    }
}

#[test]
fn a_protective_stop_holds_until_somebody_resumes_and_the_command_goes_on() {
    let run = run(&stopped_at_the_fourth(Some(30.0)));
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_done", "{text}");
    let observations: Observations = run.object(crate::objects::OBSERVATIONS).unwrap();
    assert_eq!(observations.reached, 16);
    let world = lock(&run.world);
    let moves: Vec<_> = world.log.iter().filter(|entry| entry.0 == "move").collect();
    assert!(moves[2].3 < 10.0 && moves[3].2 >= 30.0, "{moves:?}");
}

#[test]
fn a_protective_stop_that_nobody_ends_fails_the_command() {
    let run = run(&stopped_at_the_fourth(None));
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_failed");
    assert!(
        text.contains("stopped: move : stopped on purpose; nobody resumed within 60 s"),
        "{text}"
    );
    assert_eq!(run.done("move", ""), 3);
    assert!(!lock(&run.world).reserved);
}

#[test]
fn giving_back_is_tried_again_and_told_when_it_cannot_be_done() {
    let refused = |times: usize| {
        run(&Rig {
            script: Arc::new(move |command, _, occurrence| {
                if command == "release" && occurrence < times {
                    Answer::Refuse
                } else {
                    Answer::Work
                }
            }),
            ..Rig::default()
        })
    };
    let twice = refused(2);
    assert_eq!(twice.answer().0, "calibration_done");
    assert!(!lock(&twice.world).reserved);
    let (symbol, text) = refused(usize::MAX).answer();
    assert_eq!(symbol, "calibration_done");
    let told = "the manipulator could not be given back: release : refused on purpose";
    assert!(text.contains(told), "{text}");
}

/// A path to the first position of the rig's file, with the end in joint space.
fn given_path() -> Vec<(&'static str, Vec<u8>)> {
    let source = ctos::diagnostic::Source::new("p", positions(1));
    let pose = crate::positions::parse(&source).unwrap()[0].row_major();
    let path = GivenPath {
        base_t_tool: pose,
        target: Target::Pose(pose),
        kind: PathKind::StraightLine,
        speed: 0.3,
    };
    vec![(GIVEN_PATH, postcard::to_stdvec(&path).unwrap())]
}

#[test]
fn a_path_that_was_given_is_validated_and_driven_instead_of_planned() {
    let run = run(&Rig {
        given: given_path(),
        ..Rig::default()
    });
    assert_eq!(run.answer().0, "calibration_done");
    let count = |what: &str| {
        run.firings("motion")
            .iter()
            .filter(|one| *one == what)
            .count()
    };
    assert_eq!(count("validate_path completed"), 1);
    assert_eq!(count("plan_path completed"), 15);
}

#[test]
fn a_given_path_that_fits_no_more_is_planned_anew() {
    let run = run(&Rig {
        given: given_path(),
        script: Arc::new(|command, _, occurrence| match (command, occurrence) {
            ("plan", 0) => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    assert_eq!(run.answer().0, "calibration_done");
    let firings = run.firings("motion");
    let count = |what: &str| firings.iter().filter(|one| *one == what).count();
    assert_eq!(count("validate_path failed"), 1, "{firings:?}");
    assert_eq!(count("plan_path completed"), 16);
    assert_eq!(run.done("move", ""), 16);
}
