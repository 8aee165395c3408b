//! How full one lane of a queue is, for senders on other threads than its owner's: they claim a place
//! as they bring a message, one after the other. It knows nothing of messages.
//!
//! Senders count the places that they claim, the owner those whose messages have come, and neither writes
//! where the other one does: a counter that both wrote to would go to and fro between their cores for each
//! message. What is claimed and has not come is the difference of the two.

use std::sync::OnceLock;

use crate::concurrent::{AtomicBool, AtomicU32, AtomicU64, Ordering};

/// How many senders may wait for room, as a multiple of the capacity.
const WAITING_FACTOR: usize = 16;

/// The places of a lane.
#[derive(Default)]
pub(crate) struct Room {
    /// What the owner has, as a [`Stock`]. Written by it only.
    stock: AtomicU64,
    /// Senders that wait for room, those on their way included.
    waiting: AtomicU32,
    /// Nobody claims a place now, though there may be room.
    shut: AtomicBool,
    /// Made for the first message that is brought: most queues are only sent to from their own thread.
    claimed: OnceLock<Box<Claimed>>,
}

/// How many places were ever claimed, the last 32 bits of it; written by senders only, and in a cache line
/// of its own: the owner looks at what is beside it for every message, too.
#[derive(Default)]
#[repr(align(64))]
struct Claimed(AtomicU32);

/// What the owner tells, both at one moment.
#[derive(Clone, Copy)]
struct Stock {
    /// Messages in the queue. One of 2^32 messages has no memory to be in.
    held: u32,
    /// How many messages with claimed places have ever come, the last 32 bits of it.
    arrived: u32,
}

impl Stock {
    fn of(bits: u64) -> Self {
        Self {
            held: bits as u32,
            arrived: (bits >> 32) as u32,
        }
    }

    fn bits(self) -> u64 {
        u64::from(self.arrived) << 32 | u64::from(self.held)
    }

    /// How many places are taken when `claimed` were ever claimed. Less than none when messages came whose
    /// places were claimed after that was read: then they are counted among those in the queue.
    fn taken(self, claimed: Option<u32>) -> i64 {
        // As a difference of counters that have gone round it is right with its sign.
        let coming = claimed.map_or(0, |claimed| claimed.wrapping_sub(self.arrived) as i32);
        i64::from(coming) + i64::from(self.held)
    }
}

/// How many senders may wait for room at a queue of `capacity`.
pub(crate) fn most_waiting(capacity: usize) -> usize {
    capacity.saturating_mul(WAITING_FACTOR)
}

impl Room {
    /// Whether there seems to be a place. Who is about to claim one asks here first: then the line that the owner
    /// writes to has come over before all others wait for the end of the claim.
    #[inline]
    pub(crate) fn looks_free(&self, capacity: usize) -> bool {
        self.has_place(self.claimed(), capacity)
    }

    /// Claims a place for a message that is brought before anybody else claims one: the lock of the inbox that it
    /// is brought to is held, so that to count needs no atomic addition.
    #[inline]
    pub(crate) fn claim(&self, capacity: usize) -> bool {
        let claimed = &self.claimed.get_or_init(Box::default).0;
        let before = claimed.load(Ordering::Relaxed);
        let is_free = self.has_place(Some(before), capacity);
        if is_free {
            claimed.store(before.wrapping_add(1), Ordering::Relaxed);
        }
        is_free
    }

    /// Whether there is a place where so many were ever claimed.
    #[inline]
    fn has_place(&self, claimed: Option<u32>, capacity: usize) -> bool {
        // Nobody overtakes those who wait: one of them may be the same sender's.
        if self.waiting.load(Ordering::Acquire) > 0 || self.shut.load(Ordering::Acquire) {
            return false;
        }
        let taken = self.stock(Ordering::Acquire).taken(claimed);
        i64::try_from(capacity).is_ok_and(|capacity| taken < capacity)
    }

    /// How many places were ever claimed, if any was.
    #[inline]
    fn claimed(&self) -> Option<u32> {
        let claimed = self.claimed.get()?;
        Some(claimed.0.load(Ordering::Relaxed))
    }

    #[inline]
    fn stock(&self, ordering: Ordering) -> Stock {
        Stock::of(self.stock.load(ordering))
    }

    /// The owner has as many messages in the queue.
    #[inline]
    pub(crate) fn set_held(&self, held: usize) {
        self.arrived(0, held);
    }

    /// The owner has taken a message out of the queue and has `held` left. It need not tell for each, if
    /// the queue is a long one: the line that the senders look at stays theirs for a while.
    #[inline]
    pub(crate) fn took(&self, held: usize, capacity: usize) {
        let told = self.stock(Ordering::Relaxed).held as usize;
        if held == 0 || told.saturating_sub(held) > capacity / 16 {
            self.set_held(held);
        }
    }

    /// So many messages with claimed places have come to the owner, which has `held` in the queue, these
    /// included.
    #[inline]
    pub(crate) fn arrived(&self, count: usize, held: usize) {
        let before = self.stock(Ordering::Relaxed);
        let stock = Stock {
            held: held as u32,
            arrived: before.arrived.wrapping_add(count as u32),
        };
        self.stock.store(stock.bits(), Ordering::Release);
    }

    /// [`Self::arrived`] of one that did not go to the queue.
    pub(crate) fn arrived_elsewhere(&self) {
        self.arrived(1, self.stock(Ordering::Relaxed).held as usize);
    }

    /// Joins the line of those who wait, if it is not too long.
    pub(crate) fn line_up(&self, capacity: usize) -> bool {
        let before = self.waiting.fetch_add(1, Ordering::AcqRel) as usize;
        let joined = before < most_waiting(capacity);
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
        let taken = self.stock(Ordering::Relaxed).taken(self.claimed());
        usize::try_from(taken).unwrap_or(0) + self.waiting()
    }

    /// Those in the line, also on their way to it.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed) as usize
    }
}
