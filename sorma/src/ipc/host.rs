//! What the objects of these classes know about the host that they are on.

use super::answer::code;
use crate::report::Report;
use ctos::time::{Clock, Instant};
use sorma_snapshot::{Place, SnapshotError};
use std::path::PathBuf;

/// What the objects of these classes need to know.
#[derive(Debug, Clone)]
pub struct Host {
    /// The app, in whose folder the segments lie.
    pub app: String,
    /// The app's clock.
    pub clock: Clock,
    /// Under which folder; the usual one in shared memory when `None`.
    pub root: Option<PathBuf>,
}

impl Host {
    /// The app of that name, with its segments at the usual place.
    #[must_use]
    pub fn new(app: impl Into<String>, clock: Clock) -> Self {
        Self {
            app: app.into(),
            clock,
            root: None,
        }
    }

    /// The folder of the app's segments.
    ///
    /// # Errors
    /// It is not this user's alone, or cannot be made.
    pub fn place(&self) -> Result<Place, SnapshotError> {
        self.place_of("")
    }

    /// The folder of another app's segments; of this one's when it has no name.
    pub(super) fn place_of(&self, app: &str) -> Result<Place, SnapshotError> {
        let app = if app.is_empty() { &self.app } else { app };
        match &self.root {
            Some(root) => Place::under(root, app),
            None => Place::of_app(app),
        }
    }

    pub(super) fn now(&self) -> Instant {
        self.clock.now()
    }
}

/// The name of the buffer that an object is about: what its settings say, or else its flavor.
pub(super) fn buffer<'a>(said: &'a str, flavor: &'a str) -> &'a str {
    if said.is_empty() { flavor } else { said }
}

#[track_caller]
pub(super) fn buffer_error(error: &SnapshotError) -> Report {
    Report::error(code::BUFFER, error.to_string())
}
