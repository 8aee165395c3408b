//! Shared memory as the words of the protocol. It knows nothing of what they mean, and nothing of files: the
//! one mapper of the workspace is [`ctos::shared_memory`].

use super::protocol::{Load, Store, WORD};
use ctos::shared_memory::Memory;
use std::sync::atomic::{AtomicU32, Ordering, fence};

/// A segment that this process reads.
pub(super) use ctos::shared_memory::View;

/// A segment that this process writes.
pub(super) type Page = Memory;

/// The first half of the word at `at`, which is used for nothing else.
pub(super) fn bell(page: &Page, at: usize) -> Option<&AtomicU32> {
    page.short(place(at))
}

/// The byte at which a word stands; beyond all memory for one that cannot be.
fn place(at: usize) -> usize {
    at.saturating_mul(WORD)
}

/// Reads whole words, also the last one, of which perhaps only a part is wanted. Nothing where they do not all lie
/// inside.
fn load_bytes(
    at: usize,
    bytes: &mut [u8],
    word: impl Fn(usize) -> Option<u64>,
    copy: impl Fn(usize, &mut [u8]) -> bool,
) {
    let (whole, rest) = bytes.split_at_mut(bytes.len() / WORD * WORD);
    let last = place(at).saturating_add(whole.len());
    if rest.is_empty() {
        copy(place(at), whole);
    } else if let Some(word) = word(last) {
        copy(place(at), whole);
        rest.copy_from_slice(word.to_ne_bytes().get(..rest.len()).unwrap_or_default());
    }
}

impl Load for View {
    fn load(&self, at: usize) -> u64 {
        self.word(place(at)).unwrap_or(0)
    }

    fn fence_acquire(&self) {
        fence(Ordering::Acquire);
    }

    fn load_bytes(&self, at: usize, bytes: &mut [u8]) {
        let copy = |at: usize, into: &mut [u8]| self.copy_out(at, into);
        load_bytes(at, bytes, |at| self.word(at), copy);
    }
}

impl Load for Page {
    fn load(&self, at: usize) -> u64 {
        let word = self.long(place(at));
        word.map_or(0, |word| word.load(Ordering::Relaxed))
    }

    fn fence_acquire(&self) {
        fence(Ordering::Acquire);
    }

    fn load_bytes(&self, at: usize, bytes: &mut [u8]) {
        let word = |at: usize| Some(self.long(at)?.load(Ordering::Relaxed));
        let copy = |at: usize, into: &mut [u8]| self.copy_out(at, into);
        load_bytes(at, bytes, word, copy);
    }
}

impl Store for Page {
    fn store(&self, at: usize, value: u64) {
        if let Some(word) = self.long(place(at)) {
            word.store(value, Ordering::Relaxed);
        }
    }

    fn fence_release(&self) {
        fence(Ordering::Release);
    }

    fn store_bytes(&self, at: usize, bytes: &[u8]) {
        let (whole, rest) = bytes.split_at(bytes.len() / WORD * WORD);
        let last = place(at).saturating_add(whole.len());
        if rest.is_empty() {
            self.copy_in(place(at), whole);
        } else if let Some(word) = self.long(last) {
            self.copy_in(place(at), whole);
            let mut bytes = [0; WORD];
            for (to, from) in bytes.iter_mut().zip(rest) {
                *to = *from;
            }
            word.store(u64::from_ne_bytes(bytes), Ordering::Relaxed);
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
        assert!(bell(&page, 4).is_none());
    }

    proptest! {
        #[test]
        fn bytes_of_any_length_come_back(seed in any::<u8>(), length in 0_usize..6000, at in 0_usize..9) {
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
