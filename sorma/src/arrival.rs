//! The order in which requests come for an object that is not built yet. Threads build it, and who waits for them is
//! woken in any order.

use std::{collections::BTreeMap, sync::Arc};

use parking_lot::Mutex;
use tokio::sync::{Mutex as Line, OwnedMutexGuard};

/// The lines of those who ask for objects that are not there yet, by the names of the objects.
pub(crate) type Arrivals = Arc<Mutex<BTreeMap<String, Arc<Line<()>>>>>;

/// The first place in such a line, until it is dropped.
pub(crate) struct Arrival {
    arrivals: Arrivals,
    name: String,
    place: Option<OwnedMutexGuard<()>>,
}

impl Arrival {
    /// The first place in the line for `name`, when it is the caller's turn; `None` at once when nobody has to wait for an
    /// object that `is_there`.
    pub(crate) async fn at(
        arrivals: &Arrivals,
        name: &str,
        is_there: impl FnOnce() -> bool,
    ) -> Option<Self> {
        let line = {
            let mut lines = arrivals.lock();
            match lines.get(name) {
                Some(line) => Arc::clone(line),
                None if is_there() => return None,
                None => Arc::clone(lines.entry(name.to_owned()).or_default()),
            }
        };
        Some(Self {
            arrivals: Arc::clone(arrivals),
            name: name.to_owned(),
            place: Some(line.lock_owned().await),
        })
    }
}

impl Drop for Arrival {
    fn drop(&mut self) {
        self.place = None;
        let mut lines = self.arrivals.lock();
        // Nobody else is in it, and nobody comes while this is locked.
        if lines
            .get(&self.name)
            .is_some_and(|line| Arc::strong_count(line) == 1)
        {
            lines.remove(&self.name);
        }
    }
}
