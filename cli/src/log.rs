//! Where log lines go: standard error, as text or as JSON, with the app's own time; the record; and a file of this user.

use std::{
    collections::BTreeMap,
    fmt,
    os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt},
    path::Path,
};

use clap::ValueEnum;
use ctos::{record::RecordLayer, time::Clock};
use tracing::{
    Event, Metadata, Subscriber,
    field::{Field, Visit},
    level_filters::LevelFilter,
};
use tracing_subscriber::{
    EnvFilter, Layer,
    fmt::{format::Writer, time::FormatTime},
    layer::{Context, Filter, SubscriberExt},
    registry::LookupSpan,
};

use cli_common::show::colours;

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum LogFormat {
    /// A line of text for people
    #[default]
    Text,
    /// A JSON object per line, for programs
    Json,
}

impl LogFormat {
    /// The word on the command line.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Json => "json",
        }
    }
}

/// Seconds since the app was started, behind the name of the process where others' lines stand beside its own.
struct AppTime {
    clock: Clock,
    process: String,
}

impl FormatTime for AppTime {
    fn format_time(&self, w: &mut Writer<'_>) -> fmt::Result {
        let seconds = self.clock.now().since_start().as_secs_f64();
        write!(w, "{}{seconds:9.3}", self.process)
    }
}

/// The same as a JSON string without blanks.
struct JsonTime(Clock);

impl FormatTime for JsonTime {
    fn format_time(&self, w: &mut Writer<'_>) -> fmt::Result {
        write!(w, "{:.6}", self.0.now().since_start().as_secs_f64())
    }
}

/// Which lines are shown: by module, as `RUST_LOG` does it, and by task. A directive `NAME=LEVEL` counts
/// for the lines of module NAME and for those of task NAME.
struct Shown {
    modules: EnvFilter,
    tasks: BTreeMap<String, LevelFilter>,
}

impl Shown {
    fn parse(text: &str) -> Result<Self, String> {
        let modules = EnvFilter::try_new(text).map_err(|error| {
            format!(
                "`--log` does not hold a filter: {error}; write for example `--log pnt=debug`, or the name of a task: `--log arm=debug`"
            )
        })?;
        let tasks = text.split(',').filter_map(|directive| {
            let (name, level) = directive.trim().split_once('=')?;
            // Anything with `::` or `[` is of modules and spans alone.
            let plain = !name.contains([':', '[']);
            let level = level.trim().parse().ok()?;
            plain.then(|| (name.trim().to_owned(), level))
        });
        Ok(Self {
            tasks: tasks.collect(),
            modules,
        })
    }

    fn most_of_tasks(&self) -> LevelFilter {
        let most = self.tasks.values().max().copied();
        most.unwrap_or(LevelFilter::OFF)
    }
}

impl<S: Subscriber> Filter<S> for Shown {
    fn enabled(&self, metadata: &Metadata<'_>, cx: &Context<'_, S>) -> bool {
        *metadata.level() <= self.most_of_tasks() || self.modules.enabled(metadata, cx.clone())
    }

    fn event_enabled(&self, event: &Event<'_>, cx: &Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if !self.tasks.is_empty() {
            let mut task = TaskField::default();
            event.record(&mut task);
            if let Some(level) = task.0.and_then(|task| self.tasks.get(&task)) {
                return metadata.level() <= level;
            }
        }
        self.modules.enabled(metadata, cx.clone())
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(self.modules.max_level_hint()?.max(self.most_of_tasks()))
    }
}

/// Finds the field `task`.
#[derive(Default)]
struct TaskField(Option<String>);

impl Visit for TaskField {
    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "task" {
            self.0 = Some(value.to_owned());
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "task" {
            self.0 = Some(format!("{value:?}"));
        }
    }
}

/// How the log of this process is to be.
pub(crate) struct LogSetting<'a> {
    /// "warn" shows warnings, "info" the firings of nets and other events of the app, "debug" what the
    /// runtime does, "trace" everything.
    pub(crate) level: &'a str,
    /// As in `RUST_LOG`, and names of tasks; overrides `level`.
    pub(crate) filter: Option<&'a str>,
    pub(crate) format: LogFormat,
    /// Whether colours may be used.
    pub(crate) ansi: bool,
    /// What each line of text begins with.
    pub(crate) process: String,
}

/// Starts logging. `clock` is the app's. The record, if there is one, gets what is of level "info" and
/// what is shown.
///
/// # Errors
/// What is wrong with the filter.
pub(crate) fn start(setting: LogSetting<'_>, clock: Clock) -> Result<(), String> {
    let text = setting.filter.unwrap_or(setting.level);
    let shown = Shown::parse(text)?;
    // Only the first call of a program counts; a second one finds logging started already.
    let _ = tracing::subscriber::set_global_default(
        tracing_subscriber::registry()
            .with(RecordLayer::new().with_filter(Recorded(Shown::parse(text)?)))
            .with(lines(setting, clock).with_filter(shown)),
    );
    std::panic::set_hook(Box::new(|panic| {
        ctos::note_panic(panic);
        tracing::debug!("{panic}");
    }));
    Ok(())
}

/// What goes into the record.
struct Recorded(Shown);

impl<S: Subscriber> Filter<S> for Recorded {
    fn enabled(&self, metadata: &Metadata<'_>, cx: &Context<'_, S>) -> bool {
        *metadata.level() <= LevelFilter::INFO || self.0.enabled(metadata, cx)
    }

    fn event_enabled(&self, event: &Event<'_>, cx: &Context<'_, S>) -> bool {
        *event.metadata().level() <= LevelFilter::INFO || self.0.event_enabled(event, cx)
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        let shown = Filter::<S>::max_level_hint(&self.0)?;
        Some(shown.max(LevelFilter::INFO))
    }
}

/// The layer that writes lines to standard error.
fn lines<S>(setting: LogSetting<'_>, clock: Clock) -> Box<dyn Layer<S> + Send + Sync>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
{
    let layer = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(setting.ansi && colours())
        // A log that nobody reads any more (the boot was killed) must not make its writer panic: the arm
        // still has to be stopped.
        .log_internal_errors(false);
    match setting.format {
        LogFormat::Text => {
            let process = setting.process;
            let timer = AppTime { clock, process };
            layer.with_timer(timer).compact().boxed()
        }
        LogFormat::Json => layer
            .with_timer(JsonTime(clock))
            .json()
            .flatten_event(true)
            .with_current_span(false)
            .with_span_list(false)
            .boxed(),
    }
}

/// Opens a log that this user alone may read, also when it was begun otherwise.
pub(crate) fn private_file(path: &Path) -> std::io::Result<std::fs::File> {
    let file = std::fs::OpenOptions::new()
        .create(true)
        .append(true)
        .read(true)
        .mode(0o600)
        .open(path)?;
    let found = file.metadata()?;
    // Nobody else's file, and no terminal or pipe, is changed.
    if found.is_file() && found.uid() == rustix::process::geteuid().as_raw() {
        file.set_permissions(std::fs::Permissions::from_mode(0o600))?;
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct Seen(Arc<Mutex<Vec<String>>>);

    impl<S: Subscriber> Layer<S> for Seen {
        fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
            let mut task = TaskField::default();
            event.record(&mut task);
            let line = format!(
                "{} {}",
                event.metadata().level(),
                task.0.unwrap_or_default()
            );
            self.0.lock().unwrap().push(line);
        }
    }

    fn seen(filter: &str) -> Vec<String> {
        let seen = Seen::default();
        let layer = seen.clone().with_filter(Shown::parse(filter).unwrap());
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            tracing::debug!(task = "arm", "moves");
            tracing::debug!(task = %"eye", "looks");
            tracing::info!("of nobody");
            tracing::warn!(task = "eye", "is dirty");
        });
        seen.0.lock().unwrap().clone()
    }

    #[test]
    fn a_directive_with_the_name_of_a_task_counts_for_its_lines_alone() {
        assert_eq!(seen("warn"), ["WARN eye"]);
        assert_eq!(seen("warn,arm=debug"), ["DEBUG arm", "WARN eye"]);
        assert_eq!(seen("info,eye=error"), ["INFO "]);
        assert_eq!(seen("warn,eye=trace"), ["DEBUG eye", "WARN eye"]);
    }

    #[test]
    fn a_module_is_filtered_as_ever() {
        let here = module_path!();
        assert_eq!(seen(&format!("off,{here}=info")), ["INFO ", "WARN eye"]);
        assert!(Shown::parse("a=b=c").is_err());
    }
}
