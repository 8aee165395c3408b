//! The table made anew: twice as long when it has become too full, or for another layout. The store is
//! somebody's alone meanwhile.

use std::{
    ops::Range,
    sync::atomic::{AtomicU32, Ordering},
};

use super::{
    super::layout::{Layout, linear, linear_of, mix},
    BATCH, EMPTY, MOVED_TOGETHER, Store, empty,
};

/// Slots on a page of memory, or fewer.
const PAGE_SLOTS: usize = 1 << 10;

impl Store {
    /// A table of twice the length, filled by so many threads. Some numbers, in order, are not given yet.
    pub(super) fn grow(&mut self, threads: usize, free: &[Range<u32>]) {
        let size = self.table.len() * 2;
        self.peak = self.peak.max(self.bytes() + size * 4);
        self.table = empty(size);
        self.bits += 1;
        self.mask = size - 1;
        let ends = free.iter().map(|range| range.end);
        let starts = free.iter().map(|range| range.start);
        let ends = std::iter::once(0).chain(ends);
        let given = ends.zip(starts.chain([self.numbers() as u32]));
        let given: Vec<Range<u32>> = given.map(|(start, end)| start..end).collect();
        let count = if size < MOVED_TOGETHER {
            1
        } else {
            threads.max(1)
        };
        // Each thread fills slots of its own, so that no line of memory goes to and fro between them.
        let part = |thread: usize| size * thread / count..size * (thread + 1) / count;
        let (store, given) = (&*self, &given);
        let left = std::thread::scope(|scope| {
            let others =
                (1..count).map(|thread| scope.spawn(move || store.fill(part(thread), given)));
            let others: Vec<_> = others.collect();
            let mut left = store.fill(part(0), given);
            for other in others {
                let result = other.join();
                left.extend(result.unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            }
            left
        });
        for (slot, held) in left {
            self.settle(slot, held);
        }
    }

    /// Puts those numbers into the table that belong into some of its slots. What finds no room there is
    /// left: where to look on, and what is to be held there.
    fn fill(&self, slots: Range<usize>, given: &[Range<u32>]) -> Vec<(usize, u32)> {
        let mut left = Vec::new();
        // A page that is read first is the kernel's page of zeros. The first write replaces it, and
        // interrupts the other cores for that. So each is written first.
        for slot in self.table[slots.clone()].iter().step_by(PAGE_SLOTS) {
            slot.store(!EMPTY, Ordering::Relaxed);
        }
        let mut looks = [(0, 0, 0); BATCH];
        for range in given {
            for start in range.clone().step_by(BATCH) {
                let numbers = start..range.end.min(start.saturating_add(BATCH as u32));
                let mut count = 0;
                for number in numbers {
                    let words = self.at(number).iter();
                    let hash = mix(linear_of(words.map(|word| word.load(Ordering::Relaxed))));
                    let slot = hash as usize & self.mask;
                    looks[count] = (slot, self.tag(hash) | number, 0);
                    // Whose they are cannot be foreseen, so nothing is jumped over.
                    count += usize::from(slots.contains(&slot));
                }
                // All are looked at first, so that the waiting for memory overlaps.
                for (slot, _, found) in &mut looks[..count] {
                    *found = self.table[*slot].load(Ordering::Relaxed);
                }
                for (slot, held, found) in &looks[..count] {
                    let first = *slot + usize::from(*found != !EMPTY);
                    if !self.settle_within(first..slots.end, *held) {
                        left.push((slots.end & self.mask, *held));
                    }
                }
            }
        }
        left
    }

    /// Puts what is not in the table into the first of some slots that is empty; false when none is. No other
    /// thread puts anything there. None looks before all is done, and then through the thread that waited for
    /// that.
    fn settle_within(&self, slots: Range<usize>, held: u32) -> bool {
        let mut slots = self.table[slots].iter();
        let empty = slots.find(|slot| slot.load(Ordering::Relaxed) == !EMPTY);
        if let Some(slot) = empty {
            slot.store(!held, Ordering::Relaxed);
        }
        empty.is_some()
    }

    /// The same from a slot on.
    fn settle(&self, slot: usize, held: u32) {
        let size = self.table.len();
        let _ = self.settle_within(slot..size, held) || self.settle_within(0..slot, held);
    }

    /// The same markings under the same numbers in another layout.
    pub(in crate::analysis) fn repacked(&self, old: &Layout, new: &Layout) -> Self {
        let mut store = Self::new(new.words);
        store.table = empty(self.table.len());
        (store.mask, store.bits) = (self.mask, self.bits);
        store.make_blocks(self.numbers());
        store.next = AtomicU32::new(self.next.load(Ordering::Relaxed));
        store.peak = self.peak.max(self.bytes() + store.bytes());
        let (mut words, mut marking, mut packed) = (Vec::new(), Vec::new(), Vec::new());
        for slot in &self.table {
            let held = !slot.load(Ordering::Relaxed);
            if held == EMPTY {
                continue;
            }
            let number = held & self.mask as u32;
            self.read(number, &mut words);
            old.unpack(&words, &mut marking);
            new.pack(&marking, &mut packed);
            for (place, word) in store.at(number).iter().zip(&packed) {
                place.store(*word, Ordering::Relaxed);
            }
            let hash = mix(linear(&packed));
            let slot = hash as usize & self.mask;
            store.settle(slot, store.tag(hash) | number);
        }
        store
    }
}
