//! The testbed: eighteen joints in one simulated world, and their partition into manipulators by configuration.

use crate::harness::{CTOS, Run, SCOTT, Scratch};

const THREE_TIMES_SIX: &str = "configs/testbed.toml";
const TWO_TIMES_NINE: &str = "configs/testbed-2x9.toml";
const ONE_TIMES_EIGHTEEN: &str = "configs/testbed-1x18.toml";
const WITHOUT_COLLISIONS: &str = "configs/testbed-collision.toml";

fn up<'a>(scratch: &'a Scratch, partition: &str) -> Run<'a> {
    let mut run = scratch.start(CTOS, &["boot", partition], &[]);
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
fn by(arm: &str, joints: &[f64]) -> String {
    let numbers: Vec<String> = joints.iter().map(f64::to_string).collect();
    let (count, numbers) = (joints.len(), numbers.join(" "));
    format!("mvpos.{arm} EXEC by FMSG {count} {numbers}")
}

/// Moves all manipulators at once, each by its way, and holds that every joint arrives.
#[track_caller]
fn all_move(scratch: &Scratch, ways: &[(&str, &[f64])]) {
    let start = |arm: &str| asked(scratch, &format!("pino.{arm} EXEC state"));
    let starts: Vec<Vec<f64>> = ways.iter().map(|(arm, _)| start(arm)).collect();
    let under_way: Vec<Run<'_>> = ways
        .iter()
        .map(|(arm, way)| {
            let line = by(arm, way);
            scratch.start(SCOTT, &["testbed", "--json", "-c", &line], &[])
        })
        .collect();
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
fn three_programs_of_six_joints_move_at_once_in_one_world() {
    let scratch = Scratch::new();
    let _run = up(&scratch, THREE_TIMES_SIX);
    let ways: [(&str, &[f64]); 3] = [
        ("left", &[0.5, 0.0, 0.0, 0.0, 0.0, 0.2]),
        ("right", &[0.0, 0.3, 0.0, 0.0, 0.3, 0.0]),
        ("carts", &[0.3, 0.0, 0.05, -0.2, 0.4, 0.0]),
    ];
    all_move(&scratch, &ways);
}

#[test]
fn two_manipulators_of_nine_joints_move_at_once_in_one_world() {
    let scratch = Scratch::new();
    let _run = up(&scratch, TWO_TIMES_NINE);
    let ways: [(&str, &[f64]); 2] = [
        ("left", &[0.3, 0.0, 0.1, 0.5, 0.0, 0.0, 0.0, 0.0, 0.2]),
        ("right", &[-0.2, 0.4, 0.0, 0.0, 0.3, 0.0, 0.0, 0.3, 0.0]),
    ];
    all_move(&scratch, &ways);
}

#[test]
fn one_manipulator_of_eighteen_joints_moves_both_arms() {
    let scratch = Scratch::new();
    let _run = up(&scratch, ONE_TIMES_EIGHTEEN);
    let way = [
        0.3, 0.0, 0.1, 0.5, 0.0, 0.0, 0.0, 0.0, 0.2, -0.2, 0.4, 0.0, 0.0, 0.3, 0.0, 0.0, 0.3, 0.0,
    ];
    all_move(&scratch, &[("both", &way)]);
}

#[test]
fn two_programs_that_want_one_joint_are_refused_by_name_before_anything_starts() {
    let scratch = Scratch::new();
    let text = scratch.read(TWO_TIMES_NINE);
    let text = text.replace(
        "{ arm = \"right\" }",
        "{ arm = \"left\", joints = [\"cart.tilt\"] }",
    );
    scratch.write("configs/greedy.toml", text);
    let checked = scratch.ctos(&["check", "configs/greedy.toml"]);
    let wanted = "joint `cart.tilt` of arm `left` is driven by task `servo_left` already";
    checked
        .must_exit(3)
        .must_say(wanted)
        .must_say("greedy.toml:");
}

#[test]
fn an_emergency_stop_of_one_manipulator_leaves_the_other_one_alone() {
    let scratch = Scratch::new();
    let _run = up(&scratch, TWO_TIMES_NINE);
    let position = |arm: &str| asked(&scratch, &format!("pino.{arm} EXEC state"))[..9].to_vec();
    asked(&scratch, "mvpos.left CTRL -speed 0.05");
    let far = by("left", &[1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let moving = scratch.start(SCOTT, &["testbed", "-c", &far], &[]);
    while position("left")[0] < 0.01 {}
    asked(&scratch, "pino.left EXEC estop");
    moving.end().must_exit_leaving(1).must_say("emergency stop");
    let stopped = position("left");
    assert!(stopped[0] < 1.0, "{stopped:?}");
    let way = [0.1, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0];
    let before = position("right");
    let after = asked(&scratch, &by("right", &way));
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
fn every_partition_has_teach_pendants_of_its_own_arms() {
    let scratch = Scratch::new();
    for partition in [THREE_TIMES_SIX, TWO_TIMES_NINE, ONE_TIMES_EIGHTEEN] {
        let checked = scratch.ctos(&["check", partition, "--profile", "panel"]);
        checked.must_exit(0);
    }
}

#[test]
fn what_every_tick_leaves_is_in_a_snapshot_buffer_on_request() {
    let scratch = Scratch::new();
    let _run = up(&scratch, TWO_TIMES_NINE);
    asked(&scratch, "pino.left CTRL -records left_arm");
    asked(&scratch, "pino.left EXEC records");
    let way = [0.1, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0];
    let end = asked(&scratch, &by("left", &way));
    // Positions, velocities, setpoints and torques of nine joints; number, stamp and age in IMSG.
    let record = scratch.scott(&["testbed", "--json", "-c", "shmem_r.left_arm EXEC"]);
    record.must_exit_leaving(0);
    let record = record.json();
    let floats = record["floats"].as_array().unwrap();
    assert_eq!(floats.len(), 4 * 9, "{record}");
    for (joint, end) in end[..9].iter().enumerate() {
        let found = floats[joint].as_f64().unwrap();
        assert!(
            (found - end).abs() < 4e-4,
            "joint {joint}: {found}, not {end}"
        );
    }
    let count = record["ints"][0].as_i64().unwrap();
    assert!(
        count > 100,
        "a record for every tick of the motion, not {count}"
    );
    // Without a name it ends, and the buffer is gone with its writer.
    asked(&scratch, "pino.left CTRL -records \"\"");
    asked(&scratch, "pino.left EXEC records");
    let gone = scratch.scott(&["testbed", "-c", "shmem_r.left_arm EXEC status"]);
    gone.must_not_say("alive");
    // It can begin again.
    asked(&scratch, "pino.left CTRL -records left_arm");
    asked(&scratch, "pino.left EXEC records");
    assert_eq!(asked(&scratch, "shmem_r.left_arm EXEC").len(), 4 * 9);
}

#[test]
fn setpoints_and_torques_are_streamed_to_one_manipulator_by_name_and_to_its_owner_only() {
    let scratch = Scratch::new();
    let _run = up(&scratch, TWO_TIMES_NINE);
    let early = scratch.scott(&["testbed", "-c", "setpoint.left EXEC begin"]);
    early
        .must_exit_leaving(1)
        .must_say("acquire the manipulator first");
    let start = asked(&scratch, "pino.left EXEC state")[..9].to_vec();
    let other = asked(&scratch, "pino.right EXEC state")[..9].to_vec();
    asked(&scratch, "setpoint.left EXEC acquire");
    asked(&scratch, "setpoint.left CTRL -age 30 -speed 0.5");
    asked(&scratch, "setpoint.left EXEC begin");
    let way = [0.05, 0.0, 0.02, 0.2, 0.0, 0.0, 0.0, 0.0, 0.1];
    let goal: Vec<String> = start
        .iter()
        .zip(way)
        .map(|(at, by)| (at + by).to_string())
        .collect();
    asked(
        &scratch,
        &format!("setpoint.left EXEC FMSG 9 {}", goal.join(" ")),
    );
    let there = || {
        let now = asked(&scratch, "pino.left EXEC state");
        (0..9).all(|joint| (now[joint] - start[joint] - way[joint]).abs() < 1e-3)
    };
    while !there() {}
    // The other arm is nobody's, and no motion comes between.
    let busy = scratch.scott(&["testbed", "-c", &by("left", &way)]);
    busy.must_exit_leaving(1);
    let other_way = scratch.scott(&["testbed", "-c", "torque.right EXEC begin"]);
    other_way
        .must_exit_leaving(1)
        .must_say("acquire the manipulator first");
    let few = scratch.scott(&["testbed", "-c", "setpoint.left EXEC FMSG 2 0 0"]);
    few.must_exit_leaving(1)
        .must_say("a value has 2 numbers and not 9 or 18");
    asked(&scratch, "setpoint.left EXEC release");
    let state = scratch.scott(&["testbed", "-c", "setpoint.left EXEC state"]);
    state.must_exit_leaving(0);
    assert!(
        state.stdout.contains("the arm follows no more"),
        "{}",
        state.told
    );
    let later = asked(&scratch, "pino.right EXEC state");
    for (before, after) in other.iter().zip(&later) {
        assert!((before - after).abs() < 4e-4, "{other:?} {later:?}");
    }
}

#[test]
fn two_arms_that_are_sent_into_one_another_stop_before_they_touch_and_can_part_again() {
    let scratch = Scratch::new();
    let _run = up(&scratch, WITHOUT_COLLISIONS);
    // Each turns its arm towards the other and stretches it out.
    let ways = [
        ("left", [0.0, 0.0, 0.0, 1.5, -0.7, 0.0, 0.0, 0.0, 0.0]),
        ("right", [0.0, 0.0, 0.0, -1.1, -0.7, 0.0, 0.0, 0.0, 0.0]),
    ];
    let under_way = ways.map(|(arm, way)| {
        let line = by(arm, &way);
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
    let left = |model: &str| {
        format!("model = \"{model}\", driver = \"sim.arm\", driver_args = {{ arm = \"left\" }}")
    };
    let model = |model: &str| format!("model = \"{model}\"");
    for (partition, fits, misfits, (slots, errors)) in [
        (
            THREE_TIMES_SIX,
            model("models/carts.toml"),
            model("testbed9"),
            // It has no frames either, on which the arms stand.
            ("6 slots", "3 errors"),
        ),
        (
            TWO_TIMES_NINE,
            left("testbed9"),
            left("puma560"),
            ("9 slots", "1 error"),
        ),
        (
            ONE_TIMES_EIGHTEEN,
            model("testbed18"),
            model("testbed9"),
            ("18 slots", "1 error"),
        ),
    ] {
        scratch.edit(partition, &fits, &misfits);
        let checked = scratch.ctos(&["check", partition]);
        checked.must_exit(3).must_say(slots).must_say(errors);
        scratch.edit(partition, &misfits, &fits);
    }
}
