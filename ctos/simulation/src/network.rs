//! The links of a simulated app: frames take a seeded time on the virtual clock and keep their order.
//!
//! The model is a stream with a session above it, as the real links are. A frame that is lost is
//! sent again and comes late, and so does everything behind it. A link that breaks and heals goes on
//! where it was. Only a chassis that hears nothing of another one for longer than the peer time-out
//! gives it up, and tells it so when it can. Frames between different chassis overtake each other
//! freely.
//!
//! Two chassis are linked when one of them first needs to reach the other. What happened to the way between
//! them before then holds for the link.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, Weak},
    time::Duration,
};

use rand::{Rng, RngExt};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::injured;
use ctos_config::App;
use ctos_core::chassis::Chassis;
use ctos_message::ChassisNumber;
use ctos_message::frame::{Frame, Full, Link};
use ctos_time::{Clock, Instant, lock::lock, seed::mix};

/// What arrives in the place of a frame: a test breaks a rule of the links, to see that it is noticed.
#[doc(hidden)]
pub type Tamper = Box<dyn FnMut(Frame) -> Vec<Frame> + Send>;

/// Shortest time a frame takes.
const DELAY_MIN: Duration = Duration::from_micros(50);
/// How much longer it may take.
const DELAY_SPREAD_NS: u64 = 100_000;
/// How long it takes until a lost frame is sent again, ns.
const RESEND_NS: std::ops::Range<u64> = 10_000_000..60_000_000;
/// A frame is lost at most so often in a row.
const RESENDS: u32 = 20;

/// What arrives at a chassis.
pub(crate) enum Arrival {
    /// A frame.
    Frame(Frame),
    /// The sender's end of the link is closed, or the sender tells that it has given the receiver up.
    Closed,
    /// Nothing has come from the sender for longer than the peer time-out.
    Silence,
}

/// From one chassis to another.
pub(crate) type Way = (ChassisNumber, ChassisNumber);

/// What is on its way from one chassis to another.
pub(crate) struct InFlight {
    pub(crate) way: Way,
    pub(crate) arrival: Arrival,
}

/// Until when which share of the frames is lost, of 10^6, and how much longer each takes at most.
pub(crate) type Disturbance = (Instant, u32, Duration);

/// One direction of a link.
#[derive(Default)]
struct Direction {
    /// When the last frame arrives, so that none overtakes another.
    last: Instant,
    /// Before this nothing that is posted arrives.
    clear_from: Instant,
    /// Since when the receiver hears nothing, and until when.
    quiet: Option<(Instant, Instant)>,
    /// The receiver has, or will have, given the sender up.
    given_up: bool,
    /// There is a link; without one nobody listens.
    linked: bool,
    /// Nothing gets through any more.
    closed: bool,
    disturbances: Vec<Disturbance>,
    /// Draws losses and delays; made when the first one is needed.
    rng: Option<Box<ChaCha8Rng>>,
}

struct State {
    /// Those that are there, and until when those stand still that do.
    ends: BTreeMap<ChassisNumber, Weak<Chassis>>,
    frozen: BTreeMap<ChassisNumber, Instant>,
    flights: BTreeMap<(Instant, u64), InFlight>,
    directions: BTreeMap<Way, Direction>,
    next: u64,
    rng: ChaCha8Rng,
    tamper: Option<Tamper>,
    peer_timeout: Duration,
}

/// All the links of one simulated app.
#[derive(Clone)]
pub(crate) struct Network {
    state: Arc<Mutex<State>>,
    clock: Clock,
    seed: u64,
    /// What disturbs each link from its beginning.
    injuries: Arc<[Disturbance]>,
}

impl Network {
    pub(crate) fn new(clock: Clock, app: &App, tamper: Option<Tamper>) -> Self {
        Self {
            state: Arc::new(Mutex::new(State {
                ends: BTreeMap::new(),
                frozen: BTreeMap::new(),
                flights: BTreeMap::new(),
                directions: BTreeMap::new(),
                next: 0,
                rng: ChaCha8Rng::seed_from_u64(mix(app.seed, &["simulated links"])),
                tamper,
                peer_timeout: app.links.peer_timeout,
            })),
            clock,
            seed: app.seed,
            injuries: injured::lasting(&app.links.injury).into(),
        }
    }

    /// `chassis` is there; of an earlier one of its number nothing is left.
    pub(crate) fn join(&self, chassis: &Arc<Chassis>) {
        let (index, weak) = (chassis.index(), Arc::downgrade(chassis));
        let mut state = lock(&self.state);
        let others = |(from, to): Way| from != index && to != index;
        state.flights.retain(|_, flight| others(flight.way));
        // Both directions of a link are there, or none.
        let own = state
            .directions
            .range((index, 0)..=(index, ChassisNumber::MAX));
        for peer in own.map(|((_, peer), _)| *peer).collect::<Vec<_>>() {
            state.directions.remove(&(index, peer));
            state.directions.remove(&(peer, index));
        }
        state.frozen.remove(&index);
        state.ends.insert(index, weak.clone());
        let network = self.clone();
        chassis.connect_by(move |peer| {
            if let Some(chassis) = weak.upgrade() {
                network.connect(&chassis, peer);
            }
        });
    }

    /// Links `chassis` with chassis `peer`, if both are there and nothing has cut them off.
    fn connect(&self, chassis: &Arc<Chassis>, peer: ChassisNumber) {
        let (index, now) = (chassis.index(), self.clock.now());
        let mut state = lock(&self.state);
        let other = state.ends.get(&peer).and_then(Weak::upgrade);
        let both = [(index, peer), (peer, index)];
        let is_cut = |way| state.directions.get(way).is_some_and(|one| one.closed);
        let is_here = state.ends.contains_key(&index) && !both.iter().any(is_cut);
        let Some(other) = other.filter(|_| is_here) else {
            return;
        };
        for way in both {
            let frozen = [way.0, way.1].map(|end| state.frozen.get(&end).copied());
            if let Some(until) = frozen[1] {
                state.hold(way, until);
            }
            let direction = state.direction(way);
            direction.linked = true;
            direction.disturbances.extend_from_slice(&self.injuries);
            // Who hears nothing from the beginning has listened since then.
            let quiet = direction.quiet.take().map(|(_, until)| until);
            if let Some(until) = quiet.max(frozen[0]).filter(|until| *until > now) {
                state.quiet(way, now, until);
            }
        }
        drop(state);
        for (one, way) in [chassis, &other].into_iter().zip(both) {
            let network = self.clone();
            one.link_up(way.1, Arc::new(SimulatedLink { network, way }));
        }
    }

    /// To whom chassis `index` is or was linked.
    pub(crate) fn peers(&self, index: ChassisNumber) -> Vec<ChassisNumber> {
        lock(&self.state).peers(index)
    }

    /// When the next of what is under way arrives.
    pub(crate) fn next_arrival(&self) -> Option<Instant> {
        let state = lock(&self.state);
        state.flights.keys().next().map(|key| key.0)
    }

    /// The next that has arrived by `now`.
    pub(crate) fn arrive(&self, now: Instant) -> Option<InFlight> {
        let mut state = lock(&self.state);
        let first = state.flights.first_entry()?;
        (first.key().0 <= now).then(|| first.remove())
    }

    fn put(&self, way: Way, arrival: Arrival) {
        let mut state = lock(&self.state);
        let now = self.clock.now();
        let spread = Duration::from_nanos(state.rng.random_range(0..DELAY_SPREAD_NS));
        let direction = state.direction(way);
        if direction.closed {
            return;
        }
        let late = direction.lateness(now, || self.direction_rng(way));
        let wanted = direction.clear_from.max(now) + DELAY_MIN + spread + late;
        direction.last = direction.last.max(wanted);
        let moment = direction.last;
        state.insert(moment, way, arrival);
    }

    fn direction_rng(&self, (from, to): Way) -> Box<ChaCha8Rng> {
        let ends = [from.to_string(), to.to_string()];
        let seed = mix(self.seed, &["link faults", &ends[0], &ends[1]]);
        Box::new(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Chassis `index` closed its end of all its links; what it sent before still arrives.
    pub(crate) fn leave(&self, index: ChassisNumber) {
        let mut state = lock(&self.state);
        state.ends.remove(&index);
        let peers = state.peers(index);
        drop(state);
        for peer in peers {
            self.put((index, peer), Arrival::Closed);
        }
    }

    /// Ends a link: what is under way in either direction is lost, and nothing follows.
    pub(crate) fn cut(&self, (one, other): Way) {
        let mut state = lock(&self.state);
        state.close((one, other));
        state.close((other, one));
    }

    /// From now until `until` nothing that is posted on a link arrives, and nothing that is under way
    /// either when the link `breaks`.
    pub(crate) fn silence(&self, (one, other): Way, until: Instant, breaks: bool) {
        let now = self.clock.now();
        let mut state = lock(&self.state);
        for way in [(one, other), (other, one)] {
            if breaks {
                state.hold(way, until);
            } else {
                let direction = state.direction(way);
                direction.clear_from = direction.clear_from.max(until);
            }
            state.quiet(way, now, until);
        }
    }

    /// Chassis `frozen` stands still until `until`: what is sent to it waits, and nobody hears anything of it.
    pub(crate) fn freeze(&self, frozen: ChassisNumber, until: Instant) {
        let now = self.clock.now();
        let mut state = lock(&self.state);
        let still = state.frozen.entry(frozen).or_default();
        *still = until.max(*still);
        for peer in state.peers(frozen) {
            state.hold((peer, frozen), until);
            state.quiet((frozen, peer), now, until);
        }
    }

    /// The receiver, which would have given the sender up, stands still until `until`: it does so then, if
    /// there is still nothing to hear.
    pub(crate) fn listen_again(&self, way: Way, until: Instant) {
        let mut state = lock(&self.state);
        let direction = state.direction(way);
        direction.given_up = direction.quiet.is_some_and(|(_, end)| end > until);
        if direction.given_up {
            state.insert(until, way, Arrival::Silence);
        }
    }

    /// The receiver gives the sender up: what is between them is lost, and the sender learns so when it can
    /// be reached.
    pub(crate) fn give_up(&self, (from, to): Way) {
        let mut state = lock(&self.state);
        let told = state.direction((to, from)).clear_from.max(self.clock.now()) + DELAY_MIN;
        state.close((from, to));
        state.close((to, from));
        state.insert(told, (to, from), Arrival::Closed);
    }

    /// Until `until` a share of what is sent is lost and sent again, and takes up to `extra` longer.
    pub(crate) fn disturb(&self, (one, other): Way, disturbance: Disturbance) {
        let mut state = lock(&self.state);
        for way in [(one, other), (other, one)] {
            state.direction(way).disturbances.push(disturbance);
        }
    }
}

impl Direction {
    /// How much longer than usual the next frame takes.
    fn lateness(&mut self, now: Instant, seeded: impl FnOnce() -> Box<ChaCha8Rng>) -> Duration {
        if self.disturbances.is_empty() {
            return Duration::ZERO;
        }
        self.disturbances.retain(|(until, ..)| *until > now);
        let rng = self.rng.get_or_insert_with(seeded);
        let mut late = Duration::ZERO;
        let extras = self.disturbances.iter().map(|(.., extra)| extra);
        for extra in extras.filter(|extra| !extra.is_zero()) {
            let most = u64::try_from(extra.as_nanos()).unwrap_or(u64::MAX);
            late += Duration::from_nanos(rng.random_range(0..=most));
        }
        let shares = self.disturbances.iter().map(|(_, share, _)| *share);
        let share = shares.max().unwrap_or(0).min(1_000_000);
        let mut resends = 0;
        while resends < RESENDS && rng.random_range(0..1_000_000_u32) < share {
            late += Duration::from_nanos(rng.random_range(RESEND_NS));
            resends += 1;
        }
        late
    }
}

impl State {
    fn direction(&mut self, way: Way) -> &mut Direction {
        self.directions.entry(way).or_default()
    }

    /// To whom chassis `index` is or was linked.
    fn peers(&self, index: ChassisNumber) -> Vec<ChassisNumber> {
        let all = self
            .directions
            .range((index, 0)..=(index, ChassisNumber::MAX));
        let linked = all.filter(|(_, direction)| direction.linked);
        linked.map(|((_, peer), _)| *peer).collect()
    }

    fn insert(&mut self, moment: Instant, way: Way, arrival: Arrival) {
        let arrivals = match (arrival, &mut self.tamper) {
            (Arrival::Frame(frame), Some(tamper)) => {
                tamper(frame).into_iter().map(Arrival::Frame).collect()
            }
            (arrival, _) => vec![arrival],
        };
        for arrival in arrivals {
            let flight = InFlight { way, arrival };
            self.flights.insert((moment, self.next), flight);
            self.next += 1;
        }
    }

    /// Makes what is under way in one direction arrive at `until` or later, in its order.
    fn hold(&mut self, way: Way, until: Instant) {
        let direction = self.direction(way);
        direction.clear_from = direction.clear_from.max(until);
        direction.last = direction.last.max(until);
        let early: Vec<(Instant, u64)> = self
            .flights
            .range(..(until, 0))
            // Silence is noticed by the clock: nothing has to come for it.
            .filter(|(_, one)| one.way == way && !matches!(one.arrival, Arrival::Silence))
            .map(|(key, _)| *key)
            .collect();
        for key in early {
            if let Some(flight) = self.flights.remove(&key) {
                self.flights.insert((until, key.1), flight);
            }
        }
    }

    /// The receiver hears nothing of the sender until `until`. It gives the sender up if that is too long by its clock.
    fn quiet(&mut self, way: Way, now: Instant, until: Instant) {
        let direction = self.directions.entry(way).or_default();
        let (since, until) = match direction.quiet {
            Some((since, end)) if end >= now => (since, end.max(until)),
            _ => (now, until),
        };
        direction.quiet = Some((since, until));
        let Some(hears) = self.ends.get(&way.1).and_then(Weak::upgrade) else {
            return;
        };
        let gives_up_at = hears.clock.shown_at(since) + self.peer_timeout;
        let moment = hears.clock.true_at(gives_up_at).max(now);
        if direction.linked && moment < until && !direction.given_up && !direction.closed {
            direction.given_up = true;
            self.insert(moment, way, Arrival::Silence);
        }
    }

    fn close(&mut self, way: Way) {
        self.flights.retain(|_, flight| flight.way != way);
        let direction = self.direction(way);
        direction.closed = true;
        direction.given_up = true;
    }
}

struct SimulatedLink {
    network: Network,
    way: Way,
}

impl Link for SimulatedLink {
    fn post(&self, frame: Frame) -> Result<(), Full> {
        self.network.put(self.way, Arrival::Frame(frame));
        Ok(())
    }
}

/// Draws a number below `bound`.
pub(crate) fn below(rng: &mut impl Rng, bound: usize) -> usize {
    rng.random_range(0..bound.max(1))
}
