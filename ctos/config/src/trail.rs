//! What an app was made of: the files that were read, and the variables that were looked up. Also
//! the profiles that were applied, and the data files that its checks opened.

use super::node::Entry;
use super::variables::Used;
use crate::diagnostic::Place;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Kept with an app.
#[derive(Debug, Clone, Default)]
pub(crate) struct Trail {
    pub(super) used: Used,
    pub(super) applied: Vec<Entry>,
    /// The folders of the files that were read, the app's own first.
    pub(super) folders: Vec<PathBuf>,
    /// Clones of an app share it, so that what a check opens is known wherever the app is.
    /// By the paths as they were put together.
    pub(super) read: Arc<Mutex<BTreeMap<PathBuf, Read>>>,
}

/// A file that was read.
#[derive(Debug, Clone)]
pub(crate) struct Read {
    pub(super) text: String,
    /// Whether it is named by an absolute path.
    pub(super) absolute: bool,
}

/// Two apps of the same tree are equal, whatever was opened since.
impl PartialEq for Trail {
    fn eq(&self, other: &Self) -> bool {
        (&self.used, &self.applied) == (&other.used, &other.applied)
    }
}

impl Trail {
    /// Every file that was read so far.
    pub(super) fn read(&self) -> MutexGuard<'_, BTreeMap<PathBuf, Read>> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Where a value of an app comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// No file says anything: it is the runtime's default.
    Default,
    /// A file.
    File(Place),
    /// A profile in a file.
    Profile {
        /// The profile's name.
        name: String,
        /// Where it says so.
        place: Place,
    },
    /// A `--set`.
    Set(Place),
}
