//! What `ctos top` shows: rates between two looks at an app. Knows nothing of terminals.

use std::collections::BTreeMap;

use ctos::control::protocol::{Activity, AppView, TaskView};
use serde::Serialize;

use cli_common::{
    remote,
    table::{Column, left, rare, right},
};

use crate::{ps, top::Sort};

/// The columns, as people know them from Erlang's observer.
pub(crate) const COLUMNS: [Column; 8] = [
    left("TASK"),
    left("ON"),
    right("MSG/S"),
    right("BUSY"),
    right("QUEUE"),
    right("HANDLED"),
    rare("RESTARTS"),
    left("DOES"),
];

/// The app over the last interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Sample {
    /// Which app, and how it is.
    #[serde(skip)]
    pub(crate) title: String,
    /// Its name.
    pub(crate) app: String,
    /// How long ago it was started, s.
    pub(crate) up_s: f64,
    /// Its tasks, sorted.
    pub(crate) tasks: Vec<Line>,
}

/// A task over the last interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Line {
    name: String,
    on: String,
    /// What it does.
    activity: Activity,
    /// Messages handled, 1/s.
    messages_per_s: f64,
    /// Share of the time in the handler, 0 to 1.
    busy: f64,
    /// Messages in the queue, and senders that wait for a credit.
    queue: u64,
    handled: u64,
    restarts: u64,
    /// How long it waits for another task, s.
    waits_s: f64,
    does: String,
}

/// The last two looks.
#[derive(Debug)]
pub(crate) struct Model {
    pub(crate) sort: Sort,
    before: Option<AppView>,
    now: Option<AppView>,
}

impl Model {
    pub(crate) fn new(sort: Sort) -> Self {
        Self {
            sort,
            before: None,
            now: None,
        }
    }

    /// Takes a look.
    pub(crate) fn see(&mut self, view: AppView) {
        self.before = self.now.replace(view);
    }

    /// What the last interval was like; `None` before the second look.
    pub(crate) fn sample(&self) -> Option<Sample> {
        let (before, now) = (self.before.as_ref()?, self.now.as_ref()?);
        let earlier: BTreeMap<&str, &TaskView> = before
            .tasks
            .iter()
            .map(|task| (task.name.as_str(), task))
            .collect();
        let elapsed = now.up_s - before.up_s;
        let mut tasks: Vec<Line> = now
            .tasks
            .iter()
            .map(|task| line(task, earlier.get(task.name.as_str()).copied(), elapsed))
            .collect();
        tasks.sort_by(|one, other| {
            let ordered = match self.sort {
                Sort::Busy => other.busy.total_cmp(&one.busy),
                Sort::Messages => other.messages_per_s.total_cmp(&one.messages_per_s),
                Sort::Queue => other.queue.cmp(&one.queue),
                Sort::Wait => other.waits_s.total_cmp(&one.waits_s),
                Sort::Name => one.on.cmp(&other.on),
            };
            ordered.then_with(|| one.name.cmp(&other.name))
        });
        Some(Sample {
            title: ps::title(now),
            app: now.app.clone(),
            up_s: now.up_s,
            tasks,
        })
    }
}

/// A task between two looks; a handler that is younger than the first one has begun at zero.
fn line(now: &TaskView, before: Option<&TaskView>, elapsed: f64) -> Line {
    let same = before.filter(|before| before.pid == now.pid && before.handled <= now.handled);
    let (handled, busy_s) = same.map_or((0, 0.0), |before| (before.handled, before.busy_s));
    let (rate, busy) = if elapsed > 0.0 && now.activity != Activity::Gone {
        let busy = (now.busy_s - busy_s) / elapsed;
        (
            (now.handled - handled) as f64 / elapsed,
            busy.clamp(0.0, 1.0),
        )
    } else {
        (0.0, 0.0)
    };
    Line {
        name: now.name.clone(),
        on: format!("{}/{}", now.chassis, now.processor),
        activity: now.activity,
        messages_per_s: rate,
        busy,
        queue: now.urgent + now.queued + now.senders_waiting,
        handled: now.handled,
        restarts: now.restarts,
        waits_s: now.waits.first().map_or(0.0, |wait| wait.for_s),
        does: remote::does(now),
    }
}

impl Sample {
    /// The cells of [`COLUMNS`].
    pub(crate) fn rows(&self) -> Vec<Vec<String>> {
        let row = |line: &Line| {
            vec![
                line.name.clone(),
                line.on.clone(),
                format!("{:.1}", line.messages_per_s),
                format!("{:.0} %", 100.0 * line.busy),
                line.queue.to_string(),
                line.handled.to_string(),
                line.restarts.to_string(),
                line.does.clone(),
            ]
        };
        self.tasks.iter().map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn view(up_s: f64, tasks: &[(&str, u64, f64, u64)]) -> AppView {
        let tasks: Vec<_> = tasks
            .iter()
            .map(|(name, handled, busy_s, queued)| {
                json!({
                    "name": name, "chassis": "cage", "processor": "main", "handler": "h", "pid": 7,
                    "activity": "idle", "phase": null, "phase_s": 0.0, "handled": handled, "failed": 0,
                    "busy_s": busy_s, "longest_s": 0.0, "in_handler_s": null, "command": null, "urgent": 0,
                    "queued": queued, "senders_waiting": 0, "capacity": 64, "restarts": 0, "waits": [],
                })
            })
            .collect();
        let view = json!({
            "app": "cell", "file": "cell.toml", "pid": 1, "state": "up", "up_s": up_s, "chassis": [],
            "tasks": tasks,
        });
        serde_json::from_value(view).unwrap()
    }

    #[test]
    fn rates_are_those_between_two_looks_and_sort_the_tasks() {
        let mut model = Model::new(Sort::Busy);
        model.see(view(10.0, &[("arm", 100, 1.0, 0), ("eye", 5, 0.0, 9)]));
        assert_eq!(model.sample(), None);
        model.see(view(12.0, &[("arm", 120, 1.5, 0), ("eye", 5, 1.9, 9)]));
        let sample = model.sample().unwrap();
        let line = |name: &str| sample.tasks.iter().find(|line| line.name == name).unwrap();
        assert_eq!(line("arm").messages_per_s, 10.0);
        assert_eq!(line("arm").busy, 0.25);
        assert_eq!(sample.tasks[0].name, "eye");
        for (sort, first) in [
            (Sort::Messages, "arm"),
            (Sort::Queue, "eye"),
            (Sort::Name, "arm"),
        ] {
            model.sort = sort;
            assert_eq!(model.sample().unwrap().tasks[0].name, first, "{sort:?}");
        }
    }

    #[test]
    fn a_task_that_began_anew_has_no_negative_rate() {
        let mut model = Model::new(Sort::Name);
        model.see(view(10.0, &[("arm", 100, 9.0, 0)]));
        model.see(view(11.0, &[("arm", 3, 0.5, 0)]));
        let sample = model.sample().unwrap();
        assert_eq!(sample.tasks[0].messages_per_s, 3.0);
        assert_eq!(sample.tasks[0].busy, 0.5);
    }
}
