//! Memory that processes share: a file mapped as bytes and words that another process may change at any moment.
//! The only mapper of the workspace: links join chassis of one host by it, and sorma's
//! snapshot buffers lay their fields out in it. It knows nothing of what the bytes mean.
//!
//! # Why this is sound
//!
//! - A mapping is made by `mmap` of at least as many bytes as the file has, at an address that the kernel
//!   chooses. So the pointer is valid, page-aligned, and overlaps nothing that Rust owns. It is unmapped
//!   once, on drop, and everything that borrows from it borrows `self`.
//! - The memory is only reached as atomics, or by the copies below, never through a reference to plain
//!   memory. So what other processes do to it is not a data race. Every access is checked to lie inside, and
//!   no bit pattern is invalid.
//! - A [`View`] is mapped for reading only. It has relaxed loads and no others, which are the ones that the
//!   documentation of `std::sync::atomic` ("Atomic accesses to read-only memory") allows on such memory.
//! - A copy goes byte by byte to the next whole word, word by word, and byte by byte to its end. Each
//!   access is a relaxed atomic. One machine instruction makes a long copy. Its effect on memory is that
//!   of a series of relaxed atomic byte accesses in no particular order. The other side of the copy is an
//!   ordinary slice that Rust lends for the time.
//! - Accesses of different sizes to the same bytes must not race. The users of the memory ensure that. A
//!   word of 32 bits is never accessed with 64. Bytes that are copied while the other side changes them
//!   (snapshots) are copied in whole words; those of a ring are ordered by its positions.
//!
//! What remains: a file that is shortened takes its pages with it, and the system kills a process that
//! touches them (`SIGBUS`). Links seal theirs against that; a process of the same user that shortens a
//! snapshot buffer could as well have sent the signal.

#![allow(
    unsafe_code,
    reason = "memory that another process maps cannot be reached otherwise; the argument is above"
)]

use std::{
    io,
    os::fd::{AsFd, BorrowedFd},
    ptr::{self, NonNull},
    sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering},
};

use rustix::mm::{MapFlags, ProtFlags};

/// Bytes of a word.
pub const WORD: usize = 8;

/// From so many bytes on, a copy by one instruction is faster than word by word.
const LONG: usize = 2048;

/// Shared memory that this process only reads.
#[derive(Debug)]
pub struct View(Mapping);

/// Shared memory that this process reads and writes.
#[derive(Debug)]
pub struct Memory(Mapping);

#[derive(Debug)]
struct Mapping {
    start: NonNull<u8>,
    size: usize,
    mapped: bool,
}

// SAFETY: the memory belongs to no thread, and is only reached through atomics.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Mapping {
    fn new(file: BorrowedFd<'_>, size: usize, protection: ProtFlags) -> io::Result<Self> {
        let present = usize::try_from(rustix::fs::fstat(file)?.st_size).unwrap_or(0);
        if size < WORD || present < size {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        // SAFETY: a new mapping at an address of the system's choice touches nothing that exists.
        let start = unsafe {
            rustix::mm::mmap(ptr::null_mut(), size, protection, MapFlags::SHARED, file, 0)
        }?;
        let start = NonNull::new(start.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self {
            start,
            size,
            mapped: true,
        })
    }

    /// Where `count` bytes from `at` on stand, if they all lie inside.
    fn place(&self, at: usize, count: usize) -> Option<*mut u8> {
        let inside = at <= self.size && self.size - at >= count;
        // SAFETY: inside the mapping, or at its end.
        inside.then(|| unsafe { self.start.as_ptr().add(at) })
    }

    /// The word at byte `at`, if it lies inside and is aligned.
    fn long(&self, at: usize) -> Option<&AtomicU64> {
        let place = self.place(at, WORD).filter(|_| at.is_multiple_of(WORD))?;
        // SAFETY: inside and aligned (the start is page-aligned); all accesses to it are atomic.
        Some(unsafe { AtomicU64::from_ptr(place.cast()) })
    }

    fn load(&self, at: usize, into: &mut [u8]) -> bool {
        let Some(from) = self.place(at, into.len()) else {
            return false;
        };
        // SAFETY: `from` is valid for that many bytes, and the slice is ours.
        if into.len() >= LONG && unsafe { copy(from, into.as_mut_ptr(), into.len()) } {
            return true;
        }
        let (head, rest) = into.split_at_mut(to_word(at).min(into.len()));
        let words = at + head.len();
        let (chunks, tail) = rest.as_chunks_mut::<WORD>();
        let last = words + chunks.len() * WORD;
        self.load_each(at, head);
        for (index, chunk) in chunks.iter_mut().enumerate() {
            if let Some(word) = self.long(words + index * WORD) {
                *chunk = word.load(Ordering::Relaxed).to_ne_bytes();
            }
        }
        self.load_each(last, tail);
        true
    }

    fn load_each(&self, at: usize, into: &mut [u8]) {
        for (index, byte) in into.iter_mut().enumerate() {
            if let Some(place) = self.place(at + index, 1) {
                // SAFETY: inside; all accesses to it are atomic.
                *byte = unsafe { AtomicU8::from_ptr(place) }.load(Ordering::Relaxed);
            }
        }
    }

    fn store(&self, at: usize, from: &[u8]) -> bool {
        let Some(to) = self.place(at, from.len()) else {
            return false;
        };
        // SAFETY: `to` is valid for that many bytes, and the slice is lent to us.
        if from.len() >= LONG && unsafe { copy(from.as_ptr(), to, from.len()) } {
            return true;
        }
        let (head, rest) = from.split_at(to_word(at).min(from.len()));
        let words = at + head.len();
        let (chunks, tail) = rest.as_chunks::<WORD>();
        let last = words + chunks.len() * WORD;
        self.store_each(at, head);
        for (index, chunk) in chunks.iter().enumerate() {
            if let Some(word) = self.long(words + index * WORD) {
                word.store(u64::from_ne_bytes(*chunk), Ordering::Relaxed);
            }
        }
        self.store_each(last, tail);
        true
    }

    fn store_each(&self, at: usize, from: &[u8]) {
        for (index, byte) in from.iter().enumerate() {
            if let Some(place) = self.place(at + index, 1) {
                // SAFETY: inside; all accesses to it are atomic.
                unsafe { AtomicU8::from_ptr(place) }.store(*byte, Ordering::Relaxed);
            }
        }
    }
}

/// Bytes from `at` to the next whole word.
fn to_word(at: usize) -> usize {
    at.wrapping_neg() % WORD
}

impl Drop for Mapping {
    fn drop(&mut self) {
        if self.mapped {
            // SAFETY: mapped once with this address and size, and nothing borrows from it any more.
            let unmapped = unsafe { rustix::mm::munmap(self.start.as_ptr().cast(), self.size) };
            if let Err(error) = unmapped {
                tracing::warn!(%error, "shared memory stays mapped");
            }
        }
        #[cfg(test)]
        if !self.mapped {
            // SAFETY: allocated by `private` with the same layout.
            unsafe { std::alloc::dealloc(self.start.as_ptr(), private_layout(self.size)) };
        }
    }
}

/// Copies bytes of which one side may be changing, where an instruction does that; whether it did.
///
/// # Safety
/// `from` is valid for loads and `to` for stores of that many bytes, and they do not overlap.
#[cfg(all(target_arch = "x86_64", not(miri)))]
unsafe fn copy(from: *const u8, to: *mut u8, count: usize) -> bool {
    // SAFETY: as the caller promises; the direction flag is clear, as the platform demands.
    unsafe {
        std::arch::asm!(
            "rep movsb",
            inout("rcx") count => _,
            inout("rsi") from => _,
            inout("rdi") to => _,
            options(nostack, preserves_flags)
        );
    }
    true
}

/// # Safety
/// None is needed.
#[cfg(not(all(target_arch = "x86_64", not(miri))))]
unsafe fn copy(_from: *const u8, _to: *mut u8, _count: usize) -> bool {
    false
}

impl View {
    /// Maps the first `size` bytes of a file, for reading.
    ///
    /// # Errors
    /// The file is shorter than that, or the system refuses.
    pub fn new(file: impl AsFd, size: usize) -> io::Result<Self> {
        Mapping::new(file.as_fd(), size, ProtFlags::READ).map(Self)
    }

    /// The word at byte `at`, by a relaxed load; `None` outside.
    #[must_use]
    pub fn word(&self, at: usize) -> Option<u64> {
        Some(self.0.long(at)?.load(Ordering::Relaxed))
    }

    /// Copies what stands at byte `at` into `into`; false, and nothing done, when not all of it lies inside.
    pub fn copy_out(&self, at: usize, into: &mut [u8]) -> bool {
        self.0.load(at, into)
    }
}

impl Memory {
    /// Maps the first `size` bytes of a file, for reading and writing.
    ///
    /// # Errors
    /// The file is shorter than that, or was opened for reading only, or the system refuses.
    pub fn new(file: impl AsFd, size: usize) -> io::Result<Self> {
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        Mapping::new(file.as_fd(), size, protection).map(Self)
    }

    /// The 64-bit word at byte `at`; `None` outside, or when it is not aligned.
    #[must_use]
    pub fn long(&self, at: usize) -> Option<&AtomicU64> {
        self.0.long(at)
    }

    /// The 32-bit word at byte `at`; `None` outside, or when it is not aligned. Reached with 32 bits only.
    #[must_use]
    pub fn short(&self, at: usize) -> Option<&AtomicU32> {
        let place = self.0.place(at, 4).filter(|_| at.is_multiple_of(4))?;
        // SAFETY: inside and aligned (the start is page-aligned); all accesses to it are atomic.
        Some(unsafe { AtomicU32::from_ptr(place.cast()) })
    }

    /// Copies what stands at byte `at` into `into`; false, and nothing done, when not all of it lies inside.
    pub fn copy_out(&self, at: usize, into: &mut [u8]) -> bool {
        self.0.load(at, into)
    }

    /// Copies `from` to byte `at`; false, and nothing done, when it does not fit inside.
    pub fn copy_in(&self, at: usize, from: &[u8]) -> bool {
        self.0.store(at, from)
    }

    /// Memory of this process alone, for Miri, which knows no files.
    #[cfg(test)]
    pub(crate) fn private(size: usize) -> Self {
        // SAFETY: the size is not zero.
        let start = unsafe { std::alloc::alloc_zeroed(private_layout(size)) };
        Self(Mapping {
            start: NonNull::new(start).unwrap(),
            size,
            mapped: false,
        })
    }
}

#[cfg(test)]
fn private_layout(size: usize) -> std::alloc::Layout {
    std::alloc::Layout::from_size_align(size, 4096).unwrap()
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, atomic::fence};

    use proptest::prelude::*;

    use super::*;

    fn both(size: usize) -> (Memory, View) {
        let file = tempfile::tempfile().unwrap();
        file.set_len(size as u64).unwrap();
        (
            Memory::new(&file, size).unwrap(),
            View::new(&file, size).unwrap(),
        )
    }

    #[cfg(not(miri))]
    #[test]
    fn a_file_that_is_too_short_is_not_mapped() {
        let file = tempfile::tempfile().unwrap();
        file.set_len(64).unwrap();
        assert!(View::new(&file, 65).is_err());
        assert!(View::new(&file, 0).is_err());
        assert!(Memory::new(&file, usize::MAX).is_err());
    }

    #[cfg(not(miri))]
    #[test]
    fn what_lies_outside_or_across_is_neither_read_nor_written() {
        let (memory, view) = both(32);
        assert!(!memory.copy_in(24, &[7; 9]) && !memory.copy_in(usize::MAX, &[7]));
        let mut bytes = [1; 9];
        assert!(!view.copy_out(24, &mut bytes) && !memory.copy_out(33, &mut []));
        assert_eq!((bytes, view.word(24)), ([1; 9], Some(0)));
        assert!(view.word(25).is_none() && view.word(32).is_none());
        assert!(memory.long(12).is_none() && memory.long(usize::MAX).is_none());
        assert!(memory.short(28).is_some() && memory.short(30).is_none());
        assert!(memory.short(32).is_none());
    }

    #[cfg(not(miri))]
    proptest! {
        #[test]
        fn bytes_of_any_length_come_back_from_anywhere_and_touch_no_others(
            seed: u8, length in 0_usize..3 * LONG, at in 0_usize..40,
        ) {
            let bytes: Vec<u8> = (0..length).map(|i| (i as u8).wrapping_mul(31) ^ seed).collect();
            let (memory, view) = both(at + length + 20);
            prop_assert!(memory.copy_in(0, &vec![0xa5; at + length + 20]));
            prop_assert!(memory.copy_in(at, &bytes));
            let mut all = vec![0; at + length + 20];
            prop_assert!(view.copy_out(0, &mut all));
            prop_assert_eq!(&all[at..at + length], &bytes);
            prop_assert!(all[..at].iter().chain(&all[at + length..]).all(|byte| *byte == 0xa5));
            let mut back = vec![0; length];
            prop_assert!(memory.copy_out(at, &mut back));
            prop_assert_eq!(back, bytes);
        }
    }

    /// One thread fills areas of many sizes with one byte each, releases each, and takes the next when it
    /// was read. The other must find each area whole.
    fn play(writer: &Memory, reader: &Memory, rounds: u64) {
        let area = |round: u64| {
            (
                16 + (round as usize * 7) % 61,
                (round as usize * 131) % 5000,
            )
        };
        std::thread::scope(|scope| {
            scope.spawn(move || {
                for round in 1..=rounds {
                    let (at, size) = area(round);
                    assert!(writer.copy_in(at, &vec![round as u8; size]));
                    writer.long(0).unwrap().store(round, Ordering::Release);
                    while writer.long(8).unwrap().load(Ordering::Acquire) < round {
                        std::thread::yield_now();
                    }
                }
            });
            for round in 1..=rounds {
                while reader.long(0).unwrap().load(Ordering::Acquire) < round {
                    std::thread::yield_now();
                }
                let (at, size) = area(round);
                let mut bytes = vec![0; size];
                assert!(reader.copy_out(at, &mut bytes));
                assert!(bytes.iter().all(|byte| *byte == round as u8));
                reader.long(8).unwrap().store(round, Ordering::Release);
            }
        });
    }

    #[test]
    fn what_was_released_is_found_whole() {
        let memory = Memory::private(8192);
        play(&memory, &memory, if cfg!(miri) { 30 } else { 4_000 });
    }

    #[cfg(not(miri))]
    #[test]
    fn two_mappings_of_one_file_are_the_same_memory() {
        let file = tempfile::tempfile().unwrap();
        file.set_len(8192).unwrap();
        let map = || Memory::new(&file, 8192).unwrap();
        play(&map(), &map(), 4_000);
    }

    /// Whole words never tear, whatever the other side writes meanwhile.
    #[test]
    fn words_that_are_changed_while_they_are_copied_are_old_or_new_each() {
        const WORDS: usize = 64;
        let rounds = if cfg!(miri) { 20_u64 } else { 50_000 };
        let memory = Arc::new(Memory::private(WORDS * WORD));
        let writer = memory.clone();
        let writes = std::thread::spawn(move || {
            for round in 0..rounds {
                assert!(writer.copy_in(0, &[round as u8; WORDS * WORD]));
                fence(Ordering::Release);
            }
        });
        let mut bytes = [0; WORDS * WORD];
        while !writes.is_finished() {
            assert!(memory.copy_out(0, &mut bytes));
            for word in bytes.as_chunks::<WORD>().0 {
                assert!(word.iter().all(|byte| *byte == word[0]), "{word:?}");
            }
        }
        writes.join().unwrap();
    }
}
