//! One motion under way: which setpoint each tick gets, how well it is tracked, when it has settled.

use super::Settling;
use super::port::{MotionPhase, MotionStatus};
use crate::driver::SlotReading;
use crate::guard::Stopping;
use crate::joints::Distances;
use crate::model::Model;
use crate::trajectory::segment::SegmentError;
use crate::trajectory::{Follower, Rest, Setpoint, Solver};

/// A joint (rad/s or m/s) that is slower does not move yet.
const STANDING: f64 = 1e-9;

/// What a tick made of the motion.
pub(super) enum Progress {
    Going,
    Finished(MotionPhase),
    /// The setpoint rests, and the arm has not settled in time.
    NotSettled,
}

/// A segment being followed, braked or settled on.
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

    /// The setpoint of this tick, given the one before and the readings of this tick.
    pub(super) fn advance(
        &mut self,
        (follower, solver): (&mut Follower, &mut Solver),
        before: &Setpoint,
        readings: &[SlotReading],
    ) -> Result<(Setpoint, Progress), SegmentError> {
        self.elapsed += 1;
        let setpoint = if follower.rests() {
            *before
        } else {
            follower.next(solver, &before.position)?
        };
        self.measure(solver.model(), &setpoint, readings);
        if !follower.rests() {
            return Ok((setpoint, Progress::Going));
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
        let progress = if self.settled_for >= self.settling.ticks {
            Progress::Finished(if follower.is_stopping() {
                MotionPhase::Stopped
            } else {
                MotionPhase::Done
            })
        } else if self.settling_for >= self.settling.patience {
            Progress::NotSettled
        } else {
            Progress::Going
        };
        Ok((setpoint, progress))
    }

    fn measure(&mut self, model: &Model, setpoint: &Setpoint, readings: &[SlotReading]) {
        let pairs = setpoint.position.iter().zip(readings);
        let joints = pairs.zip(model.joints());
        self.error = joints.fold(Distances::default(), |most, ((wanted, reading), joint)| {
            most.with(joint.kind, (wanted - reading.position).abs())
        });
        self.max_error = self.max_error.or(self.error);
    }

    /// How it comes to rest as `rest` says, `setpoint` being that of this tick: no joint goes farther than this says.
    pub(super) fn stopping(rest: &Rest, setpoint: &Setpoint, period: f64) -> Stopping {
        let lead = match (&rest.joints, rest.lead) {
            (Some(joints), _) => {
                let all = joints.iter().zip(&setpoint.position).enumerate();
                all.fold(0.0, |most: f64, (index, (then, now))| {
                    let pace = setpoint.pace(index, period);
                    match pace.abs() > STANDING {
                        true => most.max((then - now) / pace),
                        false => most,
                    }
                })
            }
            (None, lead) => lead,
        };
        Stopping {
            time: rest.time.max(2.0 * period),
            // Who counts with it adds the period before the braking begins.
            lead: (lead - period).max(0.0),
        }
    }

    /// Largest distances of joints from their setpoints at the last tick.
    pub(super) fn error(&self) -> Distances {
        self.error
    }

    pub(super) fn report(&self, follower: &Follower, status: &mut MotionStatus) {
        status.elapsed_ticks = self.elapsed;
        status.max_tracking_error = self.max_error;
        status.error = self.error;
        status.phase = match (follower.rests(), follower.is_stopping()) {
            (true, _) => MotionPhase::Settling,
            (false, true) => MotionPhase::Stopping,
            (false, false) => MotionPhase::Moving,
        };
    }
}
