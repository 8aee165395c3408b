//! What is so, whatever anybody knows of it: the boards of all cells, and what was issued, done and reported.
//!
//! It stands in the files of the simulated host, so no kill changes it. A stand-in for hardware changes its cell's board
//! in one step. The referee only reads. There is no such thing outside of a simulation.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use ctos::{
    task::{Context, HandlerError},
    time::Instant,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::wire::{JobNumber, Outcome};

/// What is known of a job.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Fate {
    /// The cells in which its disc was set down where it shall lie, once for each time.
    pub effects: Vec<String>,
    /// What was reported of it, each time.
    pub reported: Vec<Outcome>,
}

/// Everything that is so.
#[derive(Debug, Default)]
pub struct World {
    jobs: BTreeMap<JobNumber, Fate>,
    /// By the cell, the last epoch that was settled: nothing is done under it, or an earlier one, any more.
    settled: BTreeMap<String, u64>,
    /// Jobs that were taken from cells, and when that was found to be needed: they wait for another cell.
    taken: BTreeMap<JobNumber, (String, Instant)>,
    /// How long it took from the death of a cell to its work elsewhere.
    moved: Vec<Duration>,
    /// Messages that tasks of the fleet sent.
    messages: u64,
}

/// What a referee counts.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// Jobs that were issued.
    pub issued: usize,
    /// Jobs of which an end was reported, once.
    pub reported: usize,
    /// Jobs that were carried.
    pub carried: usize,
    /// Jobs of which nothing was reported.
    pub lost: Vec<JobNumber>,
    /// Jobs that were done more than once, or reported with different ends.
    pub doubled: Vec<JobNumber>,
    /// Jobs that were reported as carried and not done, or the other way round.
    pub untrue: Vec<JobNumber>,
}

impl Count {
    /// Whether nothing is wrong.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.lost.is_empty() && self.doubled.is_empty() && self.untrue.is_empty()
    }
}

impl World {
    /// A job was issued.
    pub fn issue(&mut self, job: JobNumber) {
        self.jobs.entry(job).or_default();
    }

    /// A job was lent to a cell.
    pub fn lend(&mut self, job: JobNumber, cell: &str, now: Instant) {
        if let Some((from, since)) = self.taken.remove(&job)
            && from != cell
        {
            self.moved.push(now.since(since));
        }
    }

    /// A cell that had jobs has died at this time; they wait for another one until they are lent again.
    pub fn died(&mut self, cell: &str, jobs: &[JobNumber], at: Instant) {
        for job in jobs {
            self.taken.insert(*job, (cell.to_owned(), at));
        }
    }

    /// The disc of a job is set down, unless its epoch was settled. Says whether it was.
    pub fn set_down(&mut self, cell: &str, job: JobNumber, epoch: u64) -> bool {
        if self.settled.get(cell).is_some_and(|last| *last >= epoch) {
            return false;
        }
        let effects = &mut self.jobs.entry(job).or_default().effects;
        effects.push(cell.to_owned());
        self.settled.insert(cell.to_owned(), epoch);
        true
    }

    /// Nothing more is done in a cell under an epoch. Says whether the disc of the job lies there where it shall.
    pub fn settle(&mut self, cell: &str, job: JobNumber, epoch: u64) -> bool {
        let last = self.settled.entry(cell.to_owned()).or_default();
        *last = epoch.max(*last);
        self.lies(cell, job)
    }

    /// Whether the disc of a job lies in a cell where it shall.
    #[must_use]
    pub fn lies(&self, cell: &str, job: JobNumber) -> bool {
        let fate = self.jobs.get(&job);
        fate.is_some_and(|fate| fate.effects.iter().any(|there| there == cell))
    }

    /// An end was reported. The same one again is that of a company that was killed before it had stored the first.
    pub fn report(&mut self, job: JobNumber, outcome: Outcome) {
        let reported = &mut self.jobs.entry(job).or_default().reported;
        if !reported.contains(&outcome) {
            reported.push(outcome);
        }
    }

    /// A message was sent.
    pub fn message(&mut self) {
        self.messages += 1;
    }

    /// How many messages were sent.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// From the deaths of cells to their work elsewhere, shortest first.
    #[must_use]
    pub fn moved(&self) -> Vec<Duration> {
        let mut moved = self.moved.clone();
        moved.sort_unstable();
        moved
    }

    /// Counts.
    #[must_use]
    pub fn count(&self) -> Count {
        let mut count = Count {
            issued: self.jobs.len(),
            ..Count::default()
        };
        for (job, fate) in &self.jobs {
            let carried = fate.reported.first() == Some(&Outcome::Carried);
            count.reported += usize::from(fate.reported.len() == 1);
            count.carried += usize::from(carried);
            if fate.reported.is_empty() {
                count.lost.push(*job);
            }
            if fate.effects.len() > 1 || fate.reported.len() > 1 {
                count.doubled.push(*job);
            }
            if !fate.reported.is_empty() && carried == fate.effects.is_empty() {
                count.untrue.push(*job);
            }
        }
        count
    }
}

/// The world of the app's run, for all its tasks; a replay has none.
fn of(cx: &Context) -> Result<Arc<Mutex<World>>, &'static str> {
    let disk = cx.disk().and_then(|disk| disk.open(Path::new("fleet")));
    disk.ok_or("stand-ins stand in a simulated world only: run the app with `ctos sim`")
}

fn lock(world: &Mutex<World>) -> MutexGuard<'_, World> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Looks at the world, or changes something in one step. A record holds what is seen; `what` names it there.
///
/// # Errors
/// The app is not simulated.
pub fn see<T: Serialize + DeserializeOwned>(
    cx: &Context,
    what: &str,
    look: impl FnOnce(&mut World) -> T,
) -> Result<T, HandlerError> {
    let seen = cx.outside(what, || match of(cx) {
        Ok(world) => Ok(look(&mut lock(&world))),
        Err(why) => Err(why.to_owned()),
    });
    Ok(seen?)
}

/// Changes something of which the task sees nothing.
pub fn note(cx: &Context, change: impl FnOnce(&mut World)) {
    if !cx.is_replay()
        && let Ok(world) = of(cx)
    {
        change(&mut lock(&world));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_settled_is_not_done_any_more_and_what_was_done_is_known() {
        let mut world = World::default();
        world.issue(1);
        assert!(!world.settle("a", 1, 4));
        assert!(!world.set_down("a", 1, 4));
        assert!(world.set_down("a", 1, 5));
        assert!(!world.set_down("a", 1, 5), "once for an epoch");
        assert!(world.settle("a", 1, 5));
    }

    #[test]
    fn a_referee_finds_what_is_lost_doubled_or_untrue() {
        let mut world = World::default();
        (1..=5).for_each(|job| world.issue(job));
        world.set_down("a", 1, 1);
        world.report(1, Outcome::Carried);
        world.report(2, Outcome::Occupied);
        world.set_down("a", 3, 2);
        world.set_down("b", 3, 1);
        world.report(3, Outcome::Carried);
        world.report(4, Outcome::Carried);
        let count = world.count();
        assert_eq!((count.issued, count.reported, count.carried), (5, 4, 3));
        assert_eq!(count.lost, [5]);
        assert_eq!(count.doubled, [3]);
        assert_eq!(count.untrue, [4]);
        assert!(!count.is_clean());
    }
}
