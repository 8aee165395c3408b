//! A program under way: its process and those that it starts, and the threads that read and write its pipes.
//!
//! The pipe to it is written where the task is, without waiting; what the program does not read yet, a thread writes.

use std::{
    collections::VecDeque,
    io::{BufRead, BufReader, Read},
    os::fd::{AsFd, OwnedFd},
    os::unix::process::{CommandExt, ExitStatusExt},
    path::Path,
    process::{Child, ChildStderr, ChildStdout, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use crossbeam_channel::{Receiver, Sender};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, PidfdFlags, Signal},
};
use serde::{Deserialize, Serialize};

/// So many lines are read ahead; after that the program waits.
const AHEAD: usize = 256;
/// So much may wait to be read by the program, bytes.
const MOST_UNREAD: usize = 256 << 20;
/// How many of its last lines of standard error are kept, and how long each may be.
const LAST_LINES: usize = 12;
const LINE: u64 = 400;
/// Of a program's standard error, so many lines are logged.
const MOST_LOGGED: usize = 1000;
/// A program that closes its output is ending; it may take so long.
const ENDS_WITHIN: Duration = Duration::from_millis(500);

/// What comes of a program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Event {
    /// A line that it wrote.
    Line(String),
    /// It has ended: how, and its last words.
    Ended(String),
    /// It wrote what is no line.
    Wrong(String),
}

/// How to start one.
pub(crate) struct Plan<'a> {
    pub(crate) task: &'a str,
    pub(crate) command: &'a [String],
    pub(crate) folder: &'a Path,
    pub(crate) environment: Vec<(String, String)>,
    /// The longest line, bytes.
    pub(crate) line: usize,
    /// Whether its standard error is logged as it comes.
    pub(crate) logs: bool,
}

/// The events of one, where they are awaited by a task, or by the thread itself.
pub(crate) enum Events {
    Task(tokio::sync::mpsc::Receiver<Event>),
    Thread(Receiver<Event>),
}

enum Take {
    Task(tokio::sync::mpsc::Sender<Event>),
    Thread(Sender<Event>),
}

impl Take {
    /// Whether anybody still takes it.
    fn put(&self, event: Event) -> bool {
        match self {
            Self::Task(to) => to.blocking_send(event).is_ok(),
            Self::Thread(to) => to.send(event).is_ok(),
        }
    }
}

/// A program under way. Dropped, it is killed with all that it started.
pub(crate) struct Program {
    input: Mutex<Option<Input>>,
    group: Arc<Group>,
}

/// The pipe to it.
struct Input {
    pipe: Arc<OwnedFd>,
    /// What a thread is writing, bytes.
    left: Arc<AtomicUsize>,
    rest: Sender<Vec<u8>>,
}

/// Its processes.
struct Group {
    id: Pid,
    /// Whether its number may belong to others by now.
    reaped: Mutex<bool>,
}

impl Group {
    fn kill(&self) {
        let reaped = lock(&self.reaped);
        if !*reaped {
            // Gone already: then there is nothing to do.
            let _ = rustix::process::kill_process_group(self.id, Signal::KILL);
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Program {
    /// Starts it. `real`: a task awaits its events, and does not wait for them itself.
    ///
    /// # Errors
    /// Why it cannot be started.
    pub(crate) fn start(plan: &Plan<'_>, real: bool) -> Result<(Self, Events), String> {
        let [program, arguments @ ..] = plan.command else {
            return Err("no program is named".to_owned());
        };
        let mut child = Command::new(program)
            .args(arguments)
            .current_dir(plan.folder)
            .envs(plan.environment.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // What it starts is ended with it.
            .process_group(0)
            .spawn()
            .map_err(|error| format!("`{program}` cannot be started: {error}"))?;
        let no_pipe = || format!("`{program}` has no pipes");
        let id = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
        let group = Arc::new(Group {
            id: id.ok_or_else(no_pipe)?,
            reaped: Mutex::new(false),
        });
        let (Some(input), Some(output), Some(errors)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(no_pipe());
        };
        let own = Self {
            input: Mutex::new(None),
            group: Arc::clone(&group),
        };
        let input = Input::new(input.into(), plan.task)?;
        *lock(&own.input) = Some(input);
        let (take, events) = match real {
            true => {
                let (take, events) = tokio::sync::mpsc::channel(AHEAD);
                (Take::Task(take), Events::Task(events))
            }
            false => {
                let (take, events) = crossbeam_channel::bounded(AHEAD);
                (Take::Thread(take), Events::Thread(events))
            }
        };
        let last = Last::follow(errors, plan)?;
        let whole = Arc::clone(&group);
        // What it has started may hold its pipes, and ends with it.
        thread(plan.task, move || {
            if ends(whole.id, None) {
                whole.kill();
            }
        })?;
        let line = plan.line;
        thread(plan.task, move || {
            let wrong = read(output, line, &take);
            let how = end(child, &group, wrong.is_some());
            let said = last.said();
            take.put(match wrong {
                Some(wrong) => Event::Wrong(format!("{wrong}{said}")),
                None => Event::Ended(format!("{how}{said}")),
            });
        })?;
        Ok((own, events))
    }

    /// Writes a line, without waiting for the program to read it.
    ///
    /// # Errors
    /// It has not read for too long. (Of its end there is an event.)
    pub(crate) fn write(&self, line: Vec<u8>) -> Result<(), String> {
        lock(&self.input)
            .as_ref()
            .map_or(Ok(()), |input| input.write(line))
    }

    /// The number of its process.
    pub(crate) fn id(&self) -> i32 {
        self.group.id.as_raw_nonzero().get()
    }

    /// Nothing more is written; it sees the end of its input.
    pub(crate) fn close(&self) {
        lock(&self.input).take();
    }

    /// Ends it, and all that it started, at once.
    pub(crate) fn kill(&self) {
        self.group.kill();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.kill();
    }
}

impl Input {
    fn new(pipe: OwnedFd, task: &str) -> Result<Self, String> {
        rustix::io::ioctl_fionbio(&pipe, true).map_err(|error| error.to_string())?;
        let pipe = Arc::new(pipe);
        let left = Arc::new(AtomicUsize::new(0));
        let (rest, rests) = crossbeam_channel::unbounded::<Vec<u8>>();
        let (own, pending) = (Arc::clone(&pipe), Arc::clone(&left));
        thread(task, move || {
            for bytes in rests {
                write_all(&own, &bytes);
                pending.fetch_sub(bytes.len(), Ordering::AcqRel);
            }
        })?;
        Ok(Self { pipe, left, rest })
    }

    fn write(&self, mut line: Vec<u8>) -> Result<(), String> {
        let left = self.left.load(Ordering::Acquire);
        if left == 0 {
            match rustix::io::write(&self.pipe, &line) {
                Ok(written) if written == line.len() => return Ok(()),
                Ok(written) => drop(line.drain(..written)),
                Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => {}
                Err(_) => return Ok(()),
            }
        }
        if left + line.len() > MOST_UNREAD {
            return Err(format!(
                "its program does not read: {left} bytes wait for it"
            ));
        }
        self.left.fetch_add(line.len(), Ordering::AcqRel);
        // The thread ends after this.
        let _ = self.rest.send(line);
        Ok(())
    }
}

/// Waits wherever the pipe is full. A program that has gone takes nothing.
fn write_all(pipe: &OwnedFd, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        match rustix::io::write(pipe, bytes) {
            Ok(written) => bytes = bytes.get(written..).unwrap_or_default(),
            Err(rustix::io::Errno::AGAIN) => {
                let mut there = [PollFd::new(pipe, PollFlags::OUT)];
                if !matches!(poll(&mut there, None), Ok(_) | Err(rustix::io::Errno::INTR)) {
                    return;
                }
            }
            Err(rustix::io::Errno::INTR) => {}
            Err(_) => return,
        }
    }
}

fn thread(task: &str, work: impl FnOnce() + Send + 'static) -> Result<(), String> {
    let name: String = task.chars().take(15).collect();
    let thread = std::thread::Builder::new().name(name).spawn(work);
    thread
        .map(drop)
        .map_err(|error| format!("there is no thread: {error}"))
}

/// Reads lines until there are no more, or nobody takes them. What is wrong with the last one.
fn read(output: ChildStdout, longest: usize, take: &Take) -> Option<String> {
    let mut output = BufReader::new(output);
    loop {
        let mut line = Vec::new();
        let limit = u64::try_from(longest).unwrap_or(u64::MAX);
        let read = output.by_ref().take(limit + 1).read_until(b'\n', &mut line);
        match read {
            Ok(0) | Err(_) => return None,
            Ok(_) if line.len() > longest => {
                let mib = longest >> 20;
                return Some(format!("its program wrote a line of more than {mib} MiB"));
            }
            Ok(_) => {}
        }
        if line.iter().all(u8::is_ascii_whitespace) {
            continue;
        }
        let event = match String::from_utf8(line) {
            Ok(line) => Event::Line(line),
            Err(error) => {
                let line = error.into_bytes();
                let shown = String::from_utf8_lossy(line.get(..60).unwrap_or(&line)).into_owned();
                return Some(format!(
                    "its program wrote a line that is no UTF-8: {shown:?}"
                ));
            }
        };
        if !take.put(event) {
            return None;
        }
    }
}

/// Waits for its end, and ends all that it started. How it ended.
fn end(mut child: Child, group: &Group, at_once: bool) -> String {
    let ended = !at_once && ends(group.id, Some(ENDS_WITHIN));
    let mut reaped = lock(&group.reaped);
    // Its number is its own until it is waited for.
    let _ = rustix::process::kill_process_group(group.id, Signal::KILL);
    let status = child.wait();
    *reaped = true;
    let status = status.map_or_else(|error| error.to_string(), |status| ending(&status));
    match ended {
        true => format!("its program {status}"),
        false => "its program closed its output, and was killed".to_owned(),
    }
}

/// Whether it ends in time, if there is one.
fn ends(id: Pid, within: Option<Duration>) -> bool {
    let Ok(process) = rustix::process::pidfd_open(id, PidfdFlags::empty()) else {
        return true;
    };
    let mut there = [PollFd::from_borrowed_fd(process.as_fd(), PollFlags::IN)];
    let time = within.and_then(|time| Timespec::try_from(time).ok());
    poll(&mut there, time.as_ref()).is_ok_and(|count| count > 0)
}

fn ending(status: &ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (_, Some(signal)) => format!("was ended by signal {signal}"),
        _ => "ended".to_owned(),
    }
}

/// The last lines of its standard error.
struct Last {
    lines: Arc<Mutex<VecDeque<String>>>,
    ended: Receiver<()>,
}

impl Last {
    fn follow(errors: ChildStderr, plan: &Plan<'_>) -> Result<Self, String> {
        let lines = Arc::new(Mutex::new(VecDeque::new()));
        let (ends, ended) = crossbeam_channel::bounded(1);
        let (kept, task, logs) = (Arc::clone(&lines), plan.task.to_owned(), plan.logs);
        thread(plan.task, move || {
            let _ends: Sender<()> = ends;
            let mut errors = BufReader::new(errors);
            let mut count = 0_usize;
            loop {
                let mut line = Vec::new();
                match errors.by_ref().take(LINE).read_until(b'\n', &mut line) {
                    Ok(0) | Err(_) => return,
                    Ok(_) => {}
                }
                let line = String::from_utf8_lossy(&line).trim_end().to_owned();
                count += 1;
                match count {
                    ..MOST_LOGGED if logs => tracing::info!(task, "{line}"),
                    MOST_LOGGED if logs => {
                        tracing::info!(task, "it says more, which is not logged")
                    }
                    _ => tracing::trace!(task, "{line}"),
                }
                let mut kept = lock(&kept);
                kept.push_back(line);
                if kept.len() > LAST_LINES {
                    kept.pop_front();
                }
            }
        })?;
        Ok(Self { lines, ended })
    }

    /// The last lines, in words for an error.
    fn said(self) -> String {
        // All who could write there are gone.
        let _ = self.ended.recv_timeout(ENDS_WITHIN);
        let lines: Vec<String> = lock(&self.lines).iter().cloned().collect();
        match lines.is_empty() {
            true => String::new(),
            false => format!("; its last words: {}", lines.join("\n")),
        }
    }
}
