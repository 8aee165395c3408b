//! Apps as nodes of ROS 2 see them: by `eclipse-zenoh` and `rosbags`, which are not ours.

use std::{net::TcpListener, path::Path};

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{CTOS, Run, Scratch};

/// An arm that nobody holds, with the topics and services of the calibration.
const ARM: &str = r#"
[app]
name = "arm"

[chassis.cage]
stop_first = true
processors.servo = { realtime = true, priority = 80 }
processors.main = {}

[chassis.ros2]
restart = "on-failure"

[task.world]
handler = "sim.world"
on = "cage/servo"
args = { cell = "cell.toml", period_ms = 4.5 }

[task.servo]
handler = "mcs.servo"
on = "cage/servo"
args = { driver = "sim.arm", driver_args = { world = "world", arm = "puma" }, period_ms = 4.5, model = "puma560", law = "pid" }

[task.state]
handler = "mcs.state"
on = "cage/main"
args.servo = "servo"

[task.planner]
handler = "mcs.planner"
on = "cage/main"
args.servo = "servo"

[task.mcs]
handler = "mcs.client"
on = "cage/main"
args = { servo = "servo", state = "state", planner = "planner" }

[bridge.ros2]
on = "ros2"

[bridge.ros2.take]
"arm/joint_trajectory" = { task = "mcs", speed = 0.5 }

[bridge.ros2.serve]
"arm/stop" = { task = "mcs", command = "stop_motion" }
"arm/status" = { task = "mcs", command = "status" }
"arm/reset" = { task = "mcs", command = "reset" }
"#;

const CONTROL: &str = "bridge.ros2.allow_control=true";

/// A port that nobody has at the moment.
fn free_port() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    listener.local_addr().unwrap().port()
}

/// Boots an app whose bridge is the router of all nodes at `port`.
fn up<'a>(scratch: &'a Scratch, app: &str, port: u16, more: &[&str]) -> Run<'a> {
    let listen = format!("bridge.ros2.listen=[\"tcp/127.0.0.1:{port}\"]");
    let mut arguments = vec!["boot", app, "--set", &listen];
    for set in more {
        arguments.extend(["--set", set]);
    }
    let mut run = scratch.start(CTOS, &arguments, &[]);
    run.wait_for("the network of ROS is there");
    run
}

fn start<'a>(scratch: &'a Scratch, port: u16, work: &[&str]) -> Run<'a> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("system/ros2/peer.py");
    let python = std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let (script, port) = (script.to_str().unwrap(), port.to_string());
    let arguments = [&[&python, script, &port][..], work].concat();
    // A Python finds its packages by the name that it is started with.
    scratch.start("/usr/bin/env", &arguments, &[])
}

/// What a node of ROS 2 finds that does this work.
fn peer(scratch: &Scratch, port: u16, work: &[&str]) -> Value {
    let ended = start(scratch, port, work).end();
    ended.must_exit_leaving(0);
    ended.json()
}

fn stopped(run: Run<'_>) {
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

fn texts(value: &Value) -> Vec<&str> {
    let all = value.as_array().unwrap().iter();
    all.map(|one| one.as_str().unwrap()).collect()
}

#[test]
#[ignore = "needs the Python packages eclipse-zenoh, rosbags and xxhash: CTOS_PYTHON names a Python that has them"]
fn a_node_of_ros_reads_joints_frames_pictures_and_diagnostics_of_the_calibration() {
    let (scratch, port) = (Scratch::new(), free_port());
    let run = up(&scratch, "configs/calibrate-ros2.toml", port, &[]);
    let found = peer(&scratch, port, &["look"]);
    assert_eq!(texts(&found["node"]), ["NN calibrate_ros2"]);
    let tokens = texts(&found["tokens"]);
    for token in [
        "MS /arm/joint_trajectory",
        "SS /arm/stop",
        "MP /ceiling_east/image_raw",
    ] {
        assert!(tokens.contains(&token), "{token}: {tokens:?}");
    }
    let joints = texts(&found["joints"]);
    assert_eq!(joints.len(), 6, "{found}");
    assert!(found["age_s"].as_f64().unwrap() < 30.0, "{found}");
    let frames = found["frames"].as_array().unwrap();
    assert!(frames.len() >= 7, "{found}");
    assert!(frames.iter().all(|frame| frame[0] == "world"), "{found}");
    let norms = found["norms"].as_array().unwrap().iter();
    for norm in norms {
        assert!((norm.as_f64().unwrap() - 1.0).abs() < 1e-6);
    }
    let image = found["image"].as_array().unwrap();
    let [width, height, step, size] = [0, 1, 2, 3].map(|at| image[at].as_u64().unwrap());
    assert_eq!(
        (step, size, image[4].as_str()),
        (width, width * height, Some("mono8"))
    );
    assert!(
        image[5].as_f64().unwrap() > 50.0,
        "the lamp is bright: {found}"
    );
    let said = found["said"].as_object().unwrap();
    assert!(said.contains_key("state"), "{found}");
    assert!(
        said["calibrate_ros2: bridge to ROS 2"]
            .as_str()
            .unwrap()
            .contains("other ROS nodes")
    );
    // Looking is free, ordering is not.
    let found = peer(&scratch, port, &["refused"]);
    assert_eq!(found["call"]["success"], false, "{found}");
    assert!(
        found["call"]["message"]
            .as_str()
            .unwrap()
            .contains("allow_control")
    );
    // The arm and its task have not noticed that the bridge died, and it comes back.
    let mut run = run;
    run.kill("ros2");
    run.wait_for("ros2 is up again");
    peer(&scratch, port, &["hear"]);
    stopped(run);
}

#[test]
#[ignore = "needs the Python packages eclipse-zenoh, rosbags and xxhash: CTOS_PYTHON names a Python that has them"]
fn a_camera_that_was_computed_has_a_camera_info() {
    let (scratch, port) = (Scratch::short(), free_port());
    // Nobody ends it when the cameras are known.
    let sets = ["app.until=\"dom\""];
    let run = up(&scratch, "configs/calibrate-ros2.toml", port, &sets);
    let found = peer(&scratch, port, &["look", "lens"]);
    let lens: Vec<f64> = serde_json::from_value(found["lens"].clone()).unwrap();
    let [width, height, fx, _, cx, _, fy, cy, ..] = lens[..] else {
        panic!("{found}");
    };
    assert_eq!(
        (width, height),
        (
            found["image"][0].as_f64().unwrap(),
            found["image"][1].as_f64().unwrap()
        )
    );
    assert!(
        fx > width / 2.0 && fy > width / 2.0 && (fx / fy - 1.0).abs() < 0.05,
        "{found}"
    );
    assert!(
        (cx / width - 0.5).abs() < 0.1 && (cy / height - 0.5).abs() < 0.1,
        "{found}"
    );
    assert_eq!(lens[2..5], lens[11..14], "K and P agree");
    stopped(run);
}

#[test]
#[ignore = "needs the Python packages eclipse-zenoh, rosbags and xxhash: CTOS_PYTHON names a Python that has them"]
fn a_trajectory_moves_the_arm_and_triggers_ask_its_task() {
    let (scratch, port) = (Scratch::new(), free_port());
    scratch.write("configs/arm.toml", ARM);
    let run = up(&scratch, "configs/arm.toml", port, &[CONTROL]);
    let found = peer(&scratch, port, &["move"]);
    let calls = found["calls"].as_array().unwrap();
    let success: Vec<_> = calls.iter().map(|call| call["success"] == true).collect();
    assert_eq!(success, [true, true, false], "{found}");
    assert!(
        calls[0]["message"]
            .as_str()
            .unwrap()
            .contains("\"holder\":null"),
        "released: {found}"
    );
    let refused = calls[2]["message"].as_str().unwrap();
    assert!(refused.contains("cold state"), "{found}");
    assert_eq!(found["peers"], "1");
    stopped(run);
}

#[test]
#[ignore = "needs the Python packages eclipse-zenoh, rosbags and xxhash: CTOS_PYTHON names a Python that has them"]
fn rubbish_from_ros_is_told_and_the_next_trajectory_is_passed() {
    let (scratch, port) = (Scratch::new(), free_port());
    scratch.write("configs/arm.toml", ARM);
    let run = up(&scratch, "configs/arm.toml", port, &[CONTROL]);
    let found = peer(&scratch, port, &["harm"]);
    assert_eq!(found["calls"][0]["success"], false, "{found}");
    assert_eq!(found["calls"][1]["success"], true, "{found}");
    let status = scratch.ctos(&["status", "ros2"]);
    status.must_exit_leaving(0);
    let told = &status.stdout;
    assert!(told.contains("node `peer` means by it"), "{told}");
    stopped(run);
}

#[test]
#[ignore = "needs the Python packages eclipse-zenoh, rosbags and xxhash: CTOS_PYTHON names a Python that has them"]
fn a_network_that_is_not_there_yet_and_goes_away_is_told_and_joined_again() {
    let (scratch, port) = (Scratch::new(), free_port());
    scratch.write("configs/arm.toml", ARM);
    let connect = format!("bridge.ros2.connect=[\"tcp/127.0.0.1:{port}\"]");
    let mut run = scratch.start(CTOS, &["boot", "configs/arm.toml", "--set", &connect], &[]);
    run.wait_for("the network of ROS is not there");
    for _ in 0..2 {
        // The router is another program, which ends when it has heard enough.
        peer(&scratch, port, &["hear", "as-router"]);
        run.wait_for("the network of ROS is there");
        run.wait_for("the network of ROS is not there");
    }
    stopped(run);
}

#[test]
fn what_is_wrong_with_a_bridge_is_found_before_anything_starts() {
    let scratch = Scratch::new();
    scratch.write("configs/arm.toml", ARM);
    let check = |sets: &[&str], says: &str| {
        let mut arguments = vec!["check", "configs/arm.toml"];
        for set in sets {
            arguments.extend(["--set", set]);
        }
        let ended = scratch.ctos(&arguments);
        ended.must_say(says);
    };
    check(&[], "nothing found");
    for (set, says) in [
        ("bridge.ros2.domain=300", "domain 300"),
        ("bridge.ros2.node=\"a b\"", "no name of a node"),
        (
            "bridge.ros2.listen=[\"tcp/0.0.0.0:7447\"]",
            "bridge::ros2::open",
        ),
        (
            "bridge.ros2.connect=[\"tls/10.0.0.5:7447\"]",
            "ctos::config::no_keys",
        ),
        (
            "bridge.ros2.connect=[\"udp/127.0.0.1:1\"]",
            "is not an endpoint",
        ),
        ("bridge.ros2.connect=[]", "neither a router"),
        (
            "bridge.ros2={ listen = [\"tcp/127.0.0.1:0\"], connect = [] }",
            "`connect` has no effect",
        ),
        (CONTROL, "bridge::ros2::control"),
        (
            "bridge.ros2.publish={ \"a b\" = { joints = [\"state\"] } }",
            "no name that ROS takes",
        ),
        (
            "bridge.ros2.publish={ a = { joints = [\"stat\"] } }",
            "bridge::ros2::no_source",
        ),
        (
            "bridge.ros2.take={ a = { task = \"mc\" } }",
            "bridge::ros2::no_task",
        ),
        (
            "bridge.ros2.take={ a = { task = \"mcs\", speed = 2.0 } }",
            "fraction of full speed",
        ),
        (
            "bridge.ros2.take={ a = { task = \"state\" } }",
            "bridge::ros2::no_command",
        ),
        (
            "bridge.ros2.serve={ a = { task = \"mcs\", command = \"set_control\" } }",
            "bridge::ros2::fields",
        ),
        ("bridge.ros3={}", "ros3"),
    ] {
        check(&[set], says);
    }
}
