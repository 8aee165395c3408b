//! `ctos sim`.

use std::{
    fs::File,
    io::{BufWriter, Write},
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use clap::Args;
use ctos::{
    boot::{BootEvent, End, Observer, Outcome},
    config::{App, RecordConfig, Selection},
    diagnostic::{Finding, Findings},
    registry::Registry,
    simulation::{self, EventSink, Fault, Faults, Run, Setup},
    time::Clock,
};

use cli_common::{exit, show};
use cli_running::{progress::Display, record};

use crate::{
    commands::{
        args::{LogArgs, start_log},
        breakpoints::{Breakpoints, Released},
    },
    program,
};

/// How often a shorter list of faults is tried at most.
const SHRINK_TRIALS: usize = 500;

/// Run a whole app on one thread in virtual time, with faults
///
/// The order in which tasks run, how long messages take and what goes wrong are drawn from the seed: the same seed
/// is the same run, byte for byte. A run that fails is shown as the command that repeats it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos sim configs/hello.toml --seed 7
  ctos sim configs/hello.toml --seeds 0..100 --faults rough
  ctos sim configs/hello.toml --seed 7 --faults hostile --shrink fewer.toml
  ctos sim configs/hello.toml --seed 7 --record records
  ctos sim configs/hello.toml --break hello.count
  ctos sim --profiles")]
pub struct SimArgs {
    /// Configuration of the app
    #[arg(required_unless_present = "profiles")]
    pub file: Option<PathBuf>,
    /// Override a value of the configuration (can be repeated)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Lay `[profile.NAME]` of the configuration over it (can be repeated)
    #[arg(long = "profile", value_name = "NAME")]
    pub overlays: Vec<String>,
    /// Where nets shall stop
    #[command(flatten)]
    pub breakpoints: Breakpoints,
    /// Seed of the run [default: that of the configuration]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Run every seed from A up to, but not including, B
    #[arg(long, value_name = "A..B", conflicts_with = "seed", value_parser = seeds)]
    pub seeds: Option<Range<u64>>,
    /// What goes wrong: none, light, rough, hostile, or a file
    #[arg(long, value_name = "PROFILE|FILE", default_value = "none")]
    pub faults: String,
    /// Stop the app after so many simulated seconds, as by Ctrl-C; that it ran so long is success then
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub limit: Option<Duration>,
    /// Write every delivery to a file, a line each
    #[arg(long, value_name = "FILE", conflicts_with = "seeds")]
    pub events: Option<PathBuf>,
    /// Record the run to `DIR/APP.mcap`; the same seed gives the same bytes
    #[arg(long, value_name = "DIR", conflicts_with = "seeds")]
    pub record: Option<PathBuf>,
    /// When the run fails, find fewer faults with which it still fails, and write them to a file
    #[arg(long, value_name = "FILE", conflicts_with = "seeds")]
    pub shrink: Option<PathBuf>,
    /// Print one JSON object per run
    #[arg(long)]
    pub json: bool,
    /// Tell how long each run has computed, which differs from run to run
    #[arg(long)]
    pub cpu: bool,
    /// Print the built-in fault profiles
    #[arg(long, exclusive = true)]
    pub profiles: bool,
    /// How much to say
    #[command(flatten)]
    pub log: LogArgs,
    /// The command that repeats the run, where that is not this one.
    #[arg(skip)]
    pub repeated_by: Option<String>,
}

fn seeds(text: &str) -> Result<Range<u64>, String> {
    let ends = text.split_once("..").and_then(|(first, end)| {
        Some(first.trim().parse::<u64>().ok()?..end.trim().parse::<u64>().ok()?)
    });
    match ends {
        Some(range) if !range.is_empty() => Ok(range),
        Some(_) => Err("the range is empty; write for example 0..100".to_owned()),
        None => Err("write a range of whole numbers, for example 0..100".to_owned()),
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse::<f64>().ok();
    seconds
        .filter(|seconds| *seconds > 0.0 && *seconds <= 1e9)
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "write a number of seconds above 0".to_owned())
}

/// Runs the command.
#[must_use]
pub fn run(args: &SimArgs, registry: Registry) -> u8 {
    if args.profiles {
        return profiles();
    }
    let Some(file) = &args.file else {
        return exit::USAGE;
    };
    let faults = match faults(&args.faults) {
        Ok(faults) => faults,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    let mut selection = Selection {
        file: file.clone(),
        profiles: args.overlays.clone(),
        sets: args.sets.clone(),
    };
    let sets = args
        .breakpoints
        .sets(&selection, &registry, Released::Never);
    let checked = sets.and_then(|sets| {
        selection.sets.extend(sets);
        program::checked(&selection, &registry)
    });
    let (app, warnings) = match checked {
        Ok(checked) => checked,
        Err(findings) => {
            let counted = show::counted(&findings);
            show::findings(findings);
            show::say(&format!("{}: {counted}; nothing was run", file.display()));
            return exit::CONFIG;
        }
    };
    if app.until.is_none() && args.limit.is_none() {
        show::say(&format!(
            "error: {} has no `until`, so it never ends by itself; add for example `--for 60`",
            file.display()
        ));
        return exit::USAGE;
    }
    if !args.log.quiet {
        show::findings(warnings);
    }
    let recorded = match args.record.as_deref() {
        None => app.record.clone(),
        Some(folder) => match record::to_folder(&app, folder) {
            Ok(config) => Some(config),
            Err(error) => return cannot_write(folder, &error),
        },
    };
    let lab = Lab {
        args,
        file,
        app,
        registry: Arc::new(registry),
        faults,
        recorded,
    };
    match args.seeds.clone() {
        Some(seeds) => lab.many(seeds),
        None => lab.one(args.seed.unwrap_or(lab.app.seed)),
    }
}

fn profiles() -> u8 {
    for (name, text) in Faults::BUILT_IN {
        if show::data(&format!("## {name}\n{text}")).is_err() {
            break;
        }
    }
    exit::OK
}

/// A built-in profile, or a file.
fn faults(name: &str) -> Result<Faults, Findings> {
    if let Some(faults) = Faults::built_in(name) {
        return Ok(faults);
    }
    let path = Path::new(name);
    // What looks like the name of a profile, and is none, was meant as one.
    if path.extension().is_none() && !path.exists() {
        let known = Faults::BUILT_IN.iter().map(|(name, _)| *name);
        let message = format!("there is no fault profile `{name}`");
        return Err(Finding::error("ctos::faults::unknown_profile", message)
            .suggest(name, known)
            .into());
    }
    Faults::read(path)
}

/// An app that is run again and again.
struct Lab<'a> {
    args: &'a SimArgs,
    file: &'a Path,
    app: App,
    registry: Arc<Registry>,
    faults: Faults,
    recorded: Option<RecordConfig>,
}

impl Lab<'_> {
    fn simulate(
        &self,
        seed: u64,
        faults: Faults,
        clock: Clock,
        events: Option<EventSink>,
        record: Option<&RecordConfig>,
        observer: &Observer,
    ) -> Result<Run, u8> {
        let mut app = self.app.clone();
        app.seed = seed;
        app.record = record.cloned();
        let setup = Setup {
            clock,
            faults,
            events,
            stop_after: self.args.limit,
            ..Setup::default()
        };
        let run = simulation::run_shared(Arc::new(app), self.registry.clone(), setup, observer);
        run.map_err(|error| {
            show::say(&format!("error: {}: {error}", self.args.faults));
            exit::CONFIG
        })
    }

    /// Runs one seed and shows the run.
    fn one(&self, seed: u64) -> u8 {
        let clock = Clock::virtual_clock();
        if let Err(code) = start_log(&self.args.log, clock.clone(), true, String::new()) {
            return code;
        }
        let events = match self.args.events.as_deref().map(EventFile::create) {
            None => None,
            Some(Ok(events)) => Some(events),
            Some(Err(code)) => return code,
        };
        let before = cpu();
        let display = Arc::new(Display::new(&self.app, self.args.log.quiet));
        let shown = display.clone();
        let observer: Observer = Arc::new(move |event: &BootEvent| shown.show(event));
        let sink = events.as_ref().map(EventFile::sink);
        let record = self.recorded.as_ref();
        let run = self.simulate(seed, self.faults.clone(), clock, sink, record, &observer);
        display.finish();
        let cpu = cpu().saturating_sub(before);
        let run = match run {
            Ok(run) => run,
            Err(code) => return code,
        };
        if let Some(code) = events.and_then(|events| events.finish().err()) {
            return code;
        }
        let failure = self.failure(&run.outcome);
        if self.args.log.verbose > 0 || failure.is_some() {
            for fault in &run.faults {
                show::say(&format!("fault    {fault}"));
            }
        }
        if !self.args.log.quiet {
            show::say(&self.summary(seed, &run, cpu));
        }
        // A reader that went away has what it wanted.
        let _ = if self.args.json {
            show::data(&self.json(seed, &run, cpu))
        } else if let (End::Finished(result), None) = (&run.outcome.end, &failure) {
            show::data(&result.text)
        } else {
            Ok(())
        };
        let Some(reason) = failure else {
            return exit::OK;
        };
        show::say(&format!("error: {reason}"));
        show::say(&format!(
            "repeat   {}",
            self.command(seed, &self.args.faults)
        ));
        if let Some(path) = &self.args.shrink
            && let Err(code) = self.shrink(seed, &run, path)
        {
            return code;
        }
        match run.outcome.end {
            End::Breakpoint { .. } => exit::LIMIT,
            _ => exit::FAILED,
        }
    }

    /// Runs many seeds and tells which fail.
    fn many(&self, seeds: Range<u64>) -> u8 {
        if self.args.log.verbose > 0 {
            show::say("error: the log is that of one run; add `-v` to the command that repeats it");
            return exit::USAGE;
        }
        // Only the command line's own filter counts; what a run logs, its repetition shows.
        let quiet = LogArgs {
            verbose: 0,
            quiet: true,
            log: Some(
                self.args
                    .log
                    .log
                    .clone()
                    .unwrap_or_else(|| "off".to_owned()),
            ),
            log_format: self.args.log.log_format,
        };
        if let Err(code) = start_log(&quiet, Clock::virtual_clock(), true, String::new()) {
            return code;
        }
        let observer: Observer = Arc::new(|_: &BootEvent| ());
        let (mut failed, mut count) = (Vec::new(), 0_u64);
        for seed in seeds {
            let clock = Clock::virtual_clock();
            let before = cpu();
            let record = self.recorded.as_ref();
            let run = match self.simulate(seed, self.faults.clone(), clock, None, record, &observer)
            {
                Ok(run) => run,
                Err(code) => return code,
            };
            count += 1;
            let cpu = cpu().saturating_sub(before);
            if self.args.json && show::data(&self.json(seed, &run, cpu)).is_err() {
                return exit::OK;
            }
            if let Some(reason) = self.failure(&run.outcome) {
                show::say(&format!("seed {seed} failed: {reason}"));
                for fault in &run.faults {
                    show::say(&format!("  {fault}"));
                }
                show::say(&format!(
                    "repeat   {}",
                    self.command(seed, &self.args.faults)
                ));
                failed.push(seed);
            }
        }
        let summary = format!(
            "sim      {count} seeds, faults `{}`: {} failed",
            self.args.faults,
            failed.len()
        );
        if !self.args.log.quiet {
            show::say(&summary);
        }
        if !self.args.json {
            let _ = show::data(&format!("{} of {count} seeds failed", failed.len()));
        }
        if failed.is_empty() {
            exit::OK
        } else {
            exit::FAILED
        }
    }

    /// Why a run failed, if it did.
    fn failure(&self, outcome: &Outcome) -> Option<String> {
        Some(match &outcome.end {
            End::Finished(result) if result.ok => return None,
            End::Interrupted if self.args.limit.is_some() => return None,
            End::Finished(result) => result.text.clone(),
            End::Interrupted => "interrupted".to_owned(),
            End::Stopped => "stopped by the operator".to_owned(),
            End::ChassisDown { chassis } => {
                let mut casualties = outcome.casualties.iter();
                let how = casualties.find(|(name, _)| name == chassis);
                let how = how.map_or("was not heard any more", |(_, how)| how.as_str());
                format!("chassis `{chassis}` {how} while the app ran")
            }
            End::GivenUp { chassis, reason } => format!("chassis `{chassis}` {reason}"),
            End::TaskFailed { task, reason } => format!("task `{task}` failed: {reason}"),
            End::Breakpoint { reason, .. } => reason.clone(),
            End::PhaseFailed { phase, failures } => {
                let failures = failures
                    .iter()
                    .map(|(task, reason)| format!("task `{task}`: {reason}"));
                let failures: Vec<String> = failures.collect();
                format!("startup phase `{phase}` failed: {}", failures.join("; "))
            }
            End::Stuck => {
                "every task waits for another one; `-vv` shows the last messages".to_owned()
            }
        })
    }

    fn summary(&self, seed: u64, run: &Run, cpu: Duration) -> String {
        let computed = match self.args.cpu {
            true => format!(" in {:.1} s of computing", cpu.as_secs_f64()),
            false => String::new(),
        };
        format!(
            "sim      seed {seed}, faults `{}`: {:.3} s of the app's time{computed}, {} faults",
            self.args.faults,
            run.outcome.took.as_secs_f64(),
            run.faults.len()
        )
    }

    fn json(&self, seed: u64, run: &Run, cpu: Duration) -> String {
        let reason = self.failure(&run.outcome);
        let result = match &run.outcome.end {
            // What an app says is JSON, or else a text.
            End::Finished(result) => serde_json::from_str(&result.json)
                .unwrap_or_else(|_| serde_json::Value::from(result.text.as_str())),
            _ => serde_json::Value::Null,
        };
        let faults: Vec<String> = run.faults.iter().map(ToString::to_string).collect();
        let mut json = serde_json::json!({
            "seed": seed,
            "ok": reason.is_none(),
            "reason": reason,
            "took_s": run.outcome.took.as_secs_f64(),
            "faults": faults,
            "result": result,
        });
        if self.args.cpu {
            json["cpu_s"] = cpu.as_secs_f64().into();
        }
        json.to_string()
    }

    /// The command that runs `seed` with `faults` again.
    fn command(&self, seed: u64, faults: &str) -> String {
        if let Some(command) = &self.args.repeated_by {
            return command.clone();
        }
        let program = std::env::args().next().unwrap_or_else(|| "ctos".to_owned());
        let mut words = vec![
            program,
            "sim".to_owned(),
            self.file.display().to_string(),
            "--seed".to_owned(),
            seed.to_string(),
            "--faults".to_owned(),
            faults.to_owned(),
        ];
        for overlay in &self.args.overlays {
            words.extend(["--profile".to_owned(), overlay.clone()]);
        }
        for set in &self.args.sets {
            words.extend(["--set".to_owned(), set.clone()]);
        }
        for place in &self.args.breakpoints.breaks {
            words.extend(["--break".to_owned(), place.clone()]);
        }
        if let Some(limit) = self.args.limit {
            words.extend(["--for".to_owned(), limit.as_secs_f64().to_string()]);
        }
        let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
        words.join(" ")
    }

    /// Looks for fewer faults with which `seed` fails in the same way.
    fn shrink(&self, seed: u64, run: &Run, path: &Path) -> Result<(), u8> {
        let wanted = kind_of(&run.outcome.end);
        let observer: Observer = Arc::new(|_: &BootEvent| ());
        let mut wrong = None;
        let again = |script: &[Fault], wrong: &mut Option<u8>| {
            let faults = Faults::of_script("shrunk", script.to_vec());
            let clock = Clock::virtual_clock();
            match self.simulate(seed, faults, clock, None, None, &observer) {
                Ok(run) => {
                    kind_of(&run.outcome.end) == wanted && self.failure(&run.outcome).is_some()
                }
                Err(code) => {
                    *wrong = Some(code);
                    false
                }
            }
        };
        let left = simulation::shrink(&run.faults, SHRINK_TRIALS, |script| {
            again(script, &mut wrong)
        });
        if let Some(code) = wrong {
            return Err(code);
        }
        let text = simulation::write_script(&left);
        std::fs::write(path, text).map_err(|error| cannot_write(path, &error))?;
        show::say(&format!(
            "shrunk   {} faults to {}:",
            run.faults.len(),
            left.len()
        ));
        for fault in &left {
            show::say(&format!("fault    {fault}"));
        }
        let path = path.display().to_string();
        show::say(&format!("repeat   {}", self.command(seed, &path)));
        Ok(())
    }
}

/// How long this process has computed.
fn cpu() -> Duration {
    let used = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    let seconds = u64::try_from(used.tv_sec).unwrap_or(0);
    Duration::new(seconds, u32::try_from(used.tv_nsec).unwrap_or(0))
}

/// What makes two failures the same one: how the app ended, and where.
fn kind_of(end: &End) -> (&'static str, String) {
    match end {
        End::Finished(_) => ("finished", String::new()),
        End::Interrupted => ("interrupted", String::new()),
        End::Stopped => ("stopped", String::new()),
        End::ChassisDown { chassis } => ("chassis down", chassis.clone()),
        End::GivenUp { chassis, .. } => ("given up", chassis.clone()),
        End::TaskFailed { task, .. } => ("task failed", task.clone()),
        End::Breakpoint { task, .. } => ("breakpoint", task.clone()),
        End::PhaseFailed { phase, .. } => ("phase failed", phase.to_string()),
        End::Stuck => ("stuck", String::new()),
    }
}

/// A word as a shell takes it.
pub(super) fn quoted(word: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-./:=,+@%".contains(letter);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

fn cannot_write(path: &Path, error: &std::io::Error) -> u8 {
    show::say(&format!(
        "error: cannot write `{}`: {error}",
        path.display()
    ));
    exit::FAILED
}

/// The file of the event log.
struct EventFile {
    path: PathBuf,
    /// The writer, until the first error.
    writer: Arc<Mutex<Result<BufWriter<File>, std::io::Error>>>,
}

impl EventFile {
    fn create(path: &Path) -> Result<Self, u8> {
        let file = File::create(path).map_err(|error| cannot_write(path, &error))?;
        Ok(Self {
            path: path.to_owned(),
            writer: Arc::new(Mutex::new(Ok(BufWriter::new(file)))),
        })
    }

    fn sink(&self) -> EventSink {
        let writer = self.writer.clone();
        Arc::new(move |line: &str| {
            let mut writer = writer.lock().unwrap_or_else(PoisonError::into_inner);
            if let Ok(file) = &mut *writer
                && let Err(error) = writeln!(file, "{line}")
            {
                *writer = Err(error);
            }
        })
    }

    /// What was written is on disk, or was not.
    fn finish(self) -> Result<(), u8> {
        let mut writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
        let written = match &mut *writer {
            Ok(file) => file.flush().err(),
            Err(error) => Some(std::io::Error::new(error.kind(), error.to_string())),
        };
        match written {
            None => Ok(()),
            Some(error) => Err(cannot_write(&self.path, &error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_where_a_shell_would_take_them_apart() {
        assert_eq!(quoted("configs/hello.toml"), "configs/hello.toml");
        assert_eq!(quoted("time.mode=\"virtual\""), "'time.mode=\"virtual\"'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
        assert_eq!(quoted(""), "''");
    }

    #[test]
    fn a_range_of_seeds_is_two_numbers_and_not_empty() {
        assert_eq!(seeds("3..7"), Ok(3..7));
        assert!(seeds("7..3").is_err() && seeds("7").is_err() && seeds("a..b").is_err());
    }
}
