//! The reachable markings of a model, all of them, by distance: packed to the bits that each place
//! needs, on one thread or several. Each thread owns the markings that a hash gives it, so nothing is
//! locked, and the result does not depend on timing.

mod growth;
mod path;
mod rules;
mod worker;

#[cfg(test)]
mod tests;

use super::{
    layout::{Layout, bits_for},
    model::{Model, PlaceNumber, TransitionNumber},
};
pub use growth::Growth;
pub(super) use rules::{Rules, Scratch};
use worker::{TooWide, Worker};

/// Markings expanded between two looks at the limits.
const CHUNK: usize = 1 << 14;

/// Below so many markings further threads cost more than they bring.
const PARALLEL_FROM: usize = 1 << 15;

/// Dead markings that are kept; the others are only counted.
pub const DEAD_KEPT: usize = 1000;

/// How far to look, and with what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Markings at most.
    pub markings: usize,
    /// Bytes for markings and what finds them at most.
    pub bytes: usize,
    /// Threads.
    pub threads: usize,
}

impl Default for Limits {
    /// One million markings and 1 GiB, on one thread.
    fn default() -> Self {
        Self {
            markings: 1_000_000,
            bytes: 1 << 30,
            threads: 1,
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

/// A marking and its distance from the initial one.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Reached {
    /// Firings on a shortest way to it.
    pub distance: usize,
    /// The marking.
    pub marking: Vec<u32>,
}

/// What was found.
pub struct Explored<'a> {
    pub(super) model: &'a Model,
    pub(super) rules: Rules,
    workers: Vec<Worker>,
    /// Markings found.
    pub markings: usize,
    /// Pairs of a marking and a transition enabled in it.
    pub edges: u64,
    /// Why this is not all; nothing when it is.
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

/// The same; `progress` is told from time to time.
#[must_use]
pub fn explore_with<'a>(
    model: &'a Model,
    limits: &Limits,
    progress: &mut dyn FnMut(&Progress),
) -> Explored<'a> {
    let mut bits: Vec<u32> = model.places.iter().map(|p| bits_for(p.tokens)).collect();
    loop {
        let mut search = Search::new(model, *limits, &bits);
        match search.run(progress) {
            Ok(stopped) => return search.finish(stopped),
            // Only a search on several threads begins again; one that is alone widens as it goes.
            Err(TooWide { place, tokens }) => {
                bits = search.layout_bits();
                bits[place as usize] = bits_for(tokens).saturating_add(1).min(32);
            }
        }
    }
}

struct Search<'a> {
    model: &'a Model,
    rules: Rules,
    limits: Limits,
    workers: Vec<Worker>,
    growth: Option<Growth>,
    level: usize,
    peak: usize,
}

impl<'a> Search<'a> {
    fn new(model: &'a Model, limits: Limits, bits: &[u32]) -> Self {
        let rules = Rules::new(model, Layout::new(bits));
        let mut worker = Worker::new(&rules, 1);
        worker.insert_marking(&rules, &model.initial());
        Self {
            model,
            rules,
            limits,
            workers: vec![worker],
            growth: None,
            level: 0,
            peak: 0,
        }
    }

    fn layout_bits(&self) -> Vec<u32> {
        self.rules.layout.bits()
    }

    /// Level after level, until one is empty.
    fn run(&mut self, progress: &mut dyn FnMut(&Progress)) -> Result<Option<Stopped>, TooWide> {
        loop {
            for worker in &mut self.workers {
                worker.begin_level();
            }
            if self.workers.iter().all(|worker| worker.left() == 0) {
                return Ok(None);
            }
            while self.workers.iter().any(|worker| worker.left() > 0) {
                if let Some(stopped) = self.round()? {
                    return Ok(Some(stopped));
                }
                let at = self.progress();
                progress(&at);
                self.peak = self.peak.max(self.bytes_peak());
                if at.markings > self.limits.markings {
                    return Ok(Some(Stopped::Markings));
                }
                if self.workers.iter().map(Worker::bytes_soon).sum::<usize>() > self.limits.bytes {
                    return Ok(Some(Stopped::Bytes));
                }
                if self.workers.iter().any(Worker::is_full) {
                    return Ok(Some(Stopped::Bytes));
                }
            }
            self.deliver()?;
            if self.look_for_growth() {
                return Ok(Some(Stopped::Growth));
            }
            self.level += 1;
            if self.workers.len() < self.limits.threads && self.markings() >= PARALLEL_FROM {
                self.split();
            }
        }
    }

    fn markings(&self) -> usize {
        self.workers.iter().map(Worker::len).sum()
    }

    fn bytes_peak(&self) -> usize {
        self.workers.iter().map(Worker::bytes_peak).sum()
    }

    fn progress(&self) -> Progress {
        Progress {
            markings: self.markings(),
            expanded: self.workers.iter().map(Worker::expanded).sum(),
            level: self.level,
            bytes: self.workers.iter().map(Worker::bytes).sum(),
            for_deadlock: false,
        }
    }

    /// Every worker takes in what was sent to it, and expands a chunk of its level.
    fn round(&mut self) -> Result<Option<Stopped>, TooWide> {
        if let [worker] = self.workers.as_mut_slice() {
            loop {
                match worker.expand(&self.rules, CHUNK, self.limits.markings) {
                    Ok(()) => return Ok(None),
                    Err(TooWide {
                        place,
                        tokens: u32::MAX,
                    }) => {
                        return Ok(Some(Stopped::Tokens(place)));
                    }
                    Err(TooWide { place, tokens }) => {
                        let mut bits = self.rules.layout.bits();
                        bits[place as usize] = bits_for(tokens);
                        let rules = Rules::new(self.model, Layout::new(&bits));
                        worker.repack(&self.rules, &rules);
                        self.rules = rules;
                    }
                }
            }
        }
        let (rules, most) = (&self.rules, self.limits.markings);
        let turn = |worker: &mut Worker| {
            worker.take_in(rules);
            worker.expand(rules, CHUNK, most)
        };
        let left: usize = self.workers.iter().map(Worker::left).sum();
        let results = if left < CHUNK / 4 {
            self.workers.iter_mut().map(turn).collect()
        } else {
            on_all(&mut self.workers, turn)
        };
        self.exchange();
        for result in results {
            match result {
                Err(TooWide {
                    place,
                    tokens: u32::MAX,
                }) => {
                    return Ok(Some(Stopped::Tokens(place)));
                }
                Err(wide) => return Err(wide),
                Ok(()) => {}
            }
        }
        Ok(None)
    }

    /// What workers have found for each other changes hands.
    fn exchange(&mut self) {
        let count = self.workers.len();
        for from in 0..count {
            for to in 0..count {
                if from != to {
                    let empty = self.workers[from].spare.pop().unwrap_or_default();
                    let sent = std::mem::replace(&mut self.workers[from].outboxes[to], empty);
                    self.workers[to].inbox.push(sent);
                }
            }
        }
    }

    fn deliver(&mut self) -> Result<(), TooWide> {
        if self.workers.len() > 1 {
            let rules = &self.rules;
            on_all(&mut self.workers, |worker| worker.take_in(rules));
        }
        Ok(())
    }

    /// From one worker to as many as there are threads.
    fn split(&mut self) {
        let threads = self.limits.threads;
        let mut workers: Vec<Worker> = (0..threads)
            .map(|_| Worker::new(&self.rules, threads))
            .collect();
        for (number, worker) in workers.iter_mut().enumerate() {
            worker.number = number;
        }
        if let Some(single) = self.workers.pop() {
            single.deal(&mut workers);
        }
        self.workers = workers;
        self.peak = self.peak.max(self.bytes_peak());
    }

    fn finish(mut self, stopped: Option<Stopped>) -> Explored<'a> {
        self.peak = self.peak.max(self.bytes_peak());
        let mut dead: Vec<Reached> = self
            .workers
            .iter_mut()
            .flat_map(|w| std::mem::take(&mut w.dead))
            .collect();
        dead.sort_unstable();
        dead.truncate(DEAD_KEPT);
        let mut seen = vec![false; self.model.transitions.len()];
        let mut bounds = self.model.initial();
        for worker in &self.workers {
            for (all, own) in seen.iter_mut().zip(&worker.seen) {
                *all |= own;
            }
            for (all, own) in bounds.iter_mut().zip(&worker.bounds) {
                *all = (*all).max(*own);
            }
        }
        Explored {
            markings: self.markings(),
            edges: self.workers.iter().map(|w| w.edges).sum(),
            stopped,
            dead,
            dead_count: self.workers.iter().map(|w| w.dead_count).sum(),
            seen,
            bounds,
            most_tokens: self
                .workers
                .iter()
                .map(|w| w.most_tokens)
                .max()
                .unwrap_or(0),
            growth: self.growth,
            peak_bytes: self.peak,
            model: self.model,
            rules: self.rules,
            workers: self.workers,
        }
    }
}

/// Runs a turn of every worker on a thread of its own; results in their order.
fn on_all<T: Send>(workers: &mut [Worker], turn: impl Fn(&mut Worker) -> T + Sync) -> Vec<T> {
    let turn = &turn;
    std::thread::scope(|scope| {
        let handles: Vec<_> = workers
            .iter_mut()
            .map(|worker| scope.spawn(move || turn(worker)))
            .collect();
        let join = |handle: std::thread::ScopedJoinHandle<'_, T>| match handle.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        handles.into_iter().map(join).collect()
    })
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
        self.workers.iter().map(Worker::bytes).sum()
    }

    /// Gives back the memory of a search that a limit has ended. What is known by numbers stays; no way
    /// to any marking can be told any more.
    pub(super) fn forget(&mut self) {
        self.workers = vec![Worker::new(&self.rules, 1)];
    }

    /// Transitions that are enabled nowhere.
    pub fn never(&self) -> impl Iterator<Item = TransitionNumber> {
        (0..)
            .zip(&self.seen)
            .filter(|(_, seen)| !**seen)
            .map(|(number, _)| number)
    }
}
