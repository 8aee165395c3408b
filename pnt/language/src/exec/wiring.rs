//! A net as flat arrays: what each firing adds to which counter, which conditions hang on a counter,
//! and in which order transitions are chosen. Fixed for a net.
//!
//! A counter is the tokens of a place. For a place with a capacity it is its tokens and what
//! running firings may yet put there (`filled`). Where a transition empties the place, it is that
//! second part alone (`claimed`). Others say whether a command can be read, or how many firings of
//! a transition with a limit are running. So every condition of a transition is one comparison with
//! one counter.

use std::{cmp::Reverse, collections::BTreeMap, ops::Range};

use crate::{
    net::{Net, PlaceId, Transition, TransitionId},
    timing::Servers,
};

/// A transition's condition on a counter.
#[derive(Debug, Clone, Copy)]
pub(super) struct Watch {
    /// The condition is about the counter being at least this.
    pub(super) threshold: u32,
    /// Rank of the transition.
    pub(super) rank: u32,
    /// Whether the counter must be (input, read arc) or must not (inhibitor arc, capacity).
    pub(super) wanted: bool,
}

/// Who looks at a counter.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counter {
    watches: (u32, u32),
    /// Ranks of timed transitions of which it decides how many firings may go on at once.
    servers: (u32, u32),
    /// A change that stays at or above this changes nothing for anybody.
    pub(super) quiet_from: u32,
}

/// A change of one counter, modulo 2^32.
#[derive(Debug, Clone, Copy)]
pub(super) struct Delta {
    pub(super) counter: u32,
    pub(super) by: u32,
}

/// The changes of one phase of a firing. The first ones add tokens to places without capacity, which
/// must be checked to be countable.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Changes {
    begin: u32,
    checked: u32,
    end: u32,
}

/// What firing a transition in one step needs to know.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fire {
    pub(super) changes: Changes,
    pub(super) rank: u32,
    /// Whether the changes are all of it: no action, tape, reset or remote place.
    pub(super) plain: bool,
}

/// What the phases of a firing need to know.
#[derive(Debug, Clone, Copy)]
pub(super) struct Phases {
    pub(super) start: Changes,
    pub(super) complete: Changes,
    /// The failure branch; without one, the same as `cancel`.
    pub(super) fail: Changes,
    pub(super) cancel: Changes,
    /// What a start does beside taking tokens.
    pub(super) claim: Changes,
    pub(super) within_ns: Option<u64>,
    pub(super) resets: (u32, u32),
}

/// A place that a transition empties.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reset {
    pub(super) place: PlaceId,
    pub(super) filled: Option<u32>,
    /// What the transition takes and puts there when it fires in one step.
    pub(super) takes: u32,
    pub(super) completes: u32,
}

/// Counters of a place beside its tokens.
#[derive(Debug, Clone, Copy)]
pub(super) struct Capped {
    pub(super) capacity: u32,
    pub(super) filled: u32,
    pub(super) claimed: Option<u32>,
}

#[derive(Debug)]
pub(super) struct Wiring {
    pub(super) counters: Vec<Counter>,
    watches: Vec<Watch>,
    server_ranks: Vec<u32>,
    deltas: Vec<Delta>,
    resets: Vec<Reset>,
    /// Per transition.
    pub(super) fires: Vec<Fire>,
    pub(super) phases: Vec<Phases>,
    /// Per rank: its transition. Ranks go by priority and declared order; timed transitions follow
    /// after all others.
    pub(super) at_rank: Vec<TransitionId>,
    /// Per rank: one past the last rank of the same priority.
    pub(super) class_end: Vec<u32>,
    /// Per rank: the weight in conflicts that chance decides.
    pub(super) weights: Vec<f64>,
    /// Per rank: whether it has an enabling function.
    pub(super) guards: Vec<bool>,
    /// Per rank: conditions that never hold, because weights add up to more than can be counted.
    pub(super) impossible: Vec<u32>,
    /// The first rank of a timed transition.
    pub(super) first_timed: usize,
    /// Timed transitions that have an enabling function.
    pub(super) guarded_timed: Vec<u32>,
    /// Per place, when it has a capacity.
    pub(super) capped: Vec<Option<Capped>>,
    /// Counter of the first command.
    commands: u32,
    pub(super) place_names: BTreeMap<String, PlaceId>,
}

/// Whether a transition fires by the clock. One with an action takes the time that its action takes;
/// what the net says of it is for simulation.
fn is_timed(transition: &Transition) -> bool {
    transition.action.is_none() && !transition.timing.is_immediate()
}

fn small(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

impl Wiring {
    pub(super) fn new(net: &Net) -> Self {
        Builder::new(net).build()
    }

    pub(super) fn watches(&self, counter: &Counter) -> &[Watch] {
        slice(&self.watches, counter.watches)
    }

    pub(super) fn servers(&self, counter: &Counter) -> &[u32] {
        slice(&self.server_ranks, counter.servers)
    }

    /// All changes of a phase.
    pub(super) fn deltas(&self, changes: Changes) -> &[Delta] {
        slice(&self.deltas, (changes.begin, changes.end))
    }

    /// Those that add to a place that has no capacity.
    pub(super) fn checked(&self, changes: Changes) -> &[Delta] {
        slice(&self.deltas, (changes.begin, changes.checked))
    }

    pub(super) fn resets(&self, phases: &Phases) -> &[Reset] {
        slice(&self.resets, phases.resets)
    }

    /// The counter that says whether a command can be read.
    pub(super) fn command(&self, command: usize) -> u32 {
        self.commands + small(command)
    }
}

fn slice<T>(all: &[T], (begin, end): (u32, u32)) -> &[T] {
    all.get(begin as usize..end as usize).unwrap_or(&[])
}

/// What a transition does to one place, added up.
#[derive(Debug, Clone, Copy, Default)]
struct Around {
    takes: u64,
    reads: u64,
    completes: u64,
    fails: u64,
    reset: bool,
}

impl Around {
    fn all(transition: &Transition) -> BTreeMap<PlaceId, Self> {
        let mut all: BTreeMap<PlaceId, Self> = BTreeMap::new();
        for arc in &transition.inputs {
            all.entry(arc.place).or_default().takes += u64::from(arc.weight);
        }
        for arc in &transition.reads {
            let reads = &mut all.entry(arc.place).or_default().reads;
            *reads = (*reads).max(u64::from(arc.weight));
        }
        for arc in &transition.outputs.local {
            all.entry(arc.place).or_default().completes += u64::from(arc.weight);
        }
        for arc in transition.fail.iter().flat_map(|branch| &branch.local) {
            all.entry(arc.place).or_default().fails += u64::from(arc.weight);
        }
        for place in &transition.resets {
            all.entry(*place).or_default().reset = true;
        }
        all
    }

    /// What a running firing may put, for which the place must have free capacity.
    fn claim(&self) -> u64 {
        self.completes.max(self.fails).max(self.takes)
    }

    fn countable(&self) -> bool {
        let most = u64::from(u32::MAX);
        self.takes <= most && self.completes <= most && self.fails <= most
    }
}

struct Builder<'a> {
    net: &'a Net,
    wiring: Wiring,
    watches: Vec<Vec<Watch>>,
    server_ranks: Vec<Vec<u32>>,
    ranks: Vec<u32>,
}

impl<'a> Builder<'a> {
    fn new(net: &'a Net) -> Self {
        let (at_rank, ranks, first_timed) = order(net);
        let priority = |id: &TransitionId| (is_timed(&net[*id]), net[*id].priority);
        let class_end = at_rank
            .chunk_by(|a, b| priority(a) == priority(b))
            .scan(0, |end, class| {
                *end += small(class.len());
                Some(std::iter::repeat_n(*end, class.len()))
            })
            .flatten()
            .collect();
        let mut builder = Self {
            net,
            watches: Vec::new(),
            server_ranks: Vec::new(),
            wiring: Wiring {
                counters: Vec::new(),
                watches: Vec::new(),
                server_ranks: Vec::new(),
                deltas: Vec::new(),
                resets: Vec::new(),
                fires: Vec::new(),
                phases: Vec::new(),
                weights: at_rank.iter().map(|id| net[*id].weight).collect(),
                guards: at_rank.iter().map(|id| net[*id].when.is_some()).collect(),
                impossible: vec![0; at_rank.len()],
                at_rank,
                class_end,
                first_timed,
                guarded_timed: Vec::new(),
                capped: Vec::new(),
                commands: 0,
                place_names: (0..)
                    .map(PlaceId)
                    .zip(net.places())
                    .map(|(id, place)| (place.name.clone(), id))
                    .collect(),
            },
            ranks,
        };
        for _ in net.places() {
            builder.counter();
        }
        builder.capacities();
        builder.wiring.commands = small(builder.watches.len());
        for _ in net.commands() {
            builder.counter();
        }
        builder
    }

    fn counter(&mut self) -> u32 {
        self.watches.push(Vec::new());
        self.server_ranks.push(Vec::new());
        small(self.watches.len() - 1)
    }

    fn capacities(&mut self) {
        let mut emptied = vec![false; self.net.places().len()];
        for place in self.net.transitions().iter().flat_map(|t| &t.resets) {
            emptied[place.index()] = true;
        }
        for (place, emptied) in self.net.places().iter().zip(emptied) {
            let capped = place.capacity.map(|capacity| Capped {
                capacity,
                filled: self.counter(),
                claimed: emptied.then(|| self.counter()),
            });
            self.wiring.capped.push(capped);
        }
    }

    fn build(mut self) -> Wiring {
        for (id, transition) in (0..).map(TransitionId).zip(self.net.transitions()) {
            self.transition(id, transition);
        }
        let wiring = &mut self.wiring;
        for (mut watches, ranks) in self.watches.into_iter().zip(self.server_ranks) {
            watches.sort_by_key(|watch| (watch.threshold, watch.rank));
            let highest = watches.last().map_or(0, |watch| watch.threshold);
            let first = (
                small(wiring.watches.len()),
                small(wiring.server_ranks.len()),
            );
            wiring.counters.push(Counter {
                quiet_from: if ranks.is_empty() { highest } else { u32::MAX },
                watches: (first.0, first.0 + small(watches.len())),
                servers: (first.1, first.1 + small(ranks.len())),
            });
            wiring.watches.append(&mut watches);
            wiring.server_ranks.extend(ranks);
        }
        self.wiring
    }

    fn transition(&mut self, id: TransitionId, transition: &Transition) {
        let rank = self.ranks[id.index()];
        let around = Around::all(transition);
        let going = self.going(transition, rank);
        for (place, around) in &around {
            self.needs(*place, around, rank);
            self.room(*place, around, rank);
            if is_timed(transition) && around.takes > 0 && transition.servers != Servers::ONE {
                self.server_ranks[place.index()].push(rank);
            }
        }
        for arc in &transition.inhibitors {
            self.watch(small(arc.place.index()), arc.weight, rank, false);
        }
        if let Some(command) = transition.tape {
            self.watch(self.wiring.command(command.index()), 1, rank, true);
        }
        if is_timed(transition) && transition.when.is_some() {
            self.wiring.guarded_timed.push(rank);
        }
        let no_fail = transition.fail.is_none();
        let phase = |builder: &mut Self, of: &dyn Fn(&Around) -> (i64, i64), going_by: i64| {
            builder.phase(&around, of, going.map(|counter| (counter, going_by)))
        };
        let signed = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
        let once = |a: &Around| match a.reset {
            false => (signed(a.completes) - signed(a.takes), 0),
            // What is emptied is not known before.
            true => (0, 0),
        };
        let fire = phase(self, &once, 0);
        let start = phase(self, &|a| (-signed(a.takes), signed(a.claim())), 1);
        let claim = phase(self, &|a| (0, signed(a.claim())), 1);
        let complete = phase(self, &|a| (signed(a.completes), -signed(a.claim())), -1);
        let cancel = phase(self, &|a| (signed(a.takes), -signed(a.claim())), -1);
        let fail = if no_fail {
            cancel
        } else {
            phase(self, &|a| (signed(a.fails), -signed(a.claim())), -1)
        };
        let resets = self.resets(&around);
        self.wiring.fires.push(Fire {
            changes: fire,
            rank,
            plain: transition.action.is_none()
                && transition.tape.is_none()
                && transition.write.is_none()
                && transition.resets.is_empty()
                && transition.outputs.remote.is_empty(),
        });
        self.wiring.phases.push(Phases {
            start,
            claim,
            complete,
            fail,
            cancel,
            within_ns: transition
                .within
                .map(|within| u64::try_from(within.as_nanos()).unwrap_or(u64::MAX)),
            resets,
        });
    }

    /// The counter of firings that go on, when an action's number of servers is limited.
    fn going(&mut self, transition: &Transition, rank: u32) -> Option<u32> {
        let (Servers::Limit(limit), true) = (transition.servers, transition.action.is_some())
        else {
            return None;
        };
        let counter = self.counter();
        self.watch(counter, limit.get(), rank, false);
        Some(counter)
    }

    fn watch(&mut self, counter: u32, threshold: u32, rank: u32, wanted: bool) {
        self.watches[counter as usize].push(Watch {
            threshold,
            rank,
            wanted,
        });
    }

    fn needs(&mut self, place: PlaceId, around: &Around, rank: u32) {
        if !around.countable() {
            self.wiring.impossible[rank as usize] += 1;
            return;
        }
        let needs = around.takes.max(around.reads);
        if needs > 0 {
            let needs = u32::try_from(needs).unwrap_or(u32::MAX);
            self.watch(small(place.index()), needs, rank, true);
        }
    }

    /// The condition that what the transition may put fits into a place with a capacity.
    fn room(&mut self, place: PlaceId, around: &Around, rank: u32) {
        let Some(capped) = self.wiring.capped[place.index()] else {
            return;
        };
        // Where the place is emptied only the claims of others can be in the way.
        let (counter, gain) = match capped.claimed.filter(|_| around.reset) {
            Some(claimed) => (claimed, around.completes.max(around.fails)),
            None => (capped.filled, around.claim() - around.takes),
        };
        if gain == 0 {
            return;
        }
        match u64::from(capped.capacity).checked_sub(gain) {
            // A capacity of u32::MAX and no gain is excluded above, so this does not wrap.
            Some(room) => {
                let blocked = u32::try_from(room + 1).unwrap_or(u32::MAX);
                self.watch(counter, blocked, rank, false);
            }
            None => self.wiring.impossible[rank as usize] += 1,
        }
    }

    /// The changes of one phase: per place those of its tokens and of what is claimed of it.
    fn phase(
        &mut self,
        around: &BTreeMap<PlaceId, Around>,
        of: &dyn Fn(&Around) -> (i64, i64),
        going: Option<(u32, i64)>,
    ) -> Changes {
        let (mut checked, mut others) = (Vec::new(), Vec::new());
        for (place, around) in around {
            let (tokens, claim) = of(around);
            let capped = self.wiring.capped[place.index()];
            let counter = small(place.index());
            match capped {
                None if tokens > 0 => checked.push((counter, tokens)),
                None => others.push((counter, tokens)),
                Some(capped) => {
                    others.push((counter, tokens));
                    others.push((capped.filled, tokens + claim));
                    others.extend(capped.claimed.map(|claimed| (claimed, claim)));
                }
            }
        }
        others.extend(going);
        others.retain(|(_, by)| *by != 0);
        let begin = small(self.wiring.deltas.len());
        let middle = begin + small(checked.len());
        // Two's complement: adding it modulo 2^32 subtracts.
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "changes are modulo 2^32 on purpose; uncountable ones are never applied"
        )]
        let deltas = checked
            .into_iter()
            .chain(others)
            .map(|(counter, by)| Delta {
                counter,
                by: by as u32,
            });
        self.wiring.deltas.extend(deltas);
        Changes {
            begin,
            checked: middle,
            end: small(self.wiring.deltas.len()),
        }
    }

    fn resets(&mut self, around: &BTreeMap<PlaceId, Around>) -> (u32, u32) {
        let begin = small(self.wiring.resets.len());
        for (place, around) in around.iter().filter(|(_, around)| around.reset) {
            self.wiring.resets.push(Reset {
                place: *place,
                filled: self.wiring.capped[place.index()].map(|capped| capped.filled),
                takes: u32::try_from(around.takes).unwrap_or(u32::MAX),
                completes: u32::try_from(around.completes).unwrap_or(u32::MAX),
            });
        }
        (begin, small(self.wiring.resets.len()))
    }
}

/// Transitions by rank, ranks by transition, and the first rank of a timed one.
fn order(net: &Net) -> (Vec<TransitionId>, Vec<u32>, usize) {
    let ids = (0..).map(TransitionId).zip(net.transitions());
    let mut at_rank: Vec<TransitionId> = ids.map(|(id, _)| id).collect();
    at_rank.sort_by_key(|id| (is_timed(&net[*id]), Reverse(net[*id].priority)));
    let mut ranks = vec![0; at_rank.len()];
    for (rank, id) in (0..).zip(&at_rank) {
        ranks[id.index()] = rank;
    }
    let first_timed = at_rank.partition_point(|id| !is_timed(&net[*id]));
    (at_rank, ranks, first_timed)
}

impl Wiring {
    /// Rank of a transition of the net.
    pub(super) fn rank(&self, id: TransitionId) -> Option<usize> {
        self.fires.get(id.index()).map(|fire| fire.rank as usize)
    }

    /// The ranks of the same priority as a rank, from it to their end.
    pub(super) fn class_from(&self, rank: usize) -> Range<usize> {
        rank..self
            .class_end
            .get(rank)
            .map_or(rank + 1, |end| *end as usize)
    }
}
