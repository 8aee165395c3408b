//! Siphons and traps. A siphon is a set of places into which nothing puts without taking from it: once
//! empty, it stays empty. A trap is the reverse: once marked, it stays marked. If every siphon of an
//! ordinary net contains a trap that is marked at the beginning, the net has no deadlock (Commoner).

use super::Arcs;

/// A set of places, sorted.
pub type PlaceSet = Vec<usize>;

/// The minimal siphons of a net. `None` when there are more than `most`, or the search takes more
/// than 100 times as many steps.
#[must_use]
pub fn minimal_siphons(arcs: &Arcs, most: usize) -> Option<Vec<PlaceSet>> {
    let mut found: Vec<PlaceSet> = Vec::new();
    let mut steps = most.saturating_mul(100);
    // Problems: places that may be used, and those that must be (Cordone, Ferrarini and Piroddi 2005).
    let mut problems: Vec<(Vec<bool>, Vec<bool>)> = vec![(
        vec![true; arcs.producers.len()],
        vec![false; arcs.producers.len()],
    )];
    while let Some((allowed, required)) = problems.pop() {
        steps = steps.checked_sub(1)?;
        let Some(siphon) = one_siphon(arcs, &allowed, &required) else {
            continue;
        };
        let members = numbers(&siphon);
        let free: Vec<usize> = members
            .iter()
            .copied()
            .filter(|place| !required[*place])
            .collect();
        if !found.contains(&members) {
            found.push(members);
            if found.len() > most {
                return None;
            }
        }
        // Every other minimal siphon lacks one of its places.
        let mut required = required;
        for place in free {
            let mut fewer = allowed.clone();
            fewer[place] = false;
            problems.push((fewer, required.clone()));
            required[place] = true;
        }
    }
    let all = found.clone();
    found.retain(|siphon| {
        !all.iter()
            .any(|other| other.len() < siphon.len() && other.iter().all(|p| siphon.contains(p)))
    });
    found.sort_unstable();
    Some(found)
}

/// The minimal traps; as [`minimal_siphons`].
#[must_use]
pub fn minimal_traps(arcs: &Arcs, most: usize) -> Option<Vec<PlaceSet>> {
    minimal_siphons(&arcs.reversed(), most)
}

/// The largest siphon within a set of places.
#[must_use]
pub fn largest_siphon(arcs: &Arcs, within: &[bool]) -> Vec<bool> {
    let mut set = within.to_vec();
    loop {
        let takes = |transition: &usize| arcs.inputs[*transition].iter().any(|place| set[*place]);
        let leaks = |place: &usize| set[*place] && !arcs.producers[*place].iter().all(takes);
        let Some(place) = (0..set.len()).find(leaks) else {
            return set;
        };
        set[place] = false;
    }
}

/// The largest trap within a set of places.
#[must_use]
pub fn largest_trap(arcs: &Arcs, within: &[bool]) -> Vec<bool> {
    largest_siphon(&arcs.reversed(), within)
}

/// A minimal siphon among those with all required places and none that is not allowed.
fn one_siphon(arcs: &Arcs, allowed: &[bool], required: &[bool]) -> Option<Vec<bool>> {
    let holds = |set: &[bool]| {
        set.contains(&true)
            && required
                .iter()
                .zip(set)
                .all(|(required, has)| !required || *has)
    };
    let mut set = largest_siphon(arcs, allowed);
    if !holds(&set) {
        return None;
    }
    for place in 0..set.len() {
        if !set[place] || required[place] {
            continue;
        }
        let mut fewer = set.clone();
        fewer[place] = false;
        let smaller = largest_siphon(arcs, &fewer);
        if holds(&smaller) {
            set = smaller;
        }
    }
    Some(set)
}

fn numbers(set: &[bool]) -> PlaceSet {
    set.iter()
        .enumerate()
        .filter(|(_, is)| **is)
        .map(|(place, _)| place)
        .collect()
}

/// The minimal siphons that contain no trap marked at the beginning: the possible causes of a deadlock.
/// If there are none, an ordinary net has no deadlock. `None` beyond the limit.
#[must_use]
pub fn uncontrolled(arcs: &Arcs, initial: &[u32], most: usize) -> Option<Vec<PlaceSet>> {
    let mut siphons = minimal_siphons(arcs, most)?;
    siphons.retain(|siphon| {
        let mut set = vec![false; initial.len()];
        for place in siphon {
            set[*place] = true;
        }
        let trap = largest_trap(arcs, &set);
        !trap
            .iter()
            .zip(initial)
            .any(|(inside, tokens)| *inside && *tokens > 0)
    });
    Some(siphons)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::analysis::{
        explicit::{Limits, explore},
        samples::{kanban, philosophers, random_model},
    };

    /// By the definition, over all sets of places.
    fn by_definition(arcs: &Arcs) -> Vec<PlaceSet> {
        let places = arcs.producers.len();
        let is_siphon = |set: &PlaceSet| {
            set.iter()
                .flat_map(|place| &arcs.producers[*place])
                .all(|transition| {
                    arcs.inputs[*transition]
                        .iter()
                        .any(|place| set.contains(place))
                })
        };
        let sets = (1_u32..1 << places).map(|bits| -> PlaceSet {
            (0..places).filter(|place| bits >> place & 1 == 1).collect()
        });
        let all: Vec<PlaceSet> = sets.filter(is_siphon).collect();
        let within = |a: &PlaceSet, b: &PlaceSet| a != b && a.iter().all(|p| b.contains(p));
        let mut minimal: Vec<PlaceSet> = all
            .iter()
            .filter(|set| !all.iter().any(|other| within(other, set)))
            .cloned()
            .collect();
        minimal.sort_unstable();
        minimal
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn siphons_and_traps_are_those_of_the_definition(net in random_model()) {
            let arcs = Arcs::of(&net);
            prop_assert_eq!(minimal_siphons(&arcs, 1000).unwrap(), by_definition(&arcs));
            let reversed = by_definition(&arcs.reversed());
            prop_assert_eq!(minimal_traps(&arcs, 1000).unwrap(), reversed);
        }

        #[test]
        fn an_ordinary_net_whose_siphons_contain_marked_traps_has_no_deadlock(net in random_model()) {
            let arcs = Arcs::of(&net);
            let limits = Limits { markings: 2_000, ..Limits::default() };
            let none = uncontrolled(&arcs, &net.initial(), 1000).unwrap().is_empty();
            if arcs.ordinary && none {
                prop_assert_eq!(explore(&net, &limits).dead_count, 0);
            }
        }
    }

    #[test]
    fn the_siphons_that_philosophers_starve_by_are_named_and_kanban_has_none() {
        let net = philosophers(4);
        let bad = uncontrolled(&Arcs::of(&net), &net.initial(), 1000).unwrap();
        assert!(!bad.is_empty());
        let net = kanban(1);
        assert_eq!(
            uncontrolled(&Arcs::of(&net), &net.initial(), 1000).unwrap(),
            Vec::<PlaceSet>::new()
        );
    }
}
