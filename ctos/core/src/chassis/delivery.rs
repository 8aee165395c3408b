//! The one delivery: a task of this chassis gets a value, a task of another one gets a frame over the link. The
//! sender waits the same way for both, and learns in the same way what came of it.

use std::sync::Arc;

use super::{Chassis, pending::Outbound};
use crate::{
    delivery::NotTaken,
    envelope::Message,
    processor::Processor,
    reply::{Caller, Nobody, Promise, ReplySlot, Waiting},
    system,
    tap::{Sent, WaitFor},
};
use ctos_message::{Command, Data, Flags, Tid, fault::Fault};

/// What has become of a message.
pub(crate) enum Outcome {
    /// It is in the queue, which is all that its sender wants.
    Taken,
    /// The slot gets the outcome later, or has it; with the way to take it back when it went over a link.
    Waits(Option<Outbound>),
    /// It was not taken.
    Failed(Fault),
}

#[doc(hidden)]
impl Chassis {
    /// Brings `message` to its receiver. The reply slot that `slot` makes gets what `wait` names, or the fault.
    /// For a message that asks for no reply, `slot` runs only if that is not known at once. Every message of this
    /// chassis passes here: a recorder sees it, and a replay takes the place of the receiver. Tells the sender
    /// whom it reached.
    pub(crate) fn deliver(
        self: &Arc<Self>,
        mut message: Message,
        wait: WaitFor,
        sent: &mut Sent,
        slot: impl FnOnce() -> ReplySlot,
    ) -> Outcome {
        self.address(&mut message);
        sent.asked.to = message.header().to;
        sent.asked.trace = message.trace();
        if let Some(observer) = self.tap.observer() {
            if observer.replays() {
                observer.replay(&message, wait, self.clock.now(), slot());
                return Outcome::Waits(None);
            }
            sent.id = observer.sent(&message, wait);
            message.envelope.recorded = sent.id;
        }
        if message.header().to.chassis() == self.index {
            self.hand_over(message, wait, slot)
        } else {
            self.post(message, wait, slot)
        }
    }

    /// Puts a message into the queue of a task of this chassis. Where this thread runs the task's processor, the queue
    /// is found there.
    fn hand_over(
        &self,
        mut message: Message,
        wait: WaitFor,
        slot: impl FnOnce() -> ReplySlot,
    ) -> Outcome {
        let to = message.header().to;
        let header = &mut message.envelope.header;
        header.flags |= wait.flags() | Flags::OWNED;
        let slot = if wait == WaitFor::Reply {
            message.envelope.reply.get_or_insert_with(slot);
            None
        } else {
            Some(slot)
        };
        let home = self.processors.get(usize::from(to.processor()));
        let here = home.and_then(|(_, home)| Processor::at_hand(home));
        let offered = match here.and_then(|here| Some((here.queue(to.slot())?, here))) {
            Some((queue, here)) => queue.offer(&here, message),
            None => match self.task(to) {
                Some(task) => task.mailbox.offer(message),
                None => return fail(message, wait, Fault::UnknownTask),
            },
        };
        let mut message = match offered {
            Ok(()) if wait == WaitFor::Reply => return Outcome::Waits(None),
            Ok(()) => return Outcome::Taken,
            Err(NotTaken::Closed(message)) => return fail(message, wait, Fault::Stopping),
            Err(NotTaken::Full(message)) => message,
        };
        match self.task(to).filter(|task| !task.mailbox.is_closed()) {
            None => fail(message, wait, Fault::Stopping),
            Some(task) if wait == WaitFor::Nothing => Outcome::Failed(task.mailbox.full()),
            Some(task) => {
                let reply = &mut message.envelope.reply;
                *reply = reply.take().or_else(|| slot.map(|slot| slot()));
                task.mailbox.line_up(message);
                Outcome::Waits(None)
            }
        }
    }

    /// Sends from outside of all tasks; the returned future ends with what `wait` names, or with a fault.
    pub fn dispatch(self: &Arc<Self>, message: Message, wait: WaitFor) -> Waiting {
        let (promise, mut waiting) = Promise::new();
        let slot = || ReplySlot::outside(promise.clone());
        let mut sent = Sent::of(&message);
        match self.deliver(message, wait, &mut sent, slot) {
            Outcome::Waits(Some(outbound)) => {
                let chassis = self.clone();
                waiting.take_back = Some(Box::new(move || chassis.abandon(outbound)));
            }
            Outcome::Waits(None) => {}
            Outcome::Taken => promise.answer(Ok(Data::NOTHING)),
            Outcome::Failed(fault) => promise.answer(Err(fault)),
        }
        waiting
    }

    /// Sends a message of the runtime without waiting for anything. It is lost only with its
    /// receiver.
    pub fn post_system<C: Command>(self: &Arc<Self>, to: Tid, request: C) {
        let from = system::agent_tid(self.index);
        let message = Message::request(to, from, C::CODE, request).flagged(Flags::HIGH_PRIORITY);
        let nobody = || ReplySlot::other(Arc::new(Nobody));
        let mut sent = Sent::of(&message);
        self.deliver(message, WaitFor::Acceptance, &mut sent, nobody);
    }

    /// Directs `message` to where the receiver is now, and begins a trace if it belongs to none.
    fn address(&self, message: &mut Message) {
        let envelope = &mut *message.envelope;
        if envelope.trace == 0 {
            envelope.trace = self.fresh_trace();
        }
        // A fence goes to the old place itself.
        if envelope.header.command != system::Fence::CODE {
            envelope.header.to = self.directory.current(envelope.header.to);
        }
    }
}

/// Tells the sender of a message that it was not taken: at once, or by the slot in it.
fn fail(message: Message, wait: WaitFor, fault: Fault) -> Outcome {
    if wait != WaitFor::Reply {
        return Outcome::Failed(fault);
    }
    message.refuse(fault);
    Outcome::Waits(None)
}
