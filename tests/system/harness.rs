//! Runs the program in a scratch folder under a watchdog, and watches its lines and its processes.
//!
//! Nothing here sleeps: a test waits for a line, for the end of a process, or for the watchdog. The
//! watchdog ends every process of the run and fails the test with all output.

use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead, BufReader, Read},
    os::{fd::OwnedFd, unix::process::CommandExt, unix::process::ExitStatusExt},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, Sender, channel},
    },
    thread,
    time::Duration,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open},
};
use serde_json::Value;

/// No run may take longer, whatever happens in it. `CTOS_RUN_LIMIT_S` gives those more that are about long waits.
fn limit() -> Duration {
    let given = std::env::var("CTOS_RUN_LIMIT_S").ok();
    let given = given.map(|text| {
        text.parse()
            .expect("CTOS_RUN_LIMIT_S is a number of seconds")
    });
    Duration::from_secs(given.unwrap_or(120))
}

/// A position in every corner of the work volume, to keep runs on the real clock short.
const SHORT_EVERY: usize = 6;

/// The program.
pub const CTOS: &str = env!("CARGO_BIN_EXE_ctos-under-test");

/// The inspector.
pub const SCOTT: &str = env!("CARGO_BIN_EXE_scott-under-test");

/// The program whose handlers misbehave.
pub const MISBEHAVING: &str = env!("CARGO_BIN_EXE_ctos-misbehaving");

/// The program of the tutorial.
pub const TUTORIAL: &str = env!("CARGO_BIN_EXE_ctos-tutorial");

/// What makes a run virtual.
pub const VIRTUAL: [&str; 2] = ["--set", "time.mode=\"virtual\""];

/// A folder of its own with a copy of `configs/`; gone with all its processes when dropped.
pub struct Scratch {
    folder: tempfile::TempDir,
}

impl Scratch {
    /// A fresh copy of the repository's `configs/`.
    pub fn new() -> Self {
        let scratch = Self::empty();
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        copy(&configs, &scratch.path("configs"));
        scratch
    }

    /// A fresh copy with few positions, still spread over the whole work volume.
    pub fn short() -> Self {
        let scratch = Self::new();
        let text = scratch.read("configs/positions.csv");
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let header = lines.next().unwrap();
        let kept: Vec<&str> = lines.step_by(SHORT_EVERY).collect();
        assert!(kept.len() >= 13, "too few positions for a short run");
        scratch.write(
            "configs/positions.csv",
            format!("{header}\n{}\n", kept.join("\n")),
        );
        scratch
    }

    /// A folder with nothing in it.
    pub fn empty() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    /// A path in the folder.
    pub fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// The text of a file.
    pub fn read(&self, file: &str) -> String {
        fs::read_to_string(self.path(file)).unwrap()
    }

    /// Writes a file.
    pub fn write(&self, file: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(file), content).unwrap();
    }

    /// Replaces the only place of `from` in a file.
    pub fn edit(&self, file: &str, from: &str, to: &str) {
        let text = self.read(file);
        assert_eq!(text.matches(from).count(), 1, "`{from}` in {file}");
        self.write(file, text.replace(from, to));
    }

    /// Line and column, from 1, of the only place of `text` in a file.
    pub fn place(&self, file: &str, text: &str) -> (usize, usize) {
        let content = self.read(file);
        let places: Vec<usize> = content.match_indices(text).map(|(at, _)| at).collect();
        let [at] = places[..] else {
            panic!("`{text}` stands {} times in {file}", places.len());
        };
        let before = &content[..at];
        let column = before.chars().rev().take_while(|letter| *letter != '\n');
        (before.matches('\n').count() + 1, column.count() + 1)
    }

    /// The files that the app has written, by name.
    pub fn results(&self) -> BTreeMap<String, String> {
        let Ok(folder) = fs::read_dir(self.path("out/calibrate")) else {
            return BTreeMap::new();
        };
        folder
            .map(|entry| {
                let path = entry.unwrap().path();
                let name = path.file_name().unwrap().to_str().unwrap().to_owned();
                (name, fs::read_to_string(path).unwrap())
            })
            .collect()
    }

    /// Every process that runs in this folder: those of an app, and nobody else's.
    pub fn processes(&self) -> Vec<Pid> {
        let folder = self.folder.path().canonicalize().unwrap();
        let all = fs::read_dir("/proc").unwrap();
        all.filter_map(|entry| {
            let entry = entry.ok()?;
            let pid = entry.file_name().to_str()?.parse().ok()?;
            let its_folder = fs::read_link(entry.path().join("cwd")).ok()?;
            (its_folder == folder).then(|| Pid::from_raw(pid)).flatten()
        })
        .collect()
    }

    /// Starts the program.
    pub fn start(
        &self,
        program: &str,
        arguments: &[&str],
        environment: &[(&str, &str)],
    ) -> Run<'_> {
        let mut command = Command::new(program);
        command
            .arg0("ctos")
            .args(arguments)
            .current_dir(self.folder.path())
            .env_remove("NO_COLOR")
            .env_remove("CLICOLOR_FORCE")
            .env_remove("RUST_LOG")
            .env_remove("NOTIFY_SOCKET")
            // Control sockets of this folder's apps, and nobody else's.
            .env("XDG_RUNTIME_DIR", self.folder.path())
            .envs(environment.iter().copied())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0);
        let mut child = command.spawn().unwrap();
        let (sender, lines) = channel();
        forward(child.stdout.take().unwrap(), Stream::Out, sender.clone());
        forward(child.stderr.take().unwrap(), Stream::Err, sender);
        let boot = Pid::from_child(&child);
        let watchdog = Watchdog::start(boot, self.folder.path());
        Run {
            scratch: self,
            command: format!("{} {}", program, arguments.join(" ")),
            child,
            boot,
            lines,
            stdout: String::new(),
            stderr: String::new(),
            chassis: BTreeMap::new(),
            watchdog,
        }
    }

    /// Runs `ctos` to its end.
    pub fn ctos(&self, arguments: &[&str]) -> Ended {
        self.start(CTOS, arguments, &[]).end()
    }

    /// Runs `scott` to its end.
    pub fn scott(&self, arguments: &[&str]) -> Ended {
        self.start(SCOTT, arguments, &[]).end()
    }

    /// Boots the copied app and waits for its end.
    pub fn boot(&self, arguments: &[&str]) -> Ended {
        self.start_boot(arguments).end()
    }

    /// Boots the copied app.
    pub fn start_boot(&self, arguments: &[&str]) -> Run<'_> {
        let all = [&["boot", "configs/calibrate.toml"], arguments].concat();
        self.start(CTOS, &all, &[])
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        kill_all(&self.processes());
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

fn kill_all(pids: &[Pid]) {
    for pid in pids {
        // It may have ended by itself just now.
        let _ = kill_process(*pid, Signal::KILL);
    }
}

enum Stream {
    Out,
    Err,
}

fn forward(pipe: impl Read + Send + 'static, stream: Stream, lines: Sender<(bool, String)>) {
    let is_out = matches!(stream, Stream::Out);
    thread::spawn(move || {
        let mut reader = BufReader::new(pipe);
        let mut bytes = Vec::new();
        while reader
            .read_until(b'\n', &mut bytes)
            .is_ok_and(|read| read > 0)
        {
            let line = String::from_utf8_lossy(&bytes).into_owned();
            bytes.clear();
            if lines.send((is_out, line)).is_err() {
                break;
            }
        }
    });
}

/// Ends a run that takes too long.
struct Watchdog {
    fired: Arc<AtomicBool>,
    /// Dropped when the run has ended in time.
    _ended: Sender<()>,
}

impl Watchdog {
    fn start(boot: Pid, folder: &Path) -> Self {
        let fired = Arc::new(AtomicBool::new(false));
        let (ended, wait) = channel::<()>();
        let (flag, folder) = (fired.clone(), folder.to_owned());
        thread::spawn(move || {
            let timed_out =
                wait.recv_timeout(limit()) == Err(std::sync::mpsc::RecvTimeoutError::Timeout);
            if timed_out && folder.exists() {
                flag.store(true, Ordering::SeqCst);
                // Its children end with it; what does not is ended with the scratch folder.
                kill_all(&[boot]);
            }
        });
        Self {
            fired,
            _ended: ended,
        }
    }
}

/// A chassis's process, held so that its number cannot pass to another one unnoticed.
pub struct ChassisProcess {
    pub pid: Pid,
    /// `None` when it had ended before it could be held.
    handle: Option<OwnedFd>,
}

impl ChassisProcess {
    /// Waits until the process has ended; `false` when it does not.
    pub fn ends(&self) -> bool {
        let limit = Timespec {
            tv_sec: 30,
            tv_nsec: 0,
        };
        let Some(handle) = &self.handle else {
            return true;
        };
        let mut handles = [PollFd::new(handle, PollFlags::IN)];
        poll(&mut handles, Some(&limit)).unwrap() == 1
    }
}

/// A program that runs.
pub struct Run<'a> {
    scratch: &'a Scratch,
    command: String,
    child: Child,
    boot: Pid,
    lines: Receiver<(bool, String)>,
    stdout: String,
    stderr: String,
    /// The processes of the chassis, by name, as far as they have been told.
    pub chassis: BTreeMap<String, ChassisProcess>,
    watchdog: Watchdog,
}

impl Run<'_> {
    fn next(&mut self) -> Option<String> {
        let (is_out, line) = self.lines.recv().ok()?;
        if is_out {
            self.stdout.push_str(&line);
        } else {
            self.stderr.push_str(&line);
            self.note_chassis(&line);
        }
        Some(line)
    }

    /// `chassis  ws1          pid 4711`
    fn note_chassis(&mut self, line: &str) {
        let words: Vec<&str> = line.split_whitespace().collect();
        if let ["chassis", name, "pid", number, ..] = words[..] {
            let pid = Pid::from_raw(number.parse().unwrap()).unwrap();
            let handle = pidfd_open(pid, PidfdFlags::empty()).ok();
            self.chassis
                .insert(name.to_owned(), ChassisProcess { pid, handle });
        }
    }

    fn told(&self) -> String {
        format!(
            "{}\n--- stdout\n{}--- stderr\n{}---",
            self.command, self.stdout, self.stderr
        )
    }

    /// Reads on until a line contains `text`.
    pub fn wait_for(&mut self, text: &str) {
        self.line_with(text);
    }

    /// Reads on until a line contains `text`: that line.
    pub fn line_with(&mut self, text: &str) -> String {
        while let Some(line) = self.next() {
            if line.contains(text) {
                return line;
            }
        }
        panic!(
            "the run ended, or was ended, without `{text}`: {}",
            self.told()
        );
    }

    /// Sends a signal to the program itself.
    pub fn signal(&self, signal: Signal) {
        kill_process(self.boot, signal).unwrap();
    }

    /// Kills one chassis.
    pub fn kill(&self, chassis: &str) {
        kill_process(self.chassis[chassis].pid, Signal::KILL).unwrap();
    }

    /// Makes one chassis hang.
    pub fn freeze(&self, chassis: &str) {
        kill_process(self.chassis[chassis].pid, Signal::STOP).unwrap();
    }

    /// Makes one that hangs go on.
    pub fn resume(&self, chassis: &str) {
        kill_process(self.chassis[chassis].pid, Signal::CONT).unwrap();
    }

    /// Leaves everything as it is for a while, but not beyond the end of the program.
    pub fn hold(&self, time: Duration) {
        let limit = Timespec::try_from(time).unwrap();
        let program = pidfd_open(self.boot, PidfdFlags::empty()).unwrap();
        poll(&mut [PollFd::new(&program, PollFlags::IN)], Some(&limit)).unwrap();
    }

    /// Waits for the end. The test fails when it took too long.
    pub fn end(mut self) -> Ended {
        while self.next().is_some() {}
        let status = self.child.wait().unwrap();
        let told = self.told();
        assert!(
            !self.watchdog.fired.load(Ordering::SeqCst),
            "still running after {:?}: {told}",
            limit()
        );
        Ended {
            code: status.code(),
            signal: status.signal(),
            left: self.scratch.processes(),
            chassis: self.chassis,
            stdout: self.stdout,
            stderr: self.stderr,
            told,
        }
    }
}

/// A program that has ended.
pub struct Ended {
    pub code: Option<i32>,
    pub signal: Option<i32>,
    /// Processes of the run that were left when the program had ended.
    pub left: Vec<Pid>,
    pub chassis: BTreeMap<String, ChassisProcess>,
    pub stdout: String,
    pub stderr: String,
    /// All of it, for the message of a failed test.
    pub told: String,
}

impl Ended {
    /// The exit code must be `code`, and no process be left.
    #[track_caller]
    pub fn must_exit(&self, code: i32) -> &Self {
        assert_eq!(self.code, Some(code), "exit code: {}", self.told);
        assert!(self.left.is_empty(), "left: {:?}: {}", self.left, self.told);
        self
    }

    /// The exit code must be `code`, while others of this folder run on.
    #[track_caller]
    pub fn must_exit_leaving(&self, code: i32) -> &Self {
        assert_eq!(self.code, Some(code), "exit code: {}", self.told);
        self
    }

    /// Standard error must hold `text`.
    #[track_caller]
    pub fn must_say(&self, text: &str) -> &Self {
        assert!(self.stderr.contains(text), "no `{text}`: {}", self.told);
        self
    }

    /// Standard error must hold `first` and, after it, `second`.
    #[track_caller]
    pub fn must_say_before(&self, first: &str, second: &str) -> &Self {
        let at = |text| self.stderr.find(text);
        let in_order = matches!((at(first), at(second)), (Some(a), Some(b)) if a < b);
        assert!(in_order, "no `{first}` before `{second}`: {}", self.told);
        self
    }

    /// Standard error must not hold `text`.
    #[track_caller]
    pub fn must_not_say(&self, text: &str) -> &Self {
        assert!(!self.stderr.contains(text), "`{text}`: {}", self.told);
        self
    }

    /// The line of the error that the run ended with.
    #[track_caller]
    pub fn error(&self) -> &str {
        let at = self.stderr.find("error: ");
        &self.stderr[at.unwrap_or_else(|| panic!("no error: {}", self.told))..]
    }

    /// The last line of standard output as JSON.
    #[track_caller]
    pub fn json(&self) -> Value {
        let line = self.stdout.lines().last().unwrap_or_default();
        serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {}", self.told))
    }

    /// Every line of standard output as JSON.
    #[track_caller]
    pub fn json_lines(&self) -> Vec<Value> {
        let lines = self.stdout.lines();
        lines
            .map(|line| {
                serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {}", self.told))
            })
            .collect()
    }
}
