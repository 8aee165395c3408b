//! The class `shmem_r`: reads records from a snapshot buffer.

use super::answer::{NOT_YET, code, int, number, split, wrong};
use super::host::{Host, buffer, buffer_error};
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::report::Report;
use crate::transport::Transport;
use ctos::time::Clock;
use sorma_snapshot::{Reader, Snapshot, SnapshotError, WriterState};
use std::sync::LazyLock;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Settings {
    app: String,
    name: String,
    floats: i64,
    bytes: i64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            app: String::new(),
            name: String::new(),
            floats: -1,
            bytes: -1,
        }
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Settings>> = LazyLock::new(|| {
    OptionTable::new(
        "reads records from a snapshot buffer. EXEC latest, next, all, since COUNT or history N answers FMSG: the \
         floats of the records, one after the other; opaque: their bytes; IMSG, 6 for each record: its number, when \
         it was written (ns of the app's time), its age (ns), the generation of its writer, how many were lost \
         before it, its bytes. EXEC status tells about the buffer",
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
    .int(
        "floats",
        -1..=i64::MAX,
        "",
        "floats that a record must have; -1: any number",
        |set| &mut set.floats,
    )
    .int(
        "bytes",
        -1..=i64::MAX,
        "bytes",
        "the most bytes that a record must be able to have; -1: any number",
        |set| &mut set.bytes,
    )
});

/// What EXEC is asked for.
enum Wanted {
    Latest,
    Next,
    All,
    Since(u64),
    History(u64),
    Status,
}

impl Wanted {
    fn parse(text: &str) -> Result<Self, Report> {
        // The two that a servo loop asks for must not allocate.
        match text {
            "" | "latest" => return Ok(Self::Latest),
            "next" => return Ok(Self::Next),
            _ => {}
        }
        let words = split(text)?;
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match words.as_slice() {
            ["all"] => Ok(Self::All),
            ["status"] => Ok(Self::Status),
            ["since", count] => Ok(Self::Since(number("the number of a record", count)?)),
            ["history", most] => Ok(Self::History(number("how many records", most)?)),
            _ => Err(wrong(format!(
                "EXEC takes latest, next, all, since COUNT, history N or status, not `{text}`"
            ))),
        }
    }
}

pub(super) struct ShmemR {
    host: Host,
    flavor: String,
    settings: Settings,
    reader: Option<Reader>,
    generation: u64,
    record: Snapshot,
}

impl ShmemR {
    pub(super) fn new(host: Host, flavor: String) -> Self {
        Self {
            host,
            flavor,
            settings: Settings::default(),
            reader: None,
            generation: 0,
            record: Snapshot::default(),
        }
    }

    fn open(&self) -> Result<Reader, Report> {
        let set = &self.settings;
        let name = buffer(&set.name, &self.flavor);
        let opened = self.host.place_of(&set.app).and_then(|place| {
            let reader = Reader::open(&place, name)?;
            let has = reader.layout();
            let floats = usize::try_from(set.floats).unwrap_or(has.floats);
            let bytes = usize::try_from(set.bytes).unwrap_or(has.bytes);
            Reader::open_as(&place, name, floats, bytes)
        });
        opened.map_err(|error| buffer_error(&error))
    }

    /// Opens the buffer, or another that has taken its place, and says so.
    fn prepare(&mut self, io: &mut Transport) -> Outcome {
        let Some(reader) = &self.reader else {
            let reader = self.open()?;
            self.generation = reader.generation();
            self.reader = Some(reader);
            return Ok(());
        };
        let nothing_new = reader.head() == reader.position();
        if nothing_new
            && reader.is_over()
            && let Ok(reader) = self.open()
        {
            let text = format!(
                "the buffer was made anew, with {} floats and up to {} bytes; its numbers begin again",
                reader.layout().floats,
                reader.layout().bytes
            );
            io.report(Report::warning(code::SUCCEEDED, text));
            self.generation = reader.generation();
            self.reader = Some(reader);
        }
        Ok(())
    }

    fn read(&mut self, wanted: &Wanted, io: &mut Transport) -> Result<u64, Report> {
        let Some(reader) = &mut self.reader else {
            return Ok(0);
        };
        let record = &mut self.record;
        let clock = &self.host.clock;
        let mut lost_in_all = 0;
        let found = match wanted {
            Wanted::Latest => reader
                .latest(record)
                .map(|is_there| u64::from(is_there && put(io, record, 0, clock))),
            Wanted::Next => reader.next(record).map(|lost| {
                lost_in_all = lost.unwrap_or(0);
                lost.map_or(0, |lost| u64::from(put(io, record, lost, clock)))
            }),
            Wanted::History(most) => Ok(reader.history(*most, record, |record| {
                put(io, record, 0, clock);
            })),
            Wanted::All | Wanted::Since(_) => {
                if let Wanted::Since(count) = wanted {
                    reader.seek(*count);
                }
                each(reader, record, &mut lost_in_all, |record, lost| {
                    put(io, record, lost, clock);
                })
            }
            Wanted::Status => Ok(0),
        };
        if lost_in_all > 0 {
            let text = format!("{lost_in_all} records were overwritten before they were read");
            io.report(Report::warning(code::LOST, text));
        }
        found.map_err(|error| buffer_error(&error))
    }

    fn tell_successor(&mut self, io: &mut Transport) {
        let Some(reader) = &self.reader else {
            return;
        };
        let generation = reader.generation();
        if generation != self.generation {
            self.generation = generation;
            let text = format!("writer {generation} of the buffer has taken over");
            io.report(Report::warning(code::SUCCEEDED, text));
        }
    }

    fn status(&self) -> String {
        let Some(reader) = &self.reader else {
            return String::new();
        };
        let layout = reader.layout();
        let writer = match reader.writer() {
            WriterState::Writing(process) => format!("written by {process}"),
            WriterState::Dead(process) => format!("its writer, {process}, is dead"),
            WriterState::Closed => "its writer has ended".to_owned(),
            WriterState::Replaced => "another buffer has taken its place".to_owned(),
        };
        format!(
            "{}: {} slots of {} floats and up to {} bytes, {} records, writer {}; {writer}; \
             this reader is at {} and lost {}",
            reader.path().display(),
            layout.slots,
            layout.floats,
            layout.bytes,
            reader.head(),
            reader.generation(),
            reader.position(),
            reader.lost(),
        )
    }
}

/// All records that are there, oldest first; not more than the buffer holds, however fast it is written.
fn each(
    reader: &mut Reader,
    record: &mut Snapshot,
    lost_in_all: &mut u64,
    mut give: impl FnMut(&Snapshot, u64),
) -> Result<u64, SnapshotError> {
    let most = reader.layout().slots as u64;
    let mut found = 0;
    while found < most
        && let Some(lost) = reader.next(record)?
    {
        *lost_in_all += lost;
        give(record, lost);
        found += 1;
    }
    Ok(found)
}

/// Adds a record to the answer.
fn put(io: &mut Transport, record: &Snapshot, lost: u64, clock: &Clock) -> bool {
    io.floats.extend_from_slice(&record.floats);
    io.opaque.extend_from_slice(&record.opaque);
    let age = u64::try_from(record.age(clock).as_nanos()).unwrap_or(u64::MAX);
    io.ints.extend([
        int(record.count),
        int(record.at(clock).as_nanos()),
        int(age),
        int(record.generation),
        int(lost),
        int(record.opaque.len() as u64),
    ]);
    true
}

impl ServiceObject for ShmemR {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let wanted = Wanted::parse(&io.text)?;
        self.prepare(io)?;
        io.empty();
        self.tell_successor(io);
        if let Wanted::Status = wanted {
            io.text = self.status();
            return Ok(());
        }
        if self.read(&wanted, io)? == 0 {
            io.text.push_str(NOT_YET);
        }
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let before = self.settings.clone();
        OPTIONS.ctrl(&mut self.settings, io);
        if self.settings != before {
            self.reader = None;
        }
        Ok(())
    }

    fn dump(&self) -> String {
        OPTIONS.dump(&self.settings)
    }
}
