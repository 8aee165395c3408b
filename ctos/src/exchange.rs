//! The calls that the tasks of one processor wait for. Each waits in a slot of the processor, which is
//! used again for the next one; whoever answers holds a [`Ticket`] to it.
//!
//! A ticket comes home with the answer, so a call allocates nothing once as many slots exist as there
//! are calls at once. Generations keep a late answer from reaching the slot's next call. This file
//! knows nothing of messages: an answer is what [`crate::call`] says it is.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use crate::{
    call::{Answer, Fault},
    circle,
    context::Note,
    processor::{LocalWake, Processor, ProcessorHandle},
    time::Instant,
    timers::{TimerKey, Timers},
};

/// One slot, as those who answer see it.
struct Shared {
    home: Arc<ProcessorHandle>,
    slot: u32,
    /// The generation of the call that waits in the slot; [`NOBODY`] when none does.
    live: AtomicU64,
}

/// No call has this generation.
const NOBODY: u64 = 0;

/// The right to answer one call, from any thread. Whoever holds one must use it: a ticket that is
/// merely dropped leaves its caller to its deadline.
pub(crate) struct Ticket {
    shared: Arc<Shared>,
    generation: u64,
}

impl Ticket {
    /// Gives the answer. When the caller waits no longer, nothing comes of it.
    #[inline]
    pub(crate) fn answer(self, answer: Answer) {
        match Processor::here_if(&self.shared.home) {
            Some(processor) => processor.take_answer(self, answer),
            None => {
                let home = self.shared.home.clone();
                home.bring_answer(self, answer);
            }
        }
    }

    /// Whether the caller waits no longer.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.shared.live.load(Ordering::Acquire) != self.generation
    }

    /// Names the call that the ticket is for.
    pub(crate) fn key(&self) -> CallKey {
        CallKey {
            slot: self.shared.slot,
            generation: self.generation,
        }
    }

    /// The processor that waits for the answer.
    pub(crate) fn home(&self) -> &Arc<ProcessorHandle> {
        &self.shared.home
    }
}

/// Names one call among all that one processor has ever waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CallKey {
    slot: u32,
    generation: u64,
}

#[derive(Default)]
enum State {
    #[default]
    Free,
    Waiting(Option<LocalWake>),
    Answered(Answer),
    /// The deadline has passed.
    Late,
}

struct Slot {
    shared: Arc<Shared>,
    generation: u64,
    state: State,
    /// Whether the ticket of the last call has come home. Then its next one needs no new owner.
    ticket: Option<Ticket>,
    limit: Duration,
    /// Since when it waits, once that is known.
    since: Option<Instant>,
    timer: Option<TimerKey>,
    note: Option<Note>,
    /// Its caller is told that it has waited long.
    long: Long,
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
    Answered(Answer, Option<Note>),
    /// None within this time; the call is over.
    Late(Duration, Option<Note>),
}

/// What must be dropped or undone where no cell is borrowed: it may run code of others.
#[must_use]
#[derive(Default)]
pub(crate) struct Rest {
    pub(crate) timer: Option<TimerKey>,
    _wake: Option<LocalWake>,
    _answer: Option<Answer>,
    _note: Option<Note>,
}

/// What came of an answer.
#[must_use]
pub(crate) enum Given {
    /// It waits for its caller, who may be woken.
    Taken(Option<LocalWake>),
    /// Nobody waits for it: to be dropped where no cell is borrowed.
    Unwanted {
        _ticket: Option<Ticket>,
        _answer: Answer,
    },
}

/// All calls of one processor.
#[derive(Default)]
pub(crate) struct Calls {
    slots: Vec<Slot>,
    free: Vec<u32>,
}

impl Calls {
    /// A new call, which may take `limit` from the moment that [`Self::arm`] is told.
    #[inline]
    pub(crate) fn begin(&mut self, home: &Arc<ProcessorHandle>, limit: Duration) -> Ticket {
        let index = self.free.pop().unwrap_or_else(|| {
            let index = self.slots.len() as u32;
            self.slots.push(Slot {
                shared: Arc::new(Shared {
                    home: home.clone(),
                    slot: index,
                    live: AtomicU64::new(NOBODY),
                }),
                generation: NOBODY,
                state: State::Free,
                ticket: None,
                limit,
                since: None,
                timer: None,
                note: None,
                long: Long::NotYet,
            });
            index
        });
        // The index was free or has just been made.
        #[allow(clippy::indexing_slicing, reason = "see above")]
        let slot = &mut self.slots[index as usize];
        slot.generation += 1;
        slot.state = State::Waiting(None);
        slot.limit = limit;
        slot.since = None;
        slot.long = Long::NotYet;
        slot.shared.live.store(slot.generation, Ordering::Release);
        let mut ticket = slot.ticket.take().unwrap_or_else(|| Ticket {
            shared: slot.shared.clone(),
            generation: NOBODY,
        });
        ticket.generation = slot.generation;
        ticket
    }

    #[inline]
    fn slot(&mut self, key: CallKey) -> Option<&mut Slot> {
        let slot = self.slots.get_mut(key.slot as usize)?;
        let is_it = slot.generation == key.generation && !matches!(slot.state, State::Free);
        is_it.then_some(slot)
    }

    /// The clock of a call starts; its moment of giving up, if it still waits and had none.
    pub(crate) fn arm(&mut self, key: CallKey, now: Instant) -> Option<Instant> {
        let slot = self.slot(key)?;
        if slot.since.is_some() || !matches!(slot.state, State::Waiting(_)) {
            return None;
        }
        slot.since = Some(now);
        Some(now + slot.limit.min(circle::LONG))
    }

    /// Notes who asked whom for what.
    pub(crate) fn set_note(&mut self, key: CallKey, note: Note) {
        if let Some(slot) = self.slot(key) {
            slot.note = Some(note);
        }
    }

    /// Shows a call that still waits to whoever wants to know what its task waits for.
    pub(crate) fn show(&mut self, key: CallKey) {
        if let Some(slot) = self.slot(key)
            && let (State::Waiting(_), Some(note), Some(since)) =
                (&slot.state, &mut slot.note, slot.since)
        {
            note.show(since);
        }
    }

    /// Notes the timer of a call.
    pub(crate) fn set_timer(&mut self, key: CallKey, timer: TimerKey) {
        if let Some(slot) = self.slot(key) {
            slot.timer = Some(timer);
        }
    }

    /// When the caller gives up.
    pub(crate) fn deadline(&mut self, key: CallKey) -> Option<Instant> {
        let slot = self.slot(key)?;
        Some(slot.since? + slot.limit)
    }

    /// Takes the answer to a call.
    #[inline]
    pub(crate) fn answer(&mut self, key: CallKey, ticket: Option<Ticket>, answer: Answer) -> Given {
        let slot = self.slots.get_mut(key.slot as usize);
        let Some(slot) = slot.filter(|slot| slot.generation == key.generation) else {
            return Given::Unwanted {
                _ticket: ticket,
                _answer: answer,
            };
        };
        let spare = match ticket {
            Some(_) if slot.ticket.is_none() => {
                slot.ticket = ticket;
                None
            }
            ticket => ticket,
        };
        if !matches!(slot.state, State::Waiting(_) | State::Late) {
            return Given::Unwanted {
                _ticket: spare,
                _answer: answer,
            };
        }
        match std::mem::replace(&mut slot.state, State::Answered(answer)) {
            State::Waiting(wake) => Given::Taken(wake),
            State::Free | State::Answered(_) | State::Late => Given::Taken(None),
        }
    }

    /// The timer of a call fires: it has waited long, or its deadline has passed, and whoever has not
    /// begun with it need not any more.
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
        if slot.long == Long::NotYet && slot.limit > circle::LONG {
            slot.long = Long::ToBeTold;
            fired.again = slot.since.map(|since| since + slot.limit);
        } else {
            slot.shared.live.store(NOBODY, Ordering::Release);
            slot.state = State::Late;
        }
        fired
    }

    /// Looks for the answer. While there is none, what `waits` makes is woken when there is; what was
    /// to be woken before is given back, to be dropped where no cell is borrowed.
    #[inline]
    pub(crate) fn look<T>(
        &mut self,
        key: CallKey,
        timers: &mut Timers<T>,
        waits: impl FnOnce() -> LocalWake,
    ) -> (Looked, Option<LocalWake>) {
        let Some(slot) = self.slot(key) else {
            // A future looks at its own call only until that is over.
            return (Looked::Answered(Err(Fault::NoReply), None), None);
        };
        if let State::Waiting(before) = &mut slot.state {
            let before = before.replace(waits());
            if slot.long == Long::ToBeTold {
                slot.long = Long::Told;
                return (Looked::Long, before);
            }
            return (Looked::Waiting, before);
        }
        if let Some(timer) = slot.timer.take() {
            timers.remove(timer);
        }
        let (limit, note) = (slot.limit, slot.note.take());
        let looked = match std::mem::take(&mut slot.state) {
            State::Answered(answer) => Looked::Answered(answer, note),
            State::Late | State::Free | State::Waiting(_) => Looked::Late(limit, note),
        };
        self.free.push(key.slot);
        (looked, None)
    }

    /// Nobody waits for the answer any more.
    pub(crate) fn give_up(&mut self, key: CallKey) -> Rest {
        let mut rest = Rest::default();
        let Some(slot) = self.slot(key) else {
            return rest;
        };
        slot.shared.live.store(NOBODY, Ordering::Release);
        rest.timer = slot.timer.take();
        rest._note = slot.note.take();
        match std::mem::take(&mut slot.state) {
            State::Answered(answer) => rest._answer = Some(answer),
            State::Waiting(wake) => rest._wake = wake,
            State::Late | State::Free => {}
        }
        self.free.push(key.slot);
        rest
    }
}
