//! The processes of a simulated app: what the bootstrap service wants of them, how they end, and how others
//! start in their place.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
    time::Duration,
};

use rand::RngExt;

use crate::{machine::Machine, run::Simulation};
use ctos_bootstrap::bootstrap::{BootEvent, ProcessOrder};
use ctos_core::{chassis::Chassis, system};
use ctos_message::{ChassisNumber, Command};
use ctos_time::lock::lock;

/// How long the process of a chassis takes to start, ns.
const START_NS: std::ops::Range<u64> = 1_000_000..20_000_000;

/// The exits that chassis asked for: number, incarnation and exit code.
pub(super) type Exits = Arc<Mutex<VecDeque<(ChassisNumber, u32, i32)>>>;

pub(super) fn watch_exit(chassis: &Arc<Chassis>, incarnation: u32, exits: &Exits) {
    let (exits, index) = (exits.clone(), chassis.index());
    chassis.set_on_exit(move |code| lock(&exits).push_back((index, incarnation, code)));
}

/// How a process ended that a fault, or the supervisor, ended.
const KILLED: &str = "was killed by signal 9 (SIGKILL)";

impl Simulation {
    /// The boot is done and waits for the processes; those that do not end by themselves are killed.
    pub(super) fn end_processes(&mut self) {
        let Some(boot) = self.machines.first().map(|machine| machine.chassis.clone()) else {
            return;
        };
        boot.drop_links();
        self.network.leave(0);
        let deadline = self.clock.now() + boot.app.stop_timeout;
        let is_gone = |machine: &Machine| machine.gone;
        // Nobody starts again now: those in front of the first that is there need not be looked at again.
        let mut first = 1;
        while first < self.machines.len() {
            match self.machines.get(first).is_some_and(is_gone) {
                true => first += 1,
                false if self.step(Some(deadline)) => {}
                false => break,
            }
        }
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
    pub(super) fn run_exits(&mut self) -> bool {
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
    pub(super) fn run_orders(&mut self) -> bool {
        match self.orders.try_recv() {
            Ok(ProcessOrder::Start(index, incarnation)) => {
                let delay = Duration::from_nanos(self.rng.random_range(START_NS));
                self.starts
                    .insert((self.clock.now() + delay, index), incarnation);
                self.incarnations.insert(index, incarnation);
            }
            Ok(ProcessOrder::Kill(index)) => self.kill(index),
            Err(_) => return false,
        }
        true
    }

    /// Which process of chassis `index` is the last that was wanted.
    pub(super) fn incarnation(&self, index: ChassisNumber) -> u32 {
        self.incarnations.get(&index).copied().unwrap_or(1)
    }

    pub(super) fn kill(&mut self, index: ChassisNumber) {
        self.end_chassis(index, KILLED, None, true);
    }

    /// A process ends: nothing of it runs any more, and the others see its links close.
    fn end_chassis(&mut self, index: ChassisNumber, how: &str, code: Option<i32>, casualty: bool) {
        let incarnation = self.incarnation(index);
        // Also of one that has not started yet: it never will.
        self.tell_boot(system::ProcessEnded {
            chassis: index,
            incarnation,
            how: how.to_owned(),
            code,
        });
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
        self.rouse(usize::from(index));
        self.network.leave(index);
        chassis.close();
    }

    /// A process starts in place of the one that ended, and is connected to the boot.
    pub(super) fn start_chassis(&mut self, index: ChassisNumber, incarnation: u32) {
        let Some(old) = self.machines.get(usize::from(index)) else {
            return;
        };
        let old = &old.chassis;
        let (app, registry) = (old.app.clone(), old.registry());
        let new = Chassis::new(index, app, registry, old.clock.clone());
        if let Some(disk) = old.disk() {
            new.set_disk(disk.clone());
        }
        self.events
            .note(|| format!("chassis {} starts again", new.name()));
        // Nothing of the old process may come out of the links of the new one.
        for peer in self.network.peers(index) {
            let machine = self.machines.get(usize::from(peer));
            if let Some(machine) = machine.filter(|machine| !machine.gone) {
                machine.chassis.link_down(index);
            }
        }
        self.network.join(&new);
        new.reach(0);
        watch_exit(&new, incarnation, &self.exits);
        if let Some(recording) = &self.recording {
            recording.add(&new);
        }
        self.events.watch(&new);
        ctos_bootstrap::bootstrap::start_system_tasks(&new, None);
        self.casualties.remove(&index);
        if let Some(place) = self.machines.get_mut(usize::from(index)) {
            *place = Machine::new(new);
            let number = usize::from(index);
            for (processor, here) in place.processors().enumerate() {
                self.awake.add((number, processor), here);
            }
        }
        self.tell_boot(system::ChassisLinked {
            chassis: index,
            incarnation,
        });
    }

    /// Tells the bootstrap service.
    pub(super) fn tell_boot(&self, what: impl Command) {
        if let Some(boot) = self.machines.first() {
            boot.chassis.post_system(system::BOOTSTRAP, what);
        }
    }
}
