//! Stable storage: what a net, a data object manager or any durable task must still know after its process has died.
//!
//! A store is a small map from names to bytes that changes by whole commits. After a crash it holds all of
//! a commit or nothing of it. In real time it is a redb file, written and synced by a thread of its own, so
//! that no processor waits for the disk. In virtual time it is in the memory of the simulated host. Nobody
//! else may see what led to a commit before the commit has ended.
//!
//! It knows no net: what the bytes mean is up to its owner.

mod file;
mod simulated;
mod states;

use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
    sync::Arc,
};

use ctos::task::Context;

use file::File;
use simulated::Simulated;
pub use states::keep_states;

/// The version of the form of a store's file, and of what nets write into it.
pub const FORMAT: u32 = 2;

/// Everything that a store holds.
pub type Contents = BTreeMap<String, Vec<u8>>;

/// A change of a store: the value of a name, or none any more.
pub type Change = (String, Option<Vec<u8>>);

/// Whose store it is. Another owner's file is refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Owner {
    /// What it is: `net`, `dom` or `task`.
    pub kind: String,
    /// Its task's name.
    pub name: String,
}

impl fmt::Display for Owner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} `{}`", self.kind, self.name)
    }
}

/// Why a store could not be opened, read or written. What it held before is as it was.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// The file could not be read or written.
    #[error("{}: {what}: {reason}", .path.display())]
    Failed {
        /// The file.
        path: PathBuf,
        /// What was attempted.
        what: &'static str,
        /// What the system or the database said.
        reason: String,
    },
    /// The file is not a store, or is damaged.
    #[error("{} cannot be read as a store ({reason}); nothing of it was used: move it away to begin afresh", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What the database said.
        reason: String,
    },
    /// The file belongs to somebody else.
    #[error("{} holds the state of {found}, not of {expected}: give this one another `store` folder, or move the file away", .path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Whose it is.
        found: String,
        /// Whose it should be.
        expected: String,
    },
    /// The file was written by another version.
    #[error("{} is a store of format {found}, and this program reads format {FORMAT}: use the program that wrote it, or move the file away", .path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: String,
    },
    /// As the record of a replay says.
    #[error("{0}")]
    Recorded(String),
    /// Another process has it open.
    #[error("{} is in use by another process: is the app running already?", .path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
}

/// An open store.
pub struct Store {
    path: PathBuf,
    kind: Kind,
}

enum Kind {
    File(File),
    Simulated(Arc<Simulated>),
    /// The record tells what it held and when it was written.
    Recorded,
}

impl Store {
    /// Opens the store of `owner` at `path`, or makes it. A task that is built anew in the same process
    /// gets the store that its predecessor had.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn open(cx: &Context, path: &Path, owner: &Owner) -> Result<Arc<Self>, StoreError> {
        let key = format!("pnt::store {}", path.display());
        // No other task has this file.
        if let Some(open) = cx.chassis().shared::<Self>(&key) {
            return Ok(open);
        }
        let kind = match cx.disk() {
            _ if cx.is_replay() => Kind::Recorded,
            Some(disk) => Kind::Simulated(Simulated::open(&disk, path, owner)?),
            None => Kind::File(File::open(path, owner)?),
        };
        let path = path.to_owned();
        let store = Arc::new(Self { path, kind });
        cx.chassis().share(&key, Arc::clone(&store));
        Ok(store)
    }

    /// Its file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Everything that it holds. Waits for commits that are under way; for the start of a task.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn load(&self, cx: &Context) -> Result<Contents, StoreError> {
        let loaded = cx.outside("what its store holds", || {
            let loaded = match &self.kind {
                Kind::File(file) => file.load(),
                Kind::Simulated(simulated) => Ok(simulated.load(cx)),
                Kind::Recorded => Ok(Contents::new()),
            };
            loaded.map_err(|error| error.to_string())
        });
        loaded.map_err(StoreError::Recorded)
    }

    /// Makes changes, all or none, and waits until they survive everything. Commits are made in the
    /// order in which they are called.
    ///
    /// # Errors
    /// When they could not be written.
    pub async fn commit(&self, cx: &Context, changes: Vec<Change>) -> Result<(), StoreError> {
        let committed = cx.outside_wait("that its store has taken changes", async {
            match &self.kind {
                Kind::File(file) => file
                    .commit(changes)
                    .await
                    .map_err(|error| error.to_string()),
                Kind::Simulated(simulated) => {
                    simulated.commit(cx, changes).await;
                    Ok(())
                }
                Kind::Recorded => Ok(()),
            }
        });
        committed.await.map_err(StoreError::Recorded)
    }
}

impl fmt::Debug for Store {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Store({})", self.path.display())
    }
}

/// Applies changes.
fn apply(contents: &mut Contents, changes: Vec<Change>) {
    for (name, value) in changes {
        match value {
            Some(value) => contents.insert(name, value),
            None => contents.remove(&name),
        };
    }
}
