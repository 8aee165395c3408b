//! The lines of a record: for each thing that happened its channel, and one JSON object.
//!
//! Lines about messages are made when a record is read, the others when it is written. JSON schemas tell what
//! they look like, so that the field's viewers can read them. The data of a message is there twice: as JSON
//! for people, as base64 of its postcard bytes for replay.

use std::{fmt, sync::Arc};

use base64::{Engine, display::Base64Display, engine::general_purpose::STANDARD};
use serde::{Deserialize, Serialize};

use super::{
    event::{Key, Side, Step, Told, Traffic, What},
    glossary::{Glossary, Known},
};
use crate::names::Names;
use ctos_core::report::Ending;
use ctos_message::{Flags, Shape};

/// Data of more bytes than this is not shown as JSON: it is a picture, not something to read.
const SHOWN: usize = 4096;

/// What a channel holds: the name of its schema, the schema, and how both are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Schema {
    pub(crate) name: &'static str,
    pub(crate) text: &'static str,
    /// How the schema is written.
    pub(crate) language: &'static str,
    /// How what stands in the channel is written.
    pub(crate) encoding: &'static str,
}

macro_rules! schema {
    ($constant:ident, $name:literal, $file:literal) => {
        pub(crate) const $constant: Schema = Schema {
            name: $name,
            text: include_str!($file),
            language: "jsonschema",
            encoding: "json",
        };
    };
}

/// Stretches of what happened to messages, as [`Events`](super::traffic::Events) reads them.
pub(crate) const EVENTS: Schema = Schema {
    name: "ctos.Events",
    text: include_str!("schemas/events.txt"),
    language: "text",
    encoding: "ctos.events",
};

schema!(MESSAGE, "ctos.Message", "schemas/message.json");
schema!(BEGAN, "ctos.Began", "schemas/began.json");
schema!(ENDED, "ctos.Ended", "schemas/ended.json");
schema!(REPLY, "ctos.Reply", "schemas/reply.json");
schema!(PHASE, "ctos.Phase", "schemas/phase.json");
schema!(LOG, "foxglove.Log", "schemas/log.json");
schema!(VALUE, "ctos.Value", "schemas/value.json");
schema!(RECORDER, "ctos.Recorder", "schemas/recorder.json");

/// The number of a message or a trace in a record: `CHASSIS.NUMBER`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Number {
    /// The chassis that gave it.
    pub chassis: u8,
    /// Its number there; 0 stands for none.
    pub number: u64,
}

impl Number {
    /// A trace id, which has its chassis in the highest byte.
    #[must_use]
    pub fn of_trace(trace: u64) -> Self {
        Self {
            chassis: (trace >> 56) as u8,
            number: trace & (u64::MAX >> 8),
        }
    }

    /// The trace id again.
    pub(crate) fn to_trace(self) -> u64 {
        (u64::from(self.chassis) << 56) | self.number
    }
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.chassis, self.number)
    }
}

impl std::str::FromStr for Number {
    type Err = std::num::ParseIntError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (chassis, number) = text.split_once('.').unwrap_or(("0", text));
        Ok(Self {
            chassis: chassis.parse()?,
            number: number.parse()?,
        })
    }
}

impl Serialize for Number {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.number == 0 {
            serializer.serialize_none()
        } else {
            serializer.collect_str(self)
        }
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Option::<String>::deserialize(deserializer)? {
            Some(text) => text.parse().map_err(serde::de::Error::custom),
            None => Ok(Self {
                chassis: 0,
                number: 0,
            }),
        }
    }
}

/// A message as it stands in a record, without its data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct MessageLine {
    pub(crate) id: Number,
    pub(crate) to: String,
    pub(crate) from: String,
    pub(crate) command: String,
    pub(crate) code: u16,
    pub(crate) trace: Number,
    /// `high` or `normal`.
    pub(crate) priority: String,
    /// What its sender waits for: `reply`, `acceptance` or `nothing`.
    pub(crate) waits: String,
    pub(crate) deadline_ns: Option<u64>,
    /// Where it was noted: `here`, or between chassis at its `sender` or its `receiver`.
    pub(crate) noted: String,
    pub(crate) to_tid: u32,
    pub(crate) from_tid: u32,
}

/// A handler was called.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct BeganLine {
    pub(crate) id: Number,
    pub(crate) task: String,
    pub(crate) from: String,
    pub(crate) command: String,
    pub(crate) code: u16,
    pub(crate) trace: Number,
    pub(crate) tid: u32,
}

/// A handler returned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct EndedLine {
    pub(crate) id: Number,
    pub(crate) task: String,
    pub(crate) from: String,
    pub(crate) command: String,
    pub(crate) code: u16,
    pub(crate) trace: Number,
    pub(crate) took_s: f64,
    /// `ok`, `refused`, `panicked` or `stopped`.
    pub(crate) result: String,
    pub(crate) text: String,
    pub(crate) tid: u32,
}

/// A sender has what it waited for, without the reply's data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ReplyLine {
    pub(crate) id: Number,
    pub(crate) by: String,
    pub(crate) to: String,
    pub(crate) command: String,
    pub(crate) code: u16,
    pub(crate) trace: Number,
    /// Where it was noted: `here`, or between chassis at the `sender` or the `receiver` of the request.
    pub(crate) noted: String,
    /// Whether its sender had it in the poll in which it sent. Not told by older records.
    #[serde(default)]
    pub(crate) at_once: bool,
    /// `ok` or what went wrong.
    pub(crate) result: String,
    /// The fault again, for replay: base64 of its postcard bytes; empty when there is none.
    pub(crate) fault: String,
    pub(crate) by_tid: u32,
    pub(crate) to_tid: u32,
}

#[derive(Serialize)]
struct PhaseLine<'a> {
    task: &'a str,
    phase: String,
}

#[derive(Serialize)]
struct Timestamp {
    sec: u64,
    nsec: u32,
}

#[derive(Serialize)]
struct LogLine<'a> {
    timestamp: Timestamp,
    level: u8,
    message: &'a str,
    name: &'a str,
    file: &'a str,
    line: u32,
}

/// On which channel something that happened to a message stands, and its shape.
pub(crate) fn channel_of(step: &Step, task: &str) -> (String, Schema) {
    let (kind, schema) = match step {
        Step::Sent { .. } => ("message", MESSAGE),
        Step::Began => ("began", BEGAN),
        Step::Ended { .. } => ("ended", ENDED),
        Step::Answered { .. } => ("reply", REPLY),
    };
    (format!("/{kind}/{task}"), schema)
}

/// What is known of a message by its numbers.
struct Named<'a> {
    id: Number,
    task: Arc<str>,
    peer: Arc<str>,
    command: String,
    known: Option<&'a Known>,
    trace: Number,
}

impl<'a> Named<'a> {
    fn new(chassis: u8, key: &Key, glossary: &'a Glossary) -> Self {
        let task = glossary.task(key.task);
        let known = glossary.command(&task, key.command);
        Self {
            id: Number {
                chassis,
                number: key.id,
            },
            peer: glossary.task(key.peer),
            command: command_name(known, key.command),
            known,
            trace: Number::of_trace(key.trace),
            task,
        }
    }
}

/// What happened to a message, as one JSON object.
pub(crate) fn traffic(
    event: &Traffic,
    data: &[u8],
    glossary: &Glossary,
) -> Result<Vec<u8>, serde_json::Error> {
    let key = &event.key;
    let named = Named::new(event.chassis, key, glossary);
    match &event.step {
        Step::Sent {
            flags,
            deadline,
            side,
        } => {
            let flags = Flags::from_bits(*flags);
            let line = MessageLine {
                id: named.id,
                to: named.task.to_string(),
                from: named.peer.to_string(),
                command: named.command,
                code: key.command,
                trace: named.trace,
                priority: priority(flags).to_owned(),
                waits: waits(flags).to_owned(),
                deadline_ns: *deadline,
                noted: side.word().to_owned(),
                to_tid: key.task.bits(),
                from_tid: key.peer.bits(),
            };
            let mut json = serde_json::to_vec(&line)?;
            let shape = named.known.and_then(|known| known.request.as_ref());
            append_data(&mut json, data, shape);
            Ok(json)
        }
        Step::Began => serde_json::to_vec(&BeganLine {
            id: named.id,
            task: named.task.to_string(),
            from: named.peer.to_string(),
            command: named.command,
            code: key.command,
            trace: named.trace,
            tid: key.task.bits(),
        }),
        Step::Ended { began, ending } => {
            let (result, text) = words(ending);
            serde_json::to_vec(&EndedLine {
                id: named.id,
                task: named.task.to_string(),
                from: named.peer.to_string(),
                command: named.command,
                code: key.command,
                trace: named.trace,
                took_s: event.at.saturating_sub(*began) as f64 * 1e-9,
                result: result.to_owned(),
                text: text.to_owned(),
                tid: key.task.bits(),
            })
        }
        Step::Answered {
            side,
            at_once,
            fault,
        } => {
            let line = ReplyLine {
                id: named.id,
                by: named.task.to_string(),
                to: named.peer.to_string(),
                command: named.command,
                code: key.command,
                trace: named.trace,
                noted: side.word().to_owned(),
                at_once: *at_once,
                result: fault
                    .as_ref()
                    .map_or_else(|| "ok".to_owned(), |fault| fault.to_string()),
                fault: fault
                    .as_ref()
                    .and_then(|fault| postcard::to_stdvec(fault).ok())
                    .map(|bytes| STANDARD.encode(bytes))
                    .unwrap_or_default(),
                by_tid: key.task.bits(),
                to_tid: key.peer.bits(),
            };
            let mut json = serde_json::to_vec(&line)?;
            let shape = named.known.and_then(|known| known.reply.as_ref());
            append_data(&mut json, data, shape);
            Ok(json)
        }
    }
}

/// Writes what was told as one JSON object into `json`, which is cleared first. Returns its channel
/// and shape.
pub(crate) fn told(
    told: &Told,
    data: &[u8],
    names: &Names,
    json: &mut Vec<u8>,
) -> Result<(String, Schema), serde_json::Error> {
    json.clear();
    match &told.what {
        What::Phase { task, phase } => {
            let line = PhaseLine {
                task: &names.task(*task),
                phase: phase.map_or_else(|| "built".to_owned(), |phase| phase.to_string()),
            };
            serde_json::to_writer(json, &line)?;
            Ok(("/phase".to_owned(), PHASE))
        }
        What::Log {
            level,
            target,
            task,
            message,
        } => {
            let line = LogLine {
                timestamp: Timestamp {
                    sec: told.at / 1_000_000_000,
                    nsec: (told.at % 1_000_000_000) as u32,
                },
                level: *level,
                message,
                name: task.as_deref().unwrap_or(target),
                file: target,
                line: 0,
            };
            serde_json::to_writer(&mut *json, &line)?;
            // Its fields are a JSON object already.
            append_member(json, "fields", |json| json.extend_from_slice(data));
            Ok((format!("/log/{}", task.as_deref().unwrap_or("ctos")), LOG))
        }
        What::Value { channel } => {
            json.extend_from_slice(if data.is_empty() { b"null" } else { data });
            Ok((channel.clone(), VALUE))
        }
    }
}

fn command_name(known: Option<&Known>, code: u16) -> String {
    known.map_or_else(|| format!("{code:#06x}"), |known| known.name.clone())
}

pub(crate) fn priority(flags: Flags) -> &'static str {
    if flags.contains(Flags::HIGH_PRIORITY) {
        "high"
    } else {
        "normal"
    }
}

pub(crate) fn waits(flags: Flags) -> &'static str {
    if flags.contains(Flags::REPLY_WAIT) {
        "reply"
    } else if flags.contains(Flags::ACCEPT_WAIT) {
        "acceptance"
    } else {
        "nothing"
    }
}

/// What `result` and `text` of a handler's end are.
pub(crate) fn words(ending: &Ending) -> (&'static str, &str) {
    match ending {
        Ending::Done => ("ok", ""),
        Ending::Refused(text) => ("refused", text),
        Ending::Panicked(text) => ("panicked", text),
        Ending::Stopped => ("stopped", ""),
    }
}

/// Adds a member to the object that `json` ends with.
fn append_member(json: &mut Vec<u8>, name: &str, value: impl FnOnce(&mut Vec<u8>)) {
    if json.last() == Some(&b'}') {
        json.pop();
        json.extend_from_slice(b",\"");
        json.extend_from_slice(name.as_bytes());
        json.extend_from_slice(b"\":");
        value(json);
        json.push(b'}');
    }
}

/// Adds the data of a message: as JSON where it can be read, and as it is.
fn append_data(json: &mut Vec<u8>, data: &[u8], shape: Option<&Shape>) {
    append_member(json, "data", |json| {
        let readable = shape.filter(|_| data.len() <= SHOWN);
        if readable
            .and_then(|shape| shape.convert(data, json))
            .is_none()
        {
            json.extend_from_slice(b"null");
        }
    });
    append_member(json, "bytes", |json| {
        use std::io::Write;
        // A vector takes all that is written to it.
        let _ = write!(json, "\"{}\"", Base64Display::new(data, &STANDARD));
    });
}

/// What stands under `bytes` in a line.
#[derive(Debug, Deserialize)]
pub(crate) struct Bytes {
    bytes: String,
}

impl Bytes {
    /// The bytes again.
    pub(crate) fn decode(&self) -> Option<Vec<u8>> {
        STANDARD.decode(&self.bytes).ok()
    }
}

/// The bytes of a base64 text; empty when it is none.
pub(crate) fn from_base64(text: &str) -> Vec<u8> {
    STANDARD.decode(text).unwrap_or_default()
}

impl Side {
    /// The side that a line names.
    pub(crate) fn of_word(word: &str) -> Option<Self> {
        [Self::Here, Self::Sender, Self::Receiver]
            .into_iter()
            .find(|side| side.word() == word)
    }
}
