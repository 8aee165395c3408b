//! The other processors of the chassis, as far as the tasks of this one have to do with theirs: queues and
//! names of receivers, and where answers go. What a message needs of them is kept here, so that it does not
//! count owners in memory that other cores count in, too.

use std::{
    cell::{Ref, RefCell},
    sync::Arc,
};

use super::{Processor, ProcessorHandle, handle::Item};
use crate::{
    exchange::{Brought, Ticket},
    mailbox::Mailbox,
    message::Tid,
};

/// Something of each task, by processor and slot.
type ByTask<T> = RefCell<Vec<Vec<Option<T>>>>;

#[derive(Default)]
pub(super) struct Routes {
    queues: ByTask<Arc<Mailbox>>,
    names: ByTask<Arc<str>>,
    /// The processors that were given answers.
    homes: RefCell<Vec<Arc<ProcessorHandle>>>,
}

impl Routes {
    pub(super) fn clear(&self) {
        self.queues.borrow_mut().clear();
        self.names.borrow_mut().clear();
        self.homes.borrow_mut().clear();
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
    /// The open queue of `to`, a task of another processor of this chassis; `find` is asked when it
    /// is not known here.
    #[inline]
    pub(crate) fn route(
        &self,
        to: Tid,
        find: impl FnOnce() -> Option<Arc<Mailbox>>,
    ) -> Option<Ref<'_, Arc<Mailbox>>> {
        let queues = &self.routes.queues;
        let open = |queue: &&Arc<Mailbox>| !queue.is_closed();
        let known = Ref::filter_map(queues.borrow(), |all| noted(all, to).filter(open));
        match known {
            Ok(known) => return Some(known),
            // Not known, or closed; the cell is free again.
            Err(all) => drop(all),
        }
        note(queues, to, find());
        Ref::filter_map(queues.borrow(), |all| noted(all, to)).ok()
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
