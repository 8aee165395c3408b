//! Segments followed period by period, with stops at random moments.

use std::sync::Arc;

use super::*;
use crate::{CartesianLimits, Pace, Planner};
use mcs_model::{Model, built_in, file::Inertias};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

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
    solver: &mut Solver,
    (segment, start): (&Segment, &Joints),
    stop_before: usize,
) -> Vec<Setpoint> {
    let mut follower = Follower::new(*segment, PERIOD, 4);
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
    let whole = followed(&mut planner.solver, (&segment, &start), usize::MAX);
    check(&model, &whole, pace, usize::MAX);
    let planned = (segment.duration() / PERIOD).ceil() as usize + 1;
    assert_eq!(whole.len(), planned);
    assert_eq!(whole.last().unwrap().position, end);
    assert_eq!(whole.first().unwrap().position, start);

    let stop_before = (stop_at * planned as f64) as usize;
    let stopped = followed(&mut planner.solver, (&segment, &start), stop_before);
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
    assert!(off < 1e-6, "{off}");
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
        cart in any::<bool>(), pace in pace(), stop_at in 0.0..1.0_f64,
        (x, y, z) in (-0.1..0.1_f64, 0.05..0.25_f64, -0.1..0.1_f64), turn in -0.3..0.3_f64,
    ) {
        let ready = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
        let (model, start) = match cart {
            true => (arm("testbed9"), Joints::try_from(&[&[0.1, 0.0, 0.0][..], &ready].concat()[..]).unwrap()),
            false => (arm("puma560"), Joints::from(ready)),
        };
        let planner = Planner::new(Arc::clone(&model), CartesianLimits::default(), 0.018);
        let mut planner = planner.unwrap();
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
            let setpoints = followed(&mut planner.solver, (&segment, &start), stop_before);
            check(&model, &setpoints, Pace::from(1.0), stop_before);
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
        let setpoints = followed(&mut planner.solver, (&segment, &start), stop_before);
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
    let mut solver = Solver::new(model).unwrap();
    let here = Joints::from([0.1, 0.8, -2.6, 0.2, 0.7, 0.1]);
    let setpoints = followed(&mut solver, (&Segment::hold(here), &here), usize::MAX);
    assert_eq!(setpoints, [Setpoint::at_rest(here)]);
}
