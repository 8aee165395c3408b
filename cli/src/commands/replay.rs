//! `ctos replay`.

use std::path::PathBuf;

use clap::Args;
use ctos::{
    config::App,
    record::{Filter, Record, ReplayError, replay, replayable},
    registry::Registry,
};

use cli_common::{exit, records, remote, show, table};

use crate::{commands::args::AppArgs, program};

/// Let one task do again what it did in a record, and compare
///
/// Without --task it says which tasks of the app the record can do that with, and why not with the others.
///
/// The task runs alone on a virtual clock. It is given its messages at the recorded moments and the recorded answers to
/// what it asks; what it sends, answers and returns is compared with the record. Exit code 0 when it did the same, 1 when
/// it did not.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos boot configs/calibrate.toml --set time.mode=\"virtual\" --record run.mcap
  ctos replay configs/calibrate.toml run.mcap
  ctos replay configs/calibrate.toml run.mcap --task dispatcher
  ctos replay configs/calibrate.toml run.mcap --task dispatcher --json")]
pub struct ReplayArgs {
    /// Which app
    #[command(flatten)]
    pub app: AppArgs,
    /// Records of one run: the file of the task's process, or several
    #[arg(required = true, value_name = "RECORD")]
    pub files: Vec<PathBuf>,
    /// Name of the task; without it all are listed
    #[arg(long, value_name = "NAME")]
    pub task: Option<String>,
    /// Print the result as one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &ReplayArgs, registry: Registry) -> u8 {
    let app = match program::checked(&args.app.selection(), &registry) {
        Ok((app, _)) => app,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    let files = match records::of_a_run(&args.files) {
        Ok(files) => files,
        Err(why) => {
            show::say(&format!("error: {why}"));
            return exit::FAILED;
        }
    };
    if !args.json {
        let sizes = files.iter().filter_map(|file| file.metadata().ok());
        let bytes = sizes.map(|found| found.len()).sum();
        show::say(&format!("reads {}", remote::size(bytes)));
    }
    let record = match Record::read(&files, &Filter::default()) {
        Ok(record) => record,
        Err(error) => {
            show::say(&format!("error: {error}"));
            return exit::FAILED;
        }
    };
    let Some(task) = &args.task else {
        return list(&app, &record, args.json);
    };
    match replay(app, registry, task, &record) {
        Ok(report) => {
            let text = if args.json {
                serde_json::json!({
                    "task": report.task,
                    "same": report.is_same(),
                    "report": report,
                })
                .to_string()
            } else {
                report.to_string()
            };
            // A reader that went away has what it wanted.
            let _ = show::data(&text);
            if report.is_same() {
                exit::OK
            } else {
                exit::FAILED
            }
        }
        Err(error) => {
            show::say(&format!("error: {error}"));
            match error {
                ReplayError::NoTask { .. } | ReplayError::NotRecorded { .. } => exit::NO_SUCH_NAME,
                _ => exit::FAILED,
            }
        }
    }
}

/// Which tasks can be replayed.
fn list(app: &App, record: &Record, json: bool) -> u8 {
    let tasks = replayable(app, record);
    let text = if json {
        let tasks = tasks.iter().map(|(task, can)| {
            let why = can.as_ref().err().map(ToString::to_string);
            serde_json::json!({ "task": task, "replays": can.is_ok(), "why": why })
        });
        serde_json::json!({ "tasks": tasks.collect::<Vec<_>>() }).to_string()
    } else {
        let width = tasks.iter().map(|(task, _)| task.len()).max().unwrap_or(0);
        let line = |(task, can): &(String, Result<(), ReplayError>)| match can {
            Ok(()) => format!("{task:<width$}  replays"),
            // The task stands there already.
            Err(ReplayError::Outside { what, .. }) => {
                format!("{task:<width$}  does not: it uses {what}, which no record holds")
            }
            Err(why) => format!("{task:<width$}  does not: {why}"),
        };
        table::for_terminal(&tasks.iter().map(line).collect::<Vec<_>>().join("\n"))
    };
    // A reader that went away has what it wanted.
    let _ = show::data(&text);
    exit::OK
}
