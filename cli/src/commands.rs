//! The commands of `ctos`, a file each.

pub mod boot;
pub mod chassis;
pub mod check;
pub mod completions;
pub mod sim;

mod progress;

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, Parser, Subcommand};

use ctos::registry::Registry;

use crate::{exit, show};

/// Event handlers, booted from a file and sequenced by Petri nets
///
/// An app is one configuration file: chassis (processes), processors (threads) and tasks (event handlers), the nets
/// that sequence them, and what they work on. `ctos check` finds what is wrong with it; `ctos boot` runs it.
#[derive(Debug, Parser)]
#[command(name = "ctos", version, max_term_width = 100)]
#[command(after_help = "Examples:
  ctos check configs/calibrate.toml
  ctos boot configs/calibrate.toml
  ctos boot configs/calibrate.toml --set time.mode=\"virtual\" --set seed=7 --json

Exit codes:
  0 fine                  3 wrong configuration
  1 failed                5 a chassis cannot be started
  2 wrong command line    130 interrupted")]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Check an app without starting anything
    Check(check::CheckArgs),
    /// Check an app, start it, wait for its result and stop it
    Boot(boot::BootArgs),
    /// Run a whole app on one thread in virtual time, with faults
    Sim(sim::SimArgs),
    /// Print completions for a shell
    Completions(completions::CompletionsArgs),
    /// Run one chassis of an app (started by `ctos boot`)
    #[command(hide = true)]
    Chassis(chassis::ChassisArgs),
}

/// Which app, with what changed.
#[derive(Debug, Clone, Args)]
pub struct AppArgs {
    /// Configuration of the app
    pub file: PathBuf,
    /// Override a value of the configuration, for example `--set time.mode="virtual"` (can be repeated)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
}

/// How much to say.
#[derive(Debug, Clone, Args)]
pub struct LogArgs {
    /// Show more: `-v` net transitions as they fire, `-vv` what the runtime does (can be repeated)
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Filter of the log in the form of RUST_LOG, for example `pnt=debug`; overrides `-v`
    #[arg(long, value_name = "FILTER")]
    pub log: Option<String>,
}

/// Runs the command line of this process for the event handlers of `registry`.
#[must_use]
pub fn main(registry: Registry) -> ExitCode {
    let cli = Cli::parse();
    let code = match cli.command {
        Command::Check(args) => check::run(&args, &registry),
        Command::Boot(args) => boot::run(&args, registry),
        Command::Sim(args) => sim::run(&args, registry),
        Command::Completions(args) => completions::run(&args),
        Command::Chassis(args) => chassis::run(&args, registry),
    };
    ExitCode::from(code)
}

/// Starts logging or says why it cannot; the exit code then.
fn start_log(args: &LogArgs, clock: ctos::time::Clock, ansi: bool) -> Result<(), u8> {
    crate::log::start(args.verbose, args.log.as_deref(), clock, ansi).map_err(|error| {
        show::say(&format!("error: {error}"));
        exit::USAGE
    })
}
