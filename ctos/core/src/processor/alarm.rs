//! What a processor does at a moment: sleeps that end, calls that have waited long or too long.

use std::{
    future::Future,
    pin::Pin,
    rc::Rc,
    task::{Context as PollContext, Poll},
};

use super::core::{Processor, Timed};
use crate::timers::TimerKey;
use ctos_time::Instant;

impl Processor {
    /// A future that ends at `deadline`.
    pub(crate) fn sleep_until(self: &Rc<Self>, deadline: Instant) -> Sleep {
        Sleep {
            processor: self.clone(),
            deadline,
            key: None,
        }
    }

    /// The next moment at which something is due without being woken.
    pub fn next_deadline(&self) -> Option<Instant> {
        self.settle_calls();
        let timer = self.timers.borrow().first();
        timer.into_iter().chain(self.schedule.next_due()).min()
    }

    /// The moment at which a sleeping processor must be awake: for a timer, or shortly before a tick.
    pub(super) fn wake_at(&self) -> Option<Instant> {
        let timer = self.timers.borrow().first();
        timer.into_iter().chain(self.schedule.wake_at()).min()
    }

    /// Wakes the timers that are due.
    pub fn fire_timers(self: &Rc<Self>) {
        self.enter();
        let now = self.look_at_clock();
        self.settle_calls();
        self.fire_due(now);
    }

    /// Wakes the timers that are due at `now`.
    pub(super) fn fire_due(&self, now: Instant) {
        if now >= self.settle_at.get() {
            self.settle_calls();
        }
        loop {
            let Some(due) = self.timers.borrow_mut().pop_due(now) else {
                return;
            };
            match due {
                Timed::Sleep(wake) => self.wake_local(wake),
                Timed::Call(key) => {
                    let fired = self.calls.borrow_mut().fired(key);
                    if let Some(again) = fired.again {
                        let timer = self.timers.borrow_mut().insert(again, Timed::Call(key));
                        self.calls.borrow_mut().set_timer(key, timer);
                    }
                    if let Some(wake) = fired.wake {
                        self.wake_local(wake);
                    }
                }
            }
        }
    }
}

/// Ends at a moment.
pub(crate) struct Sleep {
    processor: Rc<Processor>,
    deadline: Instant,
    key: Option<TimerKey>,
}

impl Sleep {
    fn take_out(&mut self) {
        if let Some(key) = self.key.take() {
            let timer = self.processor.timers.borrow_mut().remove(key);
            // Outside the borrow: a waker may hold code of others.
            drop(timer);
        }
    }
}

impl Future for Sleep {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<()> {
        self.take_out();
        if self.processor.now() >= self.deadline {
            return Poll::Ready(());
        }
        let waits = self.processor.waits(cx);
        let deadline = self.deadline;
        let key = self
            .processor
            .timers
            .borrow_mut()
            .insert(deadline, Timed::Sleep(waits));
        self.key = Some(key);
        Poll::Pending
    }
}

impl Drop for Sleep {
    fn drop(&mut self) {
        self.take_out();
    }
}
