//! Slots that are commanded by position or speed, and not by torque.

use super::*;
use crate::driver::{Drives, Mode};
use crate::servo::stream::{Following, Newest, Source, Stream, StreamKind};

fn rig(modes: &[Mode]) -> Rig {
    let model = Arc::new(built_in_arm("puma560"));
    let knobs = Arc::new(Knobs::default());
    let arm = TestArm::new(built_in_arm("puma560"), &START, false, &knobs);
    let drives = Drives::new(Box::new(arm), modes, Arc::clone(&model), 8.0).unwrap();
    let law = Box::new(pid());
    let (servo, port) = Servo::new(
        Arc::clone(&model),
        Box::new(drives),
        law,
        ServoConfig::default(),
    )
    .unwrap();
    let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
    Rig {
        servo,
        port,
        planner,
        knobs,
    }
}

#[test]
fn drives_that_take_positions_or_speeds_or_some_of_each_are_moved_by_the_same_segments() {
    use Mode::{Position, Torque, Velocity};
    let mixed = [Position, Velocity, Torque, Position, Velocity, Torque];
    for modes in [&[Position][..], &[Velocity], &[Torque], &mixed] {
        let mut rig = rig(modes);
        rig.release();
        let segment = rig.plan(0.5);
        rig.start(segment);
        let motion = rig.run_to_end();
        assert_eq!(
            motion.phase,
            MotionPhase::Done,
            "{modes:?}: {:?}",
            rig.port.status()
        );
        assert!(
            motion.max_tracking_error.turning < 4e-3,
            "{modes:?}: {motion:?}"
        );
        // What a drive gives by itself is not known.
        let status = rig.port.status();
        for (torque, mode) in status.torque.iter().zip(rig.servo.driver.modes()) {
            assert!(*mode == Mode::Torque || *torque == 0.0);
        }
        rig.order(ServoCommand::PowerOff);
        while rig.port.status().power != Power::Off {
            rig.servo.tick(0);
        }
        // After brakes it begins where it stands.
        rig.release();
        assert!(distance(&rig.port.status().setpoint, &rig.port.status().position) < 1e-9);
    }
}

#[test]
fn torques_are_streamed_to_slots_that_take_them_and_to_no_others() {
    struct Nothing;
    impl Source for Nothing {
        fn newest(&mut self) -> Option<Newest<'_>> {
            None
        }
    }
    let mut rig = rig(&[Mode::Position]);
    rig.release();
    for (serial, kind) in [
        (1, StreamKind::Torques { gravity: true }),
        (2, StreamKind::Joints),
    ] {
        let how = Following {
            serial,
            kind,
            max_age: 0.1,
            pace: (1.0, 1.0),
            guards: GuardSet::default(),
        };
        let stream = Stream::new(how, Box::new(Nothing), rig.planner.model());
        rig.port.stream(Box::new(stream)).unwrap();
        rig.servo.tick(0);
    }
    let status = rig.port.status();
    assert_eq!(status.stream_rejected, Some((1, Rejection::NoTorque)));
    assert_eq!(status.stream.serial, 2);
}

#[test]
fn modes_are_one_for_all_slots_or_one_for_each() {
    assert_eq!(
        Mode::for_slots(&[Mode::Position], 3),
        Some(vec![Mode::Position; 3])
    );
    assert_eq!(
        Mode::for_slots(&[Mode::Position; 3], 3),
        Some(vec![Mode::Position; 3])
    );
    assert_eq!(Mode::for_slots(&[Mode::Position; 2], 3), None);
    assert_eq!(Mode::for_slots(&[], 3), None);
}
