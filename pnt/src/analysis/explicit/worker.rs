//! One thread's share of the markings: those whose hash says so.

use super::{
    super::{
        layout::{linear, mix},
        model::PlaceNumber,
        store::{self, Probe, Store},
    },
    DEAD_KEPT, Reached, Rules, Scratch,
};

/// A firing would put more into a place than its field holds. `u32::MAX` tokens stand for more than
/// 32 bits can say.
#[derive(Debug)]
pub(super) struct TooWide {
    pub(super) place: PlaceNumber,
    pub(super) tokens: u32,
}

pub(in crate::analysis) struct Worker {
    pub(super) number: usize,
    workers: usize,
    store: Store,
    /// The first marking of each level; what follows the last one is for the next level.
    levels: Vec<u32>,
    /// The next marking to expand, and where this level ends.
    next: u32,
    end: u32,
    pub(super) edges: u64,
    pub(super) dead: Vec<Reached>,
    pub(super) dead_count: u64,
    pub(super) seen: Vec<bool>,
    pub(super) bounds: Vec<u32>,
    pub(super) most_tokens: u64,
    /// Markings that made a place double its bound: where to look for growth.
    pub(super) records: Vec<Vec<u32>>,
    /// Packed markings that other workers own.
    pub(super) outboxes: Vec<Vec<u64>>,
    /// Packed markings that other workers have found.
    pub(super) inbox: Vec<Vec<u64>>,
    scratch: Scratch,
    from: Vec<u64>,
    successors: Vec<u64>,
    sums: Vec<u64>,
    probes: Vec<Probe>,
}

/// Which of several workers owns a marking. Its slot in the table is of other bits of the same hash.
pub(super) fn owner(sum: u64, workers: usize) -> usize {
    (mix(sum) >> 40) as usize % workers
}

impl Worker {
    pub(super) fn new(rules: &Rules, workers: usize) -> Self {
        Self {
            number: 0,
            workers,
            store: Store::new(rules.layout.words),
            levels: Vec::new(),
            next: 0,
            end: 0,
            edges: 0,
            dead: Vec::new(),
            dead_count: 0,
            seen: vec![false; rules.packed.len()],
            bounds: vec![0; rules.layout.fields.len()],
            most_tokens: 0,
            records: Vec::new(),
            outboxes: vec![Vec::new(); workers],
            inbox: Vec::new(),
            scratch: Scratch::default(),
            from: Vec::new(),
            successors: Vec::new(),
            sums: Vec::new(),
            probes: Vec::new(),
        }
    }

    pub(in crate::analysis) fn len(&self) -> usize {
        self.store.len()
    }

    pub(super) fn left(&self) -> usize {
        (self.end - self.next) as usize
    }

    pub(super) fn expanded(&self) -> usize {
        self.next as usize
    }

    pub(super) fn bytes(&self) -> usize {
        let waiting = self.outboxes.iter().chain(&self.inbox).map(Vec::len);
        self.store.bytes() + waiting.sum::<usize>() * 8
    }

    /// Bytes at most so far.
    pub(super) fn bytes_peak(&self) -> usize {
        self.bytes().max(self.store.peak())
    }

    /// Bytes when the table grows next.
    pub(super) fn bytes_soon(&self) -> usize {
        self.bytes() + self.store.next_table()
    }

    pub(super) fn is_full(&self) -> bool {
        self.store.len() + (1 << 20) > store::MOST
    }

    pub(in crate::analysis) fn store(&self) -> &Store {
        &self.store
    }

    /// Number of the level of a marking.
    pub(in crate::analysis) fn level_of(&self, id: u32) -> usize {
        self.levels
            .partition_point(|first| *first <= id)
            .saturating_sub(1)
    }

    /// The markings of a level.
    pub(super) fn level(&self, level: usize) -> std::ops::Range<u32> {
        let all = u32::try_from(self.store.len()).unwrap_or(u32::MAX);
        let start = self.levels.get(level).copied().unwrap_or(all);
        start..self.levels.get(level + 1).copied().unwrap_or(all)
    }

    pub(super) fn insert_marking(&mut self, rules: &Rules, marking: &[u32]) {
        let mut packed = Vec::new();
        rules.layout.pack(marking, &mut packed);
        self.insert(&packed);
    }

    fn insert(&mut self, packed: &[u64]) {
        let sum = linear(packed);
        let probe = self.store.probe(sum);
        self.store.insert(packed, sum, probe);
    }

    /// All that was found for the next level is this level now.
    pub(super) fn begin_level(&mut self) {
        self.levels.push(self.end);
        self.end = u32::try_from(self.store.len()).unwrap_or(u32::MAX);
    }

    /// Takes in what others have found.
    pub(super) fn take_in(&mut self, rules: &Rules) {
        for sent in std::mem::take(&mut self.inbox) {
            // Several at a time, so that the looks at the table overlap.
            for batch in sent.chunks(16 * rules.layout.words) {
                self.sums.clear();
                self.probes.clear();
                for marking in batch.chunks_exact(rules.layout.words) {
                    let sum = linear(marking);
                    self.sums.push(sum);
                    self.probes.push(self.store.probe(sum));
                }
                let each = batch.chunks_exact(rules.layout.words);
                for ((marking, sum), probe) in each.zip(&self.sums).zip(&self.probes) {
                    self.store.insert(marking, *sum, *probe);
                }
            }
        }
    }

    /// Expands up to `chunk` markings of this level; fewer when there are more than `most` in all.
    pub(super) fn expand(
        &mut self,
        rules: &Rules,
        chunk: usize,
        most: usize,
    ) -> Result<(), TooWide> {
        let chunk = u32::try_from(chunk).unwrap_or(u32::MAX);
        let until = self.end.min(self.next.saturating_add(chunk));
        while self.next < until && self.store.len() <= most {
            self.expand_one(rules, self.next)?;
            self.next += 1;
        }
        Ok(())
    }

    fn expand_one(&mut self, rules: &Rules, id: u32) -> Result<(), TooWide> {
        self.from.clear();
        self.from.extend_from_slice(self.store.get(id));
        rules.layout.unpack(&self.from, &mut self.scratch.marking);
        rules.enabled(&mut self.scratch);
        self.check_room(rules)?;
        self.note_marking();
        self.edges += self.scratch.enabled.len() as u64;
        let words = rules.layout.words;
        let count = self.scratch.enabled.len();
        self.successors.resize(count * words, 0);
        self.sums.clear();
        self.probes.clear();
        let sum = linear(&self.from);
        let targets = self.successors.chunks_exact_mut(words);
        for (number, to) in self.scratch.enabled.iter().zip(targets) {
            self.seen[*number as usize] = true;
            let sum = rules.packed[*number as usize].fire(&rules.layout, &self.from, sum, to);
            self.sums.push(sum);
            self.probes.push(self.store.probe(sum));
        }
        let found = self
            .successors
            .chunks_exact(words)
            .zip(&self.sums)
            .zip(&self.probes);
        for ((marking, sum), probe) in found {
            if self.workers > 1 {
                let owner = owner(*sum, self.workers);
                if owner != self.number {
                    self.outboxes[owner].extend_from_slice(marking);
                    continue;
                }
            }
            self.store.insert(marking, *sum, *probe);
        }
        Ok(())
    }

    fn check_room(&self, rules: &Rules) -> Result<(), TooWide> {
        for number in &self.scratch.enabled {
            let transition = &rules.packed[*number as usize];
            let gained = transition.gains.iter().map(|(place, gain)| {
                (
                    *place,
                    self.scratch.marking[*place as usize].saturating_add(*gain),
                )
            });
            for (place, tokens) in gained.chain(transition.resets.iter().copied()) {
                // A sum that saturates would fit, and be wrong.
                if tokens > rules.layout.fields[place as usize].most() || tokens == u32::MAX {
                    return Err(TooWide { place, tokens });
                }
            }
        }
        Ok(())
    }

    /// What a marking tells by itself: bounds, sums, whether it is dead.
    fn note_marking(&mut self) {
        let marking = &self.scratch.marking;
        let tokens: u64 = marking.iter().map(|tokens| u64::from(*tokens)).sum();
        self.most_tokens = self.most_tokens.max(tokens);
        let mut record = false;
        for (bound, tokens) in self.bounds.iter_mut().zip(marking) {
            if tokens > bound {
                record |= *tokens > 1 && (tokens ^ *bound) > *bound;
                *bound = *tokens;
            }
        }
        if record {
            self.records.push(marking.clone());
        }
        if !self.scratch.sure.contains(&true) {
            self.dead_count += 1;
            if self.dead.len() < DEAD_KEPT {
                self.dead.push(Reached {
                    distance: self.levels.len().saturating_sub(1),
                    marking: marking.clone(),
                });
            }
        }
    }

    /// The same markings in another layout.
    pub(super) fn repack(&mut self, old: &Rules, new: &Rules) {
        let mut store = Store::new(new.layout.words);
        let (mut marking, mut packed) = (Vec::new(), Vec::new());
        for id in 0..self.store.len() {
            // Ids are 32 bits; see Store.
            old.layout.unpack(self.store.get(id as u32), &mut marking);
            new.layout.pack(&marking, &mut packed);
            let sum = linear(&packed);
            let probe = store.probe(sum);
            store.insert(&packed, sum, probe);
        }
        self.store = store;
    }

    /// Gives all markings to their owners among several workers, level by level. All levels but the last
    /// one are expanded.
    pub(super) fn deal(self, workers: &mut [Self]) {
        let count = workers.len();
        for level in 0..self.levels.len() {
            for worker in workers.iter_mut() {
                worker
                    .levels
                    .push(u32::try_from(worker.store.len()).unwrap_or(u32::MAX));
            }
            for id in self.level(level) {
                if level + 1 == self.levels.len() && id >= self.end {
                    break;
                }
                let marking = self.store.get(id);
                workers[owner(linear(marking), count)].insert(marking);
            }
        }
        for worker in workers.iter_mut() {
            worker.end = u32::try_from(worker.store.len()).unwrap_or(u32::MAX);
            worker.next = worker.end;
        }
        for id in self.end..u32::try_from(self.store.len()).unwrap_or(u32::MAX) {
            let marking = self.store.get(id);
            workers[owner(linear(marking), count)].insert(marking);
        }
        if let Some(first) = workers.first_mut() {
            first.edges = self.edges;
            first.dead = self.dead;
            first.dead_count = self.dead_count;
            first.seen = self.seen;
            first.bounds.clone_from(&self.bounds);
            first.most_tokens = self.most_tokens;
        }
        for worker in workers {
            worker.bounds.clone_from(&self.bounds);
        }
    }
}
