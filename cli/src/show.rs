//! Findings and events as a person, or a program, sees them.

use std::{
    fmt,
    io::{self, IsTerminal, Write},
};

use ctos::diagnostic::{Finding, Findings, Severity};
use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource};

/// At most so many findings are shown.
const FINDINGS_SHOWN: usize = 20;

/// Whether standard error takes colours: `NO_COLOR` wins over `CLICOLOR_FORCE`, which wins over what
/// the stream is.
#[must_use]
pub fn colours() -> bool {
    let set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    if set("NO_COLOR") {
        false
    } else {
        set("CLICOLOR_FORCE") || io::stderr().is_terminal()
    }
}

/// Writes to standard error. A closed stream is no reason to fail.
pub fn say(text: &str) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Writes a line of data to standard output.
///
/// # Errors
/// What the stream says, a closed pipe for example.
pub fn data(text: &str) -> io::Result<()> {
    writeln!(io::stdout(), "{text}")
}

/// Shows findings with the lines they are about, sorted by place.
pub fn findings(findings: Findings) {
    let theme = if colours() {
        GraphicalTheme::unicode()
    } else {
        GraphicalTheme::unicode_nocolor()
    };
    let handler = GraphicalReportHandler::new_themed(theme).with_links(false);
    let sorted = findings.into_sorted();
    let hidden = sorted.len().saturating_sub(FINDINGS_SHOWN);
    for finding in sorted.iter().take(FINDINGS_SHOWN) {
        let mut text = String::new();
        match handler.render_report(&mut text, &Drawn::new(finding)) {
            Ok(()) => say(text.trim_end_matches('\n')),
            Err(_) => say(&finding.to_string()),
        }
    }
    if hidden > 0 {
        say(&format!("… and {hidden} more"));
    }
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

/// A finding as one JSON object.
#[must_use]
pub fn finding_json(finding: &Finding) -> serde_json::Value {
    let place = finding.place.as_ref().map(|place| {
        let (line, column) = place.source.line_column(place.range.start);
        serde_json::json!({ "file": place.source.name(), "line": line, "column": column })
    });
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
