//! What happened in a net: the source of its stream, of its snapshots, and log lines of their own target.

use std::sync::Arc;

use ctos::time::Instant;

use super::messages::FiringEvent;
use crate::stream::{Changed, Event, EventPhase, Happened, Source, view};
use pnt_language::{
    exec::{Execution, FiringId},
    net::{Net, TransitionId},
};

/// Events of a [`Snapshot`](super::Snapshot).
const SHOWN: usize = 256;

/// What happens to a net as a whole and is shown.
const OF_THE_NET: [EventPhase; 4] = [
    EventPhase::Ordered,
    EventPhase::Paused,
    EventPhase::Resumed,
    EventPhase::Stopped,
];

/// One phase of a firing.
pub(super) struct Phase<'p> {
    pub(super) transition: TransitionId,
    pub(super) firing: Option<FiringId>,
    pub(super) phase: EventPhase,
    /// Why it failed, or what data has changed; empty otherwise.
    pub(super) text: &'p str,
    /// Declared data that has changed.
    pub(super) changed: Changed,
}

impl Phase<'_> {
    /// The line of the log; `None` where nobody reads such lines.
    pub(super) fn line(&self, net: &Arc<Net>) -> Option<impl FnOnce() + 'static> {
        tracing::enabled!(target: "pnt::firing", tracing::Level::INFO).then(|| {
            let (net, transition) = (Arc::clone(net), self.transition);
            let (phase, text) = (self.phase, self.text.to_owned());
            move || {
                let (name, one) = (net.name(), &net[transition]);
                let (transition, phase) =
                    (one.written(), phase.of_part(view::part(one.part)).word());
                if text.is_empty() {
                    tracing::info!(target: "pnt::firing", net = name, transition, phase);
                } else {
                    tracing::info!(target: "pnt::firing", net = name, transition, phase, text);
                }
            }
        })
    }
}

pub(super) struct Journal {
    pub(super) stream: Source,
    /// How many recorders there had been when the net was last put into the record as a whole.
    recorders: u64,
    /// How many events were recorded since.
    recorded: u64,
}

/// After so many recorded events the net stands in the record as a whole again, so that no reader must
/// begin at the beginning.
const WHOLE_EVERY: u64 = 4096;

impl Journal {
    pub(super) fn new(stream: Source) -> Self {
        Self {
            stream,
            recorders: 0,
            recorded: 0,
        }
    }

    /// Notes one phase of a firing.
    pub(super) fn firing(
        &mut self,
        now: Instant,
        trace: u64,
        execution: &Execution,
        phase: &Phase,
    ) {
        let (text, changed) = (phase.text.to_owned(), phase.changed.clone());
        let what = Happened::Transition(phase.transition, phase.phase, phase.firing, text, changed);
        self.stream.note(now, trace, what, execution);
    }

    /// Whether the record lacks the net as a whole, where `recorders` have come so far.
    pub(super) fn lacks_whole(&mut self, recorders: u64) -> bool {
        self.recorded += 1;
        let lacks = self.recorders != recorders || self.recorded > WHOLE_EVERY;
        if lacks {
            self.recorders = recorders;
            self.recorded = 0;
        }
        lacks
    }

    /// The latest firings and the end of the net, oldest first.
    pub(super) fn events(&self) -> Vec<FiringEvent> {
        let shown =
            |event: &Event| !event.transition.is_empty() || OF_THE_NET.contains(&event.phase);
        let short = |event: Event| FiringEvent {
            at_ns: event.at_ns,
            transition: event.transition,
            phase: event.phase.word().to_owned(),
            text: event.text,
        };
        let latest = self.stream.latest(2 * SHOWN).filter(shown).map(short);
        let mut latest: Vec<FiringEvent> = latest.collect();
        latest.drain(..latest.len().saturating_sub(SHOWN));
        latest
    }

    /// Firings ended since the start.
    pub(super) fn ended(&self) -> u64 {
        self.stream.firings()
    }
}
