//! Why a snapshot buffer cannot be used.

use super::layout;
use crate::process::Process;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

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
    /// The file is not a snapshot buffer.
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
