//! What a record says of one task: what it was given, when, and what it did then.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet, VecDeque},
};

use super::{
    super::{
        event::{Key, Side, Step as Event, Traffic},
        lines::{self, Number},
        read::{Entry, Record},
    },
    ReplayError,
};
use crate::DRIFT;
use ctos_core::{context::SHARED, report::Ending, system::WaitsFor, tap::Came};
use ctos_message::{Command, Flags, Tid, fault::Fault};
use ctos_time::{Drift, Instant};

/// A message that the task was given, or sent.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sent {
    pub(super) id: Number,
    pub(super) from: Tid,
    pub(super) to: Tid,
    pub(super) command: u16,
    pub(super) trace: u64,
    pub(super) flags: Flags,
    pub(super) deadline: Option<Instant>,
    pub(super) data: Vec<u8>,
    /// How many messages and answers the task had been given before.
    pub(super) segment: usize,
}

/// An answer as it stands in the record.
pub(super) type Recorded = Result<Vec<u8>, Fault>;

/// One step of the task.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Step {
    pub(super) at: Instant,
    pub(super) trace: u64,
    pub(super) what: What,
    /// If a poll begins here: what it takes from elsewhere.
    pub(super) takes: Takes,
}

/// What was read, by name, in order.
pub(super) type Reads = VecDeque<(String, Vec<u8>)>;

/// What a poll of a task takes from elsewhere than the messages that its handler begins, in order.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Takes {
    /// What it reads, by name.
    pub(super) reads: Reads,
    /// Answers to messages of its own.
    pub(super) answers: Vec<(Number, Recorded)>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum What {
    /// Its handler was built.
    Built,
    /// It was given a message.
    Begin(Sent),
    /// This part of it was polled.
    Polled(u64),
    /// The part of it was polled that had sent message `id`, whose answer had come.
    Answered(Number),
    /// It sent the message with this place among its outputs.
    Output(usize),
    /// Its handler returned.
    Ended { command: u16, ending: Ending },
    /// It answered message `id`.
    Replied { id: Number, answer: Recorded },
}

/// What a record says of one task.
#[derive(Debug)]
pub(super) struct Script {
    pub(super) tid: Tid,
    pub(super) seed: Option<u64>,
    /// Whether its clock went on by itself.
    pub(super) real: bool,
    /// How its clock was wrong.
    pub(super) drift: Drift,
    /// The names of all tasks that got messages: when a chassis is started again, its tasks have new ids.
    pub(super) names: BTreeMap<Tid, String>,
    pub(super) lost: u64,
    pub(super) steps: Vec<Step>,
    pub(super) outputs: Vec<Sent>,
    /// Messages whose sender did not wait, and that were not taken.
    pub(super) refused: BTreeMap<Number, Fault>,
    /// What was answered in the poll in which it was sent, when, and how.
    pub(super) at_once: BTreeMap<Number, (Instant, Recorded)>,
}

impl Script {
    /// Reads what `record` says of `task`.
    ///
    /// # Errors
    /// When it says nothing, or not enough.
    pub(super) fn of(record: &Record, task: &str) -> Result<Self, ReplayError> {
        let on = |topic: String| {
            let entries = record.entries.iter();
            entries.filter(move |entry| entry.channel.topic == topic)
        };
        let Some(first) = on(format!("/began/{task}")).next() else {
            return Err(not_recorded(record, task));
        };
        let noted = |key: &str| {
            let key = key.to_owned();
            let runs = record.runs.iter();
            runs.filter_map(move |run| run.noted.get(&key))
        };
        let seeds: BTreeSet<&String> = noted("seed").collect();
        if seeds.len() > 1 {
            let why = "the files are of different runs: their seeds differ";
            return Err(incomplete(why));
        }
        let tid = parsed(first)?.key.task;
        let drift = format!("{DRIFT}{}", tid.chassis());
        let mut reader = Reader {
            task,
            messages: BTreeMap::new(),
            segment: 0,
            poll: None,
            loose: Takes::default(),
            lacking: BTreeMap::new(),
            script: Self {
                tid,
                seed: seeds.first().and_then(|seed| seed.parse().ok()),
                real: noted("time").any(|time| time == "real"),
                drift: noted(&drift)
                    .find_map(|text| drift_of(text))
                    .unwrap_or_default(),
                names: BTreeMap::new(),
                lost: record.runs.iter().map(|run| run.lost).sum(),
                steps: Vec::new(),
                outputs: Vec::new(),
                refused: BTreeMap::new(),
                at_once: BTreeMap::new(),
            },
        };
        // A message may be noted after it was begun, by another processor: all of them first.
        for entry in on(format!("/message/{task}")) {
            reader.message(entry)?;
        }
        for entry in &record.entries {
            reader.step(entry)?;
        }
        reader.refuse_lacking()?;
        Ok(reader.script)
    }
}

/// How a clock was wrong, as a file tells it.
fn drift_of(text: &str) -> Option<Drift> {
    let (offset, rate) = text.split_once(' ')?;
    Some(Drift {
        offset_ns: offset.parse().ok()?,
        rate_ppb: rate.parse().ok()?,
    })
}

fn not_recorded(record: &Record, task: &str) -> ReplayError {
    let topics = record.runs.iter().flat_map(|run| run.channels.keys());
    let known: BTreeSet<String> = topics
        .filter_map(|topic| topic.strip_prefix("/began/"))
        .filter(|name| !name.contains('@') && *name != "tidsvr" && *name != "bootstrap")
        .map(str::to_owned)
        .collect();
    ReplayError::NotRecorded {
        task: task.to_owned(),
        known: known.into_iter().collect(),
    }
}

fn incomplete(reason: impl Into<String>) -> ReplayError {
    ReplayError::Incomplete {
        reason: reason.into(),
    }
}

struct Reader<'a> {
    task: &'a str,
    /// What the task may have been given.
    messages: BTreeMap<Number, Sent>,
    segment: usize,
    /// Among the steps, the one that began the present poll.
    poll: Option<usize>,
    /// What the task takes before its first poll, while its handler is built.
    loose: Takes,
    /// What tasks read whose values nobody can record, and which tasks.
    lacking: BTreeMap<String, BTreeSet<Tid>>,
    script: Script,
}

impl Reader<'_> {
    fn message(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let event = parsed(entry)?;
        // Between chassis it is noted twice; the handler begins the one that came to its own.
        if let Event::Sent {
            flags,
            deadline,
            side,
        } = event.step
            && side != Side::Sender
        {
            let data = data_of(entry)?;
            let message = self.sent(event.number(), event.key, flags, deadline, data);
            self.messages.insert(message.id, message);
        }
        Ok(())
    }

    fn sent(&self, id: Number, key: Key, flags: u16, deadline: Option<u64>, data: Vec<u8>) -> Sent {
        Sent {
            id,
            from: key.peer,
            to: key.task,
            command: key.command,
            trace: key.trace,
            flags: Flags::from_bits_retain(flags) | Flags::OWNED,
            deadline: deadline.map(Instant::from_nanos),
            data,
            segment: self.segment,
        }
    }

    fn step(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let topic = entry.channel.topic.strip_prefix('/').unwrap_or_default();
        let of_task = match topic.split_once('/') {
            Some(("message" | "reply" | "read", _)) => true,
            Some(("began" | "ended" | "polled", name)) => name == self.task,
            None if topic == "phase" => return self.phase(entry),
            _ => false,
        };
        if !of_task {
            return Ok(());
        }
        let event = parsed(entry)?;
        let (at, key, tid) = (entry.at, event.key, self.script.tid);
        let id = event.number();
        match &event.step {
            &Event::Sent {
                flags,
                deadline,
                side,
            } => {
                let name = topic.strip_prefix("message/").unwrap_or_default();
                self.script.names.insert(key.task, name.to_owned());
                // What the runtime asks in the name of a task that waits long is not the task's doing.
                if key.peer == tid && side != Side::Receiver && key.command != WaitsFor::CODE {
                    let output = What::Output(self.script.outputs.len());
                    self.push(at, key.trace, output);
                    let data = data_of(entry)?;
                    let message = self.sent(id, key, flags, deadline, data);
                    self.script.outputs.push(message);
                }
            }
            Event::Began => {
                let message = self.begun(entry, key, id)?;
                self.segment += 1;
                self.begin_poll(at, key.trace, What::Begin(message));
            }
            Event::Ended { ending, .. } => {
                let (command, ending) = (key.command, ending.clone());
                self.push(at, key.trace, What::Ended { command, ending });
            }
            Event::Polled { part } => self.begin_poll(at, 0, What::Polled(*part)),
            Event::Read {
                what,
                lacking: true,
            } => {
                let tasks = self.lacking.entry(what.clone()).or_default();
                tasks.insert(key.task);
            }
            Event::Read { what, .. } => {
                if key.task == tid {
                    let value = data_of(entry)?;
                    self.takes().reads.push_back((what.clone(), value));
                }
            }
            Event::Answered { side, came, fault } => {
                let replied = key.task == tid && *side != Side::Sender;
                let answered = key.peer == tid && *side != Side::Receiver;
                if replied || answered {
                    let answer = match fault {
                        None => Ok(data_of(entry)?),
                        Some(fault) => Err(fault.clone()),
                    };
                    if replied {
                        let answer = answer.clone();
                        self.push(at, key.trace, What::Replied { id, answer });
                    }
                    if answered {
                        self.answered(at, key.trace, id, *came, answer);
                    }
                }
            }
        }
        Ok(())
    }

    fn push(&mut self, at: Instant, trace: u64, what: What) {
        self.script.steps.push(Step {
            at,
            trace,
            what,
            takes: Takes::default(),
        });
    }

    fn begin_poll(&mut self, at: Instant, trace: u64, what: What) {
        self.poll = Some(self.script.steps.len());
        self.push(at, trace, what);
    }

    /// What the present poll takes.
    fn takes(&mut self) -> &mut Takes {
        let poll = self.poll.and_then(|index| self.script.steps.get_mut(index));
        poll.map_or(&mut self.loose, |poll| &mut poll.takes)
    }

    /// Refuses a task that read what nobody can give it again.
    fn refuse_lacking(&self) -> Result<(), ReplayError> {
        let tid = self.script.tid;
        // What a task shares with no other is a part of itself.
        let lacks = |(what, tasks): &(&String, &BTreeSet<Tid>)| {
            tasks.contains(&tid) && !(what.starts_with(SHARED) && tasks.len() == 1)
        };
        match self.lacking.iter().find(lacks) {
            None => Ok(()),
            Some((what, _)) => Err(ReplayError::Outside {
                task: self.task.to_owned(),
                what: what.clone(),
            }),
        }
    }

    fn phase(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let phase: BTreeMap<String, String> =
            serde_json::from_slice(&entry.json).map_err(|_| unreadable(entry))?;
        let is = |key: &str, value: &str| phase.get(key).is_some_and(|there| there == value);
        if is("task", self.task) && is("phase", "built") {
            self.begin_poll(entry.at, 0, What::Built);
            let loose = std::mem::take(&mut self.loose);
            *self.takes() = loose;
        }
        Ok(())
    }

    /// The message that the task was given.
    fn begun(&self, entry: &Entry, key: Key, id: Number) -> Result<Sent, ReplayError> {
        let task = self.task;
        let mut steps = self.script.steps.iter();
        if !steps.any(|step| step.what == What::Built) {
            return Err(incomplete(format!(
                "it does not hold the beginning of `{task}`: it was begun while the app ran, or leaves out the channel /phase; record the whole run with `ctos boot --record FILE`"
            )));
        }
        if key.task != self.script.tid {
            return Err(incomplete(format!(
                "`{task}` was moved, or its chassis restarted, while it was recorded"
            )));
        }
        self.messages.get(&id).cloned().ok_or_else(|| {
            let at = entry.at;
            incomplete(format!(
                "at {at} `{task}` was given a message that is not in it"
            ))
        })
    }

    /// The task got the answer to a message of its own.
    fn answered(&mut self, at: Instant, trace: u64, id: Number, came: Came, answer: Recorded) {
        let mut own = self.script.outputs.iter().rev();
        let Some(own) = own.find(|message| message.id == id) else {
            return;
        };
        if lines::waits(own.flags) != "nothing" {
            self.segment += 1;
            match came {
                Came::AtOnce => {
                    self.script.at_once.insert(id, (at, answer));
                    return;
                }
                Came::First => self.begin_poll(at, trace, What::Answered(id)),
                Came::Later => {}
            }
            self.takes().answers.push((id, answer));
        } else if let Err(fault) = answer {
            self.script.refused.insert(id, fault);
        }
    }
}

fn parsed(entry: &Entry) -> Result<Cow<'_, Traffic>, ReplayError> {
    let event = entry.event.as_ref().map(Cow::Borrowed);
    let event = event.or_else(|| lines::from_line(&entry.json).map(Cow::Owned));
    event.ok_or_else(|| unreadable(entry))
}

fn data_of(entry: &Entry) -> Result<Vec<u8>, ReplayError> {
    lines::data_of(&entry.json).ok_or_else(|| unreadable(entry))
}

fn unreadable(entry: &Entry) -> ReplayError {
    let (topic, at) = (&entry.channel.topic, entry.at);
    incomplete(format!("the line of {topic} at {at} cannot be read"))
}
