//! The calls that the tasks of a processor wait for, and the answers that its handlers owe.

use std::{cell::Cell, task::Context as PollContext, time::Duration};

use super::{Processor, Timed};
use crate::{
    call::{Answer, ReplySlot},
    exchange::{CallKey, Given, Looked, Rest, Ticket},
    time::Instant,
};

impl Processor {
    /// Begins a call that a future of this processor makes at `now`.
    pub(crate) fn begin_call(&self, now: Instant, deadline: Duration) -> Ticket {
        let mut calls = self.calls.borrow_mut();
        let (ticket, look_at) = calls.begin(&self.handle, now, deadline);
        let key = ticket.key();
        let timer = self.timers.borrow_mut().insert(look_at, Timed::Call(key));
        calls.set_timer(key, timer);
        ticket
    }

    /// Looks for the answer to a call.
    pub(crate) fn poll_call(&self, key: CallKey, cx: &PollContext<'_>) -> Looked {
        let (looked, rest) = self.calls.borrow_mut().look(key, || self.waits(cx));
        self.drop_rest(rest);
        looked
    }

    /// Nobody waits for the answer to a call any more.
    pub(crate) fn give_up_call(&self, key: CallKey) {
        let rest = self.calls.borrow_mut().give_up(key);
        self.drop_rest(rest);
    }

    fn drop_rest(&self, rest: Rest) {
        if let Some(timer) = rest.timer {
            self.timers.borrow_mut().remove(timer);
        }
        drop(rest);
    }

    /// Takes the answer to a call of this processor.
    pub(crate) fn take_answer(&self, key: CallKey, answer: Answer) {
        let given = self.calls.borrow_mut().answer(key, answer);
        if let Given::Taken(Some(wake)) = given {
            self.wake_local(wake);
        }
    }

    /// A number for a message that is about to be handled.
    pub(crate) fn next_serial(&self) -> u64 {
        let serial = self.next_serial.get();
        self.next_serial.set(serial + 1);
        serial
    }

    /// Runs code of the handler of message `serial`: the right to answer it, dropped in there, is kept
    /// until it is known how the handler ended.
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
    pub(crate) fn take_orphan(&self, serial: u64) -> Option<ReplySlot> {
        let mut orphans = self.orphans.borrow_mut();
        let place = orphans.iter().position(|slot| slot.serial() == serial)?;
        Some(orphans.swap_remove(place))
    }
}
