//! The testbed: two manipulators of nine joints in one simulated world, each with a servo of its own.

use crate::harness::{CTOS, Run, SCOTT, Scratch};

fn up(scratch: &Scratch) -> Run<'_> {
    up_with(scratch, "configs/testbed.toml")
}

fn up_with<'s>(scratch: &'s Scratch, config: &str) -> Run<'s> {
    let mut run = scratch.start(CTOS, &["boot", config], &[]);
    run.wait_for("phase 3");
    run
}

/// The numbers of an answer, which must not be an error.
#[track_caller]
fn asked(scratch: &Scratch, line: &str) -> Vec<f64> {
    let ended = scratch.scott(&["testbed", "--json", "-c", line]);
    ended.must_exit_leaving(0);
    let answer = ended.json();
    let floats = answer["floats"].as_array().unwrap();
    floats.iter().map(|float| float.as_f64().unwrap()).collect()
}

/// A request to move `arm` on by so much, m and rad.
fn by(arm: &str, joints: [f64; 9]) -> String {
    let joints = joints.map(|joint| joint.to_string()).join(" ");
    format!("mvpos.{arm} EXEC by FMSG 9 {joints}")
}

#[test]
fn two_manipulators_of_nine_joints_move_at_once_in_one_world() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    let start = |arm: &str| asked(&scratch, &format!("mvpos.{arm} EXEC where"))[..9].to_vec();
    let ways = [
        ("left", [0.3, 0.0, 0.1, 0.5, 0.0, 0.0, 0.0, 0.0, 0.2]),
        ("right", [-0.2, 0.4, 0.0, 0.0, 0.3, 0.0, 0.0, 0.3, 0.0]),
    ];
    let starts = ways.map(|(arm, _)| start(arm));
    let under_way = ways.map(|(arm, way)| {
        let line = by(arm, way);
        scratch.start(SCOTT, &["testbed", "--json", "-c", &line], &[])
    });
    for (run, ((arm, way), start)) in under_way.into_iter().zip(ways.iter().zip(&starts)) {
        let ended = run.end();
        ended.must_exit_leaving(0);
        let answer = ended.json();
        for (joint, (way, start)) in way.iter().zip(start).enumerate() {
            let found = answer["floats"][joint].as_f64().unwrap();
            // Twice what a motion may be off when it counts as settled.
            let off = (found - start - way).abs();
            assert!(off < 4e-4, "{arm}, joint {joint}: {off}");
        }
    }
}

#[test]
fn an_emergency_stop_of_one_manipulator_leaves_the_other_one_alone() {
    let scratch = Scratch::new();
    let _run = up(&scratch);
    let position = |arm: &str| asked(&scratch, &format!("pino.{arm} EXEC state"))[..9].to_vec();
    asked(&scratch, "mvpos.left CTRL -speed 0.05");
    let far = by("left", [1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let moving = scratch.start(SCOTT, &["testbed", "-c", &far], &[]);
    while position("left")[0] < 0.01 {}
    asked(&scratch, "pino.left EXEC estop");
    moving.end().must_exit_leaving(1).must_say("emergency stop");
    let stopped = position("left");
    assert!(stopped[0] < 1.0, "{stopped:?}");
    let way = [0.1, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0];
    let before = position("right");
    let after = asked(&scratch, &by("right", way));
    assert!((after[0] - before[0] - 0.1).abs() < 4e-4, "{after:?}");
    // No motion without a reset, and what stood still has stood still meanwhile.
    let refused = scratch.scott(&["testbed", "-c", &far]);
    refused.must_exit_leaving(1).must_say("reset it");
    let later = position("left");
    for (before, after) in stopped.iter().zip(&later).skip(1) {
        assert!((before - after).abs() < 2e-4, "{stopped:?} {later:?}");
    }
    assert!(
        (later[0] - stopped[0]).abs() < 0.05,
        "{stopped:?} {later:?}"
    );
}

#[test]
fn two_arms_that_are_sent_into_one_another_stop_before_they_touch_and_can_part_again() {
    let scratch = Scratch::new();
    let _run = up_with(&scratch, "configs/testbed-collision.toml");
    // Each turns its arm towards the other and stretches it out.
    let ways = [
        ("left", [0.0, 0.0, 0.0, 1.5, -0.7, 0.0, 0.0, 0.0, 0.0]),
        ("right", [0.0, 0.0, 0.0, -1.1, -0.7, 0.0, 0.0, 0.0, 0.0]),
    ];
    let under_way = ways.map(|(arm, way)| {
        let line = by(arm, way);
        scratch.start(SCOTT, &["testbed", "-c", &line], &[])
    });
    let told = under_way.map(|run| run.end().told);
    let by_guard = |told: &String| told.contains("guard `collision` ended it: ");
    assert!(told.iter().any(by_guard), "{told:?}");
    // Back the way they came, one after the other.
    let start = [0.0, 0.0, 0.0, 0.0, 0.785, -1.571, 0.0, 0.785, 0.0];
    for (arm, _) in ways {
        let joints = start.map(|joint| joint.to_string()).join(" ");
        asked(
            &scratch,
            &format!("mvpos.{arm} EXEC joints FMSG 9 {joints}"),
        );
    }
}

#[test]
fn a_model_with_other_joints_than_its_driver_has_slots_is_found_before_anything_starts() {
    let scratch = Scratch::new();
    let other = "task.servo_left.args.model=\"puma560\"";
    let checked = scratch.ctos(&["check", "configs/testbed.toml", "--set", other]);
    checked.must_exit(3).must_say("9 slots").must_say("1 error");
}
