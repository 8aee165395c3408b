//! Proofs that a place has no bound: a marking that covers one on its own way, and holds more somewhere,
//! can be left in the same way again and again (Karp and Miller 1969). That holds unless an inhibitor
//! arc, a capacity or a priority looks at what grows, or a firing of the round empties it.

use std::collections::{BTreeMap, BTreeSet};

use super::{
    super::model::{PlaceNumber, TransitionNumber},
    Search,
    path::Lookup,
    rules::Rules,
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
        if self.rules.has_priorities {
            return false;
        }
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
    all().find(|place| !empties(*place))
}
