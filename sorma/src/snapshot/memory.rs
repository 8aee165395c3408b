//! Files mapped into memory as words that other processes may change at any moment: the only unsafe
//! code of the snapshot buffers. It knows nothing of what the words mean.
//!
//! Why it is sound:
//!
//! - A mapping is made by `mmap` of at least `words * 8` bytes at an address the kernel chooses, so the
//!   pointer is valid, page-aligned, and overlaps nothing that Rust owns. It is unmapped once, on drop,
//!   and everything that borrows from it borrows `self`.
//! - The words are only ever reached as atomics (or by the copies below), never through a reference to
//!   plain memory, so that what other processes do to them is no data race. They are plain numbers; no bit
//!   pattern is invalid.
//! - A [`View`] is mapped for reading only. It has relaxed loads and no others, which are the ones that the
//!   documentation of `std::sync::atomic` ("Atomic accesses to read-only memory") allows on such memory.
//! - The bell is one 32-bit word, which nothing reaches as part of a 64-bit one.
//! - The copies of long data are made by one machine instruction, whose effect on memory is that of a
//!   series of relaxed atomic byte accesses in no particular order. The other side of the copy is an
//!   ordinary slice that Rust lends for the time.
//!
//! What remains: a process of the same user may shorten the file, and whoever touches the missing pages is
//! then killed by the system (`SIGBUS`). Such a process could as well have sent the signal.

#![allow(unsafe_code)]

use super::protocol::{Load, Store, WORD};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::fs::File;
use std::io;
use std::ptr::{self, NonNull};
use std::slice;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};

/// From so many bytes on, a copy by one instruction is faster than word by word.
const LONG: usize = 2048;

/// A mapping that is never written by this process.
#[derive(Debug)]
pub(super) struct View(Mapping);

/// A mapping that this process writes.
#[derive(Debug)]
pub(super) struct Page(Mapping);

#[derive(Debug)]
struct Mapping {
    base: NonNull<AtomicU64>,
    words: usize,
}

// SAFETY: the memory belongs to no thread, and is only reached through atomics.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Mapping {
    fn new(file: &File, bytes: usize, protection: ProtFlags) -> io::Result<Self> {
        let present = usize::try_from(file.metadata()?.len()).unwrap_or(0);
        if bytes < WORD || present < bytes {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof));
        }
        // SAFETY: the kernel chooses a free address; see the argument above.
        let base = unsafe {
            mmap(
                ptr::null_mut(),
                bytes,
                protection,
                MapFlags::SHARED,
                file,
                0,
            )
        }?;
        let base = NonNull::new(base.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        let words = bytes / WORD;
        Ok(Self { base, words })
    }

    fn words(&self) -> &[AtomicU64] {
        // SAFETY: valid for `words` words as long as `self` lives; only atomics reach them.
        unsafe { slice::from_raw_parts(self.base.as_ptr(), self.words) }
    }

    fn range(&self, at: usize, bytes: usize) -> Option<*mut u8> {
        let end = at.checked_add(bytes.div_ceil(WORD))?;
        let words = self.words().get(at..end)?;
        Some(words.as_ptr().cast_mut().cast())
    }

    fn load(&self, at: usize) -> u64 {
        self.words()
            .get(at)
            .map_or(0, |word| word.load(Ordering::Relaxed))
    }

    fn load_floats(&self, at: usize, floats: &mut [f64]) {
        let words = self.words().get(at..).unwrap_or_default();
        for (float, word) in floats.iter_mut().zip(words) {
            *float = f64::from_bits(word.load(Ordering::Relaxed));
        }
    }

    fn load_bytes(&self, at: usize, bytes: &mut [u8]) {
        let Some(from) = self.range(at, bytes.len()) else {
            return;
        };
        if bytes.len() >= LONG && HAS_COPY {
            // SAFETY: `from` is valid for that many bytes, and the slice is ours.
            unsafe { copy(from, bytes.as_mut_ptr(), bytes.len()) };
            return;
        }
        let words = self.words().get(at..).unwrap_or_default();
        for (chunk, word) in bytes.chunks_mut(WORD).zip(words) {
            let word = word.load(Ordering::Relaxed).to_ne_bytes();
            chunk.copy_from_slice(word.get(..chunk.len()).unwrap_or_default());
        }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped once with this address and length, and nothing borrows from it any more.
        let unmapped = unsafe { munmap(self.base.as_ptr().cast(), self.words * WORD) };
        if let Err(error) = unmapped {
            tracing::warn!(%error, "shared memory stays mapped");
        }
    }
}

#[cfg(all(target_arch = "x86_64", not(miri)))]
const HAS_COPY: bool = true;
#[cfg(not(all(target_arch = "x86_64", not(miri))))]
const HAS_COPY: bool = false;

/// Copies bytes of which one side may be changing.
///
/// # Safety
/// `from` is valid for loads and `to` for stores of that many bytes, and they do not overlap.
#[cfg(all(target_arch = "x86_64", not(miri)))]
unsafe fn copy(from: *const u8, to: *mut u8, bytes: usize) {
    // SAFETY: as the caller promises; the direction flag is clear, as the platform demands.
    unsafe {
        std::arch::asm!(
            "rep movsb",
            inout("rcx") bytes => _,
            inout("rsi") from => _,
            inout("rdi") to => _,
            options(nostack, preserves_flags)
        );
    }
}

/// Never called where there is no such instruction.
///
/// # Safety
/// None is needed.
#[cfg(not(all(target_arch = "x86_64", not(miri))))]
unsafe fn copy(_from: *const u8, _to: *mut u8, _bytes: usize) {}

impl View {
    /// Maps the first `bytes` bytes of a file, for reading.
    ///
    /// # Errors
    /// The file is shorter than that, or the system refuses.
    pub(super) fn new(file: &File, bytes: usize) -> io::Result<Self> {
        Mapping::new(file, bytes, ProtFlags::READ).map(Self)
    }
}

impl Page {
    /// Maps the first `bytes` bytes of a file, for reading and writing.
    ///
    /// # Errors
    /// The file is shorter than that, or was opened for reading only, or the system refuses.
    pub(super) fn new(file: &File, bytes: usize) -> io::Result<Self> {
        Mapping::new(file, bytes, ProtFlags::READ | ProtFlags::WRITE).map(Self)
    }

    /// The first half of the word at `at`, which is used for nothing else.
    pub(super) fn bell(&self, at: usize) -> Option<&AtomicU32> {
        let bell: *const AtomicU32 = self.0.range(at, WORD)?.cast_const().cast();
        // SAFETY: inside the mapping, aligned for eight bytes, reached as 32 bits only.
        Some(unsafe { &*bell })
    }
}

impl Load for View {
    fn load(&self, at: usize) -> u64 {
        self.0.load(at)
    }
    fn fence_acquire(&self) {
        fence(Ordering::Acquire);
    }
    fn load_floats(&self, at: usize, floats: &mut [f64]) {
        self.0.load_floats(at, floats);
    }
    fn load_bytes(&self, at: usize, bytes: &mut [u8]) {
        self.0.load_bytes(at, bytes);
    }
}

impl Load for Page {
    fn load(&self, at: usize) -> u64 {
        self.0.load(at)
    }
    fn fence_acquire(&self) {
        fence(Ordering::Acquire);
    }
    fn load_floats(&self, at: usize, floats: &mut [f64]) {
        self.0.load_floats(at, floats);
    }
    fn load_bytes(&self, at: usize, bytes: &mut [u8]) {
        self.0.load_bytes(at, bytes);
    }
}

impl Store for Page {
    fn store(&self, at: usize, value: u64) {
        if let Some(word) = self.0.words().get(at) {
            word.store(value, Ordering::Relaxed);
        }
    }

    fn fence_release(&self) {
        fence(Ordering::Release);
    }

    fn store_floats(&self, at: usize, floats: &[f64]) {
        let words = self.0.words().get(at..).unwrap_or_default();
        for (word, float) in words.iter().zip(floats) {
            word.store(float.to_bits(), Ordering::Relaxed);
        }
    }

    fn store_bytes(&self, at: usize, bytes: &[u8]) {
        let Some(to) = self.0.range(at, bytes.len()) else {
            return;
        };
        if bytes.len() >= LONG && HAS_COPY {
            // SAFETY: `to` is valid for that many bytes, and the slice is lent to us.
            unsafe { copy(bytes.as_ptr(), to, bytes.len()) };
            return;
        }
        let words = self.0.words().get(at..).unwrap_or_default();
        let (chunks, rest) = bytes.as_chunks::<WORD>();
        for (word, chunk) in words.iter().zip(chunks) {
            word.store(u64::from_ne_bytes(*chunk), Ordering::Relaxed);
        }
        if let Some(word) = words.get(chunks.len()).filter(|_| !rest.is_empty()) {
            let mut last = [0; WORD];
            for (to, from) in last.iter_mut().zip(rest) {
                *to = *from;
            }
            word.store(u64::from_ne_bytes(last), Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn page(words: usize) -> (Page, View) {
        let file = tempfile::tempfile().unwrap();
        file.set_len((words * WORD) as u64).unwrap();
        let bytes = words * WORD;
        (
            Page::new(&file, bytes).unwrap(),
            View::new(&file, bytes).unwrap(),
        )
    }

    #[test]
    fn a_file_that_is_too_short_is_not_mapped() {
        let file = tempfile::tempfile().unwrap();
        file.set_len(64).unwrap();
        assert!(View::new(&file, 65).is_err());
        assert!(View::new(&file, 0).is_err());
        assert!(Page::new(&file, usize::MAX).is_err());
    }

    #[test]
    fn what_lies_outside_is_neither_read_nor_written() {
        let (page, view) = page(4);
        page.store(4, 1);
        page.store_floats(3, &[1.0, 2.0]);
        page.store_bytes(3, &[7; 9]);
        page.store_bytes(usize::MAX, &[7; 9]);
        assert_eq!(
            (view.load(3), view.load(4), view.load(usize::MAX)),
            (1.0_f64.to_bits(), 0, 0)
        );
        let mut bytes = [1; 9];
        view.load_bytes(3, &mut bytes);
        assert_eq!(bytes, [1; 9]);
        assert!(page.bell(4).is_none());
    }

    proptest! {
        #[test]
        fn bytes_of_any_length_come_back(seed in any::<u8>(), length in 0_usize..3 * LONG, at in 0_usize..9) {
            let bytes: Vec<u8> = (0..length).map(|i| (i as u8).wrapping_mul(31) ^ seed).collect();
            let (page, view) = page(at + length.div_ceil(WORD) + 1);
            page.store_bytes(at, &bytes);
            let mut back = vec![0; length];
            view.load_bytes(at, &mut back);
            prop_assert_eq!(&back, &bytes);
            prop_assert_eq!(view.load(at + length.div_ceil(WORD)), 0);
        }
    }
}
