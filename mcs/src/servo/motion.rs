//! One motion under way: which setpoint each tick gets, how well it is tracked, when it has settled.

use super::port::{MotionPhase, MotionStatus};
use super::{ServoConfig, Settling};
use crate::driver::SlotReading;
use crate::guard::Stopping;
use crate::joints::Distances;
use crate::model::{Model, Placement};
use crate::trajectory::segment::SegmentError;
use crate::trajectory::{Follower, Path, Segment, Setpoint, Solver};

/// A joint (rad/s or m/s), or a line (1/s), that is slower does not move yet.
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
    follower: Follower,
    /// Servo period, s.
    period: f64,
    settling: Settling,
    settled_for: u32,
    settling_for: u32,
    elapsed: u64,
    max_error: Distances,
    error: Distances,
}

/// How many seconds at `pace` a way takes; of one that does not move yet none.
fn seconds(way: f64, pace: f64) -> f64 {
    match pace.abs() > STANDING {
        true => (way / pace).max(0.0),
        false => 0.0,
    }
}

impl Motion {
    pub(super) fn new(segment: Segment, config: &ServoConfig) -> Self {
        let period = config.period.as_secs_f64();
        Self {
            follower: Follower::new(segment, period, config.setpoint_every),
            period,
            settling: config.settling,
            settled_for: 0,
            settling_for: 0,
            elapsed: 0,
            max_error: Distances::default(),
            error: Distances::default(),
        }
    }

    /// From now on brakes along the path.
    pub(super) fn stop(&mut self) {
        self.follower.stop();
    }

    /// The setpoint of this tick, given the one before and the readings of this tick.
    pub(super) fn advance(
        &mut self,
        solver: &mut Solver,
        before: &Setpoint,
        readings: &[SlotReading],
    ) -> Result<(Setpoint, Progress), SegmentError> {
        self.elapsed += 1;
        let setpoint = if self.follower.rests() {
            *before
        } else {
            self.follower.next(solver, &before.position)?
        };
        self.measure(solver.model(), &setpoint, readings);
        if !self.follower.rests() {
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
            Progress::Finished(if self.follower.is_stopping() {
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

    /// Whether it follows its segment and nobody has it brake.
    pub(super) fn is_under_way(&self) -> bool {
        !self.follower.is_stopping() && !self.follower.rests()
    }

    /// How it would come to rest if it braked from the next tick on, `setpoint` being that of this one. No joint goes farther
    /// than this says.
    pub(super) fn stopping(&self, solver: &Solver, setpoint: &Setpoint) -> Stopping {
        if self.follower.rests() {
            return Stopping::default();
        }
        let rest = self.follower.rest(solver);
        let lead = match self.follower.segment().path() {
            Path::Line(line) => {
                let [now, then] =
                    [self.follower.time(), rest.at].map(|time| line.progress.at(time));
                let pace = now.velocity + now.acceleration.max(0.0) * self.period;
                seconds(then.position - now.position, pace)
            }
            Path::Joint(courses) => {
                courses
                    .each()
                    .iter()
                    .enumerate()
                    .fold(0.0, |most: f64, (index, course)| {
                        let way = course.at(rest.at).position - setpoint.position[index];
                        most.max(seconds(way, setpoint.pace(index, self.period)))
                    })
            }
        };
        Stopping {
            time: rest.time.max(2.0 * self.period),
            lead,
        }
    }

    /// Where the tool would come to rest if it braked along its straight line from the next tick on; `None` on other
    /// paths, on which the joints tell.
    pub(super) fn tool_at_rest(&self, solver: &Solver) -> Option<Placement> {
        let Path::Line(line) = self.follower.segment().path() else {
            return None;
        };
        let rest = self.follower.rest(solver).at + self.period;
        Some(Placement::from(&line.pose(line.progress.at(rest).position)))
    }

    /// Largest distances of joints from their setpoints at the last tick.
    pub(super) fn error(&self) -> Distances {
        self.error
    }

    pub(super) fn report(&self, status: &mut MotionStatus) {
        status.elapsed_ticks = self.elapsed;
        status.max_tracking_error = self.max_error;
        status.error = self.error;
        status.phase = match (self.follower.rests(), self.follower.is_stopping()) {
            (true, _) => MotionPhase::Settling,
            (false, true) => MotionPhase::Stopping,
            (false, false) => MotionPhase::Moving,
        };
    }
}
