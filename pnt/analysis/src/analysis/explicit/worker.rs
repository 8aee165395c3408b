//! What one thread does: it expands markings of a level, and keeps what it finds in the store that all
//! threads share.

use std::{
    collections::BTreeMap,
    mem,
    ops::Range,
    sync::atomic::{AtomicBool, AtomicUsize, Ordering},
};

use super::{
    super::{
        compare::{Compare, at_most},
        layout::linear,
        model::{PlaceNumber, TransitionNumber},
        store::{BATCH, Share, Store},
    },
    reached::{DEAD_KEPT, Reached},
    rules::{Rules, Scratch},
};

/// A firing would put more into a place than its field holds. `u32::MAX` tokens stand for more than
/// 32 bits can say.
#[derive(Debug)]
pub(super) struct TooWide {
    pub(super) place: PlaceNumber,
    pub(super) tokens: u32,
}

/// Markings that a thread takes of a level at once. Fewer in tests, so that threads have to share small nets.
const PART: u32 = if cfg!(test) { 1 } else { 128 };

/// A place, and how many bits its tokens need.
pub(super) type Record = (PlaceNumber, u32);

/// A counter with two cache lines of its own, since a processor fetches the second one with the first. So who
/// writes to it takes no other's line away.
#[repr(align(128))]
pub(super) struct Padded<T>(pub(super) T);

/// What is left of a level: for each thread those parts that it found itself, and are best in its cache.
#[derive(Default)]
pub(super) struct Queue {
    lists: Vec<List>,
}

struct List {
    parts: Vec<Range<u32>>,
    taken: Padded<AtomicUsize>,
}

impl Queue {
    /// The markings of a level, by the worker that found them.
    pub(super) fn new(level: &[Vec<Range<u32>>]) -> Self {
        let cut = |range: &Range<u32>| {
            let end = range.end;
            let starts = range.clone().step_by(PART as usize);
            starts.map(move |start| start..end.min(start.saturating_add(PART)))
        };
        let list = |found: &Vec<Range<u32>>| List {
            parts: found.iter().flat_map(cut).collect(),
            taken: Padded(AtomicUsize::new(0)),
        };
        Self {
            lists: level.iter().map(list).collect(),
        }
    }

    /// A part for a thread: of its own, or else of another's. Only the counter decides who has it.
    fn take(&self, own: usize) -> Option<Range<u32>> {
        let (before, from) = self.lists.split_at_checked(own)?;
        from.iter().chain(before).find_map(|list| {
            if list.taken.0.load(Ordering::Relaxed) >= list.parts.len() {
                return None;
            }
            let at = list.taken.0.fetch_add(1, Ordering::Relaxed);
            list.parts.get(at).cloned()
        })
    }

    /// How many markings are in parts that nobody has taken.
    pub(super) fn left(&self) -> usize {
        let lists = self.lists.iter();
        lists
            .flat_map(|list| list.parts.iter().skip(list.taken.0.load(Ordering::Relaxed)))
            .map(|part| part.len())
            .sum()
    }
}

/// What all threads see of a round.
pub(super) struct Round<'a> {
    pub(super) rules: &'a Rules,
    pub(super) store: &'a Store,
    pub(super) queue: &'a Queue,
    pub(super) level: usize,
    /// Markings that each expands at most, but for the rest of a part.
    pub(super) chunk: usize,
    /// Whether only one thread takes part.
    pub(super) alone: bool,
    /// Markings found, and the most there may be.
    pub(super) found: &'a AtomicUsize,
    pub(super) most: usize,
    /// The most numbers that memory permits.
    pub(super) most_numbers: usize,
    /// All stop as soon as they can: a thread has no numbers left, or there are too many markings. None reads
    /// by this what another wrote.
    pub(super) stop: Padded<AtomicBool>,
}

/// What the markings of a level, or of several, tell.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub(super) edges: u64,
    /// Dead markings: of those that are as far as each other the least, and not many more than are kept.
    pub(super) dead: Vec<Reached>,
    /// Where as many as are kept are less than this one.
    worst_dead: Option<Reached>,
    pub(super) dead_count: u64,
    pub(super) seen: Vec<bool>,
    /// Conditions, by bits, all of whose transitions are noted as seen.
    seen_bits: u64,
    pub(super) most_tokens: u64,
}

impl Tally {
    pub(super) fn new(transitions: usize) -> Self {
        Self {
            seen: vec![false; transitions],
            ..Self::default()
        }
    }

    /// Adds what one thread has seen of the level that follows, and leaves it nothing.
    pub(super) fn add(&mut self, other: &mut Self) {
        self.edges += mem::take(&mut other.edges);
        self.dead_count += mem::take(&mut other.dead_count);
        self.most_tokens = self.most_tokens.max(other.most_tokens);
        for (all, own) in self.seen.iter_mut().zip(&mut other.seen) {
            *all |= mem::take(own);
        }
        self.dead.append(&mut other.dead);
        other.worst_dead = None;
        other.seen_bits = 0;
    }

    /// Leaves out dead markings that are too many.
    pub(super) fn cut_dead(&mut self) {
        self.dead.sort_unstable();
        self.dead.truncate(DEAD_KEPT);
    }

    /// Notes what is enabled at a marking.
    fn note_enabled(&mut self, scratch: &Scratch) {
        self.edges += scratch.enabled.len() as u64;
        let bits = scratch.bits.unwrap_or(u64::MAX);
        if bits & !self.seen_bits == 0 && scratch.bits.is_some() {
            return;
        }
        self.seen_bits |= scratch.bits.unwrap_or(0);
        for number in &scratch.enabled {
            self.seen[*number as usize] = true;
        }
    }

    fn note_dead(&mut self, distance: usize, marking: &[u32]) {
        self.dead_count += 1;
        let worst = self.worst_dead.as_ref();
        if worst.is_some_and(|worst| worst.marking.as_slice() <= marking) {
            return;
        }
        self.dead.push(Reached {
            distance,
            marking: marking.to_vec(),
        });
        if self.dead.len() >= 2 * DEAD_KEPT {
            self.cut_dead();
            self.worst_dead = self.dead.last().cloned();
        }
    }
}

pub(super) struct Worker {
    pub(super) number: usize,
    pub(super) share: Share,
    /// What of its part it has not expanded.
    pub(super) part: Range<u32>,
    pub(super) expanded: usize,
    pub(super) tally: Tally,
    /// The most tokens that it has seen in each place, or others in the levels before.
    pub(super) bounds: Vec<u32>,
    /// The bounds of all threads at the end of the level before.
    known_at: Vec<u32>,
    /// Markings of this level in which a place needs more bits than in all levels before: where to look for
    /// growth. Of several the least, so that it does not matter who finds them.
    pub(super) records: BTreeMap<Record, Vec<u32>>,
    /// Per place, the most tokens that are no record.
    no_record: Vec<u32>,
    /// Hold for markings by which neither bounds nor records change.
    nothing_new: Vec<Compare>,
    scratch: Scratch,
    from: Vec<u64>,
    /// Successors that are not yet in the store, packed, and their sums.
    successors: Vec<u64>,
    sums: Vec<u64>,
    recent: Recent,
    /// Per transition, whether one of its gains may not fit: a place has been so full already that it
    /// must be looked at.
    tight: Vec<bool>,
    any_tight: bool,
}

/// Pairs of a count of markings and a count of words. From so many markings on, a table of those found a
/// moment ago pays. It has so many words: as many as a processor keeps near. Fewer in tests, so that small
/// nets come to it.
const RECENT: [(usize, usize); 2] = if cfg!(test) {
    [(8, 16), (64, 64)]
} else {
    [(1 << 12, 1 << 13), (1 << 15, 1 << 16)]
};

/// Markings of one word that were found a moment ago. Most successors have just been found from another
/// marking; for those the table need not be asked.
#[derive(Default)]
struct Recent {
    words: Vec<u64>,
}

/// Where a marking with this [`linear`] sum stands in a table of so many words, a power of two. It takes
/// upper bits: in a product the lower bits take part in all of them.
fn recent_place(sum: u64, words: usize) -> usize {
    (sum >> 48) as usize & (words - 1)
}

impl Recent {
    /// So many markings are found.
    fn at(&mut self, found: usize) {
        let pays = RECENT.iter().rev().find(|(from, _)| found >= *from);
        let words = pays.map_or(0, |(_, words)| *words);
        if self.words.len() < words {
            self.words.clear();
            self.words.resize(words, u64::MAX);
        }
    }

    /// Whether a marking was found a moment ago; it is now.
    fn has(&mut self, marking: &[u64], sum: u64) -> bool {
        let ([word], false) = (marking, self.words.is_empty()) else {
            return false;
        };
        let at = recent_place(sum, self.words.len());
        let there = self.words[at] == *word && *word != u64::MAX;
        self.words[at] = *word;
        there
    }
}

/// Adds those of some markings of one word, with their sums, that were not found a moment ago. Which they are
/// cannot be foreseen, so nothing is jumped over.
fn push_new(
    markings: impl ExactSizeIterator<Item = (u64, u64)>,
    recent: &mut [u64],
    successors: &mut Vec<u64>,
    sums: &mut Vec<u64>,
) {
    let (start, words) = (successors.len(), recent.len());
    let most = start + markings.len();
    successors.resize(most, 0);
    sums.resize(most, 0);
    let mut count = start;
    for (word, sum) in markings {
        successors[count] = word;
        sums[count] = sum;
        let before = mem::replace(&mut recent[recent_place(sum, words)], word);
        count += usize::from(before != word || word == u64::MAX);
    }
    successors.truncate(count);
    sums.truncate(count);
}

impl Worker {
    pub(super) fn new(number: usize, rules: &Rules) -> Self {
        let places = rules.layout.fields.len();
        Self {
            number,
            share: Share::default(),
            part: 0..0,
            expanded: 0,
            tally: Tally::new(rules.packed.len()),
            bounds: vec![0; places],
            known_at: vec![0; places],
            records: BTreeMap::new(),
            no_record: vec![1; places],
            nothing_new: at_most(&rules.layout, &vec![0; places]),
            scratch: Scratch::default(),
            from: Vec::new(),
            successors: Vec::new(),
            sums: Vec::new(),
            recent: Recent::default(),
            tight: vec![true; rules.packed.len()],
            any_tight: true,
        }
    }

    pub(super) fn bytes(&self) -> usize {
        self.recent.words.len() * 8
    }

    /// Successors that wait for numbers.
    pub(super) fn waiting(&self) -> usize {
        self.sums.len()
    }

    /// Expands parts of the level until a chunk is done, the level is, or the round stops.
    pub(super) fn work(&mut self, round: &Round<'_>) -> Result<(), TooWide> {
        let until = self.expanded.saturating_add(round.chunk);
        loop {
            if self.sums.len() >= BATCH {
                self.keep(round);
            }
            if round.stop.0.load(Ordering::Relaxed) {
                return Ok(());
            }
            if self.part.is_empty() {
                if self.expanded >= until {
                    break;
                }
                match round.queue.take(self.number) {
                    Some(part) => self.part = part,
                    None => break,
                }
            }
            self.expand_one(round, self.part.start)?;
            self.part.start += 1;
            self.expanded += 1;
        }
        self.keep(round);
        Ok(())
    }

    /// Puts the successors into the store. They wait where there are no numbers for them; then the round stops.
    pub(super) fn keep(&mut self, round: &Round<'_>) {
        let needed = self.sums.len();
        if needed == 0 {
            return;
        }
        let share = &mut self.share;
        if share.left() < needed
            && (round.alone || !round.store.take(share, needed, round.most_numbers))
        {
            round.stop.0.store(true, Ordering::Relaxed);
            return;
        }
        let found = self.settle(round.store, round.found, round.alone);
        if found > round.most {
            round.stop.0.store(true, Ordering::Relaxed);
        }
        self.recent.at(found);
    }

    /// Puts the successors into the store, where there are numbers for them. Markings found then.
    pub(super) fn settle(&mut self, store: &Store, found: &AtomicUsize, alone: bool) -> usize {
        if self.sums.is_empty() {
            return found.load(Ordering::Relaxed);
        }
        let new = store.insert_all(&mut self.share, &self.successors, &self.sums, alone);
        self.drop_waiting();
        found.fetch_add(new, Ordering::Relaxed) + new
    }

    /// Forgets the successors that wait.
    pub(super) fn drop_waiting(&mut self) {
        self.successors.clear();
        self.sums.clear();
    }

    fn expand_one(&mut self, round: &Round<'_>, number: u32) -> Result<(), TooWide> {
        let rules = round.rules;
        round.store.read(number, &mut self.from);
        rules.enabled(&self.from, &mut self.scratch);
        self.note_tokens(rules);
        self.check_room(rules)?;
        if rules.is_dead(&self.scratch) {
            rules.layout.unpack(&self.from, &mut self.scratch.marking);
            self.tally.note_dead(round.level, &self.scratch.marking);
        }
        self.tally.note_enabled(&self.scratch);
        self.fire(rules);
        Ok(())
    }

    /// Of some markings, the first place that would hold more than 32 bits can say.
    pub(super) fn overflow(
        &mut self,
        rules: &Rules,
        store: &Store,
        numbers: impl Iterator<Item = u32>,
    ) -> Option<PlaceNumber> {
        let wide = numbers.filter_map(|number| {
            store.read(number, &mut self.from);
            rules.enabled(&self.from, &mut self.scratch);
            self.check_room(rules).err()
        });
        let overflows = wide.filter(|wide| wide.tokens == u32::MAX);
        overflows.map(|wide| wide.place).min()
    }

    /// Fires all that is enabled.
    fn fire(&mut self, rules: &Rules) {
        let sum = linear(&self.from);
        let (from, recent) = (self.from.as_slice(), &mut self.recent);
        if let ([word], Some(steps)) = (from, &rules.steps) {
            let each = self.scratch.enabled.iter().map(|number| {
                let (add, more) = steps[*number as usize];
                (word.wrapping_add(add), sum.wrapping_add(more))
            });
            if recent.words.is_empty() {
                self.successors.extend(each.clone().map(|(to, _)| to));
                self.sums.extend(each.map(|(_, sum)| sum));
            } else {
                push_new(
                    each,
                    &mut recent.words,
                    &mut self.successors,
                    &mut self.sums,
                );
            }
            return;
        }
        for number in &self.scratch.enabled {
            let transition = &rules.packed[*number as usize];
            let start = self.successors.len();
            let sum = transition.fire_onto(&rules.layout, from, sum, &mut self.successors);
            if recent.has(&self.successors[start..], sum) {
                self.successors.truncate(start);
            } else {
                self.sums.push(sum);
            }
        }
    }

    fn check_room(&self, rules: &Rules) -> Result<(), TooWide> {
        if !self.any_tight || rules.all_have_room(&self.from, &self.scratch) {
            return Ok(());
        }
        let tight = |number: &&TransitionNumber| self.tight[**number as usize];
        for number in self.scratch.enabled.iter().filter(tight) {
            let transition = &rules.packed[*number as usize];
            if transition.resets.is_empty() && rules.has_room(*number, &self.from) {
                continue;
            }
            let gained = transition.gains.iter().map(|(place, gain)| {
                let held = rules.layout.fields[*place as usize].get(&self.from);
                (*place, held.saturating_add(*gain))
            });
            for (place, tokens) in gained.chain(transition.resets.iter().copied()) {
                // A sum that saturates would fit, and be wrong.
                if tokens > rules.layout.fields[place as usize].most() || tokens == u32::MAX {
                    return Err(TooWide { place, tokens });
                }
            }
        }
        Ok(())
    }

    /// What a marking tells by its tokens: bounds and sums.
    fn note_tokens(&mut self, rules: &Rules) {
        let tokens = rules.sum.of(&rules.layout, &self.from);
        self.tally.most_tokens = self.tally.most_tokens.max(tokens);
        if !self.nothing_new.iter().all(|known| known.holds(&self.from)) {
            rules.layout.unpack(&self.from, &mut self.scratch.marking);
            self.note_bounds(rules);
        }
    }

    fn note_bounds(&mut self, rules: &Rules) {
        let marking = &self.scratch.marking;
        let mut wider = false;
        for (place, tokens) in (0..).zip(marking) {
            let bound = &mut self.bounds[place as usize];
            wider |= tokens > bound;
            *bound = (*bound).max(*tokens);
            if *tokens > self.no_record[place as usize] {
                let record = self.records.entry((place, tokens.ilog2()));
                let least = record.or_insert_with(|| marking.clone());
                if *marking < *least {
                    least.clone_from(marking);
                }
            }
        }
        if wider {
            self.find_known(rules);
            self.find_tight(rules);
        }
    }

    fn find_known(&mut self, rules: &Rules) {
        let each = self.bounds.iter().zip(&self.no_record);
        let known: Vec<u32> = each.map(|(bound, record)| *bound.min(record)).collect();
        self.nothing_new = at_most(&rules.layout, &known);
    }

    /// Takes over what all threads together know of a level that is done.
    pub(super) fn begin_level(&mut self, rules: &Rules, bounds: &[u32]) {
        if self.bounds == bounds && self.known_at == bounds {
            return;
        }
        self.bounds.copy_from_slice(bounds);
        self.known_at.copy_from_slice(bounds);
        self.find_tight(rules);
        for (no_record, bound) in self.no_record.iter_mut().zip(bounds) {
            // As many bits as the bound has.
            *no_record = u32::MAX
                .checked_shr(bound.leading_zeros())
                .map_or(1, |most| most.max(1));
        }
        self.find_known(rules);
    }

    /// Which transitions may put more into a place than fits, as full as places have been so far.
    fn find_tight(&mut self, rules: &Rules) {
        for (tight, transition) in self.tight.iter_mut().zip(&rules.packed) {
            let fits = |place: &PlaceNumber, tokens: u32| {
                tokens <= rules.layout.fields[*place as usize].most() && tokens < u32::MAX
            };
            let mut gained = transition.gains.iter();
            let gained = gained.all(|(place, gain)| {
                fits(place, self.bounds[*place as usize].saturating_add(*gain))
            });
            *tight = !gained || !transition.resets.is_empty();
        }
        self.any_tight = self.tight.contains(&true);
    }

    /// From here on markings are packed otherwise.
    pub(super) fn repack(&mut self, rules: &Rules) {
        if !self.recent.words.is_empty() {
            self.recent.words.fill(u64::MAX);
        }
        self.find_known(rules);
        self.find_tight(rules);
    }
}
