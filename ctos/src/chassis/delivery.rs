//! The one delivery: a task of this chassis gets a value, a task of another one gets a frame over the link. The
//! sender waits the same way for both, and is told in the same way what came of it.

use std::sync::Arc;

use super::{Chassis, Outbound};
use crate::{
    call::{Answer, Fault, Promise, ReplyKey, ReplySlot, Waiting},
    mailbox::{Acceptance, Offered},
    message::{Command, Data, Flags, Message},
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
    /// The way to take it back when it went over a link.
    pub(crate) outbound: Option<Outbound>,
}

impl Chassis {
    /// Brings `message` to its receiver. `slot` is told what `wait` names, or the fault; without one, nobody is.
    /// Every message of this chassis passes here: a recorder sees it, and a replay takes the place of the receiver.
    pub(crate) fn deliver(
        self: &Arc<Self>,
        mut message: Message,
        wait: WaitFor,
        slot: Option<ReplySlot>,
    ) -> Delivered {
        self.address(&mut message);
        let asked = Asked::of(&message);
        let mut delivered = Delivered {
            asked,
            recorded: 0,
            outbound: None,
        };
        if let Some(replay) = self.tap.replay() {
            let slot = slot.unwrap_or_else(|| ReplySlot::outside(Arc::default()));
            replay.dispatch(&message, wait, self.clock.now(), slot);
            return delivered;
        }
        delivered.recorded = self.tap.sent(&message, wait);
        message.envelope.recorded = delivered.recorded;
        if asked.to().chassis() == self.index {
            self.hand_over(message, wait, slot);
        } else {
            delivered.outbound = self.post(message, wait, slot);
        }
        delivered
    }

    /// Puts a message into the queue of a task of this chassis.
    fn hand_over(&self, mut message: Message, wait: WaitFor, slot: Option<ReplySlot>) {
        let tell = |slot: Option<ReplySlot>, answer: Answer| {
            if let Some(slot) = slot {
                slot.answer(answer);
            }
        };
        let Some(task) = self.task(message.header().to) else {
            return tell(slot, Err(Fault::UnknownTask));
        };
        let header = &mut message.envelope.header;
        header.flags = header.flags.with(wait.flags()).with(Flags::OWNED);
        match wait {
            WaitFor::Reply => {
                message.envelope.reply = slot;
                task.mailbox.put(message, Acceptance::Silent);
            }
            WaitFor::Acceptance => task.mailbox.put(message, Acceptance::from(slot)),
            WaitFor::Nothing => tell(
                slot,
                match task.mailbox.offer(message) {
                    Offered::Taken => Ok(Data::NOTHING),
                    Offered::NoRoom(_) => Err(task.mailbox.full()),
                    Offered::Closed(_) => Err(Fault::Stopping),
                },
            ),
        }
    }

    /// Sends from outside of all tasks; the returned future ends with what `wait` names, or with a fault.
    pub(crate) fn dispatch(self: &Arc<Self>, message: Message, wait: WaitFor) -> Waiting {
        let promise = Arc::new(Promise::default());
        let slot = ReplySlot::outside(promise.clone());
        let delivered = self.deliver(message, wait, Some(slot));
        Waiting::for_call(promise, self, delivered.outbound)
    }

    /// Sends a message of the runtime without waiting for anything. It is lost only with its
    /// receiver.
    pub(crate) fn post_system<C: Command>(self: &Arc<Self>, to: crate::message::Tid, request: C) {
        let from = system::agent_tid(self.index);
        let message = Message::request(to, from, C::CODE, request).flagged(Flags::HIGH_PRIORITY);
        self.deliver(message, WaitFor::Acceptance, None);
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
