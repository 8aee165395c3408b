//! What a record says of one task: what it was given, when, and what it did then.

use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;

use super::{
    super::{
        event::Side,
        lines::{BeganLine, Bytes, EndedLine, MessageLine, Number, ReplyLine, from_base64},
        read::{Entry, Record},
    },
    ReplayError,
};
use ctos_core::reply::Answer;
use ctos_message::{Data, Flags, Tid, fault::Fault};
use ctos_time::Instant;

/// A message that the task was given.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Begun {
    pub(super) id: Number,
    pub(super) from: Tid,
    pub(super) command: u16,
    pub(super) flags: Flags,
    pub(super) trace: u64,
    pub(super) deadline: Option<Instant>,
    pub(super) data: Vec<u8>,
}

/// A message that the task sent.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Output {
    pub(super) id: Number,
    pub(super) at: Instant,
    pub(super) to: Tid,
    pub(super) command: u16,
    pub(super) flags: Flags,
    pub(super) trace: u64,
    pub(super) data: Vec<u8>,
    /// How many messages and answers the task had been given before.
    pub(super) segment: usize,
}

/// An answer as it stands in the record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Recorded(pub(super) Result<Vec<u8>, Fault>);

impl Recorded {
    pub(super) fn into_answer(self) -> Answer {
        self.0.map(Data::Bytes)
    }
}

/// One step of the task.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Step {
    pub(super) at: Instant,
    pub(super) trace: u64,
    pub(super) what: What,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum What {
    /// Its handler was built.
    Built,
    /// It was given a message.
    Begin(Begun),
    /// It was given the answer to message `id` of its own.
    Answer { id: Number, answer: Recorded },
    /// It sent the message with this place among its outputs.
    Output(usize),
    /// Its handler returned: result and text.
    Ended {
        command: u16,
        ending: (String, String),
    },
    /// It answered message `id`.
    Replied { id: Number, answer: Recorded },
}

/// What a record says of one task.
#[derive(Debug)]
pub(super) struct Script {
    pub(super) tid: Tid,
    pub(super) seed: Option<u64>,
    pub(super) lost: u64,
    pub(super) steps: Vec<Step>,
    pub(super) outputs: Vec<Output>,
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
        let mut reader = Reader {
            task,
            tid: None,
            messages: BTreeMap::new(),
            own: BTreeMap::new(),
            segment: 0,
            steps: Vec::new(),
            outputs: Vec::new(),
            refused: BTreeMap::new(),
            at_once: BTreeMap::new(),
        };
        // A message may be noted after it was begun, by another processor: all of them first.
        for entry in &record.entries {
            reader.message(entry)?;
        }
        for entry in &record.entries {
            reader.step(entry)?;
        }
        let Some(tid) = reader.tid else {
            return Err(not_recorded(record, task));
        };
        let seeds: BTreeSet<&String> = record
            .runs
            .iter()
            .filter_map(|run| run.noted.get("seed"))
            .collect();
        if seeds.len() > 1 {
            return Err(incomplete(
                "the files are of different runs: their seeds differ",
            ));
        }
        Ok(Self {
            tid,
            seed: seeds.first().and_then(|seed| seed.parse().ok()),
            lost: record.runs.iter().map(|run| run.lost).sum(),
            steps: reader.steps,
            outputs: reader.outputs,
            refused: reader.refused,
            at_once: reader.at_once,
        })
    }
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
    tid: Option<Tid>,
    /// What the task may have been given.
    messages: BTreeMap<Number, Begun>,
    /// The messages of its own, and whether it waited for something.
    own: BTreeMap<Number, bool>,
    segment: usize,
    steps: Vec<Step>,
    outputs: Vec<Output>,
    refused: BTreeMap<Number, Fault>,
    at_once: BTreeMap<Number, (Instant, Recorded)>,
}

impl Reader<'_> {
    fn message(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let topic = entry.channel.topic.strip_prefix("/message/");
        if topic != Some(self.task) {
            return Ok(());
        }
        let line: MessageLine = parsed(entry)?;
        // Between chassis it is noted twice; the handler begins the one that came to its own.
        if line.noted == Side::Sender.word() {
            return Ok(());
        }
        let begun = Begun {
            id: line.id,
            from: Tid::from_bits(line.from_tid),
            command: line.code,
            flags: flags_of(&line),
            trace: line.trace.to_trace(),
            deadline: line.deadline_ns.map(Instant::from_nanos),
            data: data_of(entry)?,
        };
        self.messages.insert(line.id, begun);
        Ok(())
    }

    fn step(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let topic = entry.channel.topic.as_str();
        if topic == "/phase" {
            let phase: PhaseRead = parsed(entry)?;
            if phase.task == self.task && phase.phase == "built" {
                self.push(entry.at, 0, What::Built);
            }
        } else if topic.starts_with("/message/") {
            self.output(entry)?;
        } else if topic.strip_prefix("/began/") == Some(self.task) {
            if !self.steps.iter().any(|step| step.what == What::Built) {
                return Err(incomplete(format!(
                    "it does not hold the beginning of `{}`: it was begun while the app ran, or leaves out the channel /phase; record the whole run with `ctos boot --record FILE`",
                    self.task
                )));
            }
            let line: BeganLine = parsed(entry)?;
            if let Some(before) = self.tid.replace(Tid::from_bits(line.tid))
                && before != Tid::from_bits(line.tid)
            {
                return Err(incomplete(format!(
                    "`{}` was moved, or its chassis restarted, while it was recorded",
                    self.task
                )));
            }
            let Some(begun) = self.messages.get(&line.id).cloned() else {
                return Err(incomplete(format!(
                    "at {} `{}` was given a message that is not in it",
                    entry.at, self.task
                )));
            };
            self.segment += 1;
            self.push(entry.at, line.trace.to_trace(), What::Begin(begun));
        } else if topic.strip_prefix("/ended/") == Some(self.task) {
            let line: EndedLine = parsed(entry)?;
            let what = What::Ended {
                command: line.code,
                ending: (line.result, line.text),
            };
            self.push(entry.at, line.trace.to_trace(), what);
        } else if topic.starts_with("/reply/") {
            self.reply(entry)?;
        }
        Ok(())
    }

    fn push(&mut self, at: Instant, trace: u64, what: What) {
        self.steps.push(Step { at, trace, what });
    }

    /// A message that may be the task's own.
    fn output(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let line: MessageLine = parsed(entry)?;
        if line.from != self.task || line.noted == Side::Receiver.word() {
            return Ok(());
        }
        self.own.insert(line.id, line.waits != "nothing");
        let trace = line.trace.to_trace();
        self.push(entry.at, trace, What::Output(self.outputs.len()));
        self.outputs.push(Output {
            id: line.id,
            at: entry.at,
            to: Tid::from_bits(line.to_tid),
            command: line.code,
            flags: flags_of(&line),
            trace,
            data: data_of(entry)?,
            segment: self.segment,
        });
        Ok(())
    }

    /// An answer that the task got, or gave.
    fn reply(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let line: ReplyLine = parsed(entry)?;
        let answer = Recorded(if line.fault.is_empty() {
            Ok(data_of(entry)?)
        } else {
            let fault = postcard::from_bytes(&from_base64(&line.fault));
            Err(fault.map_err(|error| incomplete(format!("a fault at {}: {error}", entry.at)))?)
        });
        let trace = line.trace.to_trace();
        let id = line.id;
        let side = Side::of_word(&line.noted);
        if line.by == self.task && side != Some(Side::Sender) {
            let answer = answer.clone();
            self.push(entry.at, trace, What::Replied { id, answer });
        }
        if line.to == self.task && side != Some(Side::Receiver) {
            match (self.own.get(&id), &answer.0) {
                (Some(true), _) => {
                    self.segment += 1;
                    if line.at_once {
                        self.at_once.insert(id, (entry.at, answer.clone()));
                    }
                    self.push(entry.at, trace, What::Answer { id, answer });
                }
                (Some(false), Err(fault)) => {
                    self.refused.insert(id, fault.clone());
                }
                _ => {}
            }
        }
        Ok(())
    }
}

#[derive(serde::Deserialize)]
struct PhaseRead {
    task: String,
    phase: String,
}

fn parsed<T: DeserializeOwned>(entry: &Entry) -> Result<T, ReplayError> {
    serde_json::from_slice(&entry.json).map_err(|error| {
        incomplete(format!(
            "the line of {} at {} cannot be read: {error}",
            entry.channel.topic, entry.at
        ))
    })
}

fn data_of(entry: &Entry) -> Result<Vec<u8>, ReplayError> {
    let bytes: Bytes = parsed(entry)?;
    bytes.decode().ok_or_else(|| {
        incomplete(format!(
            "the data in {} at {} is damaged",
            entry.channel.topic, entry.at
        ))
    })
}

fn flags_of(line: &MessageLine) -> Flags {
    let priority = match line.priority.as_str() {
        "high" => Flags::HIGH_PRIORITY,
        _ => Flags::NONE,
    };
    let waits = match line.waits.as_str() {
        "reply" => Flags::REPLY_WAIT,
        "acceptance" => Flags::ACCEPT_WAIT,
        _ => Flags::NONE,
    };
    priority.with(waits).with(Flags::OWNED)
}
