//! What stands in a record: for each thing that happened its channel, and one JSON object.
//!
//! The shapes are told by JSON schemas, so that the field's viewers can read them. The data of a
//! message is there twice: as JSON for people, as base64 of its postcard bytes for replay.

use std::{fmt, panic::AssertUnwindSafe};

use base64::{Engine, display::Base64Display, engine::general_purpose::STANDARD};
use serde::{Deserialize, Serialize};

use super::{
    event::{Ending, Happened, Head, Side},
    names::Names,
};
use crate::message::{Flags, ToJson};

/// Data of more bytes than this is not shown as JSON: it is a picture, not something to read.
const SHOWN: usize = 4096;

/// The shape of a channel's objects: name and JSON schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Schema {
    pub(crate) name: &'static str,
    pub(crate) text: &'static str,
}

macro_rules! schema {
    ($constant:ident, $name:literal, $file:literal) => {
        pub(crate) const $constant: Schema = Schema {
            name: $name,
            text: include_str!($file),
        };
    };
}

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

/// Writes what happened as one JSON object into `json`, which is cleared first. Returns its channel
/// and shape.
pub(crate) fn write(
    head: &Head,
    data: &[u8],
    names: &Names,
    json: &mut Vec<u8>,
) -> Result<(String, Schema), serde_json::Error> {
    json.clear();
    let chassis = head.chassis;
    let number = |number| Number { chassis, number };
    match &head.what {
        Happened::Message {
            id,
            to,
            from,
            command,
            flags,
            trace,
            deadline,
            side,
        } => {
            let receiver = names.task(*to);
            let known = names.command(&receiver, *command);
            let flags = Flags::from_bits(*flags);
            let line = MessageLine {
                id: number(*id),
                to: receiver.to_string(),
                from: names.task(*from).to_string(),
                command: command_name(known.map(|known| known.name), *command),
                code: *command,
                trace: Number::of_trace(*trace),
                priority: priority(flags).to_owned(),
                waits: waits(flags).to_owned(),
                deadline_ns: *deadline,
                noted: side.word().to_owned(),
                to_tid: to.bits(),
                from_tid: from.bits(),
            };
            serde_json::to_writer(&mut *json, &line)?;
            append_data(json, data, known.map(|known| known.request));
            Ok((format!("/message/{receiver}"), MESSAGE))
        }
        Happened::Began {
            id,
            task,
            from,
            command,
            trace,
        } => {
            let name = names.task(*task);
            let known = names.command(&name, *command);
            let line = BeganLine {
                id: number(*id),
                task: name.to_string(),
                from: names.task(*from).to_string(),
                command: command_name(known.map(|known| known.name), *command),
                code: *command,
                trace: Number::of_trace(*trace),
                tid: task.bits(),
            };
            serde_json::to_writer(json, &line)?;
            Ok((format!("/began/{name}"), BEGAN))
        }
        Happened::Ended {
            id,
            task,
            from,
            command,
            trace,
            began,
            ending,
        } => {
            let name = names.task(*task);
            let known = names.command(&name, *command);
            let (result, text) = words(ending);
            let line = EndedLine {
                id: number(*id),
                task: name.to_string(),
                from: names.task(*from).to_string(),
                command: command_name(known.map(|known| known.name), *command),
                code: *command,
                trace: Number::of_trace(*trace),
                took_s: head.at.saturating_sub(*began) as f64 * 1e-9,
                result: result.to_owned(),
                text: text.to_owned(),
                tid: task.bits(),
            };
            serde_json::to_writer(json, &line)?;
            Ok((format!("/ended/{name}"), ENDED))
        }
        Happened::Answered { .. } => answered(head, data, names, json),
        Happened::Phase { task, phase } => {
            let name = names.task(*task);
            let line = PhaseLine {
                task: &name,
                phase: phase.map_or_else(|| "built".to_owned(), |phase| phase.to_string()),
            };
            serde_json::to_writer(json, &line)?;
            Ok(("/phase".to_owned(), PHASE))
        }
        Happened::Log {
            level,
            target,
            task,
            message,
        } => {
            let name = task.as_deref().unwrap_or(target);
            let line = LogLine {
                timestamp: Timestamp {
                    sec: head.at / 1_000_000_000,
                    nsec: (head.at % 1_000_000_000) as u32,
                },
                level: *level,
                message,
                name,
                file: target,
                line: 0,
            };
            serde_json::to_writer(&mut *json, &line)?;
            // Its fields are a JSON object already.
            append_member(json, "fields", |json| json.extend_from_slice(data));
            Ok((format!("/log/{}", task.as_deref().unwrap_or("ctos")), LOG))
        }
        Happened::Value { channel } => {
            json.extend_from_slice(if data.is_empty() { b"null" } else { data });
            Ok((channel.clone(), VALUE))
        }
    }
}

fn answered(
    head: &Head,
    data: &[u8],
    names: &Names,
    json: &mut Vec<u8>,
) -> Result<(String, Schema), serde_json::Error> {
    let Happened::Answered {
        id,
        by,
        to,
        command,
        trace,
        side,
        fault,
    } = &head.what
    else {
        return Ok(("/reply".to_owned(), REPLY));
    };
    let name = names.task(*by);
    let known = names.command(&name, *command);
    let line = ReplyLine {
        id: Number {
            chassis: head.chassis,
            number: *id,
        },
        by: name.to_string(),
        to: names.task(*to).to_string(),
        command: command_name(known.map(|known| known.name), *command),
        code: *command,
        trace: Number::of_trace(*trace),
        noted: side.word().to_owned(),
        result: fault
            .as_ref()
            .map_or_else(|| "ok".to_owned(), |fault| format!("{fault:?}")),
        fault: fault
            .as_ref()
            .and_then(|fault| postcard::to_stdvec(fault).ok())
            .map(|bytes| STANDARD.encode(bytes))
            .unwrap_or_default(),
        by_tid: by.bits(),
        to_tid: to.bits(),
    };
    serde_json::to_writer(&mut *json, &line)?;
    append_data(json, data, known.map(|known| known.reply));
    Ok((format!("/reply/{name}"), REPLY))
}

fn command_name(known: Option<&'static str>, code: u16) -> String {
    known.map_or_else(|| format!("{code:#06x}"), str::to_owned)
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
fn append_data(json: &mut Vec<u8>, data: &[u8], to_json: Option<ToJson>) {
    append_member(json, "data", |json| {
        let length = json.len();
        let readable = to_json.filter(|_| data.len() <= SHOWN);
        let shown = readable.is_some_and(|to_json| {
            // Types of others are read here; theirs to fail, not the record's.
            let convert = AssertUnwindSafe(|| to_json.convert(data, json));
            matches!(std::panic::catch_unwind(convert), Ok(Ok(())))
        });
        if !shown {
            json.truncate(length);
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
