//! How the crates of the runtime take a lock.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// A lock that ignores poisoning: no code of the runtime that holds a lock leaves its data
/// half changed when it panics.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
