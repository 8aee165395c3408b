//! Whom a task waits for. Noted of every call that waits for longer than its processor has
//! other things to do, readable from any thread.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock};

use crate::report::WaitReport;
use ctos_message::Tid;
use ctos_time::{Instant, lock::lock};

#[derive(Debug)]
struct Entry {
    to: Arc<str>,
    tid: Tid,
    command: &'static str,
    since: Instant,
}

/// The calls of one task that are shown.
#[derive(Debug, Default)]
struct Shown {
    entries: Vec<Option<Entry>>,
    /// Places in `entries` that are used again, so that a call allocates nothing and looks for nothing.
    free: Vec<usize>,
}

/// What one task waits for. Its children's calls count as its own.
#[derive(Debug, Default)]
pub struct Waits {
    /// Made for the first one.
    shown: OnceLock<Box<Mutex<Shown>>>,
}

impl Waits {
    fn shown(&self) -> MutexGuard<'_, Shown> {
        lock(self.shown.get_or_init(Box::default))
    }

    /// Shows a call; the number takes it away again.
    pub(crate) fn begin(
        &self,
        to: Arc<str>,
        tid: Tid,
        command: &'static str,
        since: Instant,
    ) -> usize {
        let entry = Some(Entry {
            to,
            tid,
            command,
            since,
        });
        let mut shown = self.shown();
        let Some(free) = shown.free.pop() else {
            shown.entries.push(entry);
            return shown.entries.len() - 1;
        };
        if let Some(place) = shown.entries.get_mut(free) {
            *place = entry;
        }
        free
    }

    /// The call has ended, however it ended.
    pub(crate) fn end(&self, place: usize) {
        let mut shown = self.shown();
        let entry = shown.entries.get_mut(place).and_then(Option::take);
        if entry.is_some() {
            shown.free.push(place);
        }
    }

    /// Whom the latest of them asked, and when.
    pub(crate) fn latest(&self) -> Option<(Tid, Instant)> {
        let shown = lock(self.shown.get()?);
        let latest = shown
            .entries
            .iter()
            .flatten()
            .max_by_key(|entry| entry.since)?;
        Some((latest.tid, latest.since))
    }

    /// What is waited for at `now`, longest first.
    pub fn read(&self, now: Instant) -> Vec<WaitReport> {
        let Some(shown) = self.shown.get() else {
            return Vec::new();
        };
        let shown = lock(shown);
        let mut waits: Vec<&Entry> = shown.entries.iter().flatten().collect();
        waits.sort_by_key(|entry| (entry.since, &entry.to));
        let report = |entry: &Entry| WaitReport {
            to: entry.to.to_string(),
            command: entry.command.to_owned(),
            for_s: now.since(entry.since).as_secs_f64(),
        };
        waits.into_iter().map(report).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_ended_is_not_waited_for_and_the_longest_comes_first() {
        let waits = Waits::default();
        let first = waits.begin("arm".into(), Tid::default(), "go", Instant::from_nanos(5));
        let second = waits.begin("eye".into(), Tid::default(), "look", Instant::from_nanos(3));
        let names = |waits: &Waits| -> Vec<String> {
            waits
                .read(Instant::START)
                .into_iter()
                .map(|wait| wait.to)
                .collect()
        };
        assert_eq!(names(&waits), ["eye", "arm"]);
        waits.end(first);
        assert_eq!(names(&waits), ["eye"]);
        let _third = waits.begin(
            "ear".into(),
            Tid::default(),
            "listen",
            Instant::from_nanos(9),
        );
        waits.end(second);
        assert_eq!(names(&waits), ["ear"]);
        assert_eq!(waits.shown().entries.len(), 2, "a free place was not used");
    }

    #[test]
    fn among_many_calls_a_free_place_is_known_and_need_not_be_looked_for() {
        let waits = Waits::default();
        let begin = || waits.begin("arm".into(), Tid::default(), "go", Instant::START);
        let places: Vec<usize> = (0..1000).map(|_| begin()).collect();
        assert_eq!(places, (0..1000).collect::<Vec<_>>());
        assert_eq!(waits.shown().free, [0; 0]);
        for place in [700, 20, 20] {
            waits.end(place);
        }
        assert_eq!(waits.shown().free, [700, 20]);
        assert_eq!([begin(), begin(), begin()], [20, 700, 1000]);
    }
}
