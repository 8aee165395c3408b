//! The arm as viewers follow it.

use futures_util::future::{Either, select};
use scene::{Batch, FollowScene, Layer, PERIOD};

use super::*;
use crate::model::Placement;

/// Of the arm, its tool included.
const PARTS: usize = 8;

async fn followed(
    cx: &Context,
    state: &TaskRef,
    after: Option<scene::Mark>,
) -> Result<Batch, HandlerError> {
    let follow = FollowScene {
        after,
        patience_ms: 500,
    };
    asked(cx, state, follow).await
}

/// What a viewer knows: where each part is, and the joint positions.
#[derive(Default)]
struct Viewer {
    poses: Vec<scene::Pose>,
    joints: Vec<f64>,
}

impl Viewer {
    fn take(&mut self, batch: &Batch) {
        self.poses.resize(PARTS + 1, scene::Pose::default());
        self.joints.resize(6, 0.0);
        for moved in &batch.moved {
            let part = moved.part as usize;
            self.poses[part] = moved.pose;
            if let ([position, ..], 1..=6) = (&moved.numbers[..], part) {
                self.joints[part - 1] = *position;
            }
        }
    }

    /// How far the parts are from where forward kinematics puts them, m.
    fn off(&self, model: &crate::model::Model) -> f64 {
        let mut data = model.data();
        model.forward(&mut data, &self.joints);
        let places = (0..6).map(|joint| data.carrier(Some(joint)));
        let distance = |(place, pose): (Placement, &scene::Pose)| {
            let turned = place.isometry().rotation.coords;
            let [x, y, z, w] = pose.turn;
            let same = (turned.x * x + turned.y * y + turned.z * z + turned.w * w).abs();
            (place.origin - nalgebra::Vector3::from(pose.at)).norm() + (1.0 - same)
        };
        let all = places.zip(&self.poses[1..]).map(distance);
        all.fold(0.0, f64::max)
    }
}

/// The ends of the pieces of the way in a view, one after the other.
fn way(view: &scene::View) -> Vec<[f64; 3]> {
    let ways = view.parts.iter().filter(|part| part.kind == "path");
    let solids = ways.flat_map(|part| &part.solids);
    let ends = solids.flat_map(|solid| match solid {
        scene::Solid::Capsule { a, b, .. } => [*a, *b],
        other => panic!("{other:?}"),
    });
    ends.collect()
}

#[test]
fn what_a_guard_forbids_is_drawn_as_long_as_there_is_the_guard() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let state = cx.task("state").await?;
            let drawn = async |after| -> Result<_, HandlerError> {
                let batch = followed(&cx, &state, after).await?;
                let view = batch.view.ok_or("the guards have changed")?;
                let guards = view.parts.iter().filter(|part| part.kind == "guard");
                let told = guards.map(|part| format!("{} {}", part.name, part.solids.len()));
                Ok((told.collect::<Vec<_>>().join(" "), batch.mark))
            };
            let (none, mark) = drawn(None).await?;
            assert_eq!(none, "");
            let table = SetGuard {
                name: "table".to_owned(),
                kind: "workspace".to_owned(),
                args: "keep_out = [{ low = [0.2, -0.5, -inf], high = [0.8, 0.5, 0.1] }]".to_owned(),
                always: true,
                reaction: crate::guard::Reaction::Stop,
            };
            asked(&cx, &mcs, table).await?;
            let (one, mark) = drawn(Some(mark)).await?;
            let name = "table".to_owned();
            asked(&cx, &mcs, RemoveGuard { name }).await?;
            let (gone, _) = drawn(Some(mark)).await?;
            assert_eq!(gone, "");
            Ok(one)
        })
    });
    assert_eq!(text, "guard table 12");
}

#[test]
fn a_viewer_is_told_the_arm_as_a_whole_and_then_where_forward_kinematics_puts_it() {
    let text = text_of(|cx, mcs, _| {
        Box::pin(async move {
            done(&cx, &mcs, Acquire {}).await?;
            let state = cx.task("state").await?;
            let model = built_in_arm("puma560");
            let mut viewer = Viewer::default();
            let first = followed(&cx, &state, None).await?;
            let view = first.view.as_ref().ok_or("the first batch has no view")?;
            let names: Vec<&str> = view.parts.iter().map(|part| part.name.as_str()).collect();
            assert_eq!(view.layer, Layer::Measured);
            assert_eq!(first.moved.len(), PARTS);
            assert!(first.said.as_ref().is_some_and(|said| !said.fault));
            let solids: usize = view.parts.iter().map(|part| part.solids.len()).sum();
            // All of the model's, and the tool's axes.
            assert_eq!(solids, model.shapes().len() + 1);
            viewer.take(&first);
            let from = viewer.poses[PARTS - 1].at;
            let (mut after, mut at, mut batches) = (first.mark, first.at_ns, 0_u32);
            let mut ways = Vec::new();
            let mut moving = Box::pin(done(&cx, &mcs, to(Target::Joints(GOAL.into()))));
            let begun = cx.now();
            loop {
                let next = Box::pin(followed(&cx, &state, Some(after)));
                let batch = match select(moving, next).await {
                    Either::Left((report, _)) => {
                        report?;
                        break;
                    }
                    Either::Right((batch, still)) => {
                        moving = still;
                        batch?
                    }
                };
                ways.extend(batch.view.as_ref().map(way));
                if batch.moved.is_empty() {
                    continue;
                }
                assert!(batch.at_ns - at >= PERIOD.as_nanos() as u64);
                (after, at) = (batch.mark, batch.at_ns);
                batches += 1;
                viewer.take(&batch);
                let off = viewer.off(&model);
                assert!(off < 1e-4, "{off} m after {batches} batches");
            }
            let (took, least) = ((cx.now() - begun).as_secs_f64(), 10.0);
            assert!(f64::from(batches) > least * took, "{batches} in {took} s");

            // What does not change is told once: the arm, and the way that it goes for as long as it does.
            let told = followed(&cx, &state, Some(after)).await?;
            ways.extend(told.view.as_ref().map(way));
            let [way, gone] = &ways[..] else {
                panic!("{ways:?}");
            };
            assert!(gone.is_empty(), "{gone:?}");
            let to = viewer.poses[PARTS - 1].at;
            for (end, told) in [(from, way[0]), (to, way[way.len() - 1])] {
                let apart = nalgebra::Vector3::from(end) - nalgebra::Vector3::from(told);
                assert!(apart.norm() < 1e-3, "{end:?}: {way:?}");
            }

            // One who comes now is told where the arm really is.
            let late = followed(&cx, &state, None).await?;
            viewer.take(&late);
            let stands = asked(&cx, &mcs, ReadPosition {}).await?;
            for (told, read) in viewer.joints.iter().zip(stands.joints.iter()) {
                assert!((told - read).abs() < 1e-4);
            }
            let tool = viewer.poses[PARTS - 1].at;
            for (axis, coordinate) in tool.iter().enumerate() {
                assert!((coordinate - stands.base_t_tool[4 * axis + 3]).abs() < 1e-4);
            }
            Ok(names.join(" "))
        })
    });
    assert_eq!(text, "base link1 link2 link3 link4 link5 link6 tool");
}
