//! Packed markings in the order in which they were found, found again by their content: an arena in
//! blocks that never move, and an open table of 32-bit numbers, at most three quarters full.

use super::layout::{linear, mix};

/// Markings of one block.
const BLOCK: usize = 1 << 14;

/// An empty slot of the table.
const EMPTY: u32 = u32::MAX;

/// The most markings of one store.
pub(super) const MOST: usize = EMPTY as usize;

pub(super) struct Store {
    words: usize,
    blocks: Vec<Vec<u64>>,
    count: usize,
    table: Vec<u32>,
    mask: usize,
    /// The largest sum of arena and tables at any time.
    peak: usize,
}

/// The first look at the table for a hash.
#[derive(Debug, Clone, Copy)]
pub(super) struct Probe {
    /// What the slot held when it was looked at.
    first: u32,
}

impl Store {
    pub(super) fn new(words: usize) -> Self {
        Self {
            words,
            blocks: Vec::new(),
            count: 0,
            table: vec![EMPTY; 64],
            mask: 63,
            peak: 0,
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

    /// Whether a number is that of this marking. Most markings are one word.
    fn is(&self, id: u32, marking: &[u64]) -> bool {
        match marking {
            [word] => self.blocks[id as usize / BLOCK][id as usize % BLOCK] == *word,
            _ => self.get(id) == marking,
        }
    }

    /// First look at the table; those of several markings overlap in time.
    pub(super) fn probe(&self, sum: u64) -> Probe {
        // The upper bits decide which thread owns a marking; the lower ones its slot.
        let slot = mix(sum) as usize & self.mask;
        Probe {
            first: self.table[slot],
        }
    }

    /// The number of a marking with this [`linear`] sum.
    pub(super) fn find(&self, marking: &[u64], sum: u64) -> Option<u32> {
        let mut slot = mix(sum) as usize & self.mask;
        loop {
            let id = self.table[slot];
            if id == EMPTY {
                return None;
            }
            if self.is(id, marking) {
                return Some(id);
            }
            slot = (slot + 1) & self.mask;
        }
    }

    /// The number of a marking and whether it is new. The probe may be older than the last insertion.
    pub(super) fn insert(&mut self, marking: &[u64], sum: u64, probe: Probe) -> (u32, bool) {
        if probe.first != EMPTY && self.is(probe.first, marking) {
            return (probe.first, false);
        }
        if (self.count + 1) * 4 > self.table.len() * 3 {
            self.grow();
        }
        let mut slot = mix(sum) as usize & self.mask;
        loop {
            let id = self.table[slot];
            if id == EMPTY {
                break;
            }
            if self.is(id, marking) {
                return (id, false);
            }
            slot = (slot + 1) & self.mask;
        }
        // The searches end long before 2^32 markings; see MOST.
        let id = u32::try_from(self.count).unwrap_or(EMPTY);
        self.table[slot] = id;
        self.push(marking);
        (id, true)
    }

    fn push(&mut self, marking: &[u64]) {
        if self.count.is_multiple_of(BLOCK) {
            self.blocks.push(Vec::new());
        }
        if let Some(block) = self.blocks.last_mut() {
            block.extend_from_slice(marking);
        }
        self.count += 1;
    }

    fn grow(&mut self) {
        let size = self.table.len() * 2;
        self.peak = self.peak.max(self.bytes() + size * 4);
        let mut table = vec![EMPTY; size];
        let mask = size - 1;
        let mut id = 0_u32;
        for block in &self.blocks {
            for marking in block.chunks_exact(self.words) {
                let mut slot = mix(linear(marking)) as usize & mask;
                while table[slot] != EMPTY {
                    slot = (slot + 1) & mask;
                }
                table[slot] = id;
                id += 1;
            }
        }
        self.table = table;
        self.mask = mask;
    }
}
