//! The run of a simulated app: one loop over what can go on, and the clock.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use ctos_bootstrap::{
    bootstrap::{BootError, BootEvent, End, EndSlot, Observer, Outcome, ProcessOrders, Seat},
    watch,
};
use ctos_config::App;
use ctos_core::{
    chassis::{BOOT_CHASSIS, Chassis},
    disk::Disk,
    processor::Processor,
    registry::Registry,
    system,
};
use ctos_message::ChassisNumber;
use ctos_record as record;
use ctos_time::{Clock, Instant, lock::lock, seed::mix};

use crate::{
    awake::{Awake, Place},
    draw::Drawn,
    events::{EventLog, EventSink},
    fault::Fault,
    happen::{drift_of, schedule},
    injured,
    machine::Machine,
    network::{Arrival, InFlight, Network, Tamper, below},
    processes::{Exits, watch_exit},
    profile::Faults,
};

/// So many steps without the clock moving are a task that never waits.
const STEPS_AT_ONCE: u64 = 10_000_000;

/// How an app is simulated.
#[derive(derive_more::Debug)]
#[debug("Setup(faults `{}`)", self.faults.name())]
pub struct Setup {
    /// The clock that shows the true time: [`Clock::virtual_clock`], kept by the code that reads
    /// it.
    pub clock: Clock,
    /// What goes wrong.
    pub faults: Faults,
    /// Where every delivery is written to, a line each.
    pub events: Option<EventSink>,
    /// When the app is stopped as by Ctrl-C.
    pub stop_after: Option<Duration>,
    /// When the second interrupt comes.
    pub stop_again_after: Option<Duration>,
    #[doc(hidden)]
    pub tamper: Option<Tamper>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            clock: Clock::virtual_clock(),
            faults: Faults::none(),
            events: None,
            stop_after: None,
            stop_again_after: None,
            tamper: None,
        }
    }
}

/// A simulated run.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// How the app ended.
    pub outcome: Outcome,
    /// What went wrong, in order. [`Faults::of_script`] of it makes the same run again.
    pub faults: Vec<Fault>,
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
    let observer = ctos_bootstrap::bootstrap::contained(observer);
    Ok(Simulation::new(app, registry, setup, &observer)?.run())
}

pub(super) struct Simulation {
    pub(super) clock: Clock,
    pub(super) machines: Vec<Machine>,
    pub(super) network: Network,
    pub(super) rng: ChaCha8Rng,
    pub(super) end: EndSlot,
    /// The given faults, by moment.
    pub(super) script: BTreeMap<Instant, Vec<Fault>>,
    pub(super) drawn: Drawn,
    /// When it is stopped as by Ctrl-C.
    pub(super) stops: BTreeSet<Instant>,
    pub(super) happened: Vec<Fault>,
    /// What of the script the app's own configuration asks for.
    pub(super) injuries: Vec<Fault>,
    /// Processes that would have ended by themselves now.
    pub(super) exits: Exits,
    /// How the last process of a chassis ended, if otherwise than it should have.
    pub(super) casualties: BTreeMap<ChassisNumber, String>,
    /// Which process of each chassis is the last that was wanted, from 1.
    pub(super) incarnations: BTreeMap<ChassisNumber, u32>,
    pub(super) orders: ProcessOrders,
    /// Processes on their way up, by the moment at which they are there.
    pub(super) starts: BTreeMap<(Instant, ChassisNumber), u32>,
    pub(super) events: EventLog,
    pub(super) recording: Option<record::Recording>,
    pub(super) observer: Observer,
    pub(super) steps_at_once: u64,
    pub(super) awake: Awake,
    /// When the chassis looked at themselves last.
    last_look: Instant,
    /// The processor whose code ran last: what comes to it need not be brought.
    here: Option<Place>,
}

impl Simulation {
    fn new(
        app: Arc<App>,
        registry: Arc<Registry>,
        setup: Setup,
        observer: &Observer,
    ) -> Result<Self, BootError> {
        let Setup { clock, faults, .. } = setup;
        let seed = app.seed;
        let names: Vec<String> = std::iter::once(BOOT_CHASSIS.to_owned())
            .chain(app.chassis.iter().map(|chassis| chassis.name.clone()))
            .collect();
        let mut happened = Drawn::drifts(&faults, &app, &names);
        let drawn = Drawn::new(&faults, &app, &names);
        let mut script = schedule(&names, faults.script, &mut happened)?;
        let injuries = injured::faults(&app.links.injury);
        for injury in &injuries {
            let at = script.entry(injury.at).or_default();
            at.push(injury.clone());
        }
        let network = Network::new(clock.clone(), &app, setup.tamper);
        let events = EventLog::new(setup.events, clock.clone());
        let count = ChassisNumber::try_from(app.chassis.len()).unwrap_or(ChassisNumber::MAX - 1);
        let disk = Arc::new(Disk::default());
        let chassis: Vec<Arc<Chassis>> = (0..=count)
            .zip(&names)
            .map(|(index, name)| {
                let clock = clock.drifting(drift_of(name, &happened));
                let chassis = Chassis::new(index, app.clone(), registry.clone(), clock);
                chassis.set_disk(disk.clone());
                chassis
            })
            .collect();
        let recording = record::start(&chassis, watch::COMMANDS)
            .map_err(ctos_bootstrap::bootstrap::io_error("cannot record"))?;
        let exits = Exits::default();
        for one in &chassis {
            events.watch(one);
            // The others start when they are asked for.
            if one.starts_on_demand(one.index()) {
                continue;
            }
            network.join(one);
            if one.index() > 0 {
                one.reach(0);
                observer(&BootEvent::Started {
                    host: None,
                    chassis: one.name().to_owned(),
                    pid: None,
                });
                watch_exit(one, 1, &exits);
            }
        }
        for fault in &happened {
            events.note(|| format!("fault {fault}"));
        }
        let mut machines: Vec<Machine> = chassis.into_iter().map(Machine::new).collect();
        for machine in &mut machines {
            let chassis = &machine.chassis;
            machine.gone = chassis.starts_on_demand(chassis.index());
        }
        let (seat, orders) = Seat::new(observer);
        for machine in machines.iter().filter(|machine| !machine.gone) {
            let boots = machine.chassis.index() == 0;
            ctos_bootstrap::bootstrap::start_system_tasks(&machine.chassis, boots.then_some(&seat));
        }
        let mut awake = Awake::default();
        for (number, machine) in machines.iter().enumerate() {
            for (place, processor) in machine.processors().enumerate() {
                awake.add((number, place), processor);
            }
        }
        Ok(Self {
            stops: [setup.stop_after, setup.stop_again_after]
                .into_iter()
                .flatten()
                .map(|after| clock.now() + after)
                .collect(),
            clock,
            machines,
            network,
            rng: ChaCha8Rng::seed_from_u64(mix(seed, &["schedule"])),
            end: seat.end,
            script,
            drawn,
            happened,
            injuries,
            exits,
            casualties: BTreeMap::new(),
            incarnations: BTreeMap::new(),
            orders,
            starts: BTreeMap::new(),
            events,
            recording,
            observer: observer.clone(),
            steps_at_once: 0,
            awake,
            last_look: Instant::START,
            here: None,
        })
    }

    fn run(mut self) -> Run {
        self.tell_boot(system::AllLinked {});
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

    /// Runs what is ready, or moves the clock to what happens next, but not beyond `deadline`. False when
    /// nothing can happen any more, or nothing until then.
    pub fn step(&mut self, deadline: Option<Instant>) -> bool {
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
            Some(moment) if deadline.is_none_or(|deadline| moment <= deadline) => {
                self.advance(moment);
                true
            }
            _ => false,
        }
    }

    /// Runs what was brought to processors, in their order. What one brings to a later one is run at once.
    fn run_jobs(&mut self) -> bool {
        let (mut any, mut behind) = (false, None);
        self.here
            .into_iter()
            .for_each(|here| self.awake.rouse(here));
        while let Some(place) = self.awake.next_stale(behind) {
            let machine = self.machines.get(place.0);
            if machine.is_some_and(|machine| machine.run_jobs(place.1)) {
                any = true;
                self.here = Some(place);
            }
            self.count(place);
            behind = Some(place);
        }
        any
    }

    /// Counts what is ready at a processor. It is looked at again when something is brought.
    fn count(&mut self, place: Place) {
        let (machine, now) = (self.machines.get(place.0), self.clock.now());
        let ready = machine.map_or(0, |machine| machine.count_ready(place.1, now));
        self.awake.counts.set(place, ready);
        if !machine.is_some_and(|machine| machine.listens(place.1)) {
            self.awake.rouse(place);
        }
    }

    /// Polls one of the futures that are ready, drawn from the seed.
    fn poll_one(&mut self) -> bool {
        let (now, counts) = (self.clock.now(), &self.awake.counts);
        if counts.total == 0 {
            return false;
        }
        let Some((place, index)) = counts.find(below(&mut self.rng, counts.total)) else {
            return false;
        };
        let machine = self.machines.get_mut(place.0);
        let polled = machine.is_some_and(|machine| machine.poll(place.1, index, now));
        self.here = Some(place);
        self.count(place);
        polled
    }

    /// When the first processor has something to do. Those that have nothing to do now fall asleep.
    fn next_due(&mut self) -> Option<Instant> {
        let now = self.clock.now();
        let (mut first, mut behind) = (None, None);
        while let Some(place) = self.awake.next(behind) {
            behind = Some(place);
            let Some(machine) = self.machines.get(place.0) else {
                continue;
            };
            let due = machine.next_event(place.1, now);
            if machine.falls_asleep(place.1, now) {
                self.awake.sleeps(place, due);
            } else {
                first = first.into_iter().chain(due).min();
            }
        }
        first.into_iter().chain(self.awake.next_due()).min()
    }

    fn next_event(&mut self) -> Option<Instant> {
        let due = self.next_due();
        let starts = self.starts.keys().next().map(|key| key.0);
        let arrives = self.network.next_arrival();
        let next = due.into_iter().chain(arrives).chain(starts).min();
        // When nothing else can ever happen, what is given still can; what is drawn has no end.
        let drawn = next.and(self.drawn.next());
        let given = self.script.keys().next().copied();
        let stops = self.stops.first().copied();
        [next, drawn, given, stops].into_iter().flatten().min()
    }

    /// Moves the clock and lets everything happen that is due then.
    fn advance(&mut self, moment: Instant) {
        for due in watch::looks(self.last_look, moment) {
            self.clock.advance_to(due);
            self.last_look = due;
            self.machines.iter_mut().for_each(|one| one.look(due));
        }
        self.clock.advance_to(moment);
        self.steps_at_once = 0;
        while let Some(entry) = self.script.first_entry() {
            if *entry.key() > moment {
                break;
            }
            for fault in entry.remove() {
                self.happen(fault);
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
        while let Some(fault) = self.drawn.pop(moment) {
            self.happen(fault);
        }
        if self.stops.first().is_some_and(|at| *at <= moment) {
            self.stops.pop_first();
            self.tell_boot(system::Interrupt { by_operator: false });
        }
        while let Some(flight) = self.network.arrive(moment) {
            self.land(flight, moment);
        }
        self.awake.rouse_due(moment);
        let mut behind = None;
        while let Some(place) = self.awake.next(behind) {
            if let Some(machine) = self.machines.get(place.0) {
                machine.run_due(place.1, moment);
            }
            self.awake.rouse(place);
            behind = Some(place);
        }
    }

    /// Something may have changed for a machine.
    pub(super) fn rouse(&mut self, number: usize) {
        let machine = self.machines.get(number);
        let processors = machine.map_or(0, |machine| machine.processors().count());
        (0..processors).for_each(|place| self.awake.rouse((number, place)));
    }

    fn land(&self, flight: InFlight, now: Instant) {
        let InFlight { way, arrival } = flight;
        let (from, to) = way;
        let Some(machine) = self.machines.get(usize::from(to)) else {
            return;
        };
        // The dead hear nothing.
        if machine.gone {
            return;
        }
        machine.stirs.set(true);
        let chassis = &machine.chassis;
        match arrival {
            Arrival::Frame(frame) => {
                if let Some(processor) = Processor::here() {
                    processor.look_at_clock();
                }
                chassis.receive(from, frame, chassis.clock.now());
            }
            Arrival::Closed => self.link_down(chassis, from),
            Arrival::Silence => match machine.frozen(now) {
                // Who stands still itself listens first when it goes on.
                Some(until) => self.network.listen_again(way, until),
                None => {
                    self.network.give_up(way);
                    self.link_down(chassis, from);
                }
            },
        }
    }

    fn link_down(&self, chassis: &Arc<Chassis>, peer: ChassisNumber) {
        if chassis.is_linked(peer) {
            let name = chassis.name_of(peer);
            self.events
                .note(|| format!("down {} loses {name}", chassis.name()));
        }
        chassis.link_down(peer);
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use super::*;
    use ctos_config::load_texts;
    use ctos_core::{
        context::Context, envelope::Message, handled::Handled, handler::EventHandler, phase::Phase,
    };

    /// Pings another task so often; without a number it does nothing.
    struct Pings(Option<u32>);

    impl EventHandler for Pings {
        async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
            cx.default_processing(message)
        }

        async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
            let cx = cx.clone();
            if let (Phase::Run, Some(pings)) = (phase, self.0) {
                cx.clone().spawn(async move {
                    // Everybody has passed the phases, and rests.
                    cx.sleep(Duration::from_millis(1)).await;
                    let far = cx.task("far").await.unwrap();
                    for _ in 0..pings {
                        cx.call(&far, system::Ping {}).await.unwrap();
                    }
                    cx.finish(system::AppResult {
                        ok: true,
                        text: String::new(),
                        json: "{}".to_owned(),
                    });
                });
            }
            Ok(())
        }
    }

    /// An app in which two chassis exchange messages while `others` have nothing to do.
    fn simulation(others: usize, pings: u32) -> Simulation {
        let mut text = String::from(
            "[app]\nuntil = \"near\"\n[chassis.a]\n[chassis.b]\n\
             [task.near]\nhandler = \"pings\"\non = \"a\"\n\
             [task.far]\nhandler = \"idle\"\non = \"b\"\n",
        );
        for other in 0..others {
            writeln!(
                text,
                "[chassis.c{other}]\n[task.t{other}]\nhandler = \"idle\"\non = \"c{other}\""
            )
            .unwrap();
        }
        let app = load_texts(&[("awake.toml", &text)], &[], &[]).unwrap();
        let mut registry = Registry::new();
        registry.handler("pings", &[], move |_| Ok(Pings(Some(pings))));
        registry.handler("idle", &[], |_| Ok(Pings(None)));
        let silent: Observer = Arc::new(|_| ());
        let setup = Setup::default();
        let simulation = Simulation::new(Arc::new(app), Arc::new(registry), setup, &silent);
        let simulation = simulation.unwrap();
        simulation.tell_boot(system::AllLinked {});
        simulation
    }

    /// How often the simulation looks at a processor of it.
    fn visits(others: usize, pings: u32) -> u64 {
        let mut simulation = simulation(others, pings);
        while lock(&simulation.end).is_none() {
            assert!(simulation.step(None));
        }
        let end = lock(&simulation.end).take();
        assert!(matches!(end, Some(End::Finished(_))), "{end:?}");
        simulation.awake.visits
    }

    #[test]
    fn a_message_costs_as_much_among_many_chassis_as_among_few() {
        let [few, many] = [2, 40].map(|others| visits(others, 300) - visits(others, 0));
        assert!(
            many < few * 5 / 4,
            "{many} looks among many, {few} among few"
        );
    }

    #[test]
    fn chassis_at_rest_are_not_looked_at() {
        let mut simulation = simulation(40, 10_000);
        let later = Instant::START + Duration::from_millis(1200);
        while simulation.clock.now() < later {
            assert!(simulation.step(None));
        }
        let stirs = |machine: &&Machine| machine.stirs.get();
        let stirring = simulation.machines.iter().filter(stirs).count();
        assert_eq!(stirring, 2, "those that exchange messages");
    }
}
