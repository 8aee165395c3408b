//! Reports: what happened inside a service object, collected along the chain of calls until it
//! reaches the first caller (SORMA technical report, section 1.6).

use crate::words;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::panic::Location;

/// How bad a report is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Severity {
    /// Details, for a person who wants to follow.
    #[default]
    Verbose,
    /// Done, but not as one would expect.
    Warning,
    /// Not done.
    Error,
}

impl Severity {
    /// Its name: `verbose`, `warning`, `error`.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Verbose => "verbose",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }

    /// The severity of that name.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        [Self::Verbose, Self::Warning, Self::Error]
            .into_iter()
            .find(|severity| severity.word() == word)
    }
}

/// One thing that happened, with where in the source it was said and by which object.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
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
    /// The process that said it; empty until the manager fills it in.
    pub process: String,
    /// When it was said, ns of the app's time; 0 until the manager fills it in.
    pub time_ns: u64,
}

/// What a code means, in words: the prototype of the reports that bear it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Prototype {
    /// The code.
    pub code: i32,
    /// Its name in the source.
    pub name: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What it says.
    pub text: &'static str,
    /// What to do about it.
    pub help: &'static str,
}

/// Defines the codes of a class in one place: a module with a constant for each and the table
/// `PROTOTYPES`. That table is registered with the class. Classes use codes from 100.
///
/// ```
/// sorma::prototypes! {
///     /// What an oven can report.
///     pub mod oven {
///         COLD = 117, Error, "the oven is cold", "wait until it is warm, or set -preheat on";
///         SMELL = 118, Warning, "something smells", "look inside";
///     }
/// }
/// assert_eq!(oven::PROTOTYPES[0].code, oven::COLD);
/// let report = sorma::raise!(oven::COLD, "only {} degrees", 40);
/// assert_eq!(report.text, "only 40 degrees");
/// ```
#[macro_export]
macro_rules! prototypes {
    (
        $(#[$meta:meta])*
        $visibility:vis mod $module:ident {
            $($name:ident = $code:literal, $severity:ident, $text:literal, $help:literal;)*
        }
    ) => {
        $(#[$meta])*
        $visibility mod $module {
            $(#[doc = $text] pub const $name: i32 = $code;)*
            /// All of them, for the class's registration.
            pub const PROTOTYPES: &[$crate::report::Prototype] = &[$(
                $crate::report::Prototype {
                    code: $code,
                    name: stringify!($name),
                    severity: $crate::report::Severity::$severity,
                    text: $text,
                    help: $help,
                },
            )*];
        }
    };
}

/// A report of an error with a code and a text as in `format!`, and the place where this stands.
#[macro_export]
macro_rules! raise {
    ($code:expr, $($text:tt)+) => {
        $crate::report::Report::error($code, format!($($text)+))
    };
}

prototypes! {
    /// The codes that the manager itself uses. Classes use numbers from 100.
    pub mod code {
        SYNTAX = 1, Error, "the request is no request", "write: name EXEC|CTRL|DBX text";
        UNKNOWN_CLASS = 2, Error, "no such class", "`sorm CTRL -classes` lists them";
        UNKNOWN_FLAVOR = 3, Error, "no such flavor in the dictionary",
            "`dict CTRL -list` lists them; add a recipe with `dict CTRL -add NAME 'OPTIONS'`";
        UNKNOWN_OPTION = 4, Error, "no such option in the class's table", "CTRL -help lists them";
        VALUE = 5, Error, "a value is missing, of the wrong type or out of range",
            "CTRL -help shows what each option takes";
        RECIPE = 6, Error, "a recipe leads to itself, or grows too long",
            "look at the -SUBST of the entries that the report names";
        DAEMON = 7, Error, "a daemon cannot be reached from here",
            "see whether it runs, and what the dictionary says about its name";
        BUSY = 8, Error, "the object is in a call already",
            "an object cannot call itself, directly or not; or wait for the other caller";
        UNSUPPORTED = 9, Error, "the class does not do this", "CTRL -help says what it does";
        LOCKED = 10, Error, "the object is locked for somebody else",
            "wait until the lock expires, or use a flavor of your own";
        PANIC = 11, Error, "the object failed in a way that its author did not expect",
            "it was removed and its next use builds it anew; tell its author";
        SELF_TEST = 12, Error, "the object did not pass its self-test", "the text says what is wrong";
        PREPARED = 13, Error, "nothing is prepared under this name, or something else is",
            "prepare, then commit or abort, each once and before it expires";
        FILE = 14, Error, "a file cannot be read or written", "the text says which and why";
        REFUSED = 16, Error, "a task of the app refused what an object asked of it",
            "the text is what the task said";
        LATE = 17, Error, "the answer did not come within its limit",
            "the text says what it is at; wait longer with `scott --limit S`, or restart the chassis";
        NO_OBJECT = 15, Error, "there is no such object", "`sorm CTRL -list` lists them";
    }
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
            ..Self::default()
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
            text: text.into(),
            ..Self::default()
        }
    }

    /// Reads one line of a `TDBX` text: a printed report, or else a bare message.
    #[must_use]
    pub fn from_line(line: &str) -> Self {
        Self::from_full(line).unwrap_or_else(|| Self::message(line))
    }

    /// `severity code object process time_ns file line text`, each a word.
    fn from_full(line: &str) -> Option<Self> {
        let words = words::split(line).ok()?;
        let [severity, code, object, process, time, file, row, text] = words.as_slice() else {
            return None;
        };
        Some(Self {
            severity: Severity::from_word(&severity.text)?,
            code: code.text.parse().ok()?,
            text: text.text.clone(),
            file: file.text.clone(),
            line: row.text.parse().ok()?,
            object: object.text.clone(),
            process: process.text.clone(),
            time_ns: time.text.parse().ok()?,
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
            "{} {} {} {} {} {} {} {}",
            self.severity.word(),
            self.code,
            words::word(&self.object),
            words::word(&self.process),
            self.time_ns,
            words::word(&self.file),
            self.line,
            words::quoted(&self.text)
        )
    }
}

impl fmt::Display for Report {
    /// For people: `error 5 (foo.a in cage): text [file:line]`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.severity.word())?;
        if self.code != 0 {
            write!(f, " {}", self.code)?;
        }
        if !self.object.is_empty() {
            write!(f, " ({}", self.object)?;
            if !self.process.is_empty() {
                write!(f, " in {}", self.process)?;
            }
            f.write_str(")")?;
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
            (any::<String>(), any::<String>(), any::<u64>()),
        );
        let full = full.prop_map(|(severity, code, text, file, line, said)| Report {
            severity,
            code,
            text,
            file,
            line,
            object: said.0,
            process: said.1,
            time_ns: said.2,
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
        let line = "error 5 foo.a cage 1200 kitchen.rs 12 \"too cold\"";
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
