//! `ctos net run`: one net by itself, without a configuration.

use std::{
    fmt::Write as _,
    net::SocketAddr,
    path::{Path, PathBuf},
};

use clap::Args;
use ctos::{diagnostic::Findings, registry::Registry};
use pnt::{format, net::Net};
use serde_json::json;

use cli_common::{exit, show};

use crate::commands::{
    args::{AppArgs, LogArgs},
    boot::{self, BootArgs, DISPLAY, InjureArgs, Until},
    breakpoints::Breakpoints,
    sim::{self, SimArgs},
};

/// Run one net by itself, without a configuration
///
/// The net runs with the handler `pnt.net`, beside a daemon `objects` that serves every class of this program. With
/// `--tape` one command is put on its tape, in virtual time, and the answer ends the run. The exit code is 0 when it is
/// the first of the command's answers. With `--display` the net runs in real time, and a page shows it; people may
/// intervene there.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net run configs/nets/greet.net --tape 'greet world 3'
  ctos net run configs/nets/greet.net --tape 'greet world 3' --stand-in --fail 0.3 --seed 7 -v
  ctos net run configs/nets/greet.net --display")]
pub struct RunArgs {
    /// The net
    pub file: PathBuf,
    /// A command for its tape, with its arguments
    #[arg(long, value_name = "COMMAND", required_unless_present = "display")]
    pub tape: Option<String>,
    /// Ask nobody: every action succeeds after its stated time, and functions of a library say yes or no by chance
    #[arg(long)]
    pub stand_in: bool,
    /// With `--stand-in`: the chance that an action that would ask somebody fails, from 0 to 1
    #[arg(
        long,
        value_name = "CHANCE",
        requires = "stand_in",
        default_value_t = 0.0
    )]
    pub fail: f64,
    /// Seed of everything that is drawn
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Run in real time, and serve a page that shows the net; at ADDRESS, or on the loopback
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = DISPLAY)]
    pub display: Option<SocketAddr>,
    /// How much to say
    #[command(flatten)]
    pub log: LogArgs,
}

/// Runs the command.
#[must_use]
pub fn run(args: &RunArgs, registry: Registry) -> u8 {
    if !(0.0..=1.0).contains(&args.fail) {
        show::say("error: `--fail` is a chance from 0 to 1");
        return exit::USAGE;
    }
    let config = match config(args) {
        Ok(config) => config,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    let folder = match tempfile::tempdir() {
        Ok(folder) => folder,
        Err(error) => {
            show::say(&format!("error: no folder can be made: {error}"));
            return exit::FAILED;
        }
    };
    let file = folder.path().join("run.toml");
    if let Err(error) = std::fs::write(&file, config) {
        show::say(&format!("error: {}: {error}", file.display()));
        return exit::FAILED;
    }
    match args.display {
        None => sim::run(&in_virtual_time(file, args.log.clone()), registry),
        Some(_) => boot::run(&in_real_time(file, args), registry),
    }
}

fn in_virtual_time(file: PathBuf, log: LogArgs) -> SimArgs {
    SimArgs {
        file: Some(file),
        sets: Vec::new(),
        overlays: Vec::new(),
        breakpoints: Breakpoints::default(),
        seed: None,
        seeds: None,
        faults: "none".to_owned(),
        limit: None,
        events: None,
        record: None,
        shrink: None,
        json: false,
        profiles: false,
        cpu: false,
        log,
        // The seed is in the arguments, or it is the first one of all.
        repeated_by: Some(
            std::env::args()
                .map(|word| sim::quoted(&word))
                .collect::<Vec<_>>()
                .join(" "),
        ),
    }
}

fn in_real_time(file: PathBuf, args: &RunArgs) -> BootArgs {
    BootArgs {
        app: AppArgs {
            file,
            sets: Vec::new(),
            profiles: Vec::new(),
        },
        display: args.display,
        allow_control: true,
        log: args.log.clone(),
        json: false,
        injure: InjureArgs::default(),
        breakpoints: Breakpoints::default(),
        record: None,
        foxglove: None,
        detach: false,
        until: Until::default(),
        log_file: None,
    }
}

/// The configuration of an app with nothing but the net and what it needs.
fn config(args: &RunArgs) -> Result<String, Findings> {
    let (net, _) = format::load(&args.file)?;
    let path = std::path::absolute(&args.file).unwrap_or_else(|_| args.file.clone());
    Ok(text(args, &net, &path))
}

fn text(args: &RunArgs, net: &Net, path: &Path) -> String {
    // A name or text as TOML has it: JSON's form of a string is one.
    let quoted = |text: &str| json!(text).to_string();
    let helper = |name: &str| match name == net.name() {
        true => format!("{name}_of_run"),
        false => name.to_owned(),
    };
    let (objects, operator) = (helper("objects"), helper("operator"));
    let stand_in = match args.stand_in {
        true => format!(", stand_in = {{ fail = {:?} }}", args.fail),
        false => String::new(),
    };
    let mut out = String::from("[app]\nname = \"net_run\"\n");
    let mut words = args.tape.iter().flat_map(|tape| tape.split_whitespace());
    let command = words.next();
    if command.is_some() {
        // Writing to a text cannot fail.
        let _ = writeln!(out, "until = \"{operator}\"");
    }
    let _ = writeln!(out, "seed = {}\n[chassis.net]", args.seed);
    let _ = writeln!(
        out,
        "[task.{}]\nhandler = \"pnt.net\"\non = \"net\"\nargs = {{ net = {}, daemon = \"{objects}\", allow_control = true{stand_in} }}",
        quoted(net.name()),
        quoted(&path.display().to_string()),
    );
    let _ = writeln!(
        out,
        "[task.{objects}]\nhandler = \"sorma.daemon\"\non = \"net\""
    );
    if let Some(command) = command {
        let arguments: Vec<&str> = words.collect();
        let known = net.command(command).map(|id| &net[id].answers);
        let success = known.and_then(|answers| answers.first());
        let success = success.map_or("", String::as_str);
        let _ = writeln!(
            out,
            "[task.{operator}]\nhandler = \"coordinators.operator\"\non = \"net\"\nargs = {{ dispatcher = {}, command = {}, arguments = {}, success = {} }}",
            quoted(net.name()),
            quoted(command),
            json!(arguments),
            quoted(success),
        );
    }
    out
}
