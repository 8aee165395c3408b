//! What the commands that talk to a running app share: which app, how to reach it, and what an error
//! means for the exit code.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use ctos::{
    control::{
        LogLine, Socket,
        protocol::{Activity, Answer, AppView, ErrorCode, Request, TaskView},
    },
    doors::Secret,
    security::Keys,
};

use crate::{
    client::{self, Client, ClientError, Pass},
    exit, show,
};

/// How long an app may take to answer. It asks its chassis itself, and waits for those half a second.
const LIMIT: Duration = Duration::from_secs(5);

/// Which running app.
#[derive(Debug, Clone, Args)]
pub struct RemoteArgs {
    /// Name of the running app, its process id, or NAME-PID; needed only when several are running
    #[arg(long, value_name = "APP", conflicts_with = "at")]
    pub app: Option<String>,
    /// An app on another host
    #[command(flatten)]
    pub at: AtArgs,
}

/// A running app on another host.
#[derive(Debug, Clone, Default, Args)]
pub struct AtArgs {
    /// Where the app listens for tools, as its `[control] listen` says
    #[arg(long, value_name = "HOST:PORT")]
    pub at: Option<String>,
    /// Key to show there, without its ending, made by `ctos keys new`
    #[arg(long, value_name = "DIR/NAME", requires = "at")]
    pub key: Option<PathBuf>,
    /// Certificate of the authority of all keys; `ca.pem` beside the key when it is left out
    #[arg(long, value_name = "FILE", requires = "key")]
    pub authority: Option<PathBuf>,
    /// Secret of a port without keys, for one that is not of this host and user: a copy of the file there
    #[arg(long, value_name = "FILE", requires = "at", conflicts_with = "key")]
    pub token_file: Option<PathBuf>,
}

/// The authority's certificate beside a key.
#[must_use]
pub fn authority_beside(key: &Path) -> PathBuf {
    key.with_file_name("ca.pem")
}

/// Connects to the app that is meant, on whatever host: `app` is its name here.
pub fn connect_to(app: Option<&str>, at: &AtArgs) -> Result<Client, ClientError> {
    let Some(place) = &at.at else {
        return connect_here(app);
    };
    let keys = at.key.as_ref().map(|key| {
        let authority = at.authority.clone();
        let authority = authority.unwrap_or_else(|| authority_beside(key));
        Keys::load(key, &authority)
    });
    let keys = keys.transpose().map_err(|error| ClientError::Key {
        at: "--key".to_owned(),
        error,
    })?;
    let pass = match (keys, &at.token_file) {
        (Some(keys), _) => Pass::Key(Box::new(keys)),
        (None, Some(file)) => Pass::Secret(Secret::read(file)?),
        (None, None) => Pass::OwnPort,
    };
    Client::connect_at(place, &pass, LIMIT)
}

impl RemoteArgs {
    /// Connects to the app that is meant.
    pub fn connect(&self) -> Result<Client, ClientError> {
        connect_to(self.app.as_deref(), &self.at)
    }

    /// What the suggested command lines must add to mean the same app.
    pub fn option(&self, app: &Socket) -> String {
        let Some(place) = &self.at.at else {
            return app_option(app);
        };
        let option = |name: &str, file: &Option<PathBuf>| {
            let file = file.as_ref();
            file.map_or_else(String::new, |file| format!(" --{name} {}", file.display()))
        };
        let key = option("key", &self.at.key);
        let token = option("token-file", &self.at.token_file);
        format!(" --at {place}{key}{token}")
    }
}

/// Connects to an app of this host and user.
pub fn connect_here(app: Option<&str>) -> Result<Client, ClientError> {
    Client::connect(client::find(app)?, LIMIT)
}

/// What the suggested command lines must add to mean `app`.
pub fn app_option(app: &Socket) -> String {
    if client::apps().len() > 1 {
        format!(" --app {}-{}", app.app, app.pid)
    } else {
        String::new()
    }
}

/// Says what went wrong; the exit code.
pub fn failed(error: &ClientError) -> u8 {
    show::say(&format!("error: {error}"));
    if let ClientError::Refused(refused) = error
        && !refused.known.is_empty()
    {
        show::say(&format!("  there are: {}", refused.known.join(", ")));
    }
    match error.code() {
        Some(ErrorCode::NoSuchName) => exit::NO_SUCH_NAME,
        Some(ErrorCode::NotAllowed) => exit::NOT_ALLOWED,
        Some(ErrorCode::TimedOut) => exit::TIMED_OUT,
        Some(ErrorCode::Failed) => exit::FAILED,
        _ => exit::UNREACHABLE,
    }
}

/// As [`failed`], with the known name that comes closest to one of `names`.
pub fn failed_for(names: &[&str], error: &ClientError) -> u8 {
    let code = failed(error);
    if let ClientError::Refused(refused) = error {
        let pairs = names
            .iter()
            .flat_map(|name| refused.known.iter().map(move |known| (name, known)));
        let near = pairs
            .map(|(name, known)| (strsim::damerau_levenshtein(known, name), known))
            .min();
        if let Some((distance, known)) = near
            && distance <= 2
        {
            show::say(&format!("  did you mean `{known}`?"));
        }
    }
    code
}

/// Asks an app how it is.
///
/// # Errors
/// [`ClientError`].
pub fn view(client: &mut Client) -> Result<AppView, ClientError> {
    match client.get(Request::Ps {})? {
        Answer::App(view) => Ok(view),
        other => Err(ClientError::Garbled {
            app: client.app().app.clone(),
            reason: format!("{other:?} is no answer to this"),
        }),
    }
}

/// Whether an app answers, over a connection of its own; one that cannot be connected to has ended, which others tell.
///
/// # Errors
/// [`ClientError::TimedOut`].
pub fn answers(app: Option<&str>, at: &AtArgs) -> Result<(), ClientError> {
    match connect_to(app, at).and_then(|mut client| client.get(Request::Ps {})) {
        Err(error @ ClientError::TimedOut { .. }) => Err(error),
        _ => Ok(()),
    }
}

/// A log line without the blanks that it begins with.
#[must_use]
pub fn log_text(line: &LogLine) -> &str {
    line.text.trim_start()
}

/// A time for a person: "0.3 s", "12 s", "3 min 5 s", "2 h 10 min", "4 d 3 h".
pub fn span(seconds: f64) -> String {
    // A number of seconds fits; what is negative or absurd is shown as zero or as the largest.
    let whole = seconds.max(0.0) as u64;
    match whole {
        0..10 => format!("{:.1} s", seconds.max(0.0)),
        10..60 => format!("{whole} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        3600..86_400 => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
        _ => format!("{} d {} h", whole / 86_400, whole % 86_400 / 3600),
    }
}

/// A number of bytes for a person: "512 B", "3.2 kB", "45 MB".
pub fn size(bytes: u64) -> String {
    let mut number = bytes as f64;
    for unit in ["B", "kB", "MB", "GB"] {
        if number < 999.5 {
            let digits = usize::from(number < 9.95 && unit != "B");
            return format!("{number:.digits$} {unit}");
        }
        number /= 1000.0;
    }
    format!("{number:.1} TB")
}

/// What a task does, in a few words.
pub fn does(task: &TaskView) -> String {
    let command = task.command.as_deref().unwrap_or("a message");
    match task.activity {
        Activity::Idle => match (&task.at, task.left_s) {
            (None, _) => "idle".to_owned(),
            (Some(at), None) => at.clone(),
            (Some(at), Some(left)) => format!("{at}, {} to go", span(left)),
        },
        // Gone with its chassis, or a chassis that is too busy to tell.
        Activity::Gone => "no answer".to_owned(),
        Activity::Busy => {
            let time = task.in_handler_s.map_or_else(String::new, span);
            format!("busy {time}: {command}")
        }
        Activity::Waits => task.waits.first().map_or_else(String::new, |wait| {
            format!(
                "waits {} for {}: {}",
                span(wait.for_s),
                wait.to,
                wait.command
            )
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_two_digits_or_three() {
        for (bytes, text) in [
            (0, "0 B"),
            (999, "999 B"),
            (1_000, "1.0 kB"),
            (45_600_000, "46 MB"),
            (999_600, "1.0 MB"),
            (3_000_000_000_000, "3.0 TB"),
        ] {
            assert_eq!(size(bytes), text);
        }
    }

    #[test]
    fn times_are_shown_in_the_two_largest_units() {
        for (seconds, text) in [
            (-1.0, "0.0 s"),
            (0.26, "0.3 s"),
            (59.9, "59 s"),
            (61.0, "1 min 1 s"),
            (7_260.0, "2 h 1 min"),
            (90_000.0, "1 d 1 h"),
        ] {
            assert_eq!(span(seconds), text);
        }
    }
}
