//! `ctos restart`.

use clap::Args;
use ctos::control::protocol::{Answer, Request};

use cli_common::{
    client::ClientError,
    exit,
    remote::{self, RemoteArgs},
    show,
};

/// Restart a task, or a chassis with all its tasks
///
/// A task's handler is built anew and brought to the phase it had reached; messages in its queue stay. The tasks of a
/// chassis are stopped in order, its process ends and the next one passes the startup phases alone. Both whatever
/// their restart policy says. Returns when it runs again; what keeps it is shown every second. A handler that does not
/// come to an end within the app's `stop_timeout_s` cannot be built anew: that ends with exit code 6, and restarting
/// its chassis helps.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos restart motion
  ctos restart cage_motion")]
pub struct RestartArgs {
    /// Name of the task or chassis
    pub name: String,
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &RestartArgs) -> u8 {
    let name = &args.name;
    match restarted(args) {
        Ok(Some(Answer::Done {})) => {
            if args.json {
                // A reader that went away has what it wanted.
                let _ = show::data(&serde_json::json!({ "restarted": name }).to_string());
            } else {
                show::say(&format!("restarted {name}"));
            }
            exit::OK
        }
        Ok(_) => {
            show::say("error: the app went away, or is of another version");
            exit::UNREACHABLE
        }
        Err(error) => remote::failed_for(&[name], &error),
    }
}

/// Waits until it runs again, and tells what keeps it.
fn restarted(args: &RestartArgs) -> Result<Option<Answer>, ClientError> {
    let mut client = args.remote.connect()?;
    let name = args.name.clone();
    client.ask(Request::Restart { name })?;
    // The app keeps the limits, and says every second what it waits for.
    loop {
        match client.read()? {
            Some(Answer::Waiting { took_s, at }) => {
                let time = remote::span(took_s);
                if !args.json {
                    show::say(&format!("restart  waits {time} for {}: {at}", args.name));
                }
            }
            answer => return Ok(answer),
        }
    }
}
