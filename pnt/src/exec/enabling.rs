//! The marking and, kept up with it, the set of transitions that are enabled.

use super::wiring::Wiring;
use crate::{
    net::{Arc, Net, PlaceId, TransitionId},
    ready::ReadySet,
};

#[derive(Debug, Clone)]
pub(super) struct Enabling {
    /// Tokens per place.
    pub(super) marking: Vec<u32>,
    /// Conditions that each transition still lacks.
    lacking: Vec<u32>,
    /// Ranks of the transitions that lack nothing.
    pub(super) ready: ReadySet,
}

impl Enabling {
    /// The initial marking, with an empty tape.
    pub(super) fn new(net: &Net, wiring: &Wiring) -> Self {
        let marking = net.places().iter().map(|place| place.tokens).collect();
        Self::at(net, wiring, marking)
    }

    /// A marking with as many places as the net has, with an empty tape.
    pub(super) fn at(net: &Net, wiring: &Wiring, marking: Vec<u32>) -> Self {
        let mut ready = ReadySet::new(net.transitions().len());
        let mut lacking = Vec::with_capacity(net.transitions().len());
        for (transition, rank) in net.transitions().iter().zip(&wiring.ranks) {
            let holds = |arc: &&Arc| marking[arc.place.index()] >= arc.weight;
            let needed = transition.inputs.iter().chain(&transition.reads);
            let count = needed.filter(|arc| !holds(arc)).count()
                + transition.inhibitors.iter().filter(holds).count()
                + usize::from(transition.tape.is_some());
            lacking.push(u32::try_from(count).unwrap_or(u32::MAX));
            if count == 0 {
                ready.insert(*rank);
            }
        }
        Self {
            marking,
            lacking,
            ready,
        }
    }

    pub(super) fn is_enabled(&self, id: TransitionId) -> bool {
        self.lacking.get(id.index()) == Some(&0)
    }

    /// The first place that cannot hold what the arcs would put.
    pub(super) fn without_room(&self, arcs: &[Arc]) -> Option<PlaceId> {
        let full = |arc: &&Arc| {
            self.marking[arc.place.index()]
                .checked_add(arc.weight)
                .is_none()
        };
        arcs.iter().find(full).map(|arc| arc.place)
    }

    pub(super) fn take(&mut self, wiring: &Wiring, arcs: &[Arc]) {
        for arc in arcs {
            let before = self.marking[arc.place.index()];
            self.change(wiring, arc.place, before, before.saturating_sub(arc.weight));
        }
    }

    pub(super) fn put(&mut self, wiring: &Wiring, arcs: &[Arc]) {
        for arc in arcs {
            let before = self.marking[arc.place.index()];
            self.change(wiring, arc.place, before, before.saturating_add(arc.weight));
        }
    }

    /// Changes the tokens of a place and what the transitions around it lack.
    fn change(&mut self, wiring: &Wiring, place: PlaceId, before: u32, after: u32) {
        self.marking[place.index()] = after;
        for watch in &wiring.around[place.index()] {
            let held = before >= watch.weight;
            let holds = after >= watch.weight;
            if held != holds {
                self.condition(wiring, watch.transition, holds == watch.wanted);
            }
        }
    }

    /// One condition of a transition has changed.
    pub(super) fn condition(&mut self, wiring: &Wiring, id: TransitionId, met: bool) {
        let rank = wiring.ranks[id.index()];
        let lacking = &mut self.lacking[id.index()];
        if met {
            *lacking = lacking.saturating_sub(1);
            if *lacking == 0 {
                self.ready.insert(rank);
            }
        } else {
            if *lacking == 0 {
                self.ready.remove(rank);
            }
            *lacking += 1;
        }
    }
}
