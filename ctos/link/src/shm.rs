//! Shared memory between two chassis of one host: a ring of bytes for each direction, and a bell for
//! each side.
//!
//! The memory has no name. It is a memfd that one side makes and passes over the Unix socket that joins
//! them, sealed so that neither can make it smaller. The system frees it when both are gone. Its
//! content was written by another process and is not trusted: positions are checked, and bytes are
//! copied out before they are read.

pub mod pass;

use std::{
    io::{self, IoSlice},
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::{
        Arc,
        atomic::{AtomicU32, AtomicU64, Ordering, fence},
    },
};

use rustix::{
    event::{EventfdFlags, eventfd},
    fs::{MemfdFlags, OFlags, SealFlags},
};

use crate::shared_memory::Memory;

/// Bytes of one ring's data; a power of two.
const RING: usize = 1 << 20;

/// Each of the fields below has a cache line of its own, so that the two sides do not disturb each other.
const LINE: usize = 128;

/// Where the fields of a ring stand, in lines from its start: bytes ever written, bytes ever read,
/// whether the writer waits for space.
const WRITTEN: usize = 0;
const READ: usize = 1;
const WANTS_SPACE: usize = 2;
/// Lines of a ring before its data.
const RING_LINES: usize = 3;

/// Lines of a bell: whether anybody sleeps at it.
const BELL_LINES: usize = 1;

/// Bytes of the whole: two bells, then two rings.
const SIZE: usize = 2 * BELL_LINES * LINE + 2 * (RING_LINES * LINE + RING);

/// The side that made the memory, and the one to which it was passed.
const MAKER: usize = 0;
const GUEST: usize = 1;

/// What the other side wrote cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the positions in the shared memory cannot be: {written} bytes written, {read} read")]
pub struct Corrupt {
    written: u64,
    read: u64,
}

/// Memory that two processes share.
pub struct Shared {
    memory: Arc<Memory>,
    /// Which side this process is.
    side: usize,
    /// What wakes the maker, and the guest.
    bells: [OwnedFd; 2],
}

impl Shared {
    /// Makes the memory and the bells, to be passed to the other side.
    ///
    /// # Errors
    /// What the system says.
    pub fn make() -> io::Result<(Self, [OwnedFd; 3])> {
        let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
        let file = rustix::fs::memfd_create("ctos-link", flags)?;
        rustix::fs::ftruncate(&file, SIZE as u64)?;
        rustix::fs::fcntl_add_seals(&file, SEALS)?;
        let bells = [bell()?, bell()?];
        let [maker, guest] = &bells;
        let passed = [file.try_clone()?, maker.try_clone()?, guest.try_clone()?];
        let shared = Self::map(file.as_fd(), bells, MAKER)?;
        Ok((shared, passed))
    }

    /// Takes memory and bells that the other side made.
    ///
    /// # Errors
    /// When they are not what they should be, or the memory could be made smaller later.
    pub fn take([file, maker, guest]: [OwnedFd; 3]) -> io::Result<Self> {
        let size = rustix::fs::fstat(&file)?.st_size;
        let seals = rustix::fs::fcntl_get_seals(&file)?;
        if u64::try_from(size) != Ok(SIZE as u64) || !seals.contains(SEALS) {
            let text = "the memory that was passed has another size, or is not sealed";
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        // Whatever they are, ringing them must not keep anybody.
        for bell in [&maker, &guest] {
            rustix::fs::fcntl_setfl(bell, OFlags::NONBLOCK)?;
        }
        Self::map(file.as_fd(), [maker, guest], GUEST)
    }

    fn map(file: BorrowedFd<'_>, bells: [OwnedFd; 2], side: usize) -> io::Result<Self> {
        let memory = Arc::new(Memory::new(file, SIZE)?);
        Ok(Self {
            memory,
            side,
            bells,
        })
    }

    /// Both sides in one process, without a file.
    #[cfg(test)]
    fn pair() -> (Self, Self) {
        let memory = Arc::new(Memory::private(SIZE));
        let bells = [bell().unwrap(), bell().unwrap()];
        let side = |side| Self {
            memory: memory.clone(),
            side,
            bells: bells.each_ref().map(|bell| bell.try_clone().unwrap()),
        };
        (side(MAKER), side(GUEST))
    }

    /// The three things that this side needs of it; the last one says when something has come, or
    /// space is free, while this side sleeps.
    pub fn split(self) -> (Sender, Receiver, OwnedFd) {
        let Self {
            memory,
            side,
            bells,
        } = self;
        let [maker, guest] = bells;
        let (other, own, theirs) = match side {
            MAKER => (GUEST, maker, guest),
            _ => (MAKER, guest, maker),
        };
        let theirs = Bell {
            memory: memory.clone(),
            side: other,
            fd: Arc::new(theirs),
        };
        // A side writes into the ring of its own number.
        let ring = |side: usize| Ring {
            memory: memory.clone(),
            start: ring_of(side),
        };
        let sender = Sender {
            ring: ring(side),
            bell: theirs.clone(),
            written: AtomicU64::new(0),
        };
        let receiver = Receiver {
            ring: ring(other),
            // To see whether space is free for what could not be written.
            own: ring(side),
            side,
            theirs,
            read: AtomicU64::new(0),
        };
        (sender, receiver, own)
    }
}

/// Where the ring begins into which a side writes.
fn ring_of(side: usize) -> usize {
    2 * BELL_LINES * LINE + side * (RING_LINES * LINE + RING)
}

/// A field. All of them lie inside and are aligned: the memory has [`SIZE`] bytes.
fn long(memory: &Memory, at: usize) -> &AtomicU64 {
    static NOWHERE: AtomicU64 = AtomicU64::new(0);
    memory.long(at).unwrap_or(&NOWHERE)
}

/// Whether a side sleeps.
fn sleeps(memory: &Memory, side: usize) -> &AtomicU32 {
    static NOWHERE: AtomicU32 = AtomicU32::new(0);
    let at = side * BELL_LINES * LINE;
    memory.short(at).unwrap_or(&NOWHERE)
}

/// An event file descriptor that wakes the thread that waits at the links: each write to it is an
/// event.
///
/// # Errors
/// What the system says.
pub fn bell() -> io::Result<OwnedFd> {
    Ok(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?)
}

/// Neither side can make the memory smaller under the other one.
const SEALS: SealFlags = SealFlags::SHRINK.union(SealFlags::GROW);

/// Wakes the other side when it sleeps.
#[derive(Clone)]
struct Bell {
    memory: Arc<Memory>,
    side: usize,
    fd: Arc<OwnedFd>,
}

impl Bell {
    /// Wakes the thread that sleeps at it; costs nothing when none does.
    fn ring(&self) {
        // Pairs with the fence of the one who goes to sleep: either this sees the sleeper, or the
        // sleeper sees what was written before this.
        fence(Ordering::SeqCst);
        let sleeps = sleeps(&self.memory, self.side);
        if sleeps.load(Ordering::Relaxed) != 0 && sleeps.swap(0, Ordering::SeqCst) != 0 {
            // It can only fail when it was rung 2^64 times.
            let _ = rustix::io::write(&*self.fd, &1_u64.to_ne_bytes());
        }
    }
}

struct Ring {
    memory: Arc<Memory>,
    start: usize,
}

impl Ring {
    fn field(&self, line: usize) -> &AtomicU64 {
        long(&self.memory, self.start + line * LINE)
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
pub struct Sender {
    ring: Ring,
    /// The other side's.
    bell: Bell,
    /// Bytes ever written: what the memory says of it, the other side may have changed. Written by one
    /// thread at a time, which holds the session's lock.
    written: AtomicU64,
}

impl Sender {
    /// Writes as much as there is space for.
    ///
    /// # Errors
    /// `WouldBlock` when there is no space; the bell of this side rings when there is some again.
    /// `InvalidData` when the other side's positions cannot be.
    pub fn try_write(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        let written = self.written.load(Ordering::Relaxed);
        let mut space = self.space(written)?;
        if space == 0 {
            self.ring.field(WANTS_SPACE).store(1, Ordering::SeqCst);
            // The reader may have freed some before it could see the wish.
            space = self.space(written)?;
            if space == 0 {
                return Err(io::ErrorKind::WouldBlock.into());
            }
        }
        // Nobody waits any more; a wish that stays would keep the other thread of this side awake.
        let wants = self.ring.field(WANTS_SPACE);
        if wants.load(Ordering::Relaxed) != 0 {
            wants.store(0, Ordering::SeqCst);
        }
        let mut at = written;
        for slice in slices {
            let (mut now, _) = slice.split_at(slice.len().min(space));
            space -= now.len();
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

    fn space(&self, written: u64) -> io::Result<usize> {
        let read = self.ring.field(READ).load(Ordering::Acquire);
        let filled = Ring::filled(written, read);
        filled
            .map(|filled| RING - filled)
            .map_err(|corrupt| io::Error::new(io::ErrorKind::InvalidData, corrupt))
    }
}

/// What comes from the other side.
pub struct Receiver {
    ring: Ring,
    own: Ring,
    side: usize,
    theirs: Bell,
    /// Bytes ever read: what the memory says of it, the other side may have changed. Written by one
    /// thread at a time, which holds the lock of the stream.
    read: AtomicU64,
}

impl Receiver {
    /// Copies out what has come, up to the size of `into`.
    ///
    /// # Errors
    /// [`Corrupt`] when the other side's position cannot be.
    pub fn read(&self, into: &mut [u8]) -> Result<usize, Corrupt> {
        let mut read = self.read.load(Ordering::Relaxed);
        let written = self.ring.field(WRITTEN).load(Ordering::Acquire);
        let count = Ring::filled(written, read)?.min(into.len());
        let (mut rest, _) = into.split_at_mut(count);
        while !rest.is_empty() {
            let (place, until_wrap) = self.ring.place(read);
            let (part, later) = rest.split_at_mut(rest.len().min(until_wrap));
            self.ring.memory.copy_out(place, part);
            read += part.len() as u64;
            rest = later;
        }
        if count > 0 {
            self.read.store(read, Ordering::Relaxed);
            self.ring.field(READ).store(read, Ordering::Release);
            fence(Ordering::SeqCst);
            if self.ring.field(WANTS_SPACE).load(Ordering::Relaxed) != 0 {
                self.theirs.ring();
            }
        }
        Ok(count)
    }

    /// Whether something has come, or space is free for what waits for it.
    pub fn has_work(&self) -> bool {
        let has_data =
            self.ring.field(WRITTEN).load(Ordering::Acquire) != self.read.load(Ordering::Relaxed);
        has_data || (self.waits_for_space() && self.has_space())
    }

    /// Whether this side has something to write for which there was no space. A peer that says otherwise in
    /// the memory keeps only its own messages waiting.
    pub fn waits_for_space(&self) -> bool {
        self.own.field(WANTS_SPACE).load(Ordering::Acquire) != 0
    }

    fn has_space(&self) -> bool {
        let written = self.own.field(WRITTEN).load(Ordering::Acquire);
        let read = self.own.field(READ).load(Ordering::Acquire);
        written.wrapping_sub(read) < RING as u64
    }

    /// This side's bell must ring from now on, or need no longer. A thread that goes to sleep looks
    /// for work once more, behind a fence.
    pub fn set_asleep(&self, asleep: bool) {
        let sleeps = sleeps(&self.ring.memory, self.side);
        sleeps.store(u32::from(asleep), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests;
