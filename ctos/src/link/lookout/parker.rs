//! Where a processor's thread sleeps: at the links of its chassis, if it may, else just so.

use std::{
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    thread::Thread,
};

use super::{Glance, Lookout, Seen, Waited};
use crate::time::Instant;

/// The place where one thread sleeps and others wake it. A wake-up that comes first is not lost: the
/// next sleep ends at once.
#[derive(Default)]
pub(crate) struct Parker {
    nudged: AtomicBool,
    /// The thread sleeps at the links, where only their nudge wakes it.
    at_links: AtomicBool,
    /// What came last was for others: they shall have the turn at the links next. For the thread alone.
    aside: AtomicBool,
    thread: OnceLock<Thread>,
    lookout: OnceLock<Arc<Lookout>>,
}

impl Parker {
    /// The calling thread is the one that will sleep here.
    pub(crate) fn sit_down(&self) {
        // Set once: a processor has one thread.
        let _ = self.thread.set(std::thread::current());
    }

    /// From now on the thread looks at the links instead of just sleeping.
    pub(crate) fn look_out(&self, lookout: Arc<Lookout>) {
        let _ = self.lookout.set(lookout);
    }

    /// Whether the thread looks at the links.
    pub(crate) fn looks_out(&self) -> bool {
        self.lookout.get().is_some()
    }

    /// Wakes the thread, if it sleeps.
    pub(crate) fn unpark(&self) {
        self.nudged.store(true, Ordering::SeqCst);
        match self.lookout.get() {
            Some(lookout) if self.at_links.load(Ordering::SeqCst) => {
                if self.at_links.swap(false, Ordering::SeqCst) {
                    lookout.nudge();
                }
            }
            _ => {
                if let Some(thread) = self.thread.get() {
                    thread.unpark();
                }
            }
        }
    }

    /// Sleeps until it is woken, or until `end`; `now` is the present moment, as far as that is known.
    pub(crate) fn park(&self, now: Instant, end: Option<Instant>) {
        if self.take_nudge() {
            return;
        }
        if let Some(lookout) = self.lookout.get()
            && !self.aside.swap(false, Ordering::Relaxed)
        {
            let waited = lookout.wait(self, end);
            self.aside
                .store(waited == Waited::HandedOn, Ordering::Relaxed);
            if self.take_nudge() || waited != Waited::Elsewhere {
                return;
            }
        }
        match end {
            Some(end) => std::thread::park_timeout(end.since(now)),
            None => std::thread::park(),
        }
        self.take_nudge();
    }

    /// Looks at the links once, for the thread while it is awake and has nothing to do, and hands on what has
    /// come. Whether there were frames.
    pub(crate) fn glance(&self, glance: Glance) -> bool {
        let lookout = self.lookout.get();
        lookout.is_some_and(|lookout| lookout.glance(glance) == Seen::Frames)
    }

    /// What came last was for the thread itself: it keeps its turn at the links.
    pub(crate) fn had_work(&self) {
        self.aside.store(false, Ordering::Relaxed);
    }

    /// Wakes a thread that can only be at the links.
    pub(super) fn unpark_at(&self, lookout: &Lookout) {
        self.nudged.store(true, Ordering::SeqCst);
        if self.at_links.swap(false, Ordering::SeqCst) {
            lookout.nudge();
        }
    }

    pub(super) fn is_nudged(&self) -> bool {
        self.nudged.load(Ordering::SeqCst)
    }

    pub(super) fn take_nudge(&self) -> bool {
        // Mostly there is none, and a look costs less than a change.
        self.is_nudged() && self.nudged.swap(false, Ordering::SeqCst)
    }

    /// The thread is about to sleep at the links, and looks for a nudge behind a fence; or it is there no
    /// longer.
    pub(super) fn set_at_links(&self, at_links: bool) {
        let order = if at_links {
            Ordering::Relaxed
        } else {
            Ordering::SeqCst
        };
        self.at_links.store(at_links, order);
    }

    /// What becomes of the turn: when all that came was for others, one of them shall have it.
    pub(super) fn after(&self, seen: Seen) -> Waited {
        if seen == Seen::Frames && !self.is_nudged() {
            Waited::HandedOn
        } else {
            Waited::Awake
        }
    }
}
