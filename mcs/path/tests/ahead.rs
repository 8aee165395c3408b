//! Looking ahead along motions: what would come too near to something is named, wherever on the way it is, and what a guard lets pass is
//! not refused.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot be set up fails"
)]

use std::sync::Arc;

use ctos::diagnostic::Source;
use mcs::{
    Joints,
    client::{PathKind, Plan, Target},
    model::{Model, Placement, Solid, built_in, file, file::Inertias},
    trajectory::{CartesianLimits, Planner},
};
use mcs_path::{Refused, Space, ahead};
use proptest::prelude::*;

const MARGIN: f64 = 0.02;

/// A ball of 50 mm that two sliding joints move in a square of 2 m.
fn gantry() -> Arc<Model> {
    let text = "name = \"gantry\"\n\
         [[joint]]\nname = \"x\"\nlink = \"bridge\"\ntype = \"prismatic\"\naxis = [1, 0, 0]\n\
         limits = { range = [-1, 1], velocity = 1, acceleration = 2 }\n\
         [[joint]]\nname = \"y\"\nlink = \"ball\"\ntype = \"prismatic\"\naxis = [0, 1, 0]\n\
         limits = { range = [-1, 1], velocity = 1, acceleration = 2 }\n\
         shapes = [{ sphere = [0, 0, 0], radius = 0.05 }]\n";
    Arc::new(file::parse(&Source::new("arm.toml", text), Inertias::Identified).unwrap())
}

fn puma() -> Arc<Model> {
    let model = built_in::model("puma560", Inertias::Engine).unwrap();
    Arc::new(model.unwrap())
}

fn block(name: &str, [x, y, z]: [f64; 3], edges: [f64; 3]) -> (String, Solid) {
    let solid = Solid::Block {
        at: Placement::shifted(x, y, z),
        half: edges.map(|edge| 0.5 * edge).into(),
    };
    (name.to_owned(), solid)
}

fn to(joints: &[f64]) -> Plan {
    Plan {
        target: Target::Joints(Joints::try_from(joints).unwrap()),
        path: PathKind::Joint,
        speed: 0.5,
        acceleration: None,
        elbow: None,
    }
}

struct Eye {
    planner: Planner,
    space: Space,
}

impl Eye {
    fn new(model: &Arc<Model>, room: Vec<(String, Solid)>, near: &[(&str, &str, f64)]) -> Self {
        let near = near.iter();
        let near: Vec<_> = near
            .map(|(solid, piece, off)| ((*solid).to_owned(), (*piece).to_owned(), *off))
            .collect();
        let space = Space::new(Arc::clone(model), Vec::new(), room, MARGIN);
        Self {
            planner: Planner::new(Arc::clone(model), CartesianLimits::default(), 0.018).unwrap(),
            space: space.with_near(&near),
        }
    }

    fn looks(&mut self, from: &[f64], motions: &[Plan]) -> Result<Joints, Refused> {
        let from = Joints::try_from(from).unwrap();
        ahead::look(&mut self.planner, &mut self.space, &from, motions)
    }
}

/// Which motion is refused, and what would meet.
fn meets(seen: Result<Joints, Refused>) -> (usize, [String; 2]) {
    match seen {
        Err(Refused::Touches { motion, touch }) => (motion, touch.pair),
        other => panic!("{other:?}"),
    }
}

/// A crate in the middle of the square.
fn crates() -> Vec<(String, Solid)> {
    vec![block("crate", [0.0; 3], [0.2; 3])]
}

#[test]
fn what_a_motion_would_touch_on_its_way_is_named_with_the_number_of_the_motion() {
    let mut eye = Eye::new(&gantry(), crates(), &[]);
    let seen = eye.looks(&[-0.5, -0.5], &[to(&[-0.5, 0.0]), to(&[0.5, 0.0])]);
    assert_eq!(meets(seen), (2, ["ball".to_owned(), "crate".to_owned()]));
    let around = [to(&[-0.5, 0.5]), to(&[0.5, 0.5]), to(&[0.5, 0.0])];
    assert_eq!(eye.looks(&[-0.5, -0.5], &around).unwrap()[..], [0.5, 0.0]);
    let beyond = eye.looks(&[-0.5, -0.5], &[to(&[-0.5, 0.5]), to(&[2.0, 0.5])]);
    assert!(matches!(beyond, Err(Refused::Unplanned { motion: 2, .. })));
}

#[test]
fn too_many_motions_are_refused_and_not_looked_at() {
    let mut eye = Eye::new(&gantry(), crates(), &[]);
    let many = vec![to(&[-0.5, -0.5]); 65];
    let seen = eye.looks(&[-0.5, -0.5], &many);
    assert!(matches!(seen, Err(Refused::Unplanned { motion: 65, .. })));
    eye.looks(&[-0.5, -0.5], &many[1..]).unwrap();
}

#[test]
fn who_stands_too_near_may_go_away_and_no_nearer_and_only_in_the_first_motion() {
    let mut eye = Eye::new(&gantry(), crates(), &[]);
    let beside = [-0.16, 0.0];
    eye.looks(&beside, &[to(&[-0.5, 0.0])]).unwrap();
    assert_eq!(meets(eye.looks(&beside, &[to(&[-0.155, 0.0])])).0, 1);
    let twice = [to(&[-0.161, 0.0]), to(&[-0.5, 0.0])];
    assert_eq!(meets(eye.looks(&beside, &twice)).0, 2);
}

#[test]
fn a_solid_that_may_be_near_a_piece_of_the_room_reaches_into_it_so_far_and_no_farther() {
    let mut eye = Eye::new(&gantry(), crates(), &[("ball", "crate", -0.02)]);
    eye.looks(&[-0.5, 0.0], &[to(&[-0.131, 0.0])]).unwrap();
    assert_eq!(
        meets(eye.looks(&[-0.5, 0.0], &[to(&[-0.129, 0.0])])).1,
        ["ball", "crate"]
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Known from outside: the way of two sliding joints of the same limits is straight, and the distance of a point from a box is
    /// elementary.
    #[test]
    fn a_motion_is_refused_where_and_only_where_the_ball_comes_nearer_than_the_margin(
        a in prop::array::uniform2(-0.9..0.9), b in prop::array::uniform2(-0.9..0.9),
    ) {
        let off = |[x, y]: [f64; 2]| {
            let out = |way: f64| (way.abs() - 0.1).max(0.0);
            out(x).hypot(out(y)) - 0.05 - MARGIN
        };
        prop_assume!(off(a) > 1e-3);
        let mut eye = Eye::new(&gantry(), crates(), &[]);
        let seen = eye.looks(&a, &[to(&b)]);
        // Each joint has a course of its own: where they differ from a straight way is asked of the planner, densely.
        let route = to(&b).route().unwrap();
        let (segment, _) = eye.planner.segment(&Joints::from(a), &route).unwrap();
        let mut solver = eye.planner.solver().clone();
        let least = (0..=4000).map(|step| {
            let time = segment.duration() * f64::from(step) / 4000.0;
            let at = segment.at(&mut solver, time, &a).unwrap().position;
            off([at[0], at[1]])
        });
        let least = least.fold(f64::INFINITY, f64::min);
        // Between two looks something may be nearer by half of what is looked at.
        if least > 1e-3 {
            prop_assert!(seen.is_ok(), "{seen:?} {least}");
        }
        if least < -0.003 {
            prop_assert!(seen.is_err(), "{least}");
        }
    }
}

#[test]
fn a_straight_line_of_the_tool_is_looked_at_in_its_middle_too() {
    let (left, right) = (
        [-0.7, 0.6, -2.6, 0.0, 0.4, 0.0],
        [0.7, 0.6, -2.6, 0.0, 0.4, 0.0],
    );
    let mut planner = Planner::new(puma(), CartesianLimits::default(), 0.018).unwrap();
    let pose = planner.tool_pose(&right);
    let begin = planner.tool_pose(&left).translation.vector;
    let middle = 0.5 * (begin + pose.translation.vector);
    let rows = pose.to_homogeneous().transpose();
    let line = Plan {
        target: Target::Pose(rows.as_slice().try_into().unwrap()),
        path: PathKind::StraightLine,
        ..to(&right)
    };
    let post = block("post", [middle.x, middle.y, middle.z], [0.02; 3]);
    let mut eye = Eye::new(&puma(), vec![post], &[]);
    let (motion, [_, piece]) = meets(eye.looks(&left, std::slice::from_ref(&line)));
    assert_eq!((motion, piece.as_str()), (1, "post"));
    let mut free = Eye::new(&puma(), vec![block("post", [5.0; 3], [0.02; 3])], &[]);
    free.looks(&left, &[line]).unwrap();
}
