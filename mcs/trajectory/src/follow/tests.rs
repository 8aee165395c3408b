//! Segments followed period by period, with stops at random moments.

use std::sync::Arc;

mod paths;

use super::*;
use crate::{CartesianLimits, Pace, Planner};
use mcs_model::{Model, built_in, file::Inertias};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PERIOD: f64 = 0.0045;

fn arm(name: &str) -> Arc<Model> {
    let model = built_in::model(name, Inertias::Identified);
    Arc::new(model.unwrap().unwrap())
}

fn within_limits(name: &'static str) -> impl Strategy<Value = Joints> {
    let dof = arm(name).dof();
    prop::collection::vec(0.0..=1.0_f64, dof).prop_map(move |shares| {
        let arm = arm(name);
        Joints::from_fn(dof, |index| {
            let limits = &arm.joints()[index].limits;
            limits.lower + shares[index] * (limits.upper - limits.lower)
        })
    })
}

/// All setpoints of a segment from `start`, to a stop asked for before some period if that comes.
fn followed(
    planner: &mut Planner,
    (segment, start): (&Segment, &Joints),
    stop_before: usize,
) -> Vec<Setpoint> {
    let mut follower = Follower::new(1, PERIOD, 4).limiting_jerk(planner.limits_jerk);
    assert!(follower.push(*segment, None));
    setpoints(&mut planner.solver, &mut follower, start, stop_before)
}

/// All setpoints to the next rest.
fn setpoints(
    solver: &mut Solver,
    follower: &mut Follower,
    start: &Joints,
    stop_before: usize,
) -> Vec<Setpoint> {
    let mut near = *start;
    let mut setpoints: Vec<Setpoint> = Vec::new();
    while !follower.rests() {
        if setpoints.len() == stop_before {
            follower.stop();
        }
        let setpoint = follower.next(solver, &near).unwrap();
        near = setpoint.position;
        setpoints.push(setpoint);
        assert!(setpoints.len() < 100_000, "it never rests");
    }
    setpoints
}

/// That setpoints keep the limits of all joints as they are seen once a period, have no steps, and that accelerations are
/// foreseen so well.
fn check(model: &Model, setpoints: &[Setpoint], pace: Pace, stop_before: usize) {
    for (period, pair) in setpoints.windows(2).enumerate() {
        let [before, now] = pair else { continue };
        for (index, joint) in model.joints().iter().enumerate() {
            let limits = &joint.limits;
            let speed = limits.velocity * pace.speed * (1.0 + 1e-9) + 1e-9;
            // A stop may brake harder than the motion.
            let share = if period + 1 < stop_before {
                pace.acceleration
            } else {
                1.0
            };
            let acceleration = limits.acceleration * share * (1.0 + 1e-9) + 1e-6;
            let moved = (now.position[index] - before.position[index]) / PERIOD;
            assert!(
                moved.abs() <= speed,
                "joint {index}, period {period}: {moved} {speed}"
            );
            assert!(now.velocity[index].abs() <= speed);
            let changed = (now.velocity[index] - before.velocity[index]) / PERIOD;
            assert!(
                changed.abs() <= acceleration,
                "joint {index}, period {period}: {changed} {acceleration}"
            );
            // The mean acceleration is announced, but for what a stop changes.
            let announced = before.acceleration[index];
            assert!(
                (announced - changed).abs() < 1e-6 || period + 1 == stop_before,
                "joint {index}, period {period}: {announced} {changed}"
            );
        }
    }
    for (period, triple) in setpoints.windows(3).enumerate() {
        let [a, b, c] = triple else { continue };
        for (index, joint) in model.joints().iter().enumerate() {
            let [a, b, c] = [a, b, c].map(|setpoint| setpoint.position[index]);
            let found = (c - 2.0 * b + a) / (PERIOD * PERIOD);
            let most = joint.limits.acceleration * (1.0 + 1e-9) + 1e-6;
            assert!(
                found.abs() <= most,
                "joint {index}, period {period}: {found} {most}"
            );
        }
    }
}

/// That setpoints keep the limits of jerk of all joints as they are seen once a period, by a share more or less.
fn check_jerk(model: &Model, setpoints: &[Setpoint], share: f64) {
    for (period, triple) in setpoints.windows(3).enumerate() {
        let [a, b, c] = triple else { continue };
        for (index, joint) in model.joints().iter().enumerate() {
            let [a, b, c] = [a, b, c].map(|setpoint| setpoint.velocity[index]);
            let found = (c - 2.0 * b + a).abs() / (PERIOD * PERIOD);
            let most = share * joint.limits.jerk * (1.0 + 1e-6) + 1e-5;
            assert!(
                found <= most,
                "joint {index}, period {period}: jerk {found}, at most {most}"
            );
        }
    }
}

/// How far a position is from where its segment is at some time: the least over all times, by halving in the travel of the
/// joint that goes furthest.
fn off_the_path(segment: &Segment, position: &Joints) -> f64 {
    let Path::Joint(courses) = segment.path() else {
        panic!("a line")
    };
    let travel = |index: usize| {
        let course = &courses.each()[index];
        course.at(segment.duration()).position - course.at(0.0).position
    };
    let furthest = (0..position.len()).max_by(|a, b| travel(*a).abs().total_cmp(&travel(*b).abs()));
    let furthest = furthest.unwrap();
    let (mut low, mut high) = (0.0, segment.duration());
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        let there = courses.each()[furthest].at(middle).position;
        match (there - position[furthest]) * travel(furthest) < 0.0 {
            true => low = middle,
            false => high = middle,
        }
    }
    let pairs = courses.each().iter().zip(position);
    pairs.fold(0.0, |most: f64, (course, position)| {
        most.max((course.at(low).position - position).abs())
    })
}

fn pace() -> impl Strategy<Value = Pace> {
    let share = || prop_oneof![Just(1.0), 0.1..1.0_f64];
    (share(), share()).prop_map(|(speed, share)| Pace::new(speed, Some(share)))
}

fn joint_motion(
    name: &'static str,
    (start, end): (Joints, Joints),
    (pace, limits_jerk): (Pace, bool),
    stop_at: f64,
) {
    let model = arm(name);
    let planner = Planner::new(Arc::clone(&model), CartesianLimits::default(), 0.018);
    let mut planner = planner.unwrap().limiting_jerk(limits_jerk);
    let segment = planner.joint(&start, &end, pace).unwrap();
    let whole = followed(&mut planner, (&segment, &start), usize::MAX);
    check(&model, &whole, pace, usize::MAX);
    let planned = (segment.duration() / PERIOD).ceil() as usize + 1;
    assert_eq!(whole.len(), planned);
    assert_eq!(whole.last().unwrap().position, end);
    assert_eq!(whole.first().unwrap().position, start);

    let stop_before = (stop_at * planned as f64) as usize;
    let stopped = followed(&mut planner, (&segment, &start), stop_before);
    check(&model, &stopped, pace, stop_before);
    // A stop is no longer than the rest of the motion, but for the parts of periods.
    let most = planned.max(stop_before) + 2;
    assert!(
        stopped.len() <= most,
        "{} {most}, stopped before {stop_before}",
        stopped.len()
    );
    let rest = stopped.last().unwrap();
    assert_eq!(*rest, Setpoint::at_rest(rest.position));
    let off = off_the_path(&segment, &rest.position);
    if limits_jerk {
        for all in [&whole, &stopped] {
            check_jerk(&model, all, 1.0);
        }
        // Beside the path, and never by as much as the way to rest.
        let before = &stopped[stop_before.saturating_sub(1).min(stopped.len() - 1)];
        let pairs = rest.position.iter().zip(&before.position);
        let way = pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
        assert!(off < way + 1e-3, "{off} {way}");
    } else {
        assert!(off < 1e-6, "{off}");
    }
}

proptest! {
    #[test]
    fn six_joints_keep_every_limit_on_the_way_and_in_a_stop_at_any_moment_which_ends_on_the_path(
        ends in (within_limits("puma560"), within_limits("puma560")), how in (pace(), any::<bool>()), stop_at in 0.0..1.0_f64,
    ) {
        joint_motion("puma560", ends, how, stop_at);
    }

    #[test]
    fn joints_that_slide_among_eighteen_do_the_same(
        ends in (within_limits("testbed18"), within_limits("testbed18")), how in (pace(), any::<bool>()), stop_at in 0.0..1.0_f64,
    ) {
        joint_motion("testbed18", ends, how, stop_at);
    }

    #[test]
    fn a_line_is_kept_within_every_limit_on_the_way_and_in_a_stop_at_any_moment(
        cart in any::<bool>(), jerk in any::<bool>(), pace in pace(), stop_at in 0.0..1.0_f64,
        (x, y, z) in (-0.1..0.1_f64, 0.05..0.25_f64, -0.1..0.1_f64), turn in -0.3..0.3_f64,
    ) {
        let ready = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
        let (model, start) = match cart {
            true => (arm("testbed9"), Joints::try_from(&[&[0.1, 0.0, 0.0][..], &ready].concat()[..]).unwrap()),
            false => (arm("puma560"), Joints::from(ready)),
        };
        let planner = Planner::new(Arc::clone(&model), CartesianLimits::default(), 0.018);
        let mut planner = planner.unwrap().limiting_jerk(jerk);
        let from = planner.tool_pose(&start);
        let goal = Isometry3::from_parts(
            Translation3::from(from.translation.vector + Vector3::new(x, y, z)),
            UnitQuaternion::from_scaled_axis(Vector3::new(0.0, turn, turn)) * from.rotation,
        );
        // Not every line can be followed at every pace.
        let segment = planner.line(&start, &goal, pace);
        prop_assume!(segment.is_ok());
        let segment = segment.unwrap();
        let planned = (segment.duration() / PERIOD).ceil() as usize + 1;
        for stop_before in [usize::MAX, (stop_at * planned as f64) as usize] {
            let setpoints = followed(&mut planner, (&segment, &start), stop_before);
            check(&model, &setpoints, Pace::from(1.0), stop_before);
            if jerk {
                check_jerk(&model, &setpoints, 1.02);
            }
            let along = goal.translation.vector - from.translation.vector;
            for setpoint in &setpoints {
                let way = planner.tool_pose(&setpoint.position).translation.vector - from.translation.vector;
                let off = (way - along * (way.dot(&along) / along.norm_squared())).norm();
                prop_assert!(off < 1e-4, "{off} m");
            }
            if stop_before == usize::MAX {
                prop_assert_eq!(setpoints.len(), planned);
                let end = planner.tool_pose(&setpoints.last().unwrap().position);
                prop_assert!((end.translation.vector - goal.translation.vector).norm() < 1e-7);
            }
        }
    }
}

/// Two segments with a bridge between them, if there is one, followed to the end and to a stop; how much was gained by the
/// bridge, s.
fn two_segments(
    planner: &mut Planner,
    start: &Joints,
    (first, second): (&Segment, &Segment),
    (pace, blend, stop_at): (Pace, f64, f64),
) -> f64 {
    let model = Arc::clone(planner.model());
    let Some(bridge) = planner.bridge((first, second), pace, blend) else {
        return 0.0;
    };
    assert!(bridge.gain(first) > 0.0);
    let whole = first.duration() + second.duration() - bridge.gain(first);
    let planned = (whole / PERIOD).ceil() as usize + 1;
    for stop_before in [usize::MAX, (stop_at * planned as f64) as usize] {
        let mut follower = Follower::new(2, PERIOD, 4).limiting_jerk(planner.limits_jerk);
        assert!(follower.push(*first, None) && follower.push(*second, Some(bridge)));
        let setpoints = setpoints(&mut planner.solver, &mut follower, start, stop_before);
        check(&model, &setpoints, Pace::from(1.0), stop_before);
        if planner.limits_jerk {
            check_jerk(&model, &setpoints, 1.02);
        }
        if stop_before == usize::MAX {
            assert!(setpoints.len().abs_diff(planned) <= 1);
            assert_eq!(follower.passed(), 1);
            let end = second.end(&mut planner.solver).unwrap();
            let pairs = setpoints[setpoints.len() - 1].position.iter().zip(&end);
            assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 1e-7));
        } else {
            assert!(setpoints.len() <= planned.max(stop_before) + 2);
            let rest = setpoints[setpoints.len() - 1];
            assert_eq!(rest, Setpoint::at_rest(rest.position));
        }
    }
    bridge.gain(first)
}

proptest! {
    #[test]
    fn over_a_bridge_every_limit_is_kept_with_no_step_of_speed_and_in_a_stop_too(
        points in (within_limits("testbed18"), within_limits("testbed18"), within_limits("testbed18")),
        how in (pace(), any::<bool>()), blend in 0.05..=1.0_f64, stop_at in 0.0..1.0_f64,
    ) {
        let planner = Planner::new(arm("testbed18"), CartesianLimits::default(), 0.018);
        let (mut planner, pace) = (planner.unwrap().limiting_jerk(how.1), how.0);
        let first = planner.joint(&points.0, &points.1, pace).unwrap();
        let second = planner.joint(&points.1, &points.2, pace).unwrap();
        two_segments(&mut planner, &points.0, (&first, &second), (pace, blend, stop_at));
    }

    #[test]
    fn bridges_lead_from_lines_to_lines_and_to_joint_motions(
        kinds in (any::<bool>(), any::<bool>()), jerk in any::<bool>(), blend in 0.05..=1.0_f64, stop_at in 0.0..1.0_f64,
        pace in 0.1..1.0_f64,
        by in (prop::array::uniform3(-0.15..0.15_f64), prop::array::uniform3(-0.15..0.15_f64)),
    ) {
        let planner = Planner::new(arm("puma560"), CartesianLimits::default(), 0.018);
        let (mut planner, pace) = (planner.unwrap().limiting_jerk(jerk), Pace::from(pace));
        let start = Joints::from([0.1, 0.8, -2.6, 0.2, 0.7, 0.1]);
        let mut from = start;
        let mut segments = Vec::new();
        for (is_line, by) in [(kinds.0, by.0), (kinds.1, by.1)] {
            let pose = Translation3::from(Vector3::from(by)) * planner.tool_pose(&from);
            let joints = planner.joints_for(&pose, &from, None);
            let segment = match joints {
                Ok(joints) if !is_line => planner.joint(&from, &joints, pace),
                _ => planner.line(&from, &pose, pace),
            };
            prop_assume!(segment.is_ok());
            segments.extend(segment);
            from = segments[segments.len() - 1].end(&mut planner.solver).unwrap();
        }
        two_segments(&mut planner, &start, (&segments[0], &segments[1]), (pace, blend, stop_at));
    }
}

#[test]
fn a_bridge_saves_time_at_a_corner_and_straight_ahead() {
    let planner = Planner::new(arm("puma560"), CartesianLimits::default(), 0.018);
    let mut planner = planner.unwrap();
    let start = Joints::from([0.1, 0.8, -2.6, 0.2, 0.7, 0.1]);
    let (mut corner, mut ahead, mut aside) = (start, start, start);
    corner[0] += 1.0;
    ahead[0] += 2.0;
    (aside[0], aside[1]) = (corner[0], start[1] + 1.0);
    let pace = Pace::from(1.0);
    let first = planner.joint(&start, &corner, pace).unwrap();
    let limits = planner.model().joints()[0].limits;
    let ramp = limits.velocity / limits.acceleration;
    // Straight ahead neither the braking nor the acceleration is needed; aside both joints move at once.
    for (to, least, most) in [(ahead, ramp, ramp), (aside, ramp, first.duration())] {
        let second = planner.joint(&corner, &to, pace).unwrap();
        let gain = two_segments(&mut planner, &start, (&first, &second), (pace, 1.0, 0.5));
        assert!(gain > least - 1e-6 && gain < most + 1e-6, "{gain}");
    }
    // Without a blend there is no bridge.
    let second = planner.joint(&corner, &ahead, pace).unwrap();
    assert_eq!(planner.bridge((&first, &second), pace, 0.0), None);
}

#[test]
fn a_segment_that_comes_too_late_begins_where_the_arm_has_stopped_on_the_path() {
    let planner = Planner::new(arm("puma560"), CartesianLimits::default(), 0.018);
    let mut planner = planner.unwrap();
    let start = Joints::from([0.1, 0.8, -2.6, 0.2, 0.7, 0.1]);
    let (mut corner, mut to) = (start, start);
    corner[0] += 1.0;
    to[1] += 1.0;
    let pace = Pace::from(1.0);
    let first = planner.joint(&start, &corner, pace).unwrap();
    let second = planner.joint(&corner, &to, pace).unwrap();
    let bridge = planner.bridge((&first, &second), pace, 0.5).unwrap();
    let leave = (bridge.leave / PERIOD) as usize;
    for (before, passed) in [(leave - 1, 1), (leave + 1, 0)] {
        let mut follower = Follower::new(2, PERIOD, 4);
        assert!(follower.push(first, None));
        let mut all: Vec<Setpoint> = Vec::new();
        while !follower.rests() {
            if all.len() == before {
                assert!(follower.push(second, Some(bridge)));
                assert!(!follower.push(second, None), "there is room for two");
            }
            all.push(follower.next(&mut planner.solver, &start).unwrap());
        }
        assert_eq!(follower.passed(), passed);
        if passed == 0 {
            assert_eq!(all.last().unwrap().position, corner);
            assert!(follower.go_on());
            all.extend(setpoints(
                &mut planner.solver,
                &mut follower,
                &corner,
                usize::MAX,
            ));
        }
        check(planner.model(), &all, pace, usize::MAX);
        assert_eq!(all.last().unwrap().position, to);
        assert!(!follower.go_on() && follower.is_empty());
    }
}

#[test]
fn a_stop_takes_the_closed_forms_time_where_one_joint_moves() {
    let model = arm("puma560");
    let planner = Planner::new(Arc::clone(&model), CartesianLimits::default(), 0.018);
    let mut planner = planner.unwrap();
    let start = Joints::from([0.1, 0.8, -2.6, 0.2, 0.7, 0.1]);
    let mut end = start;
    end[0] += 2.0;
    let limits = &model.joints()[0].limits;
    let segment = planner.joint(&start, &end, 1.0).unwrap();
    let gaining = (limits.velocity / limits.acceleration / PERIOD) as usize;
    for stop_before in [gaining / 2, gaining + 20] {
        let setpoints = followed(&mut planner, (&segment, &start), stop_before);
        let speed = setpoints[stop_before - 1].velocity[0];
        let took = (setpoints.len() - stop_before) as f64 * PERIOD;
        let least = speed / limits.acceleration;
        // One period to change from gaining to losing speed, and the rest of the last one.
        assert!(
            took >= least - 1e-9 && took <= least + 2.0 * PERIOD,
            "{took} {least}"
        );
    }
}

#[test]
fn a_segment_of_no_length_rests_at_once() {
    let model = arm("puma560");
    let mut planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
    let here = Joints::from([0.1, 0.8, -2.6, 0.2, 0.7, 0.1]);
    let setpoints = followed(&mut planner, (&Segment::hold(here), &here), usize::MAX);
    assert_eq!(setpoints, [Setpoint::at_rest(here)]);
}

#[test]
fn nine_of_ten_random_corners_have_a_bridge() {
    let model = arm("testbed9");
    let planner = Planner::new(Arc::clone(&model), CartesianLimits::default(), 0.018);
    let mut planner = planner.unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut anywhere = || {
        Joints::from_fn(model.dof(), |index| {
            let limits = &model.joints()[index].limits;
            let share = random.random_range(0.25..0.75);
            limits.lower + share * (limits.upper - limits.lower)
        })
    };
    let pace = Pace::from(0.5);
    let bridges = (0..100).filter_map(|_| {
        let [start, corner, end] = [anywhere(), anywhere(), anywhere()];
        let first = planner.joint(&start, &corner, pace).unwrap();
        let second = planner.joint(&corner, &end, pace).unwrap();
        planner.bridge((&first, &second), pace, 0.5)
    });
    let count = bridges.count();
    assert!(count >= 90, "{count}");
}
