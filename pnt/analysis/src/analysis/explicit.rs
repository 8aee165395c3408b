//! The reachable markings of a model, all of them, by distance: packed to the bits that each place
//! needs, on one thread or several. Level after level, the threads take parts of what is left, and keep
//! what they find in one store without locks. Which thread finds a marking, and under which number, is a
//! matter of timing; no result depends on it.

mod growth;
mod levels;
mod path;
mod reached;
mod rules;
mod worker;

#[cfg(test)]
mod tests;

use std::{
    collections::BTreeMap,
    mem,
    sync::atomic::{AtomicBool, AtomicUsize, Ordering},
};

use super::{
    layout::{Layout, bits_for, linear},
    model::{Model, PlaceNumber, TransitionNumber},
    stop::Stop,
    store::Store,
};
pub use growth::Growth;
use levels::Levels;
pub use reached::{DEAD_KEPT, Reached};
pub(super) use rules::{Rules, Scratch};
use worker::{Padded, Queue, Record, Round, Tally, TooWide, Worker};

/// Markings that a thread expands between two looks at the limits, when it is alone and when it is not.
/// Fewer in tests, here and below, so that small nets come to everything.
const CHUNK: usize = 1 << 14;
const CHUNK_OF_SEVERAL: usize = if cfg!(test) { 4 } else { 1 << 17 };

/// Below so many markings, and in smaller levels, further threads cost more than they bring.
const PARALLEL_FROM: usize = if cfg!(test) { 4 } else { 1 << 15 };
const PARALLEL_LEVEL: usize = if cfg!(test) { 2 } else { 1 << 12 };

/// Markings from which on it pays to look conditions up.
const LOOKED_UP_FROM: usize = if cfg!(test) { 4 } else { 1 << 10 };

/// Numbers that a thread gets at most beyond those that it waits for.
const MORE: usize = 1 << 10;

/// How far to look, and with what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Markings at most.
    pub markings: usize,
    /// Bytes for markings and what finds them at most.
    pub bytes: usize,
    /// Threads.
    pub threads: usize,
    /// What ends it before.
    pub stop: Stop,
}

impl Default for Limits {
    /// One million markings and 1 GiB, on one thread.
    fn default() -> Self {
        Self {
            markings: 1_000_000,
            bytes: 1 << 30,
            threads: 1,
            stop: Stop::default(),
        }
    }
}

/// Why a search ended before it had found everything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stopped {
    /// [`Limits::markings`].
    Markings,
    /// [`Limits::bytes`].
    Bytes,
    /// [`Limits::stop`].
    Stop,
    /// A place would hold more than 32 bits can say.
    Tokens(PlaceNumber),
    /// A place grows without bound.
    Growth,
}

/// How far a search has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Markings found.
    pub markings: usize,
    /// Of them, those whose firings have been looked at.
    pub expanded: usize,
    /// Distance from the initial marking.
    pub level: usize,
    /// Bytes held.
    pub bytes: usize,
    /// Whether only dead markings are looked for, by stubborn sets.
    pub for_deadlock: bool,
}

/// What was found.
pub struct Explored<'a> {
    pub(super) model: &'a Model,
    pub(super) rules: Rules,
    pub(super) store: Store,
    pub(super) levels: Levels,
    /// What ends what is computed from it.
    pub(super) stop: Stop,
    /// Markings found. Where a limit has ended a search on several threads, those of the levels that were
    /// found whole. All else is then about the levels before, so that nothing depends on timing.
    pub markings: usize,
    /// Pairs of a marking and a transition enabled in it.
    pub edges: u64,
    /// Why this is not all; `None` when it is.
    pub stopped: Option<Stopped>,
    /// Markings that nothing is sure to leave, nearest first, at most [`DEAD_KEPT`].
    pub dead: Vec<Reached>,
    /// How many there are.
    pub dead_count: u64,
    /// Per transition, whether it is enabled somewhere.
    pub seen: Vec<bool>,
    /// The most tokens seen in each place.
    pub bounds: Vec<u32>,
    /// The most tokens seen in a marking.
    pub most_tokens: u64,
    /// A proof that a place has no bound, if there was one.
    pub growth: Option<Growth>,
    /// Bytes for markings and what finds them, at most at any time.
    pub peak_bytes: usize,
}

/// Finds the reachable markings.
#[must_use]
pub fn explore<'a>(model: &'a Model, limits: &Limits) -> Explored<'a> {
    explore_with(model, limits, &mut |_| {})
}

/// The same; `progress` is called from time to time.
#[must_use]
pub fn explore_with<'a>(
    model: &'a Model,
    limits: &Limits,
    progress: &mut dyn FnMut(&Progress),
) -> Explored<'a> {
    let mut search = Search::new(model, *limits);
    let stopped = search.run(progress);
    search.finish(stopped)
}

struct Search<'a> {
    model: &'a Model,
    rules: Rules,
    limits: Limits,
    store: Store,
    workers: Vec<Worker>,
    levels: Levels,
    level: usize,
    /// Markings found, those of the next level included.
    found: Padded<AtomicUsize>,
    /// What the levels tell that are done.
    tally: Tally,
    bounds: Vec<u32>,
    growth: Option<Growth>,
    peak: usize,
}

impl<'a> Search<'a> {
    fn new(model: &'a Model, limits: Limits) -> Self {
        let bits: Vec<u32> = model.places.iter().map(|p| bits_for(p.tokens)).collect();
        let rules = Rules::new(model, Layout::roomy(&bits));
        let mut store = Store::new(rules.layout.words);
        let mut worker = Worker::new(0, &rules);
        let mut packed = Vec::new();
        rules.layout.pack(&model.initial(), &mut packed);
        store.insert(&mut worker.share, &packed, linear(&packed));
        Self {
            model,
            rules,
            limits,
            store,
            workers: vec![worker],
            levels: Levels::default(),
            level: 0,
            found: Padded(AtomicUsize::new(1)),
            tally: Tally::new(model.transitions.len()),
            bounds: model.initial(),
            growth: None,
            peak: 0,
        }
    }

    /// Level after level, until one is empty.
    fn run(&mut self, progress: &mut dyn FnMut(&Progress)) -> Option<Stopped> {
        loop {
            let given = self
                .workers
                .iter_mut()
                .map(|w| mem::take(&mut w.share.given));
            let mut level: Vec<_> = given.collect();
            for numbers in level.iter().flatten() {
                self.levels.add(self.level, numbers.clone());
            }
            let size: usize = level.iter().flatten().map(|numbers| numbers.len()).sum();
            if size == 0 {
                return None;
            }
            let alone = self.workers.len() == 1 || size < PARALLEL_LEVEL;
            if alone {
                level = vec![level.concat()];
            }
            let stopped = self.expand_level(&Queue::new(&level), alone, progress);
            if stopped.is_some() {
                return stopped;
            }
            let records = self.end_level();
            if self.look_for_growth(&records) {
                return Some(Stopped::Growth);
            }
            self.level += 1;
            if self.markings() >= LOOKED_UP_FROM {
                self.rules.look_up();
            }
            let threads = self.limits.threads;
            if self.workers.len() < threads && self.markings() >= PARALLEL_FROM {
                let more = (self.workers.len()..threads).map(|n| Worker::new(n, &self.rules));
                self.workers.extend(more);
                self.end_level();
            }
        }
    }

    fn markings(&self) -> usize {
        self.found.0.load(Ordering::Relaxed)
    }

    fn bytes(&self) -> usize {
        self.store.bytes() + self.beside()
    }

    /// Bytes but for the store.
    fn beside(&self) -> usize {
        self.workers.iter().map(Worker::bytes).sum()
    }

    fn progress(&self) -> Progress {
        Progress {
            markings: self.markings(),
            expanded: self.expanded(),
            level: self.level,
            bytes: self.bytes(),
            for_deadlock: false,
        }
    }

    /// Round after round, until the level is done.
    fn expand_level(
        &mut self,
        queue: &Queue,
        alone: bool,
        progress: &mut dyn FnMut(&Progress),
    ) -> Option<Stopped> {
        let mut told = self.expanded();
        loop {
            let mut end = self.make_room().err();
            if let Err(wide) = self.round(queue, alone) {
                if wide.tokens == u32::MAX {
                    end = Some(self.overflow(wide.place));
                } else {
                    self.widen(&wide);
                }
            }
            self.peak = self.peak.max(self.store.peak() + self.beside());
            if self.markings() > self.limits.markings {
                end = end.or(Some(Stopped::Markings));
            } else if self.bytes() > self.limits.bytes {
                end = end.or(Some(Stopped::Bytes));
            } else if self.limits.stop.is_set() {
                end = end.or(Some(Stopped::Stop));
            }
            let busy = |worker: &Worker| !worker.part.is_empty() || worker.waiting() > 0;
            let done = queue.left() == 0 && !self.workers.iter().any(busy);
            if done || end.is_some() || self.expanded() >= told + CHUNK {
                told = self.expanded();
                progress(&self.progress());
            }
            if done || end.is_some() {
                return end;
            }
        }
    }

    /// The first place of this level that would hold more than 32 bits can say, whichever was met.
    fn overflow(&mut self, met: PlaceNumber) -> Stopped {
        let level = self.levels.level(self.level);
        let first = self.workers.first_mut();
        let first = first.and_then(|worker| worker.overflow(&self.rules, &self.store, level));
        Stopped::Tokens(first.unwrap_or(met))
    }

    fn expanded(&self) -> usize {
        self.workers.iter().map(|worker| worker.expanded).sum()
    }

    /// Numbers for what waits for them, and some more.
    fn make_room(&mut self) -> Result<(), Stopped> {
        let beside = self.beside();
        let threads = self.workers.len();
        let more = (self.store.numbers() / 16).min(MORE);
        let mut lacking = 0;
        let mut shares = Vec::with_capacity(threads);
        for worker in &mut self.workers {
            let (waiting, left) = (worker.waiting(), worker.share.left());
            let wanted = if waiting > left { waiting + more } else { left };
            lacking += wanted - left;
            shares.push((&mut worker.share, wanted));
        }
        if lacking == 0 {
            return Ok(());
        }
        let bytes = self.store.bytes_with(lacking).ok_or(Stopped::Bytes)?;
        if bytes + beside > self.limits.bytes {
            return Err(Stopped::Bytes);
        }
        self.store.reserve(&mut shares, threads);
        Ok(())
    }

    /// Every worker, or the first alone, expands a chunk of the level.
    fn round(&mut self, queue: &Queue, alone: bool) -> Result<(), TooWide> {
        if !alone {
            self.store.open();
        }
        let most_numbers = self.store.most_numbers(self.limits.bytes, self.beside());
        let round = Round {
            rules: &self.rules,
            store: &self.store,
            queue,
            level: self.level,
            chunk: if alone { CHUNK } else { CHUNK_OF_SEVERAL },
            alone,
            found: &self.found.0,
            most: self.limits.markings,
            most_numbers,
            stop: Padded(AtomicBool::new(false)),
        };
        let (first, others) = match self.workers.split_first_mut() {
            Some((first, others)) if !alone => (first, others),
            Some((first, _)) => return first.work(&round),
            None => return Ok(()),
        };
        let round = &round;
        std::thread::scope(|scope| {
            let others: Vec<_> = others
                .iter_mut()
                .map(|worker| scope.spawn(move || worker.work(round)))
                .collect();
            let own = first.work(round);
            let join = |handle: std::thread::ScopedJoinHandle<'_, Result<(), TooWide>>| {
                let result = handle.join();
                result.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            others.into_iter().map(join).fold(own, Result::and)
        })
    }

    /// Makes room for more tokens in a place.
    fn widen(&mut self, wide: &TooWide) {
        let waiting = self.workers.iter_mut().map(|worker| {
            let waiting = worker.waiting();
            (&mut worker.share, waiting)
        });
        self.store.reserve(&mut waiting.collect::<Vec<_>>(), 1);
        for worker in &mut self.workers {
            worker.settle(&self.store, &self.found.0, true);
        }
        let mut bits = self.rules.layout.bits();
        if let Some(bits) = bits.get_mut(wide.place as usize) {
            *bits = bits_for(wide.tokens).max(*bits);
        }
        let rules = Rules::new(self.model, Layout::roomy(&bits));
        self.store = self.store.repacked(&self.rules.layout, &rules.layout);
        for worker in &mut self.workers {
            worker.repack(&rules);
        }
        self.rules = rules;
    }

    /// All workers learn what each has seen in this level. The least marking of each record.
    fn end_level(&mut self) -> BTreeMap<Record, Vec<u32>> {
        let mut records: BTreeMap<Record, Vec<u32>> = BTreeMap::new();
        for worker in &mut self.workers {
            self.tally.add(&mut worker.tally);
            raise(&mut self.bounds, &worker.bounds);
            for (record, marking) in mem::take(&mut worker.records) {
                let least = records.entry(record).or_insert_with(|| marking.clone());
                if marking < *least {
                    *least = marking;
                }
            }
        }
        self.tally.cut_dead();
        for worker in &mut self.workers {
            worker.begin_level(&self.rules, &self.bounds);
        }
        records
    }

    fn finish(mut self, stopped: Option<Stopped>) -> Explored<'a> {
        // What is known of a level that was not ended depends on timing, unless one thread was alone.
        let whole = matches!(stopped, None | Some(Stopped::Growth));
        if whole || self.workers.len() == 1 {
            self.end_level();
            for worker in &mut self.workers {
                for numbers in mem::take(&mut worker.share.given) {
                    self.levels.add(self.level + 1, numbers);
                }
            }
        }
        for worker in &mut self.workers {
            self.store.give_back(&mut worker.share);
        }
        let tally = self.tally;
        Explored {
            // One more than permitted has been found when that ends the search.
            markings: match stopped {
                Some(Stopped::Markings) => self.levels.markings().min(self.limits.markings),
                _ => self.levels.markings(),
            },
            stop: self.limits.stop,
            edges: tally.edges,
            stopped,
            dead: tally.dead,
            dead_count: tally.dead_count,
            seen: tally.seen,
            bounds: self.bounds,
            most_tokens: tally.most_tokens,
            growth: self.growth,
            peak_bytes: self.peak.max(self.store.peak()),
            model: self.model,
            rules: self.rules,
            store: self.store,
            levels: self.levels,
        }
    }
}

/// The larger of each two.
fn raise(bounds: &mut [u32], others: &[u32]) {
    for (bound, other) in bounds.iter_mut().zip(others) {
        *bound = (*bound).max(*other);
    }
}

impl Explored<'_> {
    /// Whether all reachable markings were found.
    #[must_use]
    pub fn complete(&self) -> bool {
        self.stopped.is_none()
    }

    /// What was explored.
    #[must_use]
    pub fn model(&self) -> &Model {
        self.model
    }

    /// Bytes held now.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.store.bytes()
    }

    /// Gives back the memory of a search that a limit has ended. What is known by numbers stays; no way
    /// to any marking can be given any more.
    pub(super) fn forget(&mut self) {
        self.store = Store::new(self.rules.layout.words);
        self.levels = Levels::default();
    }

    /// Transitions that are enabled nowhere.
    pub fn never(&self) -> impl Iterator<Item = TransitionNumber> {
        (0..)
            .zip(&self.seen)
            .filter(|(_, seen)| !**seen)
            .map(|(number, _)| number)
    }
}
