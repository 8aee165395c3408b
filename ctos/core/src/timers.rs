//! The timers of one processor, in the order in which they are due. It knows neither clock nor wakers.

use std::collections::BTreeMap;

use ctos_time::Instant;

/// Timers, each with a value; those of the same moment in the order in which they were set.
pub(crate) struct Timers<T> {
    by_moment: BTreeMap<TimerKey, T>,
    next: u64,
}

/// Names one timer among all that were ever set: its moment, and its number.
pub(crate) type TimerKey = (Instant, u64);

impl<T> Default for Timers<T> {
    fn default() -> Self {
        Self {
            by_moment: BTreeMap::new(),
            next: 0,
        }
    }
}

impl<T> Timers<T> {
    /// When the first timer is due.
    pub(crate) fn first(&self) -> Option<Instant> {
        self.by_moment.first_key_value().map(|(key, _)| key.0)
    }

    /// Sets a timer.
    pub(crate) fn insert(&mut self, at: Instant, value: T) -> TimerKey {
        let key = (at, self.next);
        self.next += 1;
        self.by_moment.insert(key, value);
        key
    }

    /// Takes a timer out; `None` if it was due before.
    pub(crate) fn remove(&mut self, key: TimerKey) -> Option<T> {
        self.by_moment.remove(&key)
    }

    /// Takes out the first timer that is due at `now`.
    pub(crate) fn pop_due(&mut self, now: Instant) -> Option<T> {
        let first = self.by_moment.first_entry()?;
        (first.key().0 <= now).then(|| first.remove())
    }

    /// Takes out all.
    pub(crate) fn clear(&mut self) -> Vec<T> {
        std::mem::take(&mut self.by_moment).into_values().collect()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[derive(Debug, Clone)]
    enum Step {
        Insert(u64),
        Remove(usize),
        Pop(u64),
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            3 => (0_u64..50).prop_map(Step::Insert),
            2 => any::<usize>().prop_map(Step::Remove),
            2 => (0_u64..60).prop_map(Step::Pop),
        ]
    }

    proptest! {
        #[test]
        fn it_does_what_an_ordered_map_does(steps in proptest::collection::vec(step(), 0..300)) {
            let mut timers = Timers::default();
            let mut model = BTreeMap::new();
            let mut keys = Vec::new();
            for (count, step) in steps.into_iter().enumerate() {
                match step {
                    Step::Insert(at) => {
                        let at = Instant::from_nanos(at);
                        keys.push((timers.insert(at, count), (at, count)));
                        model.insert((at, count), count);
                    }
                    Step::Remove(index) if !keys.is_empty() => {
                        // Also keys whose timer is out already.
                        let (key, in_model) = keys[index % keys.len()];
                        prop_assert_eq!(timers.remove(key), model.remove(&in_model));
                    }
                    Step::Remove(_) => {}
                    Step::Pop(now) => {
                        let now = Instant::from_nanos(now);
                        let first = model.first_entry().filter(|entry| entry.key().0 <= now);
                        prop_assert_eq!(timers.pop_due(now), first.map(|entry| entry.remove()));
                    }
                }
                prop_assert_eq!(timers.first(), model.keys().next().map(|key| key.0));
            }
        }
    }
}
