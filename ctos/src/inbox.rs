//! What other threads bring to a processor: one queue, in the order in which it was brought, and the
//! knowledge whether the processor sleeps and must be woken.
//!
//! One lock guards both, so a wake-up cannot be lost between them. The processor takes everything at
//! once, in exchange for an empty buffer. It knows nothing of what it carries.

use crate::concurrent::{AtomicBool, Mutex, MutexGuard, Ordering, PoisonError};

struct State<T> {
    items: Vec<T>,
    /// The processor found nothing and is about to sleep, or sleeps.
    sleeping: bool,
    closed: bool,
}

/// Why an item was not brought.
pub(crate) enum Refused<T> {
    /// It may not be brought now.
    NotNow(T),
    /// The reader is gone.
    Closed(T),
}

/// A queue with many writers and one reader. Away from all that its reader alone writes to: a line of the
/// cache that both cores want is what a message costs most.
#[repr(align(128))]
pub(crate) struct Inbox<T> {
    state: Mutex<State<T>>,
    /// Whether there is something, for a look without the lock. Written under the lock only.
    filled: AtomicBool,
}

impl<T> Default for Inbox<T> {
    fn default() -> Self {
        Self {
            state: Mutex::new(State {
                items: Vec::new(),
                sleeping: false,
                closed: false,
            }),
            filled: AtomicBool::new(false),
        }
    }
}

impl<T> Inbox<T> {
    /// Brings an item. True when the reader sleeps and the caller must wake it; only one is told so.
    ///
    /// # Errors
    /// The item, when the reader is gone.
    pub(crate) fn push(&self, item: T) -> Result<bool, T> {
        self.push_if(item, || true)
            .map_err(|(Refused::NotNow(item) | Refused::Closed(item))| item)
    }

    /// [`Self::push`] if `may` says so, which runs while nobody else brings or takes anything: what it counts
    /// needs no atomic addition.
    ///
    /// # Errors
    /// The item, when it was not brought.
    #[inline]
    pub(crate) fn push_if(&self, item: T, may: impl FnOnce() -> bool) -> Result<bool, Refused<T>> {
        let mut state = self.lock();
        if state.closed {
            return Err(Refused::Closed(item));
        }
        if !may() {
            return Err(Refused::NotNow(item));
        }
        state.items.push(item);
        if !self.filled.load(Ordering::Relaxed) {
            self.filled.store(true, Ordering::Release);
        }
        Ok(std::mem::take(&mut state.sleeping))
    }

    /// Whether there is something to take.
    #[inline]
    pub(crate) fn is_filled(&self) -> bool {
        self.filled.load(Ordering::Acquire)
    }

    /// Exchanges everything there is with the empty `buffer`.
    pub(crate) fn swap(&self, buffer: &mut Vec<T>) {
        let mut state = self.lock();
        std::mem::swap(&mut state.items, buffer);
        state.sleeping = false;
        self.filled.store(false, Ordering::Relaxed);
    }

    /// Announces that the reader sleeps now. False when there is something to do instead. One who wakes
    /// up by itself may be told to wake up once more by whoever brings the next item.
    pub(crate) fn sleep(&self) -> bool {
        let mut state = self.lock();
        state.sleeping = state.items.is_empty() && !state.closed;
        state.sleeping
    }

    /// Takes nothing more; gives back what nobody took.
    pub(crate) fn close(&self) -> Vec<T> {
        let mut state = self.lock();
        state.closed = true;
        self.filled.store(false, Ordering::Relaxed);
        std::mem::take(&mut state.items)
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        // Nothing that can panic runs under the lock, except for the allocation of memory.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
