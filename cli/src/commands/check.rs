//! `ctos check`.

use std::path::PathBuf;

use clap::Args;
use ctos::{config::Selection, registry::Registry};

use cli_common::{exit, show};

use crate::{
    commands::{args::AppArgs, ports},
    program,
};

/// Check apps without starting anything
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos check configs/calibrate.toml --json
  ctos check apps/*.toml")]
pub struct CheckArgs {
    /// Which app
    #[command(flatten)]
    pub app: AppArgs,
    /// Further apps to check, with the same overrides and profiles
    #[arg(value_name = "FILE")]
    pub more: Vec<PathBuf>,
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

/// Runs the command. The code is the worst of all apps.
#[must_use]
pub fn run(args: &CheckArgs, registry: &Registry) -> u8 {
    let further = args.more.iter().map(|file| Selection {
        file: file.clone(),
        ..args.app.selection()
    });
    let all = std::iter::once(args.app.selection()).chain(further);
    let codes = all.map(|selection| check(&selection, args, registry));
    codes.max().unwrap_or(exit::OK)
}

fn check(selection: &Selection, args: &CheckArgs, registry: &Registry) -> u8 {
    let (found, code) = match program::checked(selection, registry) {
        Ok((app, mut warnings)) => {
            // The app may be running, and have its ports itself: no error.
            warnings.extend(ports::warnings(&app));
            (warnings, exit::OK)
        }
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
        show::say(&format!("{}: {counted}", selection.file.display()));
    }
    code
}
