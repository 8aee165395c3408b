//! What the classes for communication read of a request, what they answer, and the codes of their reports.

use crate::raise;
use crate::report::{Report, code as general};
use crate::transport::Transport;
use crate::words;
use std::time::Duration;

crate::prototypes! {
    /// The codes of the reports of these classes.
    pub mod code {
        BUFFER = 180, Error, "a snapshot buffer cannot be made, opened, written or read",
            "the text says which and why; `shmem_r.NAME EXEC status` tells about a buffer";
        SUCCEEDED = 181, Warning, "another writer has taken over a buffer, or it was made anew",
            "go on; the numbers of the records begin again only when it was made anew";
        LOST = 182, Warning, "records were overwritten before they were read",
            "read more often, or give the buffer more slots";
        FILE = 183, Error, "a file of a flight recorder cannot be written",
            "choose another -file, or make room";
        FULL = 184, Error, "a queue, a blackboard or a line of those who wait is full",
            "try again later, or set -capacity";
        UNKNOWN = 185, Error, "no such key or hold", "see EXEC keys, EXEC holders";
        LATE = 186, Error, "the time for which one wanted to wait is over", "ask anew, for longer";
        CONFLICT = 187, Error, "a value has another version than the one that was to be replaced",
            "get it again, and decide anew";
        CLOCK = 188, Warning, "the clock of another host was set, or drifts faster than was said",
            "set -drift of shmem_far, if it comes again and again";
    }
}

/// What EXEC answers, as text, when the caller is to ask again.
pub const NOT_YET: &str = "not yet";

#[track_caller]
pub(super) fn wrong(text: impl Into<String>) -> Report {
    Report::error(general::VALUE, text)
}

/// The words of an EXEC text.
pub(crate) fn split(text: &str) -> Result<Vec<String>, Report> {
    words::texts(text).map_err(|error| raise!(general::SYNTAX, "{error}"))
}

/// A whole number that a word of EXEC says.
pub(super) fn number(what: &str, word: &str) -> Result<u64, Report> {
    word.parse()
        .map_err(|_| wrong(format!("{what} is a whole number from 0 on, not `{word}`")))
}

/// The longest anybody may say to wait: a day.
const MOST_WAIT_S: f64 = 86_400.0;

/// A time that a word of EXEC says, in seconds; none is 0.
pub(super) fn seconds(word: Option<&String>) -> Result<Duration, Report> {
    let Some(word) = word else {
        return Ok(Duration::ZERO);
    };
    word.parse()
        .ok()
        .filter(|seconds| (0.0..=MOST_WAIT_S).contains(seconds))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| {
            wrong(format!(
                "the time to wait is 0 to {MOST_WAIT_S} s, not `{word}`"
            ))
        })
}

/// What stands after the first `count` words of a text, as it stands; without its quotes if it is one word.
pub(super) fn after(text: &str, count: usize) -> Result<String, Report> {
    let found = words::split(text).map_err(|error| raise!(general::SYNTAX, "{error}"))?;
    Ok(match found.get(count..) {
        Some([only]) => only.text.clone(),
        Some([first, ..]) => text
            .get(first.span.start..)
            .unwrap_or_default()
            .trim_end()
            .to_owned(),
        _ => String::new(),
    })
}

/// Answers that the caller is to ask again.
pub(crate) fn not_yet(io: &mut Transport) {
    io.empty();
    NOT_YET.clone_into(&mut io.text);
}

/// An `i64` as IMSG carries it.
pub(crate) fn int(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}
