//! The one delivery: a task of this chassis gets a value, a task of another one gets a frame over the link. The
//! sender waits the same way for both, and is told in the same way what came of it.

use std::{rc::Rc, sync::Arc};

use super::{Chassis, pending::Outbound};
use crate::{
    delivery::{Acceptance, Offered},
    envelope::Message,
    processor::{Inlet, Processor},
    reply::{Promise, ReplySlot, Waiting},
    system,
    tap::{Asked, WaitFor},
    task_record::TaskRecord,
};
use ctos_message::{Command, Data, Flags, Tid, fault::Fault};

/// A message that was delivered, or is on its way.
pub struct Delivered {
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

/// A task that a message goes to.
enum Receiver {
    /// One of the processor that this thread runs.
    Here(Rc<Processor>, Rc<dyn Inlet>),
    There(Arc<TaskRecord>),
}

impl Receiver {
    fn offer(&self, message: Message) -> Offered {
        match self {
            Self::Here(processor, queue) => queue.offer(processor, message),
            Self::There(task) => task.mailbox.offer(message),
        }
    }
}

#[doc(hidden)]
impl Chassis {
    /// Brings `message` to its receiver. What `slot` makes is told what `wait` names, or the fault; it is made only
    /// if that is not known at once. Every message of this chassis passes here: a recorder sees it, and a replay takes
    /// the place of the receiver.
    pub fn deliver(
        self: &Arc<Self>,
        mut message: Message,
        wait: WaitFor,
        slot: &mut dyn FnMut() -> Option<ReplySlot>,
    ) -> Delivered {
        self.address(&mut message);
        let asked = Asked::of(&message);
        let mut recorded = 0;
        if let Some(observer) = self.tap.observer() {
            if observer.replays() {
                let slot = slot().unwrap_or_else(|| ReplySlot::outside(Arc::default()));
                observer.replay(&message, wait, self.clock.now(), slot);
                return Delivered {
                    asked,
                    recorded,
                    outcome: Outcome::Waits(None),
                };
            }
            recorded = observer.sent(&message, wait);
            message.envelope.recorded = recorded;
        }
        let outcome = if asked.to.chassis() == self.index {
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
        let to = message.header().to;
        let Some(receiver) = self.receiver(to) else {
            return Outcome::Failed(Fault::UnknownTask);
        };
        let header = &mut message.envelope.header;
        header.flags = header.flags.with(wait.flags()).with(Flags::OWNED);
        if wait == WaitFor::Reply {
            message.envelope.reply = slot();
        }
        let offered = receiver.offer(message);
        let message = match offered {
            Offered::Taken if wait == WaitFor::Reply => return Outcome::Waits(None),
            Offered::Taken => return Outcome::Taken,
            Offered::Closed(message) | Offered::Full(message) => message,
        };
        let task = self.task(to).filter(|task| !task.mailbox.is_closed());
        match (task, wait) {
            (None, WaitFor::Reply) => {
                message.refuse(Fault::Stopping);
                Outcome::Waits(None)
            }
            (None, _) => Outcome::Failed(Fault::Stopping),
            (Some(task), WaitFor::Nothing) => Outcome::Failed(task.mailbox.full()),
            (Some(task), WaitFor::Reply) => {
                task.mailbox.line_up(message, Acceptance::Silent);
                Outcome::Waits(None)
            }
            (Some(task), WaitFor::Acceptance) => {
                task.mailbox.line_up(message, Acceptance::from(slot()));
                Outcome::Waits(None)
            }
        }
    }

    /// A task of this chassis. The queues of those of the processor that this thread runs are found there.
    fn receiver(&self, to: Tid) -> Option<Receiver> {
        let (_, home) = self.processors.get(usize::from(to.processor()))?;
        if let Some(here) = Processor::at_hand(home)
            && let Some(queue) = here.queue(to.slot())
        {
            return Some(Receiver::Here(here, queue));
        }
        self.task(to).map(Receiver::There)
    }

    /// Sends from outside of all tasks; the returned future ends with what `wait` names, or with a fault.
    pub fn dispatch(self: &Arc<Self>, message: Message, wait: WaitFor) -> Waiting {
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
        let waiting = Waiting::here(promise);
        match outbound {
            Some(outbound) => {
                let chassis = self.clone();
                waiting.or_else(move || chassis.abandon(outbound))
            }
            None => waiting,
        }
    }

    /// Sends a message of the runtime without waiting for anything. It is lost only with its
    /// receiver.
    pub fn post_system<C: Command>(self: &Arc<Self>, to: Tid, request: C) {
        let from = system::agent_tid(self.index);
        let message = Message::request(to, from, C::CODE, request).flagged(Flags::HIGH_PRIORITY);
        self.deliver(message, WaitFor::Acceptance, &mut || None);
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
