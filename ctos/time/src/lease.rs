//! A lease: until when a process may go on. The first thread that looks at the clock later finds out that it is over.
//! So nothing that asks for the time goes on behind it.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use crate::Instant;

/// What is done when a lease is over: it was not extended for so long, or was revoked.
type Over = Box<dyn Fn(Option<Duration>) + Send + Sync>;

const UNLIMITED: u64 = u64::MAX;
const REVOKED: u64 = 0;

/// Until when a process may go on.
#[derive(derive_more::Debug)]
#[debug("Lease({term:?})")]
pub struct Lease {
    /// For how long each extension is good.
    term: Duration,
    /// ns, or one of the two above.
    until: AtomicU64,
    over: Over,
}

impl Lease {
    /// A lease without a deadline until it is extended first. `over` ends the process. It is told for how long the lease
    /// was not extended, nothing when it was revoked, and may be called by several threads.
    pub fn new(term: Duration, over: impl Fn(Option<Duration>) + Send + Sync + 'static) -> Self {
        Self {
            term,
            until: AtomicU64::new(UNLIMITED),
            over: Box::new(over),
        }
    }

    /// Good for another term from `now` on.
    pub fn extend(&self, now: Instant) {
        self.set((now + self.term).as_nanos());
    }

    /// Without a deadline from now on.
    pub fn lift(&self) {
        self.set(UNLIMITED);
    }

    /// Over at once.
    pub fn revoke(&self) {
        self.set(REVOKED);
        (self.over)(None);
    }

    fn set(&self, until: u64) {
        self.until.store(until, Ordering::Relaxed);
    }

    /// Finds out at `now` whether it is over.
    pub(crate) fn look(&self, now: Instant) {
        let until = self.until.load(Ordering::Relaxed);
        if now.as_nanos() > until {
            let late = self.term + now.since(Instant::from_nanos(until));
            (self.over)((until != REVOKED).then_some(late));
        }
    }
}
