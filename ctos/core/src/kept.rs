//! The answers of a task whose state survives its process: they wait until that state is stored. And what was stored
//! last. Knows no store and no handler.

use std::sync::{Arc, Mutex};

use crate::{
    envelope::Message,
    reply::{self, Answer, Caller, ReplySlot},
};
use ctos_message::fault::Fault;
use ctos_time::lock::lock;

/// What such a task has of it.
#[derive(Default)]
pub(crate) struct Kept {
    /// Locked while a state is being stored: others wait for the end of that.
    pub(crate) stored: tokio::sync::Mutex<Stored>,
    held: Mutex<Vec<(ReplySlot, Answer)>>,
}

/// What is known of the stored state.
#[derive(Default)]
pub(crate) struct Stored {
    /// Whether it was loaded: nothing may be stored over what was not loaded.
    pub(crate) loaded: bool,
    /// What was stored last; empty: nothing.
    pub(crate) state: Vec<u8>,
    /// A later state may have been stored, or not.
    pub(crate) torn: bool,
}

impl Kept {
    /// The answer to `message` is to wait for the end of the handler that gives it.
    pub(crate) fn hold(self: &Arc<Self>, message: &mut Message) {
        if let Some(slot) = message.envelope.reply.take() {
            let held = Held {
                slot: Mutex::new(Some(slot)),
                kept: self.clone(),
            };
            message.envelope.reply = Some(ReplySlot::other(Arc::new(held)));
        }
    }

    /// The answers that were given leave; in place of them `instead`, if there is one.
    pub(crate) fn release(&self, instead: Option<&Fault>) {
        let held = std::mem::take(&mut *lock(&self.held));
        for (slot, answer) in held {
            slot.answer(instead.map_or(answer, |fault| Err(fault.clone())));
        }
    }
}

/// A caller whose answer waits.
struct Held {
    slot: Mutex<Option<ReplySlot>>,
    kept: Arc<Kept>,
}

impl Caller for Held {
    fn answer(&self, answer: Answer) {
        let Some(slot) = lock(&self.slot).take() else {
            return;
        };
        // What a child or another thread answers no handler's end lets go.
        if reply::is_handling() {
            lock(&self.kept.held).push((slot, answer));
        } else {
            slot.answer(answer);
        }
    }

    fn is_abandoned(&self) -> bool {
        let slot = lock(&self.slot);
        slot.as_ref().is_none_or(ReplySlot::is_abandoned)
    }
}
