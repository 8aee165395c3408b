//! All eight postures against forward kinematics, and every reason for having none.

use super::*;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

fn within_limits() -> impl Strategy<Value = Joints> {
    prop::array::uniform6(0.0..=1.0_f64).prop_map(|shares| {
        let limits = ArmModel::puma560().limits;
        std::array::from_fn(|i| limits[i].lower + shares[i] * (limits[i].upper - limits[i].lower))
    })
}

fn regular(model: &ArmModel, q: &Joints) -> bool {
    let (forearm, forearm_angle) = model.puma().elbow_to_wrist();
    let outward = model.dh[1].a * q[1].cos() + forearm * (q[1] + q[2] + forearm_angle).cos();
    outward.abs() > 1e-3 && (q[2] + forearm_angle).sin().abs() > 1e-3 && q[4].sin().abs() > 1e-3
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn every_posture_reaches_the_pose_and_one_of_them_is_where_it_came_from(q in within_limits()) {
        let model = ArmModel::puma560();
        prop_assume!(regular(&model, &q));
        let pose = model.forward(&q);
        let found = model.inverse(&pose, &q).unwrap();
        for solution in &found.all {
            let again = model.forward(&solution.joints);
            prop_assert!((again.translation.vector - pose.translation.vector).norm() < 1e-9);
            prop_assert!((again.rotation.to_rotation_matrix().matrix()
                - pose.rotation.to_rotation_matrix().matrix()).norm() < 1e-9);
            prop_assert_eq!(model.branch_of(&solution.joints), solution.branch);
        }
        let best = found.nearest(&model, &q, None).unwrap();
        for (found, given) in best.joints.iter().zip(&q) {
            prop_assert!((found - given).abs() < 1e-9);
        }
        let followed = model.inverse_branch(&pose, model.branch_of(&q), &q).unwrap();
        prop_assert_eq!(followed, best.joints);
    }

    #[test]
    fn any_pose_gives_finite_joints_or_a_reason(
        p in prop::array::uniform3(-1.5..1.5_f64), r in prop::array::uniform3(-4.0..4.0_f64),
    ) {
        let model = ArmModel::puma560();
        let pose = Isometry3::new(Vector3::from(p), Vector3::from(r));
        if let Ok(found) = model.inverse(&pose, &[0.0; 6]) {
            for solution in &found.all {
                prop_assert!(solution.joints.iter().all(|value| value.is_finite()));
            }
        }
    }
}

fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::identity())
}

#[test]
fn each_reason_is_named() {
    let model = ArmModel::puma560();
    let near = [0.0; 6];
    let far = model.inverse(&at(2.0, 0.0, 0.5), &near).unwrap_err();
    assert!(matches!(far, IkError::OutOfReach { .. }), "{far}");
    let inside = model.inverse(&at(0.1, 0.05, 1.0), &near).unwrap_err();
    assert!(matches!(inside, IkError::InsideShoulder { .. }), "{inside}");
    let nan = model.inverse(&at(f64::NAN, 0.0, 0.0), &near).unwrap_err();
    assert_eq!(nan, IkError::NotFinite);
}

#[test]
fn a_pose_that_only_broken_limits_reach_names_joint_value_and_limits() {
    let mut model = ArmModel::puma560();
    let q = [0.3, 0.4, -2.5, 0.2, 0.6, 0.1];
    let pose = model.forward(&q);
    model.limits[0].upper = -3.0;
    model.limits[0].lower = -3.1;
    let found = model.inverse(&pose, &q).unwrap();
    let error = found.nearest(&model, &q, None).unwrap_err();
    assert!(
        matches!(error, IkError::JointLimit { joint: 1, .. }),
        "{error}"
    );
}

#[test]
fn the_wrist_singularity_keeps_joint_four_and_still_reaches_the_pose() {
    let model = ArmModel::puma560();
    let q = [0.3, 0.4, -2.5, 0.7, 0.0, 0.1];
    let pose = model.forward(&q);
    let found = model.inverse(&pose, &q).unwrap();
    assert!(found.singular.wrist);
    let best = found.nearest(&model, &q, None).unwrap();
    for (found, given) in best.joints.iter().zip(&q) {
        assert!((found - given).abs() < 1e-8);
    }
    let again = model.forward(&best.joints);
    assert!(again.rotation.angle_to(&pose.rotation) < 1e-8);
}

#[test]
fn the_straight_arm_and_the_shoulder_alignment_are_flagged() {
    let model = ArmModel::puma560();
    let straight = -(0.4318_f64).atan2(0.0203);
    let pose = model.forward(&[0.0, 0.5, straight, 0.0, 0.3, 0.0]);
    let found = model.inverse(&pose, &[0.0; 6]).unwrap();
    assert!(found.singular.elbow);
    let aligned = model.inverse(&at(0.0, -0.15005, 1.2), &[0.0; 6]).unwrap();
    assert!(aligned.singular.shoulder);
}

#[test]
fn joint_six_uses_its_more_than_one_turn_to_stay_near() {
    let model = ArmModel::puma560();
    let q = [0.3, 0.4, -2.5, 0.2, 0.6, 4.0];
    let found = model.inverse(&model.forward(&q), &q).unwrap();
    let best = found.nearest(&model, &q, None).unwrap();
    assert!((best.joints[5] - 4.0).abs() < 1e-9);
}
