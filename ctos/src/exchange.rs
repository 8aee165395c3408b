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
    message::{Letter, Tid},
    processor::{LocalWake, Processor, ProcessorHandle},
    time::Instant,
    timers::{TimerKey, Timers},
};

/// One slot, as those who answer see it.
struct Shared {
    home: Arc<ProcessorHandle>,
    /// The number of the home on its chassis: here as well, because it is noted of each call that is handled.
    processor: u8,
    slot: u32,
    /// The last generation whose caller went without its answer; [`NOBODY`] before there is one. Calls
    /// that end well leave it alone, so that those who answer them keep the cache line.
    gone: AtomicU64,
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
    #[inline(never)]
    pub(crate) fn answer(self, answer: Brought) {
        match Processor::here_if(&self.shared.home) {
            Some(processor) => processor.take_answer(self, answer),
            None => match Processor::here() {
                Some(here) => here.bring_answer(self, answer),
                None => {
                    let home = self.shared.home.clone();
                    home.bring_answer(self, answer);
                }
            },
        }
    }

    /// Whether the caller waits no longer.
    #[inline]
    pub(crate) fn is_abandoned(&self) -> bool {
        self.generation <= self.shared.gone.load(Ordering::Acquire)
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

    /// The number of that on its chassis.
    pub(crate) fn processor(&self) -> u8 {
        self.shared.processor
    }
}

/// An answer on its way to its caller: small, because it is passed on often.
pub(crate) enum Brought {
    /// The data, in a letter that nobody waits for.
    Data(Box<Letter>),
    Fault(Box<Fault>),
}

impl From<Answer> for Brought {
    fn from(answer: Answer) -> Self {
        match answer {
            Ok(data) => {
                let mut letter = Letter::blank();
                letter.data = data;
                Self::Data(letter)
            }
            Err(fault) => Self::Fault(Box::new(fault)),
        }
    }
}

impl From<Brought> for Answer {
    fn from(brought: Brought) -> Self {
        match brought {
            Brought::Data(letter) => Ok(letter.open().0),
            Brought::Fault(fault) => Err(*fault),
        }
    }
}

/// Names one call among all that one processor has ever waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CallKey {
    slot: u32,
    generation: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Free,
    Waiting,
    Answered,
    /// The deadline has passed.
    Late,
}

struct Slot {
    shared: Arc<Shared>,
    generation: u64,
    state: State,
    /// Who is woken, while it waits.
    wake: Option<LocalWake>,
    /// There from when it comes until it is taken.
    answer: Option<Brought>,
    /// Whether the ticket of the last call has come home. Then its next one needs no new owner.
    ticket: Option<Ticket>,
    limit: Duration,
    /// Since when it waits, once that is known.
    since: Option<Instant>,
    /// Whether it is among those that are looked after when there is time.
    listed: bool,
    timer: Option<TimerKey>,
    note: Option<Note>,
    /// Its caller is told that it has waited long.
    long: Long,
}

impl Slot {
    /// The right to answer the call that has just begun, when that to answer the last one is not there: whoever
    /// may have it learns that the call is over.
    #[cold]
    fn another_ticket(&self) -> Ticket {
        let before = self.generation - 1;
        self.shared.gone.store(before, Ordering::Release);
        Ticket {
            shared: self.shared.clone(),
            generation: self.generation,
        }
    }
}

/// A call with less time than this has its timer from the beginning. Most of the others end before
/// anybody looks after them, and never need one.
pub(crate) const SOON: Duration = Duration::from_millis(2);

/// What is to be done for a call whose clock has started.
pub(crate) enum Started {
    /// Nothing.
    Done,
    /// Its slot is to be looked after within half of [`SOON`].
    List(u32),
    /// It is to be looked after now.
    Urgent,
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
    /// Nothing yet from this task, for so long that it may be for ever. Told once.
    Long(Tid),
    /// The answer; the call is over.
    Ended(Brought),
    /// None within this time; the call is over.
    Late(Duration),
}

/// What must be dropped or undone where no cell is borrowed: it may run code of others.
#[must_use]
#[derive(Default)]
pub(crate) struct Rest {
    pub(crate) timer: Option<TimerKey>,
    _wake: Option<LocalWake>,
    _answer: Option<Brought>,
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
        _answer: Brought,
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
        let index = self.free.pop().unwrap_or_else(|| self.add_slot(home));
        // The index was free or has just been made.
        #[allow(clippy::indexing_slicing, reason = "see above")]
        let slot = &mut self.slots[index as usize];
        slot.generation += 1;
        slot.state = State::Waiting;
        slot.limit = limit;
        slot.since = None;
        slot.long = Long::NotYet;
        match slot.ticket.take() {
            Some(mut ticket) => {
                ticket.generation = slot.generation;
                ticket
            }
            None => slot.another_ticket(),
        }
    }

    /// One more slot, which is free.
    #[cold]
    fn add_slot(&mut self, home: &Arc<ProcessorHandle>) -> u32 {
        let index = self.slots.len() as u32;
        self.slots.push(Slot {
            shared: Arc::new(Shared {
                home: home.clone(),
                processor: home.index(),
                slot: index,
                gone: AtomicU64::new(NOBODY),
            }),
            generation: NOBODY,
            state: State::Free,
            wake: None,
            answer: None,
            ticket: None,
            limit: Duration::ZERO,
            since: None,
            listed: false,
            timer: None,
            note: None,
            long: Long::NotYet,
        });
        index
    }

    #[inline]
    fn slot(&mut self, key: CallKey) -> Option<&mut Slot> {
        let slot = self.slots.get_mut(key.slot as usize)?;
        let is_it = slot.generation == key.generation && slot.state != State::Free;
        is_it.then_some(slot)
    }

    /// The clock of a call starts.
    #[inline]
    pub(crate) fn start(&mut self, key: CallKey, now: Instant) -> Started {
        let Some(slot) = self.slot(key) else {
            return Started::Done;
        };
        if slot.since.is_some() || slot.state != State::Waiting {
            return Started::Done;
        }
        slot.since = Some(now);
        if slot.limit < SOON {
            return Started::Urgent;
        }
        if std::mem::replace(&mut slot.listed, true) {
            Started::Done
        } else {
            Started::List(key.slot)
        }
    }

    /// Looks after the call in a slot that was listed: shows it to whoever wants to know what its task
    /// waits for. If it still waits and has no timer, it needs one for this moment.
    pub(crate) fn settle(&mut self, slot: u32) -> Option<(CallKey, Instant)> {
        let place = self.slots.get_mut(slot as usize)?;
        place.listed = false;
        let key = CallKey {
            slot,
            generation: place.generation,
        };
        self.settle_call(key)
    }

    /// [`Self::settle`] for one call.
    pub(crate) fn settle_call(&mut self, key: CallKey) -> Option<(CallKey, Instant)> {
        let slot = self.slot(key)?;
        let (State::Waiting, Some(since)) = (slot.state, slot.since) else {
            return None;
        };
        if let Some(note) = &mut slot.note {
            note.show(since);
        }
        let at = since + slot.limit.min(circle::LONG);
        slot.timer.is_none().then_some((key, at))
    }

    /// Notes who asked whom for what; one that is `spared` only if the answer is not there yet. The note is
    /// written where it stays: what is moved right after it was written in small pieces is waited for.
    #[inline(always)]
    pub(crate) fn set_note(&mut self, key: CallKey, spared: bool, note: impl FnOnce() -> Note) {
        if let Some(slot) = self.slot(key)
            && slot.note.is_none()
            // All that it has come to is told without a note.
            && !(spared && matches!(slot.answer, Some(Brought::Data(_))))
        {
            slot.note = Some(note());
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
    pub(crate) fn answer(
        &mut self,
        key: CallKey,
        ticket: Option<Ticket>,
        answer: Brought,
    ) -> Given {
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
        if !matches!(slot.state, State::Waiting | State::Late) {
            return Given::Unwanted {
                _ticket: spare,
                _answer: answer,
            };
        }
        slot.state = State::Answered;
        slot.answer = Some(answer);
        Given::Taken(slot.wake.take())
    }

    /// [`Self::answer`] to a call that nobody has looked at, with a letter that brings its ticket: then nobody is
    /// woken, and nothing is dropped.
    ///
    /// # Errors
    /// The letter, when it is to be given in the usual way, or is not for a call of `home`, whose calls these are.
    #[inline]
    pub(crate) fn answer_unseen(
        &mut self,
        home: &Arc<ProcessorHandle>,
        mut letter: Box<Letter>,
    ) -> Result<(), Box<Letter>> {
        let Some(ticket) = letter.ticket() else {
            return Err(letter);
        };
        let slot = self.slots.get_mut(ticket.shared.slot as usize);
        let is_unseen = |slot: &&mut Slot| {
            slot.generation == ticket.generation
                && Arc::ptr_eq(ticket.home(), home)
                && slot.state == State::Waiting
                && slot.wake.is_none()
                && slot.ticket.is_none()
                && slot.answer.is_none()
        };
        let Some(slot) = slot.filter(is_unseen) else {
            return Err(letter);
        };
        let ticket = letter.take_ticket();
        // There is nothing to drop where these come, as was just seen.
        std::mem::forget(std::mem::replace(&mut slot.ticket, ticket));
        slot.state = State::Answered;
        let answer = Some(Brought::Data(letter));
        std::mem::forget(std::mem::replace(&mut slot.answer, answer));
        Ok(())
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
        if slot.state != State::Waiting {
            return fired;
        }
        fired.wake = slot.wake.take();
        slot.timer = None;
        if slot.long == Long::NotYet && slot.limit > circle::LONG {
            slot.long = Long::ToBeTold;
            fired.again = slot.since.map(|since| since + slot.limit);
        } else {
            slot.shared.gone.store(slot.generation, Ordering::Release);
            slot.state = State::Late;
        }
        fired
    }

    /// Looks for the answer; with it comes the `note` of the call. While there is none, what `waits` makes
    /// is woken when there is; what was to be woken before is given back, to be dropped where no cell is
    /// borrowed.
    #[inline]
    pub(crate) fn look<T>(
        &mut self,
        key: CallKey,
        note: &mut Option<Note>,
        timers: &mut Timers<T>,
        waits: impl FnOnce() -> LocalWake,
    ) -> (Looked, Option<LocalWake>) {
        let Some(slot) = self.slot(key) else {
            // A future looks at its own call only until that is over.
            let nothing = Err(Fault::NoReply).into();
            return (Looked::Ended(nothing), None);
        };
        if slot.state == State::Waiting {
            let before = slot.wake.replace(waits());
            if slot.long == Long::ToBeTold {
                slot.long = Long::Told;
                let to = slot.note.as_ref().map_or(Tid::default(), Note::to);
                return (Looked::Long(to), before);
            }
            return (Looked::Waiting, before);
        }
        if let Some(timer) = slot.timer.take() {
            timers.remove(timer);
        }
        let limit = slot.limit;
        *note = slot.note.take();
        slot.state = State::Free;
        let looked = match slot.answer.take() {
            Some(answer) => Looked::Ended(answer),
            None => Looked::Late(limit),
        };
        self.free.push(key.slot);
        (looked, None)
    }

    /// The answer to a call that nobody has looked at, nor noted anything of: if it is data, the call is over.
    #[inline]
    pub(crate) fn take_answered(&mut self, key: CallKey) -> Option<Box<Letter>> {
        let slot = self.slots.get_mut(key.slot as usize)?;
        let is_bare = slot.timer.is_none() && slot.note.is_none();
        if slot.generation != key.generation || !is_bare {
            return None;
        }
        match slot.answer.take() {
            Some(Brought::Data(letter)) => {
                slot.state = State::Free;
                self.free.push(key.slot);
                Some(letter)
            }
            other => {
                slot.answer = other;
                None
            }
        }
    }

    /// Nobody waits for the answer any more.
    pub(crate) fn give_up(&mut self, key: CallKey) -> Rest {
        let mut rest = Rest::default();
        let Some(slot) = self.slot(key) else {
            return rest;
        };
        slot.shared.gone.store(slot.generation, Ordering::Release);
        rest.timer = slot.timer.take();
        rest._note = slot.note.take();
        rest._answer = slot.answer.take();
        rest._wake = slot.wake.take();
        slot.state = State::Free;
        self.free.push(key.slot);
        rest
    }
}

#[cfg(test)]
mod tests;
