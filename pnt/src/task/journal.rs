//! What happened in a net, most recent last: for snapshots, and as log lines of their own target.

use std::collections::VecDeque;

use ctos::time::Instant;

use super::messages::FiringEvent;

/// Events that are kept.
const KEPT: usize = 256;

#[derive(Debug, Default)]
pub(super) struct Journal {
    events: VecDeque<FiringEvent>,
    ended: u64,
}

impl Journal {
    /// Notes one phase of a firing; returns it as it is kept.
    pub(super) fn firing(
        &mut self,
        now: Instant,
        net: &str,
        transition: &str,
        phase: &str,
        text: &str,
    ) -> &FiringEvent {
        if text.is_empty() {
            tracing::info!(target: "pnt::firing", net, transition, phase);
        } else {
            tracing::info!(target: "pnt::firing", net, transition, phase, text);
        }
        if phase != "started" {
            self.ended += 1;
        }
        self.keep(now, transition, phase, text)
    }

    /// Notes the end of the net.
    pub(super) fn stopped(&mut self, now: Instant, why: &str) {
        self.keep(now, "", "stopped", why);
    }

    /// Notes what is not a firing.
    pub(super) fn note(
        &mut self,
        now: Instant,
        transition: &str,
        phase: &str,
        text: &str,
    ) -> &FiringEvent {
        self.keep(now, transition, phase, text)
    }

    fn keep(&mut self, now: Instant, transition: &str, phase: &str, text: &str) -> &FiringEvent {
        if self.events.len() == KEPT {
            self.events.pop_front();
        }
        self.events.push_back_mut(FiringEvent {
            at_ns: now.as_nanos(),
            transition: transition.to_owned(),
            phase: phase.to_owned(),
            text: text.to_owned(),
        })
    }

    /// The kept events.
    pub(super) fn events(&self) -> Vec<FiringEvent> {
        self.events.iter().cloned().collect()
    }

    /// Firings ended since the start.
    pub(super) fn ended(&self) -> u64 {
        self.ended
    }
}
