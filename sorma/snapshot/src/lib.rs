//! Snapshot buffers: cyclic buffers in shared memory (SORMA technical report, section 1.7.2). One writer
//! hands records to any number of readers on the same host, in other processes or its own.
//!
//! A record is a fixed number of floats and some opaque bytes; its number and a time stamp are added. The
//! writer never waits, never allocates and does not know its readers. They take the latest record, or one
//! after the other, or the recent history. They know the age and number of each, and are told how many they
//! lost when they were too slow. No reader ever gets a torn record. A writer that was killed, even while it
//! wrote, is succeeded by the next one, which goes on where it ended.
//!
//! ```
//! use ctos::time::Clock;
//! use sorma_snapshot::{Layout, Place, Reader, Snapshot, Writer};
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
//! # Ok::<(), sorma_snapshot::SnapshotError>(())
//! ```
//!
//! `docs/snapshots.md` says how the memory is laid out and why it is done so.

mod bell;
mod error;
mod layout;
mod memory;
mod place;
pub mod process;
mod protocol;
mod reader;
mod record;
mod writer;

pub use error::SnapshotError;
pub use layout::{Layout, MOST_BYTES, MOST_DESCRIPTION, MOST_FLOATS, MOST_SEGMENT, MOST_SLOTS};
pub use place::{Place, STALE_AFTER, Segment};
pub use reader::{Reader, Waited, WriterState};
pub use record::Snapshot;
pub use writer::Writer;

#[cfg(test)]
mod tests;
