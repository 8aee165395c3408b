//! The calls that the tasks of a processor wait for.

use std::{task::Context as PollContext, time::Duration};

use super::{
    core::{Processor, Timed},
    handle::{Item, ProcessorHandle},
};
use crate::{
    exchange::Looked,
    reply::{CallKey, Home, Returned, Ticket},
    timers::TimerKey,
    wait::Wait,
};
use ctos_time::Instant;

/// After this time a call that still waits has a timer, and is shown; earlier where the processor has nothing to do.
const SETTLE_AFTER: Duration = Duration::from_millis(1);

impl Processor {
    /// Begins a call that a future of this processor makes at `now`.
    pub(crate) fn begin_call(&self, now: Instant, deadline: Duration) -> Ticket {
        let mut calls = self.calls.borrow_mut();
        calls.begin(|| self.handle.clone(), now, deadline)
    }

    /// A call of at most `deadline` had no answer in the poll that made it; `wait` is shown if it takes a while.
    pub(crate) fn await_call(&self, key: CallKey, deadline: Duration, wait: Wait) {
        self.calls.borrow_mut().wait(key, wait);
        let mut unsettled = self.unsettled.borrow_mut();
        if unsettled.is_empty() || deadline < SETTLE_AFTER {
            let settle_at = self.recent() + deadline.min(SETTLE_AFTER);
            self.settle_at.set(settle_at.min(self.settle_at.get()));
        }
        unsettled.push(key);
    }

    /// Sets timers for the unsettled calls that still wait, and shows what they wait for. Most have ended by then and
    /// never need either.
    pub fn settle_calls(&self) {
        let mut unsettled = self.unsettled.borrow_mut();
        let mut calls = self.calls.borrow_mut();
        for key in unsettled.drain(..) {
            if let Some(look_at) = calls.settle(key) {
                let timer = self.timers.borrow_mut().insert(look_at, Timed::Call(key));
                calls.set_timer(key, timer);
            }
        }
        self.settle_at.set(Instant::LAST);
    }

    /// Looks for the answer to a call.
    pub(crate) fn poll_call(&self, key: CallKey, cx: &PollContext<'_>) -> Looked {
        // Dropped when nothing is borrowed: a waker may hold code of others.
        let mut before = None;
        let mut calls = self.calls.borrow_mut();
        calls.look(
            key,
            || self.waits(cx),
            &mut before,
            |timer| self.unset(timer),
        )
    }

    /// The caller of a call and others wait for one another.
    pub(crate) fn note_circle(&self, key: CallKey, circle: String) {
        self.calls.borrow_mut().note_circle(key, circle);
    }

    /// Nobody waits for the answer to a call any more.
    pub(crate) fn give_up_call(&self, key: CallKey) {
        let mut calls = self.calls.borrow_mut();
        let left = calls.give_up(key, |timer| self.unset(timer));
        drop(calls);
        drop(left);
    }

    /// Takes out the timer of a call.
    fn unset(&self, timer: TimerKey) {
        self.timers.borrow_mut().remove(timer);
    }

    /// Takes the answer to a call of this processor.
    pub(crate) fn take_answer(&self, key: CallKey, answer: Returned) {
        let given = self.calls.borrow_mut().answer(key, answer);
        if let Ok(Some(wake)) = given {
            self.wake_local(wake);
        }
    }
}

impl Home for ProcessorHandle {
    fn take_answer(&self, key: CallKey, answer: Returned) {
        match Processor::here_if(self) {
            Some(processor) => processor.take_answer(key, answer),
            None => self.send(Item::Answer(key, answer)),
        }
    }
}
