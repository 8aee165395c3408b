//! The testbed interface layer: channel drivers that present every joint and sensor as a slot.
//!
//! A channel driver hides hardware (or its simulated stand-in) behind [`ChannelDriver`]. Upper layers
//! see slots only: a position read back and a command per joint, by torque, speed or position, whatever drives it
//! (CIRSSE report 108, section 4). This module names no simulator.

mod drives;
mod registry;
#[cfg(test)]
pub(crate) mod test_arm;
mod testbed;

use std::time::Duration;

pub use drives::{DRIVES, Drives};
pub use registry::{DriverKind, DriverRegistry};
pub use testbed::{NamedDriver, TESTBED};

/// What one slot reported at the last [`ChannelDriver::read`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SlotReading {
    /// Joint position, rad, or m of one that slides.
    pub position: f64,
    /// Joint velocity, rad/s, or m/s.
    pub velocity: f64,
}

/// What a slot is commanded by, with the names and the codes of CiA 402 (object 6060h).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Mode {
    /// Cyclic synchronous position: where to be when the next command is due, rad or m.
    #[serde(rename = "csp")]
    Position = 8,
    /// Cyclic synchronous velocity: how fast to be then, rad/s or m/s.
    #[serde(rename = "csv")]
    Velocity = 9,
    /// Cyclic synchronous torque: to be held until then, N m or N.
    #[default]
    #[serde(rename = "cst")]
    Torque = 10,
}

impl Mode {
    /// One mode for each of so many slots, where one or as many are given.
    #[must_use]
    pub fn for_slots(given: &[Self], slots: usize) -> Option<Vec<Self>> {
        match given {
            [one] => Some(vec![*one; slots]),
            all if all.len() == slots => Some(all.to_vec()),
            _ => None,
        }
    }
}

/// What a slot that is no joint measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum SensorKind {
    /// A force (N) and a moment (N m) about the sensor's origin, in its frame: that which what hangs behind it exerts on it.
    ForceTorque,
    /// 0 or 1.
    DigitalInput,
}

impl SensorKind {
    /// How many numbers it reads.
    #[must_use]
    pub fn width(self) -> usize {
        match self {
            Self::ForceTorque => 6,
            Self::DigitalInput => 1,
        }
    }
}

/// A slot that is no joint. What kinds there are in hardware, each is a run of numbers here.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Sensor {
    /// Its name.
    pub name: String,
    /// What it measures.
    pub kind: SensorKind,
}

/// The three physical states of the manipulator (report 108, section 4, end of the state manager).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Power {
    /// Power off: cold, reserved and estopped states. Brakes hold.
    #[default]
    Off,
    /// Power on, brakes on: active state.
    Braked,
    /// Power on, brakes off: motion state. Only now do torque commands move anything.
    Released,
}

/// Why a driver cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DriverError {
    /// The hardware (or its stand-in) reports a fault.
    #[error("channel driver `{driver}`: {reason}")]
    Fault {
        /// The driver's name in the configuration.
        driver: String,
        /// What it says.
        reason: String,
    },
}

/// Hardware behind a run of slots. Called by the servo only, once per period, in the order
/// [`read`](Self::read), [`write`](Self::write), in every power state: with power off or brakes on
/// torques and speeds are zero, and positions those that were read. A failed read is followed by a write with [`Power::Off`] in the same period, and
/// so is the servo's own end. Neither call may allocate, lock or wait; only an error may cost more.
pub trait ChannelDriver: Send {
    /// Number of slots.
    fn slots(&self) -> usize;

    /// Reads every slot into `readings` (length [`slots`](Self::slots)).
    ///
    /// # Errors
    /// A driver fault; the servo then stops the arm.
    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError>;

    /// The slots that are no joints, which never change; none unless a driver says otherwise.
    fn sensors(&self) -> &[Sensor] {
        &[]
    }

    /// Reads every sensor, one after the other, into `numbers` (length: the sum of their widths). Called once per period
    /// after [`read`](Self::read) has gone well, under the same rules.
    ///
    /// # Errors
    /// A driver fault; the servo then stops the arm.
    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        let _ = numbers;
        Ok(())
    }

    /// What each slot is commanded by, which never changes: torque, of those that it does not name.
    fn modes(&self) -> &[Mode] {
        &[]
    }

    /// Applies one command per slot, which is of the slot's [mode](Self::modes), until the next write. The next one is due
    /// in `period`: a driver may brake its joints when it does not come.
    ///
    /// # Errors
    /// A driver fault; the servo then stops the arm.
    fn write(
        &mut self,
        commands: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError>;
}
