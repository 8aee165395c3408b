//! `ctos chassis`: the process of one chassis. People do not call it; `ctos boot` does.

use clap::Args;
use ctos::boot::Address;
use ctos::registry::Registry;
use ctos::time::Clock;

use cli_common::{exit, show};

use crate::{
    commands::args::{AppArgs, LogArgs, start_log},
    program,
};

/// Run one chassis of an app
#[derive(Debug, Args)]
pub struct ChassisArgs {
    /// Which app
    #[command(flatten)]
    pub app: AppArgs,
    /// How much to say
    #[command(flatten)]
    pub log: LogArgs,
    /// Name of the chassis
    #[arg(long)]
    pub chassis: String,
    /// Where the boot listens
    #[arg(long)]
    pub boot: Address,
    /// Start of the app on the host's monotonic clock, ns
    #[arg(long)]
    pub origin: u64,
}

/// Runs the command.
#[must_use]
pub fn run(args: &ChassisArgs, registry: Registry) -> u8 {
    if let Err(code) = start_log(
        &args.log,
        Clock::real_from(args.origin),
        false,
        String::new(),
    ) {
        return code;
    }
    let app = match program::app(&args.app.selection()) {
        Ok(app) => app,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    match ctos::boot::run_chassis(app, registry, &args.chassis, &args.boot, args.origin) {
        Ok(code) => u8::try_from(code).unwrap_or(exit::FAILED),
        Err(error) => {
            show::say(&format!("error: chassis `{}`: {error}", args.chassis));
            exit::UNREACHABLE
        }
    }
}
