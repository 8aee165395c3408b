//! Ticks that come from a device instead of the clock: an encoder card's interrupt, a timer of the
//! kernel, a bus master's frame.
//!
//! A thread of its own waits for the device, so the device may block as it likes and the processor still
//! takes messages between ticks. It has the processor's priority and CPU; what it adds to the way
//! of a tick is one wake-up on the same core.

use std::{
    io,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
};

use crate::contain::contained;
use ctos_time::{Clock, Instant, lock::lock};

/// A device that says when the ticks of a processor are.
pub trait TickSource: Send {
    /// Waits for the device's next tick. Returns how many have come since it was called last: 1, or more
    /// when some went unseen. It returns 0 at least every 100 ms when there are none, so that it
    /// can be taken away.
    ///
    /// # Errors
    /// When the device gives no more ticks. The clock then counts on at the processor's base period,
    /// and the tasks with functions there have failed.
    fn wait(&mut self) -> io::Result<u64>;
}

/// What a device's thread has seen, for the processor.
#[derive(Debug, Default)]
pub(super) struct Ticks {
    seen: Mutex<Seen>,
    /// Set when no more ticks come.
    over: AtomicBool,
}

#[derive(Debug, Default)]
struct Seen {
    /// Ticks so far, and the moment of the last one.
    last: (u64, Instant),
    failure: Option<String>,
}

impl Ticks {
    /// Ticks so far and the moment of the last one; `None` while they are being written: the
    /// processor is woken again when they are.
    pub(super) fn read(&self) -> Option<(u64, Instant)> {
        self.seen.try_lock().ok().map(|seen| seen.last)
    }

    pub(super) fn is_over(&self) -> bool {
        self.over.load(Ordering::Acquire)
    }

    fn fail(&self, reason: String) {
        lock(&self.seen).failure = Some(reason);
        self.over.store(true, Ordering::Release);
    }

    /// How it ended, if it has: with a failure, or because it was taken away.
    pub(super) fn end(&self) -> Option<Option<String>> {
        self.is_over().then(|| lock(&self.seen).failure.take())
    }
}

/// Keeps a processor paced by its device; dropped, it gives the pace back to the clock. It is empty in virtual time,
/// where there are no devices.
#[derive(Debug)]
pub struct TickSourceHandle(pub(super) Option<Arc<Ticks>>);

impl Drop for TickSourceHandle {
    fn drop(&mut self) {
        if let Some(ticks) = &self.0 {
            ticks.over.store(true, Ordering::Release);
        }
    }
}

/// Starts the thread that waits for `source`. It is made like the processor's by `prepare`, CPU and priority; `wake`
/// wakes the processor.
pub(super) fn start(
    name: String,
    mut source: impl TickSource + 'static,
    prepare: impl FnOnce() + Send + 'static,
    wake: impl Fn() + Send + 'static,
    clock: Clock,
) -> io::Result<Arc<Ticks>> {
    let ticks = Arc::new(Ticks::default());
    let written = ticks.clone();
    std::thread::Builder::new().name(name).spawn(move || {
        prepare();
        while !written.is_over() {
            match contained(|| source.wait()) {
                Ok(Ok(0)) => continue,
                Ok(Ok(more)) => {
                    let last = &mut lock(&written.seen).last;
                    *last = (last.0 + more, clock.now());
                }
                Ok(Err(error)) => written.fail(error.to_string()),
                Err(panic) => written.fail(format!("it panicked: {panic}")),
            }
            wake();
        }
    })?;
    Ok(ticks)
}
