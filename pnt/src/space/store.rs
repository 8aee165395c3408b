//! Markings side by side in one block of memory, found again by their content.

use std::hash::{BuildHasher, Hash};

use hashbrown::{DefaultHashBuilder, HashTable};

use super::MarkingId;

/// What holds the tokens of one place.
pub(super) trait Cell: Copy + Ord + Hash + Into<u32> + TryFrom<u32> {}

impl Cell for u8 {}
impl Cell for u32 {}

pub(super) struct Store<C> {
    width: usize,
    cells: Vec<C>,
    count: usize,
    found: HashTable<MarkingId>,
    hasher: DefaultHashBuilder,
}

impl<C: Cell> Store<C> {
    /// An empty store of markings of `width` places.
    pub(super) fn new(width: usize) -> Self {
        Self {
            width,
            cells: Vec::new(),
            count: 0,
            found: HashTable::new(),
            // Nothing depends on the order of the table, so its seed may differ between runs.
            hasher: DefaultHashBuilder::default(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// The marking with a number that [`Store::insert`] gave.
    pub(super) fn get(&self, id: MarkingId) -> &[C] {
        let start = id as usize * self.width;
        &self.cells[start..start + self.width]
    }

    /// The number of a marking and whether it is new.
    pub(super) fn insert(&mut self, marking: &[C]) -> (MarkingId, bool) {
        let hash = self.hasher.hash_one(marking);
        let (cells, width) = (&self.cells, self.width);
        let at = |id: MarkingId| &cells[id as usize * width..][..width];
        if let Some(id) = self.found.find(hash, |id| at(*id) == marking) {
            return (*id, false);
        }
        // The limit on markings is far below 2^32: each takes memory.
        let id = MarkingId::try_from(self.count).unwrap_or(MarkingId::MAX);
        self.found
            .insert_unique(hash, id, |id| self.hasher.hash_one(at(*id)));
        self.cells.extend_from_slice(marking);
        self.count += 1;
        (id, true)
    }
}
