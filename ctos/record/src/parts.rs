//! The files of a record: begun, filled up to their size, closed, the oldest removed.
//!
//! A disk that is full or broken ends the file at the last chunk that is whole; a new one is tried
//! every few seconds, and what was lost meanwhile is counted, in the log and in the record. Nothing
//! here fails towards the app.

use std::{
    collections::BTreeMap,
    ffi::OsString,
    fs::{File, OpenOptions},
    io::{self, BufWriter, Seek, SeekFrom, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use mcap::{
    WriteOptions,
    records::{MessageHeader, Metadata},
};

use super::lines::{RECORDER, Schema};
use ctos_core::report::RecordReport;
use ctos_time::lock::lock;

/// A chunk is closed at this size at the latest, bytes: no more is lost when a disk is full.
const CHUNK: u64 = 128 * 1024;
/// After a disk has failed, the next file is tried this much later, ns.
const RETRY_NS: u64 = 5_000_000_000;
/// What a line costs in a file besides what it says, bytes: record and index.
const OVERHEAD: u64 = 47;
/// The metadata record that says what a file is a record of.
pub(crate) const RUN: &str = "ctos.run";
/// The metadata record that says what a file lacks.
pub(crate) const LOST: &str = "ctos.lost";

/// The metadata record that says what numbers mean.
pub(crate) const NAMES: &str = "ctos.names";

/// One line of a record, or a stretch of several.
pub(crate) struct Line<'a> {
    pub(crate) topic: &'a str,
    pub(crate) schema: Schema,
    pub(crate) at: u64,
    pub(crate) bytes: &'a [u8],
    /// How many it stands for.
    pub(crate) lines: u64,
}

/// A file that remembers its first error and swallows what comes afterwards: whoever writes formats
/// through it need not survive errors in the middle of them.
struct Sink {
    file: File,
    state: Arc<SinkState>,
}

#[derive(Default)]
struct SinkState {
    written: AtomicU64,
    error: Mutex<Option<String>>,
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut error = lock(&self.state.error);
        if error.is_none() {
            match self.file.write_all(bytes) {
                Ok(()) => {
                    let length = u64::try_from(bytes.len()).unwrap_or(u64::MAX);
                    self.state.written.fetch_add(length, Ordering::Relaxed);
                }
                Err(failed) => *error = Some(failed.to_string()),
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Says where it is, and goes nowhere: chunks are written whole.
impl Seek for Sink {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        if to != SeekFrom::Current(0) {
            let mut error = lock(&self.state.error);
            error.get_or_insert_with(|| {
                "a record is written from its beginning to its end".to_owned()
            });
        }
        Ok(self.state.written.load(Ordering::Relaxed))
    }
}

struct Channel {
    id: u16,
    sequence: u32,
}

struct Part {
    path: PathBuf,
    writer: mcap::Writer<BufWriter<Sink>>,
    sink: Arc<SinkState>,
    channels: BTreeMap<String, Channel>,
    schemas: BTreeMap<&'static str, u16>,
    bytes: u64,
    /// The length of the file when all of it was whole, and how many lines and bytes came since.
    whole: u64,
    unsafe_lines: u64,
    unsafe_bytes: u64,
    /// Lines that it was given.
    lines: u64,
}

/// A file that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot record to {path}: {reason}")]
pub(crate) struct PartError {
    path: String,
    reason: String,
}

impl PartError {
    fn new(path: &Path, reason: impl ToString) -> Self {
        Self {
            path: path.display().to_string(),
            reason: reason.to_string(),
        }
    }
}

/// Makes a file that is not there yet.
type Create = Box<dyn Fn(&Path) -> io::Result<File> + Send>;

/// Where a record's files go and how many there may be.
pub(crate) struct Place {
    /// The name without part number.
    pub(crate) path: PathBuf,
    pub(crate) max_bytes: u64,
    pub(crate) keep: usize,
    pub(crate) create: Create,
}

impl Place {
    /// Files of this user alone.
    pub(crate) fn new(path: PathBuf, max_bytes: u64, keep: usize) -> Self {
        let create = |path: &Path| {
            let mut options = OpenOptions::new();
            options.write(true).create_new(true).mode(0o600).open(path)
        };
        Self {
            path,
            max_bytes,
            keep,
            create: Box::new(create),
        }
    }
}

/// The files of one record.
pub(crate) struct Parts {
    place: Place,
    run: BTreeMap<String, String>,
    part: Option<Part>,
    /// Files that were begun.
    begun: u64,
    retry_at: u64,
    lost: u64,
    lost_in_all: u64,
    why: String,
    /// How the record is; of the present file only what is on disk counts.
    report: RecordReport,
    /// What was said last of a disk that takes nothing, and how many lines there were then: the same is
    /// said once.
    told: Option<(String, u64)>,
}

impl Parts {
    /// Opens the first file. `run` says of what this is the record.
    ///
    /// # Errors
    /// When it cannot be made.
    pub(crate) fn open(place: Place, run: BTreeMap<String, String>) -> Result<Self, PartError> {
        let part = Part::open(&place, &run)?;
        Ok(Self {
            place,
            run,
            report: RecordReport {
                file: part.path.display().to_string(),
                ..RecordReport::default()
            },
            part: Some(part),
            begun: 1,
            retry_at: 0,
            lost: 0,
            lost_in_all: 0,
            why: String::new(),
            told: None,
        })
    }

    /// Events that are not in the record.
    pub(crate) fn lost_in_all(&self) -> u64 {
        self.lost_in_all
    }

    /// How the record is.
    pub(crate) fn report(&self) -> RecordReport {
        let mut report = self.report.clone();
        report.lost = self.lost_in_all;
        if let Some(part) = &self.part {
            report.lines += part.lines;
            report.bytes += part.sink.written.load(Ordering::Relaxed);
        }
        report
    }

    /// Says what is wrong with the disk, and what to do; the same thing once.
    fn say(&mut self, path: &Path, error: &str, lost: u64) {
        self.report.trouble = Some(error.to_owned());
        let told = self.told.as_ref().map(|(told, _)| told.as_str());
        if told == Some(error) {
            tracing::debug!(file = %path.display(), error, lost, "the record cannot go on yet");
            return;
        }
        self.told = Some((error.to_owned(), self.report().lines));
        let retry_s = RETRY_NS / 1_000_000_000;
        tracing::error!(
            file = %path.display(), error, lost, retry_s,
            "the record broke off; the app goes on without it: make room on its disk, and it goes on in a new file; what is lost meanwhile is counted (`ctos status CHASSIS`)"
        );
    }

    /// So many events are not in the record.
    pub(crate) fn lost(&mut self, count: u64, why: &str) {
        self.lost += count;
        self.lost_in_all += count;
        why.clone_into(&mut self.why);
    }

    /// Writes in the record, where it can be written, what is missing before this moment.
    pub(crate) fn tell_lost(&mut self, now: u64) {
        if self.lost == 0 || self.part.is_none() {
            return;
        }
        let line = serde_json::json!({ "dropped": self.lost, "why": self.why }).to_string();
        self.lost = 0;
        self.write(
            now,
            &Line {
                topic: "/recorder",
                schema: RECORDER,
                at: now,
                bytes: line.as_bytes(),
                lines: 1,
            },
        );
    }

    /// Writes one line; it is lost, and counted, when there is no file to write to.
    pub(crate) fn write(&mut self, now: u64, line: &Line<'_>) {
        if !self.ready(now) {
            return self.lost(line.lines, "the disk took nothing more");
        }
        let full = match &mut self.part {
            Some(part) => match part.write(line) {
                Ok(()) => part.bytes >= self.place.max_bytes,
                Err(error) => {
                    tracing::warn!(topic = line.topic, error = %error, "a line could not be recorded");
                    return self.lost(line.lines, "a line could not be recorded");
                }
            },
            None => return,
        };
        self.check(now);
        if full {
            self.end_part(now);
            self.begin_part(now);
        }
    }

    /// Which of the files is written: another number stands for another one, which holds nothing yet.
    pub(crate) fn number(&self) -> u64 {
        self.begun
    }

    /// Puts something into the present file that is no line.
    pub(crate) fn note(&mut self, name: &str, metadata: BTreeMap<String, String>) {
        if let Some(part) = &mut self.part {
            let bytes: usize = metadata.values().map(String::len).sum();
            part.bytes += u64::try_from(bytes).unwrap_or(u64::MAX / 4);
            part.metadata(name, metadata);
        }
    }

    /// Whether there is a file; a new one is tried when it is time.
    pub(crate) fn ready(&mut self, now: u64) -> bool {
        if self.part.is_none() && now >= self.retry_at {
            self.begin_part(now);
        }
        self.part.is_some()
    }

    fn begin_part(&mut self, now: u64) {
        match Part::open(&self.place, &self.run) {
            Ok(part) => {
                self.report.file = part.path.display().to_string();
                self.part = Some(part);
                self.begun += 1;
            }
            Err(error) => {
                let path = PathBuf::from(&error.path);
                self.say(&path, &error.reason, self.lost_in_all);
                self.retry_at = now.saturating_add(RETRY_NS);
            }
        }
    }

    /// Closes the present file in order.
    fn end_part(&mut self, now: u64) {
        let lost = self.lost_in_all.to_string();
        let Some(mut part) = self.part.take() else {
            return;
        };
        part.metadata(LOST, BTreeMap::from([("events".to_owned(), lost)]));
        part.flush();
        let (path, lost, sink) = (part.path.clone(), part.unsafe_lines, part.sink.clone());
        let (whole, lines) = (part.whole, part.lines);
        part.finish();
        let error = lock(&sink.error).clone();
        match error {
            Some(error) => {
                self.account(lines.saturating_sub(lost), whole);
                self.broke_off(now, &path, whole, lost, &error);
            }
            None => self.account(lines, sink.written.load(Ordering::Relaxed)),
        }
    }

    /// A file is left with so many lines and bytes in it.
    fn account(&mut self, lines: u64, bytes: u64) {
        self.report.lines += lines;
        self.report.bytes += bytes;
    }

    /// Gives up a file whose disk has failed.
    fn check(&mut self, now: u64) {
        if let Some(part) = self.part.take_if(|part| part.error().is_some()) {
            let error = part.error().unwrap_or_default();
            let (path, whole, lost) = (part.path.clone(), part.whole, part.unsafe_lines);
            self.account(part.lines.saturating_sub(lost), whole);
            // What it still writes at its end, the sink swallows.
            drop(part);
            self.broke_off(now, &path, whole, lost, &error);
        }
    }

    /// Ends a file at the last place where it was whole.
    fn broke_off(&mut self, now: u64, path: &Path, whole: u64, lines: u64, error: &str) {
        let cut = OpenOptions::new().write(true).open(path);
        if let Err(error) = cut.and_then(|file| file.set_len(whole)) {
            tracing::warn!(file = %path.display(), error = %error, "the broken end of a record was not cut off");
        }
        self.lost(lines, error);
        self.say(path, error, lines);
        self.retry_at = now.saturating_add(RETRY_NS);
    }

    /// Brings to the disk what was written.
    pub(crate) fn flush(&mut self, now: u64) {
        if let Some(part) = &mut self.part {
            part.flush();
        }
        self.check(now);
        let lines = self.report().lines;
        if let (Some(part), Some((_, then))) = (&self.part, &self.told)
            // A disk that takes a beginning and no more has not recovered.
            && lines > *then
            && now >= self.retry_at.saturating_add(RETRY_NS)
        {
            tracing::warn!(file = %part.path.display(), "the record goes on");
            self.told = None;
            self.report.trouble = None;
        }
    }

    /// Closes the record.
    pub(crate) fn close(&mut self, now: u64) {
        self.tell_lost(now);
        self.end_part(now);
        if self.lost_in_all > 0 {
            let lost = self.lost_in_all;
            tracing::warn!(lost, "the record is not complete");
        }
    }
}

impl Part {
    fn open(place: &Place, run: &BTreeMap<String, String>) -> Result<Self, PartError> {
        let parts = parts_of(&place.path).map_err(|error| PartError::new(&place.path, error))?;
        let number = parts.keys().next_back().map_or(1, |last| last + 1);
        let path = part_path(&place.path, number);
        let file = (place.create)(&path).map_err(|error| PartError::new(&path, error))?;
        // The new one counts too.
        let surplus = (parts.len() + 1).saturating_sub(place.keep.max(1));
        for old in parts.values().take(surplus) {
            if let Err(error) = std::fs::remove_file(old) {
                tracing::warn!(file = %old.display(), error = %error, "an old record was not removed");
            }
        }
        let state = Arc::<SinkState>::default();
        let sink = Sink {
            file,
            state: state.clone(),
        };
        let writer = WriteOptions::new()
            .compression(None)
            .profile("ctos")
            .library(concat!("ctos ", env!("CARGO_PKG_VERSION")))
            // A chunk ends when it is flushed, so that it is known where the file is whole.
            .chunk_size(None)
            // A chunk is written when it is whole: a process that is killed leaves whole ones.
            .disable_seeking(true)
            .create(BufWriter::new(sink))
            .map_err(|error| PartError::new(&path, error))?;
        let mut part = Self {
            path,
            writer,
            sink: state,
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            bytes: 0,
            whole: 0,
            unsafe_lines: 0,
            unsafe_bytes: 0,
            lines: 0,
        };
        let mut run = run.clone();
        run.insert("part".to_owned(), number.to_string());
        part.metadata(RUN, run);
        part.flush();
        if let Some(error) = part.error() {
            // Nothing is in it.
            let _ = std::fs::remove_file(&part.path);
            return Err(PartError::new(&part.path, error));
        }
        Ok(part)
    }

    fn write(&mut self, line: &Line<'_>) -> mcap::McapResult<()> {
        let header = self.header(line)?;
        self.writer.write_to_known_channel(&header, line.bytes)?;
        let bytes = OVERHEAD + u64::try_from(line.bytes.len()).unwrap_or(u64::MAX / 4);
        self.bytes += bytes;
        self.unsafe_bytes += bytes;
        self.unsafe_lines += line.lines;
        self.lines += line.lines;
        if self.unsafe_bytes >= CHUNK {
            self.flush();
        }
        Ok(())
    }

    fn header(&mut self, line: &Line<'_>) -> mcap::McapResult<MessageHeader> {
        if !self.channels.contains_key(line.topic) {
            let schema = match self.schemas.get(line.schema.name) {
                Some(id) => *id,
                None => {
                    let text = line.schema.text.as_bytes();
                    let Schema { name, language, .. } = line.schema;
                    let id = self.writer.add_schema(name, language, text)?;
                    self.schemas.insert(name, id);
                    id
                }
            };
            let id = self.writer.add_channel(
                schema,
                line.topic,
                line.schema.encoding,
                &BTreeMap::new(),
            )?;
            let channel = Channel { id, sequence: 0 };
            self.channels.insert(line.topic.to_owned(), channel);
        }
        let channel = self.channels.get_mut(line.topic);
        let (channel_id, sequence) = channel.map_or((0, 0), |channel| {
            channel.sequence = channel.sequence.wrapping_add(1);
            (channel.id, channel.sequence)
        });
        Ok(MessageHeader {
            channel_id,
            sequence,
            log_time: line.at,
            publish_time: line.at,
        })
    }

    fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) {
        let metadata = Metadata {
            name: name.to_owned(),
            metadata,
        };
        // The sink keeps the error, if there is one.
        let _ = self.writer.write_metadata(&metadata);
    }

    fn error(&self) -> Option<String> {
        lock(&self.sink.error).clone()
    }

    fn flush(&mut self) {
        // The sink keeps the error, if there is one.
        let _ = self.writer.flush();
        if self.error().is_none() {
            self.whole = self.sink.written.load(Ordering::Relaxed);
            self.unsafe_lines = 0;
            self.unsafe_bytes = 0;
        }
    }

    fn finish(mut self) {
        // The sink keeps the error, if there is one.
        let _ = self.writer.finish();
        let _ = self.writer.into_inner().flush();
    }
}

/// Part 1 has the name as it is; part N has `.partN` before the extension.
fn part_path(path: &Path, number: u64) -> PathBuf {
    if number == 1 {
        return path.to_owned();
    }
    let mut name: OsString = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!(".part{number}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// The parts of a record that are there, by number.
///
/// # Errors
/// When the folder cannot be read.
pub(crate) fn parts_of(path: &Path) -> io::Result<BTreeMap<u64, PathBuf>> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut parts = BTreeMap::new();
    for entry in std::fs::read_dir(folder)? {
        let there = entry?.path();
        if there.extension() != path.extension() {
            continue;
        }
        let name = there.file_stem().unwrap_or_default().to_string_lossy();
        let number = match name.strip_prefix(&*stem) {
            Some("") => Some(1),
            Some(rest) => rest
                .strip_prefix(".part")
                .and_then(|number| number.parse().ok()),
            None => None,
        };
        if let Some(number) = number {
            parts.insert(
                number,
                path.with_file_name(there.file_name().unwrap_or_default()),
            );
        }
    }
    Ok(parts)
}

#[cfg(test)]
mod tests;
