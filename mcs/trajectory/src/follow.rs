//! Following a segment, one servo period at a time, and stopping on it. Allocates nothing.
//!
//! A segment has a time of its own. It runs as the clock does until a stop is asked for; then it runs ever more slowly, until it
//! stands still. So the joints stay on the path that was planned and checked. Per period it is slowed down as much as the
//! accelerations of all joints allow: with q(s) the path over its own time s, a joint's acceleration is q'' s'^2 + q' s''. A joint
//! that brakes already at its limit cannot brake harder; a joint that gains speed begins to lose it at once.

use mcs_model::{Joint, Joints};

use super::course::Ranges;
use super::interpolate::Interpolator;
use super::segment::{Path, SegmentError};
use super::timing::JointState;
use super::{Segment, Setpoint, Solver};

/// A segment that is being followed.
#[derive(Debug, Clone)]
pub struct Follower {
    segment: Segment,
    /// Servo period, s.
    period: f64,
    /// Servo periods between two solved poses of a line.
    every: u32,
    clock: Clock,
    /// Whether the first setpoint has been given.
    begun: bool,
    /// What lies between the last three solved poses of a line, and the line's time at the last of them.
    between: Option<[Interpolator; 2]>,
    solved: f64,
}

/// How the segment's own time runs.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Clock {
    /// The segment's own time, s.
    time: f64,
    /// How fast it runs, 1 to 0.
    rate: f64,
    /// Periods since the start, from which the time is counted until a stop, so that it never drifts.
    periods: u64,
    stopping: bool,
}

/// How many steps a look at a stop takes, about.
const REST_STEPS: f64 = 8.0;
/// And at most: after these it goes on as planned.
const MOST_REST_STEPS: u32 = 64;

/// How a segment would come to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// The time until then, s.
    pub time: f64,
    /// The segment's own time at which it rests, s.
    pub at: f64,
}

impl Follower {
    /// From the start of `segment`, with a setpoint every `period` (s). Poses on a line are solved every so many periods
    /// (at least 1) and interpolated between.
    #[must_use]
    pub fn new(segment: Segment, period: f64, every: u32) -> Self {
        Self {
            segment,
            period,
            every: every.max(1),
            clock: Clock {
                time: 0.0,
                rate: 1.0,
                periods: 0,
                stopping: false,
            },
            begun: false,
            between: None,
            solved: 0.0,
        }
    }

    /// Stops on the path, as hard as the accelerations of all joints allow.
    pub fn stop(&mut self) {
        self.clock.stopping = true;
    }

    /// Whether a stop was asked for.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.clock.stopping
    }

    /// Whether the setpoint rests, at the end or where a stop has ended.
    #[must_use]
    pub fn rests(&self) -> bool {
        self.begun && (self.clock.time >= self.segment.duration() || self.clock.rate <= 0.0)
    }

    /// The setpoint of the next period, `near` the joint positions (rad or m) of the one before. Its acceleration is the
    /// mean until the one after it, for which torques are held.
    ///
    /// # Errors
    /// [`SegmentError`] for a line through a pose that cannot be followed.
    pub fn next(&mut self, solver: &mut Solver, near: &[f64]) -> Result<Setpoint, SegmentError> {
        if self.begun {
            self.clock = self.after(&self.clock, self.period, solver);
        }
        self.begun = true;
        self.solve(solver, near)?;
        let mut setpoint = Setpoint::at_rest(Joints::zeros(solver.model().dof()));
        if self.rests() {
            for index in 0..setpoint.position.len() {
                setpoint.position[index] = self.state(index, self.clock.time).position;
            }
            if let Some([_, between]) = &self.between
                && self.clock.time >= self.segment.duration()
            {
                setpoint.position = between.end().position;
            }
            return Ok(setpoint);
        }
        let ahead = self.after(&self.clock, self.period, solver);
        for index in 0..setpoint.position.len() {
            let now = self.state(index, self.clock.time);
            let then = self.state(index, ahead.time);
            setpoint.position[index] = now.position;
            setpoint.velocity[index] = now.velocity * self.clock.rate;
            setpoint.acceleration[index] =
                (then.velocity * ahead.rate - setpoint.velocity[index]) / self.period;
        }
        Ok(setpoint)
    }

    /// The segment that is followed.
    #[must_use]
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// The segment's own time now, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.clock.time
    }

    /// How it would come to rest if a stop were asked for now, in steps longer than a period: a step brakes as hard as all of it
    /// bears, and so no harder than its periods would. Of a line only the tool counts.
    #[must_use]
    pub fn rest(&self, solver: &Solver) -> Rest {
        let mut clock = Clock {
            stopping: true,
            ..self.clock
        };
        let braking = self.braking(&clock, self.period, solver);
        let left = (self.segment.duration() - clock.time).max(0.0);
        let step = (clock.rate / braking).min(left) / REST_STEPS;
        let step = step.max(self.period);
        let mut time = 0.0;
        for _ in 0..MOST_REST_STEPS {
            if clock.rate <= 0.0 || clock.time >= self.segment.duration() {
                break;
            }
            let next = self.after(&clock, step, solver);
            // The last step is shorter where it comes to rest within.
            time += match next.rate > 0.0 {
                true => step,
                false => step.min(2.0 * (next.time - clock.time) / clock.rate),
            };
            clock = next;
        }
        let (end, still_going) = (self.segment.duration(), clock.rate > 0.0);
        Rest {
            time: time
                + if still_going {
                    (end - clock.time).max(0.0) / clock.rate
                } else {
                    0.0
                },
            at: if still_going {
                end
            } else {
                clock.time.min(end)
            },
        }
    }

    /// The clock one `period` later, s.
    fn after(&self, clock: &Clock, period: f64, solver: &Solver) -> Clock {
        if !clock.stopping {
            let periods = clock.periods + 1;
            return Clock {
                // A motion of 2^53 periods would take longer than the arm will last.
                time: periods as f64 * period,
                periods,
                ..*clock
            };
        }
        let braking = self.braking(clock, period, solver);
        if clock.rate <= braking * period {
            // It stands before the period is over.
            let way = match braking > 0.0 {
                true => 0.5 * clock.rate * clock.rate / braking,
                false => 0.0,
            };
            return Clock {
                time: clock.time + way,
                rate: 0.0,
                ..*clock
            };
        }
        Clock {
            time: clock.time + period * (clock.rate - 0.5 * braking * period),
            rate: clock.rate - braking * period,
            ..*clock
        }
    }

    /// How fast the rate may fall within the coming `period` (s), 1/s.
    fn braking(&self, clock: &Clock, period: f64, solver: &Solver) -> f64 {
        // First with what gains speed left out of account, which gives the lowest rate at the end of the period.
        let bold = self.bearable(clock, period, clock.rate, solver);
        let slowest = (clock.rate - bold * period).max(0.0);
        self.bearable(clock, period, slowest, solver)
    }

    /// How fast the rate may fall within the coming `period` (s) when it falls no lower than `slowest`.
    fn bearable(&self, clock: &Clock, period: f64, slowest: f64, solver: &Solver) -> f64 {
        let until = clock.time + clock.rate * period;
        let room = |ranges: &Ranges, limit: f64| {
            let (speed, acceleration) = (&ranges.velocity, &ranges.acceleration);
            let fastest = speed.most.max(-speed.least);
            if fastest <= 0.0 {
                return f64::INFINITY;
            }
            // The acceleration along the way of the joint, and against it where that turns within the period.
            let along = if speed.least >= 0.0 {
                acceleration.least
            } else if speed.most <= 0.0 {
                -acceleration.most
            } else {
                -acceleration.most.max(-acceleration.least)
            };
            let rate = if along > 0.0 { slowest } else { clock.rate };
            (limit + along * rate * rate).max(0.0) / fastest
        };
        let limit = |joint: &Joint| joint.limits.acceleration;
        let joints = solver.model().joints().iter().enumerate();
        match &self.segment.path() {
            Path::Joint(courses) => {
                joints
                    .zip(courses.each())
                    .fold(f64::INFINITY, |least, ((_, joint), course)| {
                        least.min(room(&course.ranges(clock.time, until), limit(joint)))
                    })
            }
            Path::Line(line) => {
                let tool = room(&line.progress.ranges(clock.time, until), line.braking);
                if until > self.solved {
                    return tool;
                }
                let middle = 0.5 * (clock.time + until);
                joints.fold(tool, |least, (index, joint)| {
                    // Within a period the cubics hardly bend.
                    let states = [clock.time, middle, until].map(|time| self.state(index, time));
                    let ranges = states.iter().fold(Ranges::NONE, Ranges::with);
                    least.min(room(&ranges, limit(joint)))
                })
            }
        }
    }

    /// A joint's state at some time of the segment's own.
    fn state(&self, joint: usize, time: f64) -> JointState {
        match (self.segment.path(), &self.between) {
            (Path::Joint(courses), _) => courses
                .each()
                .get(joint)
                .map_or_else(JointState::default, |course| course.at(time)),
            (Path::Line(line), Some([older, newer])) => {
                let along = line.progress.at(time);
                let between = match along.position < newer.start().progress {
                    true => older,
                    false => newer,
                };
                let [position, slope, bend] = between.at(joint, along.position);
                JointState {
                    position,
                    velocity: slope * along.velocity,
                    acceleration: bend * along.velocity * along.velocity
                        + slope * along.acceleration,
                }
            }
            // Poses are solved before anybody asks.
            (Path::Line(_), None) => JointState::default(),
        }
    }

    /// Sees that the poses of a line are solved up to where the clock is.
    fn solve(&mut self, solver: &mut Solver, near: &[f64]) -> Result<(), SegmentError> {
        let Path::Line(line) = self.segment.path() else {
            return Ok(());
        };
        let mut last = match &self.between {
            Some([_, between]) => *between.end(),
            None => line.knot(solver, 0.0, near)?,
        };
        // One period ahead, because the speed there is announced.
        while self.between.is_none() || self.solved < self.clock.time + self.period {
            self.solved += self.period * f64::from(self.every);
            let progress = line.progress.at(self.solved).position;
            let next = line.knot(solver, progress, &last.position)?;
            let newer = Interpolator::new(last, next);
            let older = self.between.map_or(newer, |[_, between]| between);
            self.between = Some([older, newer]);
            last = next;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
