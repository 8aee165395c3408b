//! `ctos move`.

use clap::Args;
use ctos::control::protocol::{Answer, MoveView, Request};

use cli_common::{
    client::ClientError,
    exit,
    remote::{self, RemoteArgs},
    show,
};

/// Move a running task to another processor or chassis
///
/// Its state goes along, and what is sent to it meanwhile is neither lost nor doubled nor reordered. Its handler must
/// pass its state on (`task::Handover`). A task moves between two messages; what keeps it is shown every second.
/// A move that cannot be made leaves the task where it is. A chassis without a processor means its first one.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos move sink cage
  ctos move sink cage:servo --json")]
pub struct MoveArgs {
    /// Name of the task
    pub task: String,
    /// Where it is to go
    #[arg(value_name = "CHASSIS[:PROCESSOR]")]
    pub to: String,
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print one JSON object: task, from, to, took_s
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &MoveArgs) -> u8 {
    match moved(args) {
        Ok(Some(view)) => {
            if args.json {
                let object = serde_json::json!({
                    "task": view.task,
                    "from": view.from,
                    "to": view.to,
                    "took_s": view.took_s,
                });
                // A reader that went away has what it wanted.
                let _ = show::data(&object.to_string());
            } else if view.from == view.to {
                show::say(&format!("{} is on {} already", view.task, view.to));
            } else {
                let MoveView { task, from, to, .. } = &view;
                let time = remote::span(view.took_s);
                show::say(&format!("moved    {task} from {from} to {to} in {time}"));
            }
            exit::OK
        }
        Ok(None) => {
            show::say("error: the app went away, or is of another version");
            exit::UNREACHABLE
        }
        Err(error) => remote::failed_for(&[&args.task, &args.to], &error),
    }
}

/// Waits until the task is there, and tells what keeps it.
fn moved(args: &MoveArgs) -> Result<Option<MoveView>, ClientError> {
    let mut client = args.remote.connect()?;
    client.ask(Request::Move {
        task: args.task.clone(),
        to: args.to.clone(),
    })?;
    // The app keeps the limits, and says every second what it waits for.
    loop {
        match client.read()? {
            Some(Answer::Moved(view)) => return Ok(Some(view)),
            Some(Answer::Moving(view)) if view.at.is_some() && !args.json => {
                let time = remote::span(view.took_s);
                let at = view.at.unwrap_or_default();
                show::say(&format!("move     waits {time} for {}: {at}", view.task));
            }
            Some(Answer::Moving(_)) => {}
            _ => return Ok(None),
        }
    }
}
