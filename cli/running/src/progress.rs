//! What a person sees while an app runs: phases, how far it is, its log, and how it stops.

use std::{
    io::IsTerminal,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use ctos::{
    boot::{BootEvent, Progress, StopStep},
    config::App,
    task::Phase,
};
use indicatif::{ProgressBar, ProgressState, ProgressStyle};

use cli_common::{show, table};

/// Off a terminal, a line of progress comes every so many steps.
const PLAIN_EVERY: u64 = 10;

/// Shows events on standard error.
pub struct Display {
    bar: Mutex<Option<ProgressBar>>,
    animated: bool,
    told: AtomicU64,
    width: usize,
    /// Whether only what went wrong is shown.
    quiet: bool,
}

impl Display {
    /// A display for `app`; says what is being booted, unless it is `quiet`.
    pub fn new(app: &App, quiet: bool) -> Self {
        if !quiet {
            show::say(&format!(
                "boot     {} · {} chassis · {} tasks",
                app.selection.file.display(),
                app.chassis.len(),
                app.tasks.len()
            ));
        }
        Self {
            bar: Mutex::default(),
            animated: std::io::stderr().is_terminal() && !show::says_json(),
            told: AtomicU64::new(u64::MAX),
            width: width(app),
            quiet,
        }
    }

    /// Shows one event.
    pub fn show(&self, event: &BootEvent) {
        let wrong = matches!(
            event,
            BootEvent::Log { .. }
                | BootEvent::Stopped { error: Some(_), .. }
                | BootEvent::NotQuiet { .. }
                | BootEvent::Signalled { .. }
                | BootEvent::ChassisFailed { .. }
                | BootEvent::Restarting { .. }
                | BootEvent::Restarted { .. }
        );
        if self.quiet && !wrong {
            return;
        }
        match event {
            BootEvent::Progress(progress) => self.progress(progress),
            _ => {
                if let Some(words) = words(event, self.width) {
                    self.line(&words);
                }
            }
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        if let Some(bar) = self
            .bar
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
        {
            bar.finish_and_clear();
        }
    }

    /// Says what belongs to a run that is not `quiet`, for example where its page is.
    pub fn say(&self, text: &str) {
        if !self.quiet {
            self.line(text);
        }
    }

    fn line(&self, text: &str) {
        let text = &match show::says_json() {
            true => text.to_owned(),
            false => table::for_messages(text),
        };
        let bar = self.bar.lock().unwrap_or_else(PoisonError::into_inner);
        match bar.as_ref() {
            Some(bar) => bar.suspend(|| show::say(text)),
            None => show::say(text),
        }
    }

    fn progress(&self, progress: &Progress) {
        let &Progress { done, total, .. } = progress;
        let Progress {
            task, step, what, ..
        } = progress;
        if !self.animated {
            let part = done / PLAIN_EVERY;
            let again = self.told.swap(part, Ordering::Relaxed) == part;
            if !again || done == total || done == 1 {
                self.line(&format!(
                    "run      {task}: {step} {done} of {total}, {what}"
                ));
            }
            return;
        }
        let mut bar = self.bar.lock().unwrap_or_else(PoisonError::into_inner);
        let bar = bar.get_or_insert_with(|| {
            let style = ProgressStyle::with_template(
                "run      {prefix} {pos} of {len} [{bar:30}] {seconds}  {wide_msg}",
            );
            let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
            let style = style.with_key(
                "seconds",
                |state: &ProgressState, out: &mut dyn std::fmt::Write| {
                    // A bar that cannot be written is not shown.
                    let _ = write!(out, "{} s", state.elapsed().as_secs());
                },
            );
            ProgressBar::new(total).with_style(style.progress_chars("━╸ "))
        });
        bar.set_length(total);
        bar.set_position(done);
        bar.set_prefix(format!("{task}: {step}"));
        bar.set_message(what.to_owned());
    }
}

/// How wide the names of the processes of `app` are, in letters.
pub fn width(app: &App) -> usize {
    let names = app.chassis.iter().map(|chassis| chassis.name.len());
    names.max().unwrap_or(0).max("boot".len())
}

/// An event as a line, chassis names `width` wide; `None` for one that is shown in another way, or not
/// at all.
pub fn words(event: &BootEvent, width: usize) -> Option<String> {
    Some(match event {
        BootEvent::Started { chassis, pid, host } => {
            let pid = pid.map_or_else(|| "in this process".to_owned(), |pid| format!("pid {pid}"));
            let host = host.as_ref().map(|host| format!(" on {host}"));
            format!(
                "chassis  {chassis:<width$}  {pid}{}",
                host.unwrap_or_default()
            )
        }
        BootEvent::PhaseDone { phase, tasks, took } => {
            let number = Phase::ALL.iter().position(|one| one == phase).unwrap_or(0) + 1;
            format!(
                "phase {number}  {phase:<8} ✓ {tasks}/{tasks}  {}",
                seconds(*took)
            )
        }
        BootEvent::Log { chassis, line } => show::line_of_chassis(chassis, width, line),
        BootEvent::Stopping { reason } => format!("stop     {reason}"),
        BootEvent::StopStep { step } => {
            let number = StopStep::ALL
                .iter()
                .position(|one| one == step)
                .unwrap_or(0)
                + 1;
            let what = match step {
                StopStep::Quiesce => "nets and services come to rest",
                StopStep::Tasks => "one task after the other is stopped",
                StopStep::Processes => "the processes end",
            };
            format!("stop     {number} {step}: {what}")
        }
        BootEvent::QuietAwaited { tasks } => {
            format!("stop     waits for {}", tasks.join(", "))
        }
        BootEvent::NotQuiet { task, reason } => {
            format!("stop     {task} is not at rest: {reason}")
        }
        BootEvent::Quiet { tasks, of, took } => {
            let (mark, took) = (if tasks == of { '✓' } else { '✗' }, seconds(*took));
            format!("stop     at rest {mark} {tasks}/{of}  {took}")
        }
        BootEvent::Stopped {
            task,
            error: Some(error),
        } => format!("stop     {task}: {error}"),
        BootEvent::AtRest { chassis } => format!("stop     {chassis} is at rest"),
        BootEvent::Signalled { chassis, signal } => {
            format!("stop     {chassis} does not end: {signal}")
        }
        BootEvent::ChassisFailed { chassis, reason } => format!("failed   {chassis} {reason}"),
        BootEvent::Restarting {
            chassis,
            incarnation,
            pause,
        } => format!(
            "restart  {chassis} as process {incarnation} in {}",
            seconds(*pause)
        ),
        BootEvent::Wanted { chassis, task, by } => {
            let first = match (task, by) {
                (Some(task), Some(by)) => format!("first asked by `{by}` for `{task}`"),
                (Some(task), None) => format!("first asked from outside for `{task}`"),
                (None, _) => "as a person asked".to_owned(),
            };
            format!("start    {chassis}, on demand: {first}")
        }
        BootEvent::Awake {
            chassis,
            tasks,
            took,
        } => format!(
            "start    {chassis} is up ✓ {tasks}/{tasks}  after {}",
            seconds(*took)
        ),
        BootEvent::Restarted {
            chassis,
            tasks,
            took,
        } => format!(
            "restart  {chassis} is up again ✓ {tasks}/{tasks}  after {}",
            seconds(*took)
        ),
        _ => return None,
    })
}

fn seconds(duration: Duration) -> String {
    format!("{:.2} s", duration.as_secs_f64())
}
