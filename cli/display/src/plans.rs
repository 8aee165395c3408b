//! Plans: what a task shows of the scene, seen from above and flat, in a pane of its own beside the scene. Kept in the file of
//! displays.
//!
//! ```toml
//! [plan.board]
//! title = "The game as the player knows it"
//! task = "symbols"
//! words = "room"
//! ```

use serde::{Deserialize, Serialize};

/// A plan. The scene leaves out the parts of its task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Plan {
    #[serde(default)]
    pub(crate) title: String,
    /// The task whose parts are drawn, and whose words stand below.
    pub(crate) task: String,
    /// A task whose last words are listed, such as what people hear.
    pub(crate) words: Option<String>,
}

impl Plan {
    /// The tasks that it names.
    pub(crate) fn tasks(&self) -> impl Iterator<Item = &str> {
        [Some(&*self.task), self.words.as_deref()]
            .into_iter()
            .flatten()
    }
}

/// A plan as a page is told of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Named<'p> {
    pub(crate) name: &'p str,
    #[serde(flatten)]
    pub(crate) plan: &'p Plan,
}
