//! What the tasks of one processor show each other without messages: values that never leave their thread, and
//! so need no lock. It knows nothing of what they mean.

use std::{any::Any, cell::RefCell, collections::BTreeMap};

use super::Context;

/// What was shown on one processor, by key.
#[derive(Default)]
pub(crate) struct Beside(RefCell<BTreeMap<String, Box<dyn Any>>>);

impl Beside {
    fn show(&self, key: &str, value: Box<dyn Any>) {
        let before = self.0.borrow_mut().insert(key.to_owned(), value);
        // Dropped outside the borrow: destructors may show something.
        drop(before);
    }

    fn shown<T: Clone + 'static>(&self, key: &str) -> Option<T> {
        let shown = self.0.borrow();
        shown.get(key)?.downcast_ref::<T>().cloned()
    }

    /// Forgets everything.
    pub(crate) fn clear(&self) {
        let shown = self.0.take();
        // As above.
        drop(shown);
    }
}

impl Context {
    /// Shows `value` to the tasks of this processor, in place of what was shown under `key` before. It stays
    /// there until another one takes its place or the processor ends; so it should own nothing that is
    /// to end with its task: a [`Weak`](std::rc::Weak) is what is meant.
    ///
    /// What tasks do to each other in this way is no message: it is neither recorded nor counted.
    pub fn show_beside<T: Clone + 'static>(&self, key: &str, value: T) {
        self.inner.processor.beside.show(key, Box::new(value));
    }

    /// What a task of this processor shows under `key`, if it is a `T`.
    #[must_use]
    pub fn beside<T: Clone + 'static>(&self, key: &str) -> Option<T> {
        self.inner.processor.beside.shown(key)
    }
}
