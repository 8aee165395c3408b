//! `ctos explain`: what a finding means, at more length than the finding has.
//!
//! The texts are the sections of `docs/diagnostics.md`.

use clap::Args;
use ctos::diagnostic::Finding;

use cli_common::{exit, show, table};

const PAGE: &str = include_str!("../../../docs/diagnostics.md");

/// Tell what a finding means and what to do about it
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos explain ctos::config::unknown_key
  ctos explain")]
pub struct ExplainArgs {
    /// Code of the finding, for example `ctos::config::unknown_key`; without one, all codes are listed
    pub code: Option<String>,
    /// Print one JSON object per code
    #[arg(long)]
    pub json: bool,
}

/// Every code with its text, in the order of the page.
pub fn explanations() -> impl Iterator<Item = (&'static str, &'static str)> {
    let sections = PAGE.split("\n## ").skip(1);
    sections.map(|section| {
        let (code, text) = section.split_once('\n').unwrap_or((section, ""));
        (code.trim(), text.trim())
    })
}

/// Runs the command.
#[must_use]
pub fn run(args: &ExplainArgs) -> u8 {
    let Some(wanted) = &args.code else {
        for (code, text) in explanations() {
            let line = if args.json {
                json(code, text)
            } else {
                code.to_owned()
            };
            if show::data(&line).is_err() {
                break;
            }
        }
        return exit::OK;
    };
    match explanations().find(|(code, _)| code == wanted) {
        Some((code, text)) => {
            let shown = if args.json {
                json(code, text)
            } else {
                format!("{code}\n\n{}", laid_out(text))
            };
            // A closed pipe means that the reader has what it wanted.
            let _ = show::data(&shown);
            exit::OK
        }
        None => {
            let finding = Finding::error("", format!("no finding has the code `{wanted}`"));
            let codes = explanations().map(|(code, _)| code);
            show::say(&finding.suggest(wanted, codes).to_string());
            exit::NO_SUCH_NAME
        }
    }
}

/// The text of a page as a terminal shows it: the lines of a paragraph are one. Other outputs get it as it is.
fn laid_out(text: &str) -> String {
    if table::terminal(std::io::stdout()).is_none() {
        return text.to_owned();
    }
    table::for_terminal(&flowing(text))
}

/// The lines of each paragraph as one; those of code, which are indented or fenced, and of lists as they are.
fn flowing(text: &str) -> String {
    let mut out = String::new();
    let (mut open, mut fenced) = (false, false);
    for line in text.lines() {
        let fence = line.starts_with("```");
        let own = fenced || fence || line.is_empty() || line.starts_with([' ', '|', '-', '#']);
        fenced ^= fence;
        match (open && !own, out.is_empty()) {
            (true, _) => out.push(' '),
            (false, true) => {}
            (false, false) => out.push('\n'),
        }
        out.push_str(line);
        open = !own;
    }
    out
}

fn json(code: &str, text: &str) -> String {
    serde_json::json!({ "code": code, "text": text }).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paragraphs_flow_and_code_stays_as_it_is() {
        let text = "One line\nof two.\n\n    in p\n    out q\n\nDo: this\nand that.\n- a\n- b";
        assert_eq!(
            flowing(text),
            "One line of two.\n\n    in p\n    out q\n\nDo: this and that.\n- a\n- b"
        );
    }
}
