//! The Dispatcher between stand-ins: what it collects, and what it does when things go wrong.

use std::sync::Arc;

use vss::calibrate::RejectReason;

use super::*;
use crate::rig::{Answer, Rig, Run, lock, positions, run};

fn done(run: &Run) -> Observations {
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_done", "{text}");
    run.object(OBSERVATIONS).unwrap()
}

fn failed(run: &Run) -> String {
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_failed", "{text}");
    text
}

/// Refuses `command` with `detail` at these occurrences.
fn refusing(command: &'static str, detail: &'static str, when: &'static [usize]) -> Rig {
    Rig {
        script: Arc::new(move |asked, with, occurrence| {
            if asked == command && with == detail && when.contains(&occurrence) {
                Answer::Refuse
            } else {
                Answer::Work
            }
        }),
        ..Rig::default()
    }
}

#[test]
fn every_position_gives_every_camera_a_point_and_the_cameras_come_out_true() {
    let run = run(&Rig::default());
    let observations = done(&run);
    assert_eq!((observations.wanted, observations.reached), (16, 16));
    let counts: Vec<_> = observations
        .cameras
        .iter()
        .map(|table| (table.camera.as_str(), table.points.len(), table.missed))
        .collect();
    assert_eq!(counts, [("west", 16, 0), ("east", 16, 0)]);
    let Calibrations { cameras } = run.object(CALIBRATIONS).unwrap();
    let west = crate::rig::camera(nalgebra::Point3::new(-0.5, 0.1, 2.9));
    let error = cameras[0].1.camera.error_against(&west);
    assert!(error.position_m < 1e-6, "{error:?}");
    assert_eq!(lock(&run.world).progress.len(), 16);
}

#[test]
fn a_position_that_the_arm_refuses_is_skipped_and_its_line_and_reason_are_kept() {
    // Every posture of the third position is refused; nobody asks for the other elbows otherwise.
    let run = run(&Rig {
        script: Arc::new(|command, detail, occurrence| match (command, detail) {
            ("plan", "None") if occurrence == 2 => Answer::Refuse,
            ("plan", elbow) if elbow.starts_with("Some") => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let observations = done(&run);
    assert_eq!((observations.wanted, observations.reached), (16, 15));
    assert!(
        observations
            .cameras
            .iter()
            .all(|table| table.points.len() == 15)
    );
    let unused: Vec<_> = observations
        .unused
        .iter()
        .map(|one| (one.line, one.reason.as_str()))
        .collect();
    // Two lines stand above the first position.
    let reason = "position 3 cannot be reached: plan None: refused on purpose";
    assert_eq!(unused, [(5, reason)]);
    assert_eq!(lock(&run.world).progress[2], format!("skipped: {reason}"));
}

#[test]
fn what_is_left_of_an_earlier_position_is_never_paired_with_a_later_one() {
    let out_of_reach = Rig {
        script: Arc::new(|command, detail, occurrence| match (command, detail) {
            ("plan", "None") if occurrence == 5 => Answer::Refuse,
            ("plan", elbow) if elbow.starts_with("Some") => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    };
    for (case, rig) in [
        ("out of reach", out_of_reach),
        ("unseen", refusing("spot_find", "east", &[3, 4, 5])),
    ] {
        let run = run(&rig);
        let observations = done(&run);
        for (_, calibration) in run.object::<Calibrations>(CALIBRATIONS).unwrap().cameras {
            // The stand-in's spots have no noise: a wrong pair would stand out by many pixels.
            assert!(calibration.rms_px < 1e-6, "{case}: {}", calibration.rms_px);
            let outliers: Vec<RejectReason> = calibration
                .rejected
                .iter()
                .map(|point| point.reason)
                .collect();
            assert_eq!(outliers, [], "{case}");
        }
        for table in &observations.cameras {
            assert_eq!(
                table.points.len() as u32 + table.missed,
                observations.reached,
                "{case}"
            );
        }
    }
}

#[test]
fn a_readback_that_fails_ends_the_command_and_skips_nothing() {
    let run = run(&refusing("read_position", "", &[5]));
    let text = failed(&run);
    assert!(
        text.contains("read_position : refused on purpose"),
        "{text}"
    );
    assert_eq!(run.done("move", ""), 6);
}

/// A run in which the first `unreached` positions are out of reach.
fn out_of_reach(unreached: usize, arguments: Vec<&'static str>, results: &std::path::Path) -> Run {
    run(&Rig {
        arguments,
        results: Some(results.to_owned()),
        script: Arc::new(move |command, detail, occurrence| match (command, detail) {
            ("plan", "None") if occurrence < unreached => Answer::Refuse,
            ("plan", elbow) if elbow.starts_with("Some") => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    })
}

#[test]
fn with_fewer_positions_than_are_enough_the_command_fails_and_earlier_results_stay() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("west.yaml"), "old").unwrap();
    for (unreached, enough, well) in [
        (3, vec!["enough=13"], true),
        (4, vec!["enough=13"], false),
        (0, vec!["enough=100%"], true),
        (3, vec!["enough=81%"], true),
        (3, vec!["enough=82%"], false),
        (8, vec![], true),
        (9, vec![], false),
    ] {
        let run = out_of_reach(unreached, enough, folder.path());
        if well {
            done(&run);
            std::fs::write(folder.path().join("west.yaml"), "old").unwrap();
            continue;
        }
        let text = failed(&run);
        let reason = format!(
            "{unreached} times the position was out of reach (the last: position {unreached} cannot be reached"
        );
        assert!(text.contains(&reason), "{text}");
        let kept = std::fs::read_to_string(folder.path().join("west.yaml")).unwrap();
        assert_eq!(kept, "old");
    }
}

#[test]
fn the_reason_that_was_met_most_is_the_one_that_is_told() {
    let run = run(&Rig {
        arguments: vec!["enough=14"],
        script: Arc::new(|command, detail, occurrence| match (command, detail) {
            ("plan", "None") if occurrence == 1 => Answer::Refuse,
            ("plan", elbow) if elbow.starts_with("Some") => Answer::Refuse,
            // Three looks at two positions.
            ("spot_find", "east") if (3..9).contains(&occurrence) => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let text = failed(&run);
    assert!(
        text.contains("camera `east` has seen the lamp at 3 positions, 10 are left and 14 would be enough; 2 times the spot was not seen (the last: spot_find east: refused on purpose)"),
        "{text}"
    );
}

#[test]
fn a_command_that_asks_for_what_cannot_be_fails_before_anything_moves() {
    for (argument, why) in [
        (
            "enough=101%",
            "17 positions are to be enough, and the file has 16",
        ),
        (
            "enough=17",
            "17 positions are to be enough, and the file has 16",
        ),
        (
            "enough=many",
            "`enough=many` is no argument of this command",
        ),
        ("fast", "it takes `enough=N` or `enough=N%`"),
    ] {
        let run = run(&Rig {
            arguments: vec![argument],
            ..Rig::default()
        });
        let text = failed(&run);
        assert!(text.contains(why), "{text}");
        assert_eq!(run.asked("acquire", ""), 0);
    }
}

#[test]
fn what_is_left_of_an_earlier_command_is_not_taken_for_new() {
    // The second command's position with the number at which the first one failed is skipped.
    let run = run(&Rig {
        commands: 2,
        script: Arc::new(|command, detail, occurrence| match (command, detail) {
            // The first command ends at its third position.
            ("spot_find", "west") if occurrence == 2 => Answer::Meet(Outcome::Fault),
            ("plan", "None") if (3..6).contains(&occurrence) => Answer::Refuse,
            ("plan", elbow) if elbow.starts_with("Some") => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let first = run.answers[0].as_ref().unwrap();
    assert_eq!(first.symbol, "calibration_failed", "{}", first.text);
    let observations = done(&run);
    assert_eq!((observations.wanted, observations.reached), (16, 13));
    let lines: Vec<usize> = observations.unused.iter().map(|one| one.line).collect();
    assert_eq!(lines, [3, 4, 5]);
}

#[test]
fn a_blind_camera_is_named_long_before_the_last_position() {
    let run = run(&Rig {
        positions: positions(40),
        script: Arc::new(|command, detail, _| match (command, detail) {
            ("spot_find", "east") => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let text = failed(&run);
    assert!(
        text.contains(
            "camera `east` has seen no spot at 10 positions (spot_find east: refused on purpose)"
        ),
        "{text}"
    );
    assert_eq!(run.done("move", ""), 10);
}

#[test]
fn a_lamp_that_stays_dark_ends_the_command_with_a_hint() {
    let run = run(&Rig {
        script: Arc::new(|command, _, _| match command {
            "spot_find" => Answer::Refuse,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    assert!(failed(&run).contains("is the lamp on"));
}

#[test]
fn an_arm_that_goes_nowhere_ends_the_command_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let text = failed(&out_of_reach(usize::MAX, vec!["enough=4"], folder.path()));
    assert!(
        text.contains("the arm took none of the first 10 positions (position 10 cannot be reached"),
        "{text}"
    );
}

#[test]
fn a_vision_system_that_does_not_answer_ends_the_command_and_is_named() {
    let run = run(&Rig {
        script: Arc::new(|command, detail, _| match (command, detail) {
            ("spot_find", "east") => Answer::Late,
            _ => Answer::Work,
        }),
        ..Rig::default()
    });
    let text = failed(&run);
    assert!(
        text.contains("the vision system has failed: lost: `vsm` did not answer"),
        "{text}"
    );
    assert_eq!(run.done("move", ""), 1);
}

#[test]
fn a_positions_file_that_went_bad_after_the_check_ends_the_command_with_the_place() {
    let run = run(&Rig {
        positions: "x,y,z,roll,pitch,yaw\n1,2,three,0,0,0\n".to_owned(),
        ..Rig::default()
    });
    let text = failed(&run);
    assert!(
        text.contains("positions.csv:2:5: error: `three` is no number"),
        "{text}"
    );
    assert_eq!(run.asked("acquire", ""), 0);
}

#[test]
fn a_positions_file_without_positions_ends_the_command() {
    let run = run(&Rig {
        positions: positions(0),
        ..Rig::default()
    });
    assert!(failed(&run).contains("the file of positions is empty"));
}

#[test]
fn a_calibration_that_is_refused_names_its_camera() {
    let run = run(&refusing("calibrate", "east", &[0]));
    let text = failed(&run);
    assert!(
        text.contains("camera `east`: calibrate east: refused on purpose"),
        "{text}"
    );
}

#[test]
fn results_are_written_named_in_the_answer_and_replaced() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("west.yaml"), "old").unwrap();
    let run = run(&Rig {
        results: Some(folder.path().to_owned()),
        ..Rig::default()
    });
    let (symbol, text) = run.answer();
    assert_eq!(symbol, "calibration_done", "{text}");
    for name in ["west.yaml", "east.yaml", "poses.yaml"] {
        let path = folder.path().join(name);
        assert!(
            text.contains(&format!("written: {}", path.display())),
            "{text}"
        );
        assert!(std::fs::read_to_string(path).unwrap().len() > 100);
    }
}

#[test]
fn results_that_cannot_be_written_fail_the_command_and_leave_the_old_ones() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("west.yaml"), "old").unwrap();
    std::fs::create_dir(folder.path().join("poses.yaml.part")).unwrap();
    let run = run(&Rig {
        results: Some(folder.path().to_owned()),
        ..Rig::default()
    });
    let text = failed(&run);
    assert!(
        text.contains("cannot write") && text.contains("poses.yaml.part"),
        "{text}"
    );
    let kept = std::fs::read_to_string(folder.path().join("west.yaml")).unwrap();
    assert_eq!(kept, "old");
}
