//! The planner on random and on awkward targets.

use super::*;
use nalgebra::Translation3;
use proptest::prelude::*;

const READY: Joints = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];

fn planner() -> Planner {
    let tool = Isometry3::translation(0.0, 0.0, 0.1);
    Planner::new(
        Arc::new(ArmModel::puma560()),
        tool,
        CartesianLimits::default(),
        0.018,
    )
}

fn within_limits() -> impl Strategy<Value = Joints> {
    prop::array::uniform6(0.0..=1.0_f64).prop_map(|shares| {
        let limits = ArmModel::puma560().limits;
        std::array::from_fn(|i| limits[i].lower + shares[i] * (limits[i].upper - limits[i].lower))
    })
}

proptest! {
    #[test]
    fn joint_motion_keeps_every_limit_and_ends_exactly(
        start in within_limits(), end in within_limits(), speed in 0.01..=1.0_f64,
    ) {
        let planner = planner();
        let segment = planner.joint(&start, &end, speed).unwrap();
        for step in 0..=200_u32 {
            let t = segment.duration() * f64::from(step) / 200.0;
            let setpoint = segment.at(t, &start).unwrap();
            for index in 0..DOF {
                let limit = &planner.model().limits[index];
                prop_assert!(setpoint.velocity[index].abs() <= speed * limit.velocity + 1e-9);
                prop_assert!(setpoint.acceleration[index].abs() <= speed * limit.acceleration + 1e-9);
            }
        }
        prop_assert_eq!(segment.at(0.0, &start).unwrap().position, start);
        prop_assert_eq!(segment.end(&start).unwrap(), end);
    }

    #[test]
    fn a_stop_from_anywhere_stays_on_the_path_and_within_limits(
        start in within_limits(), end in within_limits(), share in 0.0..1.0_f64, speed in 0.05..=1.0_f64,
    ) {
        let planner = planner();
        let segment = planner.joint(&start, &end, speed).unwrap();
        let t = share * segment.duration();
        let before = segment.at(t, &start).unwrap();
        let stop = segment.braked_at(t);
        let first = stop.at(0.0, &start).unwrap();
        for index in 0..DOF {
            prop_assert!((before.position[index] - first.position[index]).abs() < 1e-9);
            prop_assert!((before.velocity[index] - first.velocity[index]).abs() < 1e-9);
            let limit = &planner.model().limits[index];
            prop_assert!(first.acceleration[index].abs() <= limit.acceleration * (1.0 + 1e-6));
        }
        prop_assert!(stop.profile().end() <= 1.0 + 1e-12);
        let rest = stop.at(stop.duration(), &start).unwrap();
        prop_assert_eq!(rest.velocity, [0.0; DOF]);
    }
}

#[test]
fn the_slowest_joint_sets_the_time() {
    let planner = planner();
    let mut end = READY;
    end[0] += 1.0;
    let segment = planner.joint(&READY, &end, 1.0).unwrap();
    let (v, a) = (1.9, 10.0);
    assert!((segment.duration() - (1.0 / v + v / a)).abs() < 1e-9);
    // Half the speed, reached with a quarter of the acceleration.
    let segment = planner.joint(&READY, &end, Pace::new(0.5, Some(0.25)));
    let (v, a) = (0.5 * v, 0.25 * a);
    assert!((segment.unwrap().duration() - (1.0 / v + v / a)).abs() < 1e-9);
    let refused = planner.joint(&READY, &end, Pace::new(0.5, Some(1.25)));
    assert_eq!(
        refused.unwrap_err(),
        PlanError::Acceleration { given: 1.25 }
    );
}

#[test]
fn a_line_is_straight_in_space_and_turns_about_one_axis() {
    let planner = planner();
    let start = planner.tool_pose(&READY);
    let goal = Isometry3::from_parts(
        Translation3::from(start.translation.vector + Vector3::new(0.05, 0.2, -0.1)),
        nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.0)) * start.rotation,
    );
    let segment = planner.line(&READY, &goal, 0.5).unwrap();
    let mut near = READY;
    for step in 0..=100_u32 {
        let t = segment.duration() * f64::from(step) / 100.0;
        let setpoint = segment.at(t, &near).unwrap();
        let pose = planner.tool_pose(&setpoint.position);
        let s = segment.profile().at(t).position;
        let on_line = start.translation.vector + Vector3::new(0.05, 0.2, -0.1) * s;
        assert!((pose.translation.vector - on_line).norm() < 1e-9);
        near = setpoint.position;
    }
    let end = planner.tool_pose(&near);
    assert!((end.translation.vector - goal.translation.vector).norm() < 1e-9);
    assert!(end.rotation.angle_to(&goal.rotation) < 1e-8);
}

#[test]
fn the_joint_speeds_and_accelerations_of_a_line_are_the_derivatives_of_its_positions() {
    let planner = planner();
    let start = planner.tool_pose(&READY);
    let goal = Translation3::new(0.05, 0.2, -0.1) * start;
    let segment = planner.line(&READY, &goal, 0.5).unwrap();
    let h = 1e-4;
    for share in [0.1, 0.45, 0.6, 0.93] {
        let t = share * segment.duration();
        let [before, now, after] = [t - h, t, t + h].map(|t| segment.at(t, &READY).unwrap());
        for index in 0..DOF {
            let speed = (after.position[index] - before.position[index]) / (2.0 * h);
            let rate = (after.velocity[index] - before.velocity[index]) / (2.0 * h);
            assert!((now.velocity[index] - speed).abs() < 1e-5);
            assert!((now.acceleration[index] - rate).abs() < 1e-4);
        }
    }
}

#[test]
fn what_cannot_be_done_is_refused_with_joint_value_and_limit() {
    let planner = planner();
    let beyond = [0.0, 0.0, 0.0, 0.0, 2.0, 0.0];
    let refused = planner.joint(&READY, &beyond, 0.5).unwrap_err();
    assert!(refused.to_string().starts_with(
        "joint 5 would have to be at 2.0000 rad, its limits are -1.7453 to 1.7453 rad"
    ));
    for speed in [0.0, -1.0, 1.01, f64::NAN, f64::INFINITY] {
        let refused = planner.joint(&READY, &READY, speed).unwrap_err();
        assert!(matches!(refused, PlanError::Speed { .. }));
    }
    let mut nan = READY;
    nan[3] = f64::NAN;
    let refused = planner.joint(&READY, &nan, 0.5).unwrap_err();
    assert_eq!(refused, PlanError::NotFinite { joint: 4 });
    let far = Isometry3::translation(2.0, 0.0, 0.5);
    let refused = planner.joints_for(&far, &READY, None).unwrap_err();
    assert!(matches!(
        refused,
        PlanError::Target(IkError::OutOfReach { .. })
    ));
    let refused = planner.line(&READY, &far, 0.5).unwrap_err();
    assert!(matches!(
        refused,
        PlanError::Target(IkError::OutOfReach { .. })
    ));
}

#[test]
fn a_line_past_the_wrist_singularity_is_refused_before_it_moves() {
    let planner = planner();
    // Straight through a pose whose joint 5 is almost zero: joints 4 and 6 would have to spin.
    let middle = planner.tool_pose(&[0.1, 0.8, -2.6, -1.0, 0.004, 0.1]);
    let start_joints = [0.1, 0.8, -2.6, -1.0, 0.3, 0.1];
    let start = planner.tool_pose(&start_joints);
    let turn = middle.rotation * start.rotation.inverse();
    let sideways = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.05, 0.0));
    let goal = Isometry3::from_parts(
        (middle.translation.vector * 2.0 - start.translation.vector).into(),
        sideways * turn * turn * start.rotation,
    );
    let refused = planner.line(&start_joints, &goal, 1.0).unwrap_err();
    assert!(
        matches!(
            refused,
            PlanError::JointSpeed { .. } | PlanError::JointAcceleration { .. }
        ),
        "{refused}"
    );
}

#[test]
fn a_motion_to_where_the_arm_is_takes_no_time() {
    let planner = planner();
    assert_eq!(planner.joint(&READY, &READY, 0.5).unwrap().duration(), 0.0);
    let here = planner.tool_pose(&READY);
    assert_eq!(planner.line(&READY, &here, 0.5).unwrap().duration(), 0.0);
}
