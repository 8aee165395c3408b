//! The files of a record: begun, filled up to their size, closed, the oldest removed.
//!
//! A disk that is full or broken ends the file at the last whole chunk. A new file is tried every
//! few seconds. What was lost meanwhile is counted, in the log and in the record. Nothing here
//! fails towards the app.

use std::{
    collections::BTreeMap,
    ffi::OsString,
    fs::{File, OpenOptions},
    io::{self, Seek, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use mcap::{
    WriteOptions,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};

use super::{
    counts::{COUNTS, Counts},
    lines::{EVENTS, Schema},
};
use ctos_core::{report::RecordReport, tap::ChannelSchema};
use ctos_time::lock::lock;

/// A chunk is closed at this size at the latest, bytes: no more is lost when a disk is full.
const CHUNK: u64 = 128 * 1024;
/// After a disk has failed, the next file is tried this much later, ns.
const RETRY_NS: u64 = 5_000_000_000;
/// What a line costs in a file besides what it says, bytes: record and index.
const OVERHEAD: u64 = 47;
/// The metadata record that says what a file is a record of.
pub(crate) const RUN: &str = "ctos.run";
/// What says in which format a file is; the first did not say so.
pub(crate) const FORMAT: &str = "format";
/// The format that is written and read: its task ids have 48 bits.
pub(crate) const FORMAT_NOW: &str = "2";
/// The part with which the record begins that a part belongs to.
const FIRST: &str = "first";
/// The metadata record that says what a file lacks.
pub(crate) const LOST: &str = "ctos.lost";

/// The metadata record that says what numbers mean.
pub(crate) const NAMES: &str = "ctos.names";

/// One line of a record, or a stretch of several.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Line<'a> {
    pub(crate) topic: &'a str,
    pub(crate) schema: &'a Schema,
    pub(crate) at: u64,
    pub(crate) bytes: &'a [u8],
    /// How many it stands for.
    pub(crate) lines: u64,
}

/// Writes the lines of one MCAP file.
pub(crate) struct LineWriter<W: Write + Seek> {
    pub(crate) mcap: mcap::Writer<W>,
    /// The channels so far, with the number of lines in each.
    channels: BTreeMap<String, (u16, u32)>,
    /// What is in it, for its end.
    pub(crate) counts: Counts,
}

impl<W: Write + Seek> LineWriter<W> {
    pub(crate) fn new(options: WriteOptions, file: W) -> mcap::McapResult<Self> {
        let mcap = options
            .compression(None)
            .profile("ctos")
            .library(concat!("ctos ", env!("CARGO_PKG_VERSION")))
            .create(file)?;
        Ok(Self {
            mcap,
            channels: BTreeMap::new(),
            counts: Counts::default(),
        })
    }

    /// Closes the file: behind what it holds stands what that is.
    pub(crate) fn finish(&mut self) -> mcap::McapResult<()> {
        self.metadata(COUNTS, self.counts.page())?;
        self.mcap.finish().map(drop)
    }

    pub(crate) fn metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> mcap::McapResult<()> {
        let name = name.to_owned();
        self.mcap.write_metadata(&Metadata { name, metadata })
    }

    /// Events that the record is known to lack.
    pub(crate) fn lost(&mut self, events: u64) -> mcap::McapResult<()> {
        let metadata = BTreeMap::from([("events".to_owned(), events.to_string())]);
        self.metadata(LOST, metadata)
    }

    pub(crate) fn line(
        &mut self,
        topic: &str,
        schema: &ChannelSchema,
        at: u64,
        bytes: &[u8],
    ) -> mcap::McapResult<()> {
        if !self.channels.contains_key(topic) {
            let (language, encoding) = (&schema.language, &schema.encoding);
            let id = self.mcap.add_schema(&schema.name, language, &schema.text)?;
            let none = BTreeMap::new();
            let id = self.mcap.add_channel(id, topic, encoding, &none)?;
            self.channels.insert(topic.to_owned(), (id, 0));
        }
        let (channel_id, sequence) = self.channels.get_mut(topic).map_or((0, 0), |(id, lines)| {
            *lines = lines.wrapping_add(1);
            (*id, *lines)
        });
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: at,
            publish_time: at,
        };
        self.mcap.write_to_known_channel(&header, bytes)?;
        // What is in a stretch is counted by the one who knows.
        if schema.encoding != EVENTS {
            self.counts.add(topic, at, bytes.len());
        }
        Ok(())
    }
}

/// What has not been brought to the disk yet. Writing to it cannot fail, so that the format never breaks
/// off in the middle of something.
#[derive(Clone, Default)]
struct Unwritten(Arc<Mutex<Vec<u8>>>);

impl Write for Unwritten {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        lock(&self.0).write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

struct Part {
    path: PathBuf,
    number: u64,
    file: File,
    writer: LineWriter<NoSeek<Unwritten>>,
    unwritten: Unwritten,
    /// Lines and bytes that it was given.
    lines: u64,
    bytes: u64,
    /// How many of both it had been given when all of it was on the disk.
    safe_lines: u64,
    safe_bytes: u64,
    /// The length of the file then.
    whole: u64,
}

/// A file that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot record to {}: {reason}", .path.display())]
pub(crate) struct PartError {
    path: PathBuf,
    reason: String,
}

impl PartError {
    fn of<E: ToString>(path: &Path) -> impl Fn(E) -> Self {
        move |reason| Self {
            path: path.to_owned(),
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
    /// Events that are missing and of which the record does not say so yet, and why.
    untold: u64,
    why: String,
    /// How the record is, without the present file.
    report: RecordReport,
    /// How many lines there were when the trouble in the report began.
    troubled_at: u64,
}

impl Parts {
    /// Opens the first file. `run` says of what this is the record.
    ///
    /// # Errors
    /// When it cannot be made.
    pub(crate) fn open(place: Place, run: BTreeMap<String, String>) -> Result<Self, PartError> {
        let mut run = run;
        let part = Part::open(&place, &run)?;
        // Later files say to which one they belong.
        run.insert(FIRST.to_owned(), part.number.to_string());
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
            untold: 0,
            why: String::new(),
            troubled_at: 0,
        })
    }

    /// How the record is; of the present file only what is on disk counts.
    pub(crate) fn report(&self) -> RecordReport {
        let mut report = self.report.clone();
        if let Some(part) = &self.part {
            report.lines += part.lines;
            report.bytes += part.whole;
        }
        report
    }

    /// Says what is wrong with the disk, and what to do; the same thing once.
    fn say(&mut self, path: &Path, error: &str, lost: u64) {
        if self.report.trouble.as_deref() == Some(error) {
            tracing::debug!(file = %path.display(), error, lost, "the record cannot go on yet");
            return;
        }
        self.report.trouble = Some(error.to_owned());
        self.troubled_at = self.report().lines;
        let retry_s = RETRY_NS / 1_000_000_000;
        tracing::error!(
            file = %path.display(), error, lost, retry_s,
            "the record broke off; the app goes on without it: make room on its disk, and it goes on in a new file; what is lost meanwhile is counted (`ctos status CHASSIS`)"
        );
    }

    /// So many events are not in the record.
    pub(crate) fn lost(&mut self, count: u64, why: &str) {
        self.untold += count;
        self.report.lost += count;
        why.clone_into(&mut self.why);
    }

    /// Writes in the record, where it can be written, what is missing before this moment.
    pub(crate) fn tell_lost(&mut self, now: u64) {
        if self.untold == 0 || self.part.is_none() {
            return;
        }
        let line = serde_json::json!({ "dropped": self.untold, "why": self.why }).to_string();
        self.untold = 0;
        let line = Line {
            topic: "/recorder",
            schema: &Schema::Recorder,
            at: now,
            bytes: line.as_bytes(),
            lines: 1,
        };
        self.write(now, &line);
    }

    /// Writes one line; it is lost, and counted, when there is no file to write to.
    pub(crate) fn write(&mut self, now: u64, line: &Line<'_>) {
        self.write_stretch(now, line, &Counts::default());
    }

    /// [`Self::write`] of a stretch that holds what is `packed`.
    pub(crate) fn write_stretch(&mut self, now: u64, line: &Line<'_>, packed: &Counts) {
        if !self.ready(now) {
            return self.lost(line.lines, "the disk took nothing more");
        }
        let Some(part) = &mut self.part else { return };
        if let Err(error) = part.write(line, packed) {
            tracing::warn!(topic = line.topic, error = %error, "a line could not be recorded");
            return self.lost(line.lines, "a line could not be recorded");
        }
        if part.bytes >= self.place.max_bytes {
            self.end_part(now);
            self.begin_part(now);
        } else if part.bytes - part.safe_bytes >= CHUNK {
            self.flush_part(now);
        }
    }

    /// Which of the files is written: another number stands for another one, which holds nothing yet.
    pub(crate) fn number(&self) -> u64 {
        self.begun
    }

    /// Puts something into the present file that is not a line.
    pub(crate) fn note(&mut self, name: &str, metadata: BTreeMap<String, String>) {
        if let Some(part) = &mut self.part {
            let bytes: usize = metadata.values().map(String::len).sum();
            part.bytes += u64::try_from(bytes).unwrap_or(u64::MAX / 4);
            if let Err(error) = part.writer.metadata(name, metadata) {
                tracing::warn!(name, error = %error, "metadata could not be recorded");
            }
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
            Err(PartError { path, reason }) => {
                self.say(&path, &reason, self.report.lost);
                self.retry_at = now.saturating_add(RETRY_NS);
            }
        }
    }

    /// Closes the present file in order.
    fn end_part(&mut self, now: u64) {
        if let Some(mut part) = self.part.take() {
            let ended = part.finish(self.report.lost);
            self.leave(now, &part, ended);
        }
    }

    /// Brings to the disk what was written, or gives up a file whose disk has failed.
    fn flush_part(&mut self, now: u64) {
        if let Some(mut part) = self.part.take() {
            match part.flush() {
                Ok(()) => self.part = Some(part),
                failed => self.leave(now, &part, failed),
            }
        }
    }

    /// Leaves a file. One whose disk has failed ends at the last place where it was whole.
    fn leave(&mut self, now: u64, part: &Part, ended: io::Result<()>) {
        self.report.lines += part.safe_lines;
        self.report.bytes += part.whole;
        let Err(error) = ended else { return };
        if let Err(error) = part.file.set_len(part.whole) {
            tracing::warn!(file = %part.path.display(), error = %error, "the broken end of a record was not cut off");
        }
        let (lost, error) = (part.lines - part.safe_lines, error.to_string());
        self.lost(lost, &error);
        self.say(&part.path, &error, lost);
        self.retry_at = now.saturating_add(RETRY_NS);
    }

    /// Brings to the disk what was written.
    pub(crate) fn flush(&mut self, now: u64) {
        self.flush_part(now);
        if let Some(part) = &self.part
            && self.report.trouble.is_some()
            // A disk that takes a beginning and no more has not recovered.
            && self.report().lines > self.troubled_at
            && now >= self.retry_at.saturating_add(RETRY_NS)
        {
            tracing::warn!(file = %part.path.display(), "the record goes on");
            self.report.trouble = None;
        }
    }

    /// Closes the record.
    pub(crate) fn close(&mut self, now: u64) {
        self.tell_lost(now);
        self.end_part(now);
        let lost = self.report.lost;
        if lost > 0 {
            tracing::warn!(lost, "the record is not complete");
        }
    }
}

impl Part {
    fn open(place: &Place, run: &BTreeMap<String, String>) -> Result<Self, PartError> {
        let parts = parts_of(&place.path).map_err(PartError::of(&place.path))?;
        let number = parts.keys().next_back().map_or(1, |last| last + 1);
        let path = part_path(&place.path, number);
        let file = (place.create)(&path).map_err(PartError::of(&path))?;
        // The new one counts too.
        let surplus = (parts.len() + 1).saturating_sub(place.keep.max(1));
        for old in parts.values().take(surplus) {
            if let Err(error) = std::fs::remove_file(old) {
                tracing::warn!(file = %old.display(), error = %error, "an old record was not removed");
            }
        }
        // A chunk ends when it is flushed, so that the writer knows where the file is whole. It is written
        // when it is whole, so a killed process leaves whole chunks.
        let options = WriteOptions::new().chunk_size(None).disable_seeking(true);
        let unwritten = Unwritten::default();
        let writer = LineWriter::new(options, NoSeek::new(unwritten.clone()));
        let mut part = Self {
            writer: writer.map_err(PartError::of(&path))?,
            path,
            number,
            file,
            unwritten,
            lines: 0,
            bytes: 0,
            safe_lines: 0,
            safe_bytes: 0,
            whole: 0,
        };
        let mut run = run.clone();
        run.insert("part".to_owned(), number.to_string());
        run.insert(FORMAT.to_owned(), FORMAT_NOW.to_owned());
        run.entry(FIRST.to_owned())
            .or_insert_with(|| number.to_string());
        let begun = part.writer.metadata(RUN, run).map_err(io::Error::other);
        if let Err(error) = begun.and_then(|()| part.flush()) {
            // Nothing is in it.
            let _ = std::fs::remove_file(&part.path);
            return Err(PartError::of(&part.path)(error));
        }
        Ok(part)
    }

    fn write(&mut self, line: &Line<'_>, packed: &Counts) -> mcap::McapResult<()> {
        self.writer
            .line(line.topic, &line.schema.text(), line.at, line.bytes)?;
        self.writer.counts.extend(packed);
        self.bytes += OVERHEAD + u64::try_from(line.bytes.len()).unwrap_or(u64::MAX / 4);
        self.lines += line.lines;
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.mcap.flush().map_err(io::Error::other)?;
        self.write_out()?;
        (self.safe_lines, self.safe_bytes) = (self.lines, self.bytes);
        Ok(())
    }

    fn finish(&mut self, lost: u64) -> io::Result<()> {
        self.writer.lost(lost).map_err(io::Error::other)?;
        self.flush()?;
        self.writer.finish().map_err(io::Error::other)?;
        self.write_out()
    }

    fn write_out(&mut self) -> io::Result<()> {
        let mut unwritten = lock(&self.unwritten.0);
        self.file.write_all(&unwritten)?;
        self.whole += u64::try_from(unwritten.len()).unwrap_or(0);
        unwritten.clear();
        Ok(())
    }
}

/// Part 1 has the name as it is; part N has `.partN` before the extension.
fn part_path(path: &Path, number: u64) -> PathBuf {
    if number == 1 {
        return path.to_owned();
    }
    suffixed(path, &format!("part{number}"))
}

/// `run.mcap` becomes `run.SUFFIX.mcap`.
pub(crate) fn suffixed(path: &Path, suffix: &str) -> PathBuf {
    let mut name: OsString = path.file_stem().unwrap_or_default().to_owned();
    name.push(".");
    name.push(suffix);
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
    let folder = path.parent().unwrap_or(Path::new(""));
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut parts = BTreeMap::new();
    for entry in std::fs::read_dir(Path::new(".").join(folder))? {
        let there = entry?.path();
        if there.extension() != path.extension() {
            continue;
        }
        let name = there.file_stem().unwrap_or_default().to_string_lossy();
        let number = match name.strip_prefix(&*stem) {
            Some("") => Some(1),
            rest => rest
                .and_then(|rest| rest.strip_prefix(".part"))
                .and_then(|number| number.parse().ok()),
        };
        let name = there.file_name().unwrap_or_default();
        parts.extend(number.map(|number| (number, path.with_file_name(name))));
    }
    Ok(parts)
}

#[cfg(test)]
mod tests;
