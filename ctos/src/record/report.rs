//! How a record is while it is written: what `ctos status` and `ctos record` show of it.

use serde::{Deserialize, Serialize};

/// The record of one process at a moment.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RecordReport {
    /// The file that is written, or was last.
    pub file: String,
    /// Lines written, of all its files.
    pub lines: u64,
    /// Bytes on disk, of all its files.
    pub bytes: u64,
    /// Events that it lacks.
    pub lost: u64,
    /// Why nothing is written at the moment, if that is so.
    pub trouble: Option<String>,
}
