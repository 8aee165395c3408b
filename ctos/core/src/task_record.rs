//! A task as the rest of its chassis sees it.

use std::sync::Arc;

use crate::{mailbox::Mailbox, processor::ProcessorHandle, statistics::TaskStatistics};
use ctos_message::{CommandInfo, Tid};

/// How many messages the queue of a runtime task holds.
const SYSTEM_QUEUE: usize = 1024;

/// A task of this chassis, as the others see it.
pub struct TaskRecord {
    pub name: Arc<str>,
    pub tid: Tid,
    pub mailbox: Mailbox,
    pub statistics: TaskStatistics,
}

impl TaskRecord {
    /// A task of processor `home` that takes `commands`, with credits for `capacity` messages of each priority.
    pub(crate) fn new(
        name: &str,
        tid: Tid,
        capacity: usize,
        commands: Arc<[CommandInfo]>,
        home: &Arc<ProcessorHandle>,
    ) -> Arc<Self> {
        Arc::new(Self {
            name: name.into(),
            tid,
            mailbox: Mailbox::new(capacity, home.clone(), tid.slot()),
            statistics: TaskStatistics::of(commands),
        })
    }

    /// A task of the runtime.
    pub fn of_runtime(
        name: &str,
        tid: Tid,
        commands: Arc<[CommandInfo]>,
        home: &Arc<ProcessorHandle>,
    ) -> Arc<Self> {
        Self::new(name, tid, SYSTEM_QUEUE, commands, home)
    }
}

#[cfg(test)]
impl TaskRecord {
    /// One with credits for `capacity` messages, in `slot` of the processor `home`.
    pub(crate) fn with_capacity(
        capacity: usize,
        home: Arc<crate::processor::ProcessorHandle>,
        slot: u32,
    ) -> Arc<Self> {
        Arc::new(Self {
            name: "t".into(),
            tid: Tid::new(1, 1, slot),
            mailbox: Mailbox::new(capacity, home, slot),
            statistics: TaskStatistics::default(),
        })
    }
}
