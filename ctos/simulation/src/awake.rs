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
    /// Of those who sleep.
    due_of: BTreeMap<Place, Instant>,
    due: BTreeSet<(Instant, Place)>,
    /// To whom something was brought while they slept.
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
        let woken = std::mem::take(&mut *lock(&self.woken));
        for place in woken {
            self.rouse(place);
        }
        #[cfg(test)]
        {
            self.visits += 1;
        }
        let from = behind.map_or((0, 0), |(machine, processor)| (machine, processor + 1));
        self.places.range(from..).next().copied()
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
