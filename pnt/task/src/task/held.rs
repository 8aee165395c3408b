//! What waits until the changes that led to it are stored. It knows nothing of what the effects do.

use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    rc::Rc,
    sync::Arc,
};

use crate::store::Store;

/// What others see of a change.
type Effect<E> = Box<dyn FnOnce(&Rc<E>)>;

/// Effects of changes that are not stored yet, on an engine `E`.
pub(super) struct Durable<E> {
    pub(super) store: Option<Arc<Store>>,
    /// The change with which each came, in order.
    pub(super) held: RefCell<VecDeque<(u64, Effect<E>)>>,
    /// The last change that is stored.
    pub(super) stored: Cell<u64>,
    /// Whether a child is committing.
    pub(super) committing: Cell<bool>,
    /// Whether a commit has failed: nothing will be stored any more.
    pub(super) broken: Cell<bool>,
    /// The text of a net that was put in place and is not stored yet.
    pub(super) new_net: RefCell<Option<Vec<u8>>>,
}

impl<E> Durable<E> {
    pub(super) fn new(store: Option<Arc<Store>>) -> Self {
        // Nobody waits for what is never stored.
        let stored = if store.is_some() { 0 } else { u64::MAX };
        Self {
            store,
            held: RefCell::default(),
            stored: Cell::new(stored),
            committing: Cell::new(false),
            broken: Cell::new(false),
            new_net: RefCell::default(),
        }
    }

    /// Whether there is a store at all.
    pub(super) fn is_kept(&self) -> bool {
        self.store.is_some()
    }

    /// Changes up to this one are stored.
    pub(super) fn stored(&self) -> u64 {
        self.stored.get()
    }
}
