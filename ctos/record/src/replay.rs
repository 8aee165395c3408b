//! Replay: one task out of a record, alone on a virtual clock. It gets its messages at the recorded
//! moments and the recorded answers to what it asks. What it sends, answers and returns is compared
//! with the record.
//!
//! The record says when each part of the task, its loop or a child, was polled, and what it read there besides
//! messages. Nothing else happens here: no timer, no wake-up.

mod others;
mod script;

use crate::recorders::Recorders;
use ctos_config::{App, TaskConfig, TimeMode};
use ctos_core::{
    chassis::Chassis,
    envelope::Message,
    processor::Processor,
    registry::Registry,
    reply::{Promise, ReplySlot, Waiting},
    report::Ending,
    runner::{TaskSpec, start_task},
};
use ctos_message::{Data, Flags, Tid};
use ctos_time::{Clock, Instant};
use std::{collections::BTreeMap, fmt, rc::Rc, sync::Arc};

use futures_util::FutureExt;

use super::{glossary::Glossary, lines::Number, read::Record};

pub(crate) use others::Others;
use script::{Recorded, Script, Sent, Step, Takes, What};

/// Why a task could not be replayed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// The configuration has no such task.
    #[error("the configuration has no task `{task}`; it has: {}", .known.join(", "))]
    NoTask {
        /// The name.
        task: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// The record has nothing of the task.
    #[error("the record holds nothing that `{task}` did; it holds: {}", .known.join(", "))]
    NotRecorded {
        /// The task.
        task: String,
        /// Tasks of which it holds something.
        known: Vec<String>,
    },
    /// The record is not complete where it matters.
    #[error("the record cannot be replayed: {reason}")]
    Incomplete {
        /// What it lacks.
        reason: String,
    },
    /// The task reads what no record holds.
    #[error(
        "`{task}` cannot be replayed: it uses {what}, which no record holds; what a task reads with `Context::outside` is recorded"
    )]
    Outside {
        /// The task.
        task: String,
        /// What it reads.
        what: String,
    },
    /// The handler could not be built.
    #[error("`{task}` cannot be built: {reason}")]
    Build {
        /// The task.
        task: String,
        /// Why not.
        reason: String,
    },
}

/// The first place at which a task did something else than the record says.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Difference {
    /// When, ns since the start of the app.
    pub at_ns: u64,
    /// The trace it belongs to, `CHASSIS.NUMBER`; empty for none.
    pub trace: String,
    /// What the record says.
    pub expected: String,
    /// What the task did.
    pub got: String,
}

/// What a replay found.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize)]
pub struct ReplayReport {
    /// The task.
    pub task: String,
    /// Messages it was given.
    pub messages: u64,
    /// What it sent, answered and returned that is as recorded.
    pub same: u64,
    /// What is not.
    pub different: u64,
    /// The first difference.
    pub first: Option<Difference>,
    /// Events that the record is known to lack.
    pub lost: u64,
}

impl ReplayReport {
    /// Whether it did all that the record says and nothing else.
    #[must_use]
    pub fn is_same(&self) -> bool {
        self.different == 0
    }

    fn differs(&mut self, at: Instant, trace: u64, expected: String, got: String) {
        self.different += 1;
        if self.first.is_none() {
            let trace = Some(Number::of_trace(trace)).filter(|trace| trace.number != 0);
            self.first = Some(Difference {
                at_ns: at.as_nanos(),
                trace: trace.map_or_else(String::new, |trace| trace.to_string()),
                expected,
                got,
            });
        }
    }
}

impl fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            task,
            messages,
            same,
            different,
            ..
        } = self;
        let (how, results) = match different {
            0 => ("did the same again", "compared".to_owned()),
            _ => ("did otherwise", format!("the same, {different} different")),
        };
        write!(
            f,
            "`{task}` {how}: {messages} messages, {same} results {results}"
        )?;
        if let Some(first) = &self.first {
            let at = Instant::from_nanos(first.at_ns);
            let trace = match first.trace.as_str() {
                "" => String::new(),
                trace => format!(", trace {trace}"),
            };
            write!(
                f,
                "\nfirst difference at {at}{trace}\n  expected  {}\n  got       {}",
                first.expected, first.got
            )?;
        }
        if self.lost > 0 {
            write!(f, "\nthe record lacks {} events", self.lost)?;
        }
        Ok(())
    }
}

/// Which tasks of `app` can be replayed from `record`, and why the others cannot.
#[must_use]
pub fn replayable(app: &App, record: &Record) -> Vec<(String, Result<(), ReplayError>)> {
    let script = |task: &TaskConfig| {
        let script = Script::of(record, &task.name);
        (task.name.clone(), script.map(|_| ()))
    };
    app.tasks.iter().map(script).collect()
}

/// Lets task `task` of `app` do again what it did in `record`, and compares.
///
/// # Errors
/// [`ReplayError`] when it cannot be tried.
pub fn replay(
    mut app: App,
    registry: Registry,
    task: &str,
    record: &Record,
) -> Result<ReplayReport, ReplayError> {
    let Some(config) = app.task(task).cloned() else {
        let known = app.tasks.iter().map(|task| task.name.clone()).collect();
        let task = task.to_owned();
        return Err(ReplayError::NoTask { task, known });
    };
    let mut script = Script::of(record, task)?;
    let (tid, lost) = (script.tid, script.lost);
    let steps = std::mem::take(&mut script.steps);
    app.time = TimeMode::Virtual;
    app.record = None;
    app.metrics = None;
    if let Some(seed) = script.seed {
        app.seed = seed;
    }
    let names = Glossary::of(&app, &registry, &[]);
    let clock = Clock::virtual_clock();
    let chassis = Chassis::new(
        tid.chassis(),
        Arc::new(app),
        Arc::new(registry),
        clock.drifting(script.drift),
    );
    let others = Arc::new(Others::new(clock.clone(), names, script));
    Recorders::replay_at(&chassis, others.clone());
    // The configuration may have fewer processors now than it had then.
    let last = chassis.processors.len().saturating_sub(1);
    let index = usize::from(tid.processor()).min(last);
    let processor = chassis
        .processor(index)
        .ok_or_else(|| ReplayError::Incomplete {
            reason: "its chassis has no processor".to_owned(),
        })?;
    let stage = Stage {
        tid,
        config,
        chassis,
        processor,
        clock,
        others,
        waiting: BTreeMap::new(),
        unanswered: Vec::new(),
        messages: 0,
    };
    let mut report = stage.play(steps)?;
    report.lost = lost;
    Ok(report)
}

/// The task and what stands around it.
struct Stage {
    tid: Tid,
    config: TaskConfig,
    chassis: Arc<Chassis>,
    processor: Rc<Processor>,
    clock: Clock,
    others: Arc<Others>,
    /// The answers that the task owes, by the number of the message.
    waiting: BTreeMap<Number, (u16, Waiting)>,
    /// What it answered in the record and not yet here: with the moment and the trace.
    unanswered: Vec<Answered>,
    messages: u64,
}

type Answered = (Instant, u64, Number, Recorded);

impl Stage {
    fn play(mut self, steps: Vec<Step>) -> Result<ReplayReport, ReplayError> {
        for Step {
            at,
            trace,
            what,
            takes,
        } in steps
        {
            self.clock.advance_to(at);
            match &what {
                What::Built => {
                    self.others.begin_poll(&what, takes);
                    self.build()?;
                    self.others.end_poll();
                }
                What::Begin(message) => {
                    self.begin(message);
                    self.poll(&what, takes);
                }
                What::Polled(_) | What::Answered(_) => self.poll(&what, takes),
                What::Output(index) => self.others.must_be_done(*index, at),
                What::Ended { command, ending } => self.ended(at, trace, *command, ending),
                What::Replied { id, answer } => {
                    self.replied((at, trace, *id, answer.clone()), false);
                }
            }
        }
        for replied in std::mem::take(&mut self.unanswered) {
            self.replied(replied, true);
        }
        self.processor.clear();
        self.chassis.close();
        let mut report = self.others.report(&self.config.name);
        report.messages = self.messages;
        Ok(report)
    }

    fn build(&self) -> Result<(), ReplayError> {
        let TaskConfig { name, handler, .. } = &self.config;
        let registry = self.chassis.registry();
        let kind = registry.kind(handler);
        let recipe = kind.map(|kind| kind.recipe_of(&self.config, &self.chassis.app, &registry));
        let recipe =
            recipe.ok_or_else(|| format!("nobody registered the event handler `{handler}`"));
        let built = recipe.and_then(|recipe| {
            let config = Some(self.config.clone());
            let spec = TaskSpec::new(name, self.tid, config, recipe, &self.processor.handle);
            start_task(&self.chassis, &self.processor, spec).map_err(|error| error.to_string())
        });
        built.map_err(|reason| ReplayError::Build {
            task: name.clone(),
            reason,
        })
    }

    /// Polls the task once.
    fn poll(&mut self, what: &What, takes: Takes) {
        self.others.begin_poll(what, takes);
        self.processor.run_jobs();
        self.processor.poll_all();
        self.processor.run_jobs();
        self.others.end_poll();
        for replied in std::mem::take(&mut self.unanswered) {
            self.replied(replied, true);
        }
    }

    /// Gives the task a message.
    fn begin(&mut self, begun: &Sent) {
        self.messages += 1;
        let reply = begun.flags.contains(Flags::REPLY_WAIT).then(|| {
            let (promise, waiting) = Promise::new();
            self.waiting.insert(begun.id, (begun.command, waiting));
            ReplySlot::outside(promise)
        });
        let data = Data::Bytes(begun.data.clone());
        let mut message = Message::with_data(self.tid, begun.from, begun.command, data)
            .flagged(begun.flags)
            .in_trace(begun.trace)
            .until(begun.deadline);
        message.envelope.reply = reply;
        if let Some(task) = self.chassis.task(self.tid) {
            task.mailbox.put(message);
        }
    }

    /// Compares how a handler ended.
    fn ended(&self, at: Instant, trace: u64, command: u16, expected: &Ending) {
        // It was interrupted by an order to stop, which is among the messages that follow.
        if *expected == Ending::Stopped {
            return;
        }
        let got = self.others.next_end();
        self.others.compare_end(at, trace, command, expected, got);
    }

    /// Compares what the task answered. When nothing else in the poll told whose it was, the answer stands before it.
    fn replied(&mut self, replied: Answered, is_last: bool) {
        let (at, trace, id, ref answer) = replied;
        let Some((command, waiting)) = self.waiting.get_mut(&id) else {
            return;
        };
        match waiting.now_or_never() {
            None if !is_last => self.unanswered.push(replied),
            got => {
                self.others.compare_reply(at, trace, *command, answer, got);
                self.waiting.remove(&id);
            }
        }
    }
}

#[cfg(test)]
mod tests;
