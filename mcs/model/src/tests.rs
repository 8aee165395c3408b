//! What holds for every arm, whatever its joints: known answers of others are in `tests/known_answers.rs`.

use super::*;
use crate::file::Inertias;
use nalgebra::{DVector, Vector3};
use proptest::prelude::*;
use std::sync::LazyLock;

static ALL: LazyLock<Vec<Model>> = LazyLock::new(|| {
    let built_in = built_in::NAMES.iter().map(|name| {
        built_in::model(name, Inertias::Identified)
            .unwrap()
            .unwrap()
    });
    let file = include_str!("../../tests/known_answers/two_arms.urdf");
    let source = ctos_config::diagnostic::Source::new("two_arms.urdf", file);
    let way = urdf::parse(&source, Some("left_hand"), Some("right_hand")).unwrap();
    built_in.chain([way.model]).collect()
});

#[test]
fn what_is_fixed_to_the_frames_of_a_joint_is_its_body_and_all_of_it_hangs_on_the_base() {
    for model in ALL.iter() {
        let base = FrameId(0);
        let (mut bodies, mut hanging) = (vec![Body::default(); model.dof()], 1);
        for (frame, body) in model.hanging(base) {
            let on = model.at(frame);
            hanging += 1;
            if let Some(joint) = on.carrier {
                bodies[joint] = bodies[joint].joined(&body.seen_from(&on.placement));
            }
        }
        assert_eq!(hanging, model.frames().len(), "{}", model.name());
        for (joint, body) in model.joints().iter().zip(bodies) {
            assert!(
                (joint.body.mass - body.mass).abs() < 1e-12,
                "{}",
                joint.name
            );
            assert!((joint.body.centre - body.centre).norm() < 1e-12);
            assert!((joint.body.inertia - body.inertia).amax() < 1e-12);
        }
    }
}

#[test]
fn what_hangs_on_the_flange_of_an_arm_is_its_hand_and_nothing_of_the_arm() {
    let model = built_in::model("puma560_hand", Inertias::Engine);
    let model = model.unwrap().unwrap();
    let hand = built_in::model("hand", Inertias::Engine).unwrap().unwrap();
    let flange = model.frame("arm.flange").unwrap();
    let hanging = model.hanging(flange);
    let names: Vec<&str> = hanging
        .map(|(frame, _)| model.at(frame).name.as_str())
        .collect();
    assert!(names.iter().all(|name| name.starts_with("hand.")));
    assert_eq!(names.len(), hand.frames().len());
    // The prism, and three fingers of three links each.
    let mass: f64 = model.hanging(flange).map(|(_, body)| body.mass).sum();
    assert!((mass - (0.9 + 3.0 * 0.09)).abs() < 1e-12, "{mass} kg");
    let link6 = model.frame("arm.link6").unwrap();
    assert!(model.hangs_on(flange, link6) && !model.hangs_on(link6, flange));
    // Of two arms, neither hangs on the other.
    let both = built_in::model("testbed18", Inertias::Engine);
    let both = both.unwrap().unwrap();
    let [left, right] = ["left_arm.link1", "right"].map(|name| both.frame(name).unwrap());
    assert!(!both.hangs_on(right, left) && !both.hangs_on(left, right));
}

/// Kinetic energy from the velocities of the bodies' centres, by a way of its own.
fn kinetic_energy(model: &Model, q: &[f64], qd: &[f64]) -> f64 {
    let (mut data, mut energy) = (model.data(), 0.0);
    for (index, joint) in model.joints().iter().enumerate() {
        model.forward(&mut data, q);
        let placement = data.placements[index + 1];
        let (mut speed, mut turning) = (Vector3::zeros(), Vector3::zeros());
        let centre = placement.point(&joint.body.centre);
        for carrier in model.carriers(Some(index)) {
            let there = data.placements[carrier + 1];
            let axis = there.rotation.column(2) * qd[carrier];
            match model.joints()[carrier].kind {
                JointKind::Revolute => {
                    turning += axis;
                    speed += axis.cross(&(centre - there.origin));
                }
                JointKind::Prismatic => speed += axis,
            }
        }
        let own = placement.rotation.tr_mul(&turning);
        energy += 0.5 * joint.body.mass * speed.norm_squared()
            + 0.5 * own.dot(&(joint.body.inertia * own));
        energy += 0.5 * joint.motor.reflected_inertia() * qd[index] * qd[index];
    }
    energy
}

fn potential_energy(model: &Model, q: &[f64]) -> f64 {
    let mut data = model.data();
    model.forward(&mut data, q);
    let joints = model.joints().iter().enumerate();
    let weigh = |(index, joint): (usize, &Joint)| {
        -joint.body.mass
            * model
                .gravity()
                .dot(&data.placements[index + 1].point(&joint.body.centre))
    };
    joints.map(weigh).sum()
}

/// One step of the classical method of Runge and Kutta without drive.
fn swing(model: &Model, data: &mut Data, q: &mut DVector<f64>, qd: &mut DVector<f64>, step: f64) {
    let still = vec![0.0; model.dof()];
    let mut slope = |q: &DVector<f64>, qd: &DVector<f64>| {
        let found = model.forward_dynamics(
            data,
            q.as_slice(),
            qd.as_slice(),
            &still,
            DynamicsOptions::WITH_ROTORS,
        );
        (qd.clone(), DVector::from_column_slice(found.unwrap()))
    };
    let (v1, a1) = slope(q, qd);
    let (v2, a2) = slope(&(&*q + &v1 * (step / 2.0)), &(&*qd + &a1 * (step / 2.0)));
    let (v3, a3) = slope(&(&*q + &v2 * (step / 2.0)), &(&*qd + &a2 * (step / 2.0)));
    let (v4, a4) = slope(&(&*q + &v3 * step), &(&*qd + &a3 * step));
    *q += (v1 + v2 * 2.0 + v3 * 2.0 + v4) * (step / 6.0);
    *qd += (a1 + a2 * 2.0 + a3 * 2.0 + a4) * (step / 6.0);
}

#[test]
fn a_free_swing_keeps_its_energy() {
    for model in ALL.iter() {
        let n = model.dof();
        let mut data = model.data();
        let mut q = DVector::from_fn(n, |index, _| 0.2 + 0.3 * (index as f64).cos());
        let mut qd = DVector::zeros(n);
        let energy = |q: &DVector<f64>, qd: &DVector<f64>| {
            kinetic_energy(model, q.as_slice(), qd.as_slice())
                + potential_energy(model, q.as_slice())
        };
        let before = energy(&q, &qd);
        let mut moved = 0.0_f64;
        for _ in 0..250 {
            swing(model, &mut data, &mut q, &mut qd, 1e-3);
            moved = moved.max(kinetic_energy(model, q.as_slice(), qd.as_slice()));
        }
        let after = energy(&q, &qd);
        // A cart and jaws alone do not fall, and fingers weigh little.
        let light = ["transporter", "gripper", "hand"].contains(&model.name());
        assert!(moved > 1.0 || light, "{}: {moved} J", model.name());
        assert!(
            (after - before).abs() < 1e-6 * (1.0 + moved),
            "{}: {before} J became {after}",
            model.name()
        );
    }
}

#[test]
fn a_vector_that_is_too_short_shows_in_the_results() {
    let model = built_in::model("puma560", Inertias::Identified)
        .unwrap()
        .unwrap();
    let mut data = model.data();
    assert!(
        model
            .gravity_torques(&mut data, &[0.0; 3])
            .iter()
            .any(|torque| torque.is_nan())
    );
    assert!(
        model
            .forward_dynamics(&mut data, &[0.0; 6], &[0.0; 6], &[], DynamicsOptions::RIGID)
            .unwrap()[0]
            .is_nan()
    );
    assert_eq!(
        (
            model.joint_outside(&[0.0; 6]),
            model.joint_outside(&[0.0; 3])
        ),
        (None, Some(3))
    );
}

fn states() -> impl Strategy<Value = (usize, Vec<f64>)> {
    (0..6_usize, prop::collection::vec(-2.0..2.0_f64, 54))
}

proptest! {
    #[test]
    fn the_jacobian_is_the_derivative_of_forward_kinematics((which, numbers) in states()) {
        let model = &ALL[which];
        let n = model.dof();
        let (q, qd) = (&numbers[..n], &numbers[n..2 * n]);
        let mut data = model.data();
        let tip = model.tip();
        let mut at = |step: f64| {
            let moved: Vec<f64> = q.iter().zip(qd).map(|(q, qd)| q + step * qd).collect();
            model.placement(&mut data, &moved, tip)
        };
        let (after, before, here) = (at(1e-6), at(-1e-6), at(0.0));
        let linear = (after.origin - before.origin) / 2e-6;
        let skew = (after.rotation - before.rotation) / 2e-6 * here.rotation.transpose();
        let angular = Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]);
        let twist = model.jacobian(&mut data, q, tip) * DVector::from_column_slice(qd);
        prop_assert!((twist.rows(0, 3) - linear).norm() < 1e-7 * (1.0 + linear.norm()));
        prop_assert!((twist.rows(3, 3) - angular).norm() < 1e-7 * (1.0 + angular.norm()));
    }

    #[test]
    fn bias_acceleration_is_the_jacobians_rate_times_the_joint_speeds((which, numbers) in states()) {
        let model = &ALL[which];
        let n = model.dof();
        let (q, qd) = (&numbers[..n], &numbers[n..2 * n]);
        let (mut data, tip) = (model.data(), model.tip());
        let mut twist = |step: f64| {
            let moved: Vec<f64> = q.iter().zip(qd).map(|(q, qd)| q + step * qd).collect();
            model.jacobian(&mut data, &moved, tip) * DVector::from_column_slice(qd)
        };
        let rate = (twist(1e-6) - twist(-1e-6)) / 2e-6;
        let found = model.bias_acceleration(&mut data, q, qd, tip);
        prop_assert!((found - &rate).norm() < 1e-6 * (1.0 + rate.norm()), "{} {}", found, rate);
    }

    #[test]
    fn the_mass_matrix_is_symmetric_positive_definite_and_gives_the_kinetic_energy((which, numbers) in states()) {
        let model = &ALL[which];
        let n = model.dof();
        let (q, qd) = (&numbers[..n], &numbers[n..2 * n]);
        let mut data = model.data();
        let mass = model.mass_matrix(&mut data, q, DynamicsOptions::WITH_ROTORS).clone();
        prop_assert_eq!(&mass, &mass.transpose());
        prop_assert!(mass.clone().cholesky().is_some());
        let speeds = DVector::from_column_slice(qd);
        let energy = 0.5 * speeds.dot(&(mass * &speeds));
        prop_assert!((energy - kinetic_energy(model, q, qd)).abs() < 1e-10 * (1.0 + energy));
    }

    #[test]
    fn forward_dynamics_undo_inverse_dynamics((which, numbers) in states()) {
        let model = &ALL[which];
        let n = model.dof();
        let (q, qd, qdd) = (&numbers[..n], &numbers[n..2 * n], &numbers[2 * n..3 * n]);
        for options in [DynamicsOptions::RIGID, DynamicsOptions::FULL] {
            let mut data = model.data();
            let torques = model.inverse_dynamics(&mut data, q, qd, qdd, options).to_vec();
            let found = model.forward_dynamics(&mut data, q, qd, &torques, options).unwrap();
            for (found, given) in found.iter().zip(qdd) {
                prop_assert!((found - given).abs() < 1e-7, "{} {found} {given}", model.name());
            }
        }
    }

    #[test]
    fn power_of_the_torques_is_the_rate_of_the_energy((which, numbers) in states()) {
        let model = &ALL[which];
        let n = model.dof();
        let (q, qd, qdd) = (&numbers[..n], &numbers[n..2 * n], &numbers[2 * n..3 * n]);
        let mut data = model.data();
        let torques = model.inverse_dynamics(&mut data, q, qd, qdd, DynamicsOptions::WITH_ROTORS);
        let power: f64 = torques.iter().zip(qd).map(|(torque, speed)| torque * speed).sum();
        let energy = |h: f64| {
            let moved: Vec<f64> = (0..n).map(|i| q[i] + h * (qd[i] + 0.5 * h * qdd[i])).collect();
            let speeds: Vec<f64> = (0..n).map(|i| qd[i] + h * qdd[i]).collect();
            kinetic_energy(model, &moved, &speeds) + potential_energy(model, &moved)
        };
        let rate = (energy(1e-5) - energy(-1e-5)) / 2e-5;
        prop_assert!((power - rate).abs() < 1e-5 * (1.0 + power.abs() + energy(0.0).abs()), "{power} {rate}");
    }

    #[test]
    fn gravity_is_inverse_dynamics_at_rest((which, numbers) in states()) {
        let model = &ALL[which];
        let (n, still) = (model.dof(), [0.0; 18]);
        let mut data = model.data();
        let at_rest = model.inverse_dynamics(&mut data, &numbers[..n], &still, &still, DynamicsOptions::FULL).to_vec();
        let gravity = model.gravity_torques(&mut data, &numbers[..n]);
        for (one, other) in gravity.iter().zip(&at_rest) {
            prop_assert!((one - other).abs() < 1e-10);
        }
    }
}
