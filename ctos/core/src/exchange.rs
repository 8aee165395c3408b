//! The calls that the tasks of one processor wait for. Each waits in a slot, which later calls use again; the
//! answering task holds a `Ticket` to it.
//!
//! Generations keep a late answer from reaching the slot's next call. It knows neither links nor queues.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use crate::{
    processor::wake::LocalWake,
    reply::{CallKey, Home, NOBODY, Returned, Shared, Ticket},
    timers::TimerKey,
    wait::Wait,
};
use ctos_message::fault::Fault;
use ctos_time::Instant;

/// After this time a call asks itself whether it can ever end.
pub(crate) const LONG: Duration = Duration::from_secs(1);

/// How far the call of a slot has come.
#[must_use]
pub(crate) enum State {
    Free,
    /// Nobody has answered; with what is woken then, once the caller has looked.
    Waiting(Option<LocalWake>),
    Answered(Returned),
    /// The deadline has passed.
    Late,
}

struct Slot {
    shared: Arc<Shared>,
    generation: u64,
    state: State,
    began: Instant,
    deadline: Duration,
    timer: Option<TimerKey>,
    /// What its task waits for, to be shown if it takes a while.
    wait: Option<Wait>,
    long: Long,
    /// The tasks that wait for one another in it.
    circle: Option<String>,
}

impl Slot {
    /// Its call is over.
    fn free(&mut self, unset: impl FnOnce(TimerKey)) -> State {
        if let Some(timer) = self.timer.take() {
            unset(timer);
        }
        self.wait = None;
        std::mem::replace(&mut self.state, State::Free)
    }

    /// Why its call ends when the deadline has passed.
    fn late(&mut self) -> Fault {
        let after = self.deadline;
        match self.circle.take() {
            Some(circle) => Fault::Circle { after, circle },
            None => Fault::Deadline { after },
        }
    }
}

/// Whether a call has waited long, as its caller knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Long {
    NotYet,
    ToBeTold,
    Told,
}

/// What comes of a timer of a call.
pub(crate) struct Fired {
    pub(crate) wake: Option<LocalWake>,
    /// When to look again.
    pub(crate) again: Option<Instant>,
}

/// What a look at a call brings.
pub(crate) enum Looked {
    /// Nothing yet.
    Waiting,
    /// Nothing yet, for so long that it may be for ever. Told once.
    Long,
    /// The answer; the call is over.
    Ended(Returned),
    /// None in time; the call is over, for this reason.
    Late(Fault),
}

/// All calls of one processor.
#[derive(Default)]
pub(crate) struct Calls {
    slots: Vec<Slot>,
    free: Vec<u32>,
}

impl Calls {
    /// A new call, which began at `now` and may last until `deadline` from then.
    pub(crate) fn begin(
        &mut self,
        home: impl FnOnce() -> Arc<dyn Home>,
        now: Instant,
        deadline: Duration,
    ) -> Ticket {
        let index = self.free.pop().unwrap_or_else(|| self.add_slot(home()));
        // The index was free or has just been made.
        #[allow(clippy::indexing_slicing, reason = "see above")]
        let slot = &mut self.slots[index as usize];
        slot.generation += 1;
        slot.state = State::Waiting(None);
        slot.began = now;
        slot.deadline = deadline;
        slot.long = Long::NotYet;
        slot.circle = None;
        Ticket {
            shared: slot.shared.clone(),
            generation: slot.generation,
        }
    }

    /// The caller of a call waits for it now.
    pub(crate) fn wait(&mut self, key: CallKey, wait: Wait) {
        if let Some(slot) = self.slot(key) {
            slot.wait = Some(wait);
        }
    }

    /// One more slot, which is free.
    fn add_slot(&mut self, home: Arc<dyn Home>) -> u32 {
        let index = self.slots.len() as u32;
        self.slots.push(Slot {
            shared: Arc::new(Shared {
                home,
                slot: index,
                gone: AtomicU64::new(NOBODY),
            }),
            generation: NOBODY,
            state: State::Free,
            began: Instant::START,
            deadline: Duration::ZERO,
            timer: None,
            wait: None,
            long: Long::NotYet,
            circle: None,
        });
        index
    }

    fn slot(&mut self, key: CallKey) -> Option<&mut Slot> {
        let slot = self.slots.get_mut(key.slot as usize)?;
        let is_it = slot.generation == key.generation && !matches!(slot.state, State::Free);
        is_it.then_some(slot)
    }

    /// A call has waited for a while: shows it, and tells when to look after it.
    pub(crate) fn settle(&mut self, key: CallKey) -> Option<Instant> {
        let slot = self.slot(key)?;
        if !matches!(slot.state, State::Waiting(_)) || slot.timer.is_some() {
            return None;
        }
        if let Some(wait) = &mut slot.wait {
            wait.show(slot.began);
        }
        Some(slot.began + slot.deadline.min(LONG))
    }

    /// Notes the timer of a call.
    pub(crate) fn set_timer(&mut self, key: CallKey, timer: TimerKey) {
        if let Some(slot) = self.slot(key) {
            slot.timer = Some(timer);
        }
    }

    /// The caller of a call and others wait for one another.
    pub(crate) fn note_circle(&mut self, key: CallKey, circle: String) {
        if let Some(slot) = self.slot(key) {
            slot.circle = Some(circle);
        }
    }

    /// Takes the answer to a call, and tells who is woken then.
    ///
    /// # Errors
    /// The answer, if nobody waits for it: to be dropped where no cell is borrowed.
    pub(crate) fn answer(
        &mut self,
        key: CallKey,
        answer: Returned,
    ) -> Result<Option<LocalWake>, Returned> {
        let waits = |slot: &&mut Slot| matches!(slot.state, State::Waiting(_) | State::Late);
        let Some(slot) = self.slot(key).filter(waits) else {
            return Err(answer);
        };
        match std::mem::replace(&mut slot.state, State::Answered(answer)) {
            State::Waiting(wake) => Ok(wake),
            _ => Ok(None),
        }
    }

    /// The timer of a call fires. The call has waited long, or its deadline has passed, and a
    /// receiver that has not begun with it need not begin any more.
    pub(crate) fn fired(&mut self, key: CallKey) -> Fired {
        let mut fired = Fired {
            wake: None,
            again: None,
        };
        let Some(slot) = self.slot(key) else {
            return fired;
        };
        let State::Waiting(wake) = &mut slot.state else {
            return fired;
        };
        fired.wake = wake.take();
        slot.timer = None;
        if slot.long == Long::NotYet && slot.deadline > LONG {
            slot.long = Long::ToBeTold;
            fired.again = Some(slot.began + slot.deadline);
        } else {
            slot.shared.gone.store(slot.generation, Ordering::Release);
            slot.state = State::Late;
        }
        fired
    }

    /// Looks for the answer. While there is none, what `waits` makes is woken when there is; what was woken before comes
    /// to `before`. The timer of a call that is over comes to `unset`.
    pub(crate) fn look(
        &mut self,
        key: CallKey,
        waits: impl FnOnce() -> LocalWake,
        before: &mut Option<LocalWake>,
        unset: impl FnOnce(TimerKey),
    ) -> Looked {
        let Some(slot) = self.slot(key) else {
            // A future looks at its own call only until that is over.
            return Looked::Ended(Err(Box::new(Fault::NoReply)));
        };
        if let State::Waiting(wake) = &mut slot.state {
            *before = wake.replace(waits());
            if slot.long == Long::ToBeTold {
                slot.long = Long::Told;
                return Looked::Long;
            }
            return Looked::Waiting;
        }
        let looked = match slot.free(unset) {
            State::Answered(answer) => Looked::Ended(answer),
            _ => Looked::Late(slot.late()),
        };
        self.free.push(key.slot);
        looked
    }

    /// Nobody waits for the answer any more. What is left of the call is to be dropped where no cell is borrowed; its
    /// timer comes to `unset`.
    pub(crate) fn give_up(&mut self, key: CallKey, unset: impl FnOnce(TimerKey)) -> Option<State> {
        let slot = self.slot(key)?;
        slot.shared.gone.store(slot.generation, Ordering::Release);
        let state = slot.free(unset);
        self.free.push(key.slot);
        Some(state)
    }
}

#[cfg(test)]
mod tests;
