//! `ctos stop`.

use std::time::Duration;

use clap::Args;
use ctos::control::protocol::{Answer, Request};

use cli_common::{
    client::Within,
    exit,
    remote::{self, AtArgs},
    show,
};

use crate::progress;

/// After how long without a word the command looks whether the app answers at all.
const LOOK: Duration = Duration::from_secs(5);

/// Stop an app in order
///
/// Every task is asked to stop; a process that does not end is sent SIGTERM, then SIGKILL. Each rung is shown as it
/// is taken.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos stop
  ctos stop calibrate --now")]
pub struct StopArgs {
    /// Name of the running app, its process id, or NAME-PID; needed only when several are running
    #[arg(conflicts_with = "at")]
    pub app: Option<String>,
    /// An app on another host
    #[command(flatten)]
    pub at: AtArgs,
    /// Do not wait for tasks that do not stop at once
    #[arg(long)]
    pub now: bool,
    /// Print one JSON object per event
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &StopArgs) -> u8 {
    let mut client = match remote::connect_to(args.app.as_deref(), &args.at) {
        Ok(client) => client,
        Err(error) => return remote::failed(&error),
    };
    if let Err(error) = client.ask(Request::Stop { now: args.now }) {
        return remote::failed(&error);
    }
    loop {
        // Every rung has a limit of its own, which the app keeps while it answers at all.
        let answer = match client.read_within(LOOK) {
            Ok(Within::Answer(answer)) => *answer,
            Ok(Within::NotYet) => match remote::answers(args.app.as_deref(), &args.at) {
                Ok(()) => continue,
                Err(error) => return remote::failed(&error),
            },
            Ok(Within::Closed) => {
                show::say("error: the app went away without saying how it ended");
                return exit::UNREACHABLE;
            }
            Err(error) => return remote::failed(&error),
        };
        if args.json {
            // A reader that went away does not keep the app from stopping.
            let _ = show::data(&serde_json::to_string(&answer).unwrap_or_default());
        }
        match answer {
            Answer::Event { what } if !args.json => {
                if let Some(words) = progress::words(&what, 0) {
                    show::say(&words);
                }
            }
            Answer::Ended(ended) => {
                for (chassis, how) in ended.casualties.iter().filter(|_| !args.json) {
                    show::say(&format!("chassis `{chassis}` {how}"));
                }
                let app = &client.app().app;
                if !args.json {
                    show::say(&format!("stopped  {app}: {}", ended.reason));
                }
                return exit::OK;
            }
            _ => {}
        }
    }
}
