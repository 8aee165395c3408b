//! Where threads that take more than they give get it back from those that give more than they take: in
//! batches, through one lock. It knows nothing of what it keeps.

use crate::concurrent::{AtomicUsize, Mutex, MutexGuard, Ordering, PoisonError};

/// Batches, and the buffers that earlier ones came in.
struct Batches<T> {
    full: Vec<Vec<T>>,
    empty: Vec<Vec<T>>,
}

/// What threads have too many of.
pub(crate) struct Store<T> {
    batches: Mutex<Batches<T>>,
    /// How many full ones there are, for a look without the lock. Written under it only.
    stored: AtomicUsize,
    /// As many are kept; what is more is dropped.
    most: usize,
}

impl<T> Store<T> {
    /// A store that keeps `most` batches.
    pub(crate) fn new(most: usize) -> Self {
        Self {
            batches: Mutex::new(Batches {
                full: Vec::new(),
                empty: Vec::new(),
            }),
            stored: AtomicUsize::new(0),
            most,
        }
    }

    /// Exchanges the empty `buffer` for a batch, if there is one.
    pub(crate) fn take(&self, buffer: &mut Vec<T>) {
        if self.stored.load(Ordering::Relaxed) == 0 {
            return;
        }
        let mut batches = self.lock();
        if let Some(batch) = batches.full.pop() {
            self.stored.store(batches.full.len(), Ordering::Relaxed);
            let empty = std::mem::replace(buffer, batch);
            if batches.empty.len() < self.most {
                batches.empty.push(empty);
            }
        }
    }

    /// Takes what `buffer` has beyond the first `keep` as a batch, or drops it when there are enough.
    pub(crate) fn give(&self, buffer: &mut Vec<T>, keep: usize) {
        let mut batches = self.lock();
        if batches.full.len() < self.most {
            let mut batch = batches.empty.pop().unwrap_or_default();
            batch.extend(buffer.drain(keep.min(buffer.len())..));
            batches.full.push(batch);
            self.stored.store(batches.full.len(), Ordering::Relaxed);
        } else {
            drop(batches);
            buffer.truncate(keep);
        }
    }

    /// How many batches there are.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.lock().full.len()
    }

    fn lock(&self) -> MutexGuard<'_, Batches<T>> {
        // Nothing that can panic runs under the lock, except for the allocation of a buffer.
        self.batches.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
