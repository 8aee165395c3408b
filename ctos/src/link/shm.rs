//! Shared memory between two chassis of one host: a ring of bytes for each direction, and a bell for
//! each side.
//!
//! The memory has no name: it is a memfd that one side makes and passes over the Unix socket that joins
//! them, sealed so that neither can make it smaller; the system frees it when both are gone. What is in
//! it was written by another process and is believed nowhere: positions are checked, bytes are copied
//! out before anybody looks at them.

mod memory;
pub(crate) mod pass;

use std::{
    io::{self, IoSlice},
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::{
        Arc,
        atomic::{AtomicU32, AtomicU64, Ordering, fence},
    },
    time::Duration,
};

use rustix::{
    fs::{MemfdFlags, SealFlags},
    thread::futex,
};

use self::memory::Memory;

/// Bytes of one ring's data; a power of two.
const RING: usize = 1 << 20;

/// Each of the fields below has a cache line of its own, so that the two sides do not disturb each other.
const LINE: usize = 128;

/// Where the fields of a ring stand, in lines from its start: bytes ever written, bytes ever read,
/// whether the writer waits for room.
const WRITTEN: usize = 0;
const READ: usize = 1;
const WANTS_ROOM: usize = 2;
/// Lines of a ring before its data.
const RING_LINES: usize = 3;

/// Where the fields of a bell stand: how often it rang, whether anybody sleeps beside it.
const RINGS: usize = 0;
const SLEEPS: usize = 1;
/// Lines of a bell.
const BELL_LINES: usize = 2;

/// Bytes of the whole: two bells, then two rings.
const SIZE: usize = 2 * BELL_LINES * LINE + 2 * (RING_LINES * LINE + RING);

/// Which side of the memory this process is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    /// The one that made it.
    Maker,
    /// The one to which it was passed.
    Guest,
}

impl Side {
    fn index(self) -> usize {
        match self {
            Self::Maker => 0,
            Self::Guest => 1,
        }
    }

    fn other(self) -> Self {
        match self {
            Self::Maker => Self::Guest,
            Self::Guest => Self::Maker,
        }
    }
}

/// What the other side wrote cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the positions in the shared memory cannot be: {written} bytes written, {read} read")]
pub(crate) struct Corrupt {
    written: u64,
    read: u64,
}

/// Memory that two processes share.
#[derive(Debug)]
pub(crate) struct Shared {
    memory: Arc<Memory>,
    side: Side,
}

impl Shared {
    /// Makes the memory, to be passed to the other side.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn make() -> io::Result<(Self, OwnedFd)> {
        let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
        let file = rustix::fs::memfd_create("ctos-link", flags)?;
        rustix::fs::ftruncate(&file, SIZE as u64)?;
        rustix::fs::fcntl_add_seals(&file, SEALS)?;
        let shared = Self::map(file.as_fd(), Side::Maker)?;
        Ok((shared, file))
    }

    /// Takes memory that the other side made.
    ///
    /// # Errors
    /// When it is not what it should be, or could be made smaller later.
    pub(crate) fn take(file: BorrowedFd<'_>) -> io::Result<Self> {
        let size = rustix::fs::fstat(file)?.st_size;
        let seals = rustix::fs::fcntl_get_seals(file)?;
        if u64::try_from(size) != Ok(SIZE as u64) || !seals.contains(SEALS) {
            let text = "the memory that was passed has another size, or is not sealed";
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        Self::map(file, Side::Guest)
    }

    fn map(file: BorrowedFd<'_>, side: Side) -> io::Result<Self> {
        let memory = Arc::new(Memory::of_file(file, SIZE)?);
        Ok(Self { memory, side })
    }

    /// Both sides in one process, without a file.
    #[cfg(test)]
    fn pair() -> (Self, Self) {
        let memory = Arc::new(Memory::private(SIZE));
        let side = |side| Self {
            memory: memory.clone(),
            side,
        };
        (side(Side::Maker), side(Side::Guest))
    }

    /// The three things that this side needs of it.
    pub(crate) fn split(self) -> (Sender, Receiver, Bell) {
        let Self { memory, side } = self;
        let bell = |side: Side| Bell {
            memory: memory.clone(),
            start: side.index() * BELL_LINES * LINE,
        };
        // A side writes into the ring of its own number.
        let ring = |side: Side| Ring {
            memory: memory.clone(),
            start: 2 * BELL_LINES * LINE + side.index() * (RING_LINES * LINE + RING),
        };
        let sender = Sender {
            ring: ring(side),
            bell: bell(side.other()),
            written: AtomicU64::new(0),
        };
        let receiver = Receiver {
            ring: ring(side.other()),
            // To see whether room has come for what could not be written.
            own: ring(side),
            bell: bell(side),
            theirs: bell(side.other()),
            read: 0,
        };
        (sender, receiver, bell(side))
    }
}

/// Neither side can make the memory smaller under the other one.
const SEALS: SealFlags = SealFlags::SHRINK.union(SealFlags::GROW);

/// Wakes one side when it sleeps.
#[derive(Clone)]
pub(crate) struct Bell {
    memory: Arc<Memory>,
    start: usize,
}

impl Bell {
    fn rings(&self) -> &AtomicU32 {
        self.memory.word(self.start + RINGS * LINE)
    }

    fn sleeps(&self) -> &AtomicU32 {
        self.memory.word(self.start + SLEEPS * LINE)
    }

    /// Wakes whoever sleeps beside it; costs nothing when nobody does.
    fn ring(&self) {
        // Pairs with the fence in `sleep`: either this sees the sleeper, or the sleeper sees what was
        // written before this.
        fence(Ordering::SeqCst);
        if self.sleeps().load(Ordering::Relaxed) != 0 {
            self.ring_here();
        }
    }

    /// Wakes whoever sleeps beside it, or the next who wants to.
    pub(crate) fn ring_here(&self) {
        self.rings().fetch_add(1, Ordering::SeqCst);
        // An error would say that the address is not one.
        let _ = futex::wake(self.rings(), futex::Flags::empty(), u32::MAX >> 1);
    }

    /// Sleeps until it rings, unless there is `work` already, or it rang since `heard`.
    fn sleep(&self, heard: u32, work: impl Fn() -> bool) {
        self.sleeps().store(1, Ordering::SeqCst);
        fence(Ordering::SeqCst);
        if !work() {
            // Ends at once when it rang since; an interruption is seen by the caller as no work.
            let _ = futex::wait(self.rings(), futex::Flags::empty(), heard, None);
        }
        self.sleeps().store(0, Ordering::Relaxed);
    }
}

struct Ring {
    memory: Arc<Memory>,
    start: usize,
}

impl Ring {
    fn field(&self, line: usize) -> &AtomicU64 {
        self.memory.long(self.start + line * LINE)
    }

    fn data(&self) -> usize {
        self.start + RING_LINES * LINE
    }

    /// Where position `at` stands, and how many bytes follow it before the ring begins again.
    fn place(&self, at: u64) -> (usize, usize) {
        // The remainder is below `RING`.
        let offset = usize::try_from(at % RING as u64).unwrap_or(0);
        (self.data() + offset, RING - offset)
    }

    /// Bytes between the two positions.
    fn filled(written: u64, read: u64) -> Result<usize, Corrupt> {
        let corrupt = Corrupt { written, read };
        let filled = written.checked_sub(read).ok_or(corrupt)?;
        let filled = usize::try_from(filled).map_err(|_| corrupt)?;
        if filled <= RING {
            Ok(filled)
        } else {
            Err(corrupt)
        }
    }
}

/// This side's way into the other one.
pub(crate) struct Sender {
    ring: Ring,
    /// The other side's.
    bell: Bell,
    /// Bytes ever written: what the memory says of it, the other side may have changed. Written by one
    /// thread at a time, which holds the session's lock.
    written: AtomicU64,
}

impl Sender {
    /// Writes as much as there is room for.
    ///
    /// # Errors
    /// `WouldBlock` when there is no room; the bell of this side rings when there is some again.
    /// `InvalidData` when the other side's positions cannot be.
    pub(crate) fn try_write(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        let written = self.written.load(Ordering::Relaxed);
        let mut room = self.room(written)?;
        if room == 0 {
            self.ring.field(WANTS_ROOM).store(1, Ordering::SeqCst);
            // The reader may have made room before it could see the wish.
            room = self.room(written)?;
            if room == 0 {
                return Err(io::ErrorKind::WouldBlock.into());
            }
        }
        // Nobody waits any more; a wish that stays would keep the other thread of this side awake.
        let wants = self.ring.field(WANTS_ROOM);
        if wants.load(Ordering::Relaxed) != 0 {
            wants.store(0, Ordering::SeqCst);
        }
        let mut at = written;
        for slice in slices {
            let (mut now, _) = slice.split_at(slice.len().min(room));
            room -= now.len();
            while !now.is_empty() {
                let (place, until_wrap) = self.ring.place(at);
                let (part, later) = now.split_at(now.len().min(until_wrap));
                self.ring.memory.copy_in(place, part);
                at += part.len() as u64;
                now = later;
            }
        }
        self.written.store(at, Ordering::Relaxed);
        self.ring.field(WRITTEN).store(at, Ordering::Release);
        self.bell.ring();
        // At most `RING`, which fits.
        Ok(usize::try_from(at - written).unwrap_or(RING))
    }

    fn room(&self, written: u64) -> io::Result<usize> {
        let read = self.ring.field(READ).load(Ordering::Acquire);
        let filled = Ring::filled(written, read);
        filled
            .map(|filled| RING - filled)
            .map_err(|corrupt| io::Error::new(io::ErrorKind::InvalidData, corrupt))
    }
}

/// What comes from the other side.
pub(crate) struct Receiver {
    ring: Ring,
    own: Ring,
    bell: Bell,
    theirs: Bell,
    /// Bytes ever read: what the memory says of it, the other side may have changed.
    read: u64,
}

impl Receiver {
    /// Copies out what has come, up to the size of `into`.
    ///
    /// # Errors
    /// [`Corrupt`] when the other side's position cannot be.
    pub(crate) fn read(&mut self, into: &mut [u8]) -> Result<usize, Corrupt> {
        let written = self.ring.field(WRITTEN).load(Ordering::Acquire);
        let count = Ring::filled(written, self.read)?.min(into.len());
        let (mut into, _) = into.split_at_mut(count);
        while !into.is_empty() {
            let (place, until_wrap) = self.ring.place(self.read);
            let (part, later) = into.split_at_mut(until_wrap.min(into.len()));
            self.ring.memory.copy_out(place, part);
            self.read += part.len() as u64;
            into = later;
        }
        if count > 0 {
            self.ring.field(READ).store(self.read, Ordering::Release);
            fence(Ordering::SeqCst);
            let wants = self.ring.field(WANTS_ROOM);
            if wants.load(Ordering::Relaxed) != 0 {
                wants.store(0, Ordering::SeqCst);
                self.theirs.ring_here();
            }
        }
        Ok(count)
    }

    /// How often the bell of this side has rung: asked for before looking for work, so that no ring
    /// is missed between that and [`Self::wait`].
    pub(crate) fn heard(&self) -> u32 {
        self.bell.rings().load(Ordering::SeqCst)
    }

    fn has_data(&self) -> bool {
        self.ring.field(WRITTEN).load(Ordering::Acquire) != self.read
    }

    /// Waits until something has come, room has come, or the bell of this side rang since `heard`:
    /// looks for `spin`, then sleeps.
    pub(crate) fn wait(&self, spin: Duration, heard: u32) {
        // Room that came is told by the bell, which rang before this if the wish is gone already.
        let work = || self.has_data();
        if !spin.is_zero() {
            let clock = crate::time::Clock::real();
            let end = clock.now() + spin;
            while clock.now() < end {
                for _ in 0..SPINS {
                    if work() {
                        return;
                    }
                    std::hint::spin_loop();
                }
            }
        }
        let waits = self.own.field(WANTS_ROOM).load(Ordering::Acquire) != 0;
        let has_room = || {
            let written = self.own.field(WRITTEN).load(Ordering::Acquire);
            let read = self.own.field(READ).load(Ordering::Acquire);
            written.wrapping_sub(read) < RING as u64
        };
        self.bell.sleep(heard, || work() || (waits && has_room()));
    }
}

/// How often the ring is looked at before the clock is.
const SPINS: usize = 32;

#[cfg(test)]
mod tests;
