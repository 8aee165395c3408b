//! The memory of a chassis in which large data stands that other processes of its host read in place.
//!
//! Each chassis has one pool, which it alone writes; its peers map it to read. Data in it is lent to a
//! peer: the lender keeps it until the peer has given it back, by a word in the memory that the two share,
//! or until the peer is gone with all that it held, which shows at the end of a pipe that the borrower's
//! data keeps open. So no count of anybody's lies in memory that a killed process could leave wrong. When
//! the pool is full, or too much is lent already, data goes the ordinary way and is copied.
//!
//! # Why this is sound
//!
//! A [`Block`] is a part of the pool that belongs to nobody else from [`Pool::block`] to its drop, so it
//! may be borrowed to be written as anything that is owned. It can be seen by others only once it has become a
//! [`Bytes`], from when on nobody writes to it until the last of its owners is gone; a peer that borrowed it is
//! an owner, because [`Lending`] holds it for the peer. A [`Borrowed`] is a part of a peer's pool between the
//! peer's word that it is lent and ours that it is given back; in that time the peer, being this same program,
//! does not write there. A dishonest peer might. It is a process of the same user, let in with the run's token,
//! which could as well write to this process's memory through the system's debugging interface: against it
//! there is no wall in any case. All that is checked is that the place lies inside of the mapping, which cannot
//! shrink.

#![allow(
    unsafe_code,
    reason = "data that is read where another process wrote it: the argument is above"
)]

use std::{
    collections::BTreeMap,
    io,
    ops::{Deref, DerefMut},
    os::fd::{AsFd, OwnedFd},
    sync::{Arc, Mutex, atomic::AtomicU32, atomic::Ordering},
};

use bytes::Bytes;
use rustix::{
    fs::{MemfdFlags, SealFlags},
    pipe::{PipeFlags, pipe_with},
};

use super::memory::Memory;
use crate::{
    call::lock,
    link::session::packet::{Lend, Place},
};

/// Bytes of a pool. What was never written to costs addresses, not memory.
const SIZE: usize = 16 << 20;

/// Blocks begin and end at whole pages.
const PAGE: usize = 4096;

/// How many parts of a pool are lent to one peer at a time, at most.
pub(super) const SLOTS: usize = 64;

/// Of a slot: what it stands for was given back.
const BACK: u32 = 0;
/// Of a slot: what it stands for is lent.
const LENT: u32 = 1;

/// The owner maps it to write before anybody else has it; later it can only be mapped to read.
const SEALS: SealFlags = SealFlags::SHRINK
    .union(SealFlags::GROW)
    .union(SealFlags::FUTURE_WRITE);

/// Memory that this process writes and others read.
pub(crate) struct Pool {
    memory: Arc<Memory>,
    /// What is passed to others; none where all are in one process.
    file: Option<OwnedFd>,
    state: Mutex<State>,
}

struct State {
    /// Free parts, by where they begin: how large they are. No two of them touch.
    free: BTreeMap<usize, usize>,
    /// What peers still hold whose sessions are over.
    left: Vec<Lent>,
    closed: bool,
}

impl Pool {
    /// A pool that can be passed to other processes.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn make() -> io::Result<Arc<Self>> {
        let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
        let file = rustix::fs::memfd_create("ctos-pool", flags)?;
        rustix::fs::ftruncate(&file, SIZE as u64)?;
        let memory = Memory::of_file(file.as_fd(), SIZE)?;
        rustix::fs::fcntl_add_seals(&file, SEALS)?;
        Ok(Self::of(memory, Some(file)))
    }

    fn of(memory: Memory, file: Option<OwnedFd>) -> Arc<Self> {
        let all = BTreeMap::from([(0, memory.size())]);
        Arc::new(Self {
            memory: Arc::new(memory),
            file,
            state: Mutex::new(State {
                free: all,
                left: Vec::new(),
                closed: false,
            }),
        })
    }

    /// What a peer needs to borrow from it: the memory, and the end of a pipe that it keeps open as long
    /// as it holds any of it. The other end stays here.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn offer(&self) -> io::Result<(OwnedFd, [OwnedFd; 2])> {
        let file = self.file.as_ref().ok_or(io::ErrorKind::Unsupported)?;
        let (ours, theirs) = pipe_with(PipeFlags::CLOEXEC | PipeFlags::NONBLOCK)?;
        Ok((ours, [file.try_clone()?, theirs]))
    }

    /// A part of so many bytes; in it stands whatever stood there before. None when there is no room.
    pub(crate) fn block(self: &Arc<Self>, size: usize) -> Option<Block> {
        let room = size.max(1).checked_next_multiple_of(PAGE)?;
        self.sweep();
        let mut state = lock(&self.state);
        if state.closed {
            return None;
        }
        let fits = state.free.iter().find(|(_, free)| **free >= room);
        let (start, free) = fits.map(|(start, free)| (*start, *free))?;
        state.free.remove(&start);
        if free > room {
            state.free.insert(start + room, free - room);
        }
        drop(state);
        Some(Block {
            pool: self.clone(),
            start,
            room,
            size,
        })
    }

    /// Frees what peers held that are gone.
    fn sweep(&self) {
        let mut left = {
            let mut state = lock(&self.state);
            if state.left.is_empty() {
                return;
            }
            std::mem::take(&mut state.left)
        };
        // Without the lock, which every block that becomes free takes.
        left.retain_mut(|lent| !lent.is_over());
        lock(&self.state).left.append(&mut left);
    }

    fn give_back(&self, mut start: usize, mut room: usize) {
        let mut state = lock(&self.state);
        if let Some(after) = state.free.remove(&(start + room)) {
            room += after;
        }
        let before = state.free.range(..start).next_back();
        if let Some((before, size)) = before.map(|(before, size)| (*before, *size))
            && before + size == start
        {
            start = before;
            room += size;
        }
        state.free.insert(start, room);
    }

    /// Gives out nothing more, and forgets what peers still hold.
    pub(crate) fn close(&self) {
        let left = {
            let mut state = lock(&self.state);
            state.closed = true;
            std::mem::take(&mut state.left)
        };
        drop(left);
    }

    #[cfg(test)]
    fn free(&self) -> BTreeMap<usize, usize> {
        lock(&self.state).free.clone()
    }
}

/// A part of the pool that nobody else has yet.
pub(crate) struct Block {
    pool: Arc<Pool>,
    start: usize,
    room: usize,
    size: usize,
}

impl Deref for Block {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        // SAFETY: the block owns these bytes; while it is borrowed nobody writes to them.
        unsafe { self.pool.memory.bytes(self.start, self.size) }
    }
}

impl DerefMut for Block {
    fn deref_mut(&mut self) -> &mut [u8] {
        // SAFETY: the block owns these bytes and is borrowed exclusively; a pool's own mapping may be
        // written to.
        unsafe { self.pool.memory.bytes_mut(self.start, self.size) }
    }
}

impl AsRef<[u8]> for Block {
    fn as_ref(&self) -> &[u8] {
        self
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        self.pool.give_back(self.start, self.room);
    }
}

/// For each part that is lent a word that says so, in memory of both sides.
#[derive(Clone)]
pub(super) struct Words {
    pub(super) memory: Arc<Memory>,
    pub(super) start: usize,
}

impl Words {
    fn of(&self, slot: usize) -> &AtomicU32 {
        self.memory
            .word(self.start + slot.min(SLOTS - 1) * size_of::<u32>())
    }
}

/// What one peer holds of the pool.
struct Lent {
    words: Words,
    /// Ends when the peer holds nothing more and cannot.
    pipe: OwnedFd,
    held: Vec<Option<Bytes>>,
}

impl Lent {
    /// Takes back what was given back; whether anything is still out.
    fn collect(&mut self) -> bool {
        let mut any = false;
        for (slot, held) in self.held.iter_mut().enumerate() {
            if held.is_some() {
                if self.words.of(slot).load(Ordering::Acquire) == BACK {
                    *held = None;
                } else {
                    any = true;
                }
            }
        }
        any
    }

    /// Whether all of it is back, or nobody is there any more who could read it.
    fn is_over(&mut self) -> bool {
        !self.collect() || matches!(rustix::io::read(&self.pipe, &mut [0; 1]), Ok(0))
    }
}

/// This side's loans to one peer, for as long as a stream to it lasts. What is still out when that ends
/// stays with the pool until it is back.
pub(crate) struct Lending {
    pool: Arc<Pool>,
    lent: Option<Lent>,
}

impl Lending {
    pub(super) fn new(pool: Arc<Pool>, words: Words, pipe: OwnedFd) -> Self {
        let lent = Lent {
            words,
            pipe,
            held: vec![None; SLOTS],
        };
        Self {
            pool,
            lent: Some(lent),
        }
    }
}

impl Lend for Lending {
    fn lend(&mut self, bytes: &Bytes) -> Option<Place> {
        let lent = self.lent.as_mut()?;
        lent.collect();
        let slot = lent.held.iter().position(Option::is_none)?;
        let (offset, held) = match self.pool.memory.place_of(bytes) {
            Some(offset) => (offset, bytes.clone()),
            None => {
                let mut block = self.pool.block(bytes.len())?;
                block.copy_from_slice(bytes);
                (block.start, Bytes::from_owner(block))
            }
        };
        let place = Place {
            slot: u32::try_from(slot).ok()?,
            offset: offset as u64,
            length: held.len() as u64,
        };
        // Seen by the peer before the place is, which comes to it by the ring.
        lent.words.of(slot).store(LENT, Ordering::Relaxed);
        *lent.held.get_mut(slot)? = Some(held);
        Some(place)
    }

    fn collect(&mut self) {
        if let Some(lent) = &mut self.lent {
            lent.collect();
        }
    }
}

impl Drop for Lending {
    fn drop(&mut self) {
        if let Some(mut lent) = self.lent.take()
            && !lent.is_over()
        {
            let mut state = lock(&self.pool.state);
            if !state.closed {
                state.left.push(lent);
            }
        }
    }
}

/// A peer's pool.
pub(crate) struct Foreign {
    memory: Arc<Memory>,
    words: Words,
    /// Open as long as anything of the pool may be read here.
    _pipe: Option<OwnedFd>,
}

impl Foreign {
    /// Takes what the peer offers.
    ///
    /// # Errors
    /// When it is not what it should be, or could be made smaller later.
    pub(super) fn take([file, pipe]: [OwnedFd; 2], words: Words) -> io::Result<Arc<Self>> {
        let size = rustix::fs::fstat(&file)?.st_size;
        let seals = rustix::fs::fcntl_get_seals(&file)?;
        if u64::try_from(size) != Ok(SIZE as u64) || !seals.contains(SealFlags::SHRINK) {
            let text = "the pool that was passed has another size, or is not sealed";
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        Ok(Arc::new(Self {
            memory: Arc::new(Memory::of_file_to_read(file.as_fd(), SIZE)?),
            words,
            _pipe: Some(pipe),
        }))
    }

    /// What the peer has lent; given back when the last of its owners is gone. None when there is no such
    /// place.
    pub(crate) fn borrow(self: &Arc<Self>, place: Place) -> Option<Bytes> {
        let slot = usize::try_from(place.slot).ok()?;
        let start = usize::try_from(place.offset).ok()?;
        let size = usize::try_from(place.length).ok()?;
        let end = start.checked_add(size);
        let is_inside = end.is_some_and(|end| end <= self.memory.size());
        (slot < SLOTS && is_inside).then(|| {
            Bytes::from_owner(Borrowed {
                foreign: self.clone(),
                slot,
                start,
                size,
            })
        })
    }
}

/// A part of a peer's pool.
struct Borrowed {
    foreign: Arc<Foreign>,
    slot: usize,
    start: usize,
    size: usize,
}

impl AsRef<[u8]> for Borrowed {
    fn as_ref(&self) -> &[u8] {
        // SAFETY: the peer has lent it and writes nothing there until it is given back.
        unsafe { self.foreign.memory.bytes(self.start, self.size) }
    }
}

impl Drop for Borrowed {
    fn drop(&mut self) {
        // Behind all reads of it.
        self.foreign
            .words
            .of(self.slot)
            .store(BACK, Ordering::Release);
    }
}

#[cfg(test)]
pub(crate) mod tests;
