//! The protocol of a cyclic snapshot buffer: how one writer and any number of readers share words of
//! memory. The writer never waits, and no reader takes a torn record for a whole one.
//!
//! Each slot is a sequence lock (Boehm, "Can seqlocks get along with programming language memory
//! models?", MSPC 2012). Its first word is `2 n - 1` while record `n` is being written and `2 n` when
//! it is whole. All words, data too, are relaxed atomics, so that there is no data race; fences order
//! them. The word holds the number of the record and not only its parity. So a reader also sees that
//! a slot holds another record than the one it wants.
//!
//! Written against a trait, so that the same lines run over shared memory and in a model checker. It
//! knows neither files nor clocks.

/// Words of memory that others may change at any moment. A load outside gives 0.
pub(super) trait Load {
    /// A relaxed load.
    fn load(&self, at: usize) -> u64;
    /// No load after it is made before a load that stands before it.
    fn fence_acquire(&self);

    /// Copies words into floats.
    fn load_floats(&self, at: usize, floats: &mut [f64]) {
        for (index, float) in floats.iter_mut().enumerate() {
            *float = f64::from_bits(self.load(at + index));
        }
    }

    /// Copies words into bytes, in the order in which they lie in memory.
    fn load_bytes(&self, at: usize, bytes: &mut [u8]) {
        for (index, chunk) in bytes.chunks_mut(WORD).enumerate() {
            let word = self.load(at + index).to_ne_bytes();
            chunk.copy_from_slice(word.get(..chunk.len()).unwrap_or_default());
        }
    }
}

/// Words that may be written too. A store outside does nothing.
pub(super) trait Store: Load {
    /// A relaxed store.
    fn store(&self, at: usize, word: u64);
    /// No store after it is made before a store that stands before it.
    fn fence_release(&self);

    /// Copies floats into words.
    fn store_floats(&self, at: usize, floats: &[f64]) {
        for (index, float) in floats.iter().enumerate() {
            self.store(at + index, float.to_bits());
        }
    }

    /// Copies bytes into words; the rest of the last word is 0.
    fn store_bytes(&self, at: usize, bytes: &[u8]) {
        for (index, chunk) in bytes.chunks(WORD).enumerate() {
            let mut word = [0; WORD];
            for (to, from) in word.iter_mut().zip(chunk) {
                *to = *from;
            }
            self.store(at + index, u64::from_ne_bytes(word));
        }
    }
}

/// Bytes of a word.
pub(super) const WORD: usize = 8;

/// Words of a slot before its floats.
pub(super) const SLOT_HEAD: usize = 8;
const SEQUENCE: usize = 0;
const STAMP: usize = 1;
const GENERATION: usize = 2;
const LENGTH: usize = 3;

/// Where the slots lie, and how large a record is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Ring {
    /// The word that holds the number of the latest whole record; 0 before the first.
    pub(super) head: usize,
    /// The first word of the first slot.
    pub(super) first: usize,
    /// Words from one slot to the next.
    pub(super) stride: usize,
    /// How many slots there are; never 0.
    pub(super) slots: u64,
    pub(super) floats: usize,
    /// The most opaque bytes of a record.
    pub(super) bytes: usize,
}

/// What is written beside the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Mark {
    /// The number of the record, from 1 on.
    pub(super) count: u64,
    /// When it was written, ns of the host's clock.
    pub(super) stamp_ns: u64,
    /// Which writer wrote it, from 1 on.
    pub(super) generation: u64,
}

/// What became of reading a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Taken {
    /// It was read whole.
    Whole(Mark),
    /// Its slot holds a later record, or is being written for one.
    Overwritten,
    /// It is not there yet.
    NotYet,
}

impl Ring {
    fn slot(&self, count: u64) -> usize {
        let index = count.wrapping_sub(1) % self.slots.max(1);
        // The index is below the number of slots, which all lie in memory.
        self.first + usize::try_from(index).unwrap_or(0) * self.stride
    }

    fn bytes_at(&self, slot: usize) -> usize {
        slot + SLOT_HEAD + self.floats
    }

    /// The number of the latest whole record; 0 when there is none.
    pub(super) fn head<M: Load>(&self, memory: &M) -> u64 {
        let head = memory.load(self.head);
        memory.fence_acquire();
        head
    }

    /// The number of the oldest record that is not yet due to be overwritten.
    pub(super) fn oldest(&self, head: u64) -> u64 {
        head.saturating_sub(self.slots).saturating_add(1)
    }

    /// Writes a record. The data have the ring's number of floats, and at most its bytes.
    pub(super) fn write<M: Store>(&self, memory: &M, mark: Mark, floats: &[f64], bytes: &[u8]) {
        let slot = self.slot(mark.count);
        let whole = mark.count.wrapping_mul(2);
        memory.store(slot + SEQUENCE, whole.wrapping_sub(1));
        memory.fence_release();
        memory.store(slot + STAMP, mark.stamp_ns);
        memory.store(slot + GENERATION, mark.generation);
        memory.store(slot + LENGTH, bytes.len() as u64);
        memory.store_floats(slot + SLOT_HEAD, floats);
        memory.store_bytes(self.bytes_at(slot), bytes);
        memory.fence_release();
        memory.store(slot + SEQUENCE, whole);
        // A reader that learns of the record finds it whole.
        memory.fence_release();
        memory.store(self.head, mark.count);
    }

    /// Reads record `count` into the buffers, which keep their memory.
    pub(super) fn read<M: Load>(
        &self,
        memory: &M,
        count: u64,
        floats: &mut Vec<f64>,
        bytes: &mut Vec<u8>,
    ) -> Taken {
        let slot = self.slot(count);
        let whole = count.wrapping_mul(2);
        let before = memory.load(slot + SEQUENCE);
        memory.fence_acquire();
        if before != whole {
            return if before > whole {
                Taken::Overwritten
            } else {
                Taken::NotYet
            };
        }
        let mark = Mark {
            count,
            stamp_ns: memory.load(slot + STAMP),
            generation: memory.load(slot + GENERATION),
        };
        // Whatever the memory says, no more than a slot holds.
        let length = usize::try_from(memory.load(slot + LENGTH)).unwrap_or(usize::MAX);
        floats.resize(self.floats, 0.0);
        bytes.resize(length.min(self.bytes), 0);
        memory.load_floats(slot + SLOT_HEAD, floats);
        memory.load_bytes(self.bytes_at(slot), bytes);
        memory.fence_acquire();
        if memory.load(slot + SEQUENCE) == whole {
            Taken::Whole(mark)
        } else {
            Taken::Overwritten
        }
    }

    /// Takes over from a writer that may have ended anywhere. Gives the number of the latest whole
    /// record, and announces it if its writer did not come to that. `None` when the memory makes no
    /// sense.
    ///
    /// The slot of a record that was begun and not ended is the one that is written next, so it needs
    /// no repair.
    pub(super) fn recover<M: Store>(&self, memory: &M) -> Option<u64> {
        let head = self.head(memory);
        let next = head.checked_add(1)?;
        let limit = u64::MAX / 4;
        if head > limit || (head > 0 && !self.holds(memory, head)) {
            return None;
        }
        if !self.holds(memory, next) {
            return Some(head);
        }
        memory.fence_release();
        memory.store(self.head, next);
        Some(next)
    }

    fn holds<M: Load>(&self, memory: &M, count: u64) -> bool {
        let sequence = memory.load(self.slot(count) + SEQUENCE);
        memory.fence_acquire();
        sequence == count.wrapping_mul(2)
            // With one slot the next record may have been begun over this one.
            || (self.slots == 1 && sequence >= count.wrapping_mul(2))
    }
}

#[cfg(test)]
mod tests;
