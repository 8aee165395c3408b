//! What has happened in an execution, as numbered values for code that records, stores or shows it.
//! Off until asked for; the newest ones are kept, and nothing is allocated for an event.

use std::collections::VecDeque;

use super::{execution::Execution, running::FiringId};
use crate::net::{Arc, CommandId, Net, PlaceId, RemoteArc, TransitionId};

/// One event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event<'a> {
    /// Counted from the start of the execution, without gaps.
    pub number: u64,
    /// The time that the execution was last told ([`super::Execution::advance_to`]), in ns.
    pub at_ns: u64,
    /// What happened.
    pub happened: Happened<'a>,
}

/// How a firing ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The action is complete.
    Completed,
    /// The action has failed: the failure branch, or else everything went back.
    Failed,
    /// The time limit was over: as failed.
    TimedOut,
    /// It was cancelled: everything went back.
    Cancelled,
}

/// A symbol written to the output tape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wrote<'a> {
    /// The output symbol.
    pub symbol: &'a str,
    /// The command that it answers; none in a net that was not checked.
    pub answers: Option<u64>,
}

/// What happened. Arcs name the places and say how many tokens were moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Happened<'a> {
    /// A transition without action fired in one step.
    Fired {
        /// The transition.
        transition: TransitionId,
        /// What it took.
        consumed: &'a [Arc],
        /// What was thrown away by its reset arcs.
        emptied: &'a [Arc],
        /// What it put.
        produced: &'a [Arc],
        /// Tokens for other nets.
        remote: &'a [RemoteArc],
        /// The command that it read from the tape.
        read: Option<u64>,
        /// What it wrote.
        wrote: Option<Wrote<'a>>,
    },
    /// Tokens were taken, an action begun.
    Started {
        /// Which firing.
        firing: FiringId,
        /// Of which transition.
        transition: TransitionId,
        /// What it took.
        consumed: &'a [Arc],
        /// What was thrown away by its reset arcs.
        emptied: &'a [Arc],
        /// The command that it read from the tape.
        read: Option<u64>,
    },
    /// An action ended.
    Ended {
        /// Which firing.
        firing: FiringId,
        /// Of which transition.
        transition: TransitionId,
        /// How.
        end: End,
        /// What it put, or what went back.
        produced: &'a [Arc],
        /// Tokens for other nets.
        remote: &'a [RemoteArc],
        /// What it wrote.
        wrote: Option<Wrote<'a>>,
        /// The command that went back to the tape.
        unread: Option<u64>,
    },
    /// Tokens came from outside.
    Put {
        /// To which place.
        place: PlaceId,
        /// How many.
        tokens: u32,
    },
    /// Tokens were taken by hand.
    Taken {
        /// From which place.
        place: PlaceId,
        /// How many.
        tokens: u32,
    },
    /// A command came to the input tape.
    Symbol {
        /// Its number on the tape.
        number: u64,
        /// Which command.
        command: CommandId,
    },
}

/// Which kind of event, and what the net does not say of it.
#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    Fired,
    Started,
    Ended(End),
    Put,
    Taken,
    Symbol,
}

/// An event as it is kept.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) kind: Kind,
    /// Number of the transition, the place or the command.
    pub(super) of: u32,
    /// Number of the firing or of the command on the tape; or how many tokens.
    pub(super) number: u64,
    /// The command that was read or went back.
    pub(super) tape: Option<u64>,
    /// The command that was answered.
    pub(super) answers: Option<u64>,
    pub(super) emptied: Option<Box<[Arc]>>,
}

impl Entry {
    pub(super) fn new(kind: Kind, of: u32, number: u64) -> Self {
        Self {
            kind,
            of,
            number,
            tape: None,
            answers: None,
            emptied: None,
        }
    }
}

/// The newest events.
#[derive(Debug, Clone)]
pub(super) struct EventLog {
    kept: VecDeque<(u64, Entry)>,
    room: usize,
    /// Number of the next event.
    pub(super) next: u64,
}

impl EventLog {
    pub(super) fn new(room: usize, next: u64) -> Self {
        let room = room.max(1);
        Self {
            kept: VecDeque::with_capacity(room),
            room,
            next,
        }
    }

    #[inline]
    pub(super) fn push(&mut self, at_ns: u64, entry: Entry) {
        if self.kept.len() == self.room {
            self.kept.pop_front();
        }
        self.kept.push_back((at_ns, entry));
        self.next += 1;
    }

    /// The number of the oldest event that is still kept.
    pub(super) fn oldest(&self) -> u64 {
        self.next - self.kept.len() as u64
    }

    pub(super) fn forget_before(&mut self, number: u64) {
        let many = number.min(self.next).saturating_sub(self.oldest());
        self.kept
            .drain(..usize::try_from(many).unwrap_or(0).min(self.kept.len()));
    }

    pub(super) fn since<'a>(
        &'a self,
        net: &'a Net,
        number: u64,
    ) -> impl Iterator<Item = Event<'a>> {
        let oldest = self.oldest();
        let skip = usize::try_from(number.saturating_sub(oldest)).unwrap_or(usize::MAX);
        (oldest..)
            .zip(&self.kept)
            .skip(skip)
            .map(|(number, (at_ns, entry))| Event {
                number,
                at_ns: *at_ns,
                happened: entry.happened(net),
            })
    }
}

impl Entry {
    fn happened<'a>(&'a self, net: &'a Net) -> Happened<'a> {
        let tokens = u32::try_from(self.number).unwrap_or(u32::MAX);
        let emptied = self.emptied.as_deref().unwrap_or(&[]);
        let firing = FiringId(self.number);
        let transition = TransitionId(self.of);
        let wrote = |fact: &'a crate::net::Transition| {
            fact.write.as_deref().map(|symbol| Wrote {
                symbol,
                answers: self.answers,
            })
        };
        match self.kind {
            Kind::Put => Happened::Put {
                place: PlaceId(self.of),
                tokens,
            },
            Kind::Taken => Happened::Taken {
                place: PlaceId(self.of),
                tokens,
            },
            Kind::Symbol => Happened::Symbol {
                number: self.number,
                command: CommandId(self.of),
            },
            Kind::Fired => {
                let fact = &net[transition];
                Happened::Fired {
                    transition,
                    consumed: &fact.inputs,
                    emptied,
                    produced: &fact.outputs.local,
                    remote: &fact.outputs.remote,
                    read: self.tape,
                    wrote: wrote(fact),
                }
            }
            Kind::Started => Happened::Started {
                firing,
                transition,
                consumed: &net[transition].inputs,
                emptied,
                read: self.tape,
            },
            Kind::Ended(end) => {
                let fact = &net[transition];
                let branch = match end {
                    End::Completed => Some(&fact.outputs),
                    End::Failed | End::TimedOut => fact.fail.as_ref(),
                    End::Cancelled => None,
                };
                Happened::Ended {
                    firing,
                    transition,
                    end,
                    produced: branch.map_or(&fact.inputs, |branch| &branch.local),
                    remote: branch.map_or(&[], |branch| &branch.remote),
                    wrote: wrote(fact).filter(|_| end == End::Completed),
                    unread: self.tape,
                }
            }
        }
    }
}

impl Execution {
    /// Records what happens from now on; the newest `room` events are kept. Numbers go on from before.
    pub fn record_events(&mut self, room: usize) {
        self.stop_events();
        self.log = Some(Box::new(EventLog::new(room, self.events)));
    }

    /// Records no more and forgets what was recorded.
    pub fn stop_events(&mut self) {
        if let Some(log) = self.log.take() {
            self.events = log.next;
        }
    }

    /// The recorded events from `number` on, as far as they are kept: a first one with a greater number
    /// says that some were forgotten.
    pub fn events_since(&self, number: u64) -> impl Iterator<Item = Event<'_>> {
        self.log
            .iter()
            .flat_map(move |log| log.since(&self.net, number))
    }

    /// Number that the next event will have.
    #[must_use]
    pub fn next_event(&self) -> u64 {
        self.log.as_ref().map_or(self.events, |log| log.next)
    }

    /// Forgets recorded events before `number`.
    pub fn forget_events(&mut self, number: u64) {
        if let Some(log) = &mut self.log {
            log.forget_before(number);
        }
    }
}
