//! `ctos explain`: what a finding means, at more length than the finding has.
//!
//! The texts are the sections of `docs/diagnostics.md`.

use clap::Args;
use ctos::diagnostic::Finding;

use cli_common::{exit, show};

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
                format!("{code}\n\n{text}")
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

fn json(code: &str, text: &str) -> String {
    serde_json::json!({ "code": code, "text": text }).to_string()
}
