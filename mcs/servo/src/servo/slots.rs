//! The slots that are no joints: what inputs read, how old that is, and what outputs are set to.

use crate::driver::{Sensor, SensorKind};
use crate::guard::Words;
use crate::joints::{Joints, MAX_SLOTS};

/// All of them, by the numbers that they have one after the other.
pub(super) struct Slots {
    pub(super) sensors: Vec<Sensor>,
    /// Where the first force-torque sensor stands among the numbers.
    pub(super) force_at: Option<usize>,
    /// Age of what each has read, s.
    pub(super) ages: Vec<f64>,
    /// What outputs are set to, in their places.
    pub(super) wanted: Joints,
    /// Whether a number is one of an output.
    pub(super) is_output: Vec<bool>,
}

impl Slots {
    /// Those of a driver.
    ///
    /// # Errors
    /// How many numbers they have, when a status has no room for them.
    pub(super) fn new(sensors: &[Sensor]) -> Result<Self, usize> {
        let (mut is_output, mut force_at) = (Vec::new(), None);
        for Sensor { kind, .. } in sensors {
            if *kind == SensorKind::ForceTorque {
                force_at = force_at.or(Some(is_output.len()));
            }
            is_output.resize(is_output.len() + kind.width(), kind.is_output());
        }
        let found = is_output.len();
        if found > MAX_SLOTS {
            return Err(found);
        }
        Ok(Self {
            ages: vec![0.0; sensors.len()],
            sensors: sensors.to_vec(),
            force_at,
            wanted: Joints::zeros(found),
            is_output,
        })
    }

    /// The name of the slot that has the number at this place, and which of its numbers it is, from 1.
    pub(super) fn whose(&self, at: usize) -> (Words, usize) {
        let mut before = 0;
        for Sensor { name, kind } in &self.sensors {
            if at < before + kind.width() {
                return (name.as_str().into(), at - before + 1);
            }
            before += kind.width();
        }
        (Words::default(), at + 1)
    }

    /// How many numbers they have.
    pub(super) fn width(&self) -> usize {
        self.is_output.len()
    }
}
