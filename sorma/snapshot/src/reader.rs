//! A reader of a snapshot buffer. It writes nothing but the bell, and trusts nothing that it reads: wrong
//! numbers in the memory give errors or lost records, not more.

use super::bell;
use super::error::SnapshotError;
use super::layout::{BELL, CLOSED, GENERATION, HEADER, Header, REPLACED, STATE};
use super::layout::{Layout, ORIGIN, WRITING};
use super::memory::{self, Page, View};
use super::place::{self, Place, is_at, system};
use super::protocol::{Load, Taken};
use super::record::{Snapshot, nap};
use crate::process::Process;
use ctos::time::{Clock, Instant};
use rustix::fs::OFlags;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How often a reader that is overtaken tries again at once.
const TRIES: u32 = 1000;
/// How long a reader looks without sleeping before it sleeps.
const SPIN: Duration = Duration::from_micros(20);
/// How long it sleeps at the most before it looks whether the writer still lives.
const NAP: Duration = Duration::from_millis(100);

/// A reader of a snapshot buffer, at one place in the sequence of records.
#[derive(Debug)]
pub struct Reader {
    view: View,
    /// For the bell; `None` where the file may only be read, and then waiting is looking again and again.
    page: Option<Page>,
    header: Header,
    path: PathBuf,
    file: File,
    /// The number of the last record that was taken or passed over.
    last: u64,
    /// Records lost since the last one that was taken.
    pending: u64,
    lost: u64,
}

/// Who writes a buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WriterState {
    /// A process that is there.
    Writing(Process),
    /// Nobody any more: the writer has ended orderly.
    Closed,
    /// Nobody: the process has ended without a word. The next writer goes on here.
    Dead(Process),
    /// Another segment, with another layout, has taken the place of this one: open it anew.
    Replaced,
}

/// How waiting for a record ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Waited {
    /// There is a record that was not taken yet.
    Ready,
    /// There was none in that time.
    Late,
    /// None will come as things are.
    Ended(WriterState),
}

impl Reader {
    /// Opens a buffer. [`next`](Self::next) begins with the oldest record that is there.
    ///
    /// # Errors
    /// There is none, or it is of another version, or it is damaged, or the system refuses.
    pub fn open(place: &Place, name: &str) -> Result<Self, SnapshotError> {
        let path = &place.path(name)?;
        let file = match place::open(path, OFlags::RDWR) {
            Err(SnapshotError::System { .. }) => place::open(path, OFlags::RDONLY)?,
            opened => opened?,
        };
        let length = file
            .metadata()
            .map_err(|source| system(path, "cannot be looked at", source))?
            .len();
        if length < HEADER as u64 {
            return Err(SnapshotError::NoSnapshots {
                path: path.to_owned(),
            });
        }
        let mapped = |source| system(path, "cannot be mapped", source);
        let head = View::new(&file, HEADER).map_err(mapped)?;
        let mut header = Header::read(&head, length, path)?;
        let view = View::new(&file, header.geometry.bytes).map_err(mapped)?;
        header.read_description(&view);
        let mut reader = Self {
            view,
            page: Page::new(&file, HEADER).ok(),
            header,
            path: path.to_owned(),
            file,
            last: 0,
            pending: 0,
            lost: 0,
        };
        reader.seek(0);
        Ok(reader)
    }

    /// As [`open`](Self::open), for those who count on a structure.
    ///
    /// # Errors
    /// As [`open`](Self::open), and when the records have other numbers of floats or bytes.
    pub fn open_as(
        place: &Place,
        name: &str,
        floats: usize,
        bytes: usize,
    ) -> Result<Self, SnapshotError> {
        let reader = Self::open(place, name)?;
        let layout = reader.layout();
        let pairs = [
            ("floats", layout.floats, floats),
            ("opaque bytes, at most", layout.bytes, bytes),
        ];
        match pairs.into_iter().find(|(_, has, wanted)| has != wanted) {
            None => Ok(reader),
            Some((what, has, wanted)) => Err(SnapshotError::Differs {
                path: reader.path,
                what,
                has,
                wanted,
            }),
        }
    }

    /// What the writer says about its records.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.header.layout
    }

    /// The file of the segment.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the stamps are of a virtual clock.
    #[must_use]
    pub fn is_virtual_time(&self) -> bool {
        self.header.virtual_time
    }

    /// A real clock that shows the time of the writer's app.
    #[must_use]
    pub fn writers_clock(&self) -> Clock {
        Clock::real_from(self.view.load(ORIGIN))
    }

    /// The number of the latest record; 0 before the first.
    #[must_use]
    pub fn head(&self) -> u64 {
        self.header.geometry.ring.head(&self.view)
    }

    /// How many writers the buffer has had. It goes up when a new one takes over.
    #[must_use]
    pub fn generation(&self) -> u64 {
        self.view.load(GENERATION)
    }

    /// The number of the last record that was taken or passed over.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.last
    }

    /// Records that this reader lost, in all, because the writer was faster.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Goes on after record `count`: 0 is the oldest that is there, [`head`](Self::head) the next to come.
    pub fn seek(&mut self, count: u64) {
        let head = self.head();
        self.pending = 0;
        // Before the oldest there is nothing to lose that this reader ever had a claim to.
        let oldest = self.header.geometry.ring.oldest(head);
        self.last = count.clamp(oldest - 1, head);
    }

    /// Whether the buffer itself says that no more records will come; it says nothing of a writer that
    /// was killed. Costs one look at the memory.
    #[must_use]
    pub fn is_over(&self) -> bool {
        matches!(self.view.load(STATE), CLOSED | REPLACED)
    }

    /// Who writes. Asks the system, so it is not for every record.
    #[must_use]
    pub fn writer(&self) -> WriterState {
        match self.view.load(STATE) {
            REPLACED => WriterState::Replaced,
            _ if std::fs::symlink_metadata(&self.path).is_ok()
                && !is_at(&self.file, &self.path) =>
            {
                WriterState::Replaced
            }
            CLOSED => WriterState::Closed,
            _ => {
                let writer = place::writer_of(&self.view);
                if writer.is_alive() {
                    WriterState::Writing(writer)
                } else {
                    WriterState::Dead(writer)
                }
            }
        }
    }

    /// Takes the latest record; `false` when there is none yet. Those between the last one taken and it
    /// are passed over and do not count as lost.
    ///
    /// # Errors
    /// The writer overwrites it again and again, or the buffer has one slot, which a writer that died has left torn.
    pub fn latest(&mut self, into: &mut Snapshot) -> Result<bool, SnapshotError> {
        for _ in 0..TRIES {
            let head = self.head();
            if head == 0 {
                return Ok(false);
            }
            if self.read(head, into) {
                self.last = head;
                self.pending = 0;
                return Ok(true);
            }
            std::hint::spin_loop();
        }
        Err(self.overrun())
    }

    /// Takes the record after the last one that was taken. `None` when there is none yet, else how many were
    /// lost between the two.
    ///
    /// # Errors
    /// The writer overwrites records again and again while they are read.
    pub fn next(&mut self, into: &mut Snapshot) -> Result<Option<u64>, SnapshotError> {
        for _ in 0..TRIES {
            let head = self.head();
            if head <= self.last {
                // Below only when the memory is not what it says: begin with what it says now.
                self.last = head;
                return Ok(None);
            }
            let oldest = self.header.geometry.ring.oldest(head);
            let next = (self.last + 1).max(oldest);
            self.lose(next - 1 - self.last);
            self.last = next;
            if self.read(next, into) {
                return Ok(Some(std::mem::take(&mut self.pending)));
            }
            self.lose(1);
        }
        Err(self.overrun())
    }

    fn lose(&mut self, records: u64) {
        self.pending = self.pending.saturating_add(records);
        self.lost = self.lost.saturating_add(records);
    }

    /// Gives the most recent `most` records, or as many as there are, oldest first, to `each`; answers how
    /// many. The place of the reader stays as it is.
    pub fn history(
        &self,
        most: u64,
        record: &mut Snapshot,
        mut each: impl FnMut(&Snapshot),
    ) -> u64 {
        let head = self.head();
        let ring = &self.header.geometry.ring;
        let first = ring
            .oldest(head)
            .max(head.saturating_sub(most).saturating_add(1));
        let mut given = 0;
        for count in first..=head {
            // The oldest may be overwritten meanwhile; those after it are there.
            if self.read(count, record) {
                each(record);
                given += 1;
            }
        }
        given
    }

    /// Waits until there is a record that was not taken yet: looks for a moment without sleeping, then sleeps
    /// until the writer wakes it. The thread waits with it, so a task does not do this but looks again after
    /// a while. With a virtual clock it does not wait at all.
    pub fn wait(&self, limit: Duration, clock: &Clock) -> Waited {
        let begin = clock.now();
        let is_there = || self.head() != self.last;
        if clock.origin_ns().is_none() {
            return if is_there() {
                Waited::Ready
            } else {
                self.late()
            };
        }
        let until = begin + limit;
        let spin_until = until.min(begin + SPIN);
        while clock.now() < spin_until {
            if is_there() {
                return Waited::Ready;
            }
            std::hint::spin_loop();
        }
        self.sleep(until, clock, is_there)
    }

    fn sleep(&self, until: Instant, clock: &Clock, is_there: impl Fn() -> bool) -> Waited {
        let bell = self.page.as_ref().and_then(|page| memory::bell(page, BELL));
        let is_written = || self.view.load(STATE) == WRITING;
        loop {
            if is_there() {
                return Waited::Ready;
            }
            let now = clock.now();
            if now >= until || !is_written() {
                return self.late();
            }
            let limit = until.since(now).min(NAP);
            match bell {
                Some(word) => bell::sleep(word, limit, || is_there() || !is_written()),
                None => nap(limit.min(Duration::from_millis(1))),
            }
            // After a whole nap without a record: is there still somebody to write one?
            if clock.now().since(now) >= NAP
                && !is_there()
                && let Waited::Ended(ended) = self.late()
            {
                return Waited::Ended(ended);
            }
        }
    }

    fn late(&self) -> Waited {
        match self.writer() {
            WriterState::Writing(_) => Waited::Late,
            ended => Waited::Ended(ended),
        }
    }

    /// Reads a record whole, or answers `false`.
    fn read(&self, count: u64, into: &mut Snapshot) -> bool {
        let ring = &self.header.geometry.ring;
        let taken = ring.read(&self.view, count, &mut into.floats, &mut into.opaque);
        let Taken::Whole(mark) = taken else {
            return false;
        };
        into.count = mark.count;
        into.stamp_ns = mark.stamp_ns;
        into.generation = mark.generation;
        true
    }

    fn overrun(&self) -> SnapshotError {
        SnapshotError::Overrun {
            path: self.path.clone(),
        }
    }
}
