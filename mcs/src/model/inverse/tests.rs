//! The closed form where zero positions and frames are anybody's, and the search where there is none.

use super::*;
use crate::model::{
    JointKind, JointSpec, Limits, Model, ModelBuilder, Placement, built_in, file::Inertias,
};
use nalgebra::Vector3;
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
}
