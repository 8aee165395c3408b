//! The calls that the tasks of a processor wait for, and the answers that its handlers owe.

use std::{cell::Cell, sync::Arc, task::Context as PollContext, time::Duration};

use super::{Processor, Timed};
use crate::{
    call::ReplySlot,
    context::Note,
    exchange::{Brought, CallKey, Given, Looked, SOON, Started, Ticket},
    message::Letter,
    time::Instant,
};

impl Processor {
    /// A poll has ended: the time of the calls that were made in it runs from now, or from the next look at
    /// the clock, which is near.
    #[inline(always)]
    pub(super) fn start_calls(&self) {
        if !self.is_exact() && (self.fresh.get() || self.stopwatch.skips()) {
            self.fresh.set(true);
            return;
        }
        self.start_calls_at_once();
    }

    fn start_calls_at_once(&self) {
        self.start_begun(self.moment());
    }

    /// The time of the calls that were made since the last look at the clock runs from `now`.
    #[inline]
    pub(super) fn start_begun(&self, now: Instant) {
        let mut begun = self.begun.borrow_mut();
        if begun.is_empty() {
            return;
        }
        for key in begun.drain(..) {
            self.start_call(key, now);
        }
    }

    /// The time of a call runs from `now`, unless it does so already.
    #[inline]
    fn start_call(&self, key: CallKey, now: Instant) {
        let started = self.calls.borrow_mut().start(key, now);
        match started {
            Started::Done => {}
            Started::List(slot) => {
                let mut young = self.young.borrow_mut();
                if young.is_empty() {
                    self.young_until.set(now + SOON / 2);
                }
                young.push(slot);
            }
            Started::Urgent => {
                let call = self.calls.borrow_mut().settle_call(key);
                self.set_timer(call);
            }
        }
    }

    pub(super) fn set_timer(&self, call: Option<(CallKey, Instant)>) {
        if let Some((key, at)) = call {
            let timer = self.timers.borrow_mut().insert(at, Timed::Call(key));
            self.calls.borrow_mut().set_timer(key, timer);
        }
    }

    /// Looks after the calls that still wait: sets their timers and shows them to whoever wants to know
    /// what their tasks wait for. Done when there is time for it, because most calls end before.
    pub(crate) fn settle_calls(&self) {
        let mut young = self.young.borrow_mut();
        for slot in young.drain(..) {
            let call = self.calls.borrow_mut().settle(slot);
            self.set_timer(call);
        }
        self.young_until.set(Instant::LAST);
    }

    /// Begins a call that a future of this processor makes; its time runs from the end of the
    /// present poll.
    #[inline]
    pub(crate) fn begin_call(&self, limit: Duration) -> Ticket {
        let ticket = self.begin_untimed(limit);
        self.time_call(ticket.key());
        ticket
    }

    /// [`Self::begin_call`] without its time, which begins with [`Self::time_call`] if the call has not
    /// ended by then.
    #[inline]
    pub(crate) fn begin_untimed(&self, limit: Duration) -> Ticket {
        self.calls.borrow_mut().begin(&self.handle, limit)
    }

    /// The time of a call runs from the end of the present poll.
    #[inline]
    pub(crate) fn time_call(&self, key: CallKey) {
        self.begun.borrow_mut().push(key);
    }

    /// The answer to a call that has just been made and of which nothing is known but that, if it came in the
    /// same turn and is data. The call is over then.
    #[inline]
    pub(crate) fn take_answered(&self, key: CallKey) -> Option<Box<Letter>> {
        if self.handovers.is_cancelled() {
            return None;
        }
        self.calls.borrow_mut().take_answered(key)
    }

    /// Notes who asked whom for what in a call; what is `spared` only if the answer is not there yet.
    #[inline(always)]
    pub(crate) fn note_call(&self, key: CallKey, spared: bool, note: impl FnOnce() -> Note) {
        self.calls.borrow_mut().set_note(key, spared, note);
    }

    /// Whether `name` is known to be that of the task in `slot`, now at the latest. A slot is never used
    /// again, so that its task is the same as long as the processor lives.
    #[inline]
    pub(crate) fn knows_name(&self, slot: u16, name: &Arc<str>) -> bool {
        let names = self.names.borrow();
        match names.get(usize::from(slot)) {
            Some(Some(known)) => Arc::ptr_eq(known, name) || known == name,
            _ => {
                drop(names);
                self.learn_name(slot, name);
                true
            }
        }
    }

    #[cold]
    fn learn_name(&self, slot: u16, name: &Arc<str>) {
        let mut names = self.names.borrow_mut();
        let slot = usize::from(slot);
        if names.len() <= slot {
            names.resize_with(slot + 1, || None);
        }
        if let Some(place) = names.get_mut(slot) {
            *place = Some(name.clone());
        }
    }

    /// The name that [`Self::knows_name`] was told of.
    pub(crate) fn known_name(&self, slot: u16) -> Option<Arc<str>> {
        self.names.borrow().get(usize::from(slot))?.clone()
    }

    /// Looks for the answer to a call; with it comes the `note` of the call.
    #[inline]
    pub(crate) fn poll_call(
        &self,
        key: CallKey,
        note: &mut Option<Note>,
        cx: &PollContext<'_>,
    ) -> Looked {
        if self.handovers.is_cancelled() {
            return Looked::Waiting;
        }
        let (looked, before) = {
            let mut calls = self.calls.borrow_mut();
            let mut timers = self.timers.borrow_mut();
            calls.look(key, note, &mut timers, || self.waits(cx))
        };
        drop(before);
        looked
    }

    /// Nobody waits for the answer to a call any more.
    pub(crate) fn give_up_call(&self, key: CallKey) {
        let mut rest = self.calls.borrow_mut().give_up(key);
        if let Some(timer) = rest.timer.take() {
            self.timers.borrow_mut().remove(timer);
        }
        drop(rest);
    }

    /// Takes the answer to a call of this processor.
    #[inline]
    pub(crate) fn take_answer(&self, ticket: Ticket, answer: Brought) {
        let key = ticket.key();
        let given = self.calls.borrow_mut().answer(key, Some(ticket), answer);
        self.settle(given);
    }

    /// [`Self::take_answer`] from somebody who no longer has the ticket.
    pub(crate) fn take_answer_by_key(&self, key: CallKey, answer: Brought) {
        let given = self.calls.borrow_mut().answer(key, None, answer);
        self.settle(given);
    }

    #[inline]
    fn settle(&self, given: Given) {
        if let Given::Taken(Some(wake)) = given {
            self.wake_local(wake);
        }
    }

    /// When the caller of a call of this processor gives up.
    pub(crate) fn call_deadline(&self, key: CallKey) -> Option<Instant> {
        // If its time does not run yet, it does so from here.
        self.start_call(key, self.now());
        self.calls.borrow_mut().deadline(key)
    }

    /// A number for a message that is about to be handled.
    #[inline]
    pub(crate) fn next_serial(&self) -> u64 {
        let serial = self.next_serial.get();
        self.next_serial.set(serial + 1);
        serial
    }

    /// Runs code of the handler of message `serial`: the right to answer it, dropped in there, is kept
    /// until it is known how the handler ended.
    #[inline]
    pub(crate) fn handling<T>(&self, serial: u64, code: impl FnOnce() -> T) -> T {
        struct Restore<'a>(&'a Cell<u64>, u64);
        impl Drop for Restore<'_> {
            fn drop(&mut self) {
                self.0.set(self.1);
            }
        }
        let _restore = Restore(&self.handling, self.handling.replace(serial));
        code()
    }

    /// Keeps a right to answer that the handler at work has dropped, or gives it back.
    pub(crate) fn keep_orphan(&self, slot: ReplySlot) -> Result<(), ReplySlot> {
        if slot.serial() == 0 || slot.serial() != self.handling.get() {
            return Err(slot);
        }
        self.orphans.borrow_mut().push(slot);
        Ok(())
    }

    /// The right to answer message `serial`, if its handler dropped it.
    #[inline]
    pub(crate) fn take_orphan(&self, serial: u64) -> Option<ReplySlot> {
        let mut orphans = self.orphans.borrow_mut();
        let place = orphans.iter().position(|slot| slot.serial() == serial)?;
        Some(orphans.swap_remove(place))
    }
}
