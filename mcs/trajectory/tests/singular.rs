//! Lines of the tool past and through the three singularities of a PUMA's arm, on its pedestal and on a cart.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::sync::Arc;

use mcs_model::{Joints, Model, built_in, file::Inertias};
use mcs_trajectory::{CartesianLimits, Follower, PlanError, Planner, Segment};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Lengths of the arm, m.
const UPPER: f64 = 0.4318;
const OFFSET: f64 = 0.15005;
/// Of the servo, s.
const PERIOD: f64 = 4.5e-3;

/// Which singularity a line passes, and at what distance: rad of joint 5, m from the axis' cylinder, m from the farthest reach.
#[derive(Debug, Clone, Copy, PartialEq)]
enum At {
    Wrist(f64),
    Shoulder(f64),
    Elbow(f64),
}

fn model(name: &str) -> Arc<Model> {
    Arc::new(built_in::model(name, Inertias::Engine).unwrap().unwrap())
}

fn planner(name: &str) -> Planner {
    Planner::new(model(name), CartesianLimits::default(), 0.018).unwrap()
}

/// The joints of the arm of a model whose cart, if it has one, stands where it begins.
fn joints(name: &str, arm: [f64; 6]) -> Joints {
    let cart = model(name).dof() - 6;
    let all: Vec<f64> = vec![0.0; cart].into_iter().chain(arm).collect();
    Joints::try_from(&all[..]).unwrap()
}

/// The positions of a model without its cart with the wrist centre there, seen from the shoulder, m.
fn reaching(outward: f64, up: f64) -> [f64; 6] {
    let forearm = 0.4318_f64.hypot(0.0203);
    let distance = outward.hypot(up);
    let cosine =
        (distance * distance - UPPER * UPPER - forearm * forearm) / (2.0 * UPPER * forearm);
    let bend = -cosine.clamp(-1.0, 1.0).acos();
    let q2 = up.atan2(outward) - (forearm * bend.sin()).atan2(UPPER + forearm * bend.cos());
    [0.0, q2, bend - 0.4318_f64.atan2(0.0203), 0.3, 0.6, 0.1]
}

/// A line in the base frame of the arm: where it starts, and the pose that it ends in.
fn line(name: &str, at: At) -> (Joints, Isometry3<f64>) {
    let mut planner = planner(name);
    match at {
        At::Wrist(near) => {
            let middle = planner.tool_pose(&joints(name, [0.1, 0.8, -2.6, -1.0, near, 0.1]));
            let start = joints(name, [0.1, 0.8, -2.6, -1.0, 0.3, 0.1]);
            let from = planner.tool_pose(&start);
            let turn = middle.rotation * from.rotation.inverse();
            // A little to the side, so that only where `near` is 0 it leads through.
            let aside = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, -12.0 * near, 0.0));
            let way = middle.translation.vector * 2.0 - from.translation.vector;
            let goal = Isometry3::from_parts(way.into(), aside * turn * turn * from.rotation);
            (start, goal)
        }
        At::Shoulder(near) => {
            // Straight along x beside the axis of joint 1, nearest to it in the middle.
            let (x, y) = (0.2_f64, OFFSET + near);
            let outward = (x.hypot(y).powi(2) - OFFSET * OFFSET).sqrt();
            let mut q = reaching(outward, 0.6);
            q[0] = (-y).atan2(x) - (-OFFSET).atan2(outward);
            let start = joints(name, q);
            let mut goal = planner.tool_pose(&start);
            goal.translation.vector.x -= 2.0 * x;
            (start, goal)
        }
        At::Elbow(near) => {
            // Straight out from the shoulder, and so far from the farthest that the arm reaches.
            let farthest = UPPER + 0.4318_f64.hypot(0.0203) - near;
            let start = joints(name, reaching(0.6, 0.0));
            let mut goal = planner.tool_pose(&start);
            goal.translation.vector.x += farthest - 0.6;
            (start, goal)
        }
    }
}

fn planned(name: &str, at: At) -> Result<Segment, PlanError> {
    let (start, goal) = line(name, at);
    planner(name).line(&start, &goal, 1.0)
}

/// What a line says of itself, the smallest singular value and how many times as long it takes, once it was seen to be so: the
/// value is the least of those of the poses on it, and at the servo's rate joints keep their speeds and the tool its line.
fn passed(name: &str, at: At) -> (f64, f64) {
    let (start, goal) = line(name, at);
    let mut planner = planner(name);
    let segment = planner.line(&start, &goal, 1.0).unwrap();
    let (smallest, slowed) = segment.singularity().unwrap();
    let (model, mut data) = (model(name), model(name).data());
    let (mut solver, mut follower) = (planner.solver().clone(), Follower::new(1, PERIOD, 4));
    assert!(follower.push(segment, None));
    let from = planner.tool_pose(&start).translation.vector;
    // A turn of the wrist goes nowhere.
    let along = (goal.translation.vector - from).try_normalize(1e-9);
    let along = along.unwrap_or_default();
    let (mut before, mut least) = (start, f64::INFINITY);
    while !follower.rests() {
        let now = follower.next(&mut solver, &before).unwrap().position;
        for (index, joint) in model.joints().iter().enumerate() {
            let speed = (now[index] - before[index]).abs() / PERIOD;
            let most = joint.limits.velocity * (1.0 + 1e-6);
            assert!(speed <= most, "{name} {at:?}, joint {}: {speed}", index + 1);
        }
        let came = planner.tool_pose(&now).translation.vector - from;
        let off = (came - along * came.dot(&along)).norm();
        assert!(off < 5e-4, "{name} {at:?}: {off} m off the line");
        let jacobian = model.jacobian(&mut data, &now, model.tip()).clone();
        least = least.min(jacobian.singular_values().min());
        before = now;
    }
    let reached = planner.tool_pose(&before);
    assert!((reached.translation.vector - goal.translation.vector).norm() < 1e-6);
    // What is seen once in 18 ms, and what once in 4.5 ms.
    assert!(
        (least - smallest).abs() < 0.1 * smallest + 1e-4,
        "{name} {at:?}: {smallest}, and {least}"
    );
    (smallest, slowed)
}

#[test]
fn the_nearer_a_line_passes_a_singularity_the_smaller_is_the_value_that_it_tells_and_the_slower_it_is_there()
 {
    for at in [At::Wrist, At::Shoulder, At::Elbow] {
        let found = [0.1, 0.01, 1e-3, 1e-4].map(|near| passed("puma560", at(near)));
        for (far, near) in found.iter().zip(&found[1..]) {
            assert!(near.0 < 0.7 * far.0, "{:?}: {found:?}", at(0.0));
            assert!(near.1 >= far.1, "{:?}: {found:?}", at(0.0));
        }
        // At a tenth of a metre or of a radian nearly nothing has to be slower.
        assert!(found[0].1 < 1.1 && found[3].1 > 1.8, "{found:?}");
    }
    // Past the shoulder both postures meet, and joint 1 goes on: the line leads on there, as slowly as it must.
    let (smallest, slowed) = passed("puma560", At::Shoulder(0.0));
    assert!(smallest < 1e-5 && slowed > 2.0, "{smallest} {slowed}");
}

#[test]
fn a_line_through_the_wrists_singularity_or_to_the_stretched_elbow_is_refused_with_the_value_and_the_place()
 {
    for (at, place) in [
        (At::Wrist(0.0), 50.0),
        (At::Wrist(1e-6), 50.0),
        (At::Elbow(0.0), 100.0),
    ] {
        let refused = planned("puma560", at).unwrap_err();
        let PlanError::Singular { smallest, percent } = refused else {
            unreachable!("{at:?}: {refused}")
        };
        assert!(
            smallest < 2e-5 && (percent - place).abs() < 1.0,
            "{at:?}: {refused}"
        );
        let text = refused.to_string();
        assert!(
            text.contains("the smallest singular value along it is "),
            "{text}"
        );
    }
    // Farther than stretched it is out of reach, and not singular.
    let beyond = planned("puma560", At::Elbow(-1e-3)).unwrap_err();
    assert!(matches!(beyond, PlanError::Target(_)), "{beyond}");
}

#[test]
fn an_arm_on_a_cart_goes_the_same_lines_by_its_cart_and_tells_how_far_from_singular_it_stays() {
    for at in [At::Wrist, At::Shoulder, At::Elbow] {
        for near in [0.0, 1e-3, 0.01] {
            let (smallest, slowed) = passed("testbed9", at(near));
            assert!(
                smallest > 0.05 && slowed < 2.0,
                "{:?}: {smallest} {slowed}",
                at(near)
            );
        }
    }
    // What the arm alone cannot reach, the cart brings near.
    passed("testbed9", At::Elbow(-0.1));
}
