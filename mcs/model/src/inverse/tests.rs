//! The closed form where zero positions and frames are anybody's, and the search where there is none.

use super::*;
use crate::{
    JointKind, JointSpec, Limits, Model, ModelBuilder, Placement, built_in, file::Inertias,
};
use nalgebra::{DVector, Vector3, Vector6};
use proptest::prelude::*;

fn model(name: &str) -> Model {
    built_in::model(name, Inertias::Identified)
        .unwrap()
        .unwrap()
}

fn within(model: &Model, shares: &[f64]) -> Vec<f64> {
    let joints = model.joints().iter().zip(shares);
    joints
        .map(|(joint, share)| {
            joint.limits.lower + share * (joint.limits.upper - joint.limits.lower)
        })
        .collect()
}

/// A search reaches `pose`, and what it found is within the limits.
fn reaches(
    model: &Model,
    search: &mut Search,
    q: &[f64],
    start: &[f64],
) -> Result<(), TestCaseError> {
    let mut data = model.data();
    let goal = model.placement(&mut data, q, model.tip());
    let found = search.solve(model, &goal, start);
    prop_assert!(found.is_ok(), "{:?} from {:?}: {:?}", q, start, found);
    let found = found.unwrap().to_vec();
    let there = model.placement(&mut data, &found, model.tip());
    prop_assert!((there.origin - goal.origin).norm() < 1e-9);
    prop_assert!((there.rotation - goal.rotation).norm() < 1e-8);
    prop_assert_eq!(model.joint_outside(&found), None);
    Ok(())
}

/// Six axes of which no three meet: no closed form.
fn six_axes() -> Model {
    let mut builder = ModelBuilder::new("six", "base");
    let mut at = builder.base();
    let rows = [
        ([0.0, 0.0, 0.1], Vector3::z()),
        ([0.0, 0.1, 0.05], Vector3::y()),
        ([0.4, 0.0, 0.0], Vector3::y()),
        ([0.35, 0.0, 0.02], Vector3::y()),
        ([0.05, 0.08, 0.0], Vector3::z()),
        ([0.0, 0.0, 0.08], Vector3::y()),
    ];
    for (index, (origin, axis)) in rows.into_iter().enumerate() {
        let mut spec = JointSpec::new(format!("j{index}"), JointKind::Revolute, at);
        spec.before = Placement::from_radians(origin, [0.0; 3]);
        spec.axis = axis;
        spec.limits = Limits {
            lower: -3.0,
            upper: 3.0,
            ..Limits::NONE
        };
        at = builder.joint(spec, format!("l{index}")).unwrap();
    }
    builder.build()
}

#[test]
fn only_arms_with_a_pumas_geometry_have_a_closed_form() {
    for (name, has) in [
        ("puma560", true),
        ("puma600", true),
        ("transporter", false),
        ("testbed9", false),
    ] {
        let model = model(name);
        assert_eq!(ClosedForm::of(&model, model.tip()).is_some(), has, "{name}");
    }
    let six = six_axes();
    assert!(ClosedForm::of(&six, six.tip()).is_none());
}

#[test]
fn a_start_at_a_singular_pose_is_no_hindrance() {
    let model = model("testbed9");
    let mut search = Search::new(&model, model.tip(), true, Preferences::default());
    let goal = within(&model, &[0.7, 0.4, 0.6, 0.5, 0.4, 0.3, 0.6, 0.7, 0.5]);
    // The arm straight up and the wrist straight: three singularities in one.
    let straight = [
        0.0,
        0.0,
        0.0,
        0.0,
        std::f64::consts::FRAC_PI_2,
        -std::f64::consts::FRAC_PI_2,
        0.0,
        0.0,
        0.0,
    ];
    reaches(&model, &mut search, &goal, &straight).unwrap();
}

#[test]
fn what_is_no_number_or_too_far_is_named() {
    let model = six_axes();
    let mut search = Search::new(&model, model.tip(), true, Preferences::default());
    let at = |x: f64| Placement::shifted(x, 0.0, 0.2);
    assert_eq!(
        search.solve(&model, &at(f64::NAN), &[0.0; 6]),
        Err(IkError::NotFinite)
    );
    assert_eq!(
        search.solve(&model, &at(0.3), &[f64::INFINITY; 6]),
        Err(IkError::NotFinite)
    );
    assert!(matches!(
        search.solve(&model, &at(5.0), &[0.0; 6]),
        Err(IkError::TooFar { .. })
    ));
    assert!(matches!(
        search.solve(&model, &at(0.95), &[0.0; 6]),
        Err(IkError::NotFound { .. })
    ));
}

#[test]
fn freedom_is_used_to_keep_joints_off_their_limits() {
    // With the goal where it is, nothing has to move; the preferences bring the joints to the middle of their ranges.
    let model = model("testbed9");
    let start = within(&model, &[0.97, 0.5, 0.5, 0.5, 0.4, 0.3, 0.6, 0.7, 0.5]);
    let goal = model.placement(&mut model.data(), &start, model.tip());
    let prefers = Preferences {
        limits: 1.0,
        posture: 0.0,
        manipulability: 0.0,
    };
    let mut search = Search::new(&model, model.tip(), true, prefers);
    let found = search.solve(&model, &goal, &start).unwrap();
    let room = |q: f64| model.joints()[0].limits.upper - q;
    assert!(room(found[0]) > 2.0 * room(start[0]), "{found:?}");
    let stays = Preferences {
        limits: 0.0,
        posture: 1.0,
        manipulability: 0.0,
    };
    let mut search = Search::new(&model, model.tip(), true, stays);
    let found = search.solve(&model, &goal, &start).unwrap();
    assert!(
        found.iter().zip(&start).all(|(a, b)| (a - b).abs() < 1e-6),
        "{found:?}"
    );
}

#[test]
fn freedom_is_used_to_keep_away_from_singular_positions() {
    let model = model("testbed9");
    // The elbow is nearly stretched.
    let start = within(&model, &[0.5, 0.5, 0.5, 0.5, 0.4, 0.69, 0.6, 0.7, 0.5]);
    let goal = model.placement(&mut model.data(), &start, model.tip());
    let prefers = Preferences {
        limits: 0.0,
        posture: 0.0,
        manipulability: 1.0,
    };
    let mut search = Search::new(&model, model.tip(), true, prefers);
    let found = search.solve(&model, &goal, &start).unwrap();
    // Yoshikawa's measure, from the Jacobian by itself.
    let measure = |q: &[f64]| {
        let mut data = model.data();
        let jacobian = model.jacobian(&mut data, q, model.tip());
        (jacobian * jacobian.transpose()).determinant().sqrt()
    };
    let (before, after) = (measure(&start), measure(found));
    assert!(after > 1.2 * before, "{before} became {after}");
}

/// The PUMA 560's closed form for its wrist centre.
fn puma560() -> (Model, ClosedForm) {
    let model = model("puma560");
    let closed = ClosedForm::of(&model, model.tip()).unwrap();
    (model, closed)
}

fn pose(model: &Model, q: &[f64]) -> Placement {
    model.placement(&mut model.data(), q, model.tip())
}

#[test]
fn each_reason_is_named() {
    let (_, closed) = puma560();
    let near = [0.0; 6];
    let reason = |x: f64, y: f64, z: f64| closed.inverse(&Placement::shifted(x, y, z), &near);
    let far = reason(2.0, 0.0, 0.5).unwrap_err();
    assert!(matches!(far, IkError::OutOfReach { .. }), "{far}");
    let inside = reason(0.1, 0.05, 1.0).unwrap_err();
    assert!(matches!(inside, IkError::InsideShoulder { .. }), "{inside}");
    assert_eq!(reason(f64::NAN, 0.0, 0.0), Err(IkError::NotFinite));
}

#[test]
fn a_pose_that_only_broken_limits_reach_names_joint_value_and_limits() {
    let q = [0.3, 0.4, -2.5, 0.2, 0.6, 0.1];
    let goal = pose(&model("puma560"), &q);
    let narrow = model("puma560").with_joints(|index, joint| {
        if index == 0 {
            (joint.limits.lower, joint.limits.upper) = (-3.1, -3.0);
        }
    });
    let closed = ClosedForm::of(&narrow, narrow.tip()).unwrap();
    let found = closed.inverse(&goal, &q).unwrap();
    let nearest = found.nearest_within(closed.limits(), &q, None);
    let followed = closed.inverse_branch(&goal, closed.branch_of(&q), &q);
    for error in [nearest.unwrap_err(), followed.unwrap_err()] {
        assert!(
            matches!(error, IkError::JointLimit { joint: 1, .. }),
            "{error}"
        );
    }
}

#[test]
fn the_wrist_singularity_keeps_joint_four_and_still_reaches_the_pose() {
    let (model, closed) = puma560();
    let q = [0.3, 0.4, -2.5, 0.7, 0.0, 0.1];
    let goal = pose(&model, &q);
    let found = closed.inverse(&goal, &q).unwrap();
    assert!(found.singular.wrist);
    let best = found.nearest_within(closed.limits(), &q, None).unwrap();
    for (found, given) in best.joints.iter().zip(&q) {
        assert!((found - given).abs() < 1e-8);
    }
    assert!((pose(&model, &best.joints).rotation - goal.rotation).norm() < 1e-8);
}

#[test]
fn the_straight_arm_and_the_shoulder_alignment_are_flagged() {
    let (model, closed) = puma560();
    let straight = -(0.4318_f64).atan2(0.0203);
    let goal = pose(&model, &[0.0, 0.5, straight, 0.0, 0.3, 0.0]);
    assert!(closed.inverse(&goal, &[0.0; 6]).unwrap().singular.elbow);
    let aligned = Placement::shifted(0.0, -0.15005, 1.2);
    assert!(
        closed
            .inverse(&aligned, &[0.0; 6])
            .unwrap()
            .singular
            .shoulder
    );
}

#[test]
fn joint_six_uses_its_more_than_one_turn_to_stay_near() {
    let (model, closed) = puma560();
    let q = [0.3, 0.4, -2.5, 0.2, 0.6, 4.0];
    let found = closed.inverse(&pose(&model, &q), &q).unwrap();
    let best = found.nearest_within(closed.limits(), &q, None).unwrap();
    assert!((best.joints[5] - 4.0).abs() < 1e-9);
}

#[test]
fn a_tool_is_the_tip_and_the_closed_form_counts_with_it() {
    let tool = Placement::from_radians([0.01, -0.02, 0.1], [0.3, -0.2, 0.1]);
    let (bare, held) = (model("puma560"), model("puma560").with_tool(&tool));
    let q = [0.3, 0.4, -2.5, 0.2, 0.6, 0.1];
    let goal = pose(&held, &q);
    let expected = pose(&bare, &q).then(&tool);
    assert!((goal.origin - expected.origin).norm() < 1e-12);
    assert!((goal.rotation - expected.rotation).norm() < 1e-12);
    let closed = ClosedForm::of(&held, held.tip()).unwrap();
    let found = closed
        .inverse_branch(&goal, closed.branch_of(&q), &q)
        .unwrap();
    for (found, given) in found.iter().zip(&q) {
        assert!((found - given).abs() < 1e-9);
    }
}

#[test]
fn following_finds_the_pose_beside_and_not_one_elsewhere() {
    let model = model("testbed9");
    let mut search = Search::new(&model, model.tip(), true, Preferences::default());
    let start = within(&model, &[0.5, 0.4, 0.6, 0.5, 0.4, 0.3, 0.6, 0.7, 0.5]);
    let mut goal = pose(&model, &start);
    assert_eq!(search.follow(&model, &goal, &start).unwrap(), start);
    goal.origin.x += 0.01;
    let found = search.follow(&model, &goal, &start).unwrap().to_vec();
    assert!((pose(&model, &found).origin - goal.origin).norm() < 1e-9);
    assert!(
        found.iter().zip(&start).all(|(a, b)| (a - b).abs() < 0.02),
        "{found:?}"
    );
    goal.origin.x += 9.0;
    let lost = search.follow(&model, &goal, &start);
    assert!(matches!(lost, Err(IkError::NotFound { starts: 1, .. })));
}

#[test]
fn a_joint_on_its_limit_stays_there_while_the_others_move_the_tip() {
    let model = model("testbed9");
    let mut search = Search::new(&model, model.tip(), true, Preferences::default());
    let mut q = within(&model, &[0.5, 0.4, 0.6, 0.5, 0.4, 0.3, 0.6, 0.7, 0.5]);
    q[0] = model.joints()[0].limits.upper;
    let velocity = Vector6::new(0.2, 0.1, 0.0, 0.0, 0.1, 0.0);
    let change = Vector6::new(0.0, 0.3, 0.1, 0.2, 0.0, 0.0);
    let (mut speeds, mut rates) = ([0.0; 9], [0.0; 9]);
    let wanted = (&velocity, &change);
    search
        .rates(&model, &q, wanted, (&mut speeds, &mut rates))
        .unwrap();
    assert_eq!((speeds[0], rates[0]), (0.0, 0.0));
    let mut data = model.data();
    let jacobian = model.jacobian(&mut data, &q, model.tip()).clone();
    let bias = model.bias_acceleration(&mut data, &q, &speeds, model.tip());
    let moved = &jacobian * DVector::from_column_slice(&speeds);
    let changed = &jacobian * DVector::from_column_slice(&rates);
    assert!((moved - velocity).norm() < 1e-9);
    assert!((changed + bias - change).norm() < 1e-9);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn a_search_reaches_every_pose_of_a_redundant_arm(
        to in prop::collection::vec(0.02..0.98_f64, 9), from in prop::collection::vec(0.0..1.0_f64, 9),
    ) {
        let model = model("testbed9");
        let mut search = Search::new(&model, model.tip(), true, Preferences::default());
        reaches(&model, &mut search, &within(&model, &to), &within(&model, &from))?;
    }

    #[test]
    fn a_search_reaches_every_pose_of_six_axes_that_no_closed_form_knows(
        to in prop::collection::vec(0.02..0.98_f64, 6), from in prop::collection::vec(0.0..1.0_f64, 6),
    ) {
        let model = six_axes();
        let mut search = Search::new(&model, model.tip(), true, Preferences::default());
        reaches(&model, &mut search, &within(&model, &to), &within(&model, &from))?;
    }

    #[test]
    fn all_postures_of_the_closed_form_reach_the_pose(shares in prop::collection::vec(0.02..0.98_f64, 6)) {
        let model = model("puma560");
        let flange = model.frame("flange").unwrap();
        let closed = ClosedForm::of(&model, flange).unwrap();
        let q = within(&model, &shares);
        let near: [f64; 6] = q.clone().try_into().unwrap();
        let mut data = model.data();
        let goal = model.placement(&mut data, &q, flange);
        let found = closed.inverse(&goal, &near).unwrap();
        for solution in &found.all {
            let there = model.placement(&mut data, &solution.joints, flange);
            prop_assert!((there.origin - goal.origin).norm() < 1e-8);
            prop_assert!((there.rotation - goal.rotation).norm() < 1e-7);
        }
    }

    #[test]
    fn one_of_the_postures_is_where_the_pose_came_from_and_following_keeps_it(
        shares in prop::collection::vec(0.0..=1.0_f64, 6),
    ) {
        let (model, closed) = puma560();
        let q: [f64; 6] = within(&model, &shares).try_into().unwrap();
        let forearm = 0.4318_f64.hypot(0.0203);
        let bend = q[2] + 0.4318_f64.atan2(0.0203);
        let outward = 0.4318 * q[1].cos() + forearm * (q[1] + bend).cos();
        prop_assume!(outward.abs() > 1e-3 && bend.sin().abs() > 1e-3 && q[4].sin().abs() > 1e-3);
        let goal = pose(&model, &q);
        let found = closed.inverse(&goal, &q).unwrap();
        for solution in &found.all {
            prop_assert_eq!(closed.branch_of(&solution.joints), solution.branch);
        }
        let best = found.nearest_within(closed.limits(), &q, None).unwrap();
        for (found, given) in best.joints.iter().zip(&q) {
            prop_assert!((found - given).abs() < 1e-9);
        }
        let followed = closed.inverse_branch(&goal, closed.branch_of(&q), &q).unwrap();
        prop_assert_eq!(followed, best.joints);
    }

    #[test]
    fn any_pose_gives_finite_joints_or_a_reason(
        p in prop::array::uniform3(-1.5..1.5_f64), r in prop::array::uniform3(-4.0..4.0_f64),
    ) {
        let (_, closed) = puma560();
        if let Ok(found) = closed.inverse(&Placement::from_radians(p, r), &[0.0; 6]) {
            for solution in &found.all {
                prop_assert!(solution.joints.iter().all(|value| value.is_finite()));
            }
        }
    }
}
