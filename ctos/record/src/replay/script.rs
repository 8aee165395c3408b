//! What a record says of one task: what it was given, when, and what it did then.

use std::collections::{BTreeMap, BTreeSet};

use super::{
    super::{
        event::{Key, Side, Step as Event, Traffic},
        lines::{self, Number},
        read::{Entry, Record},
    },
    ReplayError,
};
use ctos_core::{reply::Answer, report::Ending};
use ctos_message::{Data, Flags, Tid, fault::Fault};
use ctos_time::Instant;

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
    Begin(Sent),
    /// It was given the answer to message `id` of its own.
    Answer { id: Number, answer: Recorded },
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
        let mut reader = Reader {
            task,
            messages: BTreeMap::new(),
            segment: 0,
            script: Self {
                tid: parsed(first)?.0.key.task,
                seed: seeds.first().and_then(|seed| seed.parse().ok()),
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
        Ok(reader.script)
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
    /// What the task may have been given.
    messages: BTreeMap<Number, Sent>,
    segment: usize,
    script: Script,
}

impl Reader<'_> {
    fn message(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let (event, data) = parsed(entry)?;
        // Between chassis it is noted twice; the handler begins the one that came to its own.
        if let Event::Sent {
            flags,
            deadline,
            side,
        } = event.step
            && side != Side::Sender
        {
            let message = self.sent(event.chassis, event.key, flags, deadline, data);
            self.messages.insert(message.id, message);
        }
        Ok(())
    }

    fn sent(
        &self,
        chassis: u8,
        key: Key,
        flags: u16,
        deadline: Option<u64>,
        data: Vec<u8>,
    ) -> Sent {
        Sent {
            id: Number {
                chassis,
                number: key.id,
            },
            from: key.peer,
            to: key.task,
            command: key.command,
            trace: key.trace,
            flags: Flags::from_bits(flags).with(Flags::OWNED),
            deadline: deadline.map(Instant::from_nanos),
            data,
            segment: self.segment,
        }
    }

    fn step(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let topic = entry.channel.topic.strip_prefix('/').unwrap_or_default();
        let of_task = match topic.split_once('/') {
            Some(("message" | "reply", _)) => true,
            Some(("began" | "ended", name)) => name == self.task,
            None if topic == "phase" => return self.phase(entry),
            _ => false,
        };
        if !of_task {
            return Ok(());
        }
        let (event, data) = parsed(entry)?;
        let (at, key, tid) = (entry.at, event.key, self.script.tid);
        let id = Number {
            chassis: event.chassis,
            number: key.id,
        };
        match event.step {
            Event::Sent {
                flags,
                deadline,
                side,
            } => {
                if key.peer == tid && side != Side::Receiver {
                    let output = What::Output(self.script.outputs.len());
                    self.push(at, key.trace, output);
                    let message = self.sent(event.chassis, key, flags, deadline, data);
                    self.script.outputs.push(message);
                }
            }
            Event::Began => {
                let message = self.begun(entry, key, id)?;
                self.segment += 1;
                self.push(at, key.trace, What::Begin(message));
            }
            Event::Ended { ending, .. } => {
                let command = key.command;
                self.push(at, key.trace, What::Ended { command, ending });
            }
            Event::Answered {
                side,
                at_once,
                fault,
            } => {
                let answer = Recorded(fault.map_or(Ok(data), Err));
                if key.task == tid && side != Side::Sender {
                    let answer = answer.clone();
                    self.push(at, key.trace, What::Replied { id, answer });
                }
                if key.peer == tid && side != Side::Receiver {
                    self.answered(at, key.trace, id, at_once, answer);
                }
            }
        }
        Ok(())
    }

    fn push(&mut self, at: Instant, trace: u64, what: What) {
        self.script.steps.push(Step { at, trace, what });
    }

    fn phase(&mut self, entry: &Entry) -> Result<(), ReplayError> {
        let phase: PhaseRead =
            serde_json::from_slice(&entry.json).map_err(|_| unreadable(entry))?;
        if phase.task == self.task && phase.phase == "built" {
            self.push(entry.at, 0, What::Built);
        }
        Ok(())
    }

    /// The message that the task was given.
    fn begun(&self, entry: &Entry, key: Key, id: Number) -> Result<Sent, ReplayError> {
        let task = self.task;
        if !self
            .script
            .steps
            .iter()
            .any(|step| step.what == What::Built)
        {
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
    fn answered(&mut self, at: Instant, trace: u64, id: Number, at_once: bool, answer: Recorded) {
        let mut own = self.script.outputs.iter().rev();
        let Some(own) = own.find(|message| message.id == id) else {
            return;
        };
        if lines::waits(own.flags) != "nothing" {
            self.segment += 1;
            if at_once {
                self.script.at_once.insert(id, (at, answer.clone()));
            }
            self.push(at, trace, What::Answer { id, answer });
        } else if let Recorded(Err(fault)) = answer {
            self.script.refused.insert(id, fault);
        }
    }
}

#[derive(serde::Deserialize)]
struct PhaseRead {
    task: String,
    phase: String,
}

fn parsed(entry: &Entry) -> Result<(Traffic, Vec<u8>), ReplayError> {
    lines::from_line(&entry.json).ok_or_else(|| unreadable(entry))
}

fn unreadable(entry: &Entry) -> ReplayError {
    let (topic, at) = (&entry.channel.topic, entry.at);
    incomplete(format!("the line of {topic} at {at} cannot be read"))
}
