//! The writer of a snapshot buffer: makes the segment or takes it over, and writes records into it.

use super::bell;
use super::error::SnapshotError;
use super::layout::{BELL, CLOSED, GENERATION, HEADER, Header, ORIGIN, PID, PID_START};
use super::layout::{Layout, REPLACED, STATE, WRITING};
use super::memory::{self, Page};
use super::place::{self, Place, is_at, system};
use super::protocol::{Load, Mark, Store};
use super::record::{host_ns, nap};
use crate::process::Process;
use ctos::time::Clock;
use rustix::fs::{CWD, FallocateFlags, Mode, OFlags, RenameFlags, renameat_with};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How often a segment that another process changes under our hands is tried again.
const ATTEMPTS: u32 = 16;

/// The one writer of a snapshot buffer. When it is dropped the buffer is closed, and its segment removed unless
/// it is [kept](Self::keep). Readers that have it open can still read what is there.
#[derive(Debug)]
pub struct Writer {
    page: Page,
    header: Header,
    clock: Clock,
    generation: u64,
    count: u64,
    path: PathBuf,
    keeps: bool,
    /// Its lock is what makes this the only writer; the system gives it back when the process ends.
    file: File,
}

impl Writer {
    /// Makes the buffer `name`, or takes it over from a writer that has ended. With the same layout it goes on
    /// with the next number, and readers just go on. With another layout a new segment takes the place of the
    /// old one, and readers of the old one learn so. So it is in virtual time when another process wrote the old one.
    ///
    /// # Errors
    /// Another writer has it, the name or the layout cannot be, or the system refuses.
    pub fn create(
        place: &Place,
        name: &str,
        layout: Layout,
        clock: &Clock,
    ) -> Result<Self, SnapshotError> {
        let path = place.path(name)?;
        let header = Header::new(layout, clock.origin_ns().is_none())?;
        for attempt in 0..ATTEMPTS {
            let old = match place::open(&path, OFlags::RDWR) {
                Ok(file) => match lock(file, &path) {
                    // Somebody else looks at what a dead writer left, and is done in a moment.
                    Err(SnapshotError::Busy { writer, .. }) if !writer.is_alive() => {
                        nap(Duration::from_millis(1));
                        continue;
                    }
                    locked => Some(locked?),
                },
                Err(SnapshotError::Missing { .. }) => None,
                Err(error) => return Err(error),
            };
            if old.as_ref().is_some_and(|old| !is_at(old, &path)) {
                continue;
            }
            if let Some(writer) = old
                .as_ref()
                .and_then(|old| Self::adopt(old, &path, &header, clock))
            {
                return Ok(writer);
            }
            let made = Self::make(place, &path, old.as_ref(), &header, clock, attempt)?;
            if let Some(writer) = made {
                return Ok(writer);
            }
        }
        let source = std::io::Error::other("other processes make and remove it all the time");
        Err(system(&path, "cannot be taken over", source))
    }

    /// Goes on in a segment that has the same structure.
    fn adopt(file: &File, path: &Path, header: &Header, clock: &Clock) -> Option<Self> {
        let length = file.metadata().ok()?.len();
        let page = Page::new(file, header.geometry.bytes).ok()?;
        let mut found = Header::read(&page, length, path).ok()?;
        found.read_description(&page);
        if found != *header || page.load(STATE) == REPLACED {
            return None;
        }
        // The virtual clock of another process is another clock: what it stamped is no past of this run.
        if header.virtual_time && place::writer_of(&page) != Process::this() {
            return None;
        }
        let count = header.geometry.ring.recover(&page)?;
        let generation = page.load(GENERATION);
        let file = file.try_clone().ok()?;
        Some(Self::begin(
            page, header, clock, generation, count, path, file,
        ))
    }

    /// Makes a new segment and puts it into the place of the old one; `None` when somebody else was faster.
    fn make(
        place: &Place,
        path: &Path,
        old: Option<&File>,
        header: &Header,
        clock: &Clock,
        attempt: u32,
    ) -> Result<Option<Self>, SnapshotError> {
        let unfinished = place.unfinished(attempt);
        let flags = OFlags::RDWR | OFlags::CREATE | OFlags::EXCL | OFlags::CLOEXEC;
        let file = match rustix::fs::open(&unfinished, flags, Mode::RUSR | Mode::WUSR) {
            Ok(file) => File::from(file),
            // Left by a process that had this number before, or being made by another thread of this one.
            Err(rustix::io::Errno::EXIST) => return Ok(None),
            Err(error) => return Err(system(&unfinished, "cannot be made", error.into())),
        };
        let made = Self::fill(&file, &unfinished, header);
        let old_page = old.and_then(|old| Page::new(old, HEADER).ok());
        let before = old_page.as_ref().map_or(0, |old| old.load(GENERATION));
        let moved = made.and_then(|page| {
            let file = lock(file, &unfinished)?;
            let writer = Self::begin(page, header, clock, before, 0, path, file);
            let how = if old.is_some() {
                RenameFlags::empty()
            } else {
                RenameFlags::NOREPLACE
            };
            match renameat_with(CWD, &unfinished, CWD, path, how) {
                Ok(()) => Ok(Some(writer)),
                Err(rustix::io::Errno::EXIST) => Ok(None),
                Err(error) => Err(system(path, "cannot be put in place", error.into())),
            }
        });
        if !matches!(moved, Ok(Some(_))) {
            // Best effort: what stays is found as unfinished later.
            let _ = std::fs::remove_file(&unfinished);
        } else if let Some(old) = old_page {
            old.store(STATE, REPLACED);
            if let Some(word) = memory::bell(&old, BELL) {
                bell::ring(word);
            }
        }
        moved
    }

    /// Gives a new file its length, for which the memory is taken now, and its header.
    fn fill(file: &File, path: &Path, header: &Header) -> Result<Page, SnapshotError> {
        let bytes = header.geometry.bytes;
        rustix::fs::fallocate(file, FallocateFlags::empty(), 0, bytes as u64)
            .map_err(|error| system(path, "has no room in shared memory", error.into()))?;
        let page =
            Page::new(file, bytes).map_err(|source| system(path, "cannot be mapped", source))?;
        header.write(&page);
        Ok(page)
    }

    fn begin(
        page: Page,
        header: &Header,
        clock: &Clock,
        generation_before: u64,
        count: u64,
        path: &Path,
        file: File,
    ) -> Self {
        let this = Process::this();
        let generation = generation_before.wrapping_add(1);
        page.store(PID, u64::from(this.pid));
        page.store(PID_START, this.start);
        page.store(ORIGIN, clock.origin_ns().unwrap_or(0));
        page.store(GENERATION, generation);
        page.fence_release();
        page.store(STATE, WRITING);
        Self {
            page,
            header: header.clone(),
            clock: clock.clone(),
            generation,
            count,
            path: path.to_owned(),
            keeps: false,
            file,
        }
    }

    /// Leaves the segment where it is when the writer is dropped, for those who look at it later. A segment whose
    /// writer was killed stays in any case.
    pub fn keep(&mut self, keeps: bool) {
        self.keeps = keeps;
    }

    /// Writes a record with the present moment, and answers its number. Takes no lock, never waits, and
    /// does not allocate.
    ///
    /// # Errors
    /// The floats are not as many as the layout says, or the bytes more.
    #[inline]
    pub fn write(&mut self, floats: &[f64], opaque: &[u8]) -> Result<u64, SnapshotError> {
        let stamp_ns = host_ns(&self.clock);
        self.write_stamped(stamp_ns, floats, opaque)
    }

    /// As [`write`](Self::write), for data that were taken at another moment: when the image was grabbed and
    /// not when it was looked at. In ns of the host's monotonic clock, as [`Snapshot::stamp_ns`](super::Snapshot).
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn write_stamped(
        &mut self,
        stamp_ns: u64,
        floats: &[f64],
        opaque: &[u8],
    ) -> Result<u64, SnapshotError> {
        let ring = &self.header.geometry.ring;
        if floats.len() != ring.floats {
            return Err(SnapshotError::Record {
                what: "floats",
                takes: ring.floats,
                given: floats.len(),
            });
        }
        if opaque.len() > ring.bytes {
            return Err(SnapshotError::Record {
                what: "opaque bytes, at most",
                takes: ring.bytes,
                given: opaque.len(),
            });
        }
        self.count += 1;
        let mark = Mark {
            count: self.count,
            stamp_ns,
            generation: self.generation,
        };
        ring.write(&self.page, mark, floats, opaque);
        self.ring_bell();
        Ok(self.count)
    }

    fn ring_bell(&self) {
        if let Some(word) = memory::bell(&self.page, BELL) {
            bell::ring(word);
        }
    }

    /// What it said about its records.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.header.layout
    }

    /// The number of the record written last, also by earlier writers; 0 before the first.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Which writer of this buffer it is, from 1 on.
    #[must_use]
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// The file of the segment.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Begins a record and does not end it: what a writer leaves that is killed there.
    #[cfg(test)]
    pub(super) fn begin_and_leave(&self, floats: &[f64]) {
        let ring = self.header.geometry.ring;
        let index = (self.count % ring.slots) as usize;
        let slot = ring.first + index * ring.stride;
        self.page.store(slot, 2 * self.count + 1);
        self.page
            .store_floats(slot + super::protocol::SLOT_HEAD, floats);
    }

    /// Ends as a process that is killed: nothing is tidied up, but the lock is given back.
    #[cfg(test)]
    pub(super) fn die(self) {
        self.page.store(PID_START, 1);
        // The system does this when the process ends; here the mapping stays and would keep the lock.
        self.file.unlock().unwrap();
        std::mem::forget(self);
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // In a place that another has taken, nothing is ours any more.
        if !is_at(&self.file, &self.path) {
            return;
        }
        if !self.keeps {
            // Before the lock is given back, so that nobody takes over what is removed.
            let _ = std::fs::remove_file(&self.path);
        }
        self.page.store(STATE, CLOSED);
        self.ring_bell();
    }
}

/// Takes the lock of a segment, which its writer holds.
fn lock(file: File, path: &Path) -> Result<File, SnapshotError> {
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(std::fs::TryLockError::WouldBlock) => {
            let page = Page::new(&file, HEADER)
                .map_err(|source| system(path, "cannot be mapped", source))?;
            Err(SnapshotError::Busy {
                path: path.to_owned(),
                writer: place::writer_of(&page),
            })
        }
        Err(std::fs::TryLockError::Error(source)) => Err(system(path, "cannot be locked", source)),
    }
}
