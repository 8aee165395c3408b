//! The processes of an app, as the one that boots sees them: started, watched, ended.

use std::{
    collections::{BTreeMap, VecDeque},
    process::{ExitStatus, Stdio},
    sync::{Arc, Mutex},
    time::Duration,
};

use rustix::process::{Pid, Signal, kill_process};
use tokio::{
    io::{AsyncBufReadExt, BufReader},
    process::{Child, ChildStderr, Command},
    sync::{Notify, mpsc, watch},
};

use crate::{
    boot::{
        BootError, BootEvent, End, INCARNATION_VARIABLE, Launcher, Observer, TOKEN_VARIABLE,
        mesh::FLUSH_LIMIT,
    },
    bootstrap::Processes,
    call::lock,
    chassis::Chassis,
    control::LogStore,
    link::{handshake::Token, transport::Address},
    system,
};

/// How many of its last lines are kept of a chassis's log, for the error that its end causes.
const LAST_LINES: usize = 5;

/// A longer line of a log is cut: a chassis that writes no line ends must not fill the memory of the
/// boot, bytes.
const LINE_LIMIT: usize = 16 * 1024;

/// How a process ended.
#[derive(Debug, Clone)]
pub(super) struct Ending {
    /// Completes "the chassis ...".
    pub(super) how: String,
    pub(super) code: Option<i32>,
}

impl Ending {
    fn of(status: std::io::Result<ExitStatus>) -> Self {
        match status {
            Ok(status) => Self {
                how: describe(&status),
                code: status.code(),
            },
            Err(error) => Self {
                how: format!("ended, and nobody can tell how: {error}"),
                code: None,
            },
        }
    }
}

/// A chassis's process.
pub(super) struct Process {
    pub(super) name: String,
    incarnation: u32,
    pid: Option<u32>,
    pub(super) last_lines: Arc<Mutex<VecDeque<String>>>,
    kill: Arc<Notify>,
    ended: watch::Receiver<Option<Ending>>,
}

impl Process {
    /// Waits until it has ended and its last words are known.
    pub(super) async fn ended(&mut self) -> Ending {
        let gone = || Ending {
            how: "ended unseen".to_owned(),
            code: None,
        };
        // Whoever watches it goes only when the boot does.
        let ended = self.ended.wait_for(Option::is_some).await;
        ended.map_or_else(|_| gone(), |ending| ending.clone().unwrap_or_else(gone))
    }

    /// Ends it at once.
    pub(super) fn kill(&self) {
        self.kill.notify_one();
    }

    fn signal(&self, signal: Signal) {
        let pid = self.pid.and_then(|pid| i32::try_from(pid).ok());
        if let Some(pid) = pid.and_then(Pid::from_raw)
            && self.ended.borrow().is_none()
        {
            // It may have ended just now; whoever waits for it sees that.
            let _ = kill_process(pid, signal);
        }
    }
}

/// How processes are started, and who hears of them.
pub(super) struct Starter {
    pub(super) chassis: Arc<Chassis>,
    pub(super) launcher: Launcher,
    pub(super) observer: Observer,
    pub(super) boot: Address,
    pub(super) token: Token,
    pub(super) logs: Arc<LogStore>,
}

impl Starter {
    /// Starts the process of chassis `index`; its log is shown line by line.
    pub(super) fn start(&self, index: u8, incarnation: u32) -> Result<Process, BootError> {
        let name = self.chassis.name_of(index).to_owned();
        let origin = self.chassis.clock.origin_ns().unwrap_or(0);
        let mut child = Command::new(&self.launcher.program)
            .args(&self.launcher.arguments)
            .args(["--chassis", &name, "--boot", &self.boot.to_string()])
            .args(["--origin", &origin.to_string()])
            .env(TOKEN_VARIABLE, &self.token.0)
            .env(INCARNATION_VARIABLE, incarnation.to_string())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .map_err(super::io_error(format!("cannot start chassis `{name}`")))?;
        let pid = child.id();
        self.logs.begin(&name, incarnation, pid);
        (self.observer)(&BootEvent::Started {
            chassis: name.clone(),
            pid,
        });
        let last_lines = Arc::new(Mutex::new(VecDeque::new()));
        let log = child.stderr.take().map(|stderr| {
            let log = Log {
                chassis: name.clone(),
                incarnation,
                last_lines: last_lines.clone(),
                observer: self.observer.clone(),
                logs: self.logs.clone(),
            };
            tokio::spawn(log.read(stderr))
        });
        let kill = Arc::new(Notify::new());
        let (ending, ended) = watch::channel(None);
        let order = kill.clone();
        let chassis = self.chassis.clone();
        tokio::spawn(async move {
            let status = wait(&mut child, &order).await;
            if let Some(log) = log {
                // A grandchild may hold the pipe open for ever.
                let _ = tokio::time::timeout(FLUSH_LIMIT, log).await;
            }
            let end = Ending::of(status);
            // The service is told of the end of every process; of that of the app it has no use.
            chassis.post_system(
                system::BOOTSTRAP,
                system::ProcessEnded {
                    chassis: index,
                    incarnation,
                    how: end.how.clone(),
                    code: end.code,
                },
            );
            // Nobody may be left to see it.
            let _ = ending.send(Some(end));
        });
        Ok(Process {
            name,
            incarnation,
            pid,
            last_lines,
            kill,
            ended,
        })
    }
}

async fn wait(child: &mut Child, kill: &Notify) -> std::io::Result<ExitStatus> {
    tokio::select! {
        status = child.wait() => return status,
        () = kill.notified() => {}
    }
    // An error says that it has ended already.
    let _ = child.start_kill();
    child.wait().await
}

/// What a process writes to its standard error.
struct Log {
    chassis: String,
    incarnation: u32,
    last_lines: Arc<Mutex<VecDeque<String>>>,
    observer: Observer,
    logs: Arc<LogStore>,
}

impl Log {
    async fn read(self, stderr: ChildStderr) {
        let mut reader = BufReader::new(stderr);
        let mut bytes = Vec::new();
        loop {
            let room = LINE_LIMIT.saturating_sub(bytes.len());
            let whole = match next_part(&mut reader, &mut bytes, room).await {
                Ok(Some(whole)) => whole,
                Ok(None) | Err(_) => {
                    if !bytes.is_empty() {
                        self.line(&bytes);
                    }
                    return;
                }
            };
            if whole {
                self.line(&bytes);
                bytes.clear();
            }
        }
    }

    fn line(&self, bytes: &[u8]) {
        let line = String::from_utf8_lossy(bytes).into_owned();
        {
            let mut kept = lock(&self.last_lines);
            if kept.len() == LAST_LINES {
                kept.pop_front();
            }
            kept.push_back(line.clone());
        }
        self.logs.add(&self.chassis, self.incarnation, &line);
        let chassis = self.chassis.clone();
        (self.observer)(&BootEvent::Log { chassis, line });
    }
}

/// Adds at most `room` bytes of the line to `bytes` and skips what is beyond. Whether the line is whole;
/// `None` at the end.
async fn next_part(
    reader: &mut BufReader<ChildStderr>,
    bytes: &mut Vec<u8>,
    room: usize,
) -> std::io::Result<Option<bool>> {
    let buffer = reader.fill_buf().await?;
    if buffer.is_empty() {
        return Ok(None);
    }
    let end = buffer.iter().position(|byte| *byte == b'\n');
    let part = end.map_or(buffer, |end| buffer.get(..end).unwrap_or(buffer));
    bytes.extend(part.iter().take(room));
    let used = end.map_or(buffer.len(), |end| end + 1);
    reader.consume(used);
    Ok(Some(end.is_some()))
}

enum Order {
    Start(u8, u32),
    Kill(u8),
}

/// Takes the orders of the bootstrap service, which runs on another thread.
pub(super) struct Orders(mpsc::UnboundedSender<Order>);

impl Processes for Orders {
    fn start(&self, index: u8, incarnation: u32) {
        // The receiver lives until the service has ended.
        let _ = self.0.send(Order::Start(index, incarnation));
    }

    fn kill(&self, index: u8) {
        let _ = self.0.send(Order::Kill(index));
    }
}

/// The processes of an app that is up, by chassis.
pub(super) struct Keeper {
    starter: Starter,
    orders: mpsc::UnboundedReceiver<Order>,
    processes: BTreeMap<u8, Process>,
}

impl Keeper {
    /// Keeps `processes`, which are those of chassis 1, 2, ...
    pub(super) fn new(starter: Starter, processes: Vec<Process>) -> (Self, Arc<Orders>) {
        let (sender, orders) = mpsc::unbounded_channel();
        let keeper = Self {
            starter,
            orders,
            processes: (1..).zip(processes).collect(),
        };
        (keeper, Arc::new(Orders(sender)))
    }

    /// Carries out orders until a process was started: that of which chassis, and which incarnation.
    pub(super) async fn serve(&mut self) -> (u8, u32) {
        loop {
            match self.orders.recv().await {
                Some(Order::Start(index, incarnation)) => {
                    self.start(index, incarnation);
                    return (index, incarnation);
                }
                Some(Order::Kill(index)) => {
                    if let Some(process) = self.processes.get(&index) {
                        process.kill();
                    }
                }
                None => std::future::pending().await,
            }
        }
    }

    fn start(&mut self, index: u8, incarnation: u32) {
        match self.starter.start(index, incarnation) {
            Ok(process) => {
                self.processes.insert(index, process);
            }
            Err(error) => {
                let how = format!("could not be started again: {error}");
                let chassis = &self.starter.chassis;
                let ended = system::ProcessEnded {
                    chassis: index,
                    incarnation,
                    how,
                    code: None,
                };
                chassis.post_system(system::BOOTSTRAP, ended);
            }
        }
    }

    /// Waits for all processes: those that do not end by themselves get SIGTERM, then SIGKILL.
    /// Names those that ended otherwise than they should have.
    pub(super) async fn end(self, limit: Duration, end: &End) -> Vec<(String, String)> {
        let expected = i32::from(!matches!(end, End::Finished(result) if result.ok));
        let mut casualties = Vec::new();
        for mut process in self.processes.into_values() {
            let mut ended = tokio::time::timeout(limit, process.ended()).await;
            for (number, name) in [(Signal::TERM, "SIGTERM"), (Signal::KILL, "SIGKILL")] {
                if ended.is_ok() {
                    break;
                }
                (self.starter.observer)(&BootEvent::Signalled {
                    chassis: process.name.clone(),
                    signal: name.to_owned(),
                });
                process.signal(number);
                ended = tokio::time::timeout(limit, process.ended()).await;
            }
            match ended {
                Ok(ending) if ending.code == Some(expected) => {}
                Ok(ending) => casualties.push((process.name, ending.how)),
                Err(_) => casualties.push((process.name, "could not be ended".to_owned())),
            }
        }
        casualties
    }
}

impl std::fmt::Debug for Process {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Process(`{}` {})", self.name, self.incarnation)
    }
}

fn describe(status: &ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
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
