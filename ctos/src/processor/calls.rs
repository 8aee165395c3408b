//! The calls that the tasks of a processor wait for, and the answers that its handlers owe.

use std::{cell::Cell, task::Context as PollContext, time::Duration};

use super::{Processor, Timed};
use crate::{
    call::{Answer, ReplySlot},
    exchange::{CallKey, Given, Looked, Rest, Ticket},
    time::Instant,
    waits::Wait,
};

/// After this time a call that still waits has a timer, and is shown; earlier where the processor has nothing to do.
const YOUNG: Duration = Duration::from_millis(1);

impl Processor {
    /// Begins a call that a future of this processor makes at `now`; `wait` is shown if it takes a while.
    pub(crate) fn begin_call(
        &self,
        now: Instant,
        deadline: Duration,
        wait: Option<Wait>,
    ) -> Ticket {
        let mut calls = self.calls.borrow_mut();
        let ticket = calls.begin(&self.handle, now, deadline, wait);
        let mut young = self.young.borrow_mut();
        if young.is_empty() || deadline < YOUNG {
            let settle_at = now + deadline.min(YOUNG);
            self.settle_at.set(settle_at.min(self.settle_at.get()));
        }
        young.push(ticket.key());
        ticket
    }

    /// Sets timers for the young calls that still wait, and shows what they wait for. Most have ended by then and
    /// never need either.
    pub(crate) fn settle_calls(&self) {
        let mut young = self.young.borrow_mut();
        let mut calls = self.calls.borrow_mut();
        for key in young.drain(..) {
            if let Some(look_at) = calls.settle(key) {
                let timer = self.timers.borrow_mut().insert(look_at, Timed::Call(key));
                calls.set_timer(key, timer);
            }
        }
        self.settle_at.set(Instant::LAST);
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
