//! Arguments that several commands have: which app, and how much the log says.

use std::path::PathBuf;

use clap::Args;
use cli_common::{exit, show};
use ctos::config::Selection;

use crate::log::{LogFormat, LogSetting};

/// Which app, with what changed.
#[derive(Debug, Clone, Args)]
pub struct AppArgs {
    /// Configuration of the app
    pub file: PathBuf,
    /// Override a value of the configuration, for example `--set time.mode="virtual"` (can be repeated)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Lay `[profile.NAME]` of the configuration over it, in place of what `app.profile` says (can be repeated)
    #[arg(long = "profile", value_name = "NAME")]
    pub profiles: Vec<String>,
}

impl AppArgs {
    /// What to read the app by.
    #[must_use]
    pub fn selection(&self) -> Selection {
        Selection {
            file: self.file.clone(),
            profiles: self.profiles.clone(),
            sets: self.sets.clone(),
        }
    }
}

/// How much to say.
#[derive(Debug, Clone, Args)]
pub struct LogArgs {
    /// Show more: `-v` net transitions as they fire, `-vv` what the runtime does (can be repeated)
    #[arg(short, long, action = clap::ArgAction::Count, conflicts_with = "quiet")]
    pub verbose: u8,
    /// Show results and errors only
    #[arg(short, long)]
    pub quiet: bool,
    /// Filter of the log in the form of RUST_LOG, where a name is a module's or a task's, for example
    /// `warn,arm=debug`; overrides `-v`
    #[arg(long, value_name = "FILTER")]
    pub log: Option<String>,
    /// How log lines look
    #[arg(long, value_enum, value_name = "FORMAT", default_value_t)]
    pub log_format: LogFormat,
}

/// What is shown where nothing else is asked for: warnings, and the addresses of pages.
const SHOWN: &str = "warn,ctos::page=info";

/// Starts logging or says why it cannot; the exit code then. Lines of text begin with `process`.
pub(super) fn start_log(
    args: &LogArgs,
    clock: ctos::time::Clock,
    ansi: bool,
    process: String,
) -> Result<(), u8> {
    let level = match (args.quiet, args.verbose) {
        (true, _) => "error",
        (false, 0) => SHOWN,
        (false, 1) => "info",
        (false, 2) => "debug",
        (false, _) => "trace",
    };
    if args.quiet {
        sorma::sound::silence();
    }
    if args.log_format == LogFormat::Json {
        show::say_json(Some(clock.clone()));
    }
    let setting = LogSetting {
        level,
        filter: args.log.as_deref(),
        format: args.log_format,
        ansi,
        process,
    };
    crate::log::start(setting, clock).map_err(|error| {
        show::say(&format!("error: {error}"));
        exit::USAGE
    })
}
