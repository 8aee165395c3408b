//! `ctos top`.

mod model;
mod screen;

use std::{io::IsTerminal, time::Duration};

use clap::{Args, ValueEnum};

use cli_common::{
    client::{Client, ClientError},
    exit,
    remote::{self, RemoteArgs},
    show, table,
};

use model::{Model, Sample};

/// Watch the tasks of an app, busiest first
///
/// Rates and shares are those of the last second. Keys: `b` `m` `q` `w` `n` sort by busy share, messages, queue, wait
/// and name, arrows scroll, `Esc` or Ctrl-C leaves. Without a terminal on standard output it prints a table every
/// second.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos top
  ctos top --sort queue
  ctos top --once
  ctos top --json | jq -c '.tasks[] | {name, busy}'")]
pub struct TopArgs {
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print one table, of the next second, and leave
    #[arg(long)]
    pub once: bool,
    /// Print one JSON object per second
    #[arg(long)]
    pub json: bool,
    /// What the tasks are sorted by
    #[arg(long, value_enum, default_value_t)]
    pub sort: Sort,
    /// How often it is looked, s
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = interval)]
    pub interval: Duration,
}

/// What tasks are sorted by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Sort {
    /// Share of the time that the handler is busy
    #[default]
    Busy,
    /// Messages handled per second
    Messages,
    /// Messages in the queue
    Queue,
    /// How long it waits for another task
    Wait,
    /// Chassis and name
    Name,
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
pub fn run(args: &TopArgs) -> u8 {
    let mut client = match args.remote.connect() {
        Ok(client) => client,
        Err(error) => return remote::failed(&error),
    };
    let full = std::io::stdout().is_terminal() && !args.once && !args.json;
    let ended = if full {
        screen::run(args, &mut client)
    } else {
        print(args, &mut client)
    };
    match ended {
        Ok(()) => exit::OK,
        Err(error) => remote::failed(&error),
    }
}

/// Prints samples until nobody reads them, or the app has gone.
fn print(args: &TopArgs, client: &mut Client) -> Result<(), ClientError> {
    let mut model = Model::new(args.sort);
    model.see(remote::view(client)?);
    loop {
        pause(args.interval);
        match remote::view(client) {
            Ok(view) => model.see(view),
            // An app that has ended is not an error to one who watches it.
            Err(ClientError::Unreachable { .. }) => {
                show::say("the app has ended");
                return Ok(());
            }
            Err(error) => return Err(error),
        }
        let Some(sample) = model.sample() else {
            continue;
        };
        if show::data(&printed(&sample, args.json)).is_err() || args.once {
            return Ok(());
        }
    }
}

fn printed(sample: &Sample, json: bool) -> String {
    if json {
        return serde_json::to_string(sample).unwrap_or_default();
    }
    let mut lines = vec![sample.title.clone(), String::new()];
    lines.extend(table::lines(
        &model::COLUMNS,
        &sample.rows(),
        table::width(),
    ));
    lines.push(String::new());
    lines.join("\n")
}

/// Waits, for as long as a person would: this is not a part of an app, and has no clock of one.
fn pause(duration: Duration) {
    std::thread::park_timeout(duration);
}
