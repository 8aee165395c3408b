//! The arm as viewers follow it.

use futures_util::future::{Either, select};
use scene::{Batch, FollowScene, Layer, PERIOD};

use super::*;
use crate::model::Placement;

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
        self.poses.resize(PARTS, scene::Pose::default());
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
            let (mut after, mut at, mut batches) = (first.mark, first.at_ns, 0_u32);
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
                assert!(batch.view.is_none(), "what does not change is told once");
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
