//! Which processors of a simulated app may have something to do. The others sleep, as those with a thread do, and take
//! no time until something is brought to them or is due: an app of many chassis costs what those do that work.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex},
};

use ctos_core::processor::Processor;
use ctos_time::{Instant, lock::lock, park::Park};

/// A processor: the number of its machine, and its own number there.
pub(crate) type Place = (usize, usize);

/// Who is awake, in the order in which they run, and when the others have something to do.
#[derive(Default)]
pub(crate) struct Awake {
    places: BTreeSet<Place>,
    /// Of these, where something may have been brought or become ready since it was counted.
    stale: BTreeSet<Place>,
    /// How much is ready at each place.
    pub(crate) counts: Counts,
    /// Of those who sleep.
    due_of: BTreeMap<Place, Instant>,
    due: BTreeSet<(Instant, Place)>,
    /// To whom something was brought.
    woken: Arc<Mutex<Vec<Place>>>,
    /// How often anybody was looked at.
    #[cfg(test)]
    pub(crate) visits: u64,
}

/// Where a simulated processor sleeps.
struct Bell {
    place: Place,
    woken: Arc<Mutex<Vec<Place>>>,
}

impl Park for Bell {
    fn sit_down(&self) {}

    fn unpark(&self) {
        lock(&self.woken).push(self.place);
    }

    fn park(&self, _: Instant, _: Option<Instant>) {}
}

impl Awake {
    /// One more processor, or another one in its place.
    pub(crate) fn add(&mut self, place: Place, processor: &Processor) {
        let woken = self.woken.clone();
        processor.sleep_at(Arc::new(Bell { place, woken }));
        self.rouse(place);
    }

    /// Something may have changed for a processor.
    pub(crate) fn rouse(&mut self, place: Place) {
        if let Some(due) = self.due_of.remove(&place) {
            self.due.remove(&(due, place));
        }
        self.places.insert(place);
        self.stale.insert(place);
    }

    /// Rouses those for whom something is due at `now`.
    pub(crate) fn rouse_due(&mut self, now: Instant) {
        while let Some((due, place)) = self.due.first().copied() {
            if due > now {
                return;
            }
            self.rouse(place);
        }
    }

    /// The first who is awake of those behind `place`, or of all.
    pub(crate) fn next(&mut self, behind: Option<Place>) -> Option<Place> {
        self.hear();
        self.places.range(after(behind)..).next().copied()
    }

    /// The same of those where something has to be run or counted.
    pub(crate) fn next_stale(&mut self, behind: Option<Place>) -> Option<Place> {
        self.hear();
        let next = self.stale.range(after(behind)..).next().copied()?;
        self.stale.take(&next)
    }

    /// Rouses those to whom something was brought.
    fn hear(&mut self) {
        let woken = std::mem::take(&mut *lock(&self.woken));
        woken.into_iter().for_each(|place| self.rouse(place));
        #[cfg(test)]
        {
            self.visits += 1;
        }
    }

    /// A processor sleeps until something is brought, or until `due`.
    pub(crate) fn sleeps(&mut self, place: Place, due: Option<Instant>) {
        self.places.remove(&place);
        if let Some(due) = due {
            self.due_of.insert(place, due);
            self.due.insert((due, place));
        }
    }

    /// When the first of those who sleep has something to do.
    pub(crate) fn next_due(&self) -> Option<Instant> {
        self.due.first().map(|(due, _)| *due)
    }
}

fn after(behind: Option<Place>) -> Place {
    behind.map_or((0, 0), |(machine, processor)| (machine, processor + 1))
}

/// So many machines stand in a row.
const ROW: usize = 64;

/// How much is ready at each place where anything is, and in each such row: one of all is found in few steps.
#[derive(Default)]
pub(crate) struct Counts {
    ready: BTreeMap<Place, usize>,
    rows: BTreeMap<usize, usize>,
    pub(crate) total: usize,
}

impl Counts {
    pub(crate) fn set(&mut self, place: Place, ready: usize) {
        let old = change(&mut self.ready, place, ready);
        if old != ready {
            let row = self.rows.get(&(place.0 / ROW)).copied().unwrap_or(0);
            change(&mut self.rows, place.0 / ROW, row + ready - old);
            self.total = self.total + ready - old;
        }
    }

    /// Where the one at `index` of all stands, in the order of places, and its number there.
    pub(crate) fn find(&self, mut index: usize) -> Option<(Place, usize)> {
        let mut is_here = |count: &usize| {
            let here = index < *count;
            index -= if here { 0 } else { *count };
            here
        };
        let (row, _) = self.rows.iter().find(|(_, count)| is_here(count))?;
        let mut places = self.ready.range((row * ROW, 0)..);
        let (place, _) = places.find(|(_, count)| is_here(count))?;
        Some((*place, index))
    }
}

/// Sets a count, and tells what it was. None is kept where there is nothing.
fn change<K: Ord>(counts: &mut BTreeMap<K, usize>, key: K, count: usize) -> usize {
    let before = match count {
        0 => counts.remove(&key),
        _ => counts.insert(key, count),
    };
    before.unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_ready_is_found_as_by_going_through_all_places(
            numbers in proptest::collection::vec(0..5_usize, 1..200),
            changes in proptest::collection::vec((any::<prop::sample::Index>(), 0..5_usize), 0..60),
        ) {
            let (mut counts, mut model) = (Counts::default(), Vec::new());
            for (number, ready) in numbers.into_iter().enumerate() {
                counts.set((number, 0), ready);
                model.push(ready);
            }
            for (number, ready) in changes {
                let number = number.index(model.len());
                counts.set((number, 0), ready);
                model[number] = ready;
            }
            let all: Vec<_> = model
                .iter()
                .enumerate()
                .flat_map(|(number, ready)| (0..*ready).map(move |at| ((number, 0), at)))
                .collect();
            prop_assert_eq!(counts.total, all.len());
            let found: Vec<_> = (0..all.len()).map(|index| counts.find(index).unwrap()).collect();
            prop_assert_eq!(found, all);
        }
    }
}
