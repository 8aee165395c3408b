//! What hangs in the hand is weighed by the force sensor in the wrist, which takes the hand's own weight off.

use std::time::Duration;

use nalgebra::Vector3;

use super::ride::Ride;
use crate::outcome::{Failure, Outcome};

/// Readings of the sensor, and the time between two.
const READINGS: u32 = 40;
const BETWEEN: Duration = Duration::from_millis(9);

/// What weighs more than so many things is more than one.
const MORE_THAN_ONE: f64 = 1.5;

/// Standard gravity, m/s².
const GRAVITY: f64 = 9.80665;

impl Ride<'_> {
    /// Whether one thing hangs in the hand, and not another one with it. Nobody weighs a thing whose file does not say how heavy it
    /// is, or with an arm that has no such sensor.
    pub(super) async fn weigh(&self) -> Result<(), Failure> {
        let thing = &self.errand.thing;
        let Some(mass_kg) = thing.mass_kg else {
            return Ok(());
        };
        let mut sum = Vector3::zeros();
        for _ in 0..READINGS {
            self.cx.sleep(BETWEEN).await;
            let read = self.arm().sensors().await?;
            let [x, y, z, ..] = *read.numbers.as_slice() else {
                return Ok(());
            };
            sum += Vector3::new(x, y, z);
        }
        let weight = sum.norm() / f64::from(READINGS);
        let usual = mass_kg * GRAVITY;
        tracing::info!(weight, usual, "what was lifted is weighed");
        if weight <= MORE_THAN_ONE * usual {
            return Ok(());
        }
        let text = format!(
            "what was lifted weighs {weight:.2} N, and a {} {usual:.2} N: another one sticks to it",
            thing.name
        );
        Err(Failure::new(Outcome::Stuck, text))
    }
}
