//! The execution itself: a marking, a tape, and firings from their start to their end.

use std::sync::Arc;

use super::{
    enabling::Enabling,
    error::FireError,
    events::{End, Entry, EventLog, Kind},
    running::{AllRunning, FiringId, Running},
    tape::Tape,
    wiring::{self, Changes, Wiring},
};
use crate::net::{CommandId, Net, RemoteArc, TransitionId};

/// What a transition wrote to the output tape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Written {
    /// The answer to the command in progress.
    Answer {
        /// Which command, as numbered by [`Execution::put_symbol`].
        command: u64,
        /// The output symbol.
        symbol: String,
    },
    /// A symbol that answers no command in progress; a checked net never does this.
    Unasked {
        /// The output symbol.
        symbol: String,
    },
}

/// What the caller must do after a firing.
#[derive(Debug, Default, PartialEq)]
pub struct Effects<'a> {
    /// Tokens to carry to other nets.
    pub remote: &'a [RemoteArc],
    /// What was written to the output tape.
    pub written: Option<Written>,
}

/// A net, its marking and its tape.
#[derive(Debug, Clone)]
pub struct Execution {
    pub(super) net: Arc<Net>,
    pub(super) wiring: Arc<Wiring>,
    pub(super) enabling: Enabling,
    pub(super) tape: Tape,
    pub(super) tape_room: usize,
    pub(super) running: AllRunning,
    pub(super) firings: u64,
    pub(super) log: Option<Box<EventLog>>,
    /// Number of the next event, while none are recorded.
    pub(super) events: u64,
    pub(super) now_ns: u64,
}

impl Execution {
    /// A net at its initial marking. Its tape has no limit, and it records no events.
    #[must_use]
    pub fn new(net: Arc<Net>) -> Self {
        let wiring = Arc::new(Wiring::new(&net));
        Self {
            enabling: Enabling::new(&net, &wiring),
            tape: Tape::default(),
            tape_room: usize::MAX,
            running: AllRunning::default(),
            firings: 0,
            log: None,
            events: 0,
            now_ns: 0,
            wiring,
            net,
        }
    }

    /// Lets at most `room` commands wait on the tape.
    pub fn limit_tape(&mut self, room: usize) {
        self.tape_room = room;
    }

    /// The net.
    #[must_use]
    pub fn net(&self) -> &Arc<Net> {
        &self.net
    }

    /// Tokens of every place, in order of place number.
    #[must_use]
    pub fn marking(&self) -> &[u32] {
        self.enabling.marking()
    }

    /// The input tape.
    #[must_use]
    pub fn tape(&self) -> &Tape {
        &self.tape
    }

    /// Firings between start and end, oldest first.
    pub fn running(&self) -> impl Iterator<Item = (FiringId, TransitionId)> {
        self.running
            .iter()
            .map(|running| (running.firing, running.transition))
    }

    /// Transitions whose tokens and tape symbol are there, in the order in which they would be
    /// chosen, timed ones last. Their enabling functions are not asked.
    pub fn enabled(&self) -> impl Iterator<Item = TransitionId> {
        let mut from = 0;
        std::iter::from_fn(move || {
            let rank = self.enabling.ready.next(from)?;
            from = rank + 1;
            self.wiring.at_rank.get(rank).copied()
        })
    }

    /// Whether a transition's tokens and tape symbol are there; its enabling function is not asked.
    #[must_use]
    pub fn is_enabled(&self, id: TransitionId) -> bool {
        let fire = self.wiring.fires.get(id.index());
        fire.is_some_and(|fire| self.enabling.is_enabled(*fire))
    }

    #[cold]
    pub(super) fn not_enabled(&self, id: TransitionId) -> FireError {
        let name = self.net.transitions().get(id.index());
        let name = name.map_or_else(|| format!("number {}", id.index()), |t| t.name.clone());
        FireError::NotEnabled(name)
    }

    // -- firing -----------------------------------------------------------------------------

    /// Fires a transition that has no action, in one step.
    ///
    /// # Errors
    /// It is not enabled, has an action, or would overflow a place.
    #[inline]
    pub fn fire(&mut self, id: TransitionId) -> Result<Effects<'_>, FireError> {
        let Some(fire) = self.wiring.fires.get(id.index()).copied() else {
            return Err(self.not_enabled(id));
        };
        if !self.enabling.is_enabled(fire) {
            return Err(self.not_enabled(id));
        }
        if !fire.plain {
            return self.fire_with_more(id, fire.changes);
        }
        self.require_room(fire.changes)?;
        self.enabling.apply(&self.wiring, fire.changes);
        if let Some(log) = &mut self.log {
            log.push(self.now_ns, Entry::new(Kind::Fired, id.0, 0));
        }
        Ok(Effects::default())
    }

    /// The same with resets, tape and tokens for other nets.
    fn fire_with_more(
        &mut self,
        id: TransitionId,
        changes: Changes,
    ) -> Result<Effects<'_>, FireError> {
        if self.net[id].action.is_some() {
            return Err(FireError::HasAction(self.net[id].name.clone()));
        }
        self.require_room(changes)?;
        let emptied = self.empty(id, true);
        self.enabling.apply(&self.wiring, changes);
        let read = self.read(id);
        let written = self.write(id);
        self.log(|| Entry {
            tape: read,
            answers: answered(written.as_ref()),
            emptied: emptied.filter(|emptied| !emptied.is_empty()),
            ..Entry::new(Kind::Fired, id.0, 0)
        });
        Ok(Effects {
            remote: &self.net[id].outputs.remote,
            written,
        })
    }

    /// Takes the tokens and the tape symbol of a transition; its action may begin. Its time limit
    /// begins to run.
    ///
    /// # Errors
    /// It is not enabled.
    pub fn start(&mut self, id: TransitionId) -> Result<FiringId, FireError> {
        if !self.is_enabled(id) {
            return Err(self.not_enabled(id));
        }
        let Some(phases) = self.wiring.phases.get(id.index()).copied() else {
            return Err(self.not_enabled(id));
        };
        self.enabling.apply(&self.wiring, phases.start);
        let emptied = self.empty(id, false);
        let command = self.read(id);
        let firing = FiringId(self.firings);
        self.firings += 1;
        let deadline_ns = phases
            .within_ns
            .map(|within_ns| self.now_ns.saturating_add(within_ns));
        self.running.push(firing, id, command, deadline_ns);
        self.log(|| Entry {
            tape: command,
            emptied: emptied.filter(|emptied| !emptied.is_empty()),
            ..Entry::new(Kind::Started, id.0, firing.0)
        });
        Ok(firing)
    }

    /// Puts the tokens of a firing whose action is complete.
    ///
    /// # Errors
    /// No such firing is going on, or a place would overflow; then the firing still goes on.
    pub fn complete(&mut self, firing: FiringId) -> Result<Effects<'_>, FireError> {
        let (running, phases) = self.phases(firing)?;
        self.require_room(phases.complete)?;
        self.running.remove(firing);
        self.enabling.apply(&self.wiring, phases.complete);
        let id = running.transition;
        let written = self.write(id);
        self.log(|| Entry {
            answers: answered(written.as_ref()),
            ..Entry::new(Kind::Ended(End::Completed), id.0, firing.0)
        });
        Ok(Effects {
            remote: &self.net[id].outputs.remote,
            written,
        })
    }

    /// Ends a firing whose action has failed: its failure branch, or else everything goes back.
    ///
    /// # Errors
    /// No such firing is going on, or a place would overflow; then the firing still goes on.
    pub fn fail(&mut self, firing: FiringId) -> Result<Effects<'_>, FireError> {
        self.end(firing, End::Failed)
    }

    /// Ends a firing as if it had never started. What it took goes back, whatever its failure branch
    /// says; only what a reset arc has emptied stays empty. The caller ends the action.
    ///
    /// # Errors
    /// No such firing is going on, or a place would overflow; then the firing still goes on.
    pub fn cancel(&mut self, firing: FiringId) -> Result<(), FireError> {
        self.end(firing, End::Cancelled).map(|_| ())
    }

    fn end(&mut self, firing: FiringId, end: End) -> Result<Effects<'_>, FireError> {
        let (running, phases) = self.phases(firing)?;
        let id = running.transition;
        let branch = end != End::Cancelled && self.net[id].fail.is_some();
        let changes = if branch { phases.fail } else { phases.cancel };
        self.require_room(changes)?;
        self.running.remove(firing);
        self.enabling.apply(&self.wiring, changes);
        let back = running.command.filter(|_| !branch);
        let unread = back.filter(|command| self.with_tape(|tape| tape.unread(*command)));
        self.log(|| Entry {
            tape: unread,
            ..Entry::new(Kind::Ended(end), id.0, firing.0)
        });
        let branch = self.net[id].fail.as_ref().filter(|_| branch);
        Ok(Effects {
            remote: branch.map_or(&[], |branch| &branch.remote),
            written: None,
        })
    }

    // -- time limits ------------------------------------------------------------------------

    /// Says what time it is, in ns since a beginning of the caller's choice. Time does not go back: an
    /// earlier time is passed over.
    pub fn advance_to(&mut self, now_ns: u64) {
        self.now_ns = self.now_ns.max(now_ns);
    }

    /// The time that the execution was last told, in ns.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// When the next time limit of a running action is over, in ns, and whose it is.
    pub fn next_deadline(&mut self) -> Option<(u64, FiringId)> {
        self.running.next_limit()
    }

    /// Ends the firing whose time limit was over first, if one is: as failed. The caller ends the
    /// action and asks again until there is none.
    ///
    /// # Errors
    /// A place would overflow; then the firing still goes on.
    pub fn expire(&mut self) -> Result<Option<(FiringId, TransitionId, Effects<'_>)>, FireError> {
        let Some((deadline_ns, firing)) = self.running.next_limit() else {
            return Ok(None);
        };
        if deadline_ns > self.now_ns {
            return Ok(None);
        }
        let id = self.phases(firing)?.0.transition;
        let effects = self.end(firing, End::TimedOut)?;
        Ok(Some((firing, id, effects)))
    }

    #[inline]
    pub(super) fn log(&mut self, entry: impl FnOnce() -> Entry) {
        if let Some(log) = &mut self.log {
            log.push(self.now_ns, entry());
        }
    }

    // -- parts ------------------------------------------------------------------------------

    pub(super) fn phases(&self, firing: FiringId) -> Result<(Running, wiring::Phases), FireError> {
        let running = self.running.get(firing);
        running
            .and_then(|running| {
                let phases = self.wiring.phases.get(running.transition.index())?;
                Some((*running, *phases))
            })
            .ok_or(FireError::NotRunning(firing.0))
    }

    #[inline]
    pub(super) fn require_room(&self, changes: Changes) -> Result<(), FireError> {
        match self.enabling.without_room(&self.wiring, changes) {
            Some(place) => Err(FireError::TooManyTokens(self.net[place].name.clone())),
            None => Ok(()),
        }
    }

    /// Empties the places that a transition's reset arcs name, once its inputs are taken. With `at_once`
    /// the transition fires in one step, and what it puts there is added too. Returns what was thrown
    /// away, if events are recorded.
    fn empty(&mut self, id: TransitionId, at_once: bool) -> Option<Box<[crate::net::Arc]>> {
        let phases = self.wiring.phases.get(id.index())?;
        if self.wiring.resets(phases).is_empty() {
            return None;
        }
        let wiring = Arc::clone(&self.wiring);
        let resets = wiring.resets(phases);
        let mut emptied = Vec::new();
        for reset in resets {
            let before = self.enabling.counter(reset.place.0);
            let (taken, put) = if at_once {
                (reset.takes, reset.completes)
            } else {
                (0, 0)
            };
            let by = put.wrapping_sub(before);
            self.enabling.add(&wiring, reset.place.0, by);
            if let Some(filled) = reset.filled {
                self.enabling.add(&wiring, filled, by);
            }
            let weight = before.saturating_sub(taken);
            if weight > 0 && self.log.is_some() {
                emptied.push(crate::net::Arc {
                    place: reset.place,
                    weight,
                });
            }
        }
        Some(emptied.into_boxed_slice())
    }

    /// Reads the command that a transition reads; returns its number on the tape.
    fn read(&mut self, id: TransitionId) -> Option<u64> {
        self.net[id].tape?;
        self.with_tape(Tape::read)
    }

    fn write(&mut self, id: TransitionId) -> Option<Written> {
        let symbol = self.net[id].write.clone()?;
        let net = Arc::clone(&self.net);
        let answers = |command: CommandId| net[command].answers.contains(&symbol);
        Some(match self.with_tape(|tape| tape.answer(answers)) {
            Some(command) => Written::Answer { command, symbol },
            None => Written::Unasked { symbol },
        })
    }

    /// Changes the tape and what the transitions that read it lack.
    pub(super) fn with_tape<T>(&mut self, change: impl FnOnce(&mut Tape) -> T) -> T {
        let before = self.tape.head();
        let result = change(&mut self.tape);
        let after = self.tape.head();
        if before != after {
            for (head, readable) in [(before, 0), (after, 1)] {
                if let Some(command) = head {
                    let counter = self.wiring.command(command.index());
                    self.enabling.set(&self.wiring, counter, readable);
                }
            }
        }
        result
    }
}

fn answered(written: Option<&Written>) -> Option<u64> {
    match written? {
        Written::Answer { command, .. } => Some(*command),
        Written::Unasked { .. } => None,
    }
}
