//! Lints on a running chassis: what is probably not meant, told once when it begins and once when it
//! is over.

use crate::survey::command_name;
use ctos_config::TaskConfig;
use ctos_core::{
    chassis::{Chassis, Extension},
    system,
    task_record::TaskRecord,
};
use ctos_message::Tid;
use ctos_time::{Instant, lock::lock};
use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    sync::{Arc, Mutex},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use serde_json::json;

/// How long a handler may keep its processor, unless the configuration says otherwise.
const POLL_TIMEOUT: Duration = Duration::from_secs(1);
/// How long a handler may wait for others, unless the configuration says otherwise: longer than any call
/// does by itself.
const WAIT_TIMEOUT: Duration = Duration::from_secs(30);
/// How long a permit may be held while others wait for one.
const PERMIT_TIMEOUT: Duration = Duration::from_secs(10);
/// A synchronous function that has kept its schedule for so long keeps it again.
const KEPT_AGAIN: Duration = Duration::from_secs(5);
/// A queue that has grown at so many looks in a row, and is more than half full, is growing.
const GROWTH: usize = 5;

/// What a lint is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[non_exhaustive]
#[serde(rename_all = "kebab-case")]
pub enum LintCode {
    /// A handler keeps its processor from everybody else.
    HandlerBlocks,
    /// A handler waits for others for longer than it should.
    HandlerWaits,
    /// More comes to a task than it can do.
    QueueGrows,
    /// A task keeps a permit for long while others wait for one.
    SemaphoreHeld,
    /// A synchronous function does not keep its schedule.
    CyclicOverruns,
}

impl fmt::Display for LintCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Something that is probably not meant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lint {
    /// What it is about.
    pub code: LintCode,
    /// The task.
    pub task: String,
    /// Its chassis.
    pub chassis: String,
    /// Since when, as far as it was seen.
    pub since: Instant,
    /// The same in words.
    pub text: String,
}

/// What was seen of a task that is not at rest, at the looks since it was.
struct Seen {
    /// A poll of its handler, and when it was seen first.
    poll: Option<(u64, Instant)>,
    depths: VecDeque<usize>,
    /// Since when the queue grows.
    growing: Option<Instant>,
}

impl Default for Seen {
    fn default() -> Self {
        Self {
            poll: None,
            depths: VecDeque::from([0]),
            growing: None,
        }
    }
}

/// Of very many tasks most may have nothing to do: these are looked at no closer.
fn is_at_rest(task: &TaskRecord) -> bool {
    task.mailbox.depth().0 == 0 && task.statistics.read().began.is_none()
}

/// What was seen of a synchronous function at earlier looks.
#[derive(Default)]
struct SeenCyclic {
    late: u64,
    /// Since when it is late, and when it was late last.
    span: Option<(Instant, Instant)>,
}

/// Lints by what they are about and what they are of.
type Lints = BTreeMap<(LintCode, String), Lint>;

#[derive(Default)]
struct State {
    seen: BTreeMap<Tid, Seen>,
    cyclics: BTreeMap<String, SeenCyclic>,
    present: Lints,
}

/// What a chassis has seen of itself.
#[derive(Default)]
pub(crate) struct Watch(Mutex<State>);

impl Extension for Watch {
    fn new(_: &Chassis) -> Self {
        Self::default()
    }
}

impl Watch {
    /// That of a chassis.
    pub(crate) fn of(chassis: &Chassis) -> Arc<Self> {
        chassis.extension()
    }

    pub(super) fn lints(&self) -> Vec<Lint> {
        lock(&self.0).present.values().cloned().collect()
    }

    /// Looks at all tasks of `chassis`; tells what is new and what is over. Whether something may be seen later
    /// though nothing runs.
    pub(crate) fn look(&self, chassis: &Chassis, now: Instant) -> bool {
        let mut look = Look {
            chassis,
            now,
            found: Lints::new(),
        };
        let mut state = lock(&self.0);
        let mut before = std::mem::take(&mut state.seen);
        let tasks = chassis.tasks();
        for task in tasks.iter().filter(|task| !is_at_rest(task)) {
            // The tasks of the runtime wait for others by their nature.
            if let Some(config) = chassis.app.task(&task.name) {
                let mut seen = before.remove(&task.tid).unwrap_or_default();
                look.handler(&mut seen, task, config);
                look.queue(&mut seen, task);
                state.seen.insert(task.tid, seen);
            }
        }
        let is_waited = look.semaphores();
        look.cyclics(&mut state.cyclics);
        let found = look.found;
        let rests = state.seen.is_empty() && state.cyclics.is_empty() && found.is_empty();
        let before = std::mem::replace(&mut state.present, found.clone());
        drop(state);
        for (lints, others, present) in [(&found, &before, true), (&before, &found, false)] {
            for (_, lint) in lints.iter().filter(|(key, _)| !others.contains_key(key)) {
                tell(chassis, lint, present);
            }
        }
        is_waited || !rests
    }
}

fn tell(chassis: &Chassis, lint: &Lint, present: bool) {
    let Lint {
        code, task, text, ..
    } = lint;
    if present {
        tracing::warn!(task = %task, chassis = chassis.name(), lint = %code, "{text}");
    } else {
        tracing::info!(task = %task, chassis = chassis.name(), lint = %code, "over: {text}");
    }
    let agent = system::agent_tid(chassis.index());
    if let Some(recorder) = chassis.tap.recorder() {
        let mut told = json!(lint);
        told["present"] = json!(present);
        let write = |buffer: &mut Vec<u8>| serde_json::to_writer(buffer, &told).is_ok();
        recorder.value(agent, "/lint", &write);
    }
}

/// One look at a chassis, and what it finds.
struct Look<'a> {
    chassis: &'a Chassis,
    now: Instant,
    found: Lints,
}

impl Look<'_> {
    /// Something is probably not meant of `what`, which is the task or something that it has.
    fn add(&mut self, code: LintCode, what: &str, task: &str, since: Instant, text: String) {
        let lint = Lint {
            code,
            task: task.to_owned(),
            chassis: self.chassis.name().to_owned(),
            since,
            text,
        };
        self.found.insert((code, what.to_owned()), lint);
    }

    /// A handler that is at one message for too long.
    fn handler(&mut self, seen: &mut Seen, task: &TaskRecord, config: &TaskConfig) {
        let now = self.now;
        let poll = task.statistics.poll();
        seen.poll = poll.map(|poll| match seen.poll {
            Some((before, since)) if before == poll => (poll, since),
            _ => (poll, now),
        });
        let counters = task.statistics.read();
        let Some(began) = counters.began else {
            return;
        };
        let at_it_s = now.since(began).as_secs_f64();
        let name = &task.name;
        let command = command_name(task, counters.command);
        if let Some((_, since)) = seen.poll
            && now.since(since) >= config.handler_limit.unwrap_or(POLL_TIMEOUT)
        {
            let processor = format!("{}/{}", config.chassis, config.processor);
            let text = format!(
                "`{name}` has been at `{command}` for {at_it_s:.1} s without waiting for anything: no other task of processor `{processor}` can run"
            );
            self.add(LintCode::HandlerBlocks, name, name, began, text);
        } else if now.since(began) >= config.handler_limit.unwrap_or(WAIT_TIMEOUT) {
            let text = format!(
                "`{name}` has been at `{command}` for {at_it_s:.1} s, waiting for others; what comes to it meanwhile waits too"
            );
            self.add(LintCode::HandlerWaits, name, name, began, text);
        }
    }

    /// A queue that grows and grows.
    fn queue(&mut self, seen: &mut Seen, task: &TaskRecord) {
        let (depth, capacity) = task.mailbox.depth();
        if seen.depths.len() > GROWTH {
            seen.depths.pop_front();
        }
        seen.depths.push_back(depth);
        let growing =
            seen.depths.len() > GROWTH && seen.depths.iter().is_sorted_by(|one, next| one < next);
        // Once it grows, it is over when the queue is half empty again, and not at the first pause.
        seen.growing = match seen.growing {
            _ if depth * 2 <= capacity => None,
            None if growing => Some(self.now),
            before => before,
        };
        let Some(since) = seen.growing else {
            return;
        };
        let name = &task.name;
        let text = format!(
            "{depth} messages wait for `{name}`, whose queue holds {capacity}, and it does not get round to them"
        );
        self.add(LintCode::QueueGrows, name, name, since, text);
    }

    /// Permits that are held for too long while others wait. Whether anybody waits for one.
    fn semaphores(&mut self) -> bool {
        let mut is_waited = false;
        for view in self.chassis.semaphores() {
            let Some(next) = view.waiting.first() else {
                continue;
            };
            is_waited = true;
            for holder in &view.holders {
                let held = self.now.since(holder.since);
                if held < PERMIT_TIMEOUT {
                    continue;
                }
                let (name, task) = (&view.name, &holder.task);
                let text = format!(
                    "`{task}` has held semaphore `{name}` for {:.1} s, and `{next}` waits for it",
                    held.as_secs_f64()
                );
                let what = format!("{task} {name}");
                self.add(LintCode::SemaphoreHeld, &what, task, holder.since, text);
            }
        }
        is_waited
    }

    /// Synchronous functions that skip periods or take too long.
    fn cyclics(&mut self, seen: &mut BTreeMap<String, SeenCyclic>) {
        let now = self.now;
        let all = self.chassis.cyclics();
        seen.retain(|name, _| all.iter().any(|(there, _)| there == name));
        for (name, statistics) in all {
            let late = statistics.missed() + statistics.overruns();
            let before = seen.entry(name.clone()).or_default();
            if late > before.late {
                let since = before.span.map_or(now, |(since, _)| since);
                before.span = Some((since, now));
            }
            before.late = late;
            before.span = before
                .span
                .filter(|(_, last)| now.since(*last) < KEPT_AGAIN);
            let Some((since, _)) = before.span else {
                continue;
            };
            let text = format!(
                "synchronous function `{name}` does not keep its schedule; periods missed: {}, overruns: {}",
                statistics.missed(),
                statistics.overruns()
            );
            let task = name.split('.').next().unwrap_or_default();
            self.add(LintCode::CyclicOverruns, &name, task, since, text);
        }
    }
}
