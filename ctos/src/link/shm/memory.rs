//! The one place where shared memory is touched.
//!
//! # Why this is sound
//!
//! A [`Memory`] owns a mapping (or, in tests, an allocation) of `size` bytes that lives as long as it
//! does, is page-aligned and is never handed out as a slice or a reference to plain data. There are two
//! kinds of access. Fields are reached as atomics at checked, aligned places; a field and the data of a
//! ring never overlap, because [`super::Shared::split`] alone lays them out. Data is reached by copies to and from
//! ordinary buffers within checked bounds. Between two honest sides the ring's positions order these
//! copies (the writer releases, the reader acquires, and the other way round), so none of them races;
//! the test of the ring holds that under Miri. A dishonest process may write at any moment: that is
//! outside of this program's memory model, as with any device, and the copy then holds some bytes or
//! others, which are checked after they were copied as everything from a network is. The file is sealed
//! against shrinking, so no access can fault.

#![allow(
    unsafe_code,
    reason = "memory that another process maps cannot be reached otherwise; the argument is above"
)]

use std::{
    io,
    os::fd::BorrowedFd,
    ptr::{self, NonNull},
    sync::atomic::{AtomicU32, AtomicU64},
};

use rustix::mm::{MapFlags, ProtFlags};

/// Bytes that another process may share.
#[derive(Debug)]
pub(super) struct Memory {
    start: NonNull<u8>,
    size: usize,
    mapped: bool,
}

// SAFETY: the memory belongs to no thread, and every access goes through atomics or ordered copies.
unsafe impl Send for Memory {}
// SAFETY: as above.
unsafe impl Sync for Memory {}

impl Memory {
    /// Maps the first `size` bytes of a file.
    pub(super) fn of_file(file: BorrowedFd<'_>, size: usize) -> io::Result<Self> {
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping at an address of the system's choice touches nothing that exists.
        let start = unsafe {
            rustix::mm::mmap(ptr::null_mut(), size, protection, MapFlags::SHARED, file, 0)
        }?;
        let start = NonNull::new(start.cast::<u8>());
        let start = start.ok_or_else(|| io::Error::other("the memory was mapped at zero"))?;
        Ok(Self {
            start,
            size,
            mapped: true,
        })
    }

    /// Memory of this process alone.
    #[cfg(test)]
    pub(super) fn private(size: usize) -> Self {
        let layout = Self::layout(size);
        // SAFETY: the size is not zero.
        let start = unsafe { std::alloc::alloc_zeroed(layout) };
        Self {
            start: NonNull::new(start).unwrap(),
            size,
            mapped: false,
        }
    }

    #[cfg(test)]
    fn layout(size: usize) -> std::alloc::Layout {
        std::alloc::Layout::from_size_align(size, 4096).unwrap()
    }

    /// The 32-bit field at `place`.
    pub(super) fn word(&self, place: usize) -> &AtomicU32 {
        assert!(place.is_multiple_of(4) && place < self.size && self.size - place >= 4);
        // SAFETY: in bounds and aligned (the start is page-aligned); all accesses to it are atomic.
        unsafe { AtomicU32::from_ptr(self.start.add(place).cast().as_ptr()) }
    }

    /// The 64-bit field at `place`.
    pub(super) fn long(&self, place: usize) -> &AtomicU64 {
        assert!(place.is_multiple_of(8) && place < self.size && self.size - place >= 8);
        // SAFETY: in bounds and aligned (the start is page-aligned); all accesses to it are atomic.
        unsafe { AtomicU64::from_ptr(self.start.add(place).cast().as_ptr()) }
    }

    /// Copies `bytes` to `place`.
    pub(super) fn copy_in(&self, place: usize, bytes: &[u8]) {
        assert!(place <= self.size && self.size - place >= bytes.len());
        // SAFETY: in bounds; `bytes` is ordinary memory, which does not overlap the mapping.
        unsafe {
            ptr::copy_nonoverlapping(bytes.as_ptr(), self.start.add(place).as_ptr(), bytes.len());
        }
    }

    /// Copies what is at `place` into `bytes`.
    pub(super) fn copy_out(&self, place: usize, bytes: &mut [u8]) {
        assert!(place <= self.size && self.size - place >= bytes.len());
        // SAFETY: in bounds; `bytes` is ordinary memory, which does not overlap the mapping.
        unsafe {
            ptr::copy_nonoverlapping(
                self.start.add(place).as_ptr(),
                bytes.as_mut_ptr(),
                bytes.len(),
            );
        }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        if self.mapped {
            // SAFETY: the mapping is this one's own, and nothing borrowed from it outlives it.
            // An error would say that the address is not one.
            let _ = unsafe { rustix::mm::munmap(self.start.as_ptr().cast(), self.size) };
        }
        #[cfg(test)]
        if !self.mapped {
            // SAFETY: allocated by `private` with the same layout.
            unsafe { std::alloc::dealloc(self.start.as_ptr(), Self::layout(self.size)) };
        }
    }
}
