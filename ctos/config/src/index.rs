//! Where the tasks and chassis of an app stand in its lists, by their names. Made once, with the app.

use std::collections::BTreeMap;

/// The places of those in a list that have a word in common, by that word.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Places(BTreeMap<String, Vec<usize>>);

/// The places of tasks by their names, handlers and chassis, and of chassis by their names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Index {
    pub(super) tasks: Places,
    pub(super) handlers: Places,
    pub(super) homes: Places,
    pub(super) chassis: Places,
}

impl Places {
    fn of<'n>(words: impl Iterator<Item = &'n str>) -> Self {
        let mut places: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for (place, word) in words.enumerate() {
            match places.get_mut(word) {
                Some(places) => places.push(place),
                None => drop(places.insert(word.to_owned(), vec![place])),
            }
        }
        Self(places)
    }

    /// Those of a word, in order.
    pub(super) fn all(&self, word: &str) -> &[usize] {
        self.0.get(word).map_or(&[], Vec::as_slice)
    }
}

impl Index {
    /// The names of all chassis, and those of all tasks with their handlers and their chassis, in declared order.
    pub(super) fn of<'n>(
        chassis: impl Iterator<Item = &'n str>,
        tasks: impl Iterator<Item = [&'n str; 3]> + Clone,
    ) -> Self {
        Self {
            handlers: Places::of(tasks.clone().map(|[_, handler, _]| handler)),
            homes: Places::of(tasks.clone().map(|[.., home]| home)),
            tasks: Places::of(tasks.map(|[name, ..]| name)),
            chassis: Places::of(chassis),
        }
    }
}
