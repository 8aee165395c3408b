//! The last lines of every chassis's log, kept by the boot for tools.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Mutex,
};

use serde::{Deserialize, Serialize};
use tokio::sync::broadcast;

use super::protocol::ProcessLog;
use ctos_time::{Clock, lock::lock};

/// How many lines are kept of one process.
const LINES: usize = 1000;
/// How many earlier processes of a chassis are remembered besides the present one.
const EARLIER: usize = 3;
/// How many of its last lines the status of a chassis shows of each process.
const LAST_LINES: usize = 10;
/// How many of them the error has that the end of a process causes.
const LAST_WORDS: usize = 5;
/// How many new lines a slow reader may be behind before it loses some, and learns so.
const BEHIND: usize = 4096;

/// How much a line matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Everything.
    Trace,
    /// What the runtime does.
    Debug,
    /// Events of the app.
    Info,
    /// What somebody should know.
    Warn,
    /// What went wrong.
    Error,
}

impl Level {
    /// The level that a line bears, as `tracing` writes it; a line without one matters as information.
    #[must_use]
    pub fn of(line: &str) -> Self {
        let named = if line.starts_with('{') {
            let object: Option<serde_json::Value> = serde_json::from_str(line).ok();
            object.and_then(|object| Self::named(object.get("level")?.as_str()?))
        } else {
            line.split_whitespace().take(3).find_map(Self::named)
        };
        named.unwrap_or(Self::Info)
    }

    fn named(word: &str) -> Option<Self> {
        match word {
            "TRACE" => Some(Self::Trace),
            "DEBUG" => Some(Self::Debug),
            "INFO" => Some(Self::Info),
            "WARN" => Some(Self::Warn),
            "ERROR" | "error:" => Some(Self::Error),
            _ => None,
        }
    }
}

/// A line of a log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LogLine {
    /// The chassis.
    pub chassis: String,
    /// Which of its processes, counted from 1.
    pub incarnation: u32,
    /// When it was read, s since the app was started.
    pub at_s: f64,
    /// How much it matters.
    pub level: Level,
    /// What it says.
    pub text: String,
}

impl LogLine {
    /// Whether the line is about task `name`: says so in a field, or names it.
    #[must_use]
    pub fn is_about(&self, name: &str) -> bool {
        let mut words = self.text.split_whitespace();
        self.is_of(name)
            || words.any(|word| word.trim_matches(|letter| "`,:;.()".contains(letter)) == name)
    }

    /// Whether the line says in a field that it is about task `name`; a net is the task that runs it.
    #[must_use]
    pub fn is_of(&self, name: &str) -> bool {
        ["task", "net"].iter().any(|field| {
            let plain = [format!("{field}={name}"), format!("{field}=\"{name}\"")];
            let mut words = self.text.split_whitespace();
            self.text.contains(&format!("\"{field}\":\"{name}\""))
                || words.any(|word| plain.iter().any(|plain| word == plain))
        })
    }
}

/// The logs of an app.
#[derive(Debug)]
pub(crate) struct LogStore {
    clock: Clock,
    chassis: Mutex<BTreeMap<String, VecDeque<ProcessLog>>>,
    new: broadcast::Sender<LogLine>,
}

impl LogStore {
    pub(crate) fn new(clock: Clock) -> Self {
        Self {
            clock,
            chassis: Mutex::default(),
            new: broadcast::channel(BEHIND).0,
        }
    }

    /// A process of a chassis has started.
    pub(crate) fn begin(&self, chassis: &str, incarnation: u32, pid: Option<u32>) {
        let mut all = lock(&self.chassis);
        let processes = all.entry(chassis.to_owned()).or_default();
        if processes.len() > EARLIER {
            processes.pop_front();
        }
        processes.push_back(ProcessLog {
            incarnation,
            pid,
            lines: VecDeque::new(),
        });
    }

    /// A process has written a line.
    pub(crate) fn add(&self, chassis: &str, incarnation: u32, text: &str) {
        let line = LogLine {
            chassis: chassis.to_owned(),
            incarnation,
            at_s: self.clock.now().since_start().as_secs_f64(),
            level: Level::of(text),
            text: text.to_owned(),
        };
        {
            let mut all = lock(&self.chassis);
            let mut processes = all.get_mut(chassis).into_iter().flatten();
            if let Some(process) = processes.find(|one| one.incarnation == incarnation) {
                if process.lines.len() == LINES {
                    process.lines.pop_front();
                }
                process.lines.push_back(line.clone());
            }
        }
        // Nobody may be listening.
        let _ = self.new.send(line);
    }

    /// What is kept, oldest first, and all that follows. A line may be in both.
    pub(crate) fn follow(&self) -> (Vec<LogLine>, broadcast::Receiver<LogLine>) {
        let new = self.new.subscribe();
        (self.lines(), new)
    }

    /// What is kept, oldest first.
    pub(crate) fn lines(&self) -> Vec<LogLine> {
        let all = lock(&self.chassis);
        let processes = all.values().flatten();
        let mut lines: Vec<LogLine> = processes
            .flat_map(|process| process.lines.iter().cloned())
            .collect();
        drop(all);
        lines.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
        lines
    }

    /// The last lines of a chassis's processes, the present one last; of that one those about `task`, if one is
    /// named.
    pub(crate) fn processes(&self, chassis: &str, task: Option<&str>) -> Vec<ProcessLog> {
        let all = lock(&self.chassis);
        let processes = all.get(chassis);
        let present = processes.and_then(|processes| Some(processes.back()?.incarnation));
        let log = |process: &ProcessLog| {
            let task = task.filter(|_| present == Some(process.incarnation));
            let wanted = |line: &&LogLine| task.is_none_or(|task| line.is_about(task));
            let mut log = ProcessLog {
                lines: VecDeque::new(),
                ..*process
            };
            for line in process.lines.iter().rev().filter(wanted).take(LAST_LINES) {
                log.lines.push_front(line.clone());
            }
            log
        };
        processes.into_iter().flatten().map(log).collect()
    }

    /// What a chassis wrote last, one line below the other.
    pub(crate) fn last_words(&self, chassis: &str) -> String {
        let process = self.processes(chassis, None).pop();
        let lines = process.map_or_else(VecDeque::new, |process| process.lines);
        let from = lines.len().saturating_sub(LAST_WORDS);
        let lines = lines.into_iter().skip(from).map(|line| line.text);
        lines.collect::<Vec<_>>().join("\n")
    }

    /// The process id of the present process of a chassis.
    pub(crate) fn pid(&self, chassis: &str) -> Option<u32> {
        lock(&self.chassis).get(chassis)?.back()?.pid
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_of_a_line_is_the_one_it_bears() {
        for (line, level) in [
            (
                "    0.123  WARN ctos::runner: restarted task=arm",
                Level::Warn,
            ),
            ("    0.123 ERROR task failed", Level::Error),
            ("error: chassis `a`: no", Level::Error),
            ("    1.0 TRACE x", Level::Trace),
            ("thread panicked and somebody said WARN", Level::Info),
            ("", Level::Info),
            (r#"{"level":"WARN","fields":{"task":"arm"}}"#, Level::Warn),
            ("{not json WARN", Level::Info),
        ] {
            assert_eq!(Level::of(line), level, "{line}");
        }
    }

    #[test]
    fn a_log_keeps_the_last_lines_of_the_last_processes() {
        let store = LogStore::new(Clock::virtual_clock());
        for incarnation in 1..=6 {
            store.begin("cage", incarnation, Some(incarnation * 10));
            for number in 0..LINES + 5 {
                store.add("cage", incarnation, &format!("line {number}"));
            }
        }
        let lines = store.lines();
        assert_eq!(lines.len(), LINES * (EARLIER + 1));
        assert!(lines.iter().all(|line| line.incarnation >= 3));
        assert!(!lines.iter().any(|line| line.text == "line 4"));
        assert_eq!(store.pid("cage"), Some(60));
    }

    #[test]
    fn a_line_is_about_the_tasks_it_names() {
        let line = |text: &str| LogLine {
            chassis: "cage".to_owned(),
            incarnation: 1,
            at_s: 0.0,
            level: Level::Info,
            text: text.to_owned(),
        };
        assert!(line("restarted task=arm restarts=1").is_about("arm"));
        assert!(line("the reply of `arm`: late").is_about("arm"));
        assert!(line(r#"{"level":"WARN","fields":{"task":"arm"}}"#).is_about("arm"));
        assert!(!line("restarted task=armature").is_about("arm"));
    }
}
