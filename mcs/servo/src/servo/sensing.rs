//! How a servo reads, watches and sets the slots that are no joints.

use super::Servo;
use super::port::{Fault, Rejection};
use crate::driver::Power;
use crate::guard::{GuardReport, Reaction};
use crate::words;

impl Servo {
    /// Reads all inputs, marks those that are too old, and sets all outputs.
    pub(super) fn sense(&mut self) {
        let mut sensed = self.status.sensors;
        if let Err(error) = self.driver.sense(&mut sensed) {
            return self.driver_failed(error);
        }
        let each = self.slots.wanted.iter().zip(&self.slots.is_output);
        for (number, (wanted, is_output)) in sensed.iter_mut().zip(each) {
            if *is_output {
                *number = *wanted;
            }
        }
        if let Some(at) = sensed.iter().position(|number| !number.is_finite()) {
            let (slot, number) = self.slots.whose(at);
            return self.fail(Fault::Sensor { slot, number });
        }
        self.status.sensors = sensed;
        self.driver.ages(&mut self.slots.ages);
        let limit = self.config.stale_after.as_secs_f64();
        self.status.stale = 0;
        for (index, (sensor, age)) in self.slots.sensors.iter().zip(&self.slots.ages).enumerate() {
            let fresh = *age <= limit;
            if !fresh && !sensor.kind.is_output() {
                self.status.stale |= 1 << index;
            }
        }
    }

    /// Has the driver set its outputs.
    pub(super) fn actuate(&mut self) {
        if self.status.power == Power::Off {
            self.slots.wanted.fill(0.0);
        }
        if self.slots.is_output.contains(&true)
            && let Err(error) = self.driver.actuate(&self.slots.wanted)
        {
            self.driver_failed(error);
        }
    }

    /// Sets a number of an output; of an input it sets nothing.
    pub(super) fn set_output(&mut self, number: usize, value: f64) {
        let is_output = self.slots.is_output.get(number) == Some(&true);
        if let (true, Some(wanted)) = (is_output, self.slots.wanted.get_mut(number)) {
            *wanted = value;
        }
    }

    /// What the first force-torque sensor reads, N and N m in its frame.
    pub(super) fn force(&self) -> Option<[f64; 6]> {
        let at = self.slots.force_at?;
        self.status.sensors.get(at..at + 6)?.try_into().ok()
    }

    /// Nothing begins while a slot is stale.
    pub(super) fn stale(&self) -> Option<Rejection> {
        (self.status.stale != 0).then_some(Rejection::StaleSlot)
    }

    /// A stale slot ends the motion under way, as a guard called `slots` would.
    pub(super) fn watch_slots(&mut self) {
        let stale = self.status.stale.trailing_zeros() as usize;
        let (Some(sensor), Some(age)) = (self.slots.sensors.get(stale), self.slots.ages.get(stale))
        else {
            return;
        };
        let (name, limit) = (&sensor.name, self.config.stale_after.as_secs_f64());
        let found = GuardReport {
            motion: self.status.motion.id,
            guard: words!("slots"),
            measured: match age.is_finite() {
                true => {
                    words!("what slot `{name}` reads is {age:.3} s old, the limit is {limit:.3} s")
                }
                false => words!("slot `{name}` has read nothing yet"),
            },
            reaction: Reaction::Stop,
            allowed: self.setpoint.position,
        };
        self.status.guard = Some(found);
        self.brake(words!("guard `slots`: {}", found.measured));
    }
}
