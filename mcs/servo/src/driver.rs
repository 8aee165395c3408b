//! The testbed interface layer: channel drivers that present every joint and sensor as a slot.
//!
//! A channel driver hides hardware (or its simulated stand-in) behind [`ChannelDriver`]. Upper layers
//! see slots only: a position read back and a command per joint, by torque, speed or position, whatever drives it
//! (CIRSSE report 108, section 4). This module names no simulator.

mod drives;
mod named;
mod registry;
#[cfg(test)]
pub(crate) mod test_arm;
mod testbed;

use std::time::Duration;

pub use drives::{DRIVES, Drives};
pub use named::NAMED_SLOTS;
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

/// What a slot that is no joint is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorKind {
    /// A force (N) and a moment (N m) about the sensor's origin, in its frame: that which what hangs behind it exerts on it.
    ForceTorque,
    /// 0 or 1.
    DigitalInput,
    /// How far the cap of a space mouse is pushed along its axes, and turned about them: six numbers from -1 to 1.
    SpaceMouse,
    /// The position of a joint of a hand, which something else moves, rad or m.
    HandJoint,
    /// 0 or 1, which is set.
    DigitalOutput,
    /// How bright a lamp is, 0 to 1, which is set.
    Lamp,
    /// Whether a laser pointer is on, 0 or 1, which is set.
    Laser,
}

impl SensorKind {
    /// How many numbers it has.
    #[must_use]
    pub fn width(self) -> usize {
        match self {
            Self::ForceTorque | Self::SpaceMouse => 6,
            _ => 1,
        }
    }

    /// The unit of its numbers; empty where they have none.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::ForceTorque => "N, N m",
            Self::HandJoint => "rad or m",
            _ => "",
        }
    }

    /// Whether it is set, and not read.
    #[must_use]
    pub fn is_output(self) -> bool {
        matches!(self, Self::DigitalOutput | Self::Lamp | Self::Laser)
    }
}

/// A slot that is no joint: a sensor, an input or an output. What kinds there are in hardware, each is a run of numbers here.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Sensor {
    /// Its name.
    pub name: String,
    /// What it is.
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

    /// How long the last readings of a slot have been old, and whose silence that is: nothing, where they are of this very
    /// period. The servo asks when a joint seems not to follow.
    fn silence(&self, slot: usize) -> Option<(Duration, DriverError)> {
        let _ = slot;
        None
    }

    /// The slots that are no joints, which never change; none unless a driver says otherwise.
    fn sensors(&self) -> &[Sensor] {
        &[]
    }

    /// How old what each of them has read is at the last [`sense`](Self::sense), s; of that very period unless a driver says
    /// otherwise. The servo marks what is too old, and brings the arm to rest. Under the same rules; of an output it does not
    /// matter.
    fn ages(&mut self, ages: &mut [f64]) {
        ages.fill(0.0);
    }

    /// Sets the outputs among them, in every period before [`write`](Self::write): all numbers as for
    /// [`sense`](Self::sense), of which those of outputs count. They are 0 while power is off. Under the same rules.
    ///
    /// # Errors
    /// A driver fault; the servo then stops the arm.
    fn actuate(&mut self, numbers: &[f64]) -> Result<(), DriverError> {
        let _ = numbers;
        Ok(())
    }

    /// Reads every sensor, one after the other, into `numbers` (length: the sum of their widths); outputs read as they were set. Called once per
    /// period after [`read`](Self::read) has gone well, under the same rules.
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
