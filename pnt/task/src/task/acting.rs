//! An action that is going on, as it is seen from outside, and how it is ended from there.

use futures_util::future::{AbortHandle, AbortRegistration};

/// An action that is going on, as it is seen from outside.
pub(super) struct Acting {
    handle: AbortHandle,
    pub(super) ended: Ended,
}

/// How an action is ended from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ended {
    /// By hand, as completed.
    Completed,
    /// By hand, as failed.
    Cancelled,
    /// As failed, because it did not end while the app was being stopped.
    TooLate,
}

impl Acting {
    /// With what the action looks at.
    pub(super) fn new() -> (AbortRegistration, Self) {
        let (handle, registration) = AbortHandle::new_pair();
        let acting = Self {
            handle,
            ended: Ended::Cancelled,
        };
        (registration, acting)
    }

    pub(super) fn end(&mut self, ended: Ended) {
        self.ended = ended;
        self.handle.abort();
    }
}
