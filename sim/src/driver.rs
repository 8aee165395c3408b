//! Joints of a simulated arm as slots behind the channel driver of the testbed interface.

use std::{f64::consts::TAU, sync::Arc, time::Duration};

use mcs::{
    driver::{ChannelDriver, DriverError, Power, Sensor, SensorKind, SlotReading},
    model::JointKind,
};

use crate::{
    cell::Cell,
    port::{Claim, Port, Taken},
};

/// Encoder counts per turn of a joint: 17 bits, a resolution of 4.8e-5 rad, as servo drives have today. The choice is ours; no
/// figure for the original encoders could be found.
pub const COUNTS_PER_TURN: f64 = 131_072.0;

/// Encoder counts per m of a joint that slides. The choice is ours, too.
pub const COUNTS_PER_METRE: f64 = 2e5;

/// A world whose state has been the same for so long stands still.
const STANDSTILL: Duration = Duration::from_millis(100);

/// Channel driver of some joints of an arm in a world that a task of the same chassis owns.
///
/// Positions are read back with the encoder's resolution; velocities are those of an ideal tachometer. Both are those of
/// the world's latest tick, and torques count from its next one on. Nothing here allocates, locks or waits.
#[derive(Debug)]
pub struct SimArm {
    driver: String,
    world: String,
    port: Arc<Port>,
    claim: Arc<Claim>,
    /// Encoder counts per rad or m of each slot.
    counts: Vec<f64>,
    /// Tick, positions and speeds of all joints of the arm.
    state: Vec<f64>,
    /// Sensors by index in the cell, and as slots.
    sensing: Vec<usize>,
    sensors: Vec<Sensor>,
    /// Names of the furniture that feels, and may cut the power.
    plates: Vec<String>,
    /// Lasers that it lights, by index in the cell: slots after the sensors.
    lasers: Vec<usize>,
    tick: f64,
    period: Duration,
    /// How long it has been the same tick.
    waited: Duration,
}

impl SimArm {
    /// The joints (by index from 0) of an arm of `cell`, driven by the task `driver`, in the world of the task `world`.
    ///
    /// # Errors
    /// Another task drives one of the joints.
    pub fn new(
        driver: impl Into<String>,
        (world, port, cell): (&str, &Arc<Port>, &Cell),
        arm: usize,
        joints: &[usize],
    ) -> Result<Self, Taken> {
        let driver = driver.into();
        let kinds = cell.arms.get(arm).map_or(&[][..], |arm| arm.model.joints());
        let counts = |joint: &usize| match kinds.get(*joint).map(|joint| joint.kind) {
            Some(JointKind::Prismatic) => COUNTS_PER_METRE,
            _ => COUNTS_PER_TURN / TAU,
        };
        Ok(Self {
            world: world.to_owned(),
            port: Arc::clone(port),
            claim: port.claim(&driver, arm, joints)?,
            driver,
            counts: joints.iter().map(counts).collect(),
            state: vec![0.0; port.state_length(arm)],
            sensing: Vec::new(),
            sensors: Vec::new(),
            plates: cell.plates.iter().map(|plate| plate.name.clone()).collect(),
            lasers: Vec::new(),
            tick: 0.0,
            period: Duration::ZERO,
            waited: Duration::ZERO,
        })
    }

    /// Reads sensors of the cell besides, by index; one that it does not have is left out.
    #[must_use]
    pub fn sensing(mut self, cell: &Cell, sensors: &[usize]) -> Self {
        for index in sensors {
            if let Some(name) = cell.sensor(*index) {
                self.sensing.push(*index);
                self.sensors.push(Sensor {
                    name: name.to_owned(),
                    kind: SensorKind::ForceTorque,
                });
            }
        }
        self
    }

    /// Lights lasers of the cell besides, by index, after all sensors; one that it does not have is left out.
    #[must_use]
    pub fn lighting(mut self, cell: &Cell, lasers: &[usize]) -> Self {
        for index in lasers {
            if let Some(spec) = cell.lasers.get(*index) {
                self.lasers.push(*index);
                self.sensors.push(Sensor {
                    name: spec.name.clone(),
                    kind: SensorKind::Laser,
                });
            }
        }
        self
    }

    /// The world's tick to which the last reading belongs.
    #[must_use]
    pub fn tick(&self) -> u64 {
        // Ticks are whole numbers, and none is lost below 2^53.
        self.tick as u64
    }

    fn fault(&self, reason: impl ToString) -> DriverError {
        DriverError::Fault {
            driver: self.driver.clone(),
            reason: reason.to_string(),
        }
    }

    fn count(&self, what: &str, given: usize) -> DriverError {
        self.fault(format!(
            "was given {given} {what} for {} slots",
            self.slots()
        ))
    }

    /// Whether the world goes on. Before its first tick it need not.
    fn watch(&mut self) -> Result<(), DriverError> {
        let before = std::mem::replace(&mut self.tick, self.state.first().copied().unwrap_or(0.0));
        if self.tick != before || self.tick == 0.0 {
            self.waited = Duration::ZERO;
        } else {
            self.waited += self.period;
        }
        if self.tick < before {
            return Err(self.fault(format!("world `{}` began again", self.world)));
        }
        if self.waited > STANDSTILL {
            return Err(self.still());
        }
        if let Some((plate, force)) = self.port.cut() {
            let plate = self.plates.get(plate).map_or("", String::as_str);
            return Err(self.fault(format!(
                "the force sensor `{plate}` felt {force:.0} N and cut the power: see what presses on it, then reset"
            )));
        }
        Ok(())
    }

    fn still(&self) -> DriverError {
        let (world, for_ms) = (&self.world, 1e3 * self.waited.as_secs_f64());
        let why = self.port.failure();
        let why = why.unwrap_or_else(|| "is its task running?".to_owned());
        self.fault(format!(
            "world `{world}` stands still, for {for_ms:.1} ms now: {why}"
        ))
    }
}

impl ChannelDriver for SimArm {
    fn slots(&self) -> usize {
        self.claim.joints.len()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        if readings.len() != self.slots() {
            return Err(self.count("readings", readings.len()));
        }
        self.port.read(self.claim.arm, &mut self.state);
        self.watch()?;
        let (positions, speeds) = self.state[1..].split_at(self.state.len() / 2);
        // A joint that the arm does not have reads as no number, which is a fault of its slot.
        let number = |values: &[f64], joint: usize| values.get(joint).copied().unwrap_or(f64::NAN);
        let slots = self.claim.joints.iter().zip(&self.counts);
        for (reading, (joint, counts)) in readings.iter_mut().zip(slots) {
            *reading = SlotReading {
                position: (number(positions, *joint) * counts).round() / counts,
                velocity: number(speeds, *joint),
            };
        }
        Ok(())
    }

    fn silence(&self, _slot: usize) -> Option<(Duration, DriverError)> {
        (!self.waited.is_zero()).then(|| (self.waited, self.still()))
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        for (index, numbers) in self.sensing.iter().zip(numbers.chunks_exact_mut(6)) {
            self.port.sensed(*index, numbers);
        }
        Ok(())
    }

    fn actuate(&mut self, numbers: &[f64]) -> Result<(), DriverError> {
        let outputs = numbers.iter().skip(6 * self.sensing.len());
        for (laser, lit) in self.lasers.iter().zip(outputs) {
            self.port.shine(*laser, *lit);
        }
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        if torques.len() != self.slots() {
            return Err(self.count("torques", torques.len()));
        }
        let bad = torques.iter().position(|torque| !torque.is_finite());
        if let Some(slot) = bad {
            let torque = torques[slot];
            return Err(self.fault(format!(
                "the torque of slot {} is {torque}, not a finite number",
                slot + 1
            )));
        }
        self.period = period;
        self.claim.order(torques, power, period);
        Ok(())
    }
}

impl Drop for SimArm {
    fn drop(&mut self) {
        for laser in &self.lasers {
            self.port.shine(*laser, 0.0);
        }
        self.port.release(&self.claim);
    }
}

#[cfg(test)]
mod tests;
