//! Reports: what happened inside a service object, collected along the chain of calls until it
//! reaches the first caller (SORMA technical report, section 1.6).

use crate::words;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::panic::Location;

/// How bad a report is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Severity {
    /// Talk, for whoever wants to follow.
    Verbose,
    /// Done, but not as one would expect.
    Warning,
    /// Not done.
    Error,
}

impl Severity {
    fn word(self) -> &'static str {
        match self {
            Self::Verbose => "verbose",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }

    fn from_word(word: &str) -> Option<Self> {
        [Self::Verbose, Self::Warning, Self::Error]
            .into_iter()
            .find(|severity| severity.word() == word)
    }
}

/// One thing that happened, with where in the source it was said and by which object.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// How bad it is.
    pub severity: Severity,
    /// A number that stands for this kind of report; 0 for mere talk. See [`code`].
    pub code: i32,
    /// What happened, and for an error what would have been right.
    pub text: String,
    /// Source file that said it; empty when unknown.
    pub file: String,
    /// Line in that file; 0 when unknown.
    pub line: u32,
    /// Full name of the object that said it; empty until the manager fills it in.
    pub object: String,
}

/// The codes that the manager itself uses. Classes use numbers from 100.
pub mod code {
    /// The request is no request.
    pub const SYNTAX: i32 = 1;
    /// No such class.
    pub const UNKNOWN_CLASS: i32 = 2;
    /// No such flavor in the dictionary.
    pub const UNKNOWN_FLAVOR: i32 = 3;
    /// No such option in the class's table.
    pub const UNKNOWN_OPTION: i32 = 4;
    /// A value is missing, of the wrong type or out of range.
    pub const VALUE: i32 = 5;
    /// A recipe that leads to itself, or grows too long.
    pub const RECIPE: i32 = 6;
    /// A daemon that cannot be reached from here.
    pub const DAEMON: i32 = 7;
    /// The object is in a call already.
    pub const BUSY: i32 = 8;
    /// The method is not one this class has.
    pub const UNSUPPORTED: i32 = 9;
}

impl Report {
    /// A report with the place of the caller.
    #[track_caller]
    #[must_use]
    pub fn new(severity: Severity, code: i32, text: impl Into<String>) -> Self {
        let place = Location::caller();
        Self {
            severity,
            code,
            text: text.into(),
            file: place.file().to_owned(),
            line: place.line(),
            object: String::new(),
        }
    }

    /// An error.
    #[track_caller]
    #[must_use]
    pub fn error(code: i32, text: impl Into<String>) -> Self {
        Self::new(Severity::Error, code, text)
    }

    /// A warning.
    #[track_caller]
    #[must_use]
    pub fn warning(code: i32, text: impl Into<String>) -> Self {
        Self::new(Severity::Warning, code, text)
    }

    /// Talk.
    #[track_caller]
    #[must_use]
    pub fn verbose(text: impl Into<String>) -> Self {
        Self::new(Severity::Verbose, 0, text)
    }

    /// A bare message, as a caller puts it after `TDBX`: talk from nowhere.
    #[must_use]
    pub fn message(text: impl Into<String>) -> Self {
        Self {
            severity: Severity::Verbose,
            code: 0,
            text: text.into(),
            file: String::new(),
            line: 0,
            object: String::new(),
        }
    }

    /// Reads one line of a `TDBX` text: a printed report, or else a bare message.
    #[must_use]
    pub fn from_line(line: &str) -> Self {
        Self::from_full(line).unwrap_or_else(|| Self::message(line))
    }

    /// `severity code object file line text`, each a word.
    fn from_full(line: &str) -> Option<Self> {
        let words = words::split(line).ok()?;
        let [severity, code, object, file, row, text] = words.as_slice() else {
            return None;
        };
        Some(Self {
            severity: Severity::from_word(&severity.text)?,
            code: code.text.parse().ok()?,
            text: text.text.clone(),
            file: file.text.clone(),
            line: row.text.parse().ok()?,
            object: object.text.clone(),
        })
    }

    /// One line that [`from_line`](Self::from_line) reads back exactly.
    #[must_use]
    pub fn to_line(&self) -> String {
        let one_line = !self.text.is_empty() && !self.text.chars().any(char::is_control);
        if one_line && Self::from_line(&self.text) == *self {
            return self.text.clone();
        }
        format!(
            "{} {} {} {} {} {}",
            self.severity.word(),
            self.code,
            words::word(&self.object),
            words::word(&self.file),
            self.line,
            words::quoted(&self.text)
        )
    }
}

impl fmt::Display for Report {
    /// For people: `error 5 (foo.a): text [file:line]`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.severity.word())?;
        if self.code != 0 {
            write!(f, " {}", self.code)?;
        }
        if !self.object.is_empty() {
            write!(f, " ({})", self.object)?;
        }
        write!(f, ": {}", self.text)?;
        if !self.file.is_empty() {
            write!(f, " [{}:{}]", self.file, self.line)?;
        }
        Ok(())
    }
}

impl std::error::Error for Report {}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(crate) fn any_report() -> impl Strategy<Value = Report> {
        let severity =
            prop::sample::select(vec![Severity::Verbose, Severity::Warning, Severity::Error]);
        let full = (
            severity,
            any::<i32>(),
            any::<String>(),
            any::<String>(),
            any::<u32>(),
            any::<String>(),
        );
        let full = full.prop_map(|(severity, code, text, file, line, object)| Report {
            severity,
            code,
            text,
            file,
            line,
            object,
        });
        prop_oneof![full, any::<String>().prop_map(Report::message)]
    }

    #[test]
    fn a_report_knows_where_it_was_said() {
        let report = Report::error(code::VALUE, "too cold");
        assert!(report.file.ends_with("report.rs") && report.line > 0);
    }

    #[test]
    fn a_bare_message_is_printed_bare_unless_it_looks_like_a_report() {
        assert_eq!(Report::message("watch the ice").to_line(), "watch the ice");
        let line = "error 5 foo.a kitchen.rs 12 \"too cold\"";
        assert_eq!(Report::from_line(line).code, 5);
        assert_ne!(Report::message(line).to_line(), line);
    }

    proptest! {
        #[test]
        fn a_report_is_read_back_from_its_line_exactly(report in any_report()) {
            let line = report.to_line();
            prop_assert!(!line.contains('\n'));
            prop_assert_eq!(Report::from_line(&line), report);
        }
    }
}
