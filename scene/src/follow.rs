//! The follower's end of the stream.

use std::time::Duration;

use ctos::{
    Command as _,
    config::App,
    registry::Registry,
    task::{Context, HandlerError, TaskRef},
};

use crate::{Batch, FollowScene, Mark};

/// The handler that records what tasks show, where an app has it; else displays do.
pub const RECORDER: &str = "scene.viewers";
/// How long a task waits for something to change before it answers.
const PATIENCE_MS: u32 = 2_000;
/// A task that does not answer for so long is gone. It may be waiting for an arm to come to rest.
const SILENCE: Duration = Duration::from_secs(20);
/// How long after a task was lost it is looked for again.
pub const RETRY: Duration = Duration::from_millis(500);

/// The tasks of an app that show something.
#[must_use]
pub fn sources(app: &App, registry: &Registry) -> Vec<String> {
    let shows = |handler: &str| {
        let kind = registry.kind(handler);
        kind.is_some_and(|kind| kind.command(FollowScene::INFO.name).is_some())
    };
    let tasks = app.tasks.iter().filter(|task| shows(&task.handler));
    tasks.map(|task| task.name.clone()).collect()
}

/// Follows what one task shows.
pub struct Follower {
    cx: Context,
    source: String,
    reached: Option<(TaskRef, Option<Mark>)>,
}

impl Follower {
    /// A follower of task `source`, for a part of the task `cx`.
    #[must_use]
    pub fn new(cx: &Context, source: &str) -> Self {
        Self {
            cx: cx.clone(),
            source: source.to_owned(),
            reached: None,
        }
    }

    /// The task that is followed.
    #[must_use]
    pub fn source(&self) -> &str {
        &self.source
    }

    /// What has changed since the last call: everything after the first one and after an error.
    ///
    /// # Errors
    /// The task is not there, or does not answer. Try again after [`RETRY`].
    pub async fn next(&mut self) -> Result<Batch, HandlerError> {
        let (to, after) = match self.reached.take() {
            Some(reached) => reached,
            None => (self.cx.task(&self.source).await?, None),
        };
        let follow = FollowScene {
            after,
            patience_ms: PATIENCE_MS,
        };
        let batch = self.cx.call(&to, follow).deadline(SILENCE).await?;
        self.reached = Some((to, Some(batch.mark)));
        Ok(batch)
    }
}
