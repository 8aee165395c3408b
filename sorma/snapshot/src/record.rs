//! A record as a reader takes it, and the time as it is stamped.

use ctos::time::{Clock, Instant};
use std::time::Duration;

/// A record, as a reader takes it. Reading into the same one again does not allocate.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Snapshot {
    /// Its number, counted from 1 on over all writers of the buffer.
    pub count: u64,
    /// When it was written, ns of the host's monotonic clock, which all its processes share; of the virtual
    /// clock, when the writer's is one. See [`Self::at`].
    pub stamp_ns: u64,
    /// Which writer of the buffer wrote it, from 1 on.
    pub generation: u64,
    /// The floats; as many as the layout says.
    pub floats: Vec<f64>,
    /// The opaque bytes; no more than the layout says.
    pub opaque: Vec<u8>,
}

impl Snapshot {
    /// When it was written, by this clock; the start of the app if it was written before that.
    #[must_use]
    pub fn at(&self, clock: &Clock) -> Instant {
        let origin = clock.origin_ns().unwrap_or(0);
        Instant::from_nanos(self.stamp_ns.saturating_sub(origin))
    }

    /// How long ago it was written.
    #[must_use]
    pub fn age(&self, clock: &Clock) -> Duration {
        Duration::from_nanos(host_ns(clock).saturating_sub(self.stamp_ns))
    }
}

/// The present moment as it is stamped: all processes of a host have the same.
pub(super) fn host_ns(clock: &Clock) -> u64 {
    let origin = clock.origin_ns().unwrap_or(0);
    clock.now().as_nanos().saturating_add(origin)
}

/// Sleeps where there is nothing to be woken by.
pub(super) fn nap(limit: Duration) {
    let time = rustix::thread::Timespec {
        tv_sec: i64::try_from(limit.as_secs()).unwrap_or(0),
        tv_nsec: limit.subsec_nanos().into(),
    };
    // A signal that ends it early does no harm.
    let _ = rustix::thread::nanosleep(&time);
}
