//! The lines of a record: for each thing that happened its channel, and one JSON object.
//!
//! Lines about messages are made when a record is read, the others when they are noted. JSON schemas tell what
//! they look like, so that the field's viewers can read them. What happened to a message is there twice: for
//! people, and as base64 of its postcard bytes for replay.

use std::{borrow::Cow, io::Write, sync::Arc};

use base64::{Engine, display::Base64Display, engine::general_purpose::STANDARD};
use serde::{Serialize, Serializer};
use serde_json::json;

use super::{
    event::{Step, Traffic},
    glossary::Glossary,
    traffic::{Coder, Events},
};
use ctos_core::{
    report::Ending,
    tap::{Came, ChannelSchema},
};
use ctos_message::{ChassisNumber, Flags, Shape};

/// Data of more bytes than this is not shown as JSON: it is a picture, not something to read.
const SHOWN: usize = 4096;

/// What a channel holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Schema {
    /// Stretches of what happened to messages, as [`Events`] reads them.
    Events,
    Message,
    Began,
    Ended,
    Reply,
    Polled,
    Read,
    Phase,
    Log,
    Value,
    Recorder,
    /// What a task says it does.
    Given(Arc<ChannelSchema>),
}

/// How stretches of events are written.
pub(crate) const EVENTS: &str = "ctos.events";

impl Schema {
    pub(crate) fn text(&self) -> Cow<'_, ChannelSchema> {
        let (name, text): (_, &[u8]) = match self {
            Self::Given(schema) => return Cow::Borrowed(schema),
            Self::Events => ("ctos.Events", include_bytes!("schemas/events.txt")),
            Self::Message => ("ctos.Message", include_bytes!("schemas/message.json")),
            Self::Began => ("ctos.Began", include_bytes!("schemas/began.json")),
            Self::Ended => ("ctos.Ended", include_bytes!("schemas/ended.json")),
            Self::Reply => ("ctos.Reply", include_bytes!("schemas/reply.json")),
            Self::Polled => ("ctos.Polled", include_bytes!("schemas/polled.json")),
            Self::Read => ("ctos.Read", include_bytes!("schemas/read.json")),
            Self::Phase => ("ctos.Phase", include_bytes!("schemas/phase.json")),
            Self::Log => ("foxglove.Log", include_bytes!("schemas/log.json")),
            Self::Value => ("ctos.Value", include_bytes!("schemas/value.json")),
            Self::Recorder => ("ctos.Recorder", include_bytes!("schemas/recorder.json")),
        };
        let (language, encoding) = match self {
            Self::Events => ("text", EVENTS),
            _ => ("jsonschema", "json"),
        };
        Cow::Owned(ChannelSchema {
            name: name.into(),
            language: language.into(),
            text: text.into(),
            encoding: encoding.into(),
        })
    }
}

/// The number of a message or a trace in a record: `CHASSIS.NUMBER`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, derive_more::Display)]
#[display("{chassis}.{number}")]
pub struct Number {
    /// The chassis that gave it.
    pub chassis: ChassisNumber,
    /// Its number there; 0 stands for none.
    pub number: u64,
}

impl Number {
    /// A trace id, which has its chassis in the highest 16 bits.
    #[must_use]
    pub fn of_trace(trace: u64) -> Self {
        Self {
            chassis: (trace >> 48) as ChassisNumber,
            number: trace & (u64::MAX >> 16),
        }
    }
}

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.number == 0 {
            serializer.serialize_none()
        } else {
            serializer.collect_str(self)
        }
    }
}

impl Traffic {
    pub(crate) fn number(&self) -> Number {
        let (chassis, number) = (self.chassis, self.key.id);
        Number { chassis, number }
    }
}

/// On what kind of channel something that happened to a message stands, and its shape.
pub(crate) fn kind_of(step: &Step) -> (&'static str, Schema) {
    match step {
        Step::Sent { .. } => ("message", Schema::Message),
        Step::Began => ("began", Schema::Began),
        Step::Ended { .. } => ("ended", Schema::Ended),
        Step::Answered { .. } => ("reply", Schema::Reply),
        Step::Polled { .. } => ("polled", Schema::Polled),
        Step::Read { .. } => ("read", Schema::Read),
    }
}

/// The channel of this kind for a task.
pub(crate) fn channel_of(kind: &str, task: &str) -> String {
    format!("/{kind}/{task}")
}

/// What happened to a message, as one JSON object.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn traffic(
    event: &Traffic,
    data: &[u8],
    glossary: &Glossary,
) -> Result<Vec<u8>, serde_json::Error> {
    let key = event.key;
    let (task, peer) = (glossary.task(key.task), glossary.task(key.peer));
    let known = glossary.command(&task, key.command);
    let (receiver, sender) = match event.step {
        Step::Sent { .. } => ("to", "from"),
        Step::Began | Step::Ended { .. } => ("task", "from"),
        Step::Answered { .. } => ("by", "to"),
        Step::Polled { .. } | Step::Read { .. } => ("task", ""),
    };
    let mut line = vec![(receiver, json!(&*task))];
    if !event.step.is_within() {
        line.extend([
            ("id", json!(event.number())),
            (sender, json!(&*peer)),
            ("command", json!(glossary.command_name(&task, key.command))),
            ("code", json!(key.command)),
            ("trace", json!(Number::of_trace(key.trace))),
        ]);
    }
    match &event.step {
        Step::Sent {
            flags,
            deadline,
            side,
        } => {
            let flags = Flags::from_bits_retain(*flags);
            line.extend([
                ("priority", json!(priority(flags))),
                ("waits", json!(waits(flags))),
                ("deadline_ns", json!(deadline)),
                ("noted", json!(side)),
            ]);
        }
        Step::Began => {}
        Step::Ended { took, ending } => {
            let (result, text) = words(ending);
            line.extend([
                ("took_s", json!(*took as f64 * 1e-9)),
                ("result", json!(result)),
                ("text", json!(text)),
            ]);
        }
        Step::Polled { part } => line.push(("part", json!(part))),
        Step::Read { what, lacking } => {
            line.extend([("what", json!(what)), ("lacking", json!(lacking))]);
        }
        Step::Answered { side, came, fault } => {
            let result = fault.as_ref().map(ToString::to_string);
            line.extend([
                ("noted", json!(side)),
                ("at_once", json!(*came == Came::AtOnce)),
                ("result", json!(result.as_deref().unwrap_or("ok"))),
            ]);
        }
    }
    line.push(("event", json!(again(event))));
    let mut json = Vec::new();
    serde_json::Serializer::new(&mut json).collect_map(line)?;
    let shape = match &event.step {
        Step::Sent { .. } => known.and_then(|known| known.request.as_ref()),
        Step::Answered { .. } => known.and_then(|known| known.reply.as_ref()),
        Step::Read { lacking: false, .. } => None,
        _ => return Ok(json),
    };
    append_data(&mut json, data, shape);
    Ok(json)
}

/// An event without its data, for replay.
fn again(event: &Traffic) -> String {
    let mut bytes = Vec::new();
    // What has been read can be written.
    let _ = Coder::default().put(&mut bytes, event.clone(), |_| true);
    STANDARD.encode(bytes)
}

/// What happened to a message, from the line that [`traffic`] made of it.
pub(crate) fn from_line(json: &[u8]) -> Option<Traffic> {
    let line: serde_json::Value = serde_json::from_slice(json).ok()?;
    let bytes = STANDARD.decode(line.get("event")?.as_str()?).ok()?;
    Events::new(&bytes).next().map(|(event, ..)| event)
}

/// The data of the message of a line of [`traffic`]. It stands at the end, so the rest need not be read.
pub(crate) fn data_of(json: &[u8]) -> Option<Vec<u8>> {
    let line = std::str::from_utf8(json).ok()?;
    let (_, data) = line.strip_suffix("\"}")?.rsplit_once(BYTES)?;
    STANDARD.decode(data).ok()
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

/// What stands before the data of a message.
const BYTES: &str = ",\"bytes\":\"";

/// Adds the data of a message to the object that `json` ends with: as JSON where it can be read, and as
/// it is.
fn append_data(json: &mut Vec<u8>, data: &[u8], shape: Option<&Shape>) {
    json.pop();
    json.extend_from_slice(b",\"data\":");
    let readable = shape.filter(|_| data.len() <= SHOWN);
    if readable
        .and_then(|shape| shape.convert(data, json))
        .is_none()
    {
        json.extend_from_slice(b"null");
    }
    // A vector takes all that is written to it.
    let _ = write!(json, "{BYTES}{}\"}}", Base64Display::new(data, &STANDARD));
}
