//! A whole app in one thread on the virtual clock.
//!
//! All chassis live in this process and exchange encoded frames over simulated links. One loop polls
//! the tasks that can run, in an order drawn from the app's seed; when none can, it moves the clock to
//! the next deadline. The same seed gives the same run, event for event.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    rc::Rc,
    sync::{Arc, Mutex},
};

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    boot::{self, BootError, BootEvent, End, Mishap, Observer, Outcome},
    bootstrap::EndSlot,
    call::lock,
    chassis::{BOOT_CHASSIS, Chassis},
    config::App,
    context::mix,
    link::simulated::{Network, below},
    processor::Processor,
    record,
    registry::Registry,
    system,
    time::{Clock, Instant},
    watch,
};

/// What happens to the simulated machines at a moment, with the chassis as numbers.
#[derive(Debug, Clone, Copy)]
enum Happening {
    Kill(u8),
    Cut(u8, u8),
    Stall(u8, u8, Instant),
}

struct Simulation {
    clock: Clock,
    chassis: Vec<Arc<Chassis>>,
    /// Those of each chassis, by its number.
    processors: Vec<Vec<Rc<Processor>>>,
    network: Network,
    rng: ChaCha8Rng,
    end: EndSlot,
    happenings: BTreeMap<Instant, Vec<Happening>>,
    /// Chassis whose process would have ended by itself now, with its exit code.
    exits: Arc<Mutex<VecDeque<(u8, i32)>>>,
    gone: BTreeSet<u8>,
    casualties: Vec<(String, String)>,
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
    let recording = record::start(&chassis).map_err(boot::io("cannot record"))?;
    let exits = Arc::new(Mutex::new(VecDeque::new()));
    for from in &chassis {
        for to in from.others() {
            from.link_up(to, network.link(from.index(), to));
        }
        if from.index() > 0 {
            observer(&BootEvent::Started {
                chassis: from.name().to_owned(),
                pid: None,
            });
            let (exits, index) = (exits.clone(), from.index());
            from.set_on_exit(move |code| lock(&exits).push_back((index, code)));
        }
    }
    let processors = chassis
        .iter()
        .map(|chassis| {
            let handles = chassis.processors.iter();
            handles
                .map(|(_, handle)| Processor::new(handle.clone(), clock.clone()))
                .collect()
        })
        .collect();
    let end = EndSlot::default();
    for one in &chassis {
        boot::start_system_tasks(one, observer, &end);
    }
    let simulation = Simulation {
        clock,
        chassis,
        processors,
        network,
        rng: ChaCha8Rng::seed_from_u64(mix(seed, &["schedule"])),
        end,
        happenings,
        exits,
        gone: BTreeSet::new(),
        casualties: Vec::new(),
    };
    let outcome = simulation.run();
    if let Some(recording) = recording {
        recording.finish();
    }
    Ok(outcome)
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
            if self.run_jobs() || self.run_exits() || self.poll_one() {
                continue;
            }
            match self.next_event() {
                Some(moment) => self.advance(moment),
                None => break End::Stuck,
            }
        };
        let took = self.clock.now().since_start();
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
            casualties: self.casualties,
            took,
        }
    }

    /// Ends the processes that have come to their end by themselves.
    fn run_exits(&mut self) -> bool {
        let Some((index, code)) = lock(&self.exits).pop_front() else {
            return false;
        };
        // 0 and 1 are what the boot orders; anything else the chassis chose itself.
        if code > 1 {
            self.end_chassis(index, Some(&format!("ended with exit code {code}")));
        } else {
            self.end_chassis(index, None);
        }
        true
    }

    /// A process ends: nothing of it runs any more, and the others see its links close.
    fn end_chassis(&mut self, index: u8, casualty: Option<&str>) {
        if !self.gone.insert(index) {
            return;
        }
        let Some(chassis) = self.chassis.get(usize::from(index)) else {
            return;
        };
        if let Some(how) = casualty {
            let name = chassis.name().to_owned();
            self.casualties.push((name, how.to_owned()));
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

    fn happen(&mut self, happening: Happening) {
        match happening {
            Happening::Kill(index) => {
                self.end_chassis(index, Some("was killed by signal 9 (SIGKILL)"));
            }
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
        watch::look_until(self.chassis.iter(), moment);
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
