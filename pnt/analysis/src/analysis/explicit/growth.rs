//! Proofs that a place has no bound. A marking may cover an earlier one on its own path, and hold more somewhere.
//! Then it can be left in the same way again and again (Karp and Miller 1969). That holds unless an inhibitor arc
//! or a capacity looks at what grows, or a firing of the round empties it. Where transitions have priorities, the
//! round must also be possible with any number of tokens in the places that grow.

use std::collections::{BTreeMap, BTreeSet};

use super::{
    super::model::{PlaceNumber, TransitionNumber},
    Search,
    path::Lookup,
    rules::{Rules, Scratch},
    worker::Record,
};

/// A proof that a place can grow without bound.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Growth {
    /// The place.
    pub place: PlaceNumber,
    /// Firings from the initial marking to where the growing begins.
    pub lead: Vec<TransitionNumber>,
    /// Firings that can be repeated for ever, each time with more tokens in the place.
    pub cycle: Vec<TransitionNumber>,
}

/// The longest way on which all pairs of markings are compared; on longer ones only the last marking
/// is compared with all others.
const ALL_PAIRS: usize = 400;

impl Search<'_> {
    /// Looks along the ways to the markings that have doubled a bound in this level.
    pub(super) fn look_for_growth(&mut self, records: &BTreeMap<Record, Vec<u32>>) -> bool {
        let lookup = Lookup {
            rules: &self.rules,
            store: &self.store,
            levels: &self.levels,
        };
        // One marking may be several records.
        let markings: BTreeSet<&Vec<u32>> = records.values().collect();
        self.growth = markings.into_iter().find_map(|record| {
            let (sequence, markings) = lookup.way(record)?;
            growth_on(&self.rules, &sequence, &markings)
        });
        self.growth.is_some()
    }
}

fn growth_on(
    rules: &Rules,
    sequence: &[TransitionNumber],
    markings: &[Vec<u32>],
) -> Option<Growth> {
    let last = markings.len().checked_sub(1)?;
    let first_end = if last > ALL_PAIRS { last } else { 1 };
    for end in (first_end..=last).rev() {
        for start in (0..end).rev() {
            if let Some(place) = grown(
                rules,
                &sequence[start..end],
                &markings[start],
                &markings[end],
            ) {
                return Some(Growth {
                    place,
                    lead: sequence[..start].to_vec(),
                    cycle: sequence[start..end].to_vec(),
                });
            }
        }
    }
    None
}

/// A place that grows without bound when the round leads from one marking to the other.
fn grown(
    rules: &Rules,
    round: &[TransitionNumber],
    before: &[u32],
    after: &[u32],
) -> Option<PlaceNumber> {
    if before
        .iter()
        .zip(after)
        .any(|(before, after)| before > after)
    {
        return None;
    }
    let mut grown = (0..)
        .zip(before.iter().zip(after))
        .filter(|(_, (b, a))| b < a)
        .map(|(p, _)| p);
    let empties = |place: PlaceNumber| {
        let transitions = round
            .iter()
            .filter_map(|number| rules.packed.get(*number as usize));
        transitions
            .flat_map(|t| &t.resets)
            .any(|(other, _)| *other == place)
    };
    let looked_at = |place: PlaceNumber| rules.inhibiting[place as usize];
    let first = grown.next()?;
    let all = || std::iter::once(first).chain(grown.clone());
    if all().any(looked_at) {
        return None;
    }
    let place = all().find(|place| !empties(*place))?;
    let many: Vec<PlaceNumber> = all().collect();
    (!rules.has_priorities || stays_possible(rules, round, before, &many)).then_some(place)
}

/// Whether no firing of the round ever has to wait for a more urgent one, however many tokens the places hold that
/// grow. More tokens there enable more, since no inhibitor arc looks at them; all other places hold the same each time.
fn stays_possible(
    rules: &Rules,
    round: &[TransitionNumber],
    before: &[u32],
    grown: &[PlaceNumber],
) -> bool {
    let mut marking = before.to_vec();
    let mut many = vec![false; marking.len()];
    for place in grown {
        marking[*place as usize] = u32::MAX;
        many[*place as usize] = true;
    }
    let mut scratch = Scratch::default();
    round.iter().all(|number| {
        let each = (0..).zip(&rules.packed);
        let enabled = each.filter(|(_, t)| t.is_enabled(&marking));
        scratch.enabled = enabled.map(|(number, _)| number).collect();
        rules.drop_low_priorities(&mut scratch);
        let transition = &rules.packed[*number as usize];
        for (place, loss) in &transition.losses {
            let tokens = &mut marking[*place as usize];
            *tokens = tokens.saturating_sub(if many[*place as usize] { 0 } else { *loss });
        }
        for (place, gain) in &transition.gains {
            let tokens = &mut marking[*place as usize];
            *tokens = tokens.saturating_add(*gain);
        }
        for (place, after) in &transition.resets {
            marking[*place as usize] = *after;
            many[*place as usize] = false;
        }
        scratch.enabled.contains(number)
    })
}
