//! The commands of `ctos`, a file each; those on running apps are in `cli/running`, those on nets in `cli/net`, and
//! `ctos display` and `ctos net draw` in `cli/display`.

pub mod agent;
pub mod args;
pub mod boot;
pub mod breakpoints;
pub mod chassis;
pub mod check;
pub mod completions;
pub mod config;
pub mod doctor;
pub mod explain;
pub mod keys;
pub mod log;
pub mod motion;
pub mod net;
pub mod new;
pub mod replay;
pub mod sim;
pub mod ways;

mod detach;
mod ports;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};
use cli_common::{
    exit,
    show::{self, Colour},
};
use cli_display::watch as display;
use cli_running::{logs, move_task, ps, record, restart, status, stop, top};
use ctos::registry::Registry;

const EXAMPLES: &str = "Examples:
  ctos new my-app
  ctos check configs/calibrate.toml
  ctos boot configs/calibrate.toml
  ctos boot configs/calibrate.toml --set time.mode=\"virtual\" --set seed=7 --json";

/// Event handlers, booted from a file and sequenced by Petri nets
///
/// An app is one configuration file: chassis (processes), processors (threads) and tasks (event handlers), the nets
/// that sequence them, and what they work on. `ctos check` finds what is wrong with it; `ctos boot` runs it.
#[derive(Debug, Parser)]
#[command(name = "ctos", version, max_term_width = 100)]
#[command(after_help = format!("{EXAMPLES}\n\n{}", exit::help()))]
pub struct Cli {
    /// When to use colours; `auto` asks NO_COLOR, then CLICOLOR_FORCE, then the terminal
    #[arg(long, global = true, value_enum, value_name = "WHEN", default_value_t)]
    pub color: Colour,
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Check apps without starting anything
    ///
    /// Reads the configuration and everything it names, resolves every name, and explores the state space of all
    /// nets composed. All findings are shown at once, each with its place and what to do.
    Check(check::CheckArgs),
    /// Check an app, start it, wait for its result and stop it
    ///
    /// Every chassis becomes a process, every processor a thread; `--set time.mode="virtual"` runs the whole app in
    /// one process on the virtual clock instead. Ctrl-C stops it in order, a second Ctrl-C skips a step.
    Boot(boot::BootArgs),
    /// Wait on this host for boots of other hosts, and run their chassis
    Agent(agent::AgentArgs),
    /// Make and list keys for connections beyond this host
    Keys(keys::KeysArgs),
    /// Run a whole app on one thread in virtual time, with faults
    Sim(sim::SimArgs),
    /// Show what a configuration comes to, every key there is, or the schema for editors
    Config(config::ConfigArgs),
    /// Watch the nets of a running app in the terminal, or those of a recorded run in a browser
    ///
    /// Without a record: the nets of a running app, one at a time, with what runs, what is enabled, the last events, and the
    /// neighbourhood of a transition. With records (MCAP): serves the page that `ctos boot --display` serves for a running
    /// app, on the loopback, until Ctrl-C; the run can be played, stepped and scrubbed. Several files of one run, one of each
    /// process, are shown together.
    Display(display::DisplayArgs),
    /// Tell what this host permits, and whether that is enough for an app
    Doctor(doctor::DoctorArgs),
    /// Tell what a finding means and what to do about it
    Explain(explain::ExplainArgs),
    /// Check nets, and other tools of whoever writes them
    Net(net::NetArgs),
    /// Write a small app of your own: handlers, configuration, net, test, page
    ///
    /// The folder must not be there yet. Its last part is the name of the app: letters, digits, `-` and `_`,
    /// beginning with a letter.
    New(new::NewArgs),
    /// Record a running app, until Ctrl-C
    Record(record::RecordArgs),
    /// Look into records (MCAP) of apps
    Log(log::LogCommandArgs),
    /// Let one task do again what it did in a record, and compare
    Replay(replay::ReplayArgs),
    /// Show the running apps, their chassis and their tasks
    Ps(ps::PsArgs),
    /// Show everything about one task or chassis on one screen
    Status(status::StatusArgs),
    /// Show the log of an app, a chassis or a task
    Logs(logs::LogsArgs),
    /// Stop an app in order
    Stop(stop::StopArgs),
    /// Restart a task, or a chassis with all its tasks
    Restart(restart::RestartArgs),
    /// Move a running task to another processor or chassis
    Move(move_task::MoveArgs),
    /// Watch the tasks of an app, busiest first
    Top(top::TopArgs),
    /// Watch the manipulators of an app
    ///
    /// For each: its state and owner, why it was stopped last, every joint with its place between its limits, its distance
    /// from its setpoint and its torque, and what the sensors read. Keys: arrows scroll, `Esc` or Ctrl-C leaves. Without a
    /// terminal on standard output it prints the same again and again.
    Motion(motion::MotionArgs),
    /// Show what Coordinators believe of the ways of each step
    ///
    /// For each way its chance of success and its cost, as they are believed, and how often it was tried. The way that was
    /// chosen last is marked.
    Ways(ways::WaysArgs),
    /// Print completions for a shell
    Completions(completions::CompletionsArgs),
    /// Run one chassis of an app (started by `ctos boot`)
    #[command(hide = true)]
    Chassis(chassis::ChassisArgs),
}

/// Runs the command line of this process for the event handlers of `registry`.
#[must_use]
pub fn main(mut registry: Registry) -> ExitCode {
    crate::tell_build();
    pnt::store::keep_states(&mut registry);
    // Reports a handler's panic, also in a command without a log.
    let shown = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        ctos::note_panic(panic);
        shown(panic);
    }));
    // Help and usage errors are shown while the command line is parsed: colours are settled before.
    show::choose_colour(Colour::of_command_line(std::env::args_os()));
    let cli = Cli::parse();
    let code = match cli.command {
        Command::Check(args) => check::run(&args, &registry),
        Command::Boot(args) => boot::run(&args, registry),
        Command::Agent(args) => agent::run(&args, registry),
        Command::Keys(args) => keys::run(&args),
        Command::Sim(args) => sim::run(&args, registry),
        Command::Config(args) => config::run(&args),
        Command::Display(args) => display::run(&args, &registry),
        Command::Doctor(args) => doctor::run(&args),
        Command::Explain(args) => explain::run(&args),
        Command::Net(args) => net::run(&args, registry),
        Command::New(args) => new::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Log(args) => log::run(&args),
        Command::Replay(args) => replay::run(&args, registry),
        Command::Ps(args) => ps::run(&args),
        Command::Status(args) => status::run(&args),
        Command::Logs(args) => logs::run(&args),
        Command::Stop(args) => stop::run(&args),
        Command::Restart(args) => restart::run(&args),
        Command::Move(args) => move_task::run(&args),
        Command::Top(args) => top::run(&args),
        Command::Motion(args) => motion::run(&args),
        Command::Ways(args) => ways::run(&args),
        Command::Completions(args) => completions::run(&args, &mut Cli::command()),
        Command::Chassis(args) => chassis::run(&args, registry),
    };
    ExitCode::from(code)
}
