//! `ctos ps`.

use clap::Args;
use ctos::control::protocol::AppView;

use cli_common::{
    client::{self, ClientError},
    exit,
    remote::{self, RemoteArgs, view},
    show,
    table::{self, left, rare, right},
};

/// Show the running apps, their chassis and their tasks
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos ps
  ctos ps --json | jq '.tasks[] | select(.activity == \"waits\")'")]
pub struct PsArgs {
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print one JSON object per app
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &PsArgs) -> u8 {
    if args.remote.at.at.is_some() {
        let view = args
            .remote
            .connect()
            .and_then(|mut client| view(&mut client));
        return match view {
            Ok(view) => {
                // A reader that went away has what it wanted.
                let _ = show::data(&shown(&view, args.json));
                exit::OK
            }
            Err(error) => remote::failed(&error),
        };
    }
    let apps = match &args.remote.app {
        Some(name) => client::find(Some(name)).map(|app| vec![app]),
        None => Ok(client::apps()),
    };
    let apps = match apps {
        Ok(apps) if apps.is_empty() => return remote::failed(&ClientError::NoApp),
        Ok(apps) => apps,
        Err(error) => return remote::failed(&error),
    };
    let mut code = exit::OK;
    for (index, app) in apps.into_iter().enumerate() {
        let view = remote::connect_here(Some(&format!("{}-{}", app.app, app.pid)))
            .and_then(|mut client| view(&mut client));
        let text = match view {
            Ok(view) => {
                let gap = if index > 0 && !args.json { "\n" } else { "" };
                format!("{gap}{}", shown(&view, args.json))
            }
            Err(error) => {
                code = remote::failed(&error);
                continue;
            }
        };
        if show::data(&text).is_err() {
            break;
        }
    }
    code
}

fn shown(view: &AppView, json: bool) -> String {
    if json {
        serde_json::to_string(view).unwrap_or_default()
    } else {
        lines(view, table::width()).join("\n")
    }
}

/// The line that says which app it is and how it is.
pub(crate) fn title(app: &AppView) -> String {
    format!(
        "{} · {} · {} since the start · pid {} · {}",
        app.app,
        app.state,
        remote::span(app.up_s),
        app.pid,
        app.file
    )
}

fn lines(app: &AppView, width: usize) -> Vec<String> {
    let mut lines = vec![table::fitted(&title(app), width)];
    if app.refused > 0 {
        let callers = if app.refused == 1 {
            "caller was"
        } else {
            "callers were"
        };
        lines.push(format!(
            "{} {callers} refused; the log of the boot says why",
            app.refused
        ));
    }
    lines.push(String::new());
    let is_spread = app.chassis.iter().any(|chassis| chassis.host.is_some());
    let chassis: Vec<Vec<String>> = app
        .chassis
        .iter()
        .map(|chassis| {
            let state = if chassis.answers {
                chassis.state.to_string()
            } else {
                format!("{}, no answer", chassis.state)
            };
            let host = chassis.host.as_deref().unwrap_or("here");
            let name = match is_spread {
                true => format!("{} on {host}", chassis.name),
                false => chassis.name.clone(),
            };
            vec![
                name,
                chassis
                    .pid
                    .map_or_else(|| "-".to_owned(), |pid| pid.to_string()),
                state,
                remote::span(chassis.since_s),
                chassis.restarts.to_string(),
                chassis.tasks.to_string(),
            ]
        })
        .collect();
    let columns = [
        left("CHASSIS"),
        right("PID"),
        left("STATE"),
        right("FOR"),
        rare("RESTARTS"),
        right("TASKS"),
    ];
    lines.extend(table::lines(&columns, &chassis, width));
    lines.push(String::new());
    let tasks: Vec<Vec<String>> = app
        .tasks
        .iter()
        .map(|task| {
            vec![
                task.name.clone(),
                format!("{}/{}", task.chassis, task.processor),
                task.phase
                    .map_or_else(|| "-".to_owned(), |phase| phase.to_string()),
                task.handled.to_string(),
                (task.urgent + task.queued + task.senders_waiting).to_string(),
                task.restarts.to_string(),
                remote::does(task),
            ]
        })
        .collect();
    let columns = [
        left("TASK"),
        left("ON"),
        left("PHASE").unless("run"),
        right("HANDLED"),
        rare("QUEUE"),
        rare("RESTARTS"),
        left("DOES"),
    ];
    lines.extend(table::lines(&columns, &tasks, width));
    lines
}
