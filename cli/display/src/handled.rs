//! What the tasks of a recorded run handled, and what the log says of them: the channels `/ended/TASK` and
//! `/log/TASK` of its records.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use ctos::{Command as _, control::Level, time::Instant};
use pnt::{
    stream::{Describe, Follow, NetView},
    task::Marking,
};
use scene::FollowScene;
use serde::Deserialize;
use serde_json::{Map, Value};

use super::{
    standing,
    wire::{TaskLine, TaskMessage, TaskState, Warning},
};

/// So many messages of a task are shown, the last ones.
const MOST: usize = 2_000;
/// And so many lines of the log.
const MOST_LINES: usize = 200;

/// A line of a record, as far as it matters here.
#[derive(Debug, Deserialize)]
pub(super) struct Ended {
    task: String,
    from: String,
    command: String,
    took_s: f64,
    result: String,
    #[serde(default)]
    text: String,
}

/// A line of the log, as far as it matters here.
#[derive(Debug, Deserialize)]
pub(super) struct Said {
    level: u8,
    message: String,
    /// The task, or the module.
    name: String,
    /// The module.
    file: String,
    #[serde(default)]
    fields: Map<String, Value>,
}

impl Said {
    fn line(self, at: Instant) -> TaskLine {
        let level = match self.level {
            0 | 1 => Level::Debug,
            2 => Level::Info,
            3 => Level::Warn,
            _ => Level::Error,
        };
        let mut text = format!("{}: {}", self.file, self.message);
        for (name, value) in &self.fields {
            text.push_str(&format!(" {name}={value}"));
        }
        TaskLine::new(at.as_nanos(), level, &text)
    }
}

/// What tasks handled, by their names, each in the order in which it ended, and what the log says of them.
#[derive(Debug, Default)]
pub(super) struct Handled {
    tasks: BTreeMap<String, OfTask>,
    warnings: VecDeque<Warning>,
}

#[derive(Debug, Default)]
struct OfTask {
    last: VecDeque<TaskMessage>,
    left_out: u64,
    lines: VecDeque<TaskLine>,
}

impl Handled {
    /// A handler ended at `at`.
    pub(super) fn take(&mut self, at: Instant, ended: Ended) {
        // Displays follow all the time.
        let follows = [
            Describe::INFO.name,
            Follow::INFO.name,
            FollowScene::INFO.name,
            Marking::INFO.name,
        ];
        if follows.contains(&ended.command.as_str()) {
            return;
        }
        // A handler that took longer than the app has run is none; `as` ends at the largest number.
        let took_ns = (ended.took_s.max(0.0) * 1e9).round() as u64;
        let failed = match ended.result.as_str() {
            "ok" => None,
            "refused" => Some(ended.text),
            other => Some(format!("{other} {}", ended.text).trim_end().to_owned()),
        };
        let of_task = self.tasks.entry(ended.task).or_default();
        if of_task.last.len() == MOST {
            of_task.last.pop_front();
            of_task.left_out += 1;
        }
        of_task.last.push_back(TaskMessage {
            at_ns: at.as_nanos().saturating_sub(took_ns),
            from: ended.from,
            command: ended.command,
            took_ns: Some(took_ns),
            failed,
        });
    }

    /// The log said something of a task at `at`.
    pub(super) fn note(&mut self, at: Instant, said: Said) {
        let of_task = self.tasks.entry(said.name.clone()).or_default();
        if of_task.lines.len() == MOST_LINES {
            of_task.lines.pop_front();
        }
        let name = said.name.clone();
        let line = said.line(at);
        if let Some(warning) = line.warning(name) {
            if self.warnings.len() == standing::MOST {
                self.warnings.pop_front();
            }
            self.warnings.push_back(warning);
        }
        of_task.lines.push_back(line);
    }

    /// The last lines that warn.
    pub(super) fn warnings(&self) -> Vec<Warning> {
        self.warnings.iter().cloned().collect()
    }

    /// What is known of the tasks that `nets` call, and of those that run them.
    pub(super) fn by<'n>(&self, nets: impl Iterator<Item = &'n NetView>) -> Vec<TaskState> {
        let mut names = BTreeSet::new();
        for net in nets {
            names.insert(net.name.as_str());
            names.extend(net.transitions.iter().filter_map(|one| one.task.as_deref()));
        }
        let known = names.into_iter().filter_map(|name| {
            let of_task = self.tasks.get(name)?;
            Some(TaskState {
                name: name.to_owned(),
                messages: of_task.last.iter().cloned().collect(),
                left_out: of_task.left_out,
                lines: of_task.lines.iter().cloned().collect(),
                ..TaskState::default()
            })
        });
        known.collect()
    }
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;
    use pnt::compile;

    use super::*;

    fn ended(task: &str, command: &str, result: &str) -> Ended {
        let line = serde_json::json!({
            "id": "1.2", "task": task, "from": "x", "command": command, "code": 3, "trace": "1.1",
            "took_s": 0.5, "result": result, "text": "why", "tid": 7
        });
        serde_json::from_value(line).unwrap()
    }

    fn view() -> NetView {
        let text = "net n\nplace a = 1\ntransition t\n  in a\n  send arm.go\n  out a\n";
        let net = compile::net(&Source::new("n.net", text)).unwrap_or_else(|f| panic!("{f}"));
        NetView::new(&net)
    }

    #[test]
    fn what_a_task_that_nets_call_handled_is_told_with_when_it_began_and_how_it_ended() {
        let mut handled = Handled::default();
        let second = Instant::from_nanos(1_000_000_000);
        handled.take(second, ended("arm", "go", "ok"));
        handled.take(second, ended("arm", "go", "refused"));
        handled.take(second, ended("arm", "go", "panicked"));
        handled.take(second, ended("other", "go", "ok"));
        handled.take(second, ended("n", "follow", "ok"));
        let view = view();
        let told = handled.by([&view].into_iter());
        assert_eq!(told.len(), 1);
        let messages = &told[0].messages;
        assert!(messages.iter().all(|one| one.at_ns == 500_000_000));
        let failed: Vec<_> = messages.iter().map(|one| one.failed.as_deref()).collect();
        assert_eq!(failed, [None, Some("why"), Some("panicked why")]);
    }

    #[test]
    fn what_the_log_says_of_a_task_is_told_with_its_fields() {
        let mut handled = Handled::default();
        let said = serde_json::json!({
            "timestamp": { "sec": 0, "nsec": 3 }, "level": 3, "message": "is late", "name": "arm",
            "file": "mcs::servo", "line": 0, "fields": { "late_ms": 4 }
        });
        handled.note(
            Instant::from_nanos(3),
            serde_json::from_value(said).unwrap(),
        );
        let view = view();
        let told = handled.by([&view].into_iter());
        let line = TaskLine::new(3, Level::Warn, "mcs::servo: is late late_ms=4");
        assert_eq!(told[0].lines, [line]);
    }

    #[test]
    fn of_very_many_messages_the_last_ones_are_told_and_how_many_are_not() {
        let mut handled = Handled::default();
        for at in 0..5_000 {
            handled.take(Instant::from_nanos(at), ended("arm", "go", "ok"));
        }
        let view = view();
        let told = handled.by([&view].into_iter());
        assert_eq!((told[0].messages.len(), told[0].left_out), (2_000, 3_000));
    }
}
