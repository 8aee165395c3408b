//! The channel driver: a session and a socket. In a tick it neither waits nor allocates: the socket does not block, and a
//! command that finds no room is lost as one on the way might be.

use std::time::Duration;

use ctos::time::Clock;
use mcs::driver::{ChannelDriver, DriverError, Mode, Power, SlotReading};

use crate::{
    frame::SIZE,
    session::{Doubt, Session},
    socket::{Address, Line},
};

/// No more datagrams are taken in by one tick: a peer sends one for each command.
const MOST: usize = 64;

/// Slots behind a peer in another process.
#[derive(Debug)]
pub struct RemoteArm {
    driver: String,
    address: Address,
    line: Line,
    session: Session,
    clock: Clock,
}

impl RemoteArm {
    /// The driver of the task `driver` with what its session says, over `line`, which is open to `address`.
    #[must_use]
    pub fn new(
        driver: impl Into<String>,
        (address, line): (Address, Line),
        session: Session,
        clock: Clock,
    ) -> Self {
        Self {
            driver: driver.into(),
            address,
            line,
            session,
            clock,
        }
    }

    /// Asks the peer how it is, power off, each `period` for at most `patience`, until it is believed. What for: the first
    /// tick of the servo then has readings. Waits, and so is for the start only; not for a peer where nobody listens.
    ///
    /// # Errors
    /// Why it is not believed; the driver goes on asking in every tick.
    pub fn meet(&mut self, period: Duration, patience: Duration) -> Result<(), Doubt> {
        let end = self.clock.now() + patience;
        let still = vec![0.0; self.session.slots()];
        let mut readings = vec![SlotReading::default(); self.session.slots()];
        loop {
            // Its reason is the session's doubt.
            let _ = self.write(&still, Power::Off, period);
            if !matches!(self.session.doubt(), Some(Doubt::Socket(_))) {
                self.line.wait(period);
                self.listen();
            }
            match self.session.read(&mut readings) {
                // Nobody is there who could answer later.
                Err(doubt @ Doubt::Socket(_)) => return Err(doubt),
                Err(_) if self.clock.now() < end => {}
                read => return read,
            }
        }
    }

    /// Waits until the peer has sent something, at most for `patience`: for whoever keeps no clock.
    pub fn wait(&self, patience: Duration) {
        self.line.wait(patience);
    }

    /// Commands that have not been answered yet.
    #[must_use]
    pub fn unanswered(&self) -> u64 {
        self.session.unanswered()
    }

    fn fault(&self, reason: impl std::fmt::Display) -> DriverError {
        DriverError::Fault {
            driver: self.driver.clone(),
            reason: reason.to_string(),
        }
    }

    fn doubted(&self, doubt: Doubt) -> DriverError {
        self.fault(format_args!("the peer at `{}` {doubt}", self.address))
    }

    /// Takes in what has come.
    fn listen(&mut self) {
        let mut buffer = [0; SIZE + 1];
        for _ in 0..MOST {
            match self.line.receive(&mut buffer) {
                Ok(Some(bytes)) => self.session.take(bytes),
                Ok(None) => return,
                Err(error) => return self.session.fail(Doubt::Socket(error.kind())),
            }
        }
    }
}

impl ChannelDriver for RemoteArm {
    fn slots(&self) -> usize {
        self.session.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        if readings.len() != self.slots() {
            let (given, slots) = (readings.len(), self.slots());
            return Err(self.fault(format_args!("was given {given} readings for {slots} slots")));
        }
        self.listen();
        let read = self.session.read(readings);
        read.map_err(|doubt| self.doubted(doubt))
    }

    fn silence(&self, _slot: usize) -> Option<(Duration, DriverError)> {
        let silent = self.session.silent();
        let for_ms = 1e3 * silent.as_secs_f64();
        (!silent.is_zero()).then(|| (silent, self.doubted(Doubt::Silent { for_ms })))
    }

    fn modes(&self) -> &[Mode] {
        self.session.modes()
    }

    fn write(
        &mut self,
        commands: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        if commands.len() != self.slots() {
            let (given, slots) = (commands.len(), self.slots());
            return Err(self.fault(format_args!("was given {given} commands for {slots} slots")));
        }
        if let Some(slot) = commands.iter().position(|command| !command.is_finite()) {
            let (slot, command) = (slot + 1, commands[slot]);
            return Err(self.fault(format_args!(
                "the command of slot {slot} is {command}, not a finite number"
            )));
        }
        let stamp = self.clock.now().as_nanos();
        let frame = self.session.command(commands, power, period, stamp);
        if let Err(error) = self.line.send(&frame.encode()) {
            let doubt = Doubt::Socket(error.kind());
            self.session.fail(doubt);
            return Err(self.doubted(doubt));
        }
        Ok(())
    }
}
