//! What is kept about every object, whatever its class: how often it was called, and who changed it.

use crate::meter::Meter;
use crate::report::{Report, Severity};
use crate::words;
use ctos::time::Instant;
use std::collections::VecDeque;

/// How many CTRL requests the audit trail keeps.
const AUDIT: usize = 64;

/// A longer request is cut in the trail, bytes.
const AUDIT_LINE: usize = 1024;

/// What is known about an object.
#[derive(Debug, Clone)]
pub(crate) struct Meta {
    /// The least severe reports that are passed on.
    pub(crate) verbosity: Severity,
    pub(crate) audit: VecDeque<String>,
    /// CTRL requests so far, also those that the trail no longer keeps.
    pub(crate) ctrls: u64,
    pub(crate) execs: u64,
    /// Calls that ended with an error.
    pub(crate) errors: u64,
    pub(crate) meter: Meter,
}

impl Default for Meta {
    fn default() -> Self {
        Self {
            verbosity: Severity::Verbose,
            audit: VecDeque::new(),
            ctrls: 0,
            execs: 0,
            errors: 0,
            meter: Meter::default(),
        }
    }
}

impl Meta {
    /// Notes a CTRL request.
    pub(crate) fn audited(&mut self, now: Instant, from: &str, text: &str, code: i32) {
        self.ctrls += 1;
        if self.audit.len() >= AUDIT {
            self.audit.pop_front();
        }
        let by = if from.is_empty() { "here" } else { from };
        let mut end = text.len().min(AUDIT_LINE);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let text = text.get(..end).unwrap_or(text);
        self.audit.push_back(format!(
            "{} {:.6} s {} RET {code} {}",
            self.ctrls,
            now.since_start().as_secs_f64(),
            words::word(by),
            words::word(text)
        ));
    }

    /// How often it was called.
    pub(crate) fn statistics(&self) -> String {
        format!(
            "exec {} ctrl {} errors {}",
            self.execs, self.ctrls, self.errors
        )
    }

    /// Whether a report of this object is passed on.
    pub(crate) fn passes(&self, report: &Report) -> bool {
        report.severity >= self.verbosity
    }
}
