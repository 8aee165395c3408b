//! Where the tasks and chassis of an app stand in its lists, by their names. Made once, with the app.

use super::app::{ChassisConfig, TaskConfig};
use std::collections::BTreeMap;

/// The places of names in two lists; of a name that stands twice the first. And those of each handler's tasks.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Index {
    tasks: BTreeMap<String, usize>,
    chassis: BTreeMap<String, usize>,
    handlers: BTreeMap<String, Vec<usize>>,
}

/// Each name with its place.
fn places<'n>(names: impl Iterator<Item = &'n String>) -> BTreeMap<String, usize> {
    let mut places = BTreeMap::new();
    for (place, name) in names.enumerate() {
        places.entry(name.clone()).or_insert(place);
    }
    places
}

impl Index {
    pub(super) fn of(chassis: &[ChassisConfig], tasks: &[TaskConfig]) -> Self {
        let mut handlers: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for (place, task) in tasks.iter().enumerate() {
            match handlers.get_mut(&task.handler) {
                Some(places) => places.push(place),
                None => drop(handlers.insert(task.handler.clone(), vec![place])),
            }
        }
        Self {
            handlers,
            tasks: places(tasks.iter().map(|task| &task.name)),
            chassis: places(chassis.iter().map(|chassis| &chassis.name)),
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
