//! What the tasks of one processor show each other without messages: values that never leave their thread, and
//! so need no lock. It knows nothing of what they mean. Who has changed something of another task wakes a child
//! of that, which may have its turn at once.

use std::{any::Any, cell::RefCell, collections::BTreeMap, future::Future, rc::Rc};

use super::Context;
use crate::processor::{FutureId, Processor};

/// A child of a task, in the hands of those on its processor.
pub struct Child {
    processor: Rc<Processor>,
    id: FutureId,
}

impl Child {
    /// It is polled again, unless it has ended.
    #[inline]
    pub fn wake(&self) {
        self.processor.wake(self.id);
    }
}

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

    /// [`Self::spawn`] of a child that is woken by hand.
    pub fn spawn_child(&self, future: impl Future<Output = ()> + 'static) -> Child {
        Child {
            processor: self.inner.processor.clone(),
            id: self.begin_child(future),
        }
    }

    /// False: a child that was woken has its poll in the usual way.
    pub fn give_turn(&self, _child: &Child) -> bool {
        false
    }
}
