//! How a synchronous function wakes the asynchronous side of its task.

use std::{
    future::poll_fn,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::Poll,
};

use futures_util::task::AtomicWaker;

/// Wakes the asynchronous side of a task from a synchronous function, without lock or allocation in
/// the signal itself. Raised many times before it is seen, it is seen once.
#[derive(Debug, Clone, Default)]
pub struct Signal(Arc<SignalInner>);

#[derive(Debug, Default)]
struct SignalInner {
    raised: AtomicBool,
    waker: AtomicWaker,
}

impl Signal {
    /// Raises it.
    pub fn raise(&self) {
        self.0.raised.store(true, Ordering::Release);
        self.0.waker.wake();
    }

    /// Ends when it has been raised, and lowers it. One future may wait at a time.
    pub async fn wait(&self) {
        poll_fn(|cx| {
            self.0.waker.register(cx.waker());
            if self.0.raised.swap(false, Ordering::AcqRel) {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }

    /// A signal that is not raised.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }
}
