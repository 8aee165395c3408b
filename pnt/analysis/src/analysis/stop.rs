//! A flag by which the caller of an analysis ends it early; what is known by then is reported.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether an analysis shall end. The usual one never does.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stop(Option<&'static AtomicBool>);

impl Stop {
    /// Ends nothing.
    pub const NEVER: Self = Self(None);

    /// Ends the analysis as soon as the flag is set.
    #[must_use]
    pub const fn when(flag: &'static AtomicBool) -> Self {
        Self(Some(flag))
    }

    /// Whether the analysis shall end now.
    #[must_use]
    pub fn is_set(self) -> bool {
        // Nothing that another thread wrote is read because of it.
        self.0.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }
}

impl PartialEq for Stop {
    fn eq(&self, other: &Self) -> bool {
        match (self.0, other.0) {
            (Some(one), Some(two)) => std::ptr::eq(one, two),
            (None, None) => true,
            _ => false,
        }
    }
}

impl Eq for Stop {}
