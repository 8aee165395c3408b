//! Markings and firing sequences in words, and the places that tell most about them.

use ctos::diagnostic::Finding;
use pnt_language::net::Role;

use crate::{
    analysis::{
        model::{Model, TransitionNumber},
        play::{Lack, Wanted, lacks},
    },
    compose::{Phase, Stands, System, SystemPlace},
};

/// Words about a system and its model.
#[derive(Clone, Copy)]
pub(super) struct Words<'a> {
    pub(super) system: &'a System,
    pub(super) model: &'a Model,
}

impl Words<'_> {
    /// When a sequence has been fired.
    pub(super) fn after(&self, path: &[TransitionNumber]) -> String {
        match path {
            [] => "from the start".to_owned(),
            path => format!("after {}", self.steps(path)),
        }
    }

    /// A whole sequence, so that it can be played.
    pub(super) fn steps(&self, path: &[TransitionNumber]) -> String {
        let names: Vec<&str> = path
            .iter()
            .filter_map(|number| self.model.transitions.get(*number as usize))
            .map(|transition| transition.name.as_str())
            .collect();
        names.join(", ")
    }

    /// The place that tells most about a marking: marked, not at rest, and written by a person.
    fn telling(&self, marking: &[u32]) -> Option<&SystemPlace> {
        let importance = |place: &SystemPlace| match place.stands {
            Stands::Place(id) => {
                let net = self.system.nets().get(place.net);
                let declared = net.is_some_and(|net| net[id].role == Role::Declared);
                if declared { 0 } else { 2 }
            }
            Stands::OnTape(_) | Stands::Firing(_) | Stands::OnTheWay(_) => 1,
            Stands::InProgress(_) => 3,
            Stands::Idle | Stands::Filled(_) | Stands::Holds(_) | Stands::Word(_) => 4,
        };
        self.system
            .places()
            .iter()
            .zip(marking)
            .filter(|(place, tokens)| **tokens > place.tokens && !place.stands.is_count())
            .map(|(place, _)| place)
            .min_by_key(|place| importance(place))
    }

    /// Points to what tells most about a marking that is dead or has no way back.
    pub(super) fn at_marking(&self, finding: Finding, marking: &[u32], dead: bool) -> Finding {
        if let Some(place) = self.telling(marking) {
            let label = match (dead, self.asks_functions()) {
                (true, false) => "this is marked then, and nothing takes it on",
                (true, true) => "this is marked then, and nothing is sure to take it on",
                (false, _) => "this is marked then",
            };
            return finding.at(place.at.clone()).label(label);
        }
        match self.nearly(marking) {
            Some((place, label)) => finding.at(place.at.clone()).label(label),
            None => finding,
        }
    }

    pub(super) fn asks_functions(&self) -> bool {
        self.system.steps().iter().any(|step| step.when.is_some())
    }

    /// Of the transitions that may not fire at a marking, what one with the fewest reasons waits for.
    fn nearly(&self, marking: &[u32]) -> Option<(&SystemPlace, String)> {
        let begins = (0..).zip(self.system.steps()).filter(|(_, step)| {
            step.transition.is_some() && matches!(step.phase, Phase::Fire | Phase::Start)
        });
        let of = |(number, step)| {
            let lacks = lacks(self.model, number, marking);
            let mut shown = lacks.iter().filter(|lack| self.shown(lack));
            Some((lacks.len(), *shown.next()?, step))
        };
        let (_, lack, step) = begins.filter_map(of).min_by_key(|(count, ..)| *count)?;
        let place = self.system.places().get(lack.place as usize)?;
        let net = self.system.nets().get(step.net)?;
        let transition = net[step.transition?].written();
        let label = match lack.wanted {
            Wanted::AtLeast(needs) => format!(
                "this holds {} then, and `{transition}` needs {needs}",
                lack.holds
            ),
            Wanted::Below(below) => format!(
                "this holds {} then, and `{transition}` waits until it holds fewer than {below}",
                lack.holds
            ),
        };
        Some((place, label))
    }

    /// Whether a place is one that its author knows.
    fn shown(&self, lack: &Lack) -> bool {
        let place = self.system.places().get(lack.place as usize);
        place.is_some_and(|place| matches!(place.stands, Stands::Place(_)))
    }
}
