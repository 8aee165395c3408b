//! Snapshot buffers: cyclic buffers in shared memory, with which one writer hands records to any number of
//! readers on the same host, in other processes or its own (SORMA technical report, section 1.7.2).
//!
//! A record is a fixed number of floats and some opaque bytes; its number and a time stamp are added. The
//! writer never waits, never allocates and does not know its readers. They take the latest record, or one
//! after the other, or the recent history; they know of each its age and number, and are told how many they
//! lost when they were too slow. No reader ever gets a torn record. A writer that was killed, even
//! while it wrote, is succeeded by the next one, which goes on where it ended.
//!
//! ```
//! use ctos::time::Clock;
//! use sorma::snapshot::{Layout, Place, Reader, Snapshot, Writer};
//!
//! # let folder = tempfile::tempdir().unwrap();
//! # let place = Place::under(&folder.path().join("shm"), "demo").unwrap();
//! let clock = Clock::real();
//! let layout = Layout::new(16, 2).described("q1 rad\nq2 rad");
//! let mut writer = Writer::create(&place, "joints", layout, &clock)?;
//! writer.write(&[0.1, 0.2], &[])?;
//!
//! let mut reader = Reader::open(&place, "joints")?;
//! let mut record = Snapshot::default();
//! assert!(reader.latest(&mut record)?);
//! assert_eq!((record.count, record.floats.as_slice()), (1, [0.1, 0.2].as_slice()));
//! let age = record.age(&clock);
//! # let _ = age;
//! # Ok::<(), sorma::snapshot::SnapshotError>(())
//! ```
//!
//! `docs/snapshots.md` says how the memory is laid out and why it is done so.

mod bell;
mod layout;
mod memory;
mod place;
mod protocol;
mod reader;
mod writer;

use crate::process::Process;
use ctos::time::{Clock, Instant};
use std::io;
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

pub use layout::{Layout, MOST_BYTES, MOST_DESCRIPTION, MOST_FLOATS, MOST_SEGMENT, MOST_SLOTS};
pub use place::{Place, STALE_AFTER, Segment};
pub use reader::{Reader, Waited, WriterState};
pub use writer::Writer;

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
fn host_ns(clock: &Clock) -> u64 {
    let origin = clock.origin_ns().unwrap_or(0);
    clock.now().as_nanos().saturating_add(origin)
}

/// Sleeps where there is nothing to be woken by.
fn nap(limit: Duration) {
    let time = rustix::thread::Timespec {
        tv_sec: i64::try_from(limit.as_secs()).unwrap_or(0),
        tv_nsec: limit.subsec_nanos().into(),
    };
    // A signal that ends it early does no harm.
    let _ = rustix::thread::nanosleep(&time);
}

/// Why a snapshot buffer cannot be made, opened, written or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// An app or a buffer has a name that cannot be one of a file.
    #[error(
        "`{0}` cannot name a snapshot buffer or its app: letters, digits, `_`, `-` and `.`, \
         1 to 100 of them, the first no `.`"
    )]
    Name(String),
    /// The layout is beyond what can be.
    #[error("{what} must be {low} to {high}, not {value}")]
    Layout {
        /// Which number.
        what: &'static str,
        /// What it is.
        value: usize,
        /// The least it may be.
        low: usize,
        /// The most it may be.
        high: usize,
    },
    /// Another writer has the buffer.
    #[error("{}: {writer} writes there; a snapshot buffer has one writer at a time", path.display())]
    Busy {
        /// The segment.
        path: PathBuf,
        /// Who writes.
        writer: Process,
    },
    /// There is no such buffer.
    #[error("{}: there is no such snapshot buffer; its writer has not been started, or has ended", path.display())]
    Missing {
        /// Where it would be.
        path: PathBuf,
    },
    /// The folder of the segments, or a segment, is not the user's alone.
    #[error("{}: {why}; remove it", path.display())]
    NotOurs {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        why: &'static str,
    },
    /// The file is no snapshot buffer.
    #[error("{}: this is no snapshot buffer", path.display())]
    NoSnapshots {
        /// The file.
        path: PathBuf,
    },
    /// The buffer has another format.
    #[error("{}: the buffer has version {version}, and this program reads version {}; start both from the same build", path.display(), layout::VERSION)]
    Version {
        /// The segment.
        path: PathBuf,
        /// The version it has.
        version: u64,
    },
    /// The buffer has another structure than the reader was told.
    #[error("{}: records there have {what} {has}, not {wanted}", path.display())]
    Differs {
        /// The segment.
        path: PathBuf,
        /// Of what.
        what: &'static str,
        /// How many there are.
        has: usize,
        /// How many the reader wants.
        wanted: usize,
    },
    /// The header makes no sense.
    #[error("{}: the buffer is damaged ({why}); its writer makes it anew when it starts", path.display())]
    Damaged {
        /// The segment.
        path: PathBuf,
        /// What makes no sense.
        why: String,
    },
    /// A record that does not fit.
    #[error("the buffer takes {what} {takes}, not {given}")]
    Record {
        /// Of what.
        what: &'static str,
        /// How many it takes.
        takes: usize,
        /// How many there are.
        given: usize,
    },
    /// The writer was faster than this reader, again and again; or it died in the only slot.
    #[error(
        "{}: no whole record can be read: the writer overwrites them too fast, or has died in the only \
         slot; give the buffer more slots", path.display())]
    Overrun {
        /// The segment.
        path: PathBuf,
    },
    /// The system refuses.
    #[error("{}: {what}: {source}", path.display())]
    System {
        /// The file or folder.
        path: PathBuf,
        /// What was tried.
        what: &'static str,
        /// What it says.
        source: io::Error,
    },
}

#[cfg(test)]
mod tests;
