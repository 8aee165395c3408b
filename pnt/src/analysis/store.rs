//! Packed markings in the order in which they were found, found again by their content: an arena in
//! blocks that never move, and an open table of 32-bit slots, at most three quarters full. A number is
//! smaller than the table is long, so the bits of a slot that it leaves over hold some of the hash: what
//! differs there need not be looked up in the arena.

use super::layout::{linear, mix};

/// Markings of one block.
const BLOCK: usize = 1 << 14;

/// An empty slot of the table. No number has all bits set: the table is never full.
const EMPTY: u32 = u32::MAX;

/// The most markings of one store.
pub(super) const MOST: usize = (1 << 31) / 4 * 3;

/// Markings that are best given to [`Store::insert_all`] at once.
pub(super) const BATCH: usize = 256;

pub(super) struct Store {
    words: usize,
    blocks: Vec<Vec<u64>>,
    count: usize,
    table: Vec<u32>,
    /// The bits of a hash that are its slot, and of a slot that are a number.
    mask: usize,
    /// How many these are.
    bits: u32,
    /// The largest sum of arena and tables at any time.
    peak: usize,
    /// Of the markings of a batch, where each may stand.
    looks: Vec<Look>,
}

/// Memory for [`Store::find_all`].
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

impl Store {
    pub(super) fn new(words: usize) -> Self {
        Self {
            words,
            blocks: Vec::new(),
            count: 0,
            table: vec![EMPTY; 64],
            mask: 63,
            bits: 6,
            peak: 0,
            looks: Vec::new(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// Bytes held now.
    pub(super) fn bytes(&self) -> usize {
        self.count * self.words * 8 + self.table.len() * 4
    }

    /// Bytes held at most so far.
    pub(super) fn peak(&self) -> usize {
        self.peak.max(self.bytes())
    }

    /// Bytes of the table that comes next when this one is nearly full, else nothing.
    pub(super) fn next_table(&self) -> usize {
        if self.count * 10 > self.table.len() * 7 {
            self.table.len() * 8
        } else {
            0
        }
    }

    /// The marking with a number that [`Store::insert`] gave.
    pub(super) fn get(&self, id: u32) -> &[u64] {
        let (block, within) = (id as usize / BLOCK, id as usize % BLOCK);
        let start = within * self.words;
        &self.blocks[block][start..start + self.words]
    }

    /// The first word of the marking in a slot that is not empty.
    fn first_word(&self, slot: u32) -> u64 {
        let id = slot as usize & self.mask;
        self.blocks[id / BLOCK][id % BLOCK * self.words]
    }

    /// Whether the marking in a slot that is not empty is this one. Most markings are one word.
    fn is(&self, slot: u32, marking: &[u64]) -> bool {
        match marking {
            [word] => self.first_word(slot) == *word,
            // A number has fewer than 32 bits.
            _ => self.get((slot as usize & self.mask) as u32) == marking,
        }
    }

    /// The bits of a hash that stand beside a number: others than its slot, and than those that say which
    /// thread owns a marking, as far as there are so many.
    fn tag(&self, hash: u64) -> u32 {
        ((hash >> 32) as u32) << self.bits
    }

    /// From `slot` on, the first slot that is empty or may hold a marking with this hash.
    fn candidate(&self, mut slot: usize, tag: u32) -> usize {
        loop {
            let held = self.table[slot];
            if held == EMPTY || (held ^ tag) >> self.bits == 0 {
                return slot;
            }
            slot = (slot + 1) & self.mask;
        }
    }

    /// The number of a marking with this [`linear`] sum.
    pub(super) fn find(&self, marking: &[u64], sum: u64) -> Option<u32> {
        let hash = mix(sum);
        let slot = self.slot_of(marking, hash as usize & self.mask, self.tag(hash));
        let held = self.table[slot];
        (held != EMPTY).then_some(held & self.mask as u32)
    }

    /// From `slot` on, the slot that holds a marking, or the empty one where it belongs.
    fn slot_of(&self, marking: &[u64], mut slot: usize, tag: u32) -> usize {
        loop {
            slot = self.candidate(slot, tag);
            let held = self.table[slot];
            if held == EMPTY || self.is(held, marking) {
                return slot;
            }
            slot = (slot + 1) & self.mask;
        }
    }

    /// The number of a marking and whether it is new.
    pub(super) fn insert(&mut self, marking: &[u64], sum: u64) -> (u32, bool) {
        self.make_room(1);
        let hash = mix(sum);
        let tag = self.tag(hash);
        let slot = self.slot_of(marking, hash as usize & self.mask, tag);
        let held = self.table[slot];
        if held == EMPTY {
            return (self.put(marking, slot, tag), true);
        }
        (held & self.mask as u32, false)
    }

    /// Keeps those of some markings, one behind the other, that are new; `sums` are theirs.
    pub(super) fn insert_all(&mut self, markings: &[u64], sums: &[u64]) {
        if self.count == 0 {
            // Then there is nothing to look at beforehand.
            for (marking, sum) in markings.chunks_exact(self.words).zip(sums) {
                self.insert(marking, *sum);
            }
            return;
        }
        self.make_room(sums.len());
        let mut looks = std::mem::take(&mut self.looks);
        self.look(sums, &mut looks);
        for (marking, look) in markings.chunks_exact(self.words).zip(&looks) {
            let alike = look.held != EMPTY && look.word == marking[0];
            if alike && (self.words == 1 || self.is(look.held, marking)) {
                continue;
            }
            // A slot that was empty may hold one of this batch now.
            let slot = self.slot_of(marking, look.slot, look.tag);
            if self.table[slot] == EMPTY {
                self.put(marking, slot, look.tag);
            }
        }
        self.looks = looks;
    }

    /// Looks for the markings with these sums, at all of them in the table, and then at all of what may be
    /// they in the arena, so that the waiting for memory overlaps.
    fn look(&self, sums: &[u64], looks: &mut Vec<Look>) {
        looks.clear();
        looks.extend(sums.iter().map(|sum| {
            let hash = mix(*sum);
            let slot = hash as usize & self.mask;
            Look {
                slot,
                held: self.table[slot],
                tag: self.tag(hash),
                word: 0,
            }
        }));
        for look in looks.iter_mut() {
            if look.held != EMPTY && (look.held ^ look.tag) >> self.bits != 0 {
                look.slot = self.candidate((look.slot + 1) & self.mask, look.tag);
                look.held = self.table[look.slot];
            }
        }
        for look in looks {
            // Whatever stands at number 0 is not asked for.
            let asked = if look.held == EMPTY { 0 } else { look.held };
            look.word = self.first_word(asked);
        }
    }

    /// The numbers of some markings, one behind the other, with these sums; nothing if one is not here.
    pub(super) fn find_all(
        &self,
        markings: &[u64],
        sums: &[u64],
        looks: &mut Looks,
        numbers: &mut Vec<u32>,
    ) -> Option<()> {
        numbers.clear();
        if self.count == 0 {
            return sums.is_empty().then_some(());
        }
        self.look(sums, &mut looks.0);
        let each = markings.chunks_exact(self.words).zip(&looks.0);
        for (marking, look) in each {
            let alike = look.held != EMPTY && look.word == marking[0];
            let held = if alike && (self.words == 1 || self.is(look.held, marking)) {
                look.held
            } else {
                self.table[self.slot_of(marking, look.slot, look.tag)]
            };
            if held == EMPTY {
                return None;
            }
            numbers.push(held & self.mask as u32);
        }
        Some(())
    }

    /// Puts a new marking into an empty slot.
    fn put(&mut self, marking: &[u64], slot: usize, tag: u32) -> u32 {
        // The searches end before there are more; see MOST.
        let id = self.count as u32;
        self.table[slot] = tag | id;
        if self.count.is_multiple_of(BLOCK) {
            self.blocks.push(Vec::new());
        }
        if let Some(block) = self.blocks.last_mut() {
            block.extend_from_slice(marking);
        }
        self.count += 1;
        id
    }

    /// Lets the table hold so many more.
    fn make_room(&mut self, more: usize) {
        while (self.count + more) * 4 > self.table.len() * 3 {
            self.grow();
        }
    }

    fn grow(&mut self) {
        let size = self.table.len() * 2;
        self.peak = self.peak.max(self.bytes() + size * 4);
        self.bits += 1;
        self.mask = size - 1;
        let mut table = vec![EMPTY; size];
        let mut id = 0_u32;
        for block in &self.blocks {
            for marking in block.chunks_exact(self.words) {
                let hash = mix(linear(marking));
                let mut slot = hash as usize & self.mask;
                while table[slot] != EMPTY {
                    slot = (slot + 1) & self.mask;
                }
                table[slot] = self.tag(hash) | id;
                id += 1;
            }
        }
        self.table = table;
    }
}
