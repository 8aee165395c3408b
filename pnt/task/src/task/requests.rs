//! Requests of other nets (`serves`) that are under way. It knows no task.

use std::{collections::BTreeSet, task::Waker};

use pnt_language::{
    exec::Tokens,
    net::{Net, Part, PlaceId, Transition, TransitionId},
};

/// The place that a request to another net marks, and what it waits for.
fn asked(start: &Transition) -> Option<(PlaceId, String)> {
    if start.part != Part::Start {
        return None;
    }
    let name = start.written();
    let (active, to) = (start.outputs.local.first()?, start.outputs.remote.first()?);
    Some((active.place, format!("{}: {name}", to.net)))
}

/// Why something is refused.
pub(super) const BEING_STOPPED: &str = "the app is being stopped";

/// Requests of other nets (`serves`) that are not answered, and who waits for the net to be quiet.
#[derive(Default)]
pub(super) struct Requests {
    /// Where they come in.
    places: BTreeSet<PlaceId>,
    /// Transitions that answer one.
    answers: BTreeSet<TransitionId>,
    /// Requests to other nets: the place that is marked while one is under way, and what it waits for.
    asked: Vec<(PlaceId, String)>,
    pub(super) open: u32,
    pub(super) waits: Option<Waker>,
}

impl Requests {
    pub(super) fn of(net: &Net) -> Self {
        let requests = net.serves().iter().flat_map(|side| &side.requests);
        let places = requests.filter_map(|(request, _)| net.place(&format!("I_{request}")));
        let all = net.transitions().iter().zip((0..).map(TransitionId));
        let answers = all.filter(|(transition, _)| transition.part == Part::Return);
        Self {
            places: places.collect(),
            answers: answers.map(|(_, id)| id).collect(),
            asked: net.transitions().iter().filter_map(asked).collect(),
            open: 0,
            waits: None,
        }
    }

    /// Which requests to other nets are under way, in words.
    pub(super) fn pending(&self, marking: &[u32]) -> Option<String> {
        let held = |place: PlaceId| marking.get(place.index()).is_some_and(|held| *held > 0);
        let asked = self.asked.iter().filter(|(place, _)| held(*place));
        let words: Vec<&str> = asked.map(|(_, words)| words.as_str()).collect();
        (!words.is_empty()).then(|| format!("waits for {}", words.join(", ")))
    }

    /// Another net is put in place.
    pub(super) fn replaced(&mut self, net: &Net) {
        let (open, waits) = (self.open, self.waits.take());
        *self = Self {
            open,
            waits,
            ..Self::of(net)
        };
    }

    /// Tokens of another net were put.
    #[inline]
    pub(super) fn came(&mut self, put: &Tokens) {
        if !self.places.is_empty() {
            let requests = put.iter().filter(|(place, _)| self.places.contains(place));
            self.open += requests.map(|(_, tokens)| tokens).sum::<u32>();
        }
    }

    /// A transition fired in one step.
    #[inline]
    pub(super) fn fired(&mut self, id: TransitionId) {
        if self.open > 0 && self.answers.contains(&id) {
            self.open -= 1;
        }
    }

    /// Who waits for the net to be quiet looks again.
    #[inline]
    pub(super) fn look_again(&mut self) {
        if let Some(waits) = self.waits.take() {
            waits.wake();
        }
    }
}
