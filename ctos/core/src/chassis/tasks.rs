//! The tasks of a chassis by processor and slot.

use std::sync::Arc;

use crate::task_record::TaskRecord;
use ctos_message::Tid;

/// Tasks by processor and slot.
#[derive(Default)]
pub(super) struct Tasks(Vec<Vec<Option<Arc<TaskRecord>>>>);

impl Tasks {
    pub(super) fn get(&self, tid: Tid) -> Option<&Arc<TaskRecord>> {
        let slots = self.0.get(usize::from(tid.processor()))?;
        slots.get(usize::from(tid.slot()))?.as_ref()
    }

    pub(super) fn insert(&mut self, task: Arc<TaskRecord>) {
        let (processor, slot) = (
            usize::from(task.tid.processor()),
            usize::from(task.tid.slot()),
        );
        if self.0.len() <= processor {
            self.0.resize_with(processor + 1, Vec::new);
        }
        if let Some(slots) = self.0.get_mut(processor) {
            if slots.len() <= slot {
                slots.resize_with(slot + 1, || None);
            }
            if let Some(place) = slots.get_mut(slot) {
                *place = Some(task);
            }
        }
    }

    pub(super) fn remove(&mut self, tid: Tid) -> Option<Arc<TaskRecord>> {
        let slots = self.0.get_mut(usize::from(tid.processor()))?;
        slots.get_mut(usize::from(tid.slot()))?.take()
    }

    /// All of them, by id.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Arc<TaskRecord>> {
        self.0.iter().flatten().flatten()
    }
}
