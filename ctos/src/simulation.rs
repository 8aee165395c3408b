//! A whole app in one thread on the virtual clock.
//!
//! All chassis live in this process and exchange encoded frames over simulated links. One loop polls
//! the tasks that can run, in an order drawn from the app's seed; when none can, it moves the clock to
//! the next deadline. The same seed gives the same run, event for event.

use std::{rc::Rc, sync::Arc, time::Duration};

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    boot::{self, BootEvent, End, Observer},
    bootstrap::EndSlot,
    call::lock,
    chassis::Chassis,
    config::App,
    context::mix,
    link::simulated::{Network, below},
    processor::Processor,
    registry::Registry,
    system,
    time::{Clock, Instant},
};

struct Simulation {
    clock: Clock,
    chassis: Vec<Arc<Chassis>>,
    processors: Vec<Rc<Processor>>,
    network: Network,
    rng: ChaCha8Rng,
    end: EndSlot,
}

/// Runs `app` to its end in virtual time.
pub(crate) fn run(app: Arc<App>, registry: Arc<Registry>, observer: &Observer) -> (End, Duration) {
    let clock = Clock::virtual_clock();
    let seed = app.seed;
    let network = Network::new(
        clock.clone(),
        ChaCha8Rng::seed_from_u64(mix(seed, &["simulated links"])),
    );
    let count = u8::try_from(app.chassis.len()).unwrap_or(u8::MAX - 1);
    let chassis: Vec<Arc<Chassis>> = (0..=count)
        .map(|index| Chassis::new(index, app.clone(), registry.clone(), clock.clone()))
        .collect();
    for from in &chassis {
        for to in from.others() {
            from.link_up(to, network.link(from.index(), to));
        }
        if from.index() > 0 {
            observer(&BootEvent::Started {
                chassis: from.name().to_owned(),
                pid: None,
            });
        }
    }
    let processors = chassis
        .iter()
        .flat_map(|chassis| &chassis.processors)
        .map(|(_, handle)| Processor::new(handle.clone(), clock.clone()))
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
    };
    simulation.run()
}

impl Simulation {
    fn run(mut self) -> (End, Duration) {
        if let Some(boot) = self.chassis.first() {
            boot.post_system(system::BOOTSTRAP, system::AllLinked {});
        }
        let end = loop {
            if let Some(end) = lock(&self.end).take() {
                break end;
            }
            if self.run_jobs() || self.poll_one() {
                continue;
            }
            match self.next_event() {
                Some(moment) => self.advance(moment),
                None => break End::Stuck,
            }
        };
        for processor in &self.processors {
            processor.clear();
        }
        (end, self.clock.now().since_start())
    }

    fn run_jobs(&self) -> bool {
        let mut any = false;
        for processor in &self.processors {
            any |= processor.run_jobs();
        }
        any
    }

    /// Polls one of the futures that are ready, drawn from the seed.
    fn poll_one(&mut self) -> bool {
        let counts = self
            .processors
            .iter()
            .map(|processor| processor.ready_count());
        let total: usize = counts.clone().sum();
        if total == 0 {
            return false;
        }
        let mut drawn = below(&mut self.rng, total);
        for (processor, count) in self.processors.iter().zip(counts) {
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
            .filter_map(|processor| processor.next_deadline());
        deadlines.chain(self.network.next_arrival()).min()
    }

    /// Moves the clock and lets everything happen that is due then.
    fn advance(&self, moment: Instant) {
        self.clock.advance_to(moment);
        while let Some(flight) = self.network.arrive(moment) {
            if let Some(chassis) = self.chassis.get(usize::from(flight.to)) {
                chassis.receive(flight.from, flight.frame);
            }
        }
        for processor in &self.processors {
            processor.run_cyclics();
            processor.fire_timers();
        }
    }
}
