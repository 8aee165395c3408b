//! Where the tasks and chassis of an app stand in its lists, by their names. Made once, with the app.

use std::collections::BTreeMap;

/// The places of names in two lists; of a name that stands twice the first. And those of each handler's tasks.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Index {
    tasks: BTreeMap<String, usize>,
    chassis: BTreeMap<String, usize>,
    handlers: BTreeMap<String, Vec<usize>>,
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
    /// The names of all chassis, and those of all tasks with their handlers, in declared order.
    pub(super) fn of<'n>(
        chassis: impl Iterator<Item = &'n str>,
        tasks: impl Iterator<Item = (&'n str, &'n str)> + Clone,
    ) -> Self {
        let mut handlers: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for (place, (_, handler)) in tasks.clone().enumerate() {
            match handlers.get_mut(handler) {
                Some(places) => places.push(place),
                None => drop(handlers.insert(handler.to_owned(), vec![place])),
            }
        }
        Self {
            handlers,
            tasks: places(tasks.map(|(name, _)| name)),
            chassis: places(chassis),
        }
    }

    pub(super) fn task(&self, name: &str) -> Option<usize> {
        self.tasks.get(name).copied()
    }

    pub(super) fn of_handler(&self, handler: &str) -> &[usize] {
        self.handlers.get(handler).map_or(&[], Vec::as_slice)
    }

    pub(super) fn chassis(&self, name: &str) -> Option<usize> {
        self.chassis.get(name).copied()
    }
}
