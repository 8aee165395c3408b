//! A client in a process of its own that is killed while it has an arm move.

use crate::harness::{CTOS, Run, SCOTT, Scratch};

/// The testbed as two arms, with a second daemon in a process of its own.
const APP: &str = r#"
include = ["testbed-2x9.toml"]

[chassis.desk]
restart = "on-failure"

[task.desk]
handler = "sorma.daemon"
on = "desk"
args.dictionary = ["testbed.dict"]
"#;

/// The numbers of an answer, which must not be an error.
#[track_caller]
fn asked(scratch: &Scratch, line: &str) -> Vec<f64> {
    let ended = scratch.scott(&["testbed", "--json", "-c", line]);
    ended.must_exit_leaving(0);
    let answer = ended.json();
    let floats = answer["floats"].as_array().unwrap().iter();
    floats.map(|float| float.as_f64().unwrap()).collect()
}

/// A request to move the track of an arm's cart on by so much, m.
fn by(object: &str, way: f64) -> String {
    format!("{object} EXEC by FMSG 9 {way} 0 0 0 0 0 0 0 0")
}

#[test]
fn the_arm_of_a_client_that_is_killed_comes_to_rest_and_is_free_and_the_other_arm_goes_on() {
    let scratch = Scratch::new();
    scratch.write("configs/desk.toml", APP);
    let mut run = scratch.start(CTOS, &["boot", "configs/desk.toml"], &[]);
    run.wait_for("phase 3");
    let track = |arm: &str| asked(&scratch, &format!("pino.{arm} EXEC state"))[0];
    let state = || {
        let state = scratch.scott(&["testbed", "-c", "pino.left EXEC state"]);
        state.stdout
    };
    let starts = |object: &str, speed: f64, way: f64| -> Run<'_> {
        asked(&scratch, &format!("{object} CTRL -speed {speed}"));
        scratch.start(SCOTT, &["testbed", "-c", &by(object, way)], &[])
    };
    let begin = ["left", "right"].map(track);
    let left = starts("mvpos.left@desk", 0.05, 1.0);
    let right = starts("mvpos.right", 0.1, 0.4);
    while (track("left") - begin[0]).abs() < 0.01 || (track("right") - begin[1]).abs() < 0.01 {}
    assert!(state().contains("desk"), "{}", state());
    // Nobody else moves it meanwhile.
    let other = scratch.scott(&["testbed", "-c", &by("mvpos.left", 0.1)]);
    other.must_exit_leaving(1).must_say("desk");
    run.kill("desk");
    left.end()
        .must_exit_leaving(5)
        .must_say("chassis `desk` is gone");
    loop {
        let now = state();
        assert!(!now.contains("estopped"), "{now}");
        if now.contains("cold, held by nobody") {
            break;
        }
    }
    let rests = track("left");
    assert!(
        rests > begin[0] && rests < begin[0] + 0.9,
        "{begin:?} {rests}"
    );
    right.end().must_exit_leaving(0);
    let end = track("right");
    assert!((end - begin[1] - 0.4).abs() < 4e-4, "{begin:?} {end}");
    assert!((track("left") - rests).abs() < 4e-4, "it stands");
    // The next one may have it, and then the one before again.
    let after = asked(&scratch, &by("mvpos.left", 0.1));
    assert!((after[0] - rests - 0.1).abs() < 4e-4, "{rests} {after:?}");
    asked(&scratch, "mvpos.left EXEC release");
    run.wait_for("restart  desk is up again");
    let again = asked(&scratch, &by("mvpos.left@desk", -0.1));
    assert!((again[0] - rests).abs() < 8e-4, "{rests} {again:?}");
}
