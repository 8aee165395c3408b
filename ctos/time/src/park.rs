//! Where a processor's thread sleeps while it has nothing to do, and how other threads wake it.
//!
//! Knows no socket: what the thread looks at while it sleeps is given to it as a [`Park`].

use std::{
    ops::Deref,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    thread::Thread,
};

use crate::Instant;

/// How a thread that is awake looks for what has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Glance {
    /// At shared memory only, which costs next to nothing.
    AtMemory,
    /// At the sockets as well, of which the system is asked.
    Everywhere,
}

/// A place where one thread sleeps and others wake it. A wake-up that comes first is not lost: the next
/// sleep ends at once.
pub trait Park: Send + Sync {
    /// The calling thread is the one that will sleep here.
    fn sit_down(&self);

    /// Wakes the thread, if it sleeps.
    fn unpark(&self);

    /// Sleeps until it is woken, or until `deadline`; sometimes less. `now` is the present moment, as far as
    /// that is known.
    fn park(&self, now: Instant, deadline: Option<Instant>);

    /// Looks once, for the thread while it is awake and has nothing to do, and hands on what has come.
    /// Whether there was something for a task.
    fn glance(&self, _glance: Glance) -> bool {
        false
    }

    /// What came last was for the thread's own tasks.
    fn had_work(&self) {}
}

/// A place where a thread just sleeps.
#[derive(Default)]
pub struct ThreadParker {
    /// The system's token alone is not enough: others that block this thread may take it.
    nudged: AtomicBool,
    thread: OnceLock<Thread>,
}

impl ThreadParker {
    /// Whether it has been woken and not yet looked.
    pub fn is_nudged(&self) -> bool {
        self.nudged.load(Ordering::SeqCst)
    }

    /// Looks whether it has been woken.
    pub fn take_nudge(&self) -> bool {
        // Mostly it was not, and a look costs less than a change.
        self.is_nudged() && self.nudged.swap(false, Ordering::SeqCst)
    }

    /// It has been woken; the caller of this ensures that the thread learns so.
    pub fn nudge(&self) {
        self.nudged.store(true, Ordering::SeqCst);
    }

    /// Wakes the thread, which may sleep elsewhere, without a nudge.
    pub fn shake(&self) {
        if let Some(thread) = self.thread.get() {
            thread.unpark();
        }
    }
}

impl Park for ThreadParker {
    fn sit_down(&self) {
        // Set once: a processor has one thread.
        let _ = self.thread.set(std::thread::current());
    }

    fn unpark(&self) {
        self.nudge();
        self.shake();
    }

    fn park(&self, now: Instant, deadline: Option<Instant>) {
        if self.take_nudge() {
            return;
        }
        match deadline {
            Some(deadline) => std::thread::park_timeout(deadline.since(now)),
            None => std::thread::park(),
        }
        self.take_nudge();
    }
}

/// The place of one processor: its own until it is given another one, before its thread starts.
#[derive(Default)]
pub struct Parker {
    own: ThreadParker,
    given: OnceLock<Arc<dyn Park>>,
}

impl Parker {
    /// From now on the thread sleeps there. Its processor has not started yet.
    pub fn set(&self, place: Arc<dyn Park>) {
        let _ = self.given.set(place);
    }

    /// Whether the thread looks at something while it sleeps.
    pub fn looks_out(&self) -> bool {
        self.given.get().is_some()
    }
}

impl Deref for Parker {
    type Target = dyn Park;

    fn deref(&self) -> &(dyn Park + 'static) {
        match self.given.get() {
            Some(place) => place.as_ref(),
            None => &self.own,
        }
    }
}
