//! Which app: its file, and what the command line chooses and overrides.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Which app: its file, and what the command line chooses and overrides.
///
/// The same selection makes the same app in any process with the same environment. So a child
/// process of an app is given it and reads the app again.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Selection {
    /// The app's file.
    pub file: PathBuf,
    /// The profiles, the later ones on top; without any, `app.profile` chooses one.
    pub profiles: Vec<String>,
    /// The `--set` texts, the later ones on top.
    pub sets: Vec<String>,
}

impl Selection {
    /// The app of `file` as it is written.
    #[must_use]
    pub fn new(file: impl Into<PathBuf>) -> Self {
        Self {
            file: file.into(),
            ..Self::default()
        }
    }
}
