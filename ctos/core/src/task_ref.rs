//! A task as others name it.

use std::sync::Arc;

use ctos_message::Tid;
use serde::{Deserialize, Serialize};

/// A task that was found by name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskRef {
    pub(crate) name: Arc<str>,
    pub(crate) tid: Tid,
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
