//! A firing sequence step by step from the initial marking, and what keeps a transition from firing. Follows the
//! model; which markings are reachable it does not know.

use super::{
    explicit::{Rules, Scratch},
    layout::Layout,
    model::{Model, PlaceNumber, TransitionNumber},
};

/// What a place must hold for a firing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// So many tokens.
    AtLeast(u32),
    /// Fewer than this: an inhibitor arc, or a capacity for what comes.
    Below(u32),
}

/// A place that keeps a transition from firing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lack {
    /// The place.
    pub place: PlaceNumber,
    /// What it holds.
    pub holds: u32,
    /// What it should hold.
    pub wanted: Wanted,
}

/// What keeps a transition from firing at a marking, but for priorities and enabling functions.
#[must_use]
pub fn lacks(model: &Model, transition: TransitionNumber, marking: &[u32]) -> Vec<Lack> {
    let Some(transition) = model.transitions.get(transition as usize) else {
        return Vec::new();
    };
    let held = |place: PlaceNumber| marking.get(place as usize).copied().unwrap_or(0);
    let lack = |place, wanted| Lack {
        place,
        holds: held(place),
        wanted,
    };
    let needs = transition.needs().into_iter();
    let needs = needs.filter(|(place, weight)| held(*place) < *weight);
    let forbids = transition.forbids(&model.places).into_iter();
    let forbids = forbids.filter(|(place, weight)| held(*place) >= *weight);
    let needs = needs.map(|(place, weight)| lack(place, Wanted::AtLeast(weight)));
    needs
        .chain(forbids.map(|(place, weight)| lack(place, Wanted::Below(weight))))
        .collect()
}

/// Why a step of a sequence is not possible.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refused {
    /// Tokens are missing, or something is in the way.
    Lacks(Vec<Lack>),
    /// One of these goes first.
    MoreUrgent(Vec<TransitionNumber>),
    /// A place would hold more than 32 bits can say.
    Overflow,
}

/// Plays firing sequences.
pub struct Player<'a> {
    model: &'a Model,
    rules: Rules,
    marking: Vec<u32>,
}

impl<'a> Player<'a> {
    /// Begins at the initial marking.
    #[must_use]
    pub fn new(model: &'a Model) -> Self {
        let bits = vec![u32::BITS; model.places.len()];
        Self {
            model,
            rules: Rules::new(model, Layout::roomy(&bits)),
            marking: model.initial(),
        }
    }

    /// The marking now.
    #[must_use]
    pub fn marking(&self) -> &[u32] {
        &self.marking
    }

    /// What may fire now, whatever enabling functions say.
    #[must_use]
    pub fn enabled(&self) -> Vec<TransitionNumber> {
        let each = (0..).zip(&self.model.transitions).map(|(number, _)| number);
        let mut scratch = Scratch::default();
        let enabled = each.filter(|number| self.model.is_enabled(*number, &self.marking));
        scratch.enabled.extend(enabled);
        if self.rules.has_priorities {
            self.rules.drop_low_priorities(&mut scratch);
        }
        scratch.enabled
    }

    /// Fires a transition.
    ///
    /// # Errors
    /// When it may not fire; the marking is as before.
    pub fn fire(&mut self, transition: TransitionNumber) -> Result<(), Refused> {
        let lacks = lacks(self.model, transition, &self.marking);
        if !lacks.is_empty() {
            return Err(Refused::Lacks(lacks));
        }
        let enabled = self.enabled();
        if !enabled.contains(&transition) {
            return Err(Refused::MoreUrgent(enabled));
        }
        let after = self.model.fire(transition, &self.marking);
        self.marking = after.ok_or(Refused::Overflow)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::samples::model;

    #[test]
    fn a_step_is_played_or_it_is_said_what_it_lacks_or_what_goes_first() {
        let net = model(
            "net n\nplace bin = 3, robot = 1\ntransition load\n  in bin*2, robot\n  out robot\ntransition rest\n  read robot\n  priority 1\n  in robot\n  inhibit bin*2\n",
        );
        let mut player = Player::new(&net);
        assert_eq!(player.enabled(), [0]);
        let refused = player.fire(1).unwrap_err();
        let lack = Lack {
            place: 0,
            holds: 3,
            wanted: Wanted::Below(2),
        };
        assert_eq!(refused, Refused::Lacks(vec![lack]));
        player.fire(0).unwrap();
        assert_eq!(player.marking(), [1, 1]);
        let lack = Lack {
            place: 0,
            holds: 1,
            wanted: Wanted::AtLeast(2),
        };
        assert_eq!(player.fire(0), Err(Refused::Lacks(vec![lack])));
        assert_eq!(player.enabled(), [1]);
        let both = model(
            "net n\nplace a = 1\ntransition low\n  in a\ntransition high\n  in a\n  priority 1\n",
        );
        let refused = Player::new(&both).fire(0);
        assert_eq!(refused, Err(Refused::MoreUrgent(vec![1])));
    }
}
