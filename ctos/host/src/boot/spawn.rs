//! A child process of this one: started, its log read line by line, signalled, seen to end.
//!
//! The boot starts chassis with it, and so does the agent of another host. Knows nothing of either.

use std::{
    os::unix::process::ExitStatusExt,
    process::{ExitStatus, Stdio},
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos_time::lock::lock;

use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use serde::{Deserialize, Serialize};
use tokio::{
    io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, BufReader},
    process::{Child, ChildStdin, Command},
    sync::mpsc,
};

/// A longer line of a log is cut: a chassis that writes no line ends must not fill the memory of who
/// reads it, bytes.
pub(crate) const LINE_LIMIT: usize = 16 * 1024;

/// How long the last lines of a process may take to be read when it has ended.
pub(crate) const LAST_WORDS: Duration = Duration::from_secs(1);

/// How a process ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Ending {
    /// Completes "the chassis ...".
    pub(crate) how: String,
    /// Its exit code, if it ended by itself.
    pub(crate) code: Option<i32>,
    /// Whether a signal ended it: it did run, and may do so again.
    pub(crate) by_signal: bool,
}

impl Ending {
    /// One that nobody saw.
    pub(crate) fn unseen(how: impl Into<String>) -> Self {
        Self {
            how: how.into(),
            code: None,
            by_signal: false,
        }
    }

    fn of(status: std::io::Result<ExitStatus>) -> Self {
        match status {
            Ok(status) => Self {
                how: describe(&status),
                code: status.code(),
                by_signal: status.signal().is_some(),
            },
            Err(error) => Self::unseen(format!("ended, and nobody can tell how: {error}")),
        }
    }
}

/// A process that was started.
pub(crate) struct Spawned {
    pub(crate) pid: Option<u32>,
    signals: mpsc::UnboundedSender<Signal>,
    /// Its standard input, if it is piped: dropped to let it go.
    pub(crate) tether: Option<ChildStdin>,
}

impl Spawned {
    /// Sends it a signal. One that has ended needs none.
    pub(crate) fn signal(&self, signal: Signal) {
        let _ = self.signals.send(signal);
    }
}

/// Starts `command` in a process group of its own. Its standard input, if that is piped, ends when this process is gone or
/// lets go. `line` is told each line of its standard error and of
/// its standard output, `ended` how it ended, after its last line.
///
/// # Errors
/// What the system says.
pub(crate) fn spawn(
    mut command: Command,
    stdin: Stdio,
    line: impl FnMut(String) + Send + 'static,
    ended: impl FnOnce(Ending) + Send + 'static,
) -> std::io::Result<Spawned> {
    let mut child = command
        .stdin(stdin)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .process_group(0)
        .kill_on_drop(true)
        .spawn()?;
    let pid = child.id();
    let line = Arc::new(Mutex::new(line));
    let (stderr, stdout) = (child.stderr.take(), child.stdout.take());
    let logs = [
        stderr.map(|stderr| tokio::spawn(read(stderr, line.clone()))),
        stdout.map(|stdout| tokio::spawn(read(stdout, line))),
    ];
    let tether = child.stdin.take();
    let (signals, orders) = mpsc::unbounded_channel();
    tokio::spawn(async move {
        let status = wait(&mut child, orders).await;
        for log in logs.into_iter().flatten() {
            // A grandchild may hold the pipe open for ever.
            let _ = tokio::time::timeout(LAST_WORDS, log).await;
        }
        ended(Ending::of(status));
    });
    Ok(Spawned {
        pid,
        signals,
        tether,
    })
}

/// Waits for the end, and passes signals on until then.
async fn wait(
    child: &mut Child,
    mut orders: mpsc::UnboundedReceiver<Signal>,
) -> std::io::Result<ExitStatus> {
    loop {
        let signal = tokio::select! {
            status = child.wait() => return status,
            Some(signal) = orders.recv() => signal,
        };
        // Nobody has waited for the child (`waitpid`), so its number is still its own.
        let pid = child.id().and_then(|pid| i32::try_from(pid).ok());
        if let Some(pid) = pid.and_then(Pid::from_raw) {
            // It may have ended just now; the wait for it sees that.
            let _ = match signal {
                // What it has started itself goes with it.
                Signal::KILL => kill_process_group(pid, signal),
                signal => kill_process(pid, signal),
            };
        }
    }
}

/// Tells what a process writes to a stream, line by line.
async fn read(stream: impl AsyncRead + Unpin, line: Arc<Mutex<impl FnMut(String)>>) {
    let mut reader = BufReader::new(stream);
    let mut is_rest = false;
    loop {
        let mut part = Vec::new();
        let mut limited = (&mut reader).take(LINE_LIMIT as u64);
        if !matches!(limited.read_until(b'\n', &mut part).await, Ok(1..)) {
            return;
        }
        let is_whole = part.pop_if(|byte| *byte == b'\n').is_some();
        if !is_rest {
            lock(&line)(String::from_utf8_lossy(&part).into_owned());
        }
        // What is beyond the limit is not kept.
        is_rest = !is_whole;
    }
}

fn describe(status: &ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(9)) => "was killed by signal 9 (SIGKILL)".to_owned(),
        (None, Some(15)) => "was ended by signal 15 (SIGTERM)".to_owned(),
        (None, Some(11)) => "crashed with signal 11 (SIGSEGV)".to_owned(),
        (None, Some(6)) => "aborted with signal 6 (SIGABRT)".to_owned(),
        (None, Some(number)) => format!("was ended by signal {number}"),
        (None, None) => "ended".to_owned(),
    }
}
