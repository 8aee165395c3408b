//! CTOS as a contender in a process of its own, as a boot starts a chassis.

use std::{
    io::{BufRead, BufReader, Write},
    process::{Child, Command, Stdio},
    sync::atomic::{AtomicU32, Ordering},
};

use crate::{contenders::Pair, ctos_side::Ctos};

/// The first argument of such a process; the others are the tables of its processors.
pub const BOOTED: &str = "as-booted";

/// The process that is there now; 0 when none is.
static PROCESS: AtomicU32 = AtomicU32::new(0);

/// Makes the calls that it is told to, each number of them by a line, which it gives back.
pub fn serve(processors: &[String]) {
    let processors: Vec<&str> = processors.iter().map(String::as_str).collect();
    let mut ctos = Ctos::new(&processors);
    for line in std::io::stdin().lines() {
        let line = line.expect("a line");
        ctos.calls(line.parse().expect("a number of calls"));
        println!("{line}");
    }
}

/// The process, seen from the one that measures it.
pub struct Booted {
    process: Child,
    answers: BufReader<std::process::ChildStdout>,
}

impl Booted {
    pub fn start(processors: &[&str]) -> Self {
        let program = std::env::current_exe().expect("this program");
        let mut process = Command::new(program)
            .arg(BOOTED)
            .args(processors)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a process");
        let answers = BufReader::new(process.stdout.take().expect("a pipe"));
        PROCESS.store(process.id(), Ordering::Relaxed);
        Self { process, answers }
    }
}

impl Pair for Booted {
    fn calls(&mut self, count: u32) {
        let told = self.process.stdin.as_mut().expect("a pipe");
        writeln!(told, "{count}").expect("it reads");
        let mut answer = String::new();
        self.answers.read_line(&mut answer).expect("it answers");
        assert_eq!(answer.trim(), count.to_string());
    }
}

impl Drop for Booted {
    fn drop(&mut self) {
        PROCESS.store(0, Ordering::Relaxed);
        drop(self.process.stdin.take());
        self.process.wait().expect("it ends with its input");
    }
}

/// Processor time of all threads of that process.
pub fn cpu_ns() -> f64 {
    let process = PROCESS.load(Ordering::Relaxed);
    let threads = std::fs::read_dir(format!("/proc/{process}/task"));
    let used = threads
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|thread| {
            let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
            text.split_whitespace().next()?.parse::<f64>().ok()
        });
    used.sum()
}
