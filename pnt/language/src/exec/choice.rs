//! Which transition fires next: the highest priority first; among equals the one declared first, or
//! chance by weight.

use rand_chacha::ChaCha8Rng;

use super::{enabling::Enabling, execution::Execution, wiring::Wiring};
use crate::net::{TransitionId, When};

/// Who wins when several transitions of the same priority are enabled.
#[derive(Debug, Clone)]
pub enum Conflicts {
    /// The one declared first.
    Declared,
    /// Chance, by the transitions' weights. It is asked only where there is a choice, so that the
    /// same seed and the same events give the same firings.
    Random(Box<ChaCha8Rng>),
}

impl Execution {
    /// The transition to fire next, of those that take no time: of the highest priority among the
    /// enabled ones, by declared order or by chance. `asks` evaluates an enabling function (not its
    /// negation); it must be pure.
    #[inline]
    pub fn choose(
        &mut self,
        conflicts: &mut Conflicts,
        mut asks: impl FnMut(&When) -> bool,
    ) -> Option<TransitionId> {
        let (net, wiring) = (&*self.net, &*self.wiring);
        let mut allowed = |rank: usize| {
            wiring.guards.get(rank) != Some(&true) || {
                let when = wiring
                    .at_rank
                    .get(rank)
                    .and_then(|id| net[*id].when.as_ref());
                when.is_none_or(|when| asks(when) != when.negated)
            }
        };
        let rank = match conflicts {
            Conflicts::Declared => by_order(&self.enabling, wiring, &mut allowed),
            Conflicts::Random(rng) => by_chance(&mut self.enabling, wiring, rng, &mut allowed),
        }?;
        wiring.at_rank.get(rank).copied()
    }
}

#[inline]
fn by_order(
    enabling: &Enabling,
    wiring: &Wiring,
    allowed: &mut impl FnMut(usize) -> bool,
) -> Option<usize> {
    let mut next = enabling.ready.first();
    while let Some(rank) = next.filter(|rank| *rank < wiring.first_timed) {
        if allowed(rank) {
            return Some(rank);
        }
        next = enabling.ready.next(rank + 1);
    }
    None
}

fn by_chance(
    enabling: &mut Enabling,
    wiring: &Wiring,
    rng: &mut ChaCha8Rng,
    allowed: &mut impl FnMut(usize) -> bool,
) -> Option<usize> {
    let mut next = enabling.ready.first();
    while let Some(first) = next.filter(|rank| *rank < wiring.first_timed) {
        let class = wiring.class_from(first);
        let alone = enabling
            .ready
            .next(first + 1)
            .is_none_or(|rank| rank >= class.end);
        let chosen = if alone {
            Some(first).filter(|rank| allowed(*rank))
        } else {
            let shares = enabling.shares(wiring);
            let chosen = loop {
                let Some(rank) = shares.draw(first, rng) else {
                    break None;
                };
                if allowed(rank) {
                    break Some(rank);
                }
                shares.set_aside(rank);
            };
            shares.put_back();
            chosen
        };
        if chosen.is_some() {
            return chosen;
        }
        next = enabling.ready.next(class.end);
    }
    None
}
