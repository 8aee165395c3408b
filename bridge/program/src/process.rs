//! A program under way: its process and those that it starts, and its pipes.
//!
//! The pipe to it is written where the task is, without waiting; what the program does not read yet, a thread writes. The
//! pipe from it is read where the task is, when the reactor of the chassis says that there is something; in virtual time
//! by a thread.

use std::{
    collections::VecDeque,
    io::{BufRead, BufReader, Read},
    os::fd::{AsFd, BorrowedFd, OwnedFd},
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
use ctos::reactor::{Happened, Reactor, Seen, Source, Watched};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, PidfdFlags, Signal},
};
use serde::{Deserialize, Serialize};
use tokio::sync::{Notify, oneshot};

use crate::frames::Frames;

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
    /// Where its lines may have large bytes.
    pub(crate) frames: Option<Arc<Frames>>,
}

/// The events of one, where they are awaited by a task, or by the thread itself.
pub(crate) enum Events {
    Pipe(Listening),
    Thread(Receiver<Event>),
}

/// What a program writes, read by its task.
pub(crate) struct Listening {
    pipe: Arc<Pipe>,
    _watched: Watched,
    longest: usize,
    frames: Option<Arc<Frames>>,
    ending: Option<Ending>,
    ended: Option<oneshot::Receiver<Event>>,
}

/// The pipe from a program.
struct Pipe {
    output: OwnedFd,
    /// There may be something to be read.
    readable: Notify,
    lines: Mutex<Lines>,
}

impl Source for Pipe {
    fn serve(&self, _: Happened) -> Seen {
        self.readable.notify_one();
        Seen::Frames
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.output.as_fd()
    }
}

/// What was read and is no whole line yet.
#[derive(Default)]
struct Lines {
    bytes: Vec<u8>,
    /// So many of them have no end of a line.
    looked: usize,
    over: bool,
}

/// What a look at a pipe comes to.
enum Look {
    Line(String),
    Nothing,
    /// There are no more lines, because of what is wrong, if it is.
    Over(Option<String>),
}

impl Pipe {
    /// The next line, without waiting.
    fn look(&self, longest: usize) -> Look {
        let mut lines = lock(&self.lines);
        loop {
            let Lines {
                bytes,
                looked,
                over,
            } = &mut *lines;
            let fresh = bytes.get(*looked..).unwrap_or_default();
            let end = fresh.iter().position(|byte| *byte == b'\n');
            let end = end.map(|end| *looked + end + 1);
            *looked = bytes.len();
            let end = end.or((*over && !bytes.is_empty()).then_some(bytes.len()));
            if end.unwrap_or(bytes.len()) > longest {
                return Look::Over(Some(too_long(longest)));
            }
            if let Some(end) = end {
                let rest = bytes.split_off(end);
                let line = std::mem::replace(bytes, rest);
                *looked = 0;
                match line_of(line) {
                    Ok(None) => continue,
                    Ok(Some(line)) => return Look::Line(line),
                    Err(wrong) => return Look::Over(Some(wrong)),
                }
            }
            if *over {
                return Look::Over(None);
            }
            let mut chunk = [0; 1 << 14];
            match rustix::io::read(&self.output, &mut chunk) {
                Ok(read @ 1..) => bytes.extend_from_slice(chunk.get(..read).unwrap_or_default()),
                Err(rustix::io::Errno::AGAIN) => return Look::Nothing,
                Err(rustix::io::Errno::INTR) => {}
                Ok(_) | Err(_) => *over = true,
            }
        }
    }
}

impl Listening {
    pub(crate) async fn next(&mut self) -> Event {
        loop {
            if let Some(ended) = &mut self.ended {
                let event = ended.await;
                self.ended = None;
                return event.unwrap_or_else(|_| Event::Ended("its program is gone".to_owned()));
            }
            match self.pipe.look(self.longest) {
                Look::Nothing => self.pipe.readable.notified().await,
                Look::Over(wrong) => self.finish(wrong),
                Look::Line(line) => match resolved(self.frames.as_ref(), line) {
                    Ok(line) => return Event::Line(line),
                    Err(wrong) => self.finish(Some(wrong)),
                },
            }
        }
    }

    /// It writes no more: a thread waits for its end.
    fn finish(&mut self, wrong: Option<String>) {
        let (tell, told) = oneshot::channel();
        self.ended = Some(told);
        if let Some(ending) = self.ending.take() {
            // Without a thread nobody tells, and it counts as gone.
            let _ = thread("ending", move || {
                let _ = tell.send(ending.finish(wrong));
            });
        }
    }
}

fn resolved(frames: Option<&Arc<Frames>>, line: String) -> Result<String, String> {
    match frames {
        Some(frames) => frames.resolved(line),
        None => Ok(line),
    }
}

/// How a program ends.
struct Ending {
    child: Child,
    group: Arc<Group>,
    last: Last,
}

impl Ending {
    /// Waits for it, at once if something is wrong.
    fn finish(self, wrong: Option<String>) -> Event {
        let how = end(self.child, &self.group, wrong.is_some());
        let said = self.last.said();
        match wrong {
            Some(wrong) => Event::Wrong(format!("{wrong}{said}")),
            None => Event::Ended(format!("{how}{said}")),
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
    /// Starts it. With a reactor, a task awaits its events; otherwise a thread waits for them.
    ///
    /// # Errors
    /// Why it cannot be started.
    pub(crate) fn start(
        plan: &Plan<'_>,
        reactor: Option<Arc<Reactor>>,
    ) -> Result<(Self, Events), String> {
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
        let last = Last::follow(errors, plan)?;
        let whole = Arc::clone(&group);
        // What it has started may hold its pipes, and ends with it.
        thread(plan.task, move || {
            if ends(whole.id, None) {
                whole.kill();
            }
        })?;
        let ending = Ending { child, group, last };
        let events = match reactor {
            Some(reactor) => Events::Pipe(listen(output, ending, plan, &reactor)?),
            None => Events::Thread(follow(output, ending, plan)?),
        };
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

/// Has a task read what comes.
fn listen(
    output: ChildStdout,
    ending: Ending,
    plan: &Plan<'_>,
    reactor: &Arc<Reactor>,
) -> Result<Listening, String> {
    let output: OwnedFd = output.into();
    rustix::io::ioctl_fionbio(&output, true).map_err(|error| error.to_string())?;
    let pipe = Arc::new(Pipe {
        output,
        readable: Notify::new(),
        lines: Mutex::default(),
    });
    let watched = reactor.add(Arc::clone(&pipe) as Arc<dyn Source>);
    Ok(Listening {
        pipe,
        _watched: watched.map_err(|error| error.to_string())?,
        longest: plan.line,
        frames: plan.frames.clone(),
        ending: Some(ending),
        ended: None,
    })
}

/// Has a thread read what comes.
fn follow(output: ChildStdout, ending: Ending, plan: &Plan<'_>) -> Result<Receiver<Event>, String> {
    let (take, events) = crossbeam_channel::bounded(AHEAD);
    let (line, frames) = (plan.line, plan.frames.clone());
    thread(plan.task, move || {
        let wrong = read(output, line, frames.as_ref(), &take);
        // Nobody takes it who has gone.
        let _ = take.send(ending.finish(wrong));
    })?;
    Ok(events)
}

/// Reads lines until there are no more, or nobody takes them. What is wrong with the last one.
fn read(
    output: ChildStdout,
    longest: usize,
    frames: Option<&Arc<Frames>>,
    take: &Sender<Event>,
) -> Option<String> {
    let mut output = BufReader::new(output);
    loop {
        let mut line = Vec::new();
        let limit = u64::try_from(longest).unwrap_or(u64::MAX);
        let read = output.by_ref().take(limit + 1).read_until(b'\n', &mut line);
        let line = match read {
            Ok(0) | Err(_) => return None,
            Ok(_) if line.len() > longest => return Some(too_long(longest)),
            Ok(_) => line_of(line),
        };
        let line = match line.and_then(|line| line.map(|line| resolved(frames, line)).transpose()) {
            Ok(Some(line)) => line,
            Ok(None) => continue,
            Err(wrong) => return Some(wrong),
        };
        if take.send(Event::Line(line)).is_err() {
            return None;
        }
    }
}

fn too_long(longest: usize) -> String {
    let mib = longest >> 20;
    format!("its program wrote a line of more than {mib} MiB")
}

/// A line, if there is anything in it.
fn line_of(line: Vec<u8>) -> Result<Option<String>, String> {
    if line.iter().all(u8::is_ascii_whitespace) {
        return Ok(None);
    }
    String::from_utf8(line).map(Some).map_err(|error| {
        let line = error.into_bytes();
        let shown = String::from_utf8_lossy(line.get(..60).unwrap_or(&line)).into_owned();
        format!("its program wrote a line that is no UTF-8: {shown:?}")
    })
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
