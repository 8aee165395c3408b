//! `ctos motion`: the manipulators of a running app in a terminal.

mod model;
mod screen;

use std::{io::IsTerminal, time::Duration};

use clap::Args;
use cli_common::{
    client::{Client, ClientError},
    exit,
    remote::{self, RemoteArgs},
    show, table,
};

use model::Sample;

/// Watch the manipulators of an app.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos motion
  ctos motion mcs
  ctos motion --once
  ctos motion --json | jq -c '.manipulators[] | {name, state, owner}'")]
pub struct MotionArgs {
    /// Names of manipulators, which are tasks with the handler `mcs.client`; all when none is named
    #[arg(value_name = "NAME")]
    pub names: Vec<String>,
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print it once, and leave
    #[arg(long)]
    pub once: bool,
    /// Print one JSON object per look
    #[arg(long)]
    pub json: bool,
    /// How often it is looked, s
    #[arg(long, value_name = "SECONDS", default_value = "0.5", value_parser = interval)]
    pub interval: Duration,
}

fn interval(text: &str) -> Result<Duration, String> {
    text.parse()
        .ok()
        .filter(|seconds| (0.1..=3600.0).contains(seconds))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "a number of seconds from 0.1 to 3600".to_owned())
}

/// Runs the command.
#[must_use]
pub fn run(args: &MotionArgs) -> u8 {
    let looked = args.remote.connect().and_then(|mut client| {
        let first = Sample::look(&mut client, &args.names)?;
        Ok((client, first))
    });
    let (mut client, first) = match looked {
        Ok(looked) => looked,
        Err(error) => return remote::failed(&error),
    };
    if let Some(text) = first.lacks(&args.names) {
        show::say(&format!("error: {text}"));
        return exit::NO_SUCH_NAME;
    }
    let full = std::io::stdout().is_terminal() && !args.once && !args.json;
    let ended = if full {
        screen::run(args, &mut client, first)
    } else {
        print(args, &mut client, first)
    };
    match ended {
        Ok(()) => exit::OK,
        Err(error) => remote::failed(&error),
    }
}

/// Prints samples until nobody reads them, or the app has gone.
fn print(args: &MotionArgs, client: &mut Client, first: Sample) -> Result<(), ClientError> {
    let mut sample = first;
    loop {
        if show::data(&printed(&sample, args.json)).is_err() || args.once {
            return Ok(());
        }
        // As long as a person would wait: this is not a part of an app, and has no clock of one.
        std::thread::park_timeout(args.interval);
        sample = match Sample::look(client, &args.names) {
            Ok(sample) => sample,
            // An app that has ended is not an error to one who watches it.
            Err(ClientError::Unreachable { .. }) => {
                show::say("the app has ended");
                return Ok(());
            }
            Err(error) => return Err(error),
        };
    }
}

fn printed(sample: &Sample, json: bool) -> String {
    if json {
        return serde_json::to_string(sample).unwrap_or_default();
    }
    let lines = sample.lines(table::width()).into_iter();
    let lines: Vec<String> = lines.map(|line| line.text).collect();
    lines.join("\n")
}
