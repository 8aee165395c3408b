//! The transport structure: the one public data interface of every service object, used in both
//! directions (SORMA technical report, section 1.3.3).

use crate::opaque::Opaque;
use crate::report::{Report, Severity};
use serde::{Deserialize, Serialize};

/// Which request of a first caller a call belongs to, and how deep it is nested in it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trace {
    /// The number that the first caller gave it; 0: nobody follows it.
    pub id: u64,
    /// 0 for the first caller's own request.
    pub depth: u32,
}

impl Trace {
    /// That of a call made in this one.
    #[must_use]
    pub fn nested(self) -> Self {
        match self.id {
            0 => self,
            id => Self {
                id,
                depth: self.depth + 1,
            },
        }
    }
}

/// Data that goes into a service object and comes back out of it in the same place.
///
/// What the numbers mean (units, frames, shapes) is the class's to say.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Transport {
    /// Who asks: an object, a task, a person; empty for a call by reference inside the process. Locks
    /// and the audit trail go by it. It has no textual form.
    pub from: String,
    /// Which request of the first caller this belongs to. It has no textual form.
    pub trace: Trace,
    /// Text (`TMSG`).
    pub text: String,
    /// Floats (`FMSG`).
    pub floats: Vec<f64>,
    /// Whole numbers (`IMSG`).
    pub ints: Vec<i64>,
    /// Untyped bytes, for example an image. They have no textual form.
    pub opaque: Opaque,
    /// Return code: 0 when done, else the code of the error that stopped it.
    pub code: i32,
    /// Reports so far (`TDBX`), oldest first.
    pub reports: Vec<Report>,
}

impl Transport {
    /// Only text.
    #[must_use]
    pub fn text(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            ..Self::default()
        }
    }

    /// Only floats.
    #[must_use]
    pub fn floats(floats: impl Into<Vec<f64>>) -> Self {
        Self {
            floats: floats.into(),
            ..Self::default()
        }
    }

    /// The same, asked by `from`.
    #[must_use]
    pub fn from(mut self, from: impl Into<String>) -> Self {
        self.from = from.into();
        self
    }

    /// Empties its data, to make room for an answer. Code and reports stay.
    pub(crate) fn empty(&mut self) {
        self.text.clear();
        self.floats.clear();
        self.ints.clear();
        self.opaque.clear();
    }

    /// Empties it and keeps its memory, so that a call that repeats need not allocate. The caller and the trace stay.
    pub fn clear(&mut self) {
        self.empty();
        self.code = 0;
        self.reports.clear();
    }

    /// As part of the call that `outer` came with: for its caller, and in its trace, unless it has its own.
    pub(crate) fn inherit(&mut self, outer: &Self) {
        if self.from.is_empty() {
            self.from.clone_from(&outer.from);
        }
        if self.trace.id == 0 {
            self.trace = outer.trace.nested();
        }
    }

    /// Takes over the data of another one; code and reports stay.
    pub(crate) fn take_data(&mut self, other: Self) {
        self.text = other.text;
        self.floats = other.floats;
        self.ints = other.ints;
        self.opaque = other.opaque;
    }

    /// Adds a report. An error sets the return code, unless an earlier one has.
    pub fn report(&mut self, report: Report) {
        if report.severity == Severity::Error && self.code == 0 {
            // An error whose code was forgotten must not look like success.
            self.code = if report.code == 0 { -1 } else { report.code };
        }
        self.reports.push(report);
    }

    /// All reports, in one line.
    #[must_use]
    pub fn said(&self) -> String {
        let said: Vec<String> = self.reports.iter().map(ToString::to_string).collect();
        said.join("; ")
    }

    /// The texts of all reports, in one line.
    pub(crate) fn texts(&self) -> String {
        let texts: Vec<&str> = self.reports.iter().map(|report| &*report.text).collect();
        texts.join("; ")
    }

    /// Whether the call was done.
    #[must_use]
    pub fn is_ok(&self) -> bool {
        self.code == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_error_is_the_return_code_and_an_error_is_never_success() {
        let mut io = Transport::default();
        io.report(Report::warning(3, "hm"));
        assert!(io.is_ok());
        io.report(Report::error(7, "no"));
        io.report(Report::error(8, "no again"));
        assert_eq!((io.code, io.reports.len()), (7, 3));
        io.clear();
        assert_eq!(io, Transport::default());
        io.report(Report::error(0, "no"));
        assert!(!io.is_ok());
    }
}
