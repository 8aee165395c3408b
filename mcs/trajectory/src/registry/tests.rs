//! Path planners and solvers by name.

use super::*;
use crate::{CartesianLimits, PathKind, Route, Solver};
use mcs_model::{built_in, file::Inertias};
use nalgebra::{Translation3, Vector3};

const READY: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];

fn model() -> Arc<Model> {
    let model = built_in::model("puma560", Inertias::Identified);
    Arc::new(model.unwrap().unwrap())
}

fn planner() -> Planner {
    Planner::new(model(), CartesianLimits::default(), 0.018).unwrap()
}

fn route(goal: Isometry3<f64>, path: PathKind) -> Route {
    Route {
        goal: Goal::Pose(goal),
        path,
        pace: Pace::from(0.5),
        elbow: None,
    }
}

fn named(name: &str, numbers: &[f64]) -> PathKind {
    PathKind::Named {
        name: name.parse().unwrap(),
        numbers: Joints::try_from(numbers).unwrap(),
    }
}

#[test]
fn a_path_planner_of_ones_own_is_a_function_and_a_name() {
    let mut planning = PlanningRegistry::new();
    planning.path("above", |planner, request| {
        let [height] = request.exactly()?;
        let goal = Translation3::new(0.0, 0.0, height) * request.pose(planner)?;
        planner.line(request.start, &goal, request.pace)
    });
    let mut planner = planner().offering(Arc::new(planning));
    let start = Joints::from(READY);
    let goal = Translation3::new(0.0, 0.1, 0.0) * planner.tool_pose(&start);
    let (_, end) = planner
        .segment(&start, &route(goal, named("above", &[0.05])))
        .unwrap();
    let above = planner.tool_pose(&end).translation.vector - goal.translation.vector;
    assert!((above - Vector3::new(0.0, 0.0, 0.05)).norm() < 1e-8);
    let wrong = planner.segment(&start, &route(goal, named("above", &[])));
    let numbers = PlanError::Numbers {
        needed: 1,
        given: 0,
    };
    assert_eq!(wrong.unwrap_err(), numbers);
    let wrong = planner.segment(&start, &route(goal, named("below", &[])));
    let text = wrong.unwrap_err().to_string();
    assert!(text.contains("no path planner `below`"), "{text}");
    assert!(
        "a name of so many letters that it is none"
            .parse::<Name>()
            .is_err()
    );
}

#[test]
fn what_is_built_in_has_a_name_too_and_does_the_same_by_it() {
    let mut planner = planner();
    let start = Joints::from(READY);
    let from = planner.tool_pose(&start);
    let goal = Translation3::new(0.05, 0.1, 0.0) * from;
    let via = Translation3::new(0.0, 0.06, 0.04) * from;
    let via: [f64; 3] = via.translation.vector.into();
    let (height, corner) = (0.05, Some(0.02));
    for (typed, name, numbers) in [
        (PathKind::Joint, "joint", &[][..]),
        (PathKind::StraightLine, "line", &[]),
        (PathKind::Arc { through: via }, "arc", &via),
        (PathKind::Arch { height, corner }, "arch", &[0.05, 0.02]),
    ] {
        let [typed, by_name] = [typed, named(name, numbers)].map(|path| {
            let (segment, end) = planner.segment(&start, &route(goal, path)).unwrap();
            (segment.duration(), end)
        });
        assert_eq!(typed, by_name, "{name}");
    }
}

#[test]
fn a_solver_is_found_by_its_name_and_the_search_reaches_what_the_closed_form_does() {
    let planning = PlanningRegistry::new();
    assert!(planning.solver("guess", &model()).is_none());
    let nine = built_in::model("testbed9", Inertias::Identified);
    let nine = Arc::new(nine.unwrap().unwrap());
    assert!(planning.solver("closed_form", &nine).unwrap().is_none());
    let start = Joints::from(READY);
    for name in ["closed_form", "search"] {
        let inverse = planning.solver(name, &model()).unwrap().unwrap();
        let solver = Solver::by(model(), inverse).unwrap();
        let mut planner = planner().solving_by(solver);
        let goal = Translation3::new(0.05, 0.1, 0.0) * planner.tool_pose(&start);
        let line = planner.line(&start, &goal, 0.5).unwrap();
        let end = line.end(&mut planner.solver).unwrap();
        let off = planner.tool_pose(&end).translation.vector - goal.translation.vector;
        assert!(off.norm() < 1e-8, "{name}");
    }
}
