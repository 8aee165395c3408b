//! Arcs, arches and blends through the client interface.

use super::*;

/// The pose of the tool now, shifted, in the base frame.
async fn beside(cx: &Context, mcs: &TaskRef, by: [f64; 3]) -> Result<[f64; 16], HandlerError> {
    let mut pose = asked(cx, mcs, ReadPosition {}).await?.base_t_tool;
    for (index, by) in by.into_iter().enumerate() {
        pose[4 * index + 3] += by;
    }
    Ok(pose)
}

#[test]
fn the_client_moves_in_arcs_and_arches_and_is_told_of_the_smallest_singular_value() {
    let text = text_of(|cx, _, _| {
        Box::pin(async move {
            let mcs = cx.task("mcs").await?;
            let arm = Manipulator::find(&cx, "mcs").await?;
            arm.acquire().await?;
            let patience = Duration::from_secs(30);
            let mut told = Vec::new();
            let goal = beside(&cx, &mcs, [0.0, 0.1, 0.0]).await?;
            let via = beside(&cx, &mcs, [0.0, 0.05, 0.05]).await?;
            let via = [via[3], via[7], via[11]];
            told.push(arm.arc(via, to(Target::Pose(goal)), patience).await?);
            let goal = beside(&cx, &mcs, [0.0, -0.08, 0.0]).await?;
            let centre = beside(&cx, &mcs, [0.0, -0.04, 0.03]).await?;
            let about = ([centre[3], centre[7], centre[11]], false);
            told.push(
                arm.arc_about(about, to(Target::Pose(goal)), patience)
                    .await?,
            );
            let goal = beside(&cx, &mcs, [0.05, 0.1, 0.02]).await?;
            let arch = arm.arch(0.05, to(Target::Pose(goal)), patience).await?;
            told.push(arch);
            let there = asked(&cx, &mcs, ReadPosition {}).await?.base_t_tool;
            for index in [3, 7, 11] {
                assert!((there[index] - goal[index]).abs() < 1e-3);
            }
            for report in told {
                let smallest = report.smallest_singular_value.unwrap();
                assert!(smallest > 1e-3 && smallest < 1.0, "{smallest}");
                assert!(report.max_tracking_error_rad < 8e-3, "{report:?}");
            }
            let joints = arm.go(to(Target::Joints(GOAL.into())), patience).await?;
            assert_eq!(joints.smallest_singular_value, None);
            let high = Move {
                path: PathKind::Arch {
                    height: 2.0,
                    corner: None,
                },
                ..to(Target::Pose(goal))
            };
            let error = arm.go(high, patience).await.unwrap_err();
            assert_eq!(error.outcome, Outcome::Unreachable, "{error}");
            let flat = Move {
                path: PathKind::Arch {
                    height: 0.0,
                    corner: None,
                },
                ..to(Target::Pose(goal))
            };
            let error = arm.go(flat, patience).await.unwrap_err();
            assert_eq!(error.outcome, Outcome::Refused, "{error}");
            Ok(error.reason)
        })
    });
    assert_eq!(text, "the height of an arch is above 0 m, not 0");
}

#[test]
fn a_solver_that_nobody_has_and_one_for_other_arms_are_findings() {
    let sets = |inverse: &str| findings_of(&[&format!("task.servo.args.inverse={inverse}")]);
    assert_eq!(sets("search"), "");
    assert_eq!(sets("closed_form"), "");
    let found = sets("closed-form");
    assert!(found.contains("did you mean `closed_form`?"), "{found}");
    let inverse = "task.servo.args.inverse=closed_form";
    let found = findings_of(&[ON_CART[0], ON_CART[1], inverse]);
    assert!(found.contains("is not for the arm `testbed9`"), "{found}");
}
