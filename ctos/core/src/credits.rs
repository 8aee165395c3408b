//! The places in one lane of a queue, counted by all threads. A sender takes a credit for each message that it
//! brings; the owner of the queue gives it back when it takes the message out. It knows nothing of messages.

use crate::concurrent::{AtomicBool, AtomicU32, Ordering};

/// How many senders may wait for a credit, as a multiple of the capacity.
const WAITING_FACTOR: usize = 16;

/// The credits of a lane.
#[derive(Default)]
pub(crate) struct Credits {
    /// Messages in the queue and on their way to it.
    taken: AtomicU32,
    /// Senders that wait for a credit, those on their way included.
    waiting: AtomicU32,
    /// No credit is given now, though there may be some.
    shut: AtomicBool,
}

/// How many senders may wait at a queue of `capacity`.
pub(crate) fn most_waiting(capacity: usize) -> usize {
    capacity.saturating_mul(WAITING_FACTOR)
}

impl Credits {
    /// Takes a credit if there is one and nobody waits: one of those who do may be the same sender's.
    pub(crate) fn take(&self, capacity: usize) -> bool {
        let is_open =
            self.waiting.load(Ordering::Acquire) == 0 && !self.shut.load(Ordering::Acquire);
        is_open && self.take_past_others(capacity)
    }

    /// Takes a credit if there is one, even while others wait.
    pub(crate) fn take_past_others(&self, capacity: usize) -> bool {
        let more = |taken: u32| ((taken as usize) < capacity).then_some(taken + 1);
        let took = self
            .taken
            .fetch_update(Ordering::AcqRel, Ordering::Relaxed, more);
        took.is_ok()
    }

    /// Takes a credit, even one that there is not.
    pub(crate) fn take_always(&self) {
        self.taken.fetch_add(1, Ordering::AcqRel);
    }

    /// Gives so many credits back.
    pub(crate) fn give(&self, count: usize) {
        // As many were taken before, one by one.
        self.taken.fetch_sub(count as u32, Ordering::AcqRel);
    }

    /// Joins the line of those who wait, if it is not too long.
    pub(crate) fn line_up(&self, capacity: usize) -> bool {
        let before = self.waiting.fetch_add(1, Ordering::AcqRel) as usize;
        let joined = before < most_waiting(capacity);
        if !joined {
            self.leave_line();
        }
        joined
    }

    /// Joins the line, however long it is.
    pub(crate) fn join_line(&self) {
        self.waiting.fetch_add(1, Ordering::AcqRel);
    }

    /// One of those who wait does so no longer.
    pub(crate) fn leave_line(&self) {
        self.waiting.fetch_sub(1, Ordering::AcqRel);
    }

    /// While `shut`, nobody gets a credit.
    pub(crate) fn shut(&self, shut: bool) {
        self.shut.store(shut, Ordering::Release);
    }

    /// Messages in the queue and on their way to it.
    pub(crate) fn taken(&self) -> usize {
        self.taken.load(Ordering::Relaxed) as usize
    }

    /// Those who wait, also on their way to the line.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed) as usize
    }
}
