//! The one delivery call: a task of this chassis gets a value, a task of another one gets a frame over the
//! link. The sender waits the same way for both.

use std::{sync::Arc, time::Duration};

use super::{Chassis, Outbound};
use crate::{
    call::{Answer, Fault, Promise, ReplyKey, ReplySlot, Waiting},
    context::Note,
    exchange::CallKey,
    mailbox::{Acceptance, Offered},
    message::{Command, Data, Flags, Letter, Message, Tid},
    processor::Processor,
    record::Asked,
    system,
    watch::TaskMeter,
};

/// What the sender of a message waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WaitFor {
    /// The reply.
    Reply,
    /// That the receiver's queue has taken the message.
    Acceptance,
}

/// What became of a call.
pub(crate) enum Called {
    /// It has been answered.
    Answered(Box<Letter>),
    /// It waits at its processor; with the way to take it back when it went over a link.
    Waits(CallKey, Option<Outbound>),
}

/// What became of a call of a task of the same processor.
pub(crate) enum CalledBeside {
    /// It has been answered.
    Answered(Box<Letter>),
    /// The task has begun with it, and the call waits at the processor.
    Begun(CallKey, Asked),
    /// Nothing: it is to be made in the usual way.
    Unmade(Message),
}

/// What became of a one-way message.
pub(crate) enum Sent {
    /// The receiver's queue has taken it, or never will.
    Ended(Result<(), Fault>),
    /// It waits for room.
    Waits(Question),
}

/// A send that waits at its processor; with the way to take it back when it went over a link.
pub(crate) struct Question {
    pub(crate) key: CallKey,
    pub(crate) outbound: Option<Outbound>,
    /// The message's number in the record.
    pub(crate) recorded: u64,
    pub(crate) asked: Asked,
}

impl Question {
    fn new(key: CallKey, asked: Asked) -> Self {
        Self {
            key,
            outbound: None,
            recorded: 0,
            asked,
        }
    }
}

/// What came of offering a message.
enum Offer {
    Done(Offered),
    /// No task has the id.
    Nobody(Message),
}

impl Chassis {
    /// [`Self::call`] where a note would be spared, of a task of `processor` that has its turn at once, and while
    /// nobody looks on. It is what most calls are, so that it is all that they need and no more.
    #[inline(always)]
    pub(crate) fn call_beside(
        &self,
        processor: &Processor,
        mut message: Message,
        limit: Duration,
        meter: &TaskMeter,
    ) -> CalledBeside {
        let letter = &mut *message.letter;
        let to = letter.header.to;
        let is_usual =
            letter.header.from.is_beside(to) && !self.tap.is_on() && self.directory.is_as_begun();
        let queue = if is_usual {
            processor.queue(to.slot())
        } else {
            None
        };
        let turn = queue
            .as_ref()
            .and_then(|queue| Some((queue, queue.turn_at_once(processor)?)));
        let Some((queue, turn)) = turn else {
            return CalledBeside::Unmade(message);
        };
        if letter.trace == 0 {
            letter.trace = processor.fresh_trace(|count| self.fresh_traces(count));
        }
        let asked = Asked::of(&message);
        let ticket = processor.begin_untimed(limit);
        let key = ticket.key();
        finish(
            &mut message,
            Flags::REPLY_WAIT,
            0,
            Some(ReplySlot::call(ticket)),
        );
        if let Some(message) = queue.hand_over(processor, turn, message, meter) {
            self.offered(to, Offer::Done(queue.offer(processor, message)));
        }
        match processor.take_answered(key) {
            Some(letter) => CalledBeside::Answered(letter),
            None => CalledBeside::Begun(key, asked),
        }
    }

    /// Asks for a reply within `limit`; the call waits at `processor`, and its end is found there, with
    /// what `note` makes of it and of the message's number in the record. It may have ended already: then
    /// `meter`, its caller's, has stood still meanwhile, and a note that is `spared` is not made.
    #[inline]
    pub(crate) fn call(
        self: &Arc<Self>,
        processor: &Processor,
        mut message: Message,
        limit: Duration,
        meter: &TaskMeter,
        spared: bool,
        note: impl FnOnce(Asked, u64) -> Note,
    ) -> Called {
        let asked = self.address(Some(processor), &mut message);
        let to = message.header().to;
        let here = to.chassis() == self.index;
        let seen = self.tap.is_on();
        let beside = here && self.is_on(to, processor) && !(seen && self.tap.replay().is_some());
        // What stays on the processor is told when the caller gives up once that is known there, and who looks
        // on is told at once.
        let (mut now, mut seen_at) = (None, None);
        if seen || !beside {
            seen_at = if seen { processor.look_within() } else { None };
            let moment = seen_at.unwrap_or_else(|| processor.now());
            message.letter.deadline = Some(moment + limit);
            now = Some(moment);
        }
        let ticket = processor.begin_untimed(limit);
        let key = ticket.key();
        let slot = ReplySlot::call(ticket);
        if let Some(replay) = self.tap.replay() {
            processor.note_call(key, false, || note(asked, 0));
            replay.dispatch(&message, WaitFor::Reply, self.clock.now(), slot);
            processor.time_call(key);
            return Called::Waits(key, None);
        }
        let recorded = self.tap.sent(&message, Some(WaitFor::Reply), seen_at);
        if !here {
            processor.note_call(key, false, || note(asked, recorded));
            let outbound = self.post(message, WaitFor::Reply, Some(slot), now);
            processor.time_call(key);
            processor.leave();
            return Called::Waits(key, outbound);
        }
        finish(&mut message, Flags::REPLY_WAIT, recorded, Some(slot));
        let offer = if beside {
            match processor.queue(to.slot()) {
                Some(queue) => Offer::Done(queue.offer_call(processor, message, meter)),
                None => Offer::Nobody(message),
            }
        } else {
            self.offer(processor, to, message)
        };
        match offer {
            Offer::Done(Offered::Taken) if beside && spared => {
                if let Some(letter) = processor.take_answered(key) {
                    if seen {
                        let at = processor.seen_at();
                        self.tap
                            .answered_at_once(recorded, &asked, at, Ok(&letter.data));
                    }
                    return Called::Answered(letter);
                }
            }
            offer => self.offered(to, offer),
        }
        // Answers of other threads are taken in after the present turn.
        processor.note_call(key, beside && spared && !seen, || note(asked, recorded));
        processor.time_call(key);
        processor.leave();
        Called::Waits(key, None)
    }

    /// What comes of an offer to task `to` of this chassis, whose sender waits for the answer.
    fn offered(&self, to: Tid, offer: Offer) {
        match offer {
            Offer::Done(Offered::Taken) => {}
            Offer::Done(Offered::NoRoom(message)) => match self.task(to) {
                Some(task) => task.mailbox.line_up(message, Acceptance::Silent),
                None => message.refuse(Fault::UnknownTask),
            },
            Offer::Done(Offered::Closed(message)) => message.refuse(Fault::Stopping),
            Offer::Nobody(message) => message.refuse(Fault::UnknownTask),
        }
    }

    /// Sends a message that needs no reply, and waits for room at `processor`, at most for `limit`, if
    /// there is none.
    pub(crate) fn send(
        self: &Arc<Self>,
        processor: &Processor,
        mut message: Message,
        limit: Duration,
    ) -> Sent {
        let asked = self.address(Some(processor), &mut message);
        let to = message.header().to;
        let here = to.chassis() == self.index;
        let seen = self.tap.is_on();
        let (mut now, mut seen_at) = (None, None);
        if !here || seen {
            seen_at = if seen { processor.look_within() } else { None };
            // What follows is the task's.
            processor.leave();
            let moment = seen_at.unwrap_or_else(|| processor.now());
            message.letter.deadline = Some(moment + limit);
            now = Some(moment);
        }
        let wait = || {
            let ticket = processor.begin_call(limit);
            let question = Question::new(ticket.key(), asked);
            (question, ReplySlot::call(ticket))
        };
        if let Some(replay) = self.tap.replay() {
            let (question, slot) = wait();
            replay.dispatch(&message, WaitFor::Acceptance, self.clock.now(), slot);
            return Sent::Waits(question);
        }
        let recorded = self.tap.sent(&message, Some(WaitFor::Acceptance), seen_at);
        if !here {
            let (mut question, slot) = wait();
            question.recorded = recorded;
            question.outbound = self.post(message, WaitFor::Acceptance, Some(slot), now);
            return Sent::Waits(question);
        }
        finish(&mut message, Flags::ACCEPT_WAIT, recorded, None);
        let result = match self.offer(processor, to, message) {
            Offer::Done(Offered::Taken) => Ok(()),
            Offer::Done(Offered::Closed(_)) => Err(Fault::Stopping),
            Offer::Nobody(_) => Err(Fault::UnknownTask),
            Offer::Done(Offered::NoRoom(message)) => {
                if let Some(task) = self.task(to) {
                    let (mut question, slot) = wait();
                    question.recorded = recorded;
                    task.mailbox.line_up(message, Acceptance::Told(slot));
                    return Sent::Waits(question);
                }
                Err(Fault::UnknownTask)
            }
        };
        match &result {
            Ok(()) => {
                let nothing = Data::Bytes(Vec::new());
                self.tap
                    .answered_at_once(recorded, &asked, seen_at, Ok(&nothing));
            }
            Err(fault) => self
                .tap
                .answered_at_once(recorded, &asked, seen_at, Err(fault)),
        }
        Sent::Ended(result)
    }

    /// Sends only if the receiver is on this chassis and has room now.
    pub(crate) fn try_send(
        &self,
        processor: &Processor,
        mut message: Message,
    ) -> Result<(), Fault> {
        let asked = self.address(Some(processor), &mut message);
        let to = message.header().to;
        if to.chassis() != self.index {
            let chassis = self.name_of(to.chassis()).to_owned();
            return Err(Fault::Elsewhere { chassis });
        }
        if let Some(replay) = self.tap.replay() {
            return replay.try_dispatch(&message, self.clock.now());
        }
        let seen_at = if self.tap.is_on() {
            processor.look_within()
        } else {
            None
        };
        processor.leave();
        let recorded = self.tap.sent(&message, None, seen_at);
        finish(&mut message, Flags::NONE, recorded, None);
        let put = match self.offer(processor, to, message) {
            Offer::Done(Offered::Taken) => Ok(()),
            Offer::Done(Offered::Closed(_)) => Err(Fault::Stopping),
            Offer::Done(Offered::NoRoom(_)) => Err(self
                .task(to)
                .map_or(Fault::UnknownTask, |task| task.mailbox.full())),
            Offer::Nobody(_) => Err(Fault::UnknownTask),
        };
        if let Err(fault) = &put {
            self.tap
                .answered_at_once(recorded, &asked, seen_at, Err(fault));
        }
        put
    }

    /// Sends from outside of all tasks; the returned future ends with what `wait` names, or with a fault.
    pub(crate) fn dispatch(self: &Arc<Self>, mut message: Message, wait: WaitFor) -> Waiting {
        self.address(None, &mut message);
        let promise = Arc::new(Promise::default());
        let slot = ReplySlot::local(promise.clone());
        if let Some(replay) = self.tap.replay() {
            replay.dispatch(&message, wait, self.clock.now(), slot);
            return Waiting::here(promise);
        }
        let recorded = self.tap.sent(&message, Some(wait), None);
        if message.header().to.chassis() != self.index {
            let outbound = self.post(message, wait, Some(slot), None);
            return Waiting::for_call(promise, self, outbound);
        }
        let Some(task) = self.task(message.header().to) else {
            slot.answer(Err(Fault::UnknownTask));
            return Waiting::here(promise);
        };
        let (flags, reply, acceptance) = match wait {
            WaitFor::Reply => (Flags::REPLY_WAIT, Some(slot), Acceptance::Silent),
            WaitFor::Acceptance => (Flags::ACCEPT_WAIT, None, Acceptance::Told(slot)),
        };
        finish(&mut message, flags, recorded, reply);
        task.mailbox.put(message, acceptance);
        Waiting::here(promise)
    }

    /// Sends a message of the runtime without waiting for anything. It is lost only with its
    /// receiver.
    pub(crate) fn post_system<C: Command>(self: &Arc<Self>, to: Tid, request: C) {
        let from = system::agent_tid(self.index);
        let message = Message::request(to, from, C::CODE, request);
        let mut message = message.flagged(Flags::HIGH_PRIORITY);
        self.address(None, &mut message);
        let to = message.header().to;
        if let Some(replay) = self.tap.replay() {
            let slot = ReplySlot::local(Arc::default());
            let now = self.clock.now();
            return replay.dispatch(&message, WaitFor::Acceptance, now, slot);
        }
        let recorded = self.tap.sent(&message, Some(WaitFor::Acceptance), None);
        if to.chassis() != self.index {
            self.post(message, WaitFor::Acceptance, None, None);
        } else if let Some(task) = self.task(to) {
            finish(&mut message, Flags::ACCEPT_WAIT, recorded, None);
            task.mailbox.put(message, Acceptance::Silent);
        }
    }

    /// Turns `message` to where the receiver is now, and begins a trace if it belongs to none.
    #[inline]
    fn address(&self, processor: Option<&Processor>, message: &mut Message) -> Asked {
        let letter = &mut *message.letter;
        if letter.trace == 0 {
            letter.trace = match processor {
                Some(processor) => processor.fresh_trace(|count| self.fresh_traces(count)),
                None => self.fresh_trace(),
            };
        }
        // A fence goes to the old place itself.
        if letter.header.command != system::Fence::CODE {
            letter.header.to = self.directory.current(letter.header.to);
        }
        Asked::of(message)
    }

    /// Whether task `to` of this chassis runs on `processor`.
    #[inline]
    pub(crate) fn is_on(&self, to: Tid, processor: &Processor) -> bool {
        self.processors
            .get(usize::from(to.processor()))
            .is_some_and(|(_, handle)| Arc::ptr_eq(handle, &processor.handle))
    }

    /// Offers a message of a task of `processor` to task `to` of this chassis.
    #[inline]
    fn offer(&self, processor: &Processor, to: Tid, message: Message) -> Offer {
        if self.is_on(to, processor) {
            return match processor.queue(to.slot()) {
                Some(queue) => Offer::Done(queue.offer(processor, message)),
                None => Offer::Nobody(message),
            };
        }
        match processor.route(to, || self.task(to)) {
            Some(task) => Offer::Done(task.mailbox.offer_from_afar(message)),
            None => Offer::Nobody(message),
        }
    }

    /// Answers in place of whoever has the right to; nothing comes of it when that was done already.
    pub(crate) fn answer_by_key(&self, key: ReplyKey, answer: Answer) {
        match key {
            ReplyKey::Remote(request) => self.post_reply(&request, answer),
            ReplyKey::Outside(promise) => promise.fulfil(answer),
            ReplyKey::Local(processor, call) => {
                let Some((_, handle)) = self.processors.get(usize::from(processor)) else {
                    return;
                };
                match Processor::here_if(handle) {
                    Some(here) => here.take_answer_by_key(call, answer.into()),
                    None => handle.bring_answer_by_key(call, answer.into()),
                }
            }
        }
    }
}

/// Makes a message ready for a task of the same chassis. This is the one place that every message from
/// a task to another one of its chassis passes on its way out.
#[inline]
fn finish(message: &mut Message, flags: Flags, recorded: u64, reply: Option<ReplySlot>) {
    let letter = &mut *message.letter;
    letter.header.flags = letter.header.flags.with(flags).with(Flags::OWNED);
    letter.recorded = recorded;
    letter.set_reply(reply);
}
