//! `ctos log`: what is in records.

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use clap::{Args, Subcommand};
use ctos::{
    record::{Entry, Filter, ReadError, Record, Run, scan_only},
    time::Instant,
};

use cli_common::{exit, records, show};

/// Look into records (MCAP) of apps
///
/// An app is recorded with `ctos boot APP --record FILE` or `[record] file` in its configuration; each of its processes
/// writes a file of its own. Several files are read as one, in the order of their moments. Every MCAP viewer opens them.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos log info run.mcap
  ctos log cat run.mcap --topic '/message/*' --from 1.5 --to 2
  ctos log filter run.mcap arm.mcap --topic '*/arm'
  ctos log merge run.mcap all.mcap
  ctos log recover torn.mcap whole.mcap")]
pub struct LogCommandArgs {
    /// What to do
    #[command(subcommand)]
    pub action: Action,
}

/// What can be done with records.
#[derive(Debug, Subcommand)]
pub enum Action {
    /// Show what each file is the record of, how it ends, and its channels
    Info {
        /// The records
        #[arg(required = true, value_name = "RECORD")]
        files: Vec<PathBuf>,
        /// Print one JSON object per file
        #[arg(long)]
        json: bool,
    },
    /// Print the lines of records, one per line, in the order of their moments
    Cat {
        /// The records
        #[arg(required = true, value_name = "RECORD")]
        files: Vec<PathBuf>,
        /// Which lines
        #[command(flatten)]
        wanted: WantedArgs,
        /// Print one JSON object per line: `at_s`, `topic`, `schema` and the line itself
        #[arg(long)]
        json: bool,
    },
    /// Write the wanted lines of a record to a new one
    Filter {
        /// The record
        #[arg(value_name = "RECORD")]
        file: PathBuf,
        /// The new file
        #[arg(value_name = "OUT")]
        out: PathBuf,
        /// Which lines
        #[command(flatten)]
        wanted: WantedArgs,
    },
    /// Write several records as one, in the order of their moments
    Merge {
        /// The records, and last the new file
        #[arg(required = true, num_args = 2.., value_name = "RECORD")]
        files: Vec<PathBuf>,
    },
    /// Write what can be read of a record that breaks off as a new one that is whole
    Recover {
        /// The record
        #[arg(value_name = "RECORD")]
        file: PathBuf,
        /// The new file
        #[arg(value_name = "OUT")]
        out: PathBuf,
    },
}

/// Which lines are wanted.
#[derive(Debug, Args)]
pub struct WantedArgs {
    /// Channels, in which `*` stands for any letters, for example `/log/*` (can be repeated)
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Nothing before this moment, s since the start of the app
    #[arg(long, value_name = "SECONDS", value_parser = moment)]
    pub from: Option<Instant>,
    /// Nothing after this moment, s since the start of the app
    #[arg(long, value_name = "SECONDS", value_parser = moment)]
    pub to: Option<Instant>,
}

impl WantedArgs {
    fn filter(&self) -> Filter {
        Filter {
            topics: self.topics.clone(),
            from: self.from,
            to: self.to,
        }
    }
}

/// A moment written as seconds.
fn moment(text: &str) -> Result<Instant, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| "expected a number of seconds, for example 1.5".to_owned())?;
    std::time::Duration::try_from_secs_f64(seconds)
        .map(|since| Instant::START + since)
        .map_err(|error| error.to_string())
}

/// Runs the command.
#[must_use]
pub fn run(args: &LogCommandArgs) -> u8 {
    let done = match &args.action {
        Action::Info { files, json } => info(files, *json),
        Action::Cat {
            files,
            wanted,
            json,
        } => cat(files, &wanted.filter(), *json),
        Action::Filter { file, out, wanted } => {
            rewrite(std::slice::from_ref(file), &wanted.filter(), out)
        }
        Action::Merge { files } => match files.split_last() {
            Some((out, files)) => rewrite(files, &Filter::default(), out),
            None => Ok(()),
        },
        Action::Recover { file, out } => write(std::slice::from_ref(file), &Filter::default(), out),
    };
    match done {
        Ok(()) => exit::OK,
        Err(error) => {
            show::say(&format!("error: {error}"));
            exit::FAILED
        }
    }
}

fn said(error: ReadError) -> String {
    error.to_string()
}

fn info(files: &[PathBuf], json: bool) -> Result<(), String> {
    for (index, file) in records::files(files).iter().enumerate() {
        // Counted, not shown.
        let nothing = Filter {
            topics: vec![String::new()],
            ..Filter::default()
        };
        let run = scan_only(file, &nothing, |_| ()).map_err(said)?;
        let text = if json {
            info_json(&run).to_string()
        } else {
            let gap = if index == 0 { "" } else { "\n" };
            format!("{gap}{}", info_text(&run))
        };
        if show::data(&text).is_err() {
            break;
        }
    }
    Ok(())
}

fn seconds(moment: Instant) -> f64 {
    moment.since_start().as_secs_f64()
}

fn info_json(run: &Run) -> serde_json::Value {
    let channels = run.channels.iter();
    let channels: serde_json::Map<_, _> = channels
        .map(|(topic, (lines, bytes))| {
            let counted = serde_json::json!({ "lines": lines, "bytes": bytes });
            (topic.clone(), counted)
        })
        .collect();
    serde_json::json!({
        "file": run.path.display().to_string(),
        "run": run.noted,
        "lines": run.lines(),
        "from_s": run.span.map(|span| seconds(span.0)),
        "to_s": run.span.map(|span| seconds(span.1)),
        "torn": run.torn,
        "lost": run.lost,
        "channels": channels,
    })
}

fn info_text(run: &Run) -> String {
    let noted = |key: &str| run.noted.get(key).map_or("unknown", String::as_str);
    let mut text = vec![
        run.path.display().to_string(),
        format!(
            "  app      {} · chassis {} · seed {} · {} time",
            noted("app"),
            run.noted.get("chassis").map_or("all", String::as_str),
            noted("seed"),
            noted("time")
        ),
    ];
    if let Some((from, to)) = run.span {
        text.push(format!(
            "  time     {:.3} s to {:.3} s · {} lines",
            seconds(from),
            seconds(to),
            run.lines()
        ));
    }
    text.push(match &run.torn {
        None => "  end      closed in order".to_owned(),
        Some(why) => format!("  end      breaks off ({why}); `ctos log recover` makes it whole"),
    });
    if run.lost > 0 {
        text.push(format!("  lost     {} events, see /recorder", run.lost));
    }
    let width = run.channels.keys().map(String::len).max().unwrap_or(0);
    for (topic, (lines, bytes)) in &run.channels {
        text.push(format!(
            "  {topic:<width$}  {lines:>9} lines  {bytes:>11} bytes"
        ));
    }
    text.join("\n")
}

fn cat(files: &[PathBuf], filter: &Filter, json: bool) -> Result<(), String> {
    let record = Record::read(&records::of_a_run(files)?, filter).map_err(said)?;
    warn_torn(&record);
    if record.entries.is_empty() {
        show::say("no line fits; `ctos log info` lists the topics");
    }
    for entry in &record.entries {
        let text = if json {
            line_json(entry)
        } else {
            let (line, at) = (line_text(entry), seconds(entry.at));
            format!("{at:12.6} {} {line}", entry.channel.topic)
        };
        if show::data(&text).is_err() {
            break;
        }
    }
    Ok(())
}

/// A line as JSON: of one that is written otherwise, how and how long it is.
fn line_text(entry: &Entry) -> Cow<'_, str> {
    match entry.channel.encoding() {
        "json" => String::from_utf8_lossy(&entry.json),
        other => {
            let bytes = entry.json.len();
            serde_json::json!({ "encoding": other, "bytes": bytes })
                .to_string()
                .into()
        }
    }
}

/// A line within one more object, as it is: what a program reads is not parsed twice.
fn line_json(entry: &Entry) -> String {
    let topic = serde_json::Value::from(entry.channel.topic.as_str());
    let schema = serde_json::Value::from(entry.channel.schema());
    let (line, at) = (line_text(entry), seconds(entry.at));
    format!("{{\"at_s\":{at:.9},\"topic\":{topic},\"schema\":{schema},\"line\":{line}}}")
}

fn rewrite(files: &[PathBuf], filter: &Filter, out: &Path) -> Result<(), String> {
    write(&records::of_a_run(files)?, filter, out)
}

fn write(files: &[PathBuf], filter: &Filter, out: &Path) -> Result<(), String> {
    let record = Record::read(files, filter).map_err(said)?;
    warn_torn(&record);
    record.write(out).map_err(said)?;
    let lines = record.entries.len();
    show::say(&format!("{}: {lines} lines", out.display()));
    Ok(())
}

fn warn_torn(record: &Record) {
    for run in &record.runs {
        if let Some(why) = &run.torn {
            show::say(&format!(
                "warning: {} breaks off ({why}); read up to its last whole chunk",
                run.path.display()
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_a_number_of_seconds_that_is_not_negative() {
        assert_eq!(moment("1.5"), Ok(Instant::from_nanos(1_500_000_000)));
        for wrong in ["soon", "-1", "inf", "NaN", "1e300"] {
            assert!(moment(wrong).is_err(), "{wrong}");
        }
    }
}
