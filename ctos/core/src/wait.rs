//! What a task waits for in one call, as others see it.

use std::sync::Arc;

use crate::statistics::Activity;
use ctos_message::Tid;
use ctos_time::Instant;

/// What a task waits for in one call. Shown from [`Self::show`] until it is dropped.
pub(crate) struct Wait {
    pub(crate) activity: Arc<Activity>,
    /// The asked task.
    pub(crate) to: Arc<str>,
    pub(crate) tid: Tid,
    pub(crate) command: &'static str,
    pub(crate) place: Option<usize>,
}

impl Wait {
    /// Shows what the task waits for.
    pub(crate) fn show(&mut self, since: Instant) {
        if self.place.is_none() {
            let waits = &self.activity.waits;
            self.place = Some(waits.begin(self.to.clone(), self.tid, self.command, since));
        }
    }
}

impl Drop for Wait {
    fn drop(&mut self) {
        if let Some(place) = self.place {
            self.activity.waits.end(place);
        }
    }
}
