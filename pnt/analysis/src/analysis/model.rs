//! A net as the analyses see it: places and transitions as numbers, every way that a firing can go a
//! transition of its own. Knows how a firing changes a marking, not which markings are reachable.

use crate::compose::{Phase, Step, System};
use pnt_language::net::Net;

/// Number of a place of a [`Model`].
pub type PlaceNumber = u32;

/// Number of a transition of a [`Model`].
pub type TransitionNumber = u32;

/// A place and a number of tokens.
pub type Weighted = (PlaceNumber, u32);

/// A place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Its name, for people.
    pub name: String,
    /// Tokens of the initial marking.
    pub tokens: u32,
    /// What it may hold; a firing that would put more is not enabled.
    pub capacity: Option<u32>,
}

/// A transition. Lists are sorted by place, each place at most once.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Transition {
    /// Its name, for people.
    pub name: String,
    /// Tokens it takes.
    pub takes: Vec<Weighted>,
    /// Tokens it needs and leaves.
    pub reads: Vec<Weighted>,
    /// Enabled only while the place holds fewer.
    pub inhibitors: Vec<Weighted>,
    /// Places that it empties, after taking and before putting.
    pub resets: Vec<PlaceNumber>,
    /// Tokens it puts.
    pub puts: Vec<Weighted>,
    /// Number of its enabling function, and whether it is negated.
    pub when: Option<(u32, bool)>,
    /// Among the enabled transitions of a group only those of the highest priority fire; none for
    /// what nobody chooses (the end of an action).
    pub priority: Option<u32>,
    /// Its group: the net that chooses.
    pub group: u32,
    /// Number of the transition, as its author sees it, that begins to fire here. Several may share
    /// one; none for the end of an action.
    pub label: Option<u32>,
}

/// A net, or several composed ones.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Model {
    /// The places.
    pub places: Vec<Place>,
    /// The transitions.
    pub transitions: Vec<Transition>,
}

/// A firing changes a place by this much: negative when it takes more than it puts.
pub type Change = (PlaceNumber, i64);

impl Transition {
    /// What must be there, taken or read.
    #[must_use]
    pub fn needs(&self) -> Vec<Weighted> {
        let mut needs = self.takes.clone();
        for (place, weight) in &self.reads {
            match needs.iter_mut().find(|(other, _)| other == place) {
                Some((_, need)) => *need = (*need).max(*weight),
                None => needs.push((*place, *weight)),
            }
        }
        needs.sort_unstable();
        needs
    }

    /// The change of every place but those it empties; no zeros.
    #[must_use]
    pub fn changes(&self) -> Vec<Change> {
        let mut changes: Vec<Change> = Vec::new();
        let taken = self.takes.iter().map(|(p, w)| (*p, -i64::from(*w)));
        let put = self.puts.iter().map(|(p, w)| (*p, i64::from(*w)));
        for (place, change) in taken.chain(put) {
            match changes.iter_mut().find(|(other, _)| *other == place) {
                Some((_, sum)) => *sum += change,
                None => changes.push((place, change)),
            }
        }
        changes.retain(|(place, change)| *change != 0 && !self.resets.contains(place));
        changes.sort_unstable();
        changes
    }

    /// What the places that it empties hold afterwards.
    #[must_use]
    pub fn after_reset(&self) -> Vec<Weighted> {
        let put = |place: &PlaceNumber| {
            let arc = self.puts.iter().find(|(other, _)| other == place);
            (*place, arc.map_or(0, |(_, weight)| *weight))
        };
        self.resets.iter().map(put).collect()
    }

    /// Enabled only while the place holds fewer: inhibitor arcs, and capacities for what it puts. A weight of
    /// zero is never met.
    #[must_use]
    pub fn forbids(&self, places: &[Place]) -> Vec<Weighted> {
        let mut forbids = self.inhibitors.clone();
        let mut room = |place: PlaceNumber, change: i64, before_matters: bool| {
            let capacity = places.get(place as usize).and_then(|p| p.capacity);
            let Some(capacity) = capacity else { return };
            let most = i64::from(capacity) - change;
            if !before_matters && most >= 0 {
                return;
            }
            let below = u32::try_from(most.saturating_add(1).max(0)).unwrap_or(u32::MAX);
            forbids.push((place, below));
        };
        for (place, change) in self.changes().into_iter().filter(|(_, c)| *c > 0) {
            room(place, change, true);
        }
        for (place, after) in self.after_reset() {
            room(place, i64::from(after), false);
        }
        forbids.sort_unstable();
        forbids
    }
}

impl Model {
    /// A net by itself, as a plain net: a firing is one step, nothing comes in on its tape, and
    /// nothing comes from other nets. What it sends to other nets is lost.
    #[must_use]
    pub fn of_net(net: &Net) -> Self {
        let arcs = |arcs: &[pnt_language::net::Arc]| -> Vec<Weighted> {
            let mut list: Vec<Weighted> =
                arcs.iter().map(|arc| (arc.place.0, arc.weight)).collect();
            list.sort_unstable();
            list
        };
        let mut model = Self {
            places: net
                .places()
                .iter()
                .map(|place| Place {
                    name: place.name.clone(),
                    tokens: place.tokens,
                    capacity: place.capacity,
                })
                .collect(),
            transitions: net
                .transitions()
                .iter()
                .map(|transition| Transition {
                    name: transition.name.clone(),
                    takes: arcs(&transition.inputs),
                    reads: arcs(&transition.reads),
                    inhibitors: arcs(&transition.inhibitors),
                    resets: transition.resets.iter().map(|place| place.0).collect(),
                    puts: arcs(&transition.outputs.local),
                    when: None,
                    priority: Some(transition.priority),
                    group: 0,
                    label: None,
                })
                .collect(),
        };
        for (label, transition) in (0..).zip(&mut model.transitions) {
            transition.label = Some(label);
        }
        model
    }

    /// Composed nets, a transition for each of their steps.
    #[must_use]
    pub fn of_system(system: &System) -> Self {
        let number = |place: usize| PlaceNumber::try_from(place).unwrap_or(PlaceNumber::MAX);
        let list = |arcs: &[(usize, u32)]| -> Vec<Weighted> {
            arcs.iter().map(|(place, w)| (number(*place), *w)).collect()
        };
        // The transitions of all nets, one net after the other.
        let mut next = 0;
        let firsts: Vec<usize> = system
            .nets()
            .iter()
            .map(|net| {
                let first = next;
                next += net.transitions().len();
                first
            })
            .collect();
        let label = |step: &Step| {
            let begins = matches!(step.phase, Phase::Fire | Phase::Start);
            let id = step.transition.filter(|_| begins)?;
            u32::try_from(firsts.get(step.net)? + id.index()).ok()
        };
        Self {
            places: system
                .places()
                .iter()
                .map(|place| Place {
                    name: place.name.clone(),
                    tokens: place.tokens,
                    capacity: place.capacity,
                })
                .collect(),
            transitions: system
                .steps()
                .iter()
                .map(|step| Transition {
                    name: system.step_name(step).to_string(),
                    takes: list(&step.takes),
                    reads: list(&step.reads),
                    inhibitors: list(&step.forbids),
                    resets: step.resets.iter().map(|place| number(*place)).collect(),
                    puts: list(&step.puts),
                    when: step.when.map(|(function, negated)| {
                        (u32::try_from(function).unwrap_or(u32::MAX), negated)
                    }),
                    priority: step.priority,
                    group: u32::try_from(step.net).unwrap_or(u32::MAX),
                    label: label(step),
                })
                .collect(),
        }
    }

    /// The initial marking.
    #[must_use]
    pub fn initial(&self) -> Vec<u32> {
        self.places.iter().map(|place| place.tokens).collect()
    }

    /// Whether the tokens for a transition are there, and nothing inhibits it. Priorities and enabling
    /// functions are not asked.
    #[must_use]
    pub fn is_enabled(&self, transition: TransitionNumber, marking: &[u32]) -> bool {
        let held = |place: PlaceNumber| marking.get(place as usize).copied().unwrap_or(0);
        self.transitions.get(transition as usize).is_some_and(|t| {
            t.needs()
                .iter()
                .all(|(place, weight)| held(*place) >= *weight)
                && t.forbids(&self.places)
                    .iter()
                    .all(|(place, weight)| held(*place) < *weight)
        })
    }

    /// The marking after a firing; `None` when the transition is not enabled or a place would hold
    /// more than 32 bits can say.
    #[must_use]
    pub fn fire(&self, transition: TransitionNumber, marking: &[u32]) -> Option<Vec<u32>> {
        if !self.is_enabled(transition, marking) {
            return None;
        }
        let fired = self.transitions.get(transition as usize)?;
        let mut after = marking.to_vec();
        for (place, change) in fired.changes() {
            let tokens = after.get_mut(place as usize)?;
            *tokens = u32::try_from(i64::from(*tokens) + change).ok()?;
        }
        for (place, left) in fired.after_reset() {
            *after.get_mut(place as usize)? = left;
        }
        Some(after)
    }

    /// The marking that a sequence of firings leads to from the initial one; `None` when one of them
    /// is not enabled.
    #[must_use]
    pub fn replay(&self, sequence: &[TransitionNumber]) -> Option<Vec<u32>> {
        let start = self.initial();
        sequence.iter().try_fold(start, |marking, transition| {
            self.fire(*transition, &marking)
        })
    }

    /// One more than the largest label.
    #[must_use]
    pub fn label_count(&self) -> usize {
        let labels = self.transitions.iter().filter_map(|t| t.label);
        labels.max().map_or(0, |label| label as usize + 1)
    }

    /// Whether any transition has a priority above another's.
    #[must_use]
    pub fn has_priorities(&self) -> bool {
        self.transitions.iter().any(|t| t.priority > Some(0))
    }

    /// The place called `name`.
    #[must_use]
    pub fn place(&self, name: &str) -> Option<PlaceNumber> {
        let index = self.places.iter().position(|place| place.name == name)?;
        PlaceNumber::try_from(index).ok()
    }

    /// The transition called `name`.
    #[must_use]
    pub fn transition(&self, name: &str) -> Option<TransitionNumber> {
        let index = self.transitions.iter().position(|t| t.name == name)?;
        TransitionNumber::try_from(index).ok()
    }
}
