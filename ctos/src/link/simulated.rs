//! Links of a simulated app: frames take a seeded time on the virtual clock and keep their order.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

use crate::{
    call::lock,
    link::{Frame, Link},
    time::{Clock, Instant},
};

/// Shortest time a frame takes.
const DELAY_MIN: Duration = Duration::from_micros(50);
/// How much longer it may take.
const DELAY_SPREAD_NS: u64 = 100_000;

/// A frame on its way.
pub(crate) struct InFlight {
    pub(crate) from: u8,
    pub(crate) to: u8,
    pub(crate) frame: Frame,
}

struct State {
    flights: BTreeMap<(Instant, u64), InFlight>,
    /// When the last frame of each direction arrives, so that none overtakes another.
    last: BTreeMap<(u8, u8), Instant>,
    next: u64,
    rng: ChaCha8Rng,
}

/// All the links of one simulated app.
#[derive(Clone)]
pub(crate) struct Network {
    state: Arc<Mutex<State>>,
    clock: Clock,
}

impl Network {
    pub(crate) fn new(clock: Clock, rng: ChaCha8Rng) -> Self {
        Self {
            state: Arc::new(Mutex::new(State {
                flights: BTreeMap::new(),
                last: BTreeMap::new(),
                next: 0,
                rng,
            })),
            clock,
        }
    }

    /// The link that chassis `from` has to chassis `to`.
    pub(crate) fn link(&self, from: u8, to: u8) -> Arc<dyn Link> {
        Arc::new(SimulatedLink {
            network: self.clone(),
            from,
            to,
        })
    }

    /// When the next frame arrives.
    pub(crate) fn next_arrival(&self) -> Option<Instant> {
        let state = lock(&self.state);
        state.flights.keys().next().map(|key| key.0)
    }

    /// The next frame that has arrived by `now`.
    pub(crate) fn arrive(&self, now: Instant) -> Option<InFlight> {
        let mut state = lock(&self.state);
        let first = state.flights.first_entry()?;
        (first.key().0 <= now).then(|| first.remove())
    }
}

struct SimulatedLink {
    network: Network,
    from: u8,
    to: u8,
}

impl Link for SimulatedLink {
    fn post(&self, frame: Frame) {
        let mut state = lock(&self.network.state);
        let spread = Duration::from_nanos(state.rng.random_range(0..DELAY_SPREAD_NS));
        let wanted = self.network.clock.now() + DELAY_MIN + spread;
        let direction = (self.from, self.to);
        let arrival = state
            .last
            .get(&direction)
            .map_or(wanted, |last| wanted.max(*last));
        state.last.insert(direction, arrival);
        let number = state.next;
        state.next += 1;
        state.flights.insert(
            (arrival, number),
            InFlight {
                from: self.from,
                to: self.to,
                frame,
            },
        );
    }
}

/// Draws a number below `bound`.
pub(crate) fn below(rng: &mut impl Rng, bound: usize) -> usize {
    rng.random_range(0..bound.max(1))
}
