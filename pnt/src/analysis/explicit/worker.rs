//! One thread's share of the markings: those whose hash says so.

use super::{
    super::{
        layout::{linear, mix},
        model::{PlaceNumber, TransitionNumber},
        store::{self, BATCH, Store},
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
    /// Empty boxes, to be filled again.
    pub(super) spare: Vec<Vec<u64>>,
    scratch: Scratch,
    from: Vec<u64>,
    /// Successors that are not yet in the store, packed, and their sums.
    successors: Vec<u64>,
    sums: Vec<u64>,
    recent: Recent,
    /// Per transition, whether one of its gains may not fit: a place has been so full already that it
    /// must be looked at.
    tight: Vec<bool>,
}

/// Markings from which on it pays to know what was found a moment ago. Fewer in tests, so that small nets
/// come to it.
const RECENT_FROM: usize = if cfg!(test) { 8 } else { 1 << 15 };

/// Words of the table of what was found a moment ago: as many as a processor keeps near.
const RECENT: usize = if cfg!(test) { 16 } else { 1 << 16 };

/// Markings of one word that were found a moment ago. Most successors have just been found from another
/// marking; of those neither the table nor another thread need be asked.
#[derive(Default)]
struct Recent {
    words: Vec<u64>,
}

impl Recent {
    fn begin(&mut self) {
        if self.words.is_empty() {
            self.words.resize(RECENT, u64::MAX);
        }
    }

    /// Whether a marking was found a moment ago; it is now.
    fn has(&mut self, marking: &[u64], sum: u64) -> bool {
        let ([word], false) = (marking, self.words.is_empty()) else {
            return false;
        };
        let at = (mix(sum) >> 20) as usize % RECENT;
        let there = self.words[at] == *word && *word != u64::MAX;
        self.words[at] = *word;
        there
    }
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
            spare: Vec::new(),
            scratch: Scratch::default(),
            from: Vec::new(),
            successors: Vec::new(),
            sums: Vec::new(),
            recent: Recent::default(),
            tight: vec![true; rules.packed.len()],
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
        let boxes = self.outboxes.iter().chain(&self.inbox).chain(&self.spare);
        let waiting = boxes.map(Vec::capacity);
        self.store.bytes() + (waiting.sum::<usize>() + self.recent.words.len()) * 8
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
        self.store.insert(packed, linear(packed));
    }

    /// All that was found for the next level is this level now.
    pub(super) fn begin_level(&mut self) {
        self.levels.push(self.end);
        self.end = u32::try_from(self.store.len()).unwrap_or(u32::MAX);
    }

    /// Takes in what others have found.
    pub(super) fn take_in(&mut self, rules: &Rules) {
        while let Some(mut sent) = self.inbox.pop() {
            for batch in sent.chunks(BATCH * rules.layout.words) {
                self.sums.clear();
                let each = batch.chunks_exact(rules.layout.words);
                self.sums.extend(each.map(linear));
                self.store.insert_all(batch, &self.sums);
            }
            if sent.capacity() > 0 {
                sent.clear();
                self.spare.push(sent);
            }
        }
        self.sums.clear();
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
            let expanded = self.expand_one(rules, self.next);
            if expanded.is_err() || self.sums.len() >= BATCH {
                self.keep_successors();
            }
            expanded?;
            self.next += 1;
        }
        self.keep_successors();
        Ok(())
    }

    fn keep_successors(&mut self) {
        if self.store.len() >= RECENT_FROM {
            self.recent.begin();
        }
        self.store.insert_all(&self.successors, &self.sums);
        self.successors.clear();
        self.sums.clear();
    }

    fn expand_one(&mut self, rules: &Rules, id: u32) -> Result<(), TooWide> {
        self.from.clear();
        self.from.extend_from_slice(self.store.get(id));
        rules.layout.unpack(&self.from, &mut self.scratch.marking);
        rules.enabled(&mut self.scratch);
        self.note_tokens(rules);
        self.check_room(rules)?;
        self.note_dead();
        self.edges += self.scratch.enabled.len() as u64;
        let sum = linear(&self.from);
        for number in &self.scratch.enabled {
            self.seen[*number as usize] = true;
            let transition = &rules.packed[*number as usize];
            let start = self.successors.len();
            let sum = transition.fire_onto(&rules.layout, &self.from, sum, &mut self.successors);
            if self.recent.has(&self.successors[start..], sum) {
                self.successors.truncate(start);
                continue;
            }
            if self.workers > 1 {
                let owner = owner(sum, self.workers);
                if owner != self.number {
                    self.outboxes[owner].extend(self.successors.drain(start..));
                    continue;
                }
            }
            self.sums.push(sum);
        }
        Ok(())
    }

    fn check_room(&self, rules: &Rules) -> Result<(), TooWide> {
        let tight = |number: &&TransitionNumber| self.tight[**number as usize];
        for number in self.scratch.enabled.iter().filter(tight) {
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

    /// What a marking tells by its tokens: bounds and sums.
    fn note_tokens(&mut self, rules: &Rules) {
        let marking = &self.scratch.marking;
        let tokens: u64 = marking.iter().map(|tokens| u64::from(*tokens)).sum();
        self.most_tokens = self.most_tokens.max(tokens);
        let bounds = self.bounds.iter().zip(marking);
        if bounds.fold(false, |over, (bound, tokens)| over | (tokens > bound)) {
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
            self.find_tight(rules);
        }
    }

    fn note_dead(&mut self) {
        if !self.scratch.sure.contains(&true) {
            self.dead_count += 1;
            if self.dead.len() < DEAD_KEPT {
                self.dead.push(Reached {
                    distance: self.levels.len().saturating_sub(1),
                    marking: self.scratch.marking.clone(),
                });
            }
        }
    }

    /// Which transitions may put more into a place than fits, as full as places have been so far.
    fn find_tight(&mut self, rules: &Rules) {
        for (tight, transition) in self.tight.iter_mut().zip(&rules.packed) {
            let fits = |place: &PlaceNumber, tokens: u32| {
                tokens <= rules.layout.fields[*place as usize].most() && tokens < u32::MAX
            };
            let mut gained = transition.gains.iter();
            let gained = gained.all(|(place, gain)| {
                fits(place, self.bounds[*place as usize].saturating_add(*gain))
            });
            *tight = !gained || !transition.resets.is_empty();
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
            store.insert(&packed, linear(&packed));
        }
        self.store = store;
        self.recent = Recent::default();
        self.find_tight(new);
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
