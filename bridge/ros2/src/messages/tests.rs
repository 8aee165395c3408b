//! Known answers of rosbags 0.11.9, an implementation in Python that is not ours.

use super::*;

fn bytes(hex: &str) -> Vec<u8> {
    let digits = hex.as_bytes().chunks(2);
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    digits.map(byte).collect()
}

/// A message is written as rosbags writes it, is read back, and no part of it is read as one.
fn is_written<M: Topic + PartialEq + std::fmt::Debug>(message: &M, hex: &str) {
    let known = bytes(hex);
    assert_eq!(encode(message).unwrap(), known);
    assert_eq!(decode::<M>(&known).unwrap(), *message);
    for end in 0..known.len() {
        assert!(decode::<M>(&known[..end]).is_err(), "{end} bytes of it");
    }
}

fn header() -> Header {
    Header {
        stamp: Time {
            sec: 12,
            nanosec: 34,
        },
        frame_id: "base".to_owned(),
    }
}

#[test]
fn joint_states_are_written_as_rosbags_writes_them() {
    let message = JointState {
        header: header(),
        name: vec!["j1".to_owned(), "joint2".to_owned()],
        position: vec![0.5, -1.0],
        velocity: Vec::new(),
        effort: vec![3.0],
    };
    is_written(
        &message,
        "000100000c0000002200000005000000626173650000000002000000030000006a310000070000006a6f696e74320000\
         02000000000000000000e03f000000000000f0bf00000000010000000000000000000840",
    );
}

#[test]
fn transforms_are_written_as_rosbags_writes_them() {
    let message = TFMessage {
        transforms: vec![TransformStamped {
            header: header(),
            child_frame_id: "arm/tool".to_owned(),
            translation: [1.0, 2.0, 3.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
        }],
    };
    is_written(
        &message,
        "00010000010000000c000000220000000500000062617365000000000900000061726d2f746f6f6c0000000000000000\
         0000f03f0000000000000040000000000000084000000000000000000000000000000000000000000000000000000000\
         0000f03f",
    );
}

#[test]
fn images_are_written_as_rosbags_writes_them() {
    let message = Image {
        header: header(),
        height: 2,
        width: 3,
        encoding: "mono8".to_owned(),
        is_bigendian: 0,
        step: 3,
        data: vec![0, 1, 2, 3, 4, 5].into(),
    };
    is_written(
        &message,
        "000100000c000000220000000500000062617365000000000200000003000000060000006d6f6e6f3800000003000000\
         06000000000102030405",
    );
}

#[test]
fn camera_infos_are_written_as_rosbags_writes_them() {
    let message = CameraInfo {
        header: header(),
        height: 2,
        width: 3,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.0; 5],
        k: std::array::from_fn(|at| at as f64),
        r: std::array::from_fn(|at| at as f64 + 10.0),
        p: std::array::from_fn(|at| at as f64 + 20.0),
        binning_x: 1,
        binning_y: 2,
        roi: RegionOfInterest {
            x_offset: 1,
            y_offset: 2,
            height: 3,
            width: 4,
            do_rectify: true,
        },
    };
    is_written(
        &message,
        "000100000c0000002200000005000000626173650000000002000000030000000a000000706c756d625f626f62000000\
         050000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
         00000000000000000000f03f000000000000004000000000000008400000000000001040000000000000144000000000\
         000018400000000000001c40000000000000204000000000000024400000000000002640000000000000284000000000\
         00002a400000000000002c400000000000002e4000000000000030400000000000003140000000000000324000000000\
         000034400000000000003540000000000000364000000000000037400000000000003840000000000000394000000000\
         00003a400000000000003b400000000000003c400000000000003d400000000000003e400000000000003f4001000000\
         020000000100000002000000030000000400000001",
    );
}

#[test]
fn diagnostics_are_written_as_rosbags_writes_them() {
    let status = |level, name: &str, message: &str, hardware_id: &str, values| DiagnosticStatus {
        level,
        name: name.to_owned(),
        message: message.to_owned(),
        hardware_id: hardware_id.to_owned(),
        values,
    };
    let done = KeyValue {
        key: "done".to_owned(),
        value: "3".to_owned(),
    };
    let message = DiagnosticArray {
        header: header(),
        status: vec![
            status(2, "state", "stopped", "cell", vec![done]),
            status(0, "x", "", "", Vec::new()),
        ],
    };
    is_written(
        &message,
        "000100000c00000022000000050000006261736500000000020000000200000006000000737461746500000008000000\
         73746f70706564000500000063656c6c000000000100000005000000646f6e6500000000020000003300000002000000\
         780000000100000000000000010000000000000000000000",
    );
}

#[test]
fn trajectories_are_read_as_rosbags_writes_them() {
    let message = JointTrajectory {
        header: header(),
        joint_names: vec!["j1".to_owned()],
        points: vec![JointTrajectoryPoint {
            positions: vec![0.25],
            velocities: Vec::new(),
            accelerations: vec![1.0, 2.0],
            effort: Vec::new(),
            time_from_start: Time {
                sec: 1,
                nanosec: 500_000_000,
            },
        }],
    };
    is_written(
        &message,
        "000100000c0000002200000005000000626173650000000001000000030000006a310000010000000100000000000000\
         0000d03f0000000002000000000000000000f03f000000000000004000000000010000000065cd1d",
    );
}

// Captured with rmw_zenoh's layout: a request has one byte, for a message without fields has one.
#[test]
fn a_trigger_is_read_and_answered() {
    decode::<TriggerRequest>(&[0, 1, 0, 0, 0]).unwrap();
    let response = TriggerResponse {
        success: true,
        message: "ok".to_owned(),
    };
    assert_eq!(
        encode(&response).unwrap(),
        bytes("0001000001000000030000006f6b00")
    );
}

#[test]
fn a_length_that_is_not_there_is_an_error_and_reserves_nothing() {
    let trajectory = encode(&JointTrajectory::default()).unwrap();
    // Behind the header stand time, length of the frame, its end, then the count of names.
    for at in (4..trajectory.len() - 3).step_by(4) {
        let mut huge = trajectory.clone();
        huge[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        if let Ok(read) = decode::<JointTrajectory>(&huge) {
            assert!(read.joint_names.is_empty() && read.points.is_empty());
        }
    }
    for strange in [
        &[][..],
        &[0, 1],
        &[9, 9, 0, 0, 1, 2, 3],
        &[0, 2, 0, 0, 0, 0, 0, 0],
    ] {
        let read = decode::<JointTrajectory>(strange);
        assert!(matches!(read, Err(Unreadable::Header(_))), "{strange:?}");
    }
    assert!(matches!(
        decode::<JointTrajectory>(&vec![0; MOST_BYTES + 1]),
        Err(Unreadable::Large(_))
    ));
}
