//! One motion under way: which setpoint each tick gets, how well it is tracked, when it has settled.

use super::port::{MotionPhase, MotionStatus};
use super::{ServoConfig, Settling};
use crate::driver::SlotReading;
use crate::guard::Stopping;
use crate::joints::Distances;
use crate::model::{Model, Placement};
use crate::trajectory::segment::SegmentError;
use crate::trajectory::{Interpolator, Path, ProfilePoint, Segment, Setpoint, Solver};

/// What a tick made of the motion.
pub(super) enum Progress {
    Going,
    Finished(MotionPhase),
    /// The setpoint rests, and the arm has not settled in time.
    NotSettled,
}

/// A segment being followed, braked or settled on.
pub(super) struct Motion {
    segment: Segment,
    /// Servo period and setpoint interval, s.
    period: f64,
    interval: f64,
    every: u32,
    settling: Settling,
    /// Where between two planned setpoints the motion is; none before its first tick.
    between: Option<Interpolator>,
    /// Whole setpoint intervals behind, and ticks into the current one.
    intervals: u64,
    ticks: u32,
    stopping: bool,
    settled_for: u32,
    settling_for: u32,
    elapsed: u64,
    max_error: Distances,
    error: Distances,
    resting: bool,
}

impl Motion {
    pub(super) fn new(segment: Segment, config: &ServoConfig) -> Self {
        let period = config.period.as_secs_f64();
        Self {
            segment,
            period,
            interval: period * f64::from(config.setpoint_every),
            every: config.setpoint_every,
            settling: config.settling,
            between: None,
            intervals: 0,
            ticks: 0,
            stopping: false,
            settled_for: 0,
            settling_for: 0,
            elapsed: 0,
            max_error: Distances::default(),
            error: Distances::default(),
            resting: false,
        }
    }

    /// Time along the segment, s, from counts, so that it never drifts.
    fn time(&self) -> f64 {
        // A motion of 2^53 intervals would take longer than the arm will last.
        self.intervals as f64 * self.interval + f64::from(self.ticks) * self.period
    }

    /// From now on brakes along the path, from the setpoint that holds now.
    pub(super) fn stop(&mut self, solver: &mut Solver, now: &Setpoint) {
        if self.stopping || self.resting {
            self.stopping = true;
            return;
        }
        self.stopping = true;
        self.segment = self.segment.braked_at(self.time());
        self.intervals = 0;
        self.ticks = 0;
        // The first interval starts at the setpoint in force, which between two planned setpoints
        // may be a hair off the path: no step, whenever the stop comes.
        let first = self.segment.at(solver, self.interval, &now.position);
        self.between = first
            .ok()
            .map(|first| Interpolator::new(*now, first, self.interval));
    }

    /// The setpoint of this tick, given the one before and the readings of this tick.
    pub(super) fn advance(
        &mut self,
        solver: &mut Solver,
        before: &Setpoint,
        readings: &[SlotReading],
    ) -> Result<(Setpoint, Progress), SegmentError> {
        self.elapsed += 1;
        let setpoint = if self.resting {
            *before
        } else {
            self.next(solver, before)?
        };
        self.measure(solver.model(), &setpoint, readings);
        if !self.resting {
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
            Progress::Finished(if self.stopping {
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

    fn next(&mut self, solver: &mut Solver, before: &Setpoint) -> Result<Setpoint, SegmentError> {
        let between = match self.between {
            Some(between) => {
                self.ticks += 1;
                between
            }
            None => {
                let from = self.segment.at(solver, 0.0, &before.position)?;
                let between = self.interval_from(solver, from, 0)?;
                self.between = Some(between);
                between
            }
        };
        if self.ticks < self.every {
            return Ok(self.held(&between));
        }
        self.ticks = 0;
        self.intervals += 1;
        let reached = *between.end();
        if self.time() >= self.segment.duration() {
            self.resting = true;
            return Ok(Setpoint::at_rest(reached.position));
        }
        let between = self.interval_from(solver, reached, self.intervals)?;
        self.between = Some(between);
        Ok(self.held(&between))
    }

    /// The setpoint of this tick. Torques are held until the next one, so its acceleration is the mean until then: that of
    /// the middle, where it changes evenly.
    fn held(&self, between: &Interpolator) -> Setpoint {
        let now = f64::from(self.ticks) * self.period;
        Setpoint {
            acceleration: between.at(now + 0.5 * self.period).acceleration,
            ..between.at(now)
        }
    }

    fn interval_from(
        &self,
        solver: &mut Solver,
        from: Setpoint,
        intervals: u64,
    ) -> Result<Interpolator, SegmentError> {
        let end = (intervals + 1) as f64 * self.interval;
        let to = self.segment.at(solver, end, &from.position)?;
        Ok(Interpolator::new(from, to, self.interval))
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
        !self.stopping && !self.resting
    }

    /// How it would come to rest if it braked from the next tick on, in closed form.
    pub(super) fn stopping(&self) -> Stopping {
        let at = self.segment.profile().at(self.time());
        if self.resting || at.speed <= 0.0 {
            return Stopping::default();
        }
        let braked = self.segment.braked_at(self.time());
        let profile = braked.profile();
        // Time and travel, in seconds of the speed, grow as the speed does until then.
        let grows = self.pace(&at) / at.speed;
        let time = profile.duration() * grows;
        // A stop within one setpoint interval goes beyond its end on the way, by as much as a cubic does that has to
        // come to rest where it begins.
        let beyond = match time < self.interval {
            true => 4.0 / 27.0 * self.interval,
            false => 0.0,
        };
        Stopping {
            time: time.max(self.interval),
            lead: (profile.end() - at.position) / at.speed * grows + beyond,
        }
    }

    /// The speed along the path in the next tick, at most.
    fn pace(&self, at: &ProfilePoint) -> f64 {
        at.speed + at.acceleration.max(0.0) * self.period
    }

    /// Where the tool would come to rest if it braked along its straight line from the next tick on; `None` on other
    /// paths, on which the joints tell.
    pub(super) fn tool_at_rest(&self) -> Option<Placement> {
        let Path::Line(line) = self.segment.path() else {
            return None;
        };
        let at = self.segment.profile().at(self.time());
        let way = self.pace(&at) * (self.stopping().lead + self.period);
        Some(Placement::from(&line.pose(at.position + way)))
    }

    /// Largest distances of joints from their setpoints at the last tick.
    pub(super) fn error(&self) -> Distances {
        self.error
    }

    pub(super) fn report(&self, status: &mut MotionStatus) {
        status.elapsed_ticks = self.elapsed;
        status.max_tracking_error = self.max_error;
        status.error = self.error;
        status.phase = match (self.resting, self.stopping) {
            (true, _) => MotionPhase::Settling,
            (false, true) => MotionPhase::Stopping,
            (false, false) => MotionPhase::Moving,
        };
    }
}
