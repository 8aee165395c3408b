//! The planner on random and on awkward targets.

use super::*;
use crate::timing::JointState;
use crate::{Setpoint, timing};
use mcs_model::{Placement, built_in, file::Inertias};
use nalgebra::Translation3;
use proptest::prelude::*;

const READY: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];

fn ready() -> Joints {
    READY.into()
}

fn planner() -> Planner {
    let arm = arm("puma560").with_tool(&Placement::shifted(0.0, 0.0, 0.1));
    Planner::new(Arc::new(arm), CartesianLimits::default(), 0.018).unwrap()
}

fn arm(name: &str) -> Model {
    built_in::model(name, Inertias::Identified)
        .unwrap()
        .unwrap()
}

fn at(segment: &Segment, planner: &mut Planner, t: f64, near: &[f64]) -> Setpoint {
    segment.at(&mut planner.solver, t, near).unwrap()
}

fn progress(segment: &Segment, t: f64) -> f64 {
    match segment.path() {
        Path::Tool(path) => path.along.at(t).position,
        Path::Joint(_) => panic!("no line"),
    }
}

fn within_limits() -> impl Strategy<Value = Joints> {
    prop::array::uniform6(0.0..=1.0_f64).prop_map(|shares| {
        let arm = arm("puma560");
        Joints::from_fn(6, |i| {
            let limits = &arm.joints()[i].limits;
            limits.lower + shares[i] * (limits.upper - limits.lower)
        })
    })
}

proptest! {
    #[test]
    fn joint_motion_keeps_every_limit_and_ends_exactly(
        start in within_limits(), end in within_limits(), speed in 0.01..=1.0_f64,
    ) {
        let mut planner = planner();
        let segment = planner.joint(&start, &end, speed).unwrap();
        for step in 0..=200_u32 {
            let t = segment.duration() * f64::from(step) / 200.0;
            let setpoint = at(&segment, &mut planner, t, &start);
            for index in 0..6 {
                let limit = &planner.model().joints()[index].limits;
                prop_assert!(setpoint.velocity[index].abs() <= speed * limit.velocity + 1e-9);
                prop_assert!(setpoint.acceleration[index].abs() <= speed * limit.acceleration + 1e-9);
            }
        }
        prop_assert_eq!(at(&segment, &mut planner, 0.0, &start).position, start);
        prop_assert_eq!(segment.end(&mut planner.solver).unwrap(), end);
    }

    #[test]
    fn a_direct_motion_is_a_straight_line_of_the_joints_within_every_limit_and_ends_exactly(
        start in within_limits(), end in within_limits(), speed in 0.01..=1.0_f64, jerk in any::<bool>(),
    ) {
        let mut planner = planner().limiting_jerk(jerk);
        let segment = planner.direct(&start, &end, speed).unwrap();
        for step in 0..=100_u32 {
            let t = segment.duration() * f64::from(step) / 100.0;
            let setpoint = at(&segment, &mut planner, t, &start);
            let share = (setpoint.position[0] - start[0]) / (end[0] - start[0]);
            for index in 0..6 {
                let limit = &planner.model().joints()[index].limits;
                prop_assert!(setpoint.velocity[index].abs() <= speed * limit.velocity + 1e-9);
                prop_assert!(setpoint.acceleration[index].abs() <= speed * limit.acceleration + 1e-9);
                let on_line = start[index] + share * (end[index] - start[index]);
                prop_assert!((setpoint.position[index] - on_line).abs() < 1e-6);
            }
        }
        prop_assert_eq!(at(&segment, &mut planner, 0.0, &start).position, start);
        prop_assert_eq!(segment.end(&mut planner.solver).unwrap(), end);
        // One joint is at a limit: no line is quicker.
        let joint = planner.joint(&start, &end, speed).unwrap();
        prop_assert!(segment.duration() >= joint.duration() - 1e-9);
    }

    #[test]
    fn a_joint_motion_takes_exactly_the_slowest_joints_least_time(
        start in within_limits(), end in within_limits(), speed in 0.01..=1.0_f64, share in 0.01..=1.0_f64, jerk in any::<bool>(),
    ) {
        let planner = planner().limiting_jerk(jerk);
        let segment = planner.joint(&start, &end, Pace::new(speed, Some(share))).unwrap();
        let joints = planner.model().joints().iter().zip(start.iter().zip(&end));
        let motions: Vec<timing::Motion> = joints.map(|(joint, (from, to))| {
            let at = |position: &f64| JointState { position: *position, ..JointState::default() };
            let limits = &joint.limits;
            (at(from), at(to), JointBounds {
                velocity: speed * limits.velocity,
                acceleration: share * limits.acceleration,
                jerk: if jerk { share * limits.jerk } else { 0.0 },
            })
        }).collect();
        let times = timing::between(&motions).unwrap();
        prop_assert!((segment.duration() - times.together).abs() < 1e-8, "{} {times:?}", segment.duration());
        // Every joint goes all the time: none waits for the others.
        let Path::Joint(courses) = segment.path() else { panic!("no line") };
        for course in courses.each() {
            prop_assert!((course.duration() - segment.duration()).abs() < 1e-9);
        }
    }
}

#[test]
fn the_slowest_joint_sets_the_time() {
    let planner = planner();
    let mut end = ready();
    end[0] += 1.0;
    let segment = planner.joint(&ready(), &end, 1.0).unwrap();
    let (v, a) = (1.9, 10.0);
    assert!((segment.duration() - (1.0 / v + v / a)).abs() < 1e-9);
    // Half the speed, reached with a quarter of the acceleration.
    let segment = planner.joint(&ready(), &end, Pace::new(0.5, Some(0.25)));
    let (v, a) = (0.5 * v, 0.25 * a);
    assert!((segment.unwrap().duration() - (1.0 / v + v / a)).abs() < 1e-9);
    let refused = planner.joint(&ready(), &end, Pace::new(0.5, Some(1.25)));
    assert_eq!(
        refused.unwrap_err(),
        PlanError::Acceleration { given: 1.25 }
    );
}

#[test]
fn a_line_is_straight_in_space_and_turns_about_one_axis() {
    let mut planner = planner();
    let start = planner.tool_pose(&READY);
    let goal = Isometry3::from_parts(
        Translation3::from(start.translation.vector + Vector3::new(0.05, 0.2, -0.1)),
        nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.0)) * start.rotation,
    );
    let segment = planner.line(&ready(), &goal, 0.5).unwrap();
    let mut near = ready();
    for step in 0..=100_u32 {
        let t = segment.duration() * f64::from(step) / 100.0;
        let setpoint = at(&segment, &mut planner, t, &near);
        let pose = planner.tool_pose(&setpoint.position);
        let s = progress(&segment, t);
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
    let mut planner = planner();
    let start = planner.tool_pose(&READY);
    let goal = Translation3::new(0.05, 0.2, -0.1) * start;
    let segment = planner.line(&ready(), &goal, 0.5).unwrap();
    let h = 1e-4;
    for share in [0.1, 0.45, 0.6, 0.93] {
        let t = share * segment.duration();
        let [before, now, after] = [t - h, t, t + h].map(|t| at(&segment, &mut planner, t, &READY));
        for index in 0..6 {
            let speed = (after.position[index] - before.position[index]) / (2.0 * h);
            let rate = (after.velocity[index] - before.velocity[index]) / (2.0 * h);
            assert!((now.velocity[index] - speed).abs() < 1e-5);
            assert!((now.acceleration[index] - rate).abs() < 1e-4);
        }
    }
}

#[test]
fn what_cannot_be_done_is_refused_with_joint_value_and_limit() {
    let mut planner = planner();
    let beyond = Joints::from([0.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
    let refused = planner.joint(&ready(), &beyond, 0.5).unwrap_err();
    assert!(refused.to_string().starts_with(
        "joint 5 would have to be at 2.0000 rad, its limits are -1.7453 to 1.7453 rad"
    ));
    for speed in [0.0, -1.0, 1.01, f64::NAN, f64::INFINITY] {
        let refused = planner.joint(&ready(), &ready(), speed).unwrap_err();
        assert!(matches!(refused, PlanError::Speed { .. }));
    }
    let mut nan = ready();
    nan[3] = f64::NAN;
    let refused = planner.joint(&ready(), &nan, 0.5).unwrap_err();
    assert_eq!(refused, PlanError::NotFinite { joint: 4 });
    let far = Isometry3::translation(2.0, 0.0, 0.5);
    let refused = planner.joints_for(&far, &ready(), None).unwrap_err();
    assert!(matches!(
        refused,
        PlanError::Target(IkError::OutOfReach { .. })
    ));
    let refused = planner.line(&ready(), &far, 0.5).unwrap_err();
    assert!(matches!(
        refused,
        PlanError::Target(IkError::OutOfReach { .. })
    ));
}

#[test]
fn a_motion_to_where_the_arm_is_takes_no_time() {
    let mut planner = planner();
    assert_eq!(
        planner.joint(&ready(), &ready(), 0.5).unwrap().duration(),
        0.0
    );
    let here = planner.tool_pose(&READY);
    assert_eq!(planner.line(&ready(), &here, 0.5).unwrap().duration(), 0.0);
}

#[test]
fn a_target_for_another_arm_and_a_joint_without_limits_are_refused() {
    let mut planner = planner();
    let nine = Joints::zeros(9);
    let refused = planner.joint(&ready(), &nine, 0.5).unwrap_err();
    assert_eq!(
        refused,
        PlanError::Count {
            needed: 6,
            given: 9
        }
    );
    let unlimited = arm("testbed9").with_joints(|index, joint| {
        if index == 3 {
            joint.limits.velocity = f64::INFINITY;
        }
    });
    let limits = CartesianLimits::default();
    let other = Planner::new(Arc::new(unlimited), limits, 0.018).unwrap();
    let mut to = nine;
    to[3] = 0.1;
    let refused = other.joint(&nine, &to, 0.5).unwrap_err();
    assert_eq!(refused, PlanError::NoLimit { joint: 4 });
    let here = planner.tool_pose(&READY);
    let mut other = Planner::new(Arc::new(arm("testbed9")), limits, 0.018).unwrap();
    let refused = other.joints_for(&here, &nine, Some(Elbow::Above));
    assert_eq!(refused, Err(PlanError::Target(IkError::NoElbow)));
}

#[test]
fn a_line_of_an_arm_without_a_closed_form_is_straight_and_its_speeds_are_those_of_its_positions() {
    let arm = Arc::new(arm("testbed18"));
    let mut planner = Planner::new(arm, CartesianLimits::default(), 0.018).unwrap();
    let one = [0.3, 0.2, -0.1, 0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
    let start = Joints::try_from(&[one, one].concat()[..]).unwrap();
    let from = planner.tool_pose(&start);
    let by = Vector3::new(-0.2, 0.3, 0.1);
    let goal = Isometry3::from_parts(
        Translation3::from(from.translation.vector + by),
        nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.0)) * from.rotation,
    );
    let segment = planner.line(&start, &goal, 0.5).unwrap();
    let (duration, mut before) = (segment.duration(), Setpoint::at_rest(start));
    let step = duration / 400.0;
    for count in 1..=400_u32 {
        let t = step * f64::from(count);
        let now = at(&segment, &mut planner, t, &before.position);
        let along = progress(&segment, t);
        let off = planner.tool_pose(&now.position).translation.vector
            - from.translation.vector
            - by * along;
        assert!(off.norm() < 1e-8, "{off}");
        for joint in 0..18 {
            // The mean of both speeds, but for a jump of acceleration between them.
            let mean = 0.5 * (now.velocity[joint] + before.velocity[joint]);
            let speed = (now.position[joint] - before.position[joint]) / step;
            assert!(
                (mean - speed).abs() < 0.01,
                "{count} {joint}: {mean} {speed}"
            );
        }
        assert_eq!(now.position[9..], start[9..], "the other arm stays");
        before = now;
    }
    let end = planner.tool_pose(&before.position);
    assert!((end.translation.vector - goal.translation.vector).norm() < 1e-8);
    assert!(end.rotation.angle_to(&goal.rotation) < 1e-7);
    // Beyond the end of the track there is nothing to be reached.
    let far = Translation3::new(3.5, 0.0, 0.0) * from;
    let refused = planner.line(&start, &far, 0.5).unwrap_err();
    assert!(matches!(refused, PlanError::Target(_)), "{refused}");
}
