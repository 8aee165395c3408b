//! The forms that a flight record can have.

use base64::{Engine, engine::general_purpose::STANDARD};
use ctos::time::{Clock, Instant};
use mcap::{WriteOptions, records::MessageHeader};
use serde_json::{Map, Value, json};
use sorma_snapshot::{Layout, Reader, Snapshot};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// The form of a flight record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A line for each record, for people.
    Text,
    /// Comma-separated values with a line of names; bytes in base64.
    Csv,
    /// MCAP with a JSON message for each record; bytes in base64.
    Mcap,
}

/// What the floats are called: the first word of each line of the description. Where that word is missing or
/// was there before, the float's number is added.
fn names(layout: &Layout) -> Vec<String> {
    let mut seen = BTreeSet::new();
    let mut lines = layout.description.lines();
    let name = |float: usize| {
        let word = lines.next().and_then(|line| line.split_whitespace().next());
        let word = word.unwrap_or("f").to_owned();
        let name = if word == "f" || seen.contains(&word) {
            format!("{word}{float}")
        } else {
            word
        };
        seen.insert(name.clone());
        name
    };
    (0..layout.floats).map(name).collect()
}

#[derive(Debug)]
pub(super) struct Sink {
    names: Vec<String>,
    has_bytes: bool,
    clock: Clock,
    out: Out,
}

enum Out {
    Lines {
        format: Format,
        file: Option<BufWriter<File>>,
        text: String,
    },
    Mcap {
        writer: Box<mcap::Writer<BufWriter<File>>>,
        channel: u16,
        flushed: Instant,
    },
}

impl std::fmt::Debug for Out {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Lines { .. } => "Lines",
            Self::Mcap { .. } => "Mcap",
        })
    }
}

/// So often what was recorded as MCAP reaches the file, at the latest.
const FLUSH_NS: u64 = 1_000_000_000;

impl Sink {
    fn new(reader: &Reader, clock: &Clock, out: Out) -> io::Result<Self> {
        let layout = reader.layout();
        let mut sink = Self {
            names: names(layout),
            has_bytes: layout.bytes > 0,
            clock: clock.clone(),
            out,
        };
        if let Out::Lines {
            format: Format::Csv,
            text,
            ..
        } = &mut sink.out
        {
            text.push_str("count,stamp_s,generation,lost");
            for name in &sink.names {
                text.push(',');
                text.push_str(&csv_cell(name));
            }
            text.push_str(if sink.has_bytes { ",bytes\n" } else { "\n" });
        }
        Ok(sink)
    }

    pub(super) fn create(
        path: &Path,
        format: Format,
        reader: &Reader,
        clock: &Clock,
    ) -> io::Result<Self> {
        let mut options = File::options();
        let file = options
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(path)?;
        let file = BufWriter::new(file);
        let out = match format {
            Format::Text | Format::Csv => Out::Lines {
                format,
                file: Some(file),
                text: String::new(),
            },
            Format::Mcap => mcap_file(file, reader, clock).map_err(io::Error::other)?,
        };
        Self::new(reader, clock, out)
    }

    pub(super) fn text(format: Format, reader: &Reader, clock: &Clock) -> io::Result<Self> {
        if format == Format::Mcap {
            return Err(io::Error::other(
                "MCAP is no text; set -file and say EXEC start, or choose -format text or csv",
            ));
        }
        let out = Out::Lines {
            format,
            file: None,
            text: String::new(),
        };
        Self::new(reader, clock, out)
    }

    pub(super) fn into_text(self) -> String {
        match self.out {
            Out::Lines { text, .. } => text,
            Out::Mcap { .. } => String::new(),
        }
    }

    pub(super) fn put(&mut self, record: &Snapshot, lost: u64) -> io::Result<()> {
        let at = record.at(&self.clock);
        match &mut self.out {
            Out::Lines { format, file, text } => {
                match format {
                    Format::Csv => csv_line(text, record, at, lost, self.has_bytes),
                    _ => text_line(text, &self.names, record, at, lost),
                }
                if let Some(file) = file {
                    file.write_all(text.as_bytes())?;
                    text.clear();
                }
                Ok(())
            }
            Out::Mcap {
                writer, channel, ..
            } => {
                let header = MessageHeader {
                    channel_id: *channel,
                    // MCAP's own number wraps; the count is in the message.
                    sequence: (record.count & u64::from(u32::MAX)) as u32,
                    log_time: at.as_nanos(),
                    publish_time: at.as_nanos(),
                };
                let message = message(&self.names, record, lost).to_string();
                writer
                    .write_to_known_channel(&header, message.as_bytes())
                    .map_err(io::Error::other)
            }
        }
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        match &mut self.out {
            Out::Lines { file, text, .. } => {
                let Some(file) = file else {
                    return Ok(());
                };
                file.write_all(text.as_bytes())?;
                text.clear();
                file.flush()
            }
            Out::Mcap {
                writer, flushed, ..
            } => {
                let now = self.clock.now();
                if now.as_nanos().saturating_sub(flushed.as_nanos()) < FLUSH_NS {
                    return Ok(());
                }
                *flushed = now;
                writer.flush().map_err(io::Error::other)
            }
        }
    }

    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        match &mut self.out {
            Out::Lines { .. } => Ok(()),
            Out::Mcap { writer, .. } => writer.finish().map(drop).map_err(io::Error::other),
        }
    }
}

fn mcap_file(file: BufWriter<File>, reader: &Reader, clock: &Clock) -> mcap::McapResult<Out> {
    let mut writer = WriteOptions::new()
        .compression(None)
        .library(concat!("sorma ", env!("CARGO_PKG_VERSION")))
        .create(file)?;
    let schema = schema(reader.layout()).to_string();
    let schema = writer.add_schema("sorma.snapshot", "jsonschema", schema.as_bytes())?;
    let topic = reader.path().file_name().unwrap_or_default();
    let topic = format!("/snapshot/{}", topic.to_string_lossy());
    let channel = writer.add_channel(schema, &topic, "json", &BTreeMap::new())?;
    Ok(Out::Mcap {
        writer: Box::new(writer),
        channel,
        flushed: clock.now(),
    })
}

fn schema(layout: &Layout) -> Value {
    let mut lines = layout.description.lines();
    let floats: Map<String, Value> = names(layout)
        .into_iter()
        .map(|name| {
            let line = lines.next().unwrap_or_default();
            let float = json!({"type": ["number", "string"], "description": line});
            (name, float)
        })
        .collect();
    json!({
        "type": "object",
        "properties": {
            "count": {"type": "integer"},
            "generation": {"type": "integer"},
            "lost": {"type": "integer"},
            "floats": {"type": "object", "properties": floats},
            "opaque": {"type": "string", "contentEncoding": "base64"},
        }
    })
}

fn message(names: &[String], record: &Snapshot, lost: u64) -> Value {
    let floats: Map<String, Value> = names
        .iter()
        .zip(&record.floats)
        .map(|(name, float)| (name.clone(), number(*float)))
        .collect();
    let mut message = json!({
        "count": record.count,
        "generation": record.generation,
        "lost": lost,
        "floats": floats,
    });
    if !record.opaque.is_empty() {
        message["opaque"] = Value::String(STANDARD.encode(&record.opaque));
    }
    message
}

/// JSON has no NaN and no infinity; they are written as words.
fn number(float: f64) -> Value {
    if float.is_finite() {
        json!(float)
    } else {
        Value::String(float.to_string())
    }
}

fn csv_line(out: &mut String, record: &Snapshot, at: Instant, lost: u64, has_bytes: bool) {
    // Writing to a `String` cannot fail.
    let _ = write!(
        out,
        "{},{},{},{lost}",
        record.count,
        seconds(at),
        record.generation
    );
    for float in &record.floats {
        let _ = write!(out, ",{float:?}");
    }
    if has_bytes {
        let _ = write!(out, ",{}", STANDARD.encode(&record.opaque));
    }
    out.push('\n');
}

fn csv_cell(text: &str) -> String {
    if text.contains([',', '"']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn text_line(out: &mut String, names: &[String], record: &Snapshot, at: Instant, lost: u64) {
    let _ = write!(out, "#{} {} s", record.count, seconds(at));
    if record.generation > 1 {
        let _ = write!(out, " writer {}", record.generation);
    }
    if lost > 0 {
        let _ = write!(out, " ({lost} lost before)");
    }
    for (name, float) in names.iter().zip(&record.floats) {
        let _ = write!(out, " {name}={float:?}");
    }
    if !record.opaque.is_empty() {
        let _ = write!(out, " {} bytes", record.opaque.len());
    }
    out.push('\n');
}

/// Seconds with all their nine digits.
fn seconds(at: Instant) -> String {
    let nanos = at.as_nanos();
    format!("{}.{:09}", nanos / 1_000_000_000, nanos % 1_000_000_000)
}
