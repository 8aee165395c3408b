//! The counters and, kept up with them, the set of transitions that are enabled.

use super::{
    shares::Shares,
    wiring::{Changes, Fire, Wiring},
};
use crate::{
    net::{Net, PlaceId, TransitionId},
    ready::ReadySet,
};

#[derive(Debug, Clone)]
pub(super) struct Enabling {
    /// Tokens per place, then the other counters.
    counters: Vec<u32>,
    places: usize,
    /// Conditions that each transition still lacks, by rank.
    lacking: Vec<u32>,
    /// Ranks of the transitions that lack nothing.
    pub(super) ready: ReadySet,
    /// What chance needs to choose by weight; made when it is first asked.
    pub(super) shares: Option<Box<Shares>>,
    first_timed: usize,
    /// Ranks of timed transitions whose enabling may have changed, each once.
    touched: Vec<u32>,
    is_touched: Vec<bool>,
}

impl Enabling {
    /// The initial marking, with an empty tape.
    pub(super) fn new(net: &Net, wiring: &Wiring) -> Self {
        let transitions = wiring.at_rank.len();
        let mut enabling = Self {
            counters: vec![0; wiring.counters.len()],
            places: net.places().len(),
            lacking: wiring.impossible.clone(),
            ready: ReadySet::new(transitions),
            shares: None,
            first_timed: wiring.first_timed,
            touched: Vec::with_capacity(transitions - wiring.first_timed),
            is_touched: vec![false; transitions - wiring.first_timed],
        };
        for counter in &wiring.counters {
            for watch in wiring.watches(counter).iter().filter(|watch| {
                // A counter at zero is at least a threshold of zero only.
                (watch.threshold == 0) != watch.wanted
            }) {
                enabling.lacking[watch.rank as usize] += 1;
            }
        }
        for (rank, lacking) in enabling.lacking.iter().enumerate() {
            if *lacking == 0 {
                enabling.ready.insert(rank);
            }
        }
        for rank in wiring.first_timed..transitions {
            enabling.touch(rank);
        }
        for (index, (place, capped)) in (0..).zip(net.places().iter().zip(&wiring.capped)) {
            enabling.add(wiring, index, place.tokens);
            if let Some(capped) = capped {
                enabling.add(wiring, capped.filled, place.tokens);
            }
        }
        enabling
    }

    /// Tokens per place.
    pub(super) fn marking(&self) -> &[u32] {
        self.counters.get(..self.places).unwrap_or(&[])
    }

    pub(super) fn counter(&self, counter: u32) -> u32 {
        self.counters.get(counter as usize).copied().unwrap_or(0)
    }

    #[inline]
    pub(super) fn is_enabled(&self, fire: Fire) -> bool {
        self.lacking.get(fire.rank as usize) == Some(&0)
    }

    /// The first place without capacity that could not count what a phase would put.
    #[inline]
    pub(super) fn without_room(&self, wiring: &Wiring, changes: Changes) -> Option<PlaceId> {
        let full = |counter: u32, by: u32| self.counter(counter).checked_add(by).is_none();
        let deltas = wiring.checked(changes).iter();
        let mut full = deltas.filter(|delta| full(delta.counter, delta.by));
        full.next().map(|delta| PlaceId(delta.counter))
    }

    /// All changes of one phase.
    #[inline]
    pub(super) fn apply(&mut self, wiring: &Wiring, changes: Changes) {
        for delta in wiring.deltas(changes) {
            self.add(wiring, delta.counter, delta.by);
        }
    }

    /// Adds to a counter, modulo 2^32, and looks at the transitions around it.
    #[inline]
    pub(super) fn add(&mut self, wiring: &Wiring, counter: u32, by: u32) {
        let (Some(value), Some(around)) = (
            self.counters.get_mut(counter as usize),
            wiring.counters.get(counter as usize),
        ) else {
            return;
        };
        let before = *value;
        let after = before.wrapping_add(by);
        *value = after;
        if before.min(after) >= around.quiet_from {
            return;
        }
        for watch in wiring.watches(around) {
            let held = before >= watch.threshold;
            let holds = after >= watch.threshold;
            if held != holds {
                self.condition(wiring, watch.rank as usize, holds == watch.wanted);
            }
        }
        for rank in wiring.servers(around) {
            self.touch(*rank as usize);
        }
    }

    pub(super) fn set(&mut self, wiring: &Wiring, counter: u32, to: u32) {
        let by = to.wrapping_sub(self.counter(counter));
        self.add(wiring, counter, by);
    }

    /// One condition of a transition has changed.
    #[inline]
    fn condition(&mut self, wiring: &Wiring, rank: usize, met: bool) {
        let Some(lacking) = self.lacking.get_mut(rank) else {
            return;
        };
        if met {
            *lacking = lacking.saturating_sub(1);
            if *lacking == 0 {
                self.ready.insert(rank);
                self.changed(wiring, rank, true);
            }
        } else {
            *lacking += 1;
            if *lacking == 1 {
                self.ready.remove(rank);
                self.changed(wiring, rank, false);
            }
        }
    }

    #[inline]
    fn changed(&mut self, wiring: &Wiring, rank: usize, enabled: bool) {
        if rank >= self.first_timed {
            self.touch(rank);
        } else if let Some(shares) = &mut self.shares {
            let weight = wiring.weights.get(rank).copied().unwrap_or(0.0);
            shares.set(rank, if enabled { weight } else { 0.0 });
        }
    }

    /// The keeper of the clocks must look at this timed transition again.
    fn touch(&mut self, rank: usize) {
        let Some(touched) = self.is_touched.get_mut(rank - self.first_timed) else {
            return;
        };
        if !*touched {
            *touched = true;
            self.touched.push(u32::try_from(rank).unwrap_or(u32::MAX));
        }
    }

    /// The next timed transition that must be looked at, by rank.
    pub(super) fn next_touched(&mut self) -> Option<usize> {
        let rank = self.touched.pop()? as usize;
        if let Some(touched) = self.is_touched.get_mut(rank - self.first_timed) {
            *touched = false;
        }
        Some(rank)
    }

    /// The weights of what is enabled now, for chance to choose by.
    pub(super) fn shares(&mut self, wiring: &Wiring) -> &mut Shares {
        self.shares.get_or_insert_with(|| {
            let mut shares = Shares::new(wiring);
            let mut from = 0;
            while let Some(rank) = self.ready.next(from).filter(|r| *r < wiring.first_timed) {
                shares.set(rank, wiring.weights.get(rank).copied().unwrap_or(0.0));
                from = rank + 1;
            }
            Box::new(shares)
        })
    }

    /// How many firings of a timed transition its tokens allow at once, `most` at most.
    pub(super) fn degree(&self, wiring: &Wiring, net: &Net, id: TransitionId, most: u32) -> u32 {
        let enabled = wiring.fires.get(id.index());
        if !enabled.is_some_and(|fire| self.is_enabled(*fire)) {
            return 0;
        }
        let marking = self.marking();
        let times = |arc: &crate::net::Arc| {
            let tokens = marking.get(arc.place.index()).copied().unwrap_or(0);
            tokens / arc.weight.max(1)
        };
        // Enabled without any input: one at a time.
        let least = net[id].inputs.iter().map(times).min().unwrap_or(1);
        least.clamp(1, most)
    }
}
