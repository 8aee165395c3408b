//! The client's end of the control socket: plain blocking calls, for programs that do nothing else.

use std::{
    io::{self, BufRead, BufReader, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    os::{
        fd::{AsFd, OwnedFd},
        unix::net::UnixStream,
    },
    path::PathBuf,
    time::Duration,
};

use base64::{Engine, engine::general_purpose::STANDARD};
use rustix::{
    io::ioctl_fionbio,
    net::sockopt::{Timeout, set_socket_timeout},
};

use ctos::{
    Command,
    control::{
        Socket, folder,
        protocol::{
            Answer, Ask, ErrorCode, ErrorView, REQUEST_LIMIT, Request, Shown, VERSION, too_long,
        },
        sockets,
    },
    doors::{Secret, SecretError},
    message::Data,
    security::{KeyError, Keys, Role},
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
    #[error("several apps are running; name one of them: {}", .known.join(", "))]
    Several {
        /// Their names and processes, as `--app` takes them.
        known: Vec<String>,
    },
    /// The key of this tool cannot be used, or the app does not prove who it is.
    #[error("{at}: {error}")]
    Key {
        /// Where the app should be.
        at: String,
        /// What is wrong.
        error: KeyError,
    },
    /// What answers there has a key, and not that of an app.
    #[error("{at}: what answers there has a key with the role `{role}`, and an app has `boot`")]
    Impostor {
        /// Where the app should be.
        at: String,
        /// The role.
        role: Role,
    },
    /// The secret of its port cannot be read.
    #[error("--token-file: {0}")]
    Secret(#[from] SecretError),
    /// It does not answer.
    #[error("cannot reach app `{app}`{}: {error}", of(*.pid))]
    Unreachable {
        /// The app.
        app: String,
        /// Its process; 0 for one on another host.
        pid: u32,
        /// What the system said.
        error: io::Error,
    },
    /// It took too long.
    #[error("app `{app}`{} did not answer within {} s: is its process stopped, or very busy?", of(*.pid), .timeout.as_secs_f64())]
    TimedOut {
        /// The app.
        app: String,
        /// Its process; 0 for one on another host.
        pid: u32,
        /// The timeout.
        timeout: Duration,
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

/// The process of an app, in brackets.
fn of(pid: u32) -> String {
    match pid {
        0 => String::new(),
        pid => format!(" (pid {pid})"),
    }
}

impl ClientError {
    /// What kind of error it is, in the words of the protocol; `None` when the app could not be reached or
    /// understood.
    #[must_use]
    pub fn code(&self) -> Option<ErrorCode> {
        match self {
            Self::NoSuchApp { .. } => Some(ErrorCode::NoSuchName),
            Self::TimedOut { .. } => Some(ErrorCode::TimedOut),
            Self::Key { .. } | Self::Impostor { .. } | Self::Secret(_) => {
                Some(ErrorCode::NotAllowed)
            }
            Self::Refused(error) => Some(error.code),
            _ => None,
        }
    }
}

/// The apps of this user that run.
#[must_use]
pub fn apps() -> Vec<Socket> {
    sockets(&folder())
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

/// What an app is spoken to over.
trait Wire: Read + Write + Send {}

impl<T: Read + Write + Send> Wire for T {}

/// What a tool shows to an app on another host.
#[derive(Debug)]
pub enum Pass {
    /// A key, over TLS.
    Key(Box<Keys>),
    /// The secret of a port without keys.
    Secret(Secret),
    /// The secret of a port of this host and user. The client looks it up.
    OwnPort,
}

/// The secret of the port that was called.
fn own_secret(stream: &TcpStream) -> io::Result<Secret> {
    Secret::of_port(stream.peer_addr()?).map_err(|error| {
        let hint = "does it want a key (--key), or the secret of its port (--token-file)?";
        io::Error::other(format!("{hint} ({error})"))
    })
}

/// A connection to an app.
#[derive(derive_more::Debug)]
#[debug("Client({:?})", self.app)]
pub struct Client {
    app: Socket,
    timeout: Duration,
    stream: BufReader<Box<dyn Wire>>,
    /// The socket below it, for its time-outs.
    socket: OwnedFd,
    /// What has come of the next answer.
    begun: Vec<u8>,
    /// What it may mean when the other end hangs up before it has answered anything.
    hung_up: Option<&'static str>,
}

impl Client {
    /// Connects to an app. Waits for its answers as long as `timeout`.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`].
    pub fn connect(app: Socket, timeout: Duration) -> Result<Self, ClientError> {
        let connected = UnixStream::connect(&app.path).and_then(|stream| {
            let socket = timed(&stream, timeout)?;
            Ok((stream, socket))
        });
        let (stream, socket) = connected.map_err(|error| out_of_reach(&app, error))?;
        Ok(Self::over(Box::new(stream), socket, app, timeout, None))
    }

    /// Connects to an app on whatever host, which has `[control] listen = "..."`, at `HOST:PORT`, and shows
    /// `pass` there. The client waits for its answers as long as `timeout`.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`], also when nobody knows the secret of the port, and [`ClientError::Key`]
    /// when the app does not prove who it is.
    pub fn connect_at(at: &str, pass: &Pass, timeout: Duration) -> Result<Self, ClientError> {
        let app = Socket {
            app: at.to_owned(),
            pid: 0,
            path: PathBuf::new(),
        };
        let unreachable = |error| out_of_reach(&app, error);
        let (mut stream, socket) = called(at, timeout).map_err(unreachable)?;
        let (stream, hint): (Box<dyn Wire>, _) = match pass {
            Pass::Key(keys) => {
                let at = at.to_owned();
                let (stream, identity) = match keys.call_blocking(stream) {
                    Ok(met) => met,
                    Err(error) => return Err(ClientError::Key { at, error }),
                };
                if !identity.may(Role::Boot) {
                    let role = identity.role;
                    return Err(ClientError::Impostor { at, role });
                }
                let hint = "it hung up; is this key of its authority?";
                (Box::new(stream), hint)
            }
            Pass::Secret(_) | Pass::OwnPort => {
                let token = match pass {
                    Pass::Secret(secret) => Ok(secret.clone()),
                    _ => own_secret(&stream),
                };
                let told = token.and_then(|token| {
                    let shown = serde_json::to_string(&Shown { token })?;
                    stream.write_all(format!("{shown}\n").as_bytes())
                });
                told.map_err(unreachable)?;
                let hint = "it hung up; does it want a key (--key), or belong to another user?";
                (Box::new(stream), hint)
            }
        };
        Ok(Self::over(stream, socket, app, timeout, Some(hint)))
    }

    fn over(
        stream: Box<dyn Wire>,
        socket: OwnedFd,
        app: Socket,
        timeout: Duration,
        hung_up: Option<&'static str>,
    ) -> Self {
        Self {
            app,
            timeout,
            stream: BufReader::new(stream),
            socket,
            begun: Vec::new(),
            hung_up,
        }
    }

    /// The app. Of one on another host its address is known, in the place of its name, and no process
    /// (0).
    #[must_use]
    pub fn app(&self) -> &Socket {
        &self.app
    }

    /// Waits for each further answer as long as it takes.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`].
    pub fn wait_for_ever(&mut self) -> Result<(), ClientError> {
        self.patience(None)
    }

    /// How long each reading may take.
    fn patience(&self, timeout: Option<Duration>) -> Result<(), ClientError> {
        let set = set_socket_timeout(&self.socket, Timeout::Recv, timeout);
        set.map_err(|error| self.failed(error.into()))
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
        let line = serde_json::to_string(&ask).map_err(|error| self.garbled(error))?;
        if line.len() >= REQUEST_LIMIT {
            let why = too_long(Some(line.len() + 1));
            let wrong = ErrorView::new(ErrorCode::BadRequest, why);
            return Err(ClientError::Refused(wrong));
        }
        let stream = self.stream.get_mut();
        let written = stream
            .write_all(format!("{line}\n").as_bytes())
            .and_then(|()| stream.flush());
        written.map_err(|error| self.failed(error))
    }

    /// The next answer; `None` when the app has closed the connection.
    ///
    /// # Errors
    /// [`ClientError`], also [`ClientError::Refused`] when the answer is an error.
    pub fn read(&mut self) -> Result<Option<Answer>, ClientError> {
        let read = self.stream.read_until(b'\n', &mut self.begun);
        read.map_err(|error| self.failed(error))?;
        self.whole()
    }

    /// The next answer if it comes within `timeout`. What has come of it by then is kept, so that one may ask
    /// again.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_within(&mut self, timeout: Duration) -> Result<Within, ClientError> {
        self.patience(Some(timeout))?;
        let read = self.stream.read_until(b'\n', &mut self.begun);
        self.patience(Some(self.timeout))?;
        match read {
            Ok(_) => Ok(match self.whole()? {
                Some(answer) => Within::Answer(Box::new(answer)),
                None => Within::Closed,
            }),
            Err(error) if is_late(&error) => Ok(Within::NotYet),
            Err(error) => Err(self.failed(error)),
        }
    }

    /// Whether the app has closed a connection over which the client awaits nothing, or says what nobody has asked for. It
    /// does not wait: a time-out, however short, costs a tick of the system's clock.
    pub fn has_ended(&mut self) -> bool {
        let set = ioctl_fionbio(&self.socket, true);
        let read = self.stream.read_until(b'\n', &mut self.begun);
        let back = ioctl_fionbio(&self.socket, false);
        let is_quiet = read.is_err_and(|error| is_late(&error));
        set.is_err() || back.is_err() || !is_quiet
    }

    /// The answer that has been read to its end.
    fn whole(&mut self) -> Result<Option<Answer>, ClientError> {
        let bytes = std::mem::take(&mut self.begun);
        if bytes.is_empty() && self.hung_up.is_none() {
            return Ok(None);
        }
        // What is no line of an app at all is the end of an attempt to speak TLS.
        if self.hung_up.is_some() && !bytes.starts_with(b"{") {
            return Err(self.failed(io::ErrorKind::UnexpectedEof.into()));
        }
        self.hung_up = None;
        match serde_json::from_slice(&bytes) {
            Ok(Answer::Error(error)) => Err(ClientError::Refused(error)),
            Ok(answer) => Ok(Some(answer)),
            Err(error) => Err(self.garbled(error)),
        }
    }

    fn garbled(&self, reason: impl ToString) -> ClientError {
        ClientError::Garbled {
            app: self.app.app.clone(),
            reason: reason.to_string(),
        }
    }

    /// Sends a task one of its commands and waits for its answer as long as the app does. For an app that does not
    /// answer at all it waits a little longer. Needs the role `call`.
    ///
    /// # Errors
    /// As [`Self::read`], and [`ClientError::Garbled`] when the answer is no `C::Reply`.
    pub fn call<C: Command>(
        &mut self,
        task: &str,
        request: C,
        within: Duration,
    ) -> Result<C::Reply, ClientError> {
        let encoded = Data::of(request).into_bytes();
        let encoded = encoded.map_err(|error| self.garbled(error))?;
        let usual = self.timeout;
        self.timeout = usual.saturating_add(within);
        self.patience(Some(self.timeout))?;
        let answer = self.get(Request::Call {
            task: task.to_owned(),
            command: C::NAME.to_owned(),
            data: STANDARD.encode(encoded),
            within_s: within.as_secs_f64(),
        });
        self.timeout = usual;
        self.patience(Some(usual))?;
        let answer = answer?;
        let Answer::Reply { data } = answer else {
            return Err(self.garbled("it is not the answer to a call"));
        };
        let bytes = STANDARD.decode(data);
        let bytes = bytes.map_err(|error| self.garbled(error))?;
        let reply = Data::Bytes(bytes).take::<C::Reply>();
        reply.map_err(|error| self.garbled(error))
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
        if is_late(&error) {
            return ClientError::TimedOut {
                app: self.app.app.clone(),
                pid: self.app.pid,
                timeout: self.timeout,
            };
        }
        // What a refusal looks like from here.
        let refused = matches!(
            error.kind(),
            io::ErrorKind::UnexpectedEof
                | io::ErrorKind::ConnectionReset
                | io::ErrorKind::BrokenPipe
                | io::ErrorKind::InvalidData
        );
        let error = match self.hung_up.filter(|_| refused) {
            Some(hint) => io::Error::new(error.kind(), format!("{hint} ({error})")),
            None => error,
        };
        out_of_reach(&self.app, error)
    }
}

fn out_of_reach(app: &Socket, error: io::Error) -> ClientError {
    ClientError::Unreachable {
        app: app.app.clone(),
        pid: app.pid,
        error,
    }
}

/// What came within a time-out.
#[derive(Debug)]
pub enum Within {
    /// An answer.
    Answer(Box<Answer>),
    /// Nothing whole.
    NotYet,
    /// The app has closed the connection.
    Closed,
}

/// Whether the time was over before anything came.
fn is_late(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
    )
}

/// The socket below `stream`, each of whose readings and writings may take `timeout`.
fn timed(stream: &impl AsFd, timeout: Duration) -> io::Result<OwnedFd> {
    let socket = stream.as_fd().try_clone_to_owned()?;
    set_socket_timeout(&socket, Timeout::Recv, Some(timeout))?;
    set_socket_timeout(&socket, Timeout::Send, Some(timeout))?;
    Ok(socket)
}

/// Calls the first address of `at` that answers.
fn called(at: &str, timeout: Duration) -> io::Result<(TcpStream, OwnedFd)> {
    let mut failed = io::Error::new(io::ErrorKind::NotFound, "the name leads to no address");
    for address in at.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, timeout) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                let socket = timed(&stream, timeout)?;
                return Ok((stream, socket));
            }
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

#[cfg(test)]
mod tests {
    use std::sync::{
        Arc, Mutex,
        mpsc::{Receiver, Sender, channel},
    };

    use ctos::security::make_key;
    use tokio::io::AsyncWriteExt;

    use rustix::{
        fs::{OFlags, fcntl_getfl},
        net::sockopt::socket_timeout,
    };

    use super::*;

    /// Whether a reading would wait, and how long.
    type Reading = (bool, Option<Duration>);

    /// A connection that notes its readings.
    struct Noted {
        stream: UnixStream,
        readings: Arc<Mutex<Vec<Reading>>>,
    }

    impl Read for Noted {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            let waits = !fcntl_getfl(&self.stream)?.contains(OFlags::NONBLOCK);
            let patience = socket_timeout(&self.stream, Timeout::Recv)?;
            self.readings.lock().unwrap().push((waits, patience));
            self.stream.read(into)
        }
    }

    impl Write for Noted {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.stream.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            self.stream.flush()
        }
    }

    #[test]
    fn a_look_waits_for_nothing_finds_the_end_and_keeps_what_came_of_a_line() {
        const PATIENCE: Duration = Duration::from_secs(3);
        let (stream, mut app) = UnixStream::pair().unwrap();
        let (readings, fd) = (Arc::default(), timed(&stream, PATIENCE).unwrap());
        let noted = Noted {
            stream,
            readings: Arc::clone(&readings),
        };
        let mut client = Client::over(Box::new(noted), fd, socket("cell", 7), PATIENCE, None);
        let looks = |client: &mut Client| {
            readings.lock().unwrap().clear();
            let ended = client.has_ended();
            let seen = readings.lock().unwrap().clone();
            // The time-outs are as they were, and no reading may wait for one.
            let quick = |one: &Reading| *one == (false, Some(PATIENCE));
            assert!(!seen.is_empty() && seen.iter().all(quick), "{seen:?}");
            ended
        };
        assert!(!looks(&mut client));
        app.write_all(b"{\"kind\":\"do").unwrap();
        assert!(!looks(&mut client));
        app.write_all(b"ne\"}\n").unwrap();
        // What is asked for waits as before, and has the line from its beginning.
        readings.lock().unwrap().clear();
        assert!(matches!(client.read(), Ok(Some(Answer::Done {}))));
        assert_eq!(*readings.lock().unwrap(), [(true, Some(PATIENCE))]);
        drop(app);
        assert!(looks(&mut client));
    }

    /// An app that proves who it is, and says over TLS what it is told to. It tells when that is written.
    fn secured(
        key: Keys,
        to_say: Receiver<&'static [u8]>,
        said: Sender<()>,
    ) -> (String, std::thread::JoinHandle<()>) {
        let listener = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
        listener.set_nonblocking(true).unwrap();
        let at = listener.local_addr().unwrap().to_string();
        let serve = async move {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            let (stream, _) = listener.accept().await.unwrap();
            let (mut stream, _) = key.answer(stream).await.unwrap();
            while let Ok(bytes) = to_say.recv() {
                stream.write_all(bytes).await.unwrap();
                stream.flush().await.unwrap();
                said.send(()).unwrap();
            }
        };
        let served = std::thread::spawn(move || {
            let mut runtime = tokio::runtime::Builder::new_current_thread();
            runtime.enable_all().build().unwrap().block_on(serve);
        });
        (at, served)
    }

    #[test]
    fn a_look_at_a_connection_with_keys_waits_for_nothing_finds_the_end_and_keeps_what_came_of_a_line()
     {
        /// A wait for this long would never end.
        const PATIENCE: Duration = Duration::from_secs(100_000);
        let folder = tempfile::tempdir().unwrap();
        let key = |name: &str, role| {
            let key = make_key(&folder.path().join(name), role).unwrap();
            Keys::load(&key, &folder.path().join("ca.pem")).unwrap()
        };
        let (app, tool) = (key("app", Role::Boot), key("tool", Role::Watch));
        let ((say, to_say), (tell, said)) = (channel(), channel());
        let (at, served) = secured(app, to_say, tell);
        let pass = Pass::Key(Box::new(tool));
        let mut client = Client::connect_at(&at, &pass, PATIENCE).unwrap();
        assert!(!client.has_ended());
        for part in [&b"{\"kind\":\"do"[..], b"ne\"}\n{\"kind"] {
            say.send(part).unwrap();
            said.recv().unwrap();
            // The end of a line is not silence; a part of one may be what somebody waits for.
            let whole = part.contains(&b'\n');
            assert!(whole || !client.has_ended());
        }
        // What is asked for waits as before, and has the line from its beginning.
        assert!(matches!(client.read(), Ok(Some(Answer::Done {}))));
        assert!(!client.has_ended());
        say.send(b"\":\"done\"}\n").unwrap();
        assert!(matches!(client.read(), Ok(Some(Answer::Done {}))));
        assert!(!client.has_ended());
        drop(say);
        served.join().unwrap();
        assert!(client.has_ended());
    }

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
        assert!(error.code() == Some(ErrorCode::NoSuchName) && error.to_string().contains("lab-9"));
        assert!(matches!(choose(Vec::new(), None), Err(ClientError::NoApp)));
    }
}
