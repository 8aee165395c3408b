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
    link::{Frame, Full, Link},
    time::{Clock, Instant},
};

/// Shortest time a frame takes.
const DELAY_MIN: Duration = Duration::from_micros(50);
/// How much longer it may take.
const DELAY_SPREAD_NS: u64 = 100_000;

/// What is on its way from one chassis to another.
pub(crate) struct InFlight {
    pub(crate) from: u8,
    pub(crate) to: u8,
    /// `None` tells that the sender's end of the link is closed.
    pub(crate) frame: Option<Frame>,
}

struct State {
    flights: BTreeMap<(Instant, u64), InFlight>,
    /// When the last frame of each direction arrives, so that none overtakes another.
    last: BTreeMap<(u8, u8), Instant>,
    /// Links that stand still, in both directions, and until when.
    stalls: Vec<([u8; 2], Instant)>,
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
                stalls: Vec::new(),
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

impl Network {
    /// Draws the moment at which what is posted now arrives.
    fn put(&self, from: u8, to: u8, frame: Option<Frame>) {
        let mut state = lock(&self.state);
        let spread = Duration::from_nanos(state.rng.random_range(0..DELAY_SPREAD_NS));
        let now = self.clock.now();
        let stalled = state
            .stalls
            .iter()
            .filter(|(ends, until)| *until > now && (*ends == [from, to] || *ends == [to, from]));
        let start = stalled.map(|(_, until)| *until).max().unwrap_or(now);
        let wanted = start + DELAY_MIN + spread;
        let arrival = state
            .last
            .get(&(from, to))
            .map_or(wanted, |last| wanted.max(*last));
        state.last.insert((from, to), arrival);
        let number = state.next;
        state.next += 1;
        let flight = InFlight { from, to, frame };
        state.flights.insert((arrival, number), flight);
    }

    /// Chassis `from` closed its end of the link to `to`; what it sent before still arrives.
    pub(crate) fn hang_up(&self, from: u8, to: u8) {
        self.put(from, to, None);
    }

    /// Breaks a link: what is under way in either direction is lost.
    pub(crate) fn cut(&self, one: u8, other: u8) {
        lock(&self.state).flights.retain(|_, flight| {
            let ends = (flight.from, flight.to);
            ends != (one, other) && ends != (other, one)
        });
    }

    /// From now until `until` nothing that is posted on a link arrives.
    pub(crate) fn stall(&self, one: u8, other: u8, until: Instant) {
        lock(&self.state).stalls.push(([one, other], until));
    }
}

struct SimulatedLink {
    network: Network,
    from: u8,
    to: u8,
}

impl Link for SimulatedLink {
    fn post(&self, frame: Frame) -> Result<(), Full> {
        self.network.put(self.from, self.to, Some(frame));
        Ok(())
    }
}

/// Draws a number below `bound`.
pub(crate) fn below(rng: &mut impl Rng, bound: usize) -> usize {
    rng.random_range(0..bound.max(1))
}
