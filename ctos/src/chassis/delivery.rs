//! The one delivery: a task of this chassis gets a value, a task of another one gets a frame over the link. The
//! sender waits the same way for both, and is told in the same way what came of it.

use std::sync::Arc;

use super::{Chassis, Outbound, TaskRecord};
use crate::{
    call::{Answer, Fault, Promise, ReplyKey, ReplySlot, Waiting},
    mailbox::{Acceptance, Offered},
    message::{Command, Data, Flags, Message, Tid},
    processor::Processor,
    record::Asked,
    system,
};

/// What the sender of a message waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WaitFor {
    /// The reply.
    Reply,
    /// That the receiver's queue has taken the message.
    Acceptance,
    /// Nothing: the message is taken now, or refused.
    Nothing,
}

/// A message that was delivered, or is on its way.
pub(crate) struct Delivered {
    /// Who asked whom for what.
    pub(crate) asked: Asked,
    /// Its number in the record.
    pub(crate) recorded: u64,
    pub(crate) outcome: Outcome,
}

/// What has become of a message.
pub(crate) enum Outcome {
    /// It is in the queue, which is all that its sender wants.
    Taken,
    /// The slot is told later, or was told; with the way to take it back when it went over a link.
    Waits(Option<Outbound>),
    /// It was not taken.
    Failed(Fault),
}

impl Chassis {
    /// Brings `message` to its receiver. What `slot` makes is told what `wait` names, or the fault; it is made only
    /// if that is not known at once. Every message of this chassis passes here: a recorder sees it, and a replay takes
    /// the place of the receiver.
    pub(crate) fn deliver(
        self: &Arc<Self>,
        mut message: Message,
        wait: WaitFor,
        slot: &mut dyn FnMut() -> Option<ReplySlot>,
    ) -> Delivered {
        self.address(&mut message);
        let asked = Asked::of(&message);
        if let Some(replay) = self.tap.replay() {
            let slot = slot().unwrap_or_else(|| ReplySlot::outside(Arc::default()));
            replay.dispatch(&message, wait, self.clock.now(), slot);
            return Delivered {
                asked,
                recorded: 0,
                outcome: Outcome::Waits(None),
            };
        }
        let recorded = self.tap.sent(&message, wait);
        message.envelope.recorded = recorded;
        let outcome = if asked.to().chassis() == self.index {
            self.hand_over(message, wait, slot)
        } else {
            self.post(message, wait, slot)
        };
        Delivered {
            asked,
            recorded,
            outcome,
        }
    }

    /// Puts a message into the queue of a task of this chassis.
    fn hand_over(
        &self,
        mut message: Message,
        wait: WaitFor,
        slot: &mut dyn FnMut() -> Option<ReplySlot>,
    ) -> Outcome {
        let Some(task) = self.receiver(message.header().to) else {
            return Outcome::Failed(Fault::UnknownTask);
        };
        let header = &mut message.envelope.header;
        header.flags = header.flags.with(wait.flags()).with(Flags::OWNED);
        let mailbox = &task.mailbox;
        if wait == WaitFor::Reply {
            message.envelope.reply = slot();
            mailbox.put(message, Acceptance::Silent);
            return Outcome::Waits(None);
        }
        match mailbox.offer(message) {
            Offered::Taken => Outcome::Taken,
            Offered::Closed(_) => Outcome::Failed(Fault::Stopping),
            Offered::NoRoom(message) if wait == WaitFor::Acceptance => {
                mailbox.line_up(message, Acceptance::from(slot()));
                Outcome::Waits(None)
            }
            Offered::NoRoom(_) => Outcome::Failed(mailbox.full()),
        }
    }

    /// A task of this chassis. Those of the processor that this thread runs are found there.
    fn receiver(&self, to: Tid) -> Option<Arc<TaskRecord>> {
        let (_, home) = self.processors.get(usize::from(to.processor()))?;
        let here = Processor::here_if(home).and_then(|here| here.queue(to.slot()));
        match here {
            Some(queue) => Some(queue.task().clone()),
            None => self.task(to),
        }
    }

    /// Sends from outside of all tasks; the returned future ends with what `wait` names, or with a fault.
    pub(crate) fn dispatch(self: &Arc<Self>, message: Message, wait: WaitFor) -> Waiting {
        let promise = Arc::new(Promise::default());
        let mut slot = || Some(ReplySlot::outside(promise.clone()));
        let outbound = match self.deliver(message, wait, &mut slot).outcome {
            Outcome::Waits(outbound) => outbound,
            Outcome::Taken => {
                promise.fulfil(Ok(Data::NOTHING));
                None
            }
            Outcome::Failed(fault) => {
                promise.fulfil(Err(fault));
                None
            }
        };
        Waiting::for_call(promise, self, outbound)
    }

    /// Sends a message of the runtime without waiting for anything. It is lost only with its
    /// receiver.
    pub(crate) fn post_system<C: Command>(self: &Arc<Self>, to: Tid, request: C) {
        let from = system::agent_tid(self.index);
        let message = Message::request(to, from, C::CODE, request).flagged(Flags::HIGH_PRIORITY);
        self.deliver(message, WaitFor::Acceptance, &mut || None);
    }

    /// Turns `message` to where the receiver is now, and begins a trace if it belongs to none.
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

    /// Answers in place of whoever has the right to; nothing comes of it when that was done already.
    pub(crate) fn answer_by_key(&self, key: ReplyKey, answer: Answer) {
        match key {
            ReplyKey::Remote(request) => self.post_reply(&request, answer),
            ReplyKey::Outside(promise) => promise.fulfil(answer),
            ReplyKey::Local(home, call) => match Processor::here_if(&home) {
                Some(here) => here.take_answer(call, answer),
                None => home.bring_answer(call, answer),
            },
        }
    }
}

impl WaitFor {
    /// The flags of a message whose sender waits so.
    pub(crate) fn flags(self) -> Flags {
        match self {
            Self::Reply => Flags::REPLY_WAIT,
            Self::Acceptance => Flags::ACCEPT_WAIT,
            Self::Nothing => Flags::NONE,
        }
    }
}
