//! From the torques of one law to those of the next without a step.

use std::f64::consts::PI;
use std::time::Duration;

use crate::joints::Joints;

/// How long the difference of two laws takes to die out, s.
const BLENDING: f64 = 0.3;

/// What is left of the difference between the law before and the present one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Blend {
    /// Torques of the law before less those of the next, when they changed, N m or N.
    offset: Joints,
    tick: u32,
    ticks: u32,
}

impl Blend {
    /// Begins at `before`, the torques that the law before has just given where the next one gives `next`.
    pub(super) fn between(before: &Joints, next: &Joints, period: Duration) -> Self {
        Self {
            offset: Joints::from_fn(next.len(), |joint| before[joint] - next[joint]),
            tick: 0,
            ticks: (BLENDING / period.as_secs_f64()).ceil() as u32,
        }
    }

    /// Adds what is left to the torques of a tick: all of it in the first one, ever less, and nothing in the end.
    pub(super) fn add_to(&mut self, torques: &mut Joints) {
        if self.tick >= self.ticks {
            return;
        }
        let share = 0.5 * (1.0 + (PI * f64::from(self.tick) / f64::from(self.ticks)).cos());
        for (torque, offset) in torques.iter_mut().zip(&self.offset) {
            *torque += share * offset;
        }
        self.tick += 1;
    }
}
