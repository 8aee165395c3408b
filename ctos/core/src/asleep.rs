//! Whether a processor sleeps, for those who bring it something. It knows nothing of what they bring.

use crate::concurrent::{AtomicBool, Ordering, fence};

/// Set by the processor, cleared by the thread that wakes it.
#[derive(Default)]
pub(crate) struct Asleep(AtomicBool);

impl Asleep {
    /// The processor sleeps now, unless `has_work`. A thread that brings something sees the announcement,
    /// or the processor sees what was brought: of the two fences one comes first.
    pub(crate) fn fall(&self, has_work: impl FnOnce() -> bool) -> bool {
        // A swap here and below: so that each change comes after the one that it saw.
        self.0.swap(true, Ordering::SeqCst);
        fence(Ordering::SeqCst);
        let sleeps = !has_work();
        if !sleeps {
            self.up();
        }
        sleeps
    }

    /// The processor is awake.
    pub(crate) fn up(&self) {
        self.0.swap(false, Ordering::SeqCst);
    }

    /// Something was brought: whether the caller must wake the processor. Only one caller hears so.
    pub(crate) fn must_be_woken(&self) -> bool {
        fence(Ordering::SeqCst);
        // Looked at first: a swap would take the line from those who only bring.
        self.0.load(Ordering::SeqCst) && self.0.swap(false, Ordering::SeqCst)
    }
}
