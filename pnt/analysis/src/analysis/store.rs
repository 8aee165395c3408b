//! Packed markings by number, found again by their content. They stand in an arena of blocks that never
//! move, with an open table of 32-bit slots, at most three quarters full. A number is smaller than the
//! table is long, so the other bits of a slot hold some of the hash. What differs there need not be looked
//! up in the arena.
//!
//! Several threads may find and insert at once. Each has numbers of its own to give, a [`Share`]. It
//! writes a new marking into the arena at one of them and then claims an empty slot of the table by
//! compare-and-swap. The swap releases what was written, and a thread that reads the slot acquires
//! it. A thread that loses a slot looks at it again, and gives the number to the next marking. Slots
//! never change once they are taken, except when the table grows; for that one thread must own the
//! store.

mod table;

use std::{
    collections::VecDeque,
    mem,
    ops::Range,
    sync::{
        OnceLock,
        atomic::{AtomicU32, AtomicU64, Ordering},
    },
};

use super::layout::mix;

/// Markings of one block. Fewer in tests, here and below, so that small nets come to everything.
const BLOCK: usize = if cfg!(test) { 8 } else { 1 << 14 };

/// Slots of the first table.
const FIRST_TABLE: usize = if cfg!(test) { 8 } else { 64 };

/// Numbers that a thread takes at once.
const PIECE: usize = if cfg!(test) { 2 } else { 1 << 10 };

/// Slots from which on several threads together move a table.
const MOVED_TOGETHER: usize = if cfg!(test) { 16 } else { 1 << 16 };

/// An empty slot. No number has all bits set: the table is never full. The value of a slot is stored with
/// all bits inverted, so that an empty table is zeros. The kernel makes these page by page for the thread
/// that comes to them first.
const EMPTY: u32 = u32::MAX;

/// The longest table, and the most markings of one store.
const LONGEST: usize = 1 << 31;
pub(super) const MOST: usize = LONGEST / 4 * 3;

/// Markings that are best given to [`Store::insert_all`] at once.
pub(super) const BATCH: usize = if cfg!(test) { 4 } else { 256 };

pub(super) struct Store {
    words: usize,
    /// The markings, [`BLOCK`] numbers each; the last may be shorter as long as one thread is alone.
    blocks: Vec<OnceLock<Box<[AtomicU64]>>>,
    /// From here on, numbers are nobody's.
    next: AtomicU32,
    table: Vec<AtomicU32>,
    /// The bits of a hash that are its slot, and of a slot that are a number.
    mask: usize,
    /// How many these are.
    bits: u32,
    /// The largest sum of arena and tables at any time.
    peak: usize,
}

/// What one thread inserts with: numbers that it may give, and memory for looking.
#[derive(Debug, Default)]
pub(super) struct Share {
    free: VecDeque<Range<u32>>,
    /// Numbers given since these were taken away last, in order.
    pub(super) given: Vec<Range<u32>>,
    looks: Looks,
}

/// Memory for [`Store::find_all`]: of the markings of a batch, where each may stand.
#[derive(Debug, Default)]
pub(super) struct Looks(Vec<Look>);

/// A look for a marking.
#[derive(Debug, Clone, Copy)]
struct Look {
    slot: usize,
    /// What the slot held.
    held: u32,
    tag: u32,
    /// The first word of the marking that stands there.
    word: u64,
}

impl Share {
    /// How many numbers there are to give.
    pub(super) fn left(&self) -> usize {
        self.free.iter().map(|range| range.len()).sum()
    }

    fn add(&mut self, numbers: Range<u32>) {
        if numbers.start >= numbers.end {
            return;
        }
        match self.free.back_mut() {
            Some(last) if last.end == numbers.start => last.end = numbers.end,
            _ => self.free.push_back(numbers),
        }
    }

    /// The number that is given next.
    #[allow(
        clippy::expect_used,
        reason = "whoever inserts has seen to it that there are as many numbers as markings"
    )]
    fn number(&self) -> u32 {
        self.free.front().expect("a number to give").start
    }

    /// That number is given.
    fn give(&mut self) {
        let Some(first) = self.free.front_mut() else {
            return;
        };
        let number = first.start;
        first.start += 1;
        if first.start == first.end {
            self.free.pop_front();
        }
        match self.given.last_mut() {
            Some(last) if last.end == number => last.end += 1,
            _ => self.given.push(number..number + 1),
        }
    }
}

fn zeros(words: usize) -> Box<[AtomicU64]> {
    vec![0; words].into_iter().map(AtomicU64::new).collect()
}

fn empty(slots: usize) -> Vec<AtomicU32> {
    vec![!EMPTY; slots]
        .into_iter()
        .map(AtomicU32::new)
        .collect()
}

impl Store {
    pub(super) fn new(words: usize) -> Self {
        Self {
            words,
            blocks: Vec::new(),
            next: AtomicU32::new(0),
            table: empty(FIRST_TABLE),
            mask: FIRST_TABLE - 1,
            bits: FIRST_TABLE.ilog2(),
            peak: 0,
        }
    }

    /// All numbers given, and those that are in somebody's share, are below this.
    pub(super) fn numbers(&self) -> usize {
        self.next.load(Ordering::Relaxed) as usize
    }

    /// Bytes held now.
    pub(super) fn bytes(&self) -> usize {
        self.numbers() * self.words * 8 + self.table.len() * 4
    }

    /// Bytes held at most so far.
    pub(super) fn peak(&self) -> usize {
        self.peak.max(self.bytes())
    }

    /// Bytes, at most at any time, when so many more numbers are taken; `None` when a store cannot hold
    /// so many.
    pub(super) fn bytes_with(&self, more: usize) -> Option<usize> {
        let numbers = self.numbers().checked_add(more)?;
        let arena = numbers.checked_mul(self.words * 8)?;
        let (now, mut then) = (self.table.len(), self.table.len());
        while numbers > room(then) {
            then *= 2;
        }
        let tables = if then == now { now } else { then + then / 2 };
        (then <= LONGEST).then_some(arena + tables * 4)
    }

    /// The most numbers that so many bytes permit, some of them needed for other things.
    pub(super) fn most_numbers(&self, bytes: usize, others: usize) -> usize {
        bytes.saturating_sub(self.table.len() * 4 + others) / (self.words * 8)
    }

    /// The words of the marking with a number.
    fn at(&self, number: u32) -> &[AtomicU64] {
        let (block, within) = (number as usize / BLOCK, number as usize % BLOCK);
        // The thread that took the number made its block, before the number came into the table.
        let block = self.blocks[block].get().map_or(&[][..], |block| block);
        &block[within * self.words..(within + 1) * self.words]
    }

    /// The marking with a number that [`Store::insert`] gave.
    pub(super) fn read(&self, number: u32, marking: &mut Vec<u64>) {
        let words = self.at(number).iter();
        marking.clear();
        marking.extend(words.map(|word| word.load(Ordering::Relaxed)));
    }

    /// The first word of the marking in a slot that is not empty.
    fn first_word(&self, held: u32) -> u64 {
        // A number has fewer than 32 bits.
        self.at((held as usize & self.mask) as u32)[0].load(Ordering::Relaxed)
    }

    /// Whether the marking in a slot that is not empty is this one. Most markings are one word.
    fn is(&self, held: u32, marking: &[u64]) -> bool {
        match marking {
            [word] => self.first_word(held) == *word,
            _ => {
                let words = self.at((held as usize & self.mask) as u32).iter();
                words
                    .zip(marking)
                    .all(|(one, other)| one.load(Ordering::Relaxed) == *other)
            }
        }
    }

    /// The bits of a hash that stand beside a number: others than its slot, as far as there are so many.
    fn tag(&self, hash: u64) -> u32 {
        ((hash >> 32) as u32) << self.bits
    }

    fn held(&self, slot: usize) -> u32 {
        !self.table[slot].load(Ordering::Acquire)
    }

    /// From `slot` on, the first slot that is empty or may hold a marking with this hash.
    fn candidate(&self, mut slot: usize, tag: u32) -> (usize, u32) {
        loop {
            let held = self.held(slot);
            if held == EMPTY || (held ^ tag) >> self.bits == 0 {
                return (slot, held);
            }
            slot = (slot + 1) & self.mask;
        }
    }

    /// From `slot` on, the slot that holds a marking, or the empty one where it belongs, and what it holds.
    fn slot_of(&self, marking: &[u64], mut slot: usize, tag: u32) -> (usize, u32) {
        loop {
            let (at, held) = self.candidate(slot, tag);
            if held == EMPTY || self.is(held, marking) {
                return (at, held);
            }
            slot = (at + 1) & self.mask;
        }
    }

    /// The number of a marking with this [`linear`] sum.
    pub(super) fn find(&self, marking: &[u64], sum: u64) -> Option<u32> {
        let hash = mix(sum);
        let (_, held) = self.slot_of(marking, hash as usize & self.mask, self.tag(hash));
        (held != EMPTY).then_some(held & self.mask as u32)
    }

    /// The number of a marking and whether it is new.
    pub(super) fn insert(&mut self, share: &mut Share, marking: &[u64], sum: u64) -> (u32, bool) {
        self.reserve(&mut [(&mut *share, 1)], 1);
        let hash = mix(sum);
        let held = self.keep(
            share,
            marking,
            hash as usize & self.mask,
            self.tag(hash),
            true,
        );
        match held {
            Ok(number) => (number, true),
            Err(number) => (number, false),
        }
    }

    /// From `slot` on, puts a marking into the slot where it belongs and gives it a number. If it is there
    /// already, that is an error with its number. Nobody else inserts meanwhile who is `alone`.
    fn keep(
        &self,
        share: &mut Share,
        marking: &[u64],
        mut slot: usize,
        tag: u32,
        alone: bool,
    ) -> Result<u32, u32> {
        loop {
            let (at, held) = self.slot_of(marking, slot, tag);
            if held != EMPTY {
                return Err(held & self.mask as u32);
            }
            let number = share.number();
            for (place, word) in self.at(number).iter().zip(marking) {
                place.store(*word, Ordering::Relaxed);
            }
            let taken = &self.table[at];
            // This releases the marking: a thread that acquires the slot sees its words.
            if alone {
                taken.store(!(tag | number), Ordering::Release);
            } else if taken
                .compare_exchange(
                    !EMPTY,
                    !(tag | number),
                    Ordering::Release,
                    Ordering::Relaxed,
                )
                .is_err()
            {
                // Another thread was first; perhaps with this very marking.
                slot = at;
                continue;
            }
            share.give();
            return Ok(number);
        }
    }

    /// Keeps those of some markings, one behind the other, that are new; `sums` are theirs. There must be as
    /// many numbers in the share. How many were new.
    pub(super) fn insert_all(
        &self,
        share: &mut Share,
        markings: &[u64],
        sums: &[u64],
        alone: bool,
    ) -> usize {
        let mut looks = mem::take(&mut share.looks.0);
        self.look(sums, &mut looks);
        let mut new = 0;
        for (marking, look) in markings.chunks_exact(self.words).zip(&looks) {
            let alike = look.held != EMPTY && look.word == marking[0];
            if alike && (self.words == 1 || self.is(look.held, marking)) {
                continue;
            }
            // A slot that was empty may hold one of this batch now.
            let kept = self.keep(share, marking, look.slot, look.tag, alone);
            new += usize::from(kept.is_ok());
        }
        share.looks.0 = looks;
        new
    }

    /// Looks for the markings with these sums. It looks first for all of them in the table, then at all
    /// candidates in the arena, so that the waits for memory overlap.
    fn look(&self, sums: &[u64], looks: &mut Vec<Look>) {
        looks.clear();
        looks.extend(sums.iter().map(|sum| {
            let hash = mix(*sum);
            let slot = hash as usize & self.mask;
            Look {
                slot,
                held: self.held(slot),
                tag: self.tag(hash),
                word: 0,
            }
        }));
        for look in looks.iter_mut() {
            if look.held != EMPTY && (look.held ^ look.tag) >> self.bits != 0 {
                let next = (look.slot + 1) & self.mask;
                (look.slot, look.held) = self.candidate(next, look.tag);
            }
        }
        for look in looks {
            // Whatever stands at number 0 is not asked for.
            let asked = if look.held == EMPTY { 0 } else { look.held };
            look.word = self.first_word(asked);
        }
    }

    /// The numbers of some markings, one behind the other, with these sums; `None` if one is not here.
    pub(super) fn find_all(
        &self,
        markings: &[u64],
        sums: &[u64],
        looks: &mut Looks,
        numbers: &mut Vec<u32>,
    ) -> Option<()> {
        numbers.clear();
        if self.numbers() == 0 {
            return sums.is_empty().then_some(());
        }
        self.look(sums, &mut looks.0);
        let each = markings.chunks_exact(self.words).zip(&looks.0);
        for (marking, look) in each {
            let alike = look.held != EMPTY && look.word == marking[0];
            let held = if alike && (self.words == 1 || self.is(look.held, marking)) {
                look.held
            } else {
                self.slot_of(marking, look.slot, look.tag).1
            };
            if held == EMPTY {
                return None;
            }
            numbers.push(held & self.mask as u32);
        }
        Some(())
    }

    /// Sees to it that there are so many numbers in the shares. These must be all that there are. The table
    /// grows, by so many threads, if it must.
    pub(super) fn reserve(&mut self, shares: &mut [(&mut Share, usize)], threads: usize) {
        let lacks = |share: &Share, wanted: usize| wanted.saturating_sub(share.left());
        let lacking: usize = shares.iter().map(|(s, wanted)| lacks(s, *wanted)).sum();
        if lacking == 0 {
            return;
        }
        let mut first = self.numbers();
        if first + lacking > room(self.table.len()) {
            let free = shares.iter().flat_map(|(share, _)| share.free.clone());
            let mut free: Vec<Range<u32>> = free.collect();
            free.sort_unstable_by_key(|range| range.start);
            while first + lacking > room(self.table.len()) {
                self.grow(threads, &free);
            }
        }
        self.make_blocks(first + lacking);
        for (share, wanted) in shares {
            let end = first + lacks(share, *wanted);
            // The table is not longer than LONGEST: the searches end before.
            share.add(first as u32..end as u32);
            first = end;
        }
        *self.next.get_mut() = first as u32;
    }

    /// Gives back the numbers of a share that were taken last and are not given.
    pub(super) fn give_back(&mut self, share: &mut Share) {
        if let Some(last) = share
            .free
            .pop_back_if(|last| last.end == *self.next.get_mut())
        {
            *self.next.get_mut() = last.start;
        }
    }

    /// Gets blocks ready for numbers up to `end`. The last is twice as large each time, until it is whole.
    fn make_blocks(&mut self, end: usize) {
        while self.blocks.len() * BLOCK < end {
            self.blocks.push(OnceLock::new());
        }
        let last = self.numbers() / BLOCK;
        for (number, block) in self.blocks.iter_mut().enumerate().skip(last) {
            let wanted = end.saturating_sub(number * BLOCK).min(BLOCK);
            let length = block.get().map_or(0, |block| block.len()) / self.words;
            if length >= wanted {
                continue;
            }
            let longer = zeros(wanted.next_power_of_two().clamp(4, BLOCK) * self.words);
            for (new, old) in longer.iter().zip(block.get().into_iter().flatten()) {
                new.store(old.load(Ordering::Relaxed), Ordering::Relaxed);
            }
            *block = OnceLock::from(longer);
        }
    }

    /// Gets ready for [`Store::take`] by several threads: the last block whole, and room for further ones.
    pub(super) fn open(&mut self) {
        let whole = self.numbers().next_multiple_of(BLOCK);
        self.make_blocks(whole);
        let most = room(self.table.len()).div_ceil(BLOCK);
        if self.blocks.len() < most {
            self.blocks.resize_with(most, OnceLock::new);
        }
    }

    /// The same as [`Store::reserve`] for one of several threads. It works as long as the table need not
    /// grow for it, and there are at most `most` numbers. Whether it was possible.
    pub(super) fn take(&self, share: &mut Share, numbers: usize, most: usize) -> bool {
        let lacking = numbers.saturating_sub(share.left());
        if lacking == 0 {
            return true;
        }
        // Below LONGEST, as the table's length is.
        let more = lacking.max(PIECE);
        let most = most.min(room(self.table.len()));
        let taken = self
            .next
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |next| {
                let end = next as usize + more;
                (end <= most).then_some(end as u32)
            });
        let Ok(first) = taken else {
            return false;
        };
        let end = first as usize + more;
        for block in &self.blocks[first as usize / BLOCK..end.div_ceil(BLOCK)] {
            block.get_or_init(|| zeros(BLOCK * self.words));
        }
        share.add(first..end as u32);
        true
    }
}

/// The most markings in a table of so many slots.
fn room(slots: usize) -> usize {
    slots / 4 * 3
}
