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
    /// Show every finding and not only the first 20
    #[arg(long)]
    pub all: bool,
    /// Show findings only, not how many there are
    #[arg(short, long)]
    pub quiet: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &CheckArgs, registry: &Registry) -> u8 {
    let (found, code) = match program::checked(&args.app.selection(), registry) {
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
    let most = if args.all {
        usize::MAX
    } else {
        show::FINDINGS_SHOWN
    };
    show::findings_up_to(found, most);
    if !args.quiet {
        show::say(&format!("{}: {counted}", args.app.file.display()));
    }
    code
}
