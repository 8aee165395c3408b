//! `ctos boot`.

use std::{
    ffi::OsString,
    io::Write,
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use clap::{Args, ValueEnum};
use ctos::boot::{BootError, BootEvent, End, Launcher, Observer, Outcome};
use ctos::config::TimeMode;
use ctos::diagnostic::Findings;
use ctos::registry::Registry;
use ctos::task::Phase;

use cli_common::{exit, records, remote, show};
use cli_running::{
    progress::{self, Display},
    record,
};

use crate::{
    commands::{
        args::{AppArgs, LogArgs, start_log},
        breakpoints::{Breakpoints, Released},
        detach, ports,
    },
    log::{LogFormat, private_file},
    program,
};

/// Check an app, start it, wait for its result and stop it
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:
  ctos boot configs/calibrate.toml
  ctos boot configs/calibrate.toml -v
  ctos boot configs/calibrate.toml --record run.mcap
  ctos boot configs/calibrate.toml --display
  ctos boot configs/calibrate.toml --foxglove
  ctos boot configs/calibrate.toml --break dispatcher.move_robot
  ctos boot configs/calibrate.toml --detach --log-file calibrate.log
  ctos boot configs/calibrate.toml --set time.mode=\"virtual\" --set seed=7 --json")]
pub struct BootArgs {
    /// Which app
    #[command(flatten)]
    pub app: AppArgs,
    /// Print the result as one JSON object, last on standard output
    #[arg(long)]
    pub json: bool,
    /// What goes wrong on purpose
    #[command(flatten)]
    pub injure: InjureArgs,
    /// Where nets shall stop
    #[command(flatten)]
    pub breakpoints: Breakpoints,
    /// Record messages, phases, firings, log lines and the scene to FILE; each process puts its name before the extension
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Serve a page that shows the nets, from a chassis of its own; at ADDRESS, or on the loopback. In virtual time the app
    /// then runs no faster than the clock
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = DISPLAY)]
    pub display: Option<SocketAddr>,
    /// Serve the scene, the pictures and the joints to Foxglove and Lichtblick, from a chassis of its own; at ADDRESS, or on
    /// the loopback
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = FOXGLOVE)]
    pub foxglove: Option<SocketAddr>,
    /// With `--display`: let whoever has the token of the page's address intervene
    #[arg(long, requires = "display")]
    pub allow_control: bool,
    /// Boot in the background: return when the app is up, and say where its log is and how to stop it
    #[arg(long)]
    pub detach: bool,
    /// The startup phase after which the app counts as ready, for `--detach` and for service managers
    #[arg(long, value_enum, default_value_t)]
    pub until: Until,
    /// Write the logs of all chassis to this file too; with `--detach` everything that is said
    #[arg(long, value_name = "FILE")]
    pub log_file: Option<PathBuf>,
    /// How much to say
    #[command(flatten)]
    pub log: LogArgs,
}

/// What goes wrong on purpose with the links between chassis, to see what becomes of the app.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Injured links, drawn from the seed")]
pub struct InjureArgs {
    /// Probability that a packet is lost, 0 to 0.9
    #[arg(long, value_name = "P")]
    pub drop: Option<f64>,
    /// How much later each packet leaves, for example `5ms` or `5ms..20ms`
    #[arg(long, value_name = "TIME")]
    pub delay: Option<String>,
    /// Cut the link of two chassis (or of one and `boot`) at a moment, for a while or for good (can be repeated)
    #[arg(long = "cut", value_name = "A:B@TIME[+TIME]")]
    pub cuts: Vec<String>,
}

impl InjureArgs {
    /// The same as `--set` texts, which reach every chassis.
    fn sets(&self) -> Vec<String> {
        let drop = self.drop.map(|drop| format!("injure.drop={drop:?}"));
        let delay = self.delay.as_ref();
        let delay = delay.map(|delay| format!("injure.delay={delay:?}"));
        let cuts = &self.cuts;
        let cuts = (!cuts.is_empty()).then(|| format!("injure.cut={cuts:?}"));
        [drop, delay, cuts].into_iter().flatten().collect()
    }
}

/// Where `--display` serves its page: the text of [`cli_display::DEFAULT_LISTEN`].
pub(super) const DISPLAY: &str = "127.0.0.1:8108";

/// Where `--foxglove` serves viewers: the text of [`scene_viewers::DEFAULT_LISTEN`].
const FOXGLOVE: &str = "127.0.0.1:8765";

/// What a display is, as `--set` texts, which reach every chassis.
fn display_sets(listen: SocketAddr, allow_control: bool) -> [String; 2] {
    let handler = cli_display::HANDLER;
    // The pace counts in virtual time only.
    let args = format!("{{ listen = \"{listen}\", allow_control = {allow_control}, pace = 1.0 }}");
    [
        "chassis.display={ restart = \"on-failure\" }".to_owned(),
        format!("task.display={{ handler = \"{handler}\", on = \"display\", args = {args} }}"),
    ]
}

/// What brings the scene into a record and to viewers, as `--set` texts: a process of its own, so that nothing else is
/// slower. None for an app that shows nothing, or that has such a task itself, if nobody is to be served.
fn viewer_sets(args: &BootArgs, registry: &Registry) -> Vec<String> {
    // Findings about the configuration are shown below.
    let Ok(app) = program::app(&args.app.selection()) else {
        return Vec::new();
    };
    let own = scene_viewers::HANDLER;
    let has_own = app.tasks.iter().any(|task| task.handler == own);
    let shows = !scene::follow::sources(&app, registry).is_empty();
    if args.foxglove.is_none() && (has_own || !shows) {
        return Vec::new();
    }
    let listen = args.foxglove.map(|listen| format!("listen = \"{listen}\""));
    let displays = cli_display::displays_of(&app).map(|file| format!("displays = {file:?}"));
    let given: Vec<String> = listen.into_iter().chain(displays).collect();
    let given = given.join(", ");
    vec![
        "chassis.viewers={ restart = \"on-failure\" }".to_owned(),
        format!("task.viewers={{ handler = \"{own}\", on = \"viewers\", args = {{ {given} }} }}"),
    ]
}

/// When an app counts as ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Until {
    /// All tasks are created
    #[value(alias = "created")]
    Create,
    /// All tasks have found each other
    #[value(alias = "connected")]
    Connect,
    /// All tasks run
    #[default]
    #[value(alias = "running")]
    Run,
}

impl From<Until> for Phase {
    fn from(until: Until) -> Self {
        match until {
            Until::Create => Self::Create,
            Until::Connect => Self::Connect,
            Until::Run => Self::Run,
        }
    }
}

/// Runs the command.
#[must_use]
pub fn run(args: &BootArgs, registry: Registry) -> u8 {
    let mut args = args.clone();
    if args.log.log_format == LogFormat::Json {
        // Findings about the configuration come before there is a clock.
        show::say_json(None);
    }
    if let Some(file) = &args.record {
        match record::setting(file) {
            Ok(set) => args.app.sets.push(set),
            Err(error) => {
                show::say(&format!(
                    "error: cannot record to {}: {error}",
                    file.display()
                ));
                return exit::FAILED;
            }
        }
    }
    if args.record.is_some() || args.foxglove.is_some() {
        let viewers = viewer_sets(&args, &registry);
        args.app.sets.splice(0..0, viewers);
    }
    if let Some(listen) = args.display {
        // Before the settings of the person, which may add to these.
        let display = display_sets(listen, args.allow_control);
        args.app.sets.splice(0..0, display);
        if args.allow_control
            // Findings about the configuration are shown below.
            && let Ok(app) = program::app(&args.app.selection())
        {
            let nets = pnt::task::net_tasks(&app, &registry).into_iter();
            let allows = |net: &String| {
                let task = app.task(net);
                let allows = task.and_then(|task| task.args.get("allow_control")?.as_bool());
                allows == Some(true)
            };
            let others = nets.filter(|net| !allows(net));
            let allow = others.map(|net| format!("task.\"{net}\".args.allow_control=true"));
            args.app.sets.extend(allow);
        }
    }
    let sets = args
        .breakpoints
        .sets(&args.app.selection(), &registry, Released::ByHand);
    match sets {
        Ok(sets) => args.app.sets.extend(sets),
        Err(findings) => return not_started(&args, findings),
    }
    let args = &args;
    let mut selection = args.app.selection();
    selection.sets.extend(args.injure.sets());
    let (app, warnings) = match program::checked(&selection, &registry) {
        Ok(checked) => checked,
        Err(findings) => return not_started(args, findings),
    };
    let taken = ports::taken(&app, args.display, args.foxglove);
    if taken.has_errors() {
        return not_started(args, taken);
    }
    let clock = ctos::boot::clock(app.time);
    // On a virtual clock all tasks run in this process, and their lines name them.
    let process = match app.time {
        TimeMode::Real => format!("{:<1$} │ ", "boot", progress::width(&app)),
        TimeMode::Virtual => String::new(),
    };
    if let Err(code) = start_log(&args.log, clock.clone(), true, process) {
        return code;
    }
    if !args.log.quiet {
        show::findings(warnings);
    }
    let program = match std::env::current_exe() {
        Ok(program) => program,
        Err(error) => {
            show::say(&format!(
                "error: cannot find this program's own file: {error}"
            ));
            return exit::UNREACHABLE;
        }
    };
    let launcher = Launcher {
        program,
        arguments: child_arguments(args),
    };
    if args.detach {
        let mut arguments = boot_arguments(args);
        arguments.insert(0, "boot".into());
        if args.log.log_format == LogFormat::Json {
            // Its standard output goes to the log too.
            arguments.push("--json".into());
        }
        let log = args.log_file.as_deref();
        return detach::run(&app, &arguments, log, args.until.into());
    }
    let log_file = match args.log_file.as_deref().map(LogFile::open).transpose() {
        Ok(log_file) => log_file,
        Err(error) => {
            show::say(&format!("error: cannot write `--log-file`: {error}"));
            return exit::FAILED;
        }
    };
    let display = Arc::new(Display::new(&app, args.log.quiet));
    let shown = display.clone();
    let page = args.display.and_then(|listen| page(listen, args));
    let served = args.foxglove.filter(|listen| listen.port() != 0);
    let served = served.map(|listen| format!("foxglove ws://{listen}"));
    let page = [page, served].into_iter().flatten().collect::<Vec<_>>();
    let terminated = Arc::new(AtomicBool::new(false));
    let told = terminated.clone();
    let ready = Phase::from(args.until);
    let observer: Observer = Arc::new(move |event: &BootEvent| {
        if matches!(event, BootEvent::Terminated) {
            told.store(true, Ordering::Release);
        }
        if matches!(event, BootEvent::PhaseDone { phase, .. } if *phase == ready) {
            detach::notify_ready();
        }
        if let (Some(file), BootEvent::Log { chassis, line }) = (&log_file, event) {
            file.write(chassis, line);
        }
        shown.show(event);
        if let BootEvent::PhaseDone { phase, .. } = event
            && *phase == Phase::Run
        {
            page.iter().for_each(|line| shown.say(line));
        }
    });
    let before = args.record.as_deref().map(records::made_of);
    let before = before.unwrap_or_default();
    let outcome = ctos::boot::boot_with(
        &clock,
        app,
        registry,
        &launcher,
        &log_options(args),
        &observer,
    );
    display.finish();
    if let Some(file) = &args.record
        && outcome.is_ok()
    {
        display.say(&recorded(file, &before));
    }
    match outcome {
        Ok(outcome) => {
            let code = report(&outcome, args.json);
            if code == exit::INTERRUPTED && terminated.load(Ordering::Acquire) {
                exit::TERMINATED
            } else {
                code
            }
        }
        Err(error) => {
            show::say(&format!("error: {error}"));
            match error {
                BootError::Io { .. } => exit::FAILED,
                _ => exit::UNREACHABLE,
            }
        }
    }
}

/// Where the page is, in words; `None` where only its task knows the port.
fn page(listen: SocketAddr, args: &BootArgs) -> Option<String> {
    let token = match args.allow_control {
        true => "  (with its token in the line of `display` above)",
        false => "",
    };
    (listen.port() != 0).then(|| format!("display  http://{listen}/{token}"))
}

/// How much the processes have recorded, and how it is looked at; `before` were there before this run.
fn recorded(file: &Path, before: &[PathBuf]) -> String {
    let mut files = records::made_of(file);
    files.retain(|file| !before.contains(file));
    files.sort();
    // Where the name is that of an earlier run's only file, this one's has another.
    let file = match (before.iter().any(|other| other == file), files.first()) {
        (true, Some(first)) => first,
        _ => file,
    };
    let sizes = files.iter().filter_map(|file| file.metadata().ok());
    let bytes = sizes.map(|found| found.len()).sum();
    let count = match files.len() {
        1 => String::new(),
        count => format!("{count} files, "),
    };
    let (file, size) = (file.display(), remote::size(bytes));
    format!("recorded {file} · {count}{size}\nlook     ctos log info {file}")
}

fn not_started(args: &BootArgs, findings: Findings) -> u8 {
    let counted = show::counted(&findings);
    show::findings(findings);
    show::say(&format!(
        "{}: {counted}; nothing was started",
        args.app.file.display()
    ));
    exit::CONFIG
}

/// A file that the logs of the chassis go to.
struct LogFile {
    file: Mutex<std::fs::File>,
    /// A full disk is reported once.
    told: AtomicBool,
}

impl LogFile {
    fn open(path: &Path) -> std::io::Result<Self> {
        let file = private_file(path)?;
        Ok(Self {
            file: Mutex::new(file),
            told: AtomicBool::new(false),
        })
    }

    fn write(&self, chassis: &str, line: &str) {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        // In one call, so that no line is cut by another.
        let line = show::line_of_chassis(chassis, 0, line);
        let written = file.write_all(format!("{line}\n").as_bytes());
        if let Err(error) = written
            && !self.told.swap(true, Ordering::Relaxed)
        {
            show::say(&format!("warning: the log file cannot be written: {error}"));
        }
    }
}

fn child_arguments(args: &BootArgs) -> Vec<OsString> {
    let mut arguments = boot_arguments(args);
    arguments.insert(0, "chassis".into());
    arguments
}

/// What a further process of this program must be told to read the same app and to say as much.
fn boot_arguments(args: &BootArgs) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = vec![args.app.file.clone().into()];
    for profile in &args.app.profiles {
        arguments.extend(["--profile".into(), profile.into()]);
    }
    for set in args.app.sets.iter().cloned().chain(args.injure.sets()) {
        arguments.extend(["--set".into(), set.into()]);
    }
    arguments.extend(log_options(args).into_iter().map(OsString::from));
    arguments
}

/// How much a chassis is to say, wherever it runs.
fn log_options(args: &BootArgs) -> Vec<String> {
    let mut options = Vec::new();
    if args.log.quiet {
        options.push("--quiet".to_owned());
    }
    options.extend((0..args.log.verbose).map(|_| "-v".to_owned()));
    options.extend(["--log-format", args.log.log_format.word()].map(str::to_owned));
    if let Some(filter) = &args.log.log {
        options.extend(["--log".to_owned(), filter.clone()]);
    }
    options
}

/// Shows how the app ended.
fn report(outcome: &Outcome, json: bool) -> u8 {
    for (chassis, how) in &outcome.casualties {
        show::say(&format!("chassis `{chassis}` {how}"));
    }
    let (code, reason) = match &outcome.end {
        End::Finished(result) if result.ok => {
            let shown = if json {
                show::say(&result.text);
                show::data(&result.json)
            } else {
                show::data(&result.text)
            };
            // A reader that went away has what it wanted.
            let _ = shown;
            return exit::OK;
        }
        End::Finished(result) => (exit::FAILED, result.text.clone()),
        End::Interrupted => (exit::INTERRUPTED, "interrupted".to_owned()),
        End::Stopped => (exit::INTERRUPTED, "stopped by the operator".to_owned()),
        End::ChassisDown { chassis } => {
            let mut casualties = outcome.casualties.iter();
            let how = casualties.find(|(name, _)| name == chassis);
            let how = how.map_or("went away", |(_, how)| how.as_str());
            (
                exit::FAILED,
                format!("chassis `{chassis}` {how} while the app ran; its log above may tell why"),
            )
        }
        End::GivenUp { chassis, reason } => (exit::FAILED, format!("chassis `{chassis}` {reason}")),
        End::TaskFailed { task, reason } => {
            (exit::FAILED, format!("task `{task}` failed: {reason}"))
        }
        End::Breakpoint { reason, .. } => (exit::LIMIT, reason.clone()),
        End::PhaseFailed { phase, failures } => {
            let lines: Vec<String> = failures
                .iter()
                .map(|(task, reason)| format!("  task `{task}`: {reason}"))
                .collect();
            (
                exit::FAILED,
                format!(
                    "startup phase `{phase}` failed and the boot was undone:\n{}",
                    lines.join("\n")
                ),
            )
        }
        End::Stuck => (
            exit::FAILED,
            "every task waits for another one; `-vv` shows the last messages".to_owned(),
        ),
    };
    show::say(&format!("error: {reason}"));
    if json {
        let object = match &outcome.end {
            End::Finished(result) => result.json.clone(),
            _ => serde_json::json!({ "ok": false, "reason": reason }).to_string(),
        };
        // A reader that went away has what it wanted.
        let _ = show::data(&object);
    }
    code
}
