//! Where the tasks and chassis of an app stand in its lists, by their names. Made once, with the app.

use std::collections::BTreeMap;

/// The places of names in two lists; of a name that stands twice the first. And those of the tasks of each handler and
/// of each chassis.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Index {
    tasks: BTreeMap<String, usize>,
    chassis: BTreeMap<String, usize>,
    handlers: BTreeMap<String, Vec<usize>>,
    homes: BTreeMap<String, Vec<usize>>,
}

/// The places of those that have a word in common, by that word.
fn grouped<'n>(words: impl Iterator<Item = &'n str>) -> BTreeMap<String, Vec<usize>> {
    let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (place, word) in words.enumerate() {
        match groups.get_mut(word) {
            Some(places) => places.push(place),
            None => drop(groups.insert(word.to_owned(), vec![place])),
        }
    }
    groups
}

/// Each name with its place.
fn places<'n>(names: impl Iterator<Item = &'n str>) -> BTreeMap<String, usize> {
    let mut places = BTreeMap::new();
    for (place, name) in names.enumerate() {
        places.entry(name.to_owned()).or_insert(place);
    }
    places
}

impl Index {
    /// The names of all chassis, and those of all tasks with their handlers and their chassis, in declared order.
    pub(super) fn of<'n>(
        chassis: impl Iterator<Item = &'n str>,
        tasks: impl Iterator<Item = [&'n str; 3]> + Clone,
    ) -> Self {
        Self {
            handlers: grouped(tasks.clone().map(|[_, handler, _]| handler)),
            homes: grouped(tasks.clone().map(|[.., home]| home)),
            tasks: places(tasks.map(|[name, ..]| name)),
            chassis: places(chassis),
        }
    }

    pub(super) fn task(&self, name: &str) -> Option<usize> {
        self.tasks.get(name).copied()
    }

    pub(super) fn of_handler(&self, handler: &str) -> &[usize] {
        self.handlers.get(handler).map_or(&[], Vec::as_slice)
    }

    pub(super) fn of_chassis(&self, chassis: &str) -> &[usize] {
        self.homes.get(chassis).map_or(&[], Vec::as_slice)
    }

    pub(super) fn chassis(&self, name: &str) -> Option<usize> {
        self.chassis.get(name).copied()
    }
}
