//! `ctos logs`.

use clap::{Args, ValueEnum};
use ctos::control::{
    Level, LogLine,
    protocol::{Answer, LogRequest, Request},
};

use cli_common::{
    exit,
    remote::{self, RemoteArgs, log_text},
    show,
};

/// Show the log of an app, a chassis or a task
///
/// The app keeps the last 1000 lines of each chassis, and of the three processes before it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos logs
  ctos logs cage_motion -f
  ctos logs motion --level warn --last 20")]
pub struct LogsArgs {
    /// Name of the chassis, or of the task that lines must be about
    pub name: Option<String>,
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Show what follows too, until the app ends
    #[arg(short, long)]
    pub follow: bool,
    /// Show lines that matter at least so much
    #[arg(long, value_enum)]
    pub level: Option<LevelName>,
    /// Show the last so many lines of those that there are
    #[arg(long, value_name = "LINES")]
    pub last: Option<usize>,
    /// Show lines from so many seconds after the start of the app on
    #[arg(long, value_name = "SECONDS")]
    pub since: Option<f64>,
    /// Print one JSON object per line
    #[arg(long)]
    pub json: bool,
}

/// How much a line matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LevelName {
    /// Everything
    Trace,
    /// What the runtime does
    Debug,
    /// Events of the app
    Info,
    /// What somebody should know
    Warn,
    /// What went wrong
    Error,
}

impl From<LevelName> for Level {
    fn from(name: LevelName) -> Self {
        match name {
            LevelName::Trace => Self::Trace,
            LevelName::Debug => Self::Debug,
            LevelName::Info => Self::Info,
            LevelName::Warn => Self::Warn,
            LevelName::Error => Self::Error,
        }
    }
}

/// Runs the command.
#[must_use]
pub fn run(args: &LogsArgs) -> u8 {
    let mut client = match args.remote.connect() {
        Ok(client) => client,
        Err(error) => return remote::failed(&error),
    };
    let request = Request::Logs(LogRequest {
        name: args.name.clone(),
        level: args.level.map(Level::from),
        since_s: args.since,
        last: args.last,
        follow: args.follow,
    });
    let asked = client.ask(request).and_then(|()| {
        if args.follow {
            client.wait_for_ever()
        } else {
            Ok(())
        }
    });
    if let Err(error) = asked {
        return remote::failed(&error);
    }
    let mut any = false;
    loop {
        match client.read() {
            Ok(Some(Answer::Log(line))) => {
                any = true;
                if show::data(&shown(&line, args.json)).is_err() {
                    return exit::OK;
                }
            }
            Ok(Some(Answer::Lost { lines })) => {
                show::say(&format!(
                    "… {lines} lines were lost: they were not read in time"
                ));
            }
            // The app was killed: what it said has been shown.
            Ok(Some(_)) | Ok(None) => {
                if !any {
                    show::say("no line of the log is about that");
                }
                return exit::OK;
            }
            Err(error) => {
                let name = args.name.as_deref().unwrap_or_default();
                return remote::failed_for(&[name], &error);
            }
        }
    }
}

fn shown(line: &LogLine, json: bool) -> String {
    if json {
        return serde_json::to_string(line).unwrap_or_default();
    }
    let process = match line.incarnation {
        1 => String::new(),
        number => format!("#{number}"),
    };
    format!("{}{process} │ {}", line.chassis, log_text(line))
}
