//! `ctos check`.

use clap::Args;
use ctos::registry::Registry;

use crate::{commands::AppArgs, exit, program, show};

/// Check an app without starting anything
///
/// Reads the configuration and everything it names, resolves every name, and explores the state space of all nets
/// composed. All findings are shown at once, each with its place and what to do.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  ctos check configs/calibrate.toml --json")]
pub struct CheckArgs {
    /// Which app
    #[command(flatten)]
    pub app: AppArgs,
    /// Print one JSON object per finding
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &CheckArgs, registry: &Registry) -> u8 {
    let (found, code) = match program::checked(&args.app.file, &args.app.sets, registry) {
        Ok((_, warnings)) => (warnings, exit::OK),
        Err(findings) => (findings, exit::CONFIG),
    };
    if args.json {
        for finding in found.into_sorted() {
            if show::data(&show::finding_json(&finding).to_string()).is_err() {
                break;
            }
        }
        return code;
    }
    let counted = show::counted(&found);
    show::findings(found);
    show::say(&format!("{}: {counted}", args.app.file.display()));
    code
}
