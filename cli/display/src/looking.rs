//! Follows what tasks show of the scene: poses and pictures. Pictures are encoded here, on the display's processor.

use std::time::Duration;

use ctos::{
    Command as _,
    task::{Context, Handled},
};
use scene::FollowScene;

use super::{
    hub::Hub,
    scenes::{SceneStep, Shown},
};

/// How long a task waits for something to change before it answers.
const PATIENCE_MS: u32 = 2_000;
/// A task that does not answer for so long is gone. It may be waiting for an arm to come to rest.
const SILENCE: Duration = Duration::from_secs(20);
/// How long after a task was lost it is looked for again.
const RETRY: Duration = Duration::from_millis(500);

/// The tasks that show something.
pub(super) fn sources(cx: &Context) -> Vec<String> {
    let registry = cx.registry();
    let shows = |handler: &str| {
        let kind = registry.kind(handler);
        kind.is_some_and(|kind| kind.command(FollowScene::INFO.name).is_some())
    };
    let tasks = cx.app().tasks.iter().filter(|task| shows(&task.handler));
    tasks.map(|task| task.name.clone()).collect()
}

/// Follows one task for good, through the end and the return of its chassis.
pub(super) async fn follow(cx: &Context, source: &str, hub: &Hub) {
    loop {
        if let Err(error) = stream(cx, source, hub).await {
            hub.dark(source, &error.to_string());
            cx.sleep(RETRY).await;
        }
    }
}

async fn stream(cx: &Context, source: &str, hub: &Hub) -> Handled {
    let to = cx.task(source).await?;
    let mut after = None;
    let mut recorders = None;
    loop {
        let follow = FollowScene {
            after,
            patience_ms: PATIENCE_MS,
        };
        let mut batch = cx.call(&to, follow).deadline(SILENCE).await?;
        after = Some(batch.mark);
        let pictures = std::mem::take(&mut batch.pictures);
        let step = hub.showed(source, SceneStep::new(&batch));
        if cx.is_recording() {
            let channel = format!("/scene/{source}");
            // Each record begins with the whole.
            if recorders.replace(cx.recorders()) != Some(cx.recorders()) {
                cx.record(&channel, &hub.scene(source));
            } else if let Some(step) = step {
                cx.record(&channel, &step);
            }
        }
        for picture in pictures {
            let shown = Shown::new(picture)?;
            if cx.is_recording() {
                cx.record(&format!("/picture/{}", shown.camera), &shown);
            }
            hub.pictured(shown);
        }
    }
}
