//! Recipes of guards: from the configuration, by message, and as service objects.

use super::*;
use crate::guard::Reaction;

/// The height of the tool, m.
async fn height(cx: &Context, mcs: &TaskRef) -> Result<f64, HandlerError> {
    Ok(asked(cx, mcs, ReadPosition {}).await?.base_t_tool[11])
}

/// Straight down by so much, m.
async fn down(cx: &Context, mcs: &TaskRef, by: f64, guards: &[&str]) -> Result<Move, HandlerError> {
    let mut pose = asked(cx, mcs, ReadPosition {}).await?.base_t_tool;
    pose[11] -= by;
    Ok(Move {
        path: PathKind::StraightLine,
        guards: guards.iter().map(|name| (*name).to_owned()).collect(),
        ..to(Target::Pose(pose))
    })
}

/// A recipe that forbids all below a height, m.
fn table(height: f64, reaction: Reaction) -> SetGuard {
    SetGuard {
        name: "no-table".to_owned(),
        kind: "workspace".to_owned(),
        always: false,
        reaction,
        args: format!("keep_out = [{{ low = [-2, -2, -2], high = [2, 2, {height}] }}]"),
    }
}

#[test]
fn a_motion_that_names_a_guard_is_ended_by_it_with_its_name_and_what_it_measured() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let start = height(&cx, &mcs).await?;
            let order = down(&cx, &mcs, 0.2, &["no-table"]).await?;
            let unknown = error_of(&cx, &mcs, order.clone()).await?;
            assert_eq!(unknown.outcome, Outcome::Refused);
            assert!(
                unknown.reason.contains("no guard `no-table` (it has none)"),
                "{unknown}"
            );
            asked(&cx, &mcs, table(start - 0.1, Reaction::Stop)).await?;
            let ended = error_of(&cx, &mcs, order.clone()).await?;
            assert_eq!(ended.outcome, Outcome::Guard, "{ended}");
            assert!(
                ended
                    .reason
                    .starts_with("guard `no-table` ended it: the tool at ")
                    && ended.reason.contains("would come into keep-out box 1"),
                "{ended}"
            );
            let stopped = height(&cx, &mcs).await?;
            assert!(
                (start - 0.1005..start - 0.08).contains(&stopped),
                "{stopped} {start}"
            );
            // Who looks on is told the same.
            let state = cx.task("state").await?;
            let follow = scene::FollowScene {
                after: None,
                patience_ms: 0,
            };
            let said = asked(&cx, &state, follow).await?.said;
            let words = said.map(|said| said.words).unwrap_or_default();
            assert!(
                words.contains("guard `no-table` ends its motion: the tool at"),
                "{words}"
            );
            // The setpoint stays above the box; the arm is off by its tracking error.
            //
            // Another height from now on; and one who does not name it is not watched.
            asked(&cx, &mcs, table(start - 0.15, Reaction::Stop)).await?;
            error_of(&cx, &mcs, order).await?;
            let deeper = height(&cx, &mcs).await?;
            assert!(
                (start - 0.1505..start - 0.13).contains(&deeper),
                "{deeper} {start}"
            );
            let order = down(&cx, &mcs, 0.03, &[]).await?;
            done(&cx, &mcs, order).await?;
            assert!(height(&cx, &mcs).await? < start - 0.15);
            let guards = asked(&cx, &mcs, ReadGuards {}).await?;
            assert_eq!(guards.recipes[0].name, "no-table");
            assert_eq!(guards.last.map(|last| last.reaction), Some(Reaction::Stop));
            asked(
                &cx,
                &mcs,
                RemoveGuard {
                    name: "no-table".to_owned(),
                },
            )
            .await?;
            assert!(asked(&cx, &mcs, ReadGuards {}).await?.recipes.is_empty());
            Ok(String::new())
        })
    });
}

#[test]
fn after_a_retreat_the_tool_is_where_all_was_well() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let start = height(&cx, &mcs).await?;
            asked(&cx, &mcs, table(start - 0.1, Reaction::Retreat)).await?;
            let order = down(&cx, &mcs, 0.2, &["no-table"]).await?;
            let ended = error_of(&cx, &mcs, order).await?;
            assert_eq!(ended.outcome, Outcome::Guard, "{ended}");
            assert!(
                ended
                    .reason
                    .ends_with("; the arm went back to where all was well"),
                "{ended}"
            );
            let back = height(&cx, &mcs).await?;
            let last = asked(&cx, &mcs, ReadGuards {})
                .await?
                .last
                .ok_or("nothing was found")?;
            let there = asked(&cx, &mcs, ReadPosition {}).await?.joints;
            for (found, wanted) in there.iter().zip(&last.allowed) {
                assert!((found - wanted).abs() < 1e-3);
            }
            // It had been quick, so that the way to rest was long.
            assert!(back > start - 0.097, "{back} {start}");
            // It is held as before, by whom it was held, and the next motion may begin at once.
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!((status.state, status.stopped), (State::Motion, false));
            assert_eq!(status.holder.as_deref(), Some("user"));
            let order = down(&cx, &mcs, 0.1, &["no-table"]).await?;
            let again = error_of(&cx, &mcs, order).await?;
            assert_eq!(again.outcome, Outcome::Guard, "{again}");
            let lower = height(&cx, &mcs).await?;
            let order = down(&cx, &mcs, -0.05, &["no-table"]).await?;
            done(&cx, &mcs, order).await?;
            assert!((height(&cx, &mcs).await? - lower - 0.05).abs() < 2e-3);
            Ok(String::new())
        })
    });
}

#[test]
fn an_emergency_stop_in_a_retreat_leaves_the_arm_where_it_is_and_is_what_the_mover_is_told() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let start = height(&cx, &mcs).await?;
            asked(&cx, &mcs, table(start - 0.1, Reaction::Retreat)).await?;
            let order = down(&cx, &mcs, 0.2, &["no-table"]).await?;
            let press = async {
                // Up again: it goes back.
                let (mut lowest, mut now) = (start, start);
                while now < lowest + 2e-4 {
                    cx.sleep(Duration::from_millis(9)).await;
                    now = height(&cx, &mcs).await?;
                    lowest = lowest.min(now);
                }
                asked(&cx, &mcs, EmergencyStop {}).await?;
                cx.sleep(Duration::from_millis(9)).await;
                height(&cx, &mcs).await
            };
            let moving = error_of(&cx, &mcs, order);
            let (pressed, moved) = futures_util::future::join(press, moving).await;
            let (pressed, moved) = (pressed?, moved?);
            assert_eq!(moved.outcome, Outcome::Estopped, "{moved}");
            let status = asked(&cx, &mcs, Status {}).await?;
            assert_eq!((status.state, status.holder), (State::Estopped, None));
            cx.sleep(Duration::from_secs(2)).await;
            let later = height(&cx, &mcs).await?;
            assert!((later - pressed).abs() < 1e-4, "{pressed} {later}");
            let last = asked(&cx, &mcs, ReadGuards {}).await?.last;
            let last = last.ok_or("nothing was found")?;
            let there = asked(&cx, &mcs, ReadPosition {}).await?.joints;
            let mut pairs = there.iter().zip(&last.allowed);
            assert!(pairs.any(|(found, allowed)| (found - allowed).abs() > 5e-3));
            Ok(String::new())
        })
    });
}

#[test]
fn a_recipe_of_the_dictionary_watches_the_motions_of_who_names_its_object() {
    text_of(|cx, mcs, _| {
        Box::pin(async move {
            let start = height(&cx, &mcs).await?;
            let add = format!(
                "dict CTRL -add wspc.noTable '-keepout -2 -2 -2 2 2 {}'",
                start - 0.1
            );
            assert!(told(&cx, &add).await?.is_ok());
            told(&cx, "mvpos CTRL -guards wspc.noTable -path line").await?;
            let moved = told(&cx, "mvpos EXEC shift FMSG 6 0 0 -0.2 0 0 0").await?;
            let text = &moved.reports[0].text;
            assert!(
                text.starts_with("guard `noTable` ended it: "),
                "{:?}",
                moved.reports
            );
            assert!(height(&cx, &mcs).await? > start - 0.1);
            let list = told(&cx, "wspc EXEC list").await?.text;
            assert!(
                list.starts_with("noTable: workspace, when named, stop\nlast found, by noTable"),
                "{list}"
            );
            // It is changed while it is in use, and taken away.
            told(
                &cx,
                &format!("wspc.noTable CTRL -above 0 0 1 {}", start - 0.12),
            )
            .await?;
            told(&cx, "wspc.noTable CTRL -keepout -1 -1 -1 1 1 0").await?;
            let moved = told(&cx, "mvpos EXEC shift FMSG 6 0 0 -0.2 0 0 0").await?;
            let text = &moved.reports[0].text;
            assert!(text.contains("below half-space 1"), "{text}");
            assert!(told(&cx, "wspc.noTable EXEC remove").await?.is_ok());
            assert_eq!(told(&cx, "wspc EXEC list").await?.text.lines().count(), 1);
            // One that forbids nothing is refused, before anything moves.
            told(&cx, "mvpos CTRL -guards wspc.empty").await?;
            let moved = told(&cx, "mvpos EXEC shift FMSG 6 0 0 0.1 0 0 0").await?;
            let all: Vec<&str> = moved
                .reports
                .iter()
                .map(|report| report.text.as_str())
                .collect();
            assert!(
                all.iter()
                    .any(|text| text.contains("guard `empty`: it forbids nothing")),
                "{all:?}"
            );
            Ok(String::new())
        })
    });
}

/// A guard of the configuration that forbids all above a height.
const LOW: [&str; 2] = [
    "task.servo.args.guards.low.kind=workspace",
    "task.servo.args.guards.low.args.above=[{normal=[0,0,-1],at=-0.5}]",
];

#[test]
fn a_guard_of_the_configuration_always_watches_and_cannot_be_taken_away() {
    let script: Script = |cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            // The tool is above the height already, and may come down only.
            let order = down(&cx, &mcs, -0.05, &[]).await?;
            let ended = error_of(&cx, &mcs, order).await?;
            assert_eq!(ended.outcome, Outcome::Guard, "{ended}");
            let order = down(&cx, &mcs, 0.05, &[]).await?;
            done(&cx, &mcs, order).await?;
            let remove = RemoveGuard {
                name: "low".to_owned(),
            };
            let refused = cx.call(&mcs, remove).await.map_err(|error| error.reason());
            assert!(
                refused
                    .unwrap_err()
                    .contains("stands in the configuration of `servo`")
            );
            Ok(String::new())
        })
    };
    let outcome = run(script, &Arc::default(), &LOW);
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}

#[test]
fn a_recipe_that_is_wrong_is_found_before_anything_starts() {
    assert_eq!(findings_of(&LOW), "");
    for (set, expected) in [
        (
            "kind=wrkspace",
            "nobody registered the kind of guard `wrkspace`",
        ),
        ("args.radius=-1", "`radius` is 0 to 1 m, not -1"),
        ("args.inside=3", "inside"),
    ] {
        let set = format!("task.servo.args.guards.low.{set}");
        let found = findings_of(&[LOW[0], LOW[1], &set]);
        assert!(
            found.contains("guard `low`: ") && found.contains(expected),
            "{found}"
        );
    }
}
