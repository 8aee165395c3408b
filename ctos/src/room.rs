//! How full one lane of a queue is, for senders on other threads than its owner's: they claim a place
//! before they bring a message. It knows nothing of messages.

use crate::concurrent::{AtomicBool, AtomicUsize, Ordering};

/// How many senders may wait for room, as a multiple of the capacity.
const WAITING_FACTOR: usize = 16;

/// The places of a lane. The owner writes `held`, everybody the rest.
#[derive(Default)]
pub(crate) struct Room {
    /// Messages in the queue.
    held: AtomicUsize,
    /// Senders that wait for room, those on their way included.
    waiting: AtomicUsize,
    /// Nobody claims a place now, though there may be room.
    shut: AtomicBool,
    /// Places claimed by messages that are on their way.
    coming: AtomicUsize,
}

/// How many senders may wait for room at a queue of `capacity`.
pub(crate) fn most_waiting(capacity: usize) -> usize {
    capacity.saturating_mul(WAITING_FACTOR)
}

impl Room {
    /// Claims a place for a message that will be brought. Claims of several threads at the same
    /// moment may fail together; more than `capacity` never succeed.
    pub(crate) fn claim(&self, capacity: usize) -> bool {
        // Nobody overtakes those who wait: one of them may be the same sender's.
        if self.waiting.load(Ordering::Acquire) > 0 || self.shut.load(Ordering::Acquire) {
            return false;
        }
        let coming = self.coming.fetch_add(1, Ordering::AcqRel);
        // What arrives is counted in `held` before it leaves `coming`, so it is never missed here.
        let is_free = coming + self.held.load(Ordering::Acquire) < capacity;
        if !is_free {
            self.coming.fetch_sub(1, Ordering::AcqRel);
        }
        is_free
    }

    /// The owner has as many messages in the queue.
    pub(crate) fn set_held(&self, held: usize) {
        self.held.store(held, Ordering::Release);
    }

    /// The owner has taken a message out of the queue and has `held` left. It need not tell for each, if
    /// the queue is a long one: the line that the senders look at stays theirs for a while.
    #[inline]
    pub(crate) fn took(&self, held: usize, capacity: usize) {
        let told = self.held.load(Ordering::Relaxed);
        if held == 0 || told.saturating_sub(held) > capacity / 16 {
            self.set_held(held);
        }
    }

    /// As many messages with claimed places are in the queue, and counted there.
    pub(crate) fn arrived(&self, count: usize) {
        self.coming.fetch_sub(count, Ordering::AcqRel);
    }

    /// Joins the line of those who wait, if it is not too long.
    pub(crate) fn line_up(&self, capacity: usize) -> bool {
        let joined = self.waiting.fetch_add(1, Ordering::AcqRel) < most_waiting(capacity);
        if !joined {
            self.waiting.fetch_sub(1, Ordering::AcqRel);
        }
        joined
    }

    /// Joins the line, however long it is.
    pub(crate) fn join_line(&self) {
        self.waiting.fetch_add(1, Ordering::AcqRel);
    }

    /// Whether places can be claimed at all.
    pub(crate) fn shut(&self, shut: bool) {
        self.shut.store(shut, Ordering::Release);
    }

    /// One of those who wait does so no longer.
    pub(crate) fn leave_line(&self) {
        self.waiting.fetch_sub(1, Ordering::AcqRel);
    }

    /// Messages in the queue, on their way to it and in the line.
    pub(crate) fn len(&self) -> usize {
        self.held.load(Ordering::Relaxed) + self.coming.load(Ordering::Relaxed) + self.waiting()
    }

    /// Those in the line, also on their way to it.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed)
    }
}
