//! A task as the rest of its chassis sees it.

use std::sync::Arc;

use crate::{
    mailbox::Mailbox,
    message::{CommandInfo, Tid},
    processor::ProcessorHandle,
    statistics::TaskStatistics,
};

/// How many messages the queue of a runtime task holds.
const SYSTEM_QUEUE: usize = 1024;

/// A task of this chassis, as the others see it.
pub(crate) struct TaskRecord {
    pub(crate) name: Arc<str>,
    pub(crate) tid: Tid,
    pub(crate) mailbox: Mailbox,
    pub(crate) statistics: TaskStatistics,
}

impl TaskRecord {
    /// A task of processor `home` that takes `commands`, with room for `capacity` messages of each priority.
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
    pub(crate) fn of_runtime(
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
    /// One with room for `capacity` messages, in `slot` of the processor `home`.
    pub(crate) fn with_room(
        capacity: usize,
        home: Arc<crate::processor::ProcessorHandle>,
        slot: u16,
    ) -> Arc<Self> {
        Arc::new(Self {
            name: "t".into(),
            tid: Tid::new(1, 1, slot),
            mailbox: Mailbox::new(capacity, home, slot),
            statistics: TaskStatistics::default(),
        })
    }
}
