//! Who is woken: a future of a processor by its number, anything else by its waker.

use std::{num::NonZeroU64, task::Waker};

/// Names one future among all that a processor has ever run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct FutureId {
    pub(super) generation: NonZeroU64,
    pub(super) index: u32,
}

/// What a future of this processor is woken by. Free of atomics when the future is a task's own.
#[derive(Clone)]
pub(crate) enum LocalWake {
    /// It is polled again.
    Future(FutureId),
    /// The future that polls it within itself is woken.
    Waker(Waker),
}
