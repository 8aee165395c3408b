//! What a person says comes on the tapes, against the nets that have them.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use ctos::diagnostic::{Finding, Findings, Source};

pub use crate::compose::tape::Tape;

use pnt_language::{
    language::{
        Expression, Language, SymbolNumber,
        parse::{Written, parse},
    },
    net::Net,
};

/// Reads what comes on the tapes of nets: `calibrate (carry | resect)* park`. The name of the net and
/// a colon stand before it where several nets have a tape. The whole form is that of
/// [`pnt_language::language::parse`].
///
/// # Errors
/// All findings about one text, each with its place there.
pub fn tapes(source: &Source, nets: &[Arc<Net>]) -> Result<Vec<Tape>, Findings> {
    let written = parse(source)?;
    let mut findings = Findings::new();
    let mut tapes: Vec<Tape> = Vec::new();
    for written in &written {
        match tape(source, written, nets) {
            Ok(tape) => tapes.push(tape),
            Err(found) => findings.extend(found),
        }
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(tapes)
    }
}

/// Reports tapes that are given twice.
#[must_use]
pub fn given_twice(tapes: &[Tape]) -> Findings {
    let mut findings = Findings::new();
    for (number, tape) in tapes.iter().enumerate() {
        if tapes.iter().take(number).any(|other| other.net == tape.net) {
            let text = format!("the tape of net `{}` is given twice", tape.net);
            let finding = Finding::error("pnt::tape::twice", text);
            findings
                .push(finding.help("join the two with `|` if either may come, or leave one away"));
        }
    }
    findings
}

fn tape(source: &Source, written: &Written, nets: &[Arc<Net>]) -> Result<Tape, Findings> {
    let net = net_of(source, written, nets)?;
    let mut findings = Findings::new();
    let commands = net.commands();
    let expression: Expression<SymbolNumber> = written.expression.map(&mut |word| {
        let found = commands.iter().position(|c| c.symbol == word.text);
        if found.is_none() {
            let text = format!(
                "net `{}` has no command `{}` on its tape",
                net.name(),
                word.text
            );
            findings.push(
                Finding::error("pnt::tape::unknown_symbol", text)
                    .at(source.at(word.range.clone()))
                    .suggest(&word.text, commands.iter().map(|c| c.symbol.as_str())),
            );
        }
        found.unwrap_or_default()
    });
    if findings.has_errors() {
        return Err(findings);
    }
    match Language::new(&expression, commands.len()) {
        Ok(language) => Ok(Tape {
            net: net.name().to_owned(),
            text: one_line(source.text().get(written.range.clone()).unwrap_or_default()),
            language,
        }),
        Err(error) => Err(Finding::error("pnt::tape::too_large", error.to_string())
            .at(source.at(written.range.clone()))
            .help("repeat fewer times by number; `*` and `+` take no room")
            .into()),
    }
}

/// The net whose tape is meant.
fn net_of<'a>(
    source: &Source,
    written: &Written,
    nets: &'a [Arc<Net>],
) -> Result<&'a Arc<Net>, Finding> {
    let with_tape = || nets.iter().filter(|net| !net.commands().is_empty());
    let no_tape = |text: String| {
        Finding::error("pnt::tape::no_tape", text)
            .help("a net has a tape when it has a `command` line; leave `--tape` away for others")
    };
    let Some(named) = &written.net else {
        let all: Vec<&Arc<Net>> = with_tape().collect();
        return match all.as_slice() {
            [only] => Ok(*only),
            [] => Err(no_tape("no net here has an input tape".to_owned())
                .at(source.at(written.range.clone()))),
            several => {
                let names: Vec<&str> = several.iter().map(|net| net.name()).collect();
                let text = "several nets have an input tape, and it is not said whose this is";
                Err(Finding::error("pnt::tape::which_net", text)
                    .at(source.at(written.range.clone()))
                    .help(format!(
                        "write the net and a colon before it, as in `{}: ...`; the nets are {}",
                        names[0],
                        names.join(", ")
                    )))
            }
        };
    };
    let at = source.at(named.range.clone());
    match nets.iter().find(|net| net.name() == named.text) {
        Some(net) if net.commands().is_empty() => {
            Err(no_tape(format!("net `{}` has no input tape", named.text)).at(at))
        }
        Some(net) => Ok(net),
        None => {
            let text = format!("there is no net `{}` here", named.text);
            let names = with_tape().map(|net| net.name());
            Err(Finding::error("pnt::tape::unknown_net", text)
                .at(at)
                .suggest(&named.text, names))
        }
    }
}

/// A text without comments and breaks of lines, to be shown.
fn one_line(text: &str) -> String {
    let code = |line: &str| {
        let mut quoted = false;
        let comment = line.char_indices().find(|(_, character)| {
            quoted ^= *character == '"';
            *character == '#' && !quoted
        });
        let end = comment.map_or(line.len(), |(at, _)| at);
        line.get(..end).unwrap_or_default().trim().to_owned()
    };
    let lines: Vec<String> = text.lines().map(code).collect();
    lines.join(" ").trim().to_owned()
}
