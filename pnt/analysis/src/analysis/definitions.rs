//! Every analysis beside the definitions of the textbooks, on random small models. Their markings,
//! firings and reachability are written down in full, by code that shares nothing with the analyses.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::{
    cover::{self, Tokens},
    explicit::{Explored, Limits, Stopped, explore},
    model::{Model, Transition},
    question::{Answer, Because, Question},
    returns::{always_reachable, returns},
    samples::random_model,
    structure::{Arcs, semiflows, siphons},
    verdict::{Engines, look},
};

type Marking = Vec<u32>;

/// Markings at most; models with more are passed over.
const MOST: usize = 400;

/// Arcs of a list to or from a place, added up.
fn sum(arcs: &[(u32, u32)], place: usize) -> i64 {
    let of = arcs.iter().filter(|(p, _)| *p as usize == place);
    of.map(|(_, weight)| i64::from(*weight)).sum()
}

/// The marking after a firing, by the definition; `None` when it is not enabled.
fn fire(model: &Model, transition: &Transition, marking: &[u32]) -> Option<Marking> {
    let mut after = Vec::new();
    for (place, tokens) in marking.iter().enumerate() {
        let number = u32::try_from(place).unwrap();
        let tokens = i64::from(*tokens);
        let reads = transition.reads.iter().filter(|(p, _)| *p == number);
        let inhibitors = transition.inhibitors.iter().filter(|(p, _)| *p == number);
        let (takes, puts) = (sum(&transition.takes, place), sum(&transition.puts, place));
        let there = tokens >= takes && reads.clone().all(|(_, w)| tokens >= i64::from(*w));
        if !there || inhibitors.clone().any(|(_, w)| tokens >= i64::from(*w)) {
            return None;
        }
        let left = if transition.resets.contains(&number) {
            0
        } else {
            tokens - takes
        };
        let then = left + puts;
        // More than it may hold, and more than before: what is too full may still get emptier.
        let capacity = model.places[place].capacity.map(i64::from);
        let emptied = transition.resets.contains(&number);
        if capacity.is_some_and(|capacity| then > capacity && (emptied || then > tokens)) {
            return None;
        }
        after.push(u32::try_from(then).unwrap());
    }
    Some(after)
}

/// Transitions that may fire for some answers of the enabling functions, with where they lead, and those
/// that are sure. Of a pair of a function and its negation, one fires for any answer.
fn firings(model: &Model, marking: &[u32]) -> (BTreeMap<usize, Marking>, BTreeSet<usize>) {
    let transitions = model.transitions.iter().enumerate();
    let enabled: BTreeMap<usize, Marking> = transitions
        .filter_map(|(number, t)| Some((number, fire(model, t, marking)?)))
        .collect();
    let mut may = BTreeMap::new();
    for answers in 0_u32..4 {
        let passes = |number: usize| {
            let when = model.transitions[number].when;
            when.is_none_or(|(function, negated)| (answers >> function & 1 == 1) != negated)
        };
        let passing: Vec<usize> = enabled.keys().copied().filter(|n| passes(*n)).collect();
        for number in &passing {
            let t = &model.transitions[*number];
            let outranked = passing.iter().map(|n| &model.transitions[*n]).any(|other| {
                other.group == t.group && t.priority.is_some() && other.priority > t.priority
            });
            if !outranked {
                may.insert(*number, enabled[number].clone());
            }
        }
    }
    let whens: Vec<_> = may
        .keys()
        .filter_map(|n| model.transitions[*n].when)
        .collect();
    let sure = may.keys().copied().filter(|number| {
        let when = model.transitions[*number].when;
        when.is_none_or(|(function, negated)| whens.contains(&(function, !negated)))
    });
    let sure = sure.collect();
    (may, sure)
}

/// Everything reachable, by distance.
struct All {
    markings: Vec<Marking>,
    distances: Vec<usize>,
    /// Per marking: transitions and where they lead.
    edges: Vec<BTreeMap<usize, usize>>,
    sure: Vec<BTreeSet<usize>>,
}

fn all(model: &Model) -> Option<All> {
    let mut numbers = BTreeMap::from([(model.initial(), 0)]);
    let mut all = All {
        markings: vec![model.initial()],
        distances: vec![0],
        edges: Vec::new(),
        sure: Vec::new(),
    };
    while all.edges.len() < all.markings.len() {
        let from = all.edges.len();
        let (may, sure) = firings(model, &all.markings[from].clone());
        let mut edges = BTreeMap::new();
        for (transition, to) in may {
            let next = all.markings.len();
            let number = *numbers.entry(to.clone()).or_insert(next);
            if number == next {
                all.markings.push(to);
                all.distances.push(all.distances[from] + 1);
            }
            edges.insert(transition, number);
        }
        all.edges.push(edges);
        all.sure.push(sure);
        if all.markings.len() > MOST {
            return None;
        }
    }
    Some(all)
}

impl All {
    /// Per marking, what can be reached from it by firings that are sure to stay possible.
    fn reach(&self) -> Vec<Vec<bool>> {
        let from = |start: usize| {
            let mut seen = vec![false; self.markings.len()];
            let mut open = vec![start];
            seen[start] = true;
            while let Some(at) = open.pop() {
                for (transition, to) in &self.edges[at] {
                    if self.sure[at].contains(transition) && !seen[*to] {
                        seen[*to] = true;
                        open.push(*to);
                    }
                }
            }
            seen
        };
        (0..self.markings.len()).map(from).collect()
    }
}

/// A random model whose transitions have priorities and enabling functions as well, in two groups.
fn guarded_model() -> impl Strategy<Value = Model> {
    let choice = prop::collection::vec((0_u32..3, 0_u32..9, any::<bool>(), 0_u32..2), 7);
    (random_model(), choice).prop_map(|(mut model, choices)| {
        for (transition, (priority, function, negated, group)) in
            model.transitions.iter_mut().zip(choices)
        {
            transition.group = group;
            transition.priority = Some(priority / 2);
            // A function belongs to one group.
            if function < 3 {
                transition.when = Some((group, negated));
            }
        }
        model
    })
}

fn any_model() -> impl Strategy<Value = Model> {
    prop_oneof![random_model(), guarded_model()]
}

/// Everything that a search tells.
fn told(found: &Explored<'_>, place: usize) -> String {
    let ways: Vec<_> = found
        .dead
        .iter()
        .map(|dead| found.path(&dead.marking))
        .collect();
    let nearest = found.nearest(|marking| marking[place] > 1);
    let way = nearest.as_ref().map(|nearest| found.path(&nearest.marking));
    let end = found.complete().then(|| {
        let mut returns = returns(found, usize::MAX);
        // Numbers that threads had left over need room as well.
        returns.iter_mut().for_each(|returns| returns.bytes = 0);
        let wanted = |marking: &[u32]| marking[place] > 0;
        (returns, always_reachable(found, &wanted, usize::MAX))
    });
    let numbers = (
        found.markings,
        found.edges,
        found.dead_count,
        found.most_tokens,
    );
    let lists = (&found.bounds, &found.seen, &found.dead);
    format!(
        "{numbers:?} {:?} {:?} {lists:?} {ways:?} {nearest:?} {way:?} {end:?}",
        found.stopped, found.growth
    )
}

proptest! {
    // Every case starts threads for each level.
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn threads_change_nothing_that_is_told(
        model in any_model(), markings in 5_usize..600, place in any::<prop::sample::Index>()
    ) {
        let place = place.index(model.places.len());
        let found = |threads| {
            let found = explore(&model, &Limits { markings, threads, ..Limits::default() });
            (told(&found, place), found.stopped)
        };
        let (one, stopped) = found(1);
        let (two, _) = found(2);
        // Alone, a search knows some of the level that it did not end.
        if stopped != Some(Stopped::Markings) {
            prop_assert_eq!(&one, &two);
        }
        for threads in [2, 3, 8] {
            prop_assert_eq!(&two, &found(threads).0, "{} threads", threads);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn the_list_of_markings_is_that_of_the_definition(model in any_model(), threads in 1_usize..5) {
        let Some(all) = all(&model) else { return Ok(()) };
        let limits = Limits { threads, ..Limits::default() };
        let found = explore(&model, &limits);
        prop_assert!(found.complete(), "{:?}", found.stopped);
        prop_assert_eq!(found.markings, all.markings.len());
        prop_assert_eq!(found.edges as usize, all.edges.iter().map(BTreeMap::len).sum::<usize>());
        for (marking, distance) in all.markings.iter().zip(&all.distances) {
            let path = found.path(marking).unwrap();
            prop_assert_eq!(path.len(), *distance);
            prop_assert_eq!(model.replay(&path), Some(marking.clone()));
        }
        for place in 0..model.places.len() {
            let most = all.markings.iter().map(|marking| marking[place]).max();
            prop_assert_eq!(Some(found.bounds[place]), most);
        }
        let sums = all.markings.iter().map(|m| m.iter().map(|t| u64::from(*t)).sum::<u64>());
        prop_assert_eq!(Some(found.most_tokens), sums.max());
        for (number, seen) in found.seen.iter().enumerate() {
            prop_assert_eq!(*seen, all.edges.iter().any(|edges| edges.contains_key(&number)));
        }
        let dead: BTreeSet<&Marking> =
            all.markings.iter().zip(&all.sure).filter(|(_, sure)| sure.is_empty()).map(|(m, _)| m).collect();
        prop_assert_eq!(found.dead_count as usize, dead.len());
        prop_assert_eq!(found.dead.iter().map(|d| &d.marking).collect::<BTreeSet<_>>(), dead);
    }

    #[test]
    fn where_markings_lead_in_the_end_is_as_defined(model in any_model()) {
        let Some(all) = all(&model) else { return Ok(()) };
        let reach = all.reach();
        let found = explore(&model, &Limits::default());
        let told = returns(&found, usize::MAX).unwrap();
        let count = all.markings.len();
        prop_assert_eq!(told.reversible, (0..count).all(|m| reach[m][0]));
        if let Some(marking) = &told.no_return {
            let number = all.markings.iter().position(|m| m == marking).unwrap();
            prop_assert!(!reach[number][0]);
            // The nearest such.
            let nearest = (0..count).filter(|m| !reach[*m][0]).map(|m| all.distances[m]).min();
            prop_assert_eq!(Some(all.distances[number]), nearest);
        }
        prop_assert_eq!(told.no_return.is_none(), told.reversible);
        let home = (0..count).filter(|home| (0..count).all(|m| reach[m][*home])).count();
        prop_assert_eq!(told.home_states, home);
        // Terminal components: a marking that returns from wherever it leads.
        let terminal: BTreeSet<Vec<bool>> = (0..count)
            .filter(|m| (0..count).all(|to| !reach[*m][to] || reach[to][*m]))
            .map(|m| reach[m].clone())
            .collect();
        prop_assert_eq!(told.terminal, terminal.len());
        for (label, live) in told.live.iter().enumerate() {
            let again = |m: usize| (0..count).any(|to| reach[m][to] && all.sure[to].contains(&label));
            prop_assert_eq!(*live, (0..count).all(again), "transition {}", label);
        }
        // What always stays within reach.
        for place in 0..model.places.len() {
            let wanted = |marking: &[u32]| marking[place] > 0;
            let stays = always_reachable(&found, &wanted, usize::MAX).unwrap();
            let lost = |m: &usize| !(0..count).any(|to| reach[*m][to] && wanted(&all.markings[to]));
            prop_assert_eq!(stays.is_some(), (0..count).any(|m| lost(&m)));
            if let Some(marking) = stays {
                let number = all.markings.iter().position(|m| *m == marking).unwrap();
                prop_assert!(lost(&number));
            }
        }
    }

    #[test]
    fn verdicts_of_both_engines_are_as_defined(model in any_model()) {
        let Some(all) = all(&model) else { return Ok(()) };
        let reach = all.reach();
        let count = all.markings.len();
        let limits = Limits { markings: 1_000_000, ..Limits::default() };
        for engines in [Engines::Explicit, Engines::Symbolic] {
            let verdict = look(&model, &limits, engines, &mut |_| {}).verdict;
            prop_assert!(verdict.complete);
            prop_assert_eq!((verdict.markings, verdict.bounded), (count as u128, Some(true)));
            let edges = all.edges.iter().map(BTreeMap::len).sum::<usize>();
            prop_assert_eq!(verdict.edges, edges as u128);
            let safe = all.markings.iter().flatten().all(|tokens| *tokens <= 1);
            prop_assert_eq!(verdict.safe, Some(safe));
            let dead = all.sure.iter().filter(|sure| sure.is_empty()).count();
            prop_assert_eq!(verdict.deadlocks, dead as u128);
            prop_assert_eq!(verdict.reversible, Some((0..count).all(|m| reach[m][0])));
            let live = (0..model.transitions.len()).all(|label| {
                (0..count).all(|m| (0..count).any(|to| reach[m][to] && all.sure[to].contains(&label)))
            });
            prop_assert_eq!(verdict.live, Some(live));
            if let Some(home) = verdict.home_states {
                let homes = (0..count).filter(|home| (0..count).all(|m| reach[m][*home])).count();
                prop_assert_eq!(home, homes as u128);
            }
        }
    }

    #[test]
    fn questions_are_answered_as_by_looking_at_every_marking(
        model in any_model(), place in any::<prop::sample::Index>(), other in any::<prop::sample::Index>(), tokens in 0_u32..4
    ) {
        let Some(all) = all(&model) else { return Ok(()) };
        let reach = all.reach();
        let found = explore(&model, &Limits::default());
        let (p, q) = (place.index(model.places.len()), other.index(model.places.len()));
        for text in [
            format!("p{p} >= {tokens} & p{q}"),
            format!("p{p} = {tokens} | !(p{q})"),
            format!("p{p} <= {tokens} & p{q} != {tokens}"),
            format!("p{p} >= {tokens} & p{q} >= 2 & p0 >= 1"),
        ] {
            let question = Question::parse(&text, &model).unwrap();
            let holds = |m: &Marking| {
                let (p, q) = (m[p], m[q]);
                match text.as_bytes() {
                    t if t.windows(2).any(|w| w == b"!=") => p <= tokens && q != tokens,
                    t if t.contains(&b'|') => p == tokens || q == 0,
                    t if t.windows(3).any(|w| w == b"p0 ") && text.matches('&').count() == 2 => p >= tokens && q >= 2 && m[0] >= 1,
                    _ => p >= tokens && q >= 1,
                }
            };
            let any = all.markings.iter().any(holds);
            match question.can_be(&found) {
                Answer::Witness(witness) => {
                    prop_assert!(any && holds(&witness.marking));
                    prop_assert_eq!(model.replay(&witness.sequence), Some(witness.marking));
                }
                Answer::Proved(because) => {
                    prop_assert!(!any, "{}", text);
                    if let Because::Invariant(weights) = because {
                        let sum = |m: &Marking| weights.iter().map(|(p, w)| w * u64::from(m[*p as usize])).sum::<u64>();
                        prop_assert!(all.markings.iter().all(|m| sum(m) == sum(&all.markings[0])));
                    }
                }
                Answer::Unknown => prop_assert!(false, "{} is not answered", text),
            }
            let count = all.markings.len();
            let stays = (0..count).all(|m| (0..count).any(|to| reach[m][to] && holds(&all.markings[to])));
            match question.stays_possible(&found, usize::MAX) {
                Answer::Witness(witness) => {
                    prop_assert!(!stays);
                    prop_assert_eq!(model.replay(&witness.sequence), Some(witness.marking.clone()));
                    let from = all.markings.iter().position(|m| *m == witness.marking).unwrap();
                    prop_assert!(!(0..count).any(|to| reach[from][to] && holds(&all.markings[to])));
                }
                Answer::Proved(_) => prop_assert!(stays),
                Answer::Unknown => prop_assert!(false, "{} is not answered", text),
            }
        }
    }

    #[test]
    fn invariants_and_siphons_say_what_holds_at_every_marking(model in any_model()) {
        let arcs = Arcs::of(&model);
        let invariants = semiflows::place_invariants(&model, 2_000);
        let (siphons, traps) = (siphons::minimal_siphons(&arcs, 2_000), siphons::minimal_traps(&arcs, 2_000));
        let Some(all) = all(&model) else { return Ok(()) };
        for weights in invariants.iter().flatten() {
            let sum = |m: &Marking| weights.iter().zip(m).map(|(w, t)| w * u64::from(*t)).sum::<u64>();
            prop_assert!(all.markings.iter().all(|m| sum(m) == sum(&all.markings[0])));
        }
        let bounds = semiflows::bounds(&model, invariants.as_deref().unwrap_or_default());
        for (place, bound) in bounds.iter().enumerate() {
            let most = all.markings.iter().map(|m| u64::from(m[place])).max();
            prop_assert!(bound.is_none_or(|bound| Some(bound) >= most));
        }
        let holds = |set: &[usize], m: &Marking| set.iter().any(|place| m[*place] > 0);
        let resets = model.transitions.iter().any(|t| !t.resets.is_empty());
        for (from, edges) in all.markings.iter().zip(&all.edges) {
            for to in edges.values().map(|to| &all.markings[*to]) {
                // A siphon without tokens gets none; a trap with tokens keeps one, where nothing is emptied
                // and every arc takes one.
                for siphon in siphons.iter().flatten() {
                    prop_assert!(holds(siphon, from) || !holds(siphon, to), "siphon {:?}", siphon);
                }
                for trap in traps.iter().flatten().filter(|_| !resets) {
                    prop_assert!(!holds(trap, from) || holds(trap, to), "trap {:?}", trap);
                }
            }
        }
    }

    #[test]
    fn growth_and_cover_are_true_of_the_markings_that_can_be_found(model in any_model()) {
        let found = explore(&model, &Limits { markings: 3_000, ..Limits::default() });
        if let Some(growth) = &found.growth {
            // Again and again: the round adds to the place each time.
            let mut marking = model.initial();
            let mut held = Vec::new();
            for transition in &growth.lead {
                marking = fire(&model, &model.transitions[*transition as usize], &marking).unwrap();
            }
            for _ in 0..5 {
                held.push(marking[growth.place as usize]);
                for transition in &growth.cycle {
                    let (may, _) = firings(&model, &marking);
                    marking = may.get(&(*transition as usize)).cloned().unwrap();
                }
            }
            prop_assert!(held.is_sorted_by(|a, b| a < b));
            prop_assert_eq!(found.stopped, Some(Stopped::Growth));
        }
        if !cover::fits(&model) {
            return Ok(());
        }
        let Some(cover) = cover::cover(&model, 20_000) else { return Ok(()) };
        match all(&model) {
            Some(all) => {
                for (place, bound) in cover.bounds().iter().enumerate() {
                    let most = all.markings.iter().map(|m| m[place]).max().unwrap();
                    prop_assert_eq!(*bound, Tokens::Exactly(most));
                }
                for marking in &all.markings {
                    let wanted: Vec<_> = (0..).zip(marking.iter().copied()).collect();
                    prop_assert!(cover.can_cover(&wanted));
                }
            }
            None => prop_assert!(found.growth.is_none() || cover.unbounded().next().is_some()),
        }
    }
}
