//! What an app was made of: the files that were read, the variables that were asked for, the
//! profiles that were laid on, and the data files that its checks have opened.

use super::load::Read;
use super::node::Entry;
use super::variables::Used;
use crate::diagnostic::{Place, Source};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Kept with an app. Two apps of the same files are equal, whatever was opened since.
#[derive(Debug, Clone, Default)]
pub(crate) struct Trail {
    pub(super) sources: Vec<Read>,
    pub(super) used: Used,
    pub(super) applied: Vec<Entry>,
    opened: Opened,
}

/// The data files opened so far, by the path that names them in the configuration, with their
/// texts. Clones of an app share it, so that what a check opens is known wherever the app is.
type Opened = Arc<Mutex<BTreeMap<String, String>>>;

impl PartialEq for Trail {
    fn eq(&self, other: &Self) -> bool {
        (&self.sources, &self.used, &self.applied) == (&other.sources, &other.used, &other.applied)
    }
}

impl Trail {
    pub(super) fn new(sources: Vec<Read>, used: Used, applied: Vec<Entry>) -> Self {
        Self {
            sources,
            used,
            applied,
            opened: Opened::default(),
        }
    }

    /// The data files opened so far.
    pub(super) fn opened(&self) -> BTreeMap<String, String> {
        let opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        opened.clone()
    }

    pub(super) fn note(&self, relative: &str, source: &Source) {
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        opened.insert(relative.to_owned(), source.text().to_owned());
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
