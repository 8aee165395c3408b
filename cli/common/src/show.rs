//! Findings and events as a person, or a program, sees them.

use std::{
    ffi::OsString,
    fmt,
    io::{self, Write},
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

use anstream::{AutoStream, ColorChoice};
use clap::ValueEnum;
use ctos::{
    control::Level,
    diagnostic::{Finding, Findings, Place, Severity},
    time::Clock,
};
use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource};

use crate::table;

/// How wide a finding may be where no terminal says.
const WIDE: usize = 200;

/// So many findings are shown unless all are asked for.
pub const FINDINGS_SHOWN: usize = 20;

/// When to use colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Colour {
    /// `NO_COLOR` wins over `CLICOLOR_FORCE`, which wins over what the stream is
    #[default]
    Auto,
    /// Always
    Always,
    /// Never
    Never,
}

impl Colour {
    /// What a command line says, before it is parsed; `Auto` when it is wrong.
    pub fn of_command_line(arguments: impl IntoIterator<Item = OsString>) -> Self {
        let mut choice = Self::default();
        let mut arguments = arguments.into_iter().skip(1);
        while let Some(argument) = arguments.next() {
            let value = match argument.to_str() {
                Some("--") => break,
                Some("--color") => arguments.next(),
                Some(text) => text.strip_prefix("--color=").map(OsString::from),
                None => None,
            };
            let value = value.and_then(|value| Self::from_str(value.to_str()?, false).ok());
            choice = value.unwrap_or(choice);
        }
        choice
    }
}

/// Settles for this process when colours are used, by the help as by everything here.
pub fn choose_colour(choice: Colour) {
    let choice = match choice {
        Colour::Auto => ColorChoice::Auto,
        Colour::Always => ColorChoice::Always,
        Colour::Never => ColorChoice::Never,
    };
    choice.write_global();
}

/// Whether standard error takes colours.
#[must_use]
pub fn colours() -> bool {
    AutoStream::choice(&io::stderr()) != ColorChoice::Never
}

/// Whether everything on standard error is a JSON object in a line.
static JSON: AtomicBool = AtomicBool::new(false);

/// The clock of the app that is spoken of, once there is one.
static CLOCK: OnceLock<Clock> = OnceLock::new();

/// Settles for this process that its output is a JSON object per line, and by which clock.
pub fn say_json(clock: Option<Clock>) {
    JSON.store(true, Ordering::Relaxed);
    if let Some(clock) = clock {
        // The app sets it first; a simulation of many seeds has one clock for each.
        let _ = CLOCK.set(clock);
    }
}

/// Whether the output is JSON.
#[must_use]
pub fn says_json() -> bool {
    JSON.load(Ordering::Relaxed)
}

/// Writes to standard error. A closed stream is not a reason to fail.
pub fn say(text: &str) {
    let line = if says_json() {
        json_line(text)
    } else {
        text.to_owned()
    };
    // In one call, so that no line is cut by another.
    let _ = io::stderr().write_all(format!("{line}\n").as_bytes());
}

/// A text as a line of a JSON log; one that is such a line already stays as it is.
fn json_line(text: &str) -> String {
    if is_object(text) {
        return text.to_owned();
    }
    let seconds = CLOCK.get().map(|clock| {
        let seconds = clock.now().since_start().as_secs_f64();
        (seconds * 1e6).round() / 1e6
    });
    let level = match text.strip_prefix("warning:") {
        Some(_) => Level::Warn,
        None => Level::of(text),
    };
    let level = format!("{level:?}").to_uppercase();
    let object = serde_json::json!({ "timestamp": seconds, "level": level, "message": text });
    object.to_string()
}

fn is_object(text: &str) -> bool {
    text.starts_with('{') && serde_json::from_str::<serde_json::Value>(text).is_ok()
}

/// A line that chassis `chassis` has written, as it stands in a log of several; names are `width` wide.
#[must_use]
pub fn line_of_chassis(chassis: &str, width: usize, line: &str) -> String {
    if !says_json() {
        return format!("{chassis:<width$} │ {line}");
    }
    let line = json_line(line);
    // It is an object, and not an empty one or there is nothing to say of it.
    let rest = line.trim_start_matches('{').trim_start();
    let comma = if rest == "}" { "" } else { "," };
    let name = serde_json::Value::from(chassis);
    format!("{{\"chassis\":{name}{comma}{rest}")
}

/// Writes a line of data to standard output.
///
/// # Errors
/// What the stream says, a closed pipe for example.
pub fn data(text: &str) -> io::Result<()> {
    writeln!(io::stdout(), "{text}")
}

/// Shows findings with the lines they are about, sorted by place, [`FINDINGS_SHOWN`] at most.
pub fn findings(findings: Findings) {
    findings_up_to(findings, FINDINGS_SHOWN);
}

/// Shows up to `most` findings with the lines they are about, sorted by place, and how to learn more.
pub fn findings_up_to(findings: Findings, most: usize) {
    let theme = if colours() {
        GraphicalTheme::unicode()
    } else {
        GraphicalTheme::unicode_nocolor()
    };
    let width = table::terminal(io::stderr()).unwrap_or(WIDE);
    let handler = GraphicalReportHandler::new_themed(theme)
        .with_links(false)
        .with_width(width);
    let sorted = findings.into_sorted();
    for finding in sorted.iter().take(most) {
        if says_json() {
            say(&log_json(finding).to_string());
            continue;
        }
        let mut text = String::new();
        let drawn = is_drawn(finding) && {
            let drawn = Drawn::new(finding);
            handler.render_report(&mut text, &drawn).is_ok()
        };
        if drawn {
            say(text.trim_end_matches('\n'));
        } else {
            say(&finding.to_string());
        }
    }
    let hidden = sorted.len().saturating_sub(most);
    if hidden > 0 {
        say(&format!(
            "… and {hidden} more; `ctos check --all` shows all of them"
        ));
    }
    if let Some(first) = sorted.first().filter(|_| !says_json()) {
        say(&format!("`ctos explain {}` tells more", first.code));
    }
}

/// Whether the lines around a finding's place are short enough to be shown.
fn is_drawn(finding: &Finding) -> bool {
    const LONGEST_TEXT: usize = 1 << 20;
    const LONGEST_LINE: usize = 1000;
    let Some(place) = &finding.place else {
        return true;
    };
    let text = place.source.text();
    let middle = place.range.start.min(text.len());
    let from = middle.saturating_sub(LONGEST_LINE);
    let to = (middle + LONGEST_LINE).min(text.len());
    let around = text.as_bytes().get(from..to).unwrap_or_default();
    // A window without any line end in a text that goes on beyond it is one long line.
    let long = to - from > LONGEST_LINE && !around.contains(&b'\n');
    text.len() <= LONGEST_TEXT && !long
}

/// A finding as miette draws it.
#[derive(Debug)]
struct Drawn<'a> {
    finding: &'a Finding,
    source: Option<NamedSource<String>>,
}

impl<'a> Drawn<'a> {
    fn new(finding: &'a Finding) -> Self {
        let source = finding
            .place
            .as_ref()
            .map(|place| NamedSource::new(place.source.name(), place.source.text().to_owned()));
        Self { finding, source }
    }
}

impl fmt::Display for Drawn<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.finding.message)
    }
}

impl std::error::Error for Drawn<'_> {}

impl Diagnostic for Drawn<'_> {
    fn code<'b>(&'b self) -> Option<Box<dyn fmt::Display + 'b>> {
        Some(Box::new(self.finding.code))
    }

    fn severity(&self) -> Option<miette::Severity> {
        Some(match self.finding.severity {
            Severity::Warning => miette::Severity::Warning,
            Severity::Error => miette::Severity::Error,
        })
    }

    fn help<'b>(&'b self) -> Option<Box<dyn fmt::Display + 'b>> {
        let help = self.finding.help.as_ref()?;
        Some(Box::new(help))
    }

    fn source_code(&self) -> Option<&dyn miette::SourceCode> {
        let source = self.source.as_ref()?;
        Some(source)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let place = self.finding.place.as_ref()?;
        let label = match self.finding.label.as_str() {
            "" => "here",
            label => label,
        };
        let length = place.range.len().max(1);
        let span = LabeledSpan::new(Some(label.to_owned()), place.range.start, length);
        Some(Box::new(std::iter::once(span)))
    }
}

/// A place as one JSON object.
#[must_use]
pub fn place_json(place: &Place) -> serde_json::Value {
    let (line, column) = place.source.line_column(place.range.start);
    serde_json::json!({ "file": place.source.name(), "line": line, "column": column })
}

/// A finding as one JSON object.
#[must_use]
pub fn finding_json(finding: &Finding) -> serde_json::Value {
    let place = finding.place.as_ref().map(place_json);
    serde_json::json!({
        "code": finding.code,
        "severity": match finding.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        },
        "message": finding.message,
        "place": place,
        "help": finding.help,
    })
}

/// A finding as a line of a JSON log.
fn log_json(finding: &Finding) -> serde_json::Value {
    let mut object = finding_json(finding);
    let level = match finding.severity {
        Severity::Error => "ERROR",
        Severity::Warning => "WARN",
    };
    if let Some(object) = object.as_object_mut() {
        object.insert("level".to_owned(), level.into());
    }
    object
}

/// "3 errors, 1 warning".
#[must_use]
pub fn counted(findings: &Findings) -> String {
    let errors = findings
        .iter()
        .filter(|finding| finding.severity == Severity::Error)
        .count();
    let warnings = findings.iter().count() - errors;
    let plural = |count: usize, word: &str| match count {
        0 => None,
        1 => Some(format!("1 {word}")),
        _ => Some(format!("{count} {word}s")),
    };
    let parts: Vec<String> = [plural(errors, "error"), plural(warnings, "warning")]
        .into_iter()
        .flatten()
        .collect();
    if parts.is_empty() {
        "nothing found".to_owned()
    } else {
        parts.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_is_said_in_a_json_log_is_an_object_in_a_line() {
        for (text, level) in [
            ("error: nothing\nhere", "ERROR"),
            ("warning: a leak", "WARN"),
            ("phase 1  create", "INFO"),
            ("{ not json", "INFO"),
        ] {
            let line = json_line(text);
            let object: serde_json::Value = serde_json::from_str(&line).unwrap();
            assert_eq!(object["message"], text, "{line}");
            assert_eq!(object["level"], level, "{line}");
            assert!(!line.contains('\n'), "{line}");
        }
        let object = r#"{"level":"INFO","message":"one"}"#;
        assert_eq!(json_line(object), object);
    }

    #[test]
    fn the_colour_of_a_command_line_is_known_before_it_is_parsed() {
        let choice =
            |line: &str| Colour::of_command_line(line.split_whitespace().map(OsString::from));
        assert_eq!(choice("ctos check a.toml"), Colour::Auto);
        assert_eq!(choice("ctos --color never check"), Colour::Never);
        assert_eq!(choice("ctos check --color=always"), Colour::Always);
        assert_eq!(choice("ctos --color=purple check"), Colour::Auto);
        assert_eq!(choice("ctos check -- --color=always"), Colour::Auto);
        assert_eq!(choice("ctos check --color"), Colour::Auto);
    }
}
