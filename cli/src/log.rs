//! Where log lines go: standard error, with the app's own time.

use std::fmt;

use ctos::time::Clock;
use tracing_subscriber::{
    EnvFilter,
    fmt::{format::Writer, time::FormatTime},
};

use crate::show::colours;

/// Seconds since the app was started.
struct AppTime(Clock);

impl FormatTime for AppTime {
    fn format_time(&self, w: &mut Writer<'_>) -> fmt::Result {
        write!(w, "{:9.3}", self.0.now().since_start().as_secs_f64())
    }
}

/// Starts logging. `level` "warn" shows warnings, "info" the firings of nets and other events of the
/// app, "debug" what the runtime does, "trace" everything; `filter` (as in `RUST_LOG`) overrides it.
/// `clock` is the app's.
///
/// # Errors
/// What is wrong with the filter.
pub(crate) fn start(
    level: &str,
    filter: Option<&str>,
    clock: Clock,
    ansi: bool,
) -> Result<(), String> {
    let filter = EnvFilter::try_new(filter.unwrap_or(level)).map_err(|error| {
        format!("`--log` does not hold a filter: {error}; write for example `--log pnt=debug`")
    })?;
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(ansi && colours())
        .with_timer(AppTime(clock))
        // A log that nobody reads any more (the boot was killed) must not make its writer panic: the arm
        // still has to be stopped.
        .log_internal_errors(false)
        .compact()
        .finish();
    // Only the first call of a program counts; a second one finds logging started already.
    let _ = tracing::subscriber::set_global_default(subscriber);
    std::panic::set_hook(Box::new(|panic| {
        tracing::debug!("{panic}");
    }));
    Ok(())
}
