//! One motion under way: how well its setpoints are tracked, and when it has settled.

use super::Settling;
use super::port::{MotionPhase, MotionStatus};
use crate::driver::SlotReading;
use crate::guard::Stopping;
use crate::joints::{Distances, Joints};
use crate::model::Model;
use crate::trajectory::{Rest, Setpoint, way_to_rest};

/// What a tick made of the motion.
pub(super) enum Progress {
    Going,
    Finished(MotionPhase),
    /// The setpoint rests, and the arm has not settled in time.
    NotSettled,
}

/// A segment or a stream being followed, braked or settled on.
pub(super) struct Motion {
    settling: Settling,
    settled_for: u32,
    settling_for: u32,
    elapsed: u64,
    max_error: Distances,
    error: Distances,
}

impl Motion {
    pub(super) fn new(settling: Settling) -> Self {
        Self {
            settling,
            settled_for: 0,
            settling_for: 0,
            elapsed: 0,
            max_error: Distances::default(),
            error: Distances::default(),
        }
    }

    /// What this tick made of it: its setpoint, what was read, whether the setpoint rests and whether it does not go on.
    pub(super) fn settle(
        &mut self,
        model: &Model,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        (rests, stopping): (bool, bool),
    ) -> Progress {
        self.elapsed += 1;
        self.measure(model, setpoint, readings);
        if !rests {
            return Progress::Going;
        }
        self.settling_for += 1;
        let slow = readings
            .iter()
            .all(|reading| reading.velocity.abs() <= self.settling.speed);
        let (_, error) = self.error.largest();
        if slow && error <= self.settling.error {
            self.settled_for += 1;
        } else {
            self.settled_for = 0;
        }
        if self.settled_for >= self.settling.ticks {
            Progress::Finished(if stopping {
                MotionPhase::Stopped
            } else {
                MotionPhase::Done
            })
        } else if self.settling_for >= self.settling.patience {
            Progress::NotSettled
        } else {
            Progress::Going
        }
    }

    fn measure(&mut self, model: &Model, setpoint: &Setpoint, readings: &[SlotReading]) {
        let pairs = setpoint.position.iter().zip(readings);
        let joints = pairs.zip(model.joints());
        self.error = joints.fold(Distances::default(), |most, ((wanted, reading), joint)| {
            most.with(joint.kind, (wanted - reading.position).abs())
        });
        self.max_error = self.max_error.or(self.error);
    }

    /// How it comes to rest as `rest` says, `setpoint` being that of this tick. On a path of the tool the joints are taken to go
    /// on in proportion to their speeds.
    pub(super) fn stopping(rest: &Rest, setpoint: &Setpoint, period: f64) -> Stopping {
        let straight = || {
            // Before the braking begins a period goes by.
            let lead = (rest.lead - period).max(0.0);
            way_to_rest(1.0, |share| {
                let seconds = period + lead * share * (2.0 - share);
                Joints::from_fn(setpoint.position.len(), |index| {
                    setpoint.position[index] + setpoint.pace(index, period) * seconds
                })
            })
        };
        Stopping {
            time: rest.time.max(2.0 * period),
            way: rest.way.unwrap_or_else(straight),
        }
    }

    /// Largest distances of joints from their setpoints at the last tick.
    pub(super) fn error(&self) -> Distances {
        self.error
    }

    /// Tells how it is, and whether its setpoint rests or does not go on.
    pub(super) fn report(&self, (rests, stopping): (bool, bool), status: &mut MotionStatus) {
        status.elapsed_ticks = self.elapsed;
        status.max_tracking_error = self.max_error;
        status.error = self.error;
        status.phase = match (rests, stopping) {
            (true, _) => MotionPhase::Settling,
            (false, true) => MotionPhase::Stopping,
            (false, false) => MotionPhase::Moving,
        };
    }
}
