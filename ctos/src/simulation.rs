//! A whole app in one thread on the virtual clock.
//!
//! All chassis live in this process and exchange encoded frames over simulated links. One loop polls
//! the tasks that can run, in an order drawn from the app's seed; when none can, it moves the clock to
//! the next deadline. What goes wrong meanwhile is drawn from the same seed, or given. The same seed
//! and the same faults give the same run, event for event.

mod draw;
mod events;
mod machine;
mod mishap;
mod profile;
mod reader;
mod script;
mod shrink;

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex},
    time::Duration,
};

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    boot::{self, BootError, BootEvent, End, Observer, Outcome},
    bootstrap::{EndSlot, Processes, Seat},
    call::lock,
    chassis::{BOOT_CHASSIS, Chassis},
    config::App,
    context::mix,
    link::{
        Frame,
        simulated::{Arrival, InFlight, Network, below},
    },
    message::{Flags, SYSTEM_COMMANDS},
    record,
    registry::Registry,
    system,
    time::{Clock, Drift, Instant},
    watch,
};

use self::{draw::Drawn, events::EventLog, machine::Machine, mishap::Site};

pub use self::{
    events::EventSink, mishap::Mishap, profile::Faults, script::write_script, shrink::shrink,
};

/// The page on time and simulation: its example runs with the documentation's.
#[cfg(doctest)]
#[doc = include_str!("../../docs/time-and-simulation.md")]
struct Page;

/// So many steps without the clock moving are a task that never waits.
const STEPS_AT_ONCE: u64 = 10_000_000;

/// A rule of the links that a test breaks, to see that it is noticed. Nobody else has a use for it.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Breach {
    /// Some frames arrive twice.
    Duplicate,
    /// Some frames change places with the one before them between the same tasks.
    Swap,
    /// Some frames never arrive.
    Lose,
    /// Some requests arrive at another task.
    Misdeliver,
}

impl Breach {
    /// Only what tasks send each other is broken: a boot that fails would hide it.
    pub(crate) fn concerns(self, frame: &Frame) -> bool {
        let of_the_app = frame.header.command < SYSTEM_COMMANDS;
        let request = !frame.header.flags.contains(Flags::REPLY);
        of_the_app && (request || self == Self::Lose)
    }
}

/// How an app is simulated.
pub struct Setup {
    /// The clock that shows the true time: [`Clock::virtual_clock`], kept by who wants to read it.
    pub clock: Clock,
    /// What goes wrong.
    pub faults: Faults,
    /// Where every delivery is written to, a line each.
    pub events: Option<EventSink>,
    /// When the app is stopped as by Ctrl-C.
    pub stop_after: Option<Duration>,
    #[doc(hidden)]
    pub breach: Option<Breach>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            clock: Clock::virtual_clock(),
            faults: Faults::none(),
            events: None,
            stop_after: None,
            breach: None,
        }
    }
}

impl std::fmt::Debug for Setup {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Setup(faults `{}`)", self.faults.name())
    }
}

/// A simulated run.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// How the app ended.
    pub outcome: Outcome,
    /// What went wrong, in order. [`Faults::of_script`] of it makes the same run again.
    pub faults: Vec<Mishap>,
}

/// Runs `app` to its end on the virtual clock of `setup`, whatever its `time.mode` is.
///
/// # Errors
/// [`BootError::NoChassis`] when a fault names a chassis that the app has not.
pub fn run(
    app: App,
    registry: Registry,
    setup: Setup,
    observer: &Observer,
) -> Result<Run, BootError> {
    run_shared(Arc::new(app), Arc::new(registry), setup, observer)
}

/// [`run`] for many runs with one registry.
///
/// # Errors
/// As [`run`].
pub fn run_shared(
    app: Arc<App>,
    registry: Arc<Registry>,
    setup: Setup,
    observer: &Observer,
) -> Result<Run, BootError> {
    Ok(Simulation::new(app, registry, setup, &boot::contained(observer))?.run())
}

/// How long the process of a chassis takes to start, ns.
const START_NS: std::ops::Range<u64> = 1_000_000..20_000_000;

/// What the bootstrap service wants of the simulated machines.
#[derive(Default)]
struct Orders(Mutex<VecDeque<Order>>);

enum Order {
    Start(u8, u32),
    Kill(u8),
}

impl Processes for Orders {
    fn start(&self, index: u8, incarnation: u32) {
        lock(&self.0).push_back(Order::Start(index, incarnation));
    }

    fn kill(&self, index: u8) {
        lock(&self.0).push_back(Order::Kill(index));
    }
}

/// The exits that chassis asked for: number, incarnation and exit code.
type Exits = Arc<Mutex<VecDeque<(u8, u32, i32)>>>;

fn watch_exit(chassis: &Arc<Chassis>, incarnation: u32, exits: &Exits) {
    let (exits, index) = (exits.clone(), chassis.index());
    chassis.set_on_exit(move |code| lock(&exits).push_back((index, incarnation, code)));
}

/// How a process ended that a fault, or the supervisor, ended.
const KILLED: &str = "was killed by signal 9 (SIGKILL)";

struct Simulation {
    clock: Clock,
    machines: Vec<Machine>,
    network: Network,
    rng: ChaCha8Rng,
    end: EndSlot,
    /// What is given, by moment.
    script: BTreeMap<Instant, Vec<Mishap>>,
    drawn: Drawn,
    stop_at: Option<Instant>,
    happened: Vec<Mishap>,
    /// Processes that would have ended by themselves now.
    exits: Exits,
    /// How the last process of a chassis ended, if otherwise than it should have.
    casualties: BTreeMap<u8, String>,
    /// Which process of each chassis is the last that was wanted, from 1.
    incarnations: BTreeMap<u8, u32>,
    orders: Arc<Orders>,
    /// Processes on their way up, by the moment at which they are there.
    starts: BTreeMap<(Instant, u8), u32>,
    events: EventLog,
    recording: Option<record::Recording>,
    observer: Observer,
    steps_at_once: u64,
    /// Kept between steps for its room.
    counts: Vec<usize>,
}

impl Simulation {
    fn new(
        app: Arc<App>,
        registry: Arc<Registry>,
        setup: Setup,
        observer: &Observer,
    ) -> Result<Self, BootError> {
        let Setup {
            clock,
            faults,
            events,
            stop_after,
            breach,
        } = setup;
        let seed = app.seed;
        let names: Vec<String> = std::iter::once(BOOT_CHASSIS.to_owned())
            .chain(app.chassis.iter().map(|chassis| chassis.name.clone()))
            .collect();
        let mut happened = Drawn::drifts(&faults, &app, &names);
        let drawn = Drawn::new(&faults, &app, &names);
        let script = schedule(&names, faults.script, &mut happened)?;
        let network = Network::new(clock.clone(), seed, app.links.peer_timeout, breach);
        let events = EventLog::new(events, clock.clone());
        let count = u8::try_from(app.chassis.len()).unwrap_or(u8::MAX - 1);
        let chassis: Vec<Arc<Chassis>> = (0..=count)
            .zip(&names)
            .map(|(index, name)| {
                let clock = clock.drifting(drift_of(name, &happened));
                Chassis::new(index, app.clone(), registry.clone(), clock)
            })
            .collect();
        let recording = record::start(&chassis).map_err(boot::io_error("cannot record"))?;
        let exits = Exits::default();
        for from in &chassis {
            events.watch(from, &chassis);
            for to in from.others() {
                from.link_up(to, network.link(from.index(), to));
            }
            if from.index() > 0 {
                observer(&BootEvent::Started {
                    host: None,
                    chassis: from.name().to_owned(),
                    pid: None,
                });
                watch_exit(from, 1, &exits);
            }
        }
        for fault in &happened {
            events.note(|| format!("fault {fault}"));
        }
        let machines: Vec<Machine> = chassis.into_iter().map(Machine::new).collect();
        let orders = Arc::new(Orders::default());
        let seat = Seat {
            observer: observer.clone(),
            end: EndSlot::default(),
            processes: orders.clone(),
        };
        for machine in &machines {
            let boots = machine.chassis.index() == 0;
            boot::start_system_tasks(&machine.chassis, boots.then_some(&seat));
        }
        Ok(Self {
            stop_at: stop_after.map(|after| clock.now() + after),
            clock,
            machines,
            network,
            rng: ChaCha8Rng::seed_from_u64(mix(seed, &["schedule"])),
            end: seat.end,
            script,
            drawn,
            happened,
            exits,
            casualties: BTreeMap::new(),
            incarnations: BTreeMap::new(),
            orders,
            starts: BTreeMap::new(),
            events,
            recording,
            observer: observer.clone(),
            steps_at_once: 0,
            counts: Vec::new(),
        })
    }

    fn run(mut self) -> Run {
        if let Some(boot) = self.machines.first() {
            boot.chassis
                .post_system(system::BOOTSTRAP, system::AllLinked {});
        }
        let end = loop {
            if let Some(end) = lock(&self.end).take() {
                break end;
            }
            if !self.step(None) {
                break End::Stuck;
            }
        };
        let took = self.clock.now().since_start();
        if end != End::Stuck {
            self.end_processes();
        }
        self.events.note(|| format!("end {end:?}"));
        for machine in &self.machines {
            machine.chassis.drop_links();
        }
        for machine in &self.machines {
            machine.clear();
        }
        for machine in &self.machines {
            machine.chassis.close();
        }
        if let Some(recording) = self.recording {
            recording.finish();
        }
        let casualties = self.casualties.into_iter().map(|(index, how)| {
            let machine = self.machines.get(usize::from(index));
            let name = machine.map_or("", |machine| machine.chassis.name());
            (name.to_owned(), how)
        });
        Run {
            outcome: Outcome {
                end,
                casualties: casualties.collect(),
                took,
            },
            faults: self.happened,
        }
    }

    /// Runs what is ready, or moves the clock to what happens next, but not beyond `limit`. False when
    /// nothing can happen any more, or nothing until then.
    fn step(&mut self, limit: Option<Instant>) -> bool {
        if self.run_jobs() || self.run_exits() || self.run_orders() || self.poll_one() {
            self.steps_at_once += 1;
            if self.steps_at_once > STEPS_AT_ONCE {
                let moment = self.clock.now();
                tracing::error!(at = %moment, steps = STEPS_AT_ONCE, "a task goes on for ever without waiting");
                return false;
            }
            return true;
        }
        match self.next_event() {
            Some(moment) if limit.is_none_or(|limit| moment <= limit) => {
                self.advance(moment);
                true
            }
            _ => false,
        }
    }

    /// The boot is done and waits for the processes; those that do not end by themselves are killed.
    fn end_processes(&mut self) {
        let Some(boot) = self.machines.first().map(|machine| machine.chassis.clone()) else {
            return;
        };
        boot.drop_links();
        for other in boot.others() {
            self.network.hang_up(0, other);
        }
        let limit = self.clock.now() + boot.app.stop_timeout;
        let ended = |machines: &[Machine]| machines.iter().skip(1).all(|machine| machine.gone);
        while !ended(&self.machines) && self.step(Some(limit)) {}
        for index in boot.others() {
            let left = self.machines.get(usize::from(index));
            if left.is_some_and(|machine| !machine.gone) {
                (self.observer)(&BootEvent::Signalled {
                    chassis: boot.name_of(index).to_owned(),
                    signal: "SIGKILL".to_owned(),
                });
                self.kill(index);
            }
        }
    }

    /// Ends the processes that have come to their end by themselves.
    fn run_exits(&mut self) -> bool {
        let Some((index, incarnation, code)) = lock(&self.exits).pop_front() else {
            return false;
        };
        if incarnation == self.incarnation(index) {
            let how = format!("ended with exit code {code}");
            // 0 and 1 are what the boot orders; anything else the chassis chose itself.
            self.end_chassis(index, &how, Some(code), code > 1);
        }
        true
    }

    /// Does what the bootstrap service wants.
    fn run_orders(&mut self) -> bool {
        let order = lock(&self.orders.0).pop_front();
        match order {
            Some(Order::Start(index, incarnation)) => {
                let delay = Duration::from_nanos(self.rng.random_range(START_NS));
                self.starts
                    .insert((self.clock.now() + delay, index), incarnation);
                self.incarnations.insert(index, incarnation);
            }
            Some(Order::Kill(index)) => self.kill(index),
            None => return false,
        }
        true
    }

    /// Which process of chassis `index` is the last that was wanted.
    fn incarnation(&self, index: u8) -> u32 {
        self.incarnations.get(&index).copied().unwrap_or(1)
    }

    fn kill(&mut self, index: u8) {
        self.end_chassis(index, KILLED, None, true);
    }

    /// A process ends: nothing of it runs any more, and the others see its links close.
    fn end_chassis(&mut self, index: u8, how: &str, code: Option<i32>, casualty: bool) {
        let incarnation = self.incarnation(index);
        if let Some(boot) = self.machines.first() {
            // Also of one that has not started yet: it never will.
            let ended = system::ProcessEnded {
                chassis: index,
                incarnation,
                how: how.to_owned(),
                code,
            };
            boot.chassis.post_system(system::BOOTSTRAP, ended);
        }
        self.starts.retain(|(_, starting), _| *starting != index);
        let Some(machine) = self.machines.get_mut(usize::from(index)) else {
            return;
        };
        if std::mem::replace(&mut machine.gone, true) {
            return;
        }
        let chassis = machine.chassis.clone();
        self.events
            .note(|| format!("chassis {} {how}", chassis.name()));
        if casualty {
            self.casualties.insert(index, how.to_owned());
        }
        // First the links, so that what its destructors send reaches nobody.
        chassis.drop_links();
        machine.clear();
        for other in chassis.others() {
            self.network.hang_up(index, other);
        }
        chassis.close();
    }

    /// A process starts in place of the one that ended, and is connected to those that live.
    fn start_chassis(&mut self, index: u8, incarnation: u32) {
        let Some(old) = self.machines.get(usize::from(index)) else {
            return;
        };
        let old = &old.chassis;
        let (app, registry) = (old.app.clone(), old.registry.clone());
        let new = Chassis::new(index, app, registry, old.clock.clone());
        self.events
            .note(|| format!("chassis {} starts again", new.name()));
        for machine in self.machines.iter().filter(|machine| !machine.gone) {
            let peer = &machine.chassis;
            // Nothing of the old process may come out of the links of the new one.
            peer.link_down(index);
            peer.link_up(index, self.network.link(peer.index(), index));
            new.link_up(peer.index(), self.network.link(index, peer.index()));
        }
        watch_exit(&new, incarnation, &self.exits);
        if let Some(recording) = &self.recording {
            recording.add(&new);
        }
        let mut all: Vec<_> = self
            .machines
            .iter()
            .map(|one| one.chassis.clone())
            .collect();
        if let Some(place) = all.get_mut(usize::from(index)) {
            place.clone_from(&new);
        }
        self.events.watch(&new, &all);
        boot::start_system_tasks(&new, None);
        self.casualties.remove(&index);
        if let Some(place) = self.machines.get_mut(usize::from(index)) {
            *place = Machine::new(new);
        }
        if let Some(boot) = self.machines.first() {
            let linked = system::ChassisLinked {
                chassis: index,
                incarnation,
            };
            boot.chassis.post_system(system::BOOTSTRAP, linked);
        }
    }

    fn index(&self, name: &str) -> Option<usize> {
        let mut machines = self.machines.iter();
        machines.position(|machine| machine.chassis.name() == name)
    }

    fn happen(&mut self, mishap: Mishap) {
        self.events.note(|| format!("fault {mishap}"));
        match mishap.site() {
            Site::Chassis(name) => {
                if let Some(index) = self.index(name) {
                    self.happen_to(index, &mishap);
                }
            }
            Site::Link(one, other) => {
                if let (Some(one), Some(other)) = (self.index(one), self.index(other)) {
                    self.happen_between(one, other, &mishap);
                }
            }
        }
        self.happened.push(mishap);
    }

    fn happen_to(&mut self, index: usize, mishap: &Mishap) {
        let Some(machine) = self.machines.get_mut(index) else {
            return;
        };
        let number = machine.chassis.index();
        match mishap {
            Mishap::Kill { .. } => self.kill(number),
            Mishap::Freeze { until, .. } if !machine.gone => {
                machine.freeze(*until);
                for other in self.machines.iter().filter(|other| !other.gone) {
                    let peer = other.chassis.index();
                    if peer != number {
                        self.network.freeze(number, (peer, other.clock()), *until);
                    }
                }
            }
            Mishap::Slow {
                until, per_step, ..
            } => machine.slow(*until, *per_step),
            _ => {}
        }
    }

    fn happen_between(&self, one: usize, other: usize, mishap: &Mishap) {
        let (Some(first), Some(second)) = (self.machines.get(one), self.machines.get(other)) else {
            return;
        };
        let ends = (first.chassis.index(), second.chassis.index());
        let clocks = || ((ends.0, first.clock()), (ends.1, second.clock()));
        match mishap {
            Mishap::Cut { .. } => {
                self.network.cut(ends.0, ends.1);
                first.chassis.link_down(ends.1);
                second.chassis.link_down(ends.0);
            }
            Mishap::Break { until, .. } => {
                let (one, other) = clocks();
                self.network.silence(one, other, *until, true);
            }
            Mishap::Stall { until, .. } => {
                let (one, other) = clocks();
                self.network.silence(one, other, *until, false);
            }
            Mishap::Loss {
                until, share_ppm, ..
            } => self.network.lose(ends.0, ends.1, *until, *share_ppm),
            Mishap::Delay { until, extra, .. } => {
                self.network.delay(ends.0, ends.1, *until, *extra);
            }
            _ => {}
        }
    }

    fn run_jobs(&self) -> bool {
        let mut any = false;
        for machine in &self.machines {
            any |= machine.run_jobs();
        }
        any
    }

    /// Polls one of the futures that are ready, drawn from the seed.
    fn poll_one(&mut self) -> bool {
        let now = self.clock.now();
        self.counts.clear();
        for machine in &self.machines {
            machine.count_ready(now, &mut self.counts);
        }
        let total: usize = self.counts.iter().sum();
        if total == 0 {
            return false;
        }
        let mut drawn = below(&mut self.rng, total);
        let mut counts = self.counts.iter();
        for machine in &mut self.machines {
            for (processor, count) in (0..machine.processors()).zip(&mut counts) {
                if drawn < *count {
                    return machine.poll(processor, drawn, now);
                }
                drawn -= count;
            }
        }
        false
    }

    fn next_event(&self) -> Option<Instant> {
        let now = self.clock.now();
        let machines = self.machines.iter();
        let machines = machines.filter_map(|machine| machine.next_event(now));
        let starts = self.starts.keys().next().map(|key| key.0);
        let next = machines
            .chain(self.network.next_arrival())
            .chain(starts)
            .min();
        // When nothing else can ever happen, what is given still can; what is drawn has no end.
        let drawn = next.and(self.drawn.next());
        let given = self.script.keys().next().copied();
        next.into_iter()
            .chain(drawn)
            .chain(given)
            .chain(self.stop_at)
            .min()
    }

    /// Moves the clock and lets everything happen that is due then.
    fn advance(&mut self, moment: Instant) {
        let chassis = self.machines.iter().map(|machine| &machine.chassis);
        watch::look_until(&self.clock, chassis, moment);
        self.clock.advance_to(moment);
        self.steps_at_once = 0;
        while let Some(entry) = self.script.first_entry() {
            if *entry.key() > moment {
                break;
            }
            for mishap in entry.remove() {
                self.happen(mishap);
            }
        }
        while let Some(entry) = self.starts.first_entry() {
            let (due, index) = *entry.key();
            if due > moment {
                break;
            }
            let incarnation = entry.remove();
            self.start_chassis(index, incarnation);
        }
        while let Some(mishap) = self.drawn.pop(moment) {
            self.happen(mishap);
        }
        if self.stop_at.is_some_and(|at| at <= moment) {
            self.stop_at = None;
            if let Some(boot) = self.machines.first() {
                boot.chassis
                    .post_system(system::BOOTSTRAP, system::Interrupt {});
            }
        }
        while let Some(flight) = self.network.arrive(moment) {
            self.land(flight, moment);
        }
        for machine in &self.machines {
            machine.run_due(moment);
        }
    }

    fn land(&self, flight: InFlight, now: Instant) {
        let InFlight { from, to, arrival } = flight;
        let Some(machine) = self.machines.get(usize::from(to)) else {
            return;
        };
        // The dead hear nothing.
        if machine.gone {
            return;
        }
        let chassis = &machine.chassis;
        match arrival {
            Arrival::Frame(frame) => chassis.receive(from, frame),
            Arrival::Closed => self.link_down(chassis, from),
            Arrival::Silence => match machine.frozen(now) {
                // Who stands still itself listens first when it goes on.
                Some(until) => self.network.listen_again(from, to, until),
                None => {
                    self.network.give_up(from, to);
                    self.link_down(chassis, from);
                }
            },
        }
    }

    fn link_down(&self, chassis: &Arc<Chassis>, peer: u8) {
        if chassis.is_linked(peer) {
            let name = chassis.name_of(peer);
            self.events
                .note(|| format!("down {} loses {name}", chassis.name()));
        }
        chassis.link_down(peer);
    }
}

/// Faults by the moment at which they happen; those of clocks, which are wrong from the start, take the
/// place of those that were drawn.
fn schedule(
    names: &[String],
    given: Vec<Mishap>,
    drifts: &mut Vec<Mishap>,
) -> Result<BTreeMap<Instant, Vec<Mishap>>, BootError> {
    let check = |name: &str, mishap: &Mishap| {
        let killed = matches!(mishap, Mishap::Kill { .. });
        if names.iter().any(|known| known == name) && !(killed && name == BOOT_CHASSIS) {
            return Ok(());
        }
        Err(BootError::NoChassis {
            chassis: name.to_owned(),
            what: mishap.called(),
        })
    };
    let mut script: BTreeMap<Instant, Vec<Mishap>> = BTreeMap::new();
    for mishap in given {
        match mishap.site() {
            Site::Chassis(chassis) => check(chassis, &mishap)?,
            Site::Link(one, other) => {
                check(one, &mishap)?;
                check(other, &mishap)?;
            }
        }
        if let Mishap::Drift { chassis, .. } = &mishap {
            drifts.retain(|other| !matches!(other.site(), Site::Chassis(name) if name == chassis));
            drifts.push(mishap);
        } else {
            script.entry(mishap.at()).or_default().push(mishap);
        }
    }
    Ok(script)
}

fn drift_of(name: &str, drifts: &[Mishap]) -> Drift {
    let found = drifts.iter().find_map(|mishap| match mishap {
        Mishap::Drift {
            chassis,
            ahead,
            rate_ppb,
        } if chassis == name => Some(Drift {
            offset_ns: u64::try_from(ahead.as_nanos()).unwrap_or(0),
            rate_ppb: *rate_ppb,
        }),
        _ => None,
    });
    found.unwrap_or_default()
}
