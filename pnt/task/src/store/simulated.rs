//! A store in the memory of a simulated host. A commit takes a while, as on a disk. A process that
//! dies meanwhile leaves all of it or nothing, by chance drawn from the run's seed.

use std::{
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use ctos::{disk::Disk, mix, task::Context};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::{Change, Contents, Owner, StoreError, apply};

/// How long a commit takes, ns: that of a disk that really writes.
const COMMIT_NS: std::ops::Range<u64> = 200_000..4_000_000;

#[derive(Default)]
pub(super) struct Simulated {
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    owner: Option<Owner>,
    contents: Contents,
    /// The commit under way.
    pending: Option<Vec<Change>>,
    /// Commits begun so far.
    commits: u64,
}

impl Simulated {
    pub(super) fn open(disk: &Disk, path: &Path, owner: &Owner) -> Result<Arc<Self>, StoreError> {
        let damaged = || StoreError::Damaged {
            path: path.to_owned(),
            reason: "it is another kind of file".to_owned(),
        };
        let file: Arc<Self> = disk.open(path).ok_or_else(damaged)?;
        let mut inner = file.inner();
        let found = inner.owner.get_or_insert_with(|| owner.clone());
        if found != owner {
            return Err(StoreError::Foreign {
                path: path.to_owned(),
                found: found.to_string(),
                expected: owner.to_string(),
            });
        }
        drop(inner);
        Ok(file)
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What a process finds that starts now: the one that had a commit under way is gone.
    pub(super) fn load(&self, cx: &Context) -> Contents {
        let mut inner = self.inner();
        if let Some(changes) = inner.pending.take() {
            let number = inner.commits.to_string();
            let words = [cx.name(), "torn commit", number.as_str()];
            let mut coin = ChaCha8Rng::seed_from_u64(mix(cx.app().seed, &words));
            if coin.random_bool(0.5) {
                apply(&mut inner.contents, changes);
            }
        }
        inner.contents.clone()
    }

    pub(super) async fn commit(&self, cx: &Context, changes: Vec<Change>) {
        let takes = {
            let mut inner = self.inner();
            inner.commits += 1;
            inner.pending = Some(changes);
            let number = inner.commits.to_string();
            let words = [cx.name(), "commit", number.as_str()];
            let mut rng = ChaCha8Rng::seed_from_u64(mix(cx.app().seed, &words));
            Duration::from_nanos(rng.random_range(COMMIT_NS))
        };
        cx.sleep(takes).await;
        let mut inner = self.inner();
        if let Some(changes) = inner.pending.take() {
            apply(&mut inner.contents, changes);
        }
    }
}
