//! Data objects that one net keeps for itself: what `send` lines store is what others take along.

use std::{cell::RefCell, collections::BTreeMap, rc::Rc};

use ctos::task::{Context, HandlerError};
use pnt::library::{Acted, DataStore, Later};

type Bytes = BTreeMap<String, Vec<u8>>;

/// The objects, by name; clones are the same.
#[derive(Debug, Clone, Default)]
pub(crate) struct Objects(Rc<RefCell<Bytes>>);

impl Objects {
    /// All of them, to be kept.
    pub(crate) fn kept(&self) -> Bytes {
        self.0.borrow().clone()
    }

    pub(crate) fn take_up(&mut self, kept: Bytes) {
        self.0.replace(kept);
    }
}

impl DataStore for Objects {
    fn get(&self, _: &Context, object: &str) -> Later<Result<Vec<u8>, HandlerError>> {
        let found = self.0.borrow().get(object).cloned();
        let missing = || HandlerError::new(format!("nothing was stored as `{object}` yet"));
        let found = found.ok_or_else(missing);
        Box::pin(async { found })
    }

    fn put(&self, _: &Context, objects: Vec<(String, Vec<u8>)>) -> Later<Acted> {
        self.0.borrow_mut().extend(objects);
        Box::pin(async { Ok(()) })
    }

    fn validity(&self, _: &Context, _: &str, _: bool) -> Later<Acted> {
        // The marking says it, and nobody else has these objects.
        Box::pin(async { Ok(()) })
    }
}
