//! Booting in the background: the same program, away from the terminal, that tells when it is ready.

use std::{
    ffi::OsString,
    fs::File,
    io::{self, Read, Seek},
    os::unix::{net::UnixDatagram, process::CommandExt},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    time::Duration,
};

use ctos::{config::App, control, task::Phase};

use cli_common::{exit, show};

use crate::log::private_file;

/// Where a service manager, or [`run`], waits to be told that the app is ready.
const NOTIFY: &str = "NOTIFY_SOCKET";

/// How often the parent looks whether the app has ended instead of becoming ready.
const LOOK: Duration = Duration::from_millis(100);

/// How much of the log of an app that did not become ready is shown, bytes.
const SHOWN: u64 = 8 * 1024;

/// Tells a service manager that the app is ready, in the way of `sd_notify`, if one wants to know.
pub(crate) fn notify_ready() {
    let Some(path) = std::env::var_os(NOTIFY).filter(|path| !path.is_empty()) else {
        return;
    };
    let told = UnixDatagram::unbound().and_then(|socket| socket.send_to(b"READY=1", &path));
    if let Err(error) = told {
        tracing::warn!(error = %error, "cannot tell that the app is ready");
    }
}

/// Boots the app in the background with `arguments`, and returns when it has passed `until`.
pub(crate) fn run(app: &App, arguments: &[OsString], log: Option<&Path>, until: Phase) -> u8 {
    match start(app, arguments, log, until) {
        Ok(code) => code,
        Err(error) => {
            show::say(&format!("error: cannot start in the background: {error}"));
            exit::FAILED
        }
    }
}

fn start(app: &App, arguments: &[OsString], log: Option<&Path>, until: Phase) -> io::Result<u8> {
    let folder = tempfile::Builder::new().prefix("ctos-").tempdir()?;
    let path = folder.path().join("ready");
    let socket = UnixDatagram::bind(&path)?;
    socket.set_read_timeout(Some(LOOK))?;
    let log = match log {
        Some(log) => std::path::absolute(log)?,
        None => default_log(&app.name)?,
    };
    let file = private_file(&log)?;
    let began = file.metadata()?.len();
    let mut child = Command::new(std::env::current_exe()?)
        .args(arguments)
        .args(["--until", &until.to_string()])
        .env(NOTIFY, &path)
        .stdin(Stdio::null())
        .stdout(file.try_clone()?)
        .stderr(file.try_clone()?)
        .process_group(0)
        .spawn()?;
    match wait(&socket, &mut child)? {
        None => {
            let (name, pid) = (&app.name, child.id());
            show::say(&format!("{name} is up, pid {pid}"));
            show::say(&format!("log      {}", log.display()));
            show::say(&format!("look     ctos ps --app {pid}"));
            show::say(&format!("stop     ctos stop {pid}"));
            Ok(exit::OK)
        }
        Some(status) => {
            show::say(&tail(file, began)?);
            show::say(&format!("{} did not become ready", app.name));
            let code = status.code().and_then(|code| u8::try_from(code).ok());
            // An app that has its result before it was ready is none that runs in the background.
            Ok(code.unwrap_or(exit::FAILED))
        }
    }
}

/// Waits until the app is ready, or has ended: how.
fn wait(socket: &UnixDatagram, child: &mut Child) -> io::Result<Option<ExitStatus>> {
    let mut told = [0_u8; 256];
    loop {
        match socket.recv(&mut told) {
            Ok(length) => {
                let told = told.get(..length).unwrap_or_default();
                if told
                    .split(|byte| *byte == b'\n')
                    .any(|line| line == b"READY=1")
                {
                    return Ok(None);
                }
            }
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::WouldBlock
                        | io::ErrorKind::TimedOut
                        | io::ErrorKind::Interrupted
                ) => {}
            Err(error) => return Err(error),
        }
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
    }
}

/// The log of an app beside its control socket.
fn default_log(name: &str) -> io::Result<PathBuf> {
    let folder = control::prepared_folder()?;
    let plain = |letter: char| {
        if letter.is_ascii_alphanumeric() || "_-.".contains(letter) {
            letter
        } else {
            '_'
        }
    };
    let name: String = name.chars().take(64).map(plain).collect();
    Ok(folder.join(format!("{name}-{}.log", std::process::id())))
}

/// The end of what the app wrote to its log.
fn tail(mut file: File, began: u64) -> io::Result<String> {
    let length = file.metadata()?.len();
    file.seek(io::SeekFrom::Start(began.max(length.saturating_sub(SHOWN))))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).trim_end().to_owned())
}
