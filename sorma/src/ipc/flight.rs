//! The flight recorder of snapshot buffers: what is in one, and what comes, as lines of text, as CSV or as
//! MCAP. It is a library and the class `flight`.

mod sink;

use super::answer::{code, int, number, split, wrong};
use super::host::{Host, buffer, buffer_error};
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::report::Report;
use crate::transport::Transport;
use ctos::time::Clock;
pub use sink::Format;
use sink::Sink;
use sorma_snapshot::{Reader, Snapshot, Waited, WriterState};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};
use std::thread::JoinHandle;
use std::time::Duration;

/// How long a recorder that follows waits before it looks whether it is to stop.
const PATIENCE: Duration = Duration::from_millis(20);

/// Writes the records of a buffer to a file as they come.
#[derive(Debug)]
pub struct Recorder {
    reader: Reader,
    sink: Sink,
    clock: Clock,
    record: Snapshot,
}

/// What a recorder has done so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Recorded {
    /// Records written.
    pub records: u64,
    /// Records lost, because the writer was faster.
    pub lost: u64,
}

impl Recorder {
    /// Begins a new file, with the oldest record that `reader` still has.
    ///
    /// # Errors
    /// The file is there already, or cannot be made.
    pub fn create(reader: Reader, path: &Path, format: Format, clock: &Clock) -> io::Result<Self> {
        let sink = Sink::create(path, format, &reader, clock)?;
        Ok(Self {
            reader,
            sink,
            clock: clock.clone(),
            record: Snapshot::default(),
        })
    }

    /// Writes what has come since the last time; at most as many as the buffer holds.
    ///
    /// # Errors
    /// The disk is full, or the writer overwrites its records faster than they can be read.
    pub fn collect(&mut self) -> io::Result<Recorded> {
        let mut done = Recorded::default();
        let most = self.reader.layout().slots as u64;
        while done.records < most
            && let Some(lost) = self
                .reader
                .next(&mut self.record)
                .map_err(io::Error::other)?
        {
            self.sink.put(&self.record, lost)?;
            done.records += 1;
            done.lost += lost;
        }
        self.sink.flush()?;
        Ok(done)
    }

    /// Follows the buffer until `stop` is set or its writer has ended orderly; after a writer that died
    /// it waits for the next one. The thread does nothing else, so it is one made for it.
    ///
    /// # Errors
    /// As [`collect`](Self::collect).
    pub fn follow(&mut self, stop: &AtomicBool, done: impl Fn(Recorded)) -> io::Result<()> {
        loop {
            done(self.collect()?);
            if stop.load(Ordering::Acquire) {
                return Ok(());
            }
            if let Waited::Ended(WriterState::Closed | WriterState::Replaced) =
                self.reader.wait(PATIENCE, &self.clock)
            {
                done(self.collect()?);
                return Ok(());
            }
        }
    }

    /// Writes the end of the file, where its format has one.
    ///
    /// # Errors
    /// The disk is full.
    pub fn finish(mut self) -> io::Result<()> {
        self.sink.finish()
    }
}

/// The most recent `most` records of a buffer, as text or CSV.
///
/// # Errors
/// MCAP is no text.
pub fn dump(reader: &Reader, most: u64, format: Format, clock: &Clock) -> io::Result<String> {
    let mut sink = Sink::text(format, reader, clock)?;
    let mut record = Snapshot::default();
    let mut result = Ok(());
    let mut last = None;
    reader.history(most, &mut record, |record| {
        let lost = last.map_or(0, |last| record.count - last - 1);
        last = Some(record.count);
        if result.is_ok() {
            result = sink.put(record, lost);
        }
    });
    result?;
    Ok(sink.into_text())
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Settings {
    app: String,
    name: String,
    file: String,
    format: String,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            app: String::new(),
            name: String::new(),
            file: String::new(),
            format: "text".to_owned(),
        }
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Settings>> = LazyLock::new(|| {
    OptionTable::new(
        "records a snapshot buffer. EXEC dump [N]: the recent records as text; start: writes all that come to -file \
         until stop, in a thread of its own (in virtual time: whenever EXEC collect is said); collect, stop and \
         status answer IMSG 2: records written, records lost; segments: all buffers of the app; sweep: removes those \
         that have no writer and were silent for 10 minutes, and answers their names",
    )
    .word(
        "app",
        "APP",
        "the app whose buffer it is; this one when empty",
        |set: &mut Settings| &mut set.app,
    )
    .word(
        "name",
        "BUFFER",
        "name of the buffer; the flavor when empty",
        |set| &mut set.name,
    )
    .word(
        "file",
        "FILE",
        "where start writes to; it must not be there yet",
        |set| &mut set.file,
    )
    .choice(
        "format",
        &["text", "csv", "mcap"],
        "lines for people, comma-separated values, or MCAP",
        |set| &mut set.format,
    )
});

/// What a thread that follows tells.
#[derive(Debug, Default)]
struct Progress {
    stop: AtomicBool,
    records: AtomicU64,
    lost: AtomicU64,
}

impl Progress {
    fn add(&self, done: Recorded) {
        self.records.fetch_add(done.records, Ordering::Relaxed);
        self.lost.fetch_add(done.lost, Ordering::Relaxed);
    }
}

enum Work {
    Idle,
    /// In virtual time, where nothing happens by itself.
    Collecting(Box<Recorder>),
    Following(JoinHandle<io::Result<()>>),
}

pub(super) struct Flight {
    host: Host,
    flavor: String,
    settings: Settings,
    work: Work,
    progress: Arc<Progress>,
}

impl Flight {
    pub(super) fn new(host: Host, flavor: String) -> Self {
        Self {
            host,
            flavor,
            settings: Settings::default(),
            work: Work::Idle,
            progress: Arc::default(),
        }
    }

    fn reader(&self) -> Result<Reader, Report> {
        let name = buffer(&self.settings.name, &self.flavor);
        let opened = self
            .host
            .place()
            .and_then(|place| Reader::open(&place, name));
        opened.map_err(|error| buffer_error(&error))
    }

    fn format(&self) -> Format {
        match self.settings.format.as_str() {
            "csv" => Format::Csv,
            "mcap" => Format::Mcap,
            _ => Format::Text,
        }
    }

    fn dump_recent(&self, most: u64) -> Result<String, Report> {
        let reader = self.reader()?;
        dump(&reader, most, self.format(), &self.host.clock)
            .map_err(|error| wrong(error.to_string()))
    }

    /// A line for each buffer of the app.
    fn segments(&self) -> Result<String, Report> {
        let listed = self
            .host
            .place_of(&self.settings.app)
            .and_then(|place| place.segments());
        let listed = listed.map_err(|error| buffer_error(&error))?;
        let lines = listed.iter().map(|one| {
            let writer = if one.is_written {
                format!("written by {}", one.writer)
            } else {
                format!("no writer; the last was {}", one.writer)
            };
            let age = one.age.map_or_else(String::new, |age| {
                format!(", the latest {:.3} s old", age.as_secs_f64())
            });
            format!("{}: {} records{age}, {writer}", one.name, one.head)
        });
        Ok(lines.collect::<Vec<_>>().join("\n"))
    }

    fn start(&mut self) -> Outcome {
        if !matches!(self.work, Work::Idle) {
            return Err(wrong("it records already; EXEC stop ends that"));
        }
        if self.settings.file.is_empty() {
            return Err(wrong("it has no file to write to; CTRL -file FILE"));
        }
        let reader = self.reader()?;
        let path = Path::new(&self.settings.file);
        let mut recorder = Recorder::create(reader, path, self.format(), &self.host.clock)
            .map_err(|error| self.disk(&error))?;
        self.progress = Arc::default();
        let progress = Arc::clone(&self.progress);
        self.work = if self.host.clock.origin_ns().is_none() {
            Work::Collecting(Box::new(recorder))
        } else {
            let following =
                std::thread::Builder::new()
                    .name("flight".to_owned())
                    .spawn(move || {
                        recorder.follow(&progress.stop, |done| progress.add(done))?;
                        recorder.finish()
                    });
            Work::Following(following.map_err(|error| self.disk(&error))?)
        };
        Ok(())
    }

    fn collect(&mut self) -> Outcome {
        if let Work::Collecting(recorder) = &mut self.work {
            let done = recorder.collect();
            let done = done.map_err(|error| self.disk(&error))?;
            self.progress.add(done);
        }
        Ok(())
    }

    fn stop(&mut self) -> Outcome {
        self.collect()?;
        self.progress.stop.store(true, Ordering::Release);
        let ended = match std::mem::replace(&mut self.work, Work::Idle) {
            Work::Idle => return Err(wrong("it does not record; EXEC start begins")),
            Work::Collecting(recorder) => recorder.finish(),
            // Not longer than its patience and what the disk takes.
            Work::Following(thread) => thread
                .join()
                .unwrap_or_else(|_| Err(io::Error::other("the recorder's thread has panicked"))),
        };
        ended.map_err(|error| self.disk(&error))
    }

    #[track_caller]
    fn disk(&self, error: &io::Error) -> Report {
        Report::error(code::FILE, format!("`{}`: {error}", self.settings.file))
    }

    fn state(&self) -> &'static str {
        match &self.work {
            Work::Idle => "idle",
            Work::Following(thread) if thread.is_finished() => "ended; EXEC stop tells how",
            Work::Collecting(_) | Work::Following(_) => "recording",
        }
    }
}

impl ServiceObject for Flight {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let words = split(&io.text)?;
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match words.as_slice() {
            ["dump"] => {
                io.text = self.dump_recent(u64::MAX)?;
                return Ok(());
            }
            ["dump", most] => {
                io.text = self.dump_recent(number("how many records", most)?)?;
                return Ok(());
            }
            ["segments"] => {
                io.text = self.segments()?;
                return Ok(());
            }
            ["sweep"] => {
                let removed = self
                    .host
                    .place_of(&self.settings.app)
                    .and_then(|place| place.remove_stale());
                io.text = removed.map_err(|error| buffer_error(&error))?.join(" ");
                return Ok(());
            }
            ["start"] => self.start()?,
            ["collect"] => self.collect()?,
            ["stop"] => self.stop()?,
            ["status"] => {}
            _ => {
                return Err(wrong(format!(
                    "EXEC takes dump [N], start, collect, stop, status, segments or sweep, not `{}`",
                    io.text
                )));
            }
        }
        self.state().clone_into(&mut io.text);
        let progress = &self.progress;
        let counts = [&progress.records, &progress.lost];
        io.ints = counts
            .map(|count| int(count.load(Ordering::Relaxed)))
            .to_vec();
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(&mut self.settings, io);
        Ok(())
    }

    fn dump(&self) -> String {
        OPTIONS.dump(&self.settings)
    }
}

impl Drop for Flight {
    fn drop(&mut self) {
        if !matches!(self.work, Work::Idle)
            && let Err(report) = self.stop()
        {
            tracing::warn!(error = report.text, "a flight record has no proper end");
        }
    }
}
