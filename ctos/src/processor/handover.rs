//! Calls between tasks of one processor without a detour: where nothing else is to be done, an idle task
//! that is called has its turn at once, within that of its caller, who then finds the answer without having
//! waited.
//!
//! The receiver would have been the next to have its turn, so the order of messages is the same as without.
//! The same is done for a child that was woken by another task, where that asks for it and the child would have had
//! the next turn.
//!
//! What is different is when the rest of the caller's turn comes: after the receiver's. So that nobody
//! else waits longer for that, it is done only while the code of tasks is brief, for a few calls of a turn, and not
//! where synchronous functions have their deadlines. Never in virtual time. While something is recorded the caller
//! has looked at the clock when it called, and the receiver's handler begins at that moment.

use std::{cell::Cell, sync::atomic::Ordering, time::Duration};

use super::{FutureId, Processor, futures::Running};
use crate::{time::Instant, watch::TaskMeter};

/// So many turns are given within one turn at most. Then everything else is looked at.
const MOST: u32 = 64;

/// None of them is made once the turn is known to have lasted for so long.
const LONGEST: Duration = Duration::from_micros(16);

/// So many receivers have their turns within one another.
const DEEPEST: u32 = 4;

/// Counts turns within turns.
#[derive(Default)]
pub(super) struct Handovers {
    /// Those in the present turn.
    made: Cell<u32>,
    /// How long the present turn may have lasted.
    until: Cell<Instant>,
    /// Counts the futures that were cancelled, of all turns.
    cancels: Cell<u32>,
    /// Those that have not ended.
    depth: Cell<u32>,
    /// Whether the future that has the present turn was cancelled by whom it called.
    cancelled: Cell<bool>,
    /// Whether turns are taken to be brief.
    always: Cell<bool>,
}

impl Handovers {
    /// A turn begins that is in no other one.
    #[inline]
    pub(super) fn begin_anew(&self, now: Instant) {
        self.made.set(0);
        self.until.set(now + LONGEST);
        self.depth.set(0);
        self.cancelled.set(false);
    }

    /// A future is cancelled.
    #[inline]
    pub(super) fn count_cancel(&self) {
        self.cancels.set(self.cancels.get().wrapping_add(1));
    }

    /// Whether the future that has the present turn is to learn nothing more: whom it called has cancelled
    /// it, and it is dropped at the end of the turn.
    #[inline]
    pub(super) fn is_cancelled(&self) -> bool {
        self.cancelled.get()
    }
}

/// The turn that a future may have at once: it is out of its entry, so that it must have it.
#[must_use]
pub(crate) struct Turn(Box<Running>);

impl Processor {
    /// The turn that an idle future may have within the present one, if it need not have it in the usual way.
    #[inline]
    pub(crate) fn turn_at_once(&self, of: FutureId) -> Option<Turn> {
        if !self.may_hand_over() {
            return None;
        }
        self.take_idle(of).map(Turn)
    }

    /// Lets a future that has just got a message have its turn within the present one, which is its
    /// caller's, whose `meter` stands still meanwhile.
    #[inline]
    pub(crate) fn hand_over(&self, turn: Turn, meter: &TaskMeter) {
        self.turn_within(turn.0, meter);
    }

    /// The same for a future that was woken, if its turn would be the next one.
    pub(crate) fn hand_over_next(&self, to: FutureId, meter: &TaskMeter) -> bool {
        if !self.may_hand_over() {
            return false;
        }
        let Some(running) = self.take_next(to) else {
            return false;
        };
        self.turn_within(running, meter);
        true
    }

    /// A turn within the present one.
    #[inline(always)]
    fn turn_within(&self, running: Box<Running>, meter: &TaskMeter) {
        let Handovers {
            made,
            depth,
            cancels,
            cancelled,
            ..
        } = &self.handovers;
        made.set(made.get() + 1);
        let outer = depth.get();
        depth.set(outer + 1);
        // Here a part of the caller's turn ends.
        self.start_calls();
        let was_cancelled = cancelled.replace(false);
        let cancels_before = cancels.get();
        let handling = self.handling.replace(0);
        meter.out_of_turn(|| self.poll_running(running));
        self.handling.set(handling);
        let is_there = |(id, _)| self.futures.borrow_mut().entry(id).is_some();
        let caller_is_there =
            || cancels.get() == cancels_before || self.current.get().is_some_and(is_there);
        cancelled.set(was_cancelled || !caller_is_there());
        depth.set(outer);
        self.leave();
    }

    /// Whether nothing else is to be done before the turn of whoever is called now.
    #[inline]
    fn may_hand_over(&self) -> bool {
        let Handovers {
            made, depth, until, ..
        } = &self.handovers;
        self.turns_are_brief()
            && made.get() < MOST
            && self.recent.get() <= until.get()
            && depth.get() < DEEPEST
            && self.schedule.is_idle()
            && !self.handle.inbox.is_filled()
            && !self.handle.stop.load(Ordering::Relaxed)
            && self.current.get().is_some()
    }

    /// Whether the turns of tasks were brief of late. Never in virtual time.
    #[inline]
    pub(crate) fn turns_are_brief(&self) -> bool {
        self.stopwatch.is_brief() || self.handovers.always.get()
    }

    /// From now on turns are taken to be brief, whatever the clock says: for tests.
    pub(crate) fn take_turns_to_be_brief(&self) {
        self.handovers.always.set(true);
    }
}

#[cfg(test)]
mod tests;
