//! A cell of one process whose arm is driven from another: the peer of `mcs.remote` with this crate's world behind it.
//!
//! Each command takes the world on by the period that it names, so that a controller and its world never get out of step;
//! while none comes, time stands still there, and the brakes engage when the watchdog says so.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use ctos::time::Clock;
use mcs::driver::{ChannelDriver, Power, SlotReading};
use mcs_remote::{
    frame::SIZE,
    peer::{Order, Peer},
    socket::PeerSocket,
};

use crate::{cell::Cell, driver::SimArm, port::Port, simulation::Simulation};

/// How often [`Served::serve`] looks whether it shall end.
const LOOK: Duration = Duration::from_millis(20);

/// Brakes bring an arm to rest in fewer periods.
const MOST_BRAKING: usize = 1000;

/// An arm of a cell, driven from another process.
#[derive(Debug)]
pub struct Served {
    peer: Peer,
    arm: SimArm,
    simulation: Simulation,
    readings: Vec<SlotReading>,
    power: Power,
    period: Duration,
    clock: Clock,
}

impl Served {
    /// An arm of `cell`, by index, as the peer with the number `own`, which no start before had; none without such an arm.
    #[must_use]
    pub fn new(cell: &Cell, arm: usize, own: u32) -> Option<Self> {
        let slots = cell.arms.get(arm)?.model.dof();
        let port = Arc::new(Port::new(cell));
        let joints: Vec<usize> = (0..slots).collect();
        let simulation = Simulation::new(cell, Arc::clone(&port));
        Some(Self {
            peer: Peer::new(own, slots),
            arm: SimArm::new("served", ("world", &port, cell), arm, &joints).ok()?,
            simulation,
            readings: vec![SlotReading::default(); slots],
            power: Power::Off,
            period: Duration::ZERO,
            clock: Clock::real(),
        })
    }

    /// Takes in a datagram; the answer, if there is one.
    pub fn take(&mut self, bytes: &[u8]) -> Option<[u8; SIZE]> {
        match self.peer.take(bytes) {
            Ok(order) => {
                self.obey(&order);
                let slots = self.readings.iter();
                let slots = slots.map(|reading| [reading.position, reading.velocity]);
                let stamp = self.clock.now().as_nanos();
                Some(self.peer.answer(self.power, slots, stamp).encode())
            }
            Err(refusal) => {
                tracing::warn!("a command is not taken in: {refusal}");
                None
            }
        }
    }

    /// No command came for as long as the watchdog allows: the brakes engage, and the arm comes to rest.
    pub fn silent(&mut self) {
        self.peer.silent();
        let order = Order {
            power: Power::Braked,
            commands: vec![0.0; self.readings.len()],
            period: self.period,
        };
        for _ in 0..MOST_BRAKING {
            self.obey(&order);
            if self.stands() {
                break;
            }
        }
    }

    /// Whether the arm stands still.
    #[must_use]
    pub fn stands(&self) -> bool {
        self.readings.iter().all(|reading| reading.velocity == 0.0)
    }

    /// Joint positions as they are read back, rad or m.
    #[must_use]
    pub fn positions(&self) -> Vec<f64> {
        let readings = self.readings.iter();
        readings.map(|reading| reading.position).collect()
    }

    fn obey(&mut self, order: &Order) {
        (self.power, self.period) = (order.power, order.period);
        let now = self.clock.now().since_start();
        let period = order.period;
        let written = self.arm.write(&order.commands, order.power, period);
        let gone_on = self
            .simulation
            .tick(period, 0, now)
            .map_err(|error| error.to_string());
        let read = self.arm.read(&mut self.readings);
        let failed = written
            .and(read)
            .map_err(|error| error.to_string())
            .and(gone_on);
        if let Err(reason) = failed {
            tracing::error!("the world cannot go on: {reason}");
            self.power = Power::Off;
            self.peer.fault();
        }
    }

    /// Answers whoever drives the arm until `over`.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn serve(&mut self, socket: &PeerSocket, over: &AtomicBool) -> io::Result<()> {
        let mut buffer = [0; SIZE + 1];
        let mut last = self.clock.now();
        while !over.load(Ordering::Relaxed) {
            match socket.receive(&mut buffer, LOOK)? {
                Some((bytes, from)) => {
                    if let Some(answer) = self.take(bytes) {
                        socket.send(&answer, &from);
                        last = self.clock.now();
                    }
                }
                None => {
                    let late = |watchdog: Duration| self.clock.now().since(last) > watchdog;
                    if self.peer.watchdog().is_some_and(late) {
                        self.silent();
                    }
                }
            }
        }
        Ok(())
    }
}
