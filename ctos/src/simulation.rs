//! A whole app in one thread on the virtual clock.
//!
//! All chassis live in this process and exchange encoded frames over simulated links. One loop polls
//! the tasks that can run, in an order drawn from the app's seed; when none can, it moves the clock to
//! the next deadline. The same seed gives the same run, event for event.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    rc::Rc,
    sync::{Arc, Mutex},
    time::Duration,
};

use rand::RngExt;

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    boot::{self, BootError, BootEvent, End, Mishap, Observer, Outcome},
    bootstrap::{EndSlot, Processes, Seat},
    call::lock,
    chassis::{BOOT_CHASSIS, Chassis},
    config::App,
    context::mix,
    link::simulated::{Network, below},
    processor::Processor,
    registry::Registry,
    system,
    time::{Clock, Instant},
};

/// What happens to the simulated machines at a moment, with the chassis as numbers.
#[derive(Debug, Clone, Copy)]
enum Happening {
    Kill(u8),
    Cut(u8, u8),
    Stall(u8, u8, Instant),
    /// The process of a chassis has started, as the incarnation of this number.
    Start(u8, u32),
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

struct Simulation {
    clock: Clock,
    chassis: Vec<Arc<Chassis>>,
    /// Those of each chassis, by its number.
    processors: Vec<Vec<Rc<Processor>>>,
    network: Network,
    rng: ChaCha8Rng,
    end: EndSlot,
    happenings: BTreeMap<Instant, Vec<Happening>>,
    /// Processes that would have ended by themselves now.
    exits: Exits,
    gone: BTreeSet<u8>,
    /// How the last process of a chassis ended, if otherwise than it should have.
    casualties: BTreeMap<u8, String>,
    /// Which process of each chassis this is, from 1.
    incarnations: BTreeMap<u8, u32>,
    orders: Arc<Orders>,
}

/// Runs `app` to its end on a virtual clock.
pub(crate) fn run(
    clock: &Clock,
    app: Arc<App>,
    registry: Arc<Registry>,
    mishaps: &[Mishap],
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let clock = clock.clone();
    let seed = app.seed;
    let network = Network::new(
        clock.clone(),
        ChaCha8Rng::seed_from_u64(mix(seed, &["simulated links"])),
    );
    let happenings = schedule(&app, mishaps)?;
    let count = u8::try_from(app.chassis.len()).unwrap_or(u8::MAX - 1);
    let chassis: Vec<Arc<Chassis>> = (0..=count)
        .map(|index| Chassis::new(index, app.clone(), registry.clone(), clock.clone()))
        .collect();
    let exits = Exits::default();
    for from in &chassis {
        for to in from.others() {
            from.link_up(to, network.link(from.index(), to));
        }
        if from.index() > 0 {
            observer(&BootEvent::Started {
                chassis: from.name().to_owned(),
                pid: None,
            });
            watch_exit(from, 1, &exits);
        }
    }
    let processors = chassis.iter().map(processors_of).collect();
    let orders = Arc::new(Orders::default());
    let seat = Seat {
        observer: observer.clone(),
        end: EndSlot::default(),
        processes: orders.clone(),
    };
    for one in &chassis {
        boot::start_system_tasks(one, (one.index() == 0).then_some(&seat));
    }
    let simulation = Simulation {
        clock,
        chassis,
        processors,
        network,
        rng: ChaCha8Rng::seed_from_u64(mix(seed, &["schedule"])),
        end: seat.end,
        happenings,
        exits,
        gone: BTreeSet::new(),
        casualties: BTreeMap::new(),
        incarnations: BTreeMap::new(),
        orders,
    };
    Ok(simulation.run())
}

fn processors_of(chassis: &Arc<Chassis>) -> Vec<Rc<Processor>> {
    let handles = chassis.processors.iter();
    handles
        .map(|(_, handle)| Processor::new(handle.clone(), chassis.clock.clone()))
        .collect()
}

fn watch_exit(chassis: &Arc<Chassis>, incarnation: u32, exits: &Exits) {
    let (exits, index) = (exits.clone(), chassis.index());
    chassis.set_on_exit(move |code| lock(&exits).push_back((index, incarnation, code)));
}

/// Mishaps by the moment at which they happen.
fn schedule(app: &App, mishaps: &[Mishap]) -> Result<BTreeMap<Instant, Vec<Happening>>, BootError> {
    let number = |name: &str, what: &'static str| {
        if name == BOOT_CHASSIS && what != "a kill" {
            return Ok(0);
        }
        let position = app.chassis.iter().position(|config| config.name == name);
        position
            .and_then(|position| u8::try_from(position + 1).ok())
            .ok_or_else(|| BootError::NoChassis {
                chassis: name.to_owned(),
                what,
            })
    };
    let mut happenings: BTreeMap<Instant, Vec<Happening>> = BTreeMap::new();
    for mishap in mishaps {
        let (moment, happening) = match mishap {
            Mishap::Kill { chassis, at } => (*at, Happening::Kill(number(chassis, "a kill")?)),
            Mishap::Cut { one, other, at } => {
                let (one, other) = (number(one, "a cut")?, number(other, "a cut")?);
                (*at, Happening::Cut(one, other))
            }
            Mishap::Stall {
                one,
                other,
                at,
                until,
            } => {
                let (one, other) = (number(one, "a stall")?, number(other, "a stall")?);
                (*at, Happening::Stall(one, other, *until))
            }
        };
        happenings.entry(moment).or_default().push(happening);
    }
    Ok(happenings)
}

impl Simulation {
    fn run(mut self) -> Outcome {
        if let Some(boot) = self.chassis.first() {
            boot.post_system(system::BOOTSTRAP, system::AllLinked {});
        }
        let end = loop {
            if let Some(end) = lock(&self.end).take() {
                break end;
            }
            if self.run_jobs() || self.run_exits() || self.run_orders() || self.poll_one() {
                continue;
            }
            match self.next_event() {
                Some(moment) => self.advance(moment),
                None => break End::Stuck,
            }
        };
        let took = self.clock.now().since_start();
        let names = self.casualties.into_iter().map(|(index, how)| {
            let chassis = self.chassis.get(usize::from(index));
            (chassis.map_or("", |chassis| chassis.name()).to_owned(), how)
        });
        let casualties = names.collect();
        for chassis in &self.chassis {
            chassis.drop_links();
        }
        for processor in self.processors.iter().flatten() {
            processor.clear();
        }
        for chassis in &self.chassis {
            chassis.close();
        }
        Outcome {
            end,
            casualties,
            took,
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
                let due = self.happenings.entry(self.clock.now() + delay).or_default();
                due.push(Happening::Start(index, incarnation));
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
        self.end_chassis(index, "was killed by signal 9 (SIGKILL)", None, true);
    }

    /// A process ends: nothing of it runs any more, and the others see its links close.
    fn end_chassis(&mut self, index: u8, how: &str, code: Option<i32>, casualty: bool) {
        let incarnation = self.incarnation(index);
        if let Some(boot) = self.chassis.first() {
            // Also of one that has not started yet: it never will.
            boot.post_system(
                system::BOOTSTRAP,
                system::ProcessEnded {
                    chassis: index,
                    incarnation,
                    how: how.to_owned(),
                    code,
                },
            );
        }
        for happenings in self.happenings.values_mut() {
            happenings.retain(|one| !matches!(one, Happening::Start(of, _) if *of == index));
        }
        if !self.gone.insert(index) {
            return;
        }
        let Some(chassis) = self.chassis.get(usize::from(index)) else {
            return;
        };
        if casualty {
            self.casualties.insert(index, how.to_owned());
        }
        // First the links, so that what its destructors send reaches nobody.
        chassis.drop_links();
        for processor in self
            .processors
            .get(usize::from(index))
            .into_iter()
            .flatten()
        {
            processor.clear();
        }
        for other in chassis.others() {
            self.network.hang_up(index, other);
        }
        chassis.close();
    }

    /// A process starts in place of the one that ended, and is connected to those that live.
    fn start_chassis(&mut self, index: u8, incarnation: u32) {
        let place = usize::from(index);
        let Some(old) = self.chassis.get(place) else {
            return;
        };
        let new = Chassis::new(
            index,
            old.app.clone(),
            old.registry.clone(),
            self.clock.clone(),
        );
        for other in new.others().filter(|other| !self.gone.contains(other)) {
            let Some(peer) = self.chassis.get(usize::from(other)) else {
                continue;
            };
            // Nothing of the old process may come out of the links of the new one.
            self.network.cut(index, other);
            peer.link_down(index);
            peer.link_up(index, self.network.link(other, index));
            new.link_up(other, self.network.link(index, other));
        }
        watch_exit(&new, incarnation, &self.exits);
        boot::start_system_tasks(&new, None);
        self.gone.remove(&index);
        self.casualties.remove(&index);
        if let Some(processors) = self.processors.get_mut(place) {
            *processors = processors_of(&new);
        }
        if let Some(place) = self.chassis.get_mut(place) {
            *place = new;
        }
        if let Some(boot) = self.chassis.first() {
            let linked = system::ChassisLinked {
                chassis: index,
                incarnation,
            };
            boot.post_system(system::BOOTSTRAP, linked);
        }
    }

    fn happen(&mut self, happening: Happening) {
        match happening {
            Happening::Kill(index) => self.kill(index),
            Happening::Start(index, incarnation) => self.start_chassis(index, incarnation),
            Happening::Cut(one, other) => {
                self.network.cut(one, other);
                for (end, peer) in [(one, other), (other, one)] {
                    if let Some(chassis) = self.chassis.get(usize::from(end)) {
                        chassis.link_down(peer);
                    }
                }
            }
            Happening::Stall(one, other, until) => self.network.stall(one, other, until),
        }
    }

    fn run_jobs(&self) -> bool {
        let mut any = false;
        for processor in self.processors.iter().flatten() {
            any |= processor.run_jobs();
        }
        any
    }

    /// Polls one of the futures that are ready, drawn from the seed.
    fn poll_one(&mut self) -> bool {
        let counts = self
            .processors
            .iter()
            .flatten()
            .map(|processor| processor.ready_count());
        let total: usize = counts.clone().sum();
        if total == 0 {
            return false;
        }
        let mut drawn = below(&mut self.rng, total);
        for (processor, count) in self.processors.iter().flatten().zip(counts) {
            if drawn < count {
                return processor.poll_ready(drawn);
            }
            drawn -= count;
        }
        false
    }

    fn next_event(&self) -> Option<Instant> {
        let deadlines = self
            .processors
            .iter()
            .flatten()
            .filter_map(|processor| processor.next_deadline());
        let next = deadlines.chain(self.network.next_arrival()).min();
        let mishap = self.happenings.keys().next().copied();
        // When nothing else can ever happen, a mishap still can.
        next.into_iter().chain(mishap).min()
    }

    /// Moves the clock and lets everything happen that is due then.
    fn advance(&mut self, moment: Instant) {
        self.clock.advance_to(moment);
        while let Some(entry) = self.happenings.first_entry() {
            if *entry.key() > moment {
                break;
            }
            for happening in entry.remove() {
                self.happen(happening);
            }
        }
        while let Some(flight) = self.network.arrive(moment) {
            let Some(chassis) = self.chassis.get(usize::from(flight.to)) else {
                continue;
            };
            match flight.frame {
                // The dead hear nothing.
                _ if self.gone.contains(&flight.to) => {}
                Some(frame) => chassis.receive(flight.from, frame),
                None => chassis.link_down(flight.from),
            }
        }
        for processor in self.processors.iter().flatten() {
            processor.run_cyclics();
            processor.fire_timers();
        }
    }
}
