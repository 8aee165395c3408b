//! `ctos restart`.

use clap::Args;
use ctos::control::protocol::{Answer, Request};

use cli_common::{
    exit,
    remote::{self, RemoteArgs},
    show,
};

/// Restart a task, or a chassis with all its tasks
///
/// A task's handler is built anew and brought to the phase it had reached; messages in its queue stay. The tasks of a
/// chassis are stopped in order, its process ends and the next one passes the startup phases alone. Both whatever
/// their restart policy says. Returns when it runs again.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos restart arm
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
    let restarted = args.remote.connect().and_then(|mut client| {
        client.ask(Request::Restart { name: name.clone() })?;
        // The phases have limits of their own, which the app keeps.
        client.wait_for_ever()?;
        client.read()
    });
    match restarted {
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
