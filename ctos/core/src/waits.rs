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

/// What one task waits for. Its children's calls count as its own.
#[derive(Debug, Default)]
pub struct Waits {
    /// Made for the first one. Free places are used again, so that a call allocates nothing.
    entries: OnceLock<Box<Mutex<Vec<Option<Entry>>>>>,
}

impl Waits {
    fn entries(&self) -> MutexGuard<'_, Vec<Option<Entry>>> {
        lock(self.entries.get_or_init(Box::default))
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
        let mut entries = self.entries();
        match entries.iter().position(Option::is_none) {
            Some(free) => {
                if let Some(place) = entries.get_mut(free) {
                    *place = entry;
                }
                free
            }
            None => {
                entries.push(entry);
                entries.len() - 1
            }
        }
    }

    /// The call has ended, however it ended.
    pub(crate) fn end(&self, place: usize) {
        if let Some(place) = self.entries().get_mut(place) {
            *place = None;
        }
    }

    /// Whom the latest of them asked, and when.
    pub(crate) fn latest(&self) -> Option<(Tid, Instant)> {
        let entries = lock(self.entries.get()?);
        let latest = entries.iter().flatten().max_by_key(|entry| entry.since)?;
        Some((latest.tid, latest.since))
    }

    /// What is waited for at `now`, longest first.
    pub fn read(&self, now: Instant) -> Vec<WaitReport> {
        let Some(entries) = self.entries.get() else {
            return Vec::new();
        };
        let entries = lock(entries);
        let mut waits: Vec<&Entry> = entries.iter().flatten().collect();
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
        assert_eq!(waits.entries().len(), 2, "a free place was not used");
    }
}
