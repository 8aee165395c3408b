//! Faults of the world and of the machine: the run fails in bounded time and says who, why and what to do.

use std::net::TcpListener;

use crate::harness::{Scratch, VIRTUAL};

/// What progress says at the last position of the file; a run that gives up early never says it.
fn last_position(scratch: &Scratch) -> String {
    let text = scratch.read("configs/positions.csv");
    let rows = text.lines().filter(|line| !line.starts_with('#')).count() - 1;
    format!(" {rows} of {rows}")
}

#[test]
fn a_camera_that_sees_nothing_fails_the_run_and_is_named() {
    let scratch = Scratch::new();
    // Turned up and away from the arm.
    scratch.edit(
        "configs/cell.toml",
        "look_at = [-0.06, 0.03, 0.8]",
        "look_at = [0.49, 3.0, 6.0]",
    );
    let ended = scratch.boot(&[&VIRTUAL[..], &["--json"]].concat());
    ended.must_exit(1).must_not_say(&last_position(&scratch));
    let error = ended.error();
    assert!(error.contains("camera `ceiling_east`"), "{}", ended.told);
    assert!(!error.contains("ceiling_west"), "{}", ended.told);
    // The sky is one grey, as what covers a camera is.
    assert!(error.contains("(covered)"), "{}", ended.told);
    let result = ended.json();
    assert_eq!(result["ok"], false);
    assert!(result["reason"].as_str().unwrap().contains("ceiling_east"));
    assert!(scratch.results().is_empty(), "results of a run that failed");
}

#[test]
fn a_lamp_that_does_not_shine_fails_the_run_and_is_asked_for() {
    let scratch = Scratch::new();
    scratch.edit("configs/cell.toml", "brightness = 80.0", "brightness = 0.0");
    let ended = scratch.boot(&VIRTUAL);
    ended.must_exit(1).must_not_say(&last_position(&scratch));
    let error = ended.error();
    assert!(error.contains("camera `ceiling_"), "{}", ended.told);
    assert!(error.contains("is the lamp on"), "{}", ended.told);
    assert_eq!(ended.stdout, "");
    assert!(scratch.results().is_empty(), "results of a run that failed");
}

#[test]
fn positions_that_one_camera_alone_misses_are_rejected_and_the_others_are_used() {
    let scratch = Scratch::new();
    // The wide view of both cameras is kept; a narrow one loses the rim of the work volume.
    for (from, to) in [("fx = 414.9", "fx = 700.0"), ("fy = 416.3", "fy = 702.0")] {
        scratch.edit("configs/cell.toml", from, to);
    }
    let few = ["--set", "task.operator.args.arguments=[\"enough=20%\"]"];
    let ended = scratch.boot(&[&VIRTUAL[..], &few, &["--json"]].concat());
    let result = ended.must_exit(0).json();
    let rejected: Vec<u64> = result["cameras"]
        .as_array()
        .unwrap()
        .iter()
        .map(|camera| camera["rejected"].as_u64().unwrap())
        .collect();
    let [west, east] = rejected[..] else {
        panic!("{result}");
    };
    assert!(west < east && east > 0, "{result}");
    assert_eq!(result["rejected"], west + east, "{result}");
}

#[test]
fn a_port_in_use_names_the_chassis_the_address_and_what_to_do() {
    for chassis in ["ws1", "cage_vision"] {
        let held = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = held.local_addr().unwrap();
        let scratch = Scratch::short();
        scratch.edit(
            "configs/calibrate.toml",
            &format!("[chassis.{chassis}]"),
            &format!("[chassis.{chassis}]\nlisten = \"{address}\""),
        );
        let ended = scratch.boot(&[]);
        ended
            .must_exit(3)
            .must_say(&format!("chassis `{chassis}` cannot listen on {address}"))
            .must_say("choose another `listen`")
            .must_not_say("phase 1");
        assert!(ended.chassis.is_empty(), "{}", ended.told);
        assert!(scratch.results().is_empty());
    }
}

#[test]
fn a_results_folder_that_cannot_be_written_fails_the_run_and_is_named() {
    let scratch = Scratch::short();
    scratch.write("out", "a file where the folder should be");
    let ended = scratch.boot(&VIRTUAL);
    ended.must_exit(1);
    assert!(ended.error().contains("out/calibrate"), "{}", ended.told);
}
