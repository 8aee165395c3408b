//! Follows what tasks show of the scene: poses and pictures. Pictures are encoded here, on the display's processor.

use ctos::task::{Context, Handled};
use scene::{
    follow::{Follower, RECORDER, RETRY},
    track::{SceneStep, Shown},
};

use super::hub::Hub;

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
    let mut follower = Follower::new(cx, source);
    // A task that is there for it records what everybody shows.
    let app = cx.app();
    let records = !app.tasks.iter().any(|task| task.handler == RECORDER);
    let mut recorders = None;
    loop {
        let mut batch = follower.next().await?;
        let pictures = std::mem::take(&mut batch.pictures);
        let step = hub.showed(source, SceneStep::new(&batch));
        let records = records && cx.is_recording();
        if records {
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
            if records {
                cx.record(&format!("/picture/{}", shown.camera), &shown);
            }
            hub.pictured(shown);
        }
    }
}
