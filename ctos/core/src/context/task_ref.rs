//! A task as others name it.

use std::sync::Arc;

use ctos_message::Tid;

/// A task that was found by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TaskRef {
    pub(super) name: Arc<str>,
    pub(super) tid: Tid,
}

impl TaskRef {
    /// Its symbolic name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its id.
    #[must_use]
    pub fn tid(&self) -> Tid {
        self.tid
    }
}

#[doc(hidden)]
impl TaskRef {
    pub fn new(name: impl Into<Arc<str>>, tid: Tid) -> Self {
        Self {
            name: name.into(),
            tid,
        }
    }
}
