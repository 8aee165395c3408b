//! The client's end of the control socket: plain blocking calls, for programs that do nothing else.

use std::{
    io::{self, BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    time::Duration,
};

use crate::control::{
    Socket, place,
    protocol::{Answer, Ask, ErrorCode, ErrorView, Request, VERSION},
};

/// Why an app could not be asked, or said no.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No app runs.
    #[error("no app is running; start one with `ctos boot FILE`")]
    NoApp,
    /// No app has this name.
    #[error("no running app is called `{name}`; there are: {}", .known.join(", "))]
    NoSuchApp {
        /// The name.
        name: String,
        /// Those that run.
        known: Vec<String>,
    },
    /// There are several.
    #[error("several apps are running; choose one with `--app`: {}", .known.join(", "))]
    Several {
        /// Their names and processes, as `--app` takes them.
        known: Vec<String>,
    },
    /// It does not answer.
    #[error("cannot reach app `{app}` (pid {pid}): {error}")]
    Unreachable {
        /// The app.
        app: String,
        /// Its process.
        pid: u32,
        /// What the system said.
        error: io::Error,
    },
    /// It took too long.
    #[error("app `{app}` (pid {pid}) did not answer within {} s", .limit.as_secs_f64())]
    TimedOut {
        /// The app.
        app: String,
        /// Its process.
        pid: u32,
        /// The limit.
        limit: Duration,
    },
    /// It answered what this version cannot read.
    #[error("cannot read what app `{app}` answers: {reason}; is it of another version?")]
    Garbled {
        /// The app.
        app: String,
        /// What is wrong.
        reason: String,
    },
    /// It said no.
    #[error("{}", .0.message)]
    Refused(ErrorView),
}

impl ClientError {
    /// Whether a name was wrong.
    #[must_use]
    pub fn is_no_such_name(&self) -> bool {
        match self {
            Self::NoSuchApp { .. } => true,
            Self::Refused(error) => error.code == ErrorCode::NoSuchName,
            _ => false,
        }
    }

    /// Whether something took too long.
    #[must_use]
    pub fn is_timed_out(&self) -> bool {
        match self {
            Self::TimedOut { .. } => true,
            Self::Refused(error) => error.code == ErrorCode::TimedOut,
            _ => false,
        }
    }

    /// Whether the app said no.
    #[must_use]
    pub fn is_refused(&self) -> bool {
        matches!(self, Self::Refused(error) if error.code == ErrorCode::Failed)
    }
}

/// The apps of this user that run.
#[must_use]
pub fn apps() -> Vec<Socket> {
    place::sockets(&place::folder())
}

/// The app called `name`, which may be its process id or `NAME-PID` too; without a name the only one.
///
/// # Errors
/// [`ClientError`] when there is none, or more than one.
pub fn find(name: Option<&str>) -> Result<Socket, ClientError> {
    choose(apps(), name)
}

fn choose(apps: Vec<Socket>, name: Option<&str>) -> Result<Socket, ClientError> {
    let full = |app: &Socket| format!("{}-{}", app.app, app.pid);
    let known: Vec<String> = apps.iter().map(full).collect();
    if known.is_empty() {
        return Err(ClientError::NoApp);
    }
    let mut chosen = apps.into_iter().filter(|app| {
        name.is_none_or(|name| app.app == name || app.pid.to_string() == name || full(app) == name)
    });
    match (chosen.next(), chosen.next()) {
        (Some(app), None) => Ok(app),
        (Some(_), Some(_)) => Err(ClientError::Several { known }),
        (None, _) => Err(ClientError::NoSuchApp {
            name: name.unwrap_or_default().to_owned(),
            known,
        }),
    }
}

/// A connection to an app.
#[derive(Debug)]
pub struct Client {
    app: Socket,
    limit: Duration,
    reader: BufReader<UnixStream>,
    writer: UnixStream,
}

impl Client {
    /// Connects to an app whose answers are waited for `limit` long.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`].
    pub fn connect(app: Socket, limit: Duration) -> Result<Self, ClientError> {
        let connected = UnixStream::connect(&app.path).and_then(|writer| {
            writer.set_read_timeout(Some(limit))?;
            writer.set_write_timeout(Some(limit))?;
            Ok((BufReader::new(writer.try_clone()?), writer))
        });
        match connected {
            Ok((reader, writer)) => Ok(Self {
                app,
                limit,
                reader,
                writer,
            }),
            Err(error) => Err(ClientError::Unreachable {
                app: app.app,
                pid: app.pid,
                error,
            }),
        }
    }

    /// The app.
    #[must_use]
    pub fn app(&self) -> &Socket {
        &self.app
    }

    /// Waits for each further answer as long as it takes.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`].
    pub fn wait_for_ever(&mut self) -> Result<(), ClientError> {
        let set = self.reader.get_ref().set_read_timeout(None);
        set.map_err(|error| self.failed(error))
    }

    /// Asks. The answers are read with [`Self::read`].
    ///
    /// # Errors
    /// [`ClientError::Unreachable`] and [`ClientError::TimedOut`].
    pub fn ask(&mut self, request: Request) -> Result<(), ClientError> {
        let ask = Ask {
            version: VERSION,
            request,
        };
        let line = serde_json::to_string(&ask).map_err(|error| ClientError::Garbled {
            app: self.app.app.clone(),
            reason: error.to_string(),
        })?;
        let written = writeln!(self.writer, "{line}");
        written.map_err(|error| self.failed(error))
    }

    /// The next answer; `None` when the app has closed the connection.
    ///
    /// # Errors
    /// [`ClientError`], also [`ClientError::Refused`] when the answer is an error.
    pub fn read(&mut self) -> Result<Option<Answer>, ClientError> {
        let mut line = String::new();
        match self.reader.read_line(&mut line) {
            Ok(0) => return Ok(None),
            Ok(_) => {}
            Err(error) => return Err(self.failed(error)),
        }
        match serde_json::from_str(&line) {
            Ok(Answer::Error(error)) => Err(ClientError::Refused(error)),
            Ok(answer) => Ok(Some(answer)),
            Err(error) => Err(ClientError::Garbled {
                app: self.app.app.clone(),
                reason: error.to_string(),
            }),
        }
    }

    /// Asks for what is answered in one line.
    ///
    /// # Errors
    /// As [`Self::read`]; [`ClientError::Unreachable`] when the app goes instead of answering.
    pub fn get(&mut self, request: Request) -> Result<Answer, ClientError> {
        self.ask(request)?;
        match self.read()? {
            Some(answer) => Ok(answer),
            None => Err(self.failed(io::ErrorKind::UnexpectedEof.into())),
        }
    }

    fn failed(&self, error: io::Error) -> ClientError {
        let (app, pid) = (self.app.app.clone(), self.app.pid);
        match error.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => ClientError::TimedOut {
                app,
                pid,
                limit: self.limit,
            },
            _ => ClientError::Unreachable { app, pid, error },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn socket(app: &str, pid: u32) -> Socket {
        Socket {
            app: app.to_owned(),
            pid,
            path: format!("{app}-{pid}.sock").into(),
        }
    }

    #[test]
    fn the_app_is_the_only_one_or_the_one_that_is_named() {
        let both = || vec![socket("cell", 7), socket("cell", 8), socket("lab", 9)];
        let pid = |name: Option<&str>| choose(both(), name).map(|app| app.pid).ok();
        assert_eq!(pid(Some("lab")), Some(9));
        assert_eq!(pid(Some("8")), Some(8));
        assert_eq!(pid(Some("cell-7")), Some(7));
        assert_eq!(pid(Some("cell")), None);
        assert_eq!(pid(None), None);
        let only = choose(vec![socket("lab", 9)], None);
        assert_eq!(only.map(|app| app.pid).ok(), Some(9));
        let error = choose(both(), Some("leb")).unwrap_err();
        assert!(error.is_no_such_name() && error.to_string().contains("lab-9"));
        assert!(matches!(choose(Vec::new(), None), Err(ClientError::NoApp)));
    }
}
