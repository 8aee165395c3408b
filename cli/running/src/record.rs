//! `ctos record`, and what `--record` of other commands means for the configuration.

use std::{
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use ctos::{
    config::{App, RecordConfig},
    control::{
        Socket,
        protocol::{Answer, RecordRequest, RecordView, Request},
    },
};
use tokio::{
    runtime::Runtime,
    signal::unix::{Signal, SignalKind, signal},
};

use cli_common::{
    client::{Client, ClientError},
    exit,
    remote::{self, AtArgs},
    show,
};

/// Record a running app, until Ctrl-C
///
/// What `ctos boot --record` writes, from now on: a file for each process, `APP.CHASSIS.mcap`. The app goes on
/// undisturbed, also when this command is killed; several may record at a time. Each process writes its file on the
/// host where it runs.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos record
  ctos record calibrate --to records --for 10s
  ctos record --channels '/message/*' --channels '/firing/*'
  ctos record --at cell.example:7400 --key keys/me --to /var/tmp/records")]
pub struct RecordArgs {
    /// Name of the running app, its process id, or NAME-PID; needed only when several are running
    #[arg(conflicts_with = "at")]
    pub app: Option<String>,
    /// An app on another host
    #[command(flatten)]
    pub at: AtArgs,
    /// Folder of the files, which is made if it is missing; with `--at` a whole path there
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub to: PathBuf,
    /// For how long, for example `10s`, `500ms` or `2min`
    #[arg(long = "for", value_name = "TIME", value_parser = span)]
    pub limit: Option<Duration>,
    /// Only channels of this name, in which `*` stands for any letters (can be repeated)
    #[arg(long, value_name = "NAME")]
    pub channels: Vec<String>,
    /// Print one JSON object at the end: the files with their lines and bytes, and what they lack
    #[arg(long)]
    pub json: bool,
}

fn span(text: &str) -> Result<Duration, String> {
    let wrong = || "write a time above 0, for example 10s, 500ms or 2min".to_owned();
    let digits = text
        .find(|letter: char| letter.is_ascii_alphabetic())
        .unwrap_or(text.len());
    let (number, unit) = text.split_at_checked(digits).ok_or_else(wrong)?;
    let scale = match unit.trim() {
        "" | "s" => 1.0,
        "ms" => 1e-3,
        "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(wrong()),
    };
    let seconds = number.trim().parse::<f64>().map_err(|_| wrong())? * scale;
    let limit = (seconds > 0.0 && seconds <= 1e9).then_some(seconds);
    limit.map(Duration::from_secs_f64).ok_or_else(wrong)
}

/// Runs the command.
#[must_use]
pub fn run(args: &RecordArgs) -> u8 {
    let folder = match prepared(args) {
        Ok(folder) => folder,
        Err(error) => {
            show::say(&format!(
                "error: cannot record to {}: {error}",
                args.to.display()
            ));
            return exit::FAILED;
        }
    };
    match recorded(args, &folder) {
        Ok(Some(view)) => report(args, &view),
        Ok(None) => {
            show::say("error: the app went away, or is of another version");
            exit::UNREACHABLE
        }
        Err(error) => remote::failed(&error),
    }
}

/// The folder by its whole path, which the app's processes need. On another host it is theirs to have.
fn prepared(args: &RecordArgs) -> io::Result<String> {
    let folder = if args.at.at.is_none() {
        std::fs::create_dir_all(&args.to)?;
        std::path::absolute(&args.to)?
    } else if args.to.is_absolute() {
        args.to.clone()
    } else {
        let why = "with --at the folder is one of the other host: name its whole path with --to";
        return Err(io::Error::other(why));
    };
    let text = folder.to_str().map(str::to_owned);
    text.ok_or_else(|| io::Error::other("its name is no Unicode text"))
}

/// Waits for the end of the record.
fn recorded(args: &RecordArgs, folder: &str) -> Result<Option<RecordView>, ClientError> {
    let mut client = remote::connect_to(args.app.as_deref(), &args.at)?;
    client.ask(Request::Record(RecordRequest {
        folder: folder.to_owned(),
        channels: args.channels.clone(),
        for_s: args.limit.map(|limit| limit.as_secs_f64()),
    }))?;
    let mut told = false;
    loop {
        match client.read()? {
            Some(Answer::Recorded(view)) => return Ok(Some(view)),
            Some(Answer::Recording(view)) => {
                if !told {
                    told = true;
                    client.wait_for_ever()?;
                    stop_by_signal(client.app(), &args.at, view.key);
                    begun(args, client.app(), &view);
                }
            }
            _ => return Ok(None),
        }
    }
}

fn begun(args: &RecordArgs, app: &Socket, view: &RecordView) {
    let until = match args.limit {
        Some(limit) => format!("for {}", remote::span(limit.as_secs_f64())),
        None => "until Ctrl-C".to_owned(),
    };
    show::say(&format!("record   {} {until}", app.app));
    for file in &view.files {
        if let Some(trouble) = &file.record.trouble {
            show::say(&format!(
                "warning: {} is not recorded: {trouble}",
                file.chassis
            ));
        }
    }
}

/// Lets Ctrl-C and SIGTERM end the record, not this command before it. From the return on, no signal is
/// missed.
fn stop_by_signal(app: &Socket, at: &AtArgs, key: u64) {
    let (app, at) = (app.clone(), at.clone());
    let started = Signals::heard().and_then(|signals| {
        let waiting = std::thread::Builder::new().name("signals".to_owned());
        waiting.spawn(move || {
            signals.wait();
            let client = match &at.at {
                Some(_) => remote::connect_to(None, &at),
                None => Client::connect(app, Duration::from_secs(5)),
            };
            // An app that is not there any more has closed the record.
            if let Ok(mut client) = client {
                let _ = client.get(Request::RecordStop { key });
            }
        })
    });
    if let Err(error) = started {
        show::say(&format!(
            "warning: Ctrl-C ends this command at once: {error}"
        ));
    }
}

/// The signals that ask this process to end.
struct Signals {
    runtime: Runtime,
    interrupt: Signal,
    terminate: Signal,
}

impl Signals {
    /// From here on they do nothing but end [`Self::wait`].
    fn heard() -> io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let inside = runtime.enter();
        let interrupt = signal(SignalKind::interrupt())?;
        let terminate = signal(SignalKind::terminate())?;
        drop(inside);
        Ok(Self {
            runtime,
            interrupt,
            terminate,
        })
    }

    /// Ends with the first one.
    fn wait(mut self) {
        self.runtime.block_on(async {
            tokio::select! {
                _ = self.interrupt.recv() => {}
                _ = self.terminate.recv() => {}
            }
        });
    }
}

fn report(args: &RecordArgs, view: &RecordView) -> u8 {
    if args.json {
        // A reader that went away has what it wanted.
        let _ = show::data(&serde_json::to_string(view).unwrap_or_default());
    } else {
        for file in &view.files {
            let record = &file.record;
            let lost = match record.lost {
                0 => String::new(),
                lost => format!(", lacks {lost} events"),
            };
            let trouble = record.trouble.as_ref();
            let trouble = trouble.map_or_else(String::new, |why| format!(": {why}"));
            show::say(&format!(
                "recorded {} · {} lines, {}{lost}{trouble}",
                record.file,
                record.lines,
                remote::size(record.bytes)
            ));
        }
        show::say(&format!("look     ctos log info {}", files(view)));
    }
    let complete = view.files.iter().all(|file| file.record.trouble.is_none());
    if complete { exit::OK } else { exit::FAILED }
}

/// The files as a shell takes them.
fn files(view: &RecordView) -> String {
    let files = view.files.iter().map(|file| file.record.file.as_str());
    let files: Vec<&str> = files.filter(|file| !file.is_empty()).collect();
    files.join(" ")
}

/// How the simulated run of `app` is recorded to a folder, which is made if it is missing.
///
/// # Errors
/// When it cannot be made.
pub fn to_folder(app: &App, folder: &Path) -> io::Result<RecordConfig> {
    std::fs::create_dir_all(folder)?;
    let file = std::path::absolute(folder)?.join(ctos::record::file_name(&app.name));
    Ok(match &app.record {
        Some(config) => RecordConfig {
            file,
            ..config.clone()
        },
        None => RecordConfig::new(file),
    })
}

/// The `--set` text that records to `file`, which is relative to where the command was given.
///
/// # Errors
/// When the present folder is gone.
pub fn setting(file: &Path) -> std::io::Result<String> {
    let file = std::path::absolute(file)?;
    let text = serde_json::Value::from(file.to_string_lossy());
    // A JSON string is a TOML string.
    Ok(format!("record.file={text}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_has_a_unit_or_is_in_seconds() {
        for (text, seconds) in [
            ("10s", 10.0),
            ("500ms", 0.5),
            ("2 min", 120.0),
            ("1.5", 1.5),
        ] {
            assert_eq!(span(text), Ok(Duration::from_secs_f64(seconds)), "{text}");
        }
        for text in ["", "s", "-1s", "0", "10 parsecs", "1e400", "NaN"] {
            assert!(span(text).is_err(), "{text}");
        }
    }
}
