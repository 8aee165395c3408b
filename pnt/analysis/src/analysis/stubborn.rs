//! Whether anything is dead, by stubborn sets. At each marking only some of the enabled transitions are
//! fired, chosen so that any firings of the others are possible afterwards just as well. Every dead marking
//! is still reached; most of the markings between are not. (Valmari 1989; the strong sets, with the enabled
//! transition that gives the fewest.)
//!
//! For dead markings nothing need be done about transitions that are put off for ever. One of the fired ones
//! stays possible until it is fired, so a dead marking cannot be reached without it.

use std::mem;

use super::{
    explicit::{Limits, Progress, Stopped},
    layout::{Layout, bits_for, linear},
    model::{Model, PlaceNumber, TransitionNumber, Weighted},
    store::{self, Share, Store},
};

/// Markings looked at between two looks at the limits.
const CHUNK: usize = 1 << 10;

/// What a search found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Markings that were looked at: some of the reachable ones.
    pub markings: usize,
    /// A firing sequence to a dead marking, and that marking.
    pub deadlock: Option<(Vec<TransitionNumber>, Vec<u32>)>,
    /// Why the search ended before it had an answer.
    pub stopped: Option<Stopped>,
    /// Bytes for markings and what finds them, at most at any time.
    pub peak_bytes: usize,
}

/// Whether the search says anything about a model: not where priorities or enabling functions decide what
/// may fire.
#[must_use]
pub fn applies(model: &Model) -> bool {
    !model.has_priorities() && model.transitions.iter().all(|t| t.when.is_none())
}

/// Looks for a marking at which nothing is enabled, until one is found or there is none.
#[must_use]
pub fn deadlock(model: &Model, limits: &Limits) -> Found {
    deadlock_with(model, limits, &mut |_| {})
}

/// The same; `progress` is called from time to time.
#[must_use]
pub fn deadlock_with(model: &Model, limits: &Limits, progress: &mut dyn FnMut(&Progress)) -> Found {
    let rules = Rules::new(model);
    let mut search = Search::new(model);
    let mut scratch = Scratch::default();
    let mut marking = Vec::new();
    let mut expanded = 0_usize;
    // The latest first: a search for one dead marking comes to the ends sooner than to all of the middle.
    while let Some(at) = search.open.pop() {
        search.store.read(at, &mut search.packed);
        search.layout.unpack(&search.packed, &mut marking);
        let fired = rules.stubborn(&marking, &mut scratch);
        if fired.is_empty() {
            let deadlock = Some((search.path(at), marking));
            return search.found(deadlock, None);
        }
        for transition in fired {
            let Some(to) = rules.fire(transition, &marking) else {
                return search.found(None, Some(Stopped::Tokens(0)));
            };
            search.insert(&to, (at, transition));
        }
        expanded += 1;
        if search.parents.len() > limits.markings {
            return search.found(None, Some(Stopped::Markings));
        }
        if limits.stop.is_set() {
            return search.found(None, Some(Stopped::Stop));
        }
        if search.bytes_soon() > limits.bytes || search.parents.len() + 1 >= store::MOST {
            return search.found(None, Some(Stopped::Bytes));
        }
        if expanded.is_multiple_of(CHUNK) {
            search.peak = search.peak.max(search.bytes());
            progress(&Progress {
                markings: search.parents.len(),
                expanded,
                level: search.path(at).len(),
                bytes: search.bytes(),
                for_deadlock: true,
            });
        }
    }
    search.found(None, None)
}

/// The markings so far, packed to the bits that each place needs.
struct Search {
    layout: Layout,
    store: Store,
    share: Share,
    /// Those whose firings are still to be looked at.
    open: Vec<u32>,
    /// From which marking, by which transition, each was reached first.
    parents: Vec<(u32, TransitionNumber)>,
    packed: Vec<u64>,
    /// Bytes at most so far, but for what the store knows itself.
    peak: usize,
}

impl Search {
    fn new(model: &Model) -> Self {
        let initial = model.initial();
        let bits: Vec<u32> = initial.iter().map(|tokens| bits_for(*tokens)).collect();
        let layout = Layout::new(&bits);
        let mut search = Self {
            store: Store::new(layout.words),
            share: Share::default(),
            layout,
            open: Vec::new(),
            parents: Vec::new(),
            packed: Vec::new(),
            peak: 0,
        };
        search.insert(&initial, (0, 0));
        search
    }

    /// Keeps a marking, if it is new.
    fn insert(&mut self, marking: &[u32], parent: (u32, TransitionNumber)) {
        self.make_room(marking);
        self.layout.pack(marking, &mut self.packed);
        let (number, new) = self
            .store
            .insert(&mut self.share, &self.packed, linear(&self.packed));
        if new {
            self.parents.push(parent);
            self.open.push(number);
        }
    }

    /// Widens the fields that a marking does not fit into. Markings keep their numbers.
    fn make_room(&mut self, marking: &[u32]) {
        let fields = || self.layout.fields.iter().zip(marking);
        if fields().all(|(field, tokens)| *tokens <= field.most()) {
            return;
        }
        let wider = self.layout.bits().into_iter().zip(marking);
        let wider: Vec<u32> = wider.map(|(bits, n)| bits.max(bits_for(*n))).collect();
        let layout = Layout::new(&wider);
        let store = self.store.repacked(&self.layout, &layout);
        // That knows of both stores, and this of the lists beside them.
        self.peak = self.peak.max(self.bytes() + store.bytes());
        self.layout = layout;
        self.store = store;
    }

    fn bytes(&self) -> usize {
        self.store.bytes()
            + self.parents.capacity() * mem::size_of::<(u32, TransitionNumber)>()
            + self.open.capacity() * mem::size_of::<u32>()
    }

    /// Bytes when the table or a list grows next.
    fn bytes_soon(&self) -> usize {
        // A list that is full is copied into one of twice its size.
        let parents = self.parents.capacity() * mem::size_of::<(u32, TransitionNumber)>();
        let nearly = self.parents.len() + self.parents.len() / 64 >= self.parents.capacity();
        let lists = self.bytes() - self.store.bytes() + if nearly { 2 * parents } else { 0 };
        let soon = self.parents.len() / 32 + 64;
        let store = self.store.bytes_with(soon).unwrap_or(usize::MAX);
        store.saturating_add(lists)
    }

    fn path(&self, at: u32) -> Vec<TransitionNumber> {
        let mut path = Vec::new();
        let mut at = at as usize;
        while at != 0 {
            let (from, transition) = self.parents[at];
            path.push(transition);
            at = from as usize;
        }
        path.reverse();
        path
    }

    fn found(
        &self,
        deadlock: Option<(Vec<TransitionNumber>, Vec<u32>)>,
        stopped: Option<Stopped>,
    ) -> Found {
        Found {
            markings: self.parents.len(),
            deadlock,
            stopped,
            peak_bytes: self.peak.max(self.store.peak()).max(self.bytes()),
        }
    }
}

/// What one transition needs, and does.
struct Fact {
    needs: Vec<Weighted>,
    forbids: Vec<Weighted>,
    changes: Vec<(PlaceNumber, i64)>,
    resets: Vec<Weighted>,
    /// Transitions that it can disable, or that can disable it, or that do not come to the same in
    /// another order.
    conflicts: Vec<TransitionNumber>,
}

/// A model, prepared.
struct Rules {
    facts: Vec<Fact>,
    /// Per place, the transitions that may leave it with more, and with fewer tokens.
    raised_by: Vec<Vec<TransitionNumber>>,
    lowered_by: Vec<Vec<TransitionNumber>>,
}

/// Memory for one set.
#[derive(Default)]
struct Scratch {
    member: Vec<bool>,
    set: Vec<TransitionNumber>,
    enabled: Vec<TransitionNumber>,
}

impl Fact {
    fn raises(&self, place: PlaceNumber) -> bool {
        self.changes
            .iter()
            .any(|(p, change)| *p == place && *change > 0)
            || self.resets.iter().any(|(p, left)| *p == place && *left > 0)
    }

    fn lowers(&self, place: PlaceNumber) -> bool {
        self.changes
            .iter()
            .any(|(p, change)| *p == place && *change < 0)
            || self.resets.iter().any(|(p, _)| *p == place)
    }

    fn touches(&self, place: PlaceNumber) -> bool {
        let mut all = self.needs.iter().chain(&self.forbids).chain(&self.resets);
        all.any(|(p, _)| *p == place) || self.changes.iter().any(|(p, _)| *p == place)
    }

    fn is_enabled(&self, marking: &[u32]) -> bool {
        let held = |place: &PlaceNumber| marking[*place as usize];
        self.needs
            .iter()
            .all(|(place, weight)| held(place) >= *weight)
            && self
                .forbids
                .iter()
                .all(|(place, weight)| held(place) < *weight)
    }

    /// Whether the other one can disable this one, or they do not come to the same in another order.
    fn depends_on(&self, other: &Self) -> bool {
        self.needs.iter().any(|(place, _)| other.lowers(*place))
            || self.forbids.iter().any(|(place, _)| other.raises(*place))
            || self.resets.iter().any(|(place, _)| other.touches(*place))
    }
}

impl Rules {
    fn new(model: &Model) -> Self {
        let mut facts: Vec<Fact> = model
            .transitions
            .iter()
            .map(|t| Fact {
                needs: t.needs(),
                forbids: t.forbids(&model.places),
                changes: t.changes(),
                resets: t.after_reset(),
                conflicts: Vec::new(),
            })
            .collect();
        let conflicts: Vec<Vec<TransitionNumber>> = facts
            .iter()
            .map(|one| {
                let with = |other: &Fact| one.depends_on(other) || other.depends_on(one);
                let others = (0..).zip(&facts).filter(|(_, other)| with(other));
                others.map(|(number, _)| number).collect()
            })
            .collect();
        for (fact, conflicts) in facts.iter_mut().zip(conflicts) {
            fact.conflicts = conflicts;
        }
        let those = |does: fn(&Fact, PlaceNumber) -> bool| {
            let of = |place: PlaceNumber| {
                let all = (0..).zip(&facts).filter(|(_, fact)| does(fact, place));
                all.map(|(number, _)| number)
                    .collect::<Vec<TransitionNumber>>()
            };
            (0..)
                .zip(&model.places)
                .map(|(place, _)| of(place))
                .collect()
        };
        Self {
            raised_by: those(Fact::raises),
            lowered_by: those(Fact::lowers),
            facts,
        }
    }

    /// Those of the enabled transitions that are to be fired at a marking; none if nothing is enabled.
    fn stubborn(&self, marking: &[u32], scratch: &mut Scratch) -> Vec<TransitionNumber> {
        let numbered = (0..).zip(&self.facts);
        let enabled = numbered.filter(|(_, fact)| fact.is_enabled(marking));
        let enabled: Vec<TransitionNumber> = enabled.map(|(number, _)| number).collect();
        let mut best: Option<Vec<TransitionNumber>> = None;
        for key in &enabled {
            let most = best.as_ref().map_or(usize::MAX, Vec::len);
            if self.close(*key, marking, most, scratch) {
                best = Some(mem::take(&mut scratch.enabled));
            }
            if best.as_ref().is_some_and(|best| best.len() == 1) {
                break;
            }
        }
        best.unwrap_or_default()
    }

    /// The smallest set that is stubborn and has `key`; whether it has fewer enabled transitions than
    /// `most`.
    fn close(
        &self,
        key: TransitionNumber,
        marking: &[u32],
        most: usize,
        scratch: &mut Scratch,
    ) -> bool {
        let Scratch {
            member,
            set,
            enabled,
        } = scratch;
        member.clear();
        member.resize(self.facts.len(), false);
        set.clear();
        enabled.clear();
        member[key as usize] = true;
        set.push(key);
        let mut next = 0;
        while let Some(number) = set.get(next).copied() {
            next += 1;
            let fact = &self.facts[number as usize];
            let with = if fact.is_enabled(marking) {
                enabled.push(number);
                if enabled.len() >= most {
                    return false;
                }
                &fact.conflicts
            } else {
                self.needed_first(fact, marking)
            };
            for other in with {
                if !mem::replace(&mut member[*other as usize], true) {
                    set.push(*other);
                }
            }
        }
        true
    }

    /// Transitions without one of which a disabled one stays disabled: of the places that keep it from
    /// firing, the one that fewest can mend.
    fn needed_first(&self, fact: &Fact, marking: &[u32]) -> &[TransitionNumber] {
        let held = |place: &PlaceNumber| marking[*place as usize];
        let short = fact
            .needs
            .iter()
            .filter(|(place, weight)| held(place) < *weight);
        let short = short.map(|(place, _)| &self.raised_by[*place as usize]);
        let full = fact
            .forbids
            .iter()
            .filter(|(place, weight)| held(place) >= *weight);
        let full = full.map(|(place, _)| &self.lowered_by[*place as usize]);
        let fewest = short.chain(full).min_by_key(|those| those.len());
        fewest.map_or(&[], Vec::as_slice)
    }

    /// The marking after a firing; `None` when a place would hold more than 32 bits can say.
    fn fire(&self, transition: TransitionNumber, marking: &[u32]) -> Option<Vec<u32>> {
        let fact = &self.facts[transition as usize];
        let mut after = marking.to_vec();
        for (place, change) in &fact.changes {
            let tokens = &mut after[*place as usize];
            *tokens = u32::try_from(i64::from(*tokens) + change).ok()?;
        }
        for (place, left) in &fact.resets {
            after[*place as usize] = *left;
        }
        Some(after)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::analysis::{
        explicit::explore,
        samples::{buffer, kanban, model, philosophers, random_model},
    };

    fn all() -> Limits {
        Limits {
            markings: usize::MAX,
            ..Limits::default()
        }
    }

    #[test]
    fn philosophers_are_found_dead_among_few_of_their_markings() {
        for count in [8_usize, 10] {
            let model = philosophers(count);
            let found = deadlock(&model, &all());
            let (path, marking) = found.deadlock.unwrap();
            assert_eq!(model.replay(&path), Some(marking.clone()));
            let numbers = 0..TransitionNumber::try_from(model.transitions.len()).unwrap();
            assert!(numbers.into_iter().all(|t| !model.is_enabled(t, &marking)));
            let full = explore(&model, &all()).markings;
            assert!(10 * found.markings < full, "{} of {full}", found.markings);
        }
    }

    /// Independent lines of steps that all come back. n steps each in turn suffice, of n to the power
    /// of their number.
    #[test]
    fn what_has_nothing_to_do_with_each_other_is_looked_at_one_after_the_other() {
        use std::fmt::Write as _;
        let mut text = String::from("net lines\n");
        for line in 0..8 {
            let _ = writeln!(text, "place a{line} = 1, b{line}, c{line}");
            for (name, from, to) in [("f", "a", "b"), ("g", "b", "c")] {
                let _ = writeln!(
                    text,
                    "transition {name}{line}\n  in {from}{line}\n  out {to}{line}"
                );
            }
        }
        let model = model(&text);
        let found = deadlock(&model, &all());
        assert_eq!(explore(&model, &all()).markings, 3_usize.pow(8));
        assert_eq!(found.markings, 2 * 8 + 1);
        assert_eq!(found.deadlock.unwrap().0.len(), 16);
    }

    #[test]
    fn nets_of_the_literature_without_a_deadlock_have_none() {
        for model in [buffer(3), kanban(1), kanban(2)] {
            let found = deadlock(&model, &all());
            assert_eq!((found.deadlock, found.stopped), (None, None));
            assert!(found.markings <= explore(&model, &all()).markings);
        }
    }

    #[test]
    fn a_limit_ends_the_search_without_an_answer() {
        let model = kanban(2);
        let limits = Limits {
            markings: 10,
            ..Limits::default()
        };
        let found = deadlock(&model, &limits);
        assert_eq!(
            (found.deadlock, found.stopped),
            (None, Some(Stopped::Markings))
        );
        let limits = Limits {
            bytes: 100,
            ..Limits::default()
        };
        assert_eq!(deadlock(&model, &limits).stopped, Some(Stopped::Bytes));
    }

    #[test]
    fn a_long_search_tells_how_far_it_is_and_keeps_its_markings_packed() {
        let model = buffer(5_000);
        let mut told: Vec<Progress> = Vec::new();
        let found = deadlock_with(&model, &all(), &mut |progress| told.push(*progress));
        assert_eq!((found.deadlock, found.stopped), (None, None));
        assert!(told.len() > 2 && told.iter().all(|progress| progress.for_deadlock));
        let numbers = told.windows(2);
        assert!(
            numbers
                .into_iter()
                .all(|pair| pair[0].markings <= pair[1].markings)
        );
        // A word for the marking, a parent, and an entry in a table and in the list of those to be
        // looked at. Lists and tables grow by doubling.
        assert!(
            found.peak_bytes < 64 * found.markings,
            "{} bytes for {}",
            found.peak_bytes,
            found.markings
        );
        let limits = Limits {
            bytes: found.peak_bytes / 4,
            ..all()
        };
        let few = deadlock(&model, &limits);
        assert_eq!(few.stopped, Some(Stopped::Bytes));
        assert!(few.peak_bytes <= limits.bytes, "{few:?}");
    }

    #[test]
    fn a_place_that_holds_more_and_more_gets_wider_and_the_way_stays_the_same() {
        let model = model(
            "net n\nplace a = 3000, b, c\ntransition t\n  in a\n  out b*3\ntransition u\n  in b*9000\n  out c\n",
        );
        let (path, marking) = deadlock(&model, &all()).deadlock.unwrap();
        assert_eq!(path.len(), 3001);
        assert_eq!(model.replay(&path), Some(marking));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        #[test]
        fn there_is_a_deadlock_exactly_if_the_full_search_finds_one(model in random_model()) {
            let limits = Limits { markings: 2000, ..Limits::default() };
            let full = explore(&model, &limits);
            if !full.complete() {
                return Ok(());
            }
            let found = deadlock(&model, &limits);
            prop_assert_eq!(found.stopped, None);
            prop_assert!(found.markings <= full.markings);
            prop_assert_eq!(found.deadlock.is_some(), full.dead_count > 0);
            if let Some((path, marking)) = found.deadlock {
                prop_assert_eq!(model.replay(&path), Some(marking.clone()));
                prop_assert!(full.dead.iter().any(|dead| dead.marking == marking));
            }
        }
    }
}
