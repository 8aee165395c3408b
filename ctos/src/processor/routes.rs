//! The other processors of the chassis, as far as the tasks of this one have to do with theirs: queues and
//! names of receivers, and where answers go. What a message needs of them is kept here, so that it does not
//! count owners in memory that other cores count in, too.

use std::{
    cell::{Cell, Ref, RefCell},
    sync::Arc,
};

use super::{Processor, ProcessorHandle, handle::Item};
use crate::{
    chassis::TaskRecord,
    exchange::{Brought, Ticket},
    message::Tid,
};

/// Something of each task, by processor and slot.
type ByTask<T> = RefCell<Vec<Vec<Option<T>>>>;

#[derive(Default)]
pub(super) struct Routes {
    tasks: ByTask<Arc<TaskRecord>>,
    /// How many tasks were noted since those that had ended were forgotten, those that were left included, and
    /// at how many that is done again.
    noted: Cell<usize>,
    forget_at: Cell<usize>,
    names: ByTask<Arc<str>>,
    /// The processors that were given answers.
    homes: RefCell<Vec<Arc<ProcessorHandle>>>,
}

impl Routes {
    pub(super) fn clear(&self) {
        self.tasks.borrow_mut().clear();
        self.names.borrow_mut().clear();
        self.homes.borrow_mut().clear();
    }

    /// Notes a task, if there is one.
    #[cold]
    fn note_task(&self, of: Tid, task: Option<Arc<TaskRecord>>) {
        if self.noted.get() >= self.forget_at.get() {
            self.forget_ended();
        }
        note(&self.tasks, of, task);
        self.noted.set(self.noted.get() + 1);
    }

    /// Lets go of the tasks that have ended, most of which nobody asks for again.
    fn forget_ended(&self) {
        /// As few as these are left where they are.
        const FEW: usize = 64;
        let mut ended = Vec::new();
        let mut left = 0;
        for place in self.tasks.borrow_mut().iter_mut().flatten() {
            match place.take_if(|task| task.mailbox.is_closed()) {
                Some(task) => ended.push(task),
                None => left += usize::from(place.is_some()),
            }
        }
        self.noted.set(left);
        self.forget_at.set(2 * left + FEW);
    }
}

/// What is noted of a task.
#[inline]
fn noted<T>(all: &[Vec<Option<T>>], of: Tid) -> Option<&T> {
    let slots = all.get(usize::from(of.processor()))?;
    slots.get(usize::from(of.slot()))?.as_ref()
}

/// Notes something of a task.
#[cold]
fn note<T>(all: &ByTask<T>, of: Tid, what: Option<T>) {
    let (processor, slot) = (usize::from(of.processor()), usize::from(of.slot()));
    let mut all = all.borrow_mut();
    if all.len() <= processor {
        all.resize_with(processor + 1, Vec::new);
    }
    let Some(slots) = all.get_mut(processor) else {
        return;
    };
    if slots.len() <= slot {
        slots.resize_with(slot + 1, || None);
    }
    let before = match slots.get_mut(slot) {
        Some(place) => std::mem::replace(place, what),
        None => None,
    };
    drop(all);
    drop(before);
}

impl Processor {
    /// `to`, if its queue is open: a task of another processor of this chassis; `find` is asked when it
    /// is not known here.
    #[inline]
    pub(crate) fn route(
        &self,
        to: Tid,
        find: impl FnOnce() -> Option<Arc<TaskRecord>>,
    ) -> Option<Ref<'_, Arc<TaskRecord>>> {
        let tasks = &self.routes.tasks;
        let open = |task: &&Arc<TaskRecord>| !task.mailbox.is_closed();
        let known = Ref::filter_map(tasks.borrow(), |all| noted(all, to).filter(open));
        match known {
            Ok(known) => return Some(known),
            // Not known, or closed; the cell is free again.
            Err(all) => drop(all),
        }
        self.routes.note_task(to, find());
        Ref::filter_map(tasks.borrow(), |all| noted(all, to)).ok()
    }

    /// Brings the answer to a call of another processor.
    #[inline]
    pub(crate) fn bring_answer(&self, ticket: Ticket, answer: Brought) {
        let is_it = |home: &&Arc<ProcessorHandle>| Arc::ptr_eq(home, ticket.home());
        let homes = &self.routes.homes;
        let refused = match Ref::filter_map(homes.borrow(), |all| all.iter().find(is_it)) {
            Ok(home) => home.bring(Item::Answer(ticket, answer)),
            Err(all) => {
                drop(all);
                let home = ticket.home().clone();
                homes.borrow_mut().push(home.clone());
                home.bring(Item::Answer(ticket, answer))
            }
        };
        // Outside the borrow: without a processor nobody waits for it, and it may be code of others that
        // drops it.
        drop(refused);
    }

    /// Whether `name` is known to be that of `of`, a task of another processor of this chassis, now at the
    /// latest. A slot is never used again, so that its task is the same as long as the chassis lives.
    #[inline]
    pub(crate) fn knows_far_name(&self, of: Tid, name: &Arc<str>) -> bool {
        if let Some(known) = noted(&self.routes.names.borrow(), of) {
            return Arc::ptr_eq(known, name) || known == name;
        }
        note(&self.routes.names, of, Some(name.clone()));
        true
    }

    /// The name that [`Self::knows_far_name`] was told of.
    pub(crate) fn far_name(&self, of: Tid) -> Option<Arc<str>> {
        noted(&self.routes.names.borrow(), of).cloned()
    }
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use super::*;
    use crate::time::Clock;

    #[test]
    fn of_tasks_that_were_sent_to_and_have_ended_few_are_kept() {
        let clock = Clock::virtual_clock();
        let here: Rc<Processor> = Processor::new(Arc::default(), clock);
        let home: Arc<ProcessorHandle> = Arc::new(ProcessorHandle::new(1));
        let mut ended = Vec::new();
        for slot in 0..1000 {
            let task = TaskRecord::with_room(1, home.clone(), slot);
            assert!(here.route(task.tid, || Some(task.clone())).is_some());
            let lives_on = slot % 100 == 0;
            if !lives_on {
                task.mailbox.close();
                ended.push(Arc::downgrade(&task));
            }
        }
        let kept = ended.iter().filter(|task| task.strong_count() > 0);
        assert!(kept.count() < 100);
        for slot in (0..1000).step_by(100) {
            let nobody = || panic!("it is known");
            assert!(here.route(Tid::new(1, 1, slot), nobody).is_some());
        }
    }
}
