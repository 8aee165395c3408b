//! Stops that do not slow down the path's own time: those that keep limits of jerk, and those that give way to a touch.

use mcs_model::{Joint, Joints};

use super::{Clock, Follower, Part};
use crate::chase::chase;
use crate::course::Course;
use crate::segment::{Courses, Path, SegmentError};
use crate::timing::{JointBounds, JointState};
use crate::{Setpoint, Solver};

/// A joint that is nearer than this (rad or m) to where it goes back to, and no faster (per s), is there.
const REACHED: f64 = 1e-7;
/// How long going back takes at most, about, s.
pub(super) const GOING_BACK: f64 = 0.1;

/// A stop that does not go on along the path, or that keeps the limits of jerk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Halt {
    pub(super) way: Braking,
    /// Periods since it began.
    pub(super) periods: u32,
}

#[derive(Debug, Clone, Copy)]
#[allow(
    clippy::large_enum_variant,
    reason = "courses behind a pointer would be freed, and so call the allocator, in the tick"
)]
pub(super) enum Braking {
    /// Every joint for itself, beside the path.
    Joints(Courses),
    /// The progress along the path of the tool under way.
    Path(Course),
    /// Every joint for itself back to a position, rad or m; the state in the next period, and whether that is all.
    Back {
        to: Joints,
        next: Setpoint,
        rests: bool,
    },
}

impl Follower {
    /// Stops at once: takes over the arm from where it was measured and how fast, and brings it back to that position (rad or m)
    /// as quickly as their limits of speed and acceleration allow. The setpoint of this period, unless it stops already.
    pub fn yield_to(&mut self, arm: &Setpoint, solver: &Solver) -> Option<Setpoint> {
        if self.clock.stopping {
            return None;
        }
        self.clock.stopping = true;
        let joints = solver.model().joints();
        let to = Joints::from_fn(joints.len().min(arm.position.len()), |index| {
            let limits = &joints[index].limits;
            arm.position[index].clamp(limits.lower, limits.upper)
        });
        let next = self.back(arm, &to, solver);
        let mut now = *arm;
        for (index, acceleration) in now.acceleration.iter_mut().enumerate() {
            *acceleration = (next.velocity[index] - now.velocity[index]) / self.period;
        }
        let rests = false;
        let way = Braking::Back { to, next, rests };
        self.halt = Some(Halt { way, periods: 0 });
        Some(now)
    }

    /// The states of all joints a period later on their way back to a position. Their jerk has no limit there: what keeps it presses
    /// on meanwhile.
    fn back(&self, from: &Setpoint, to: &Joints, solver: &Solver) -> Setpoint {
        let (period, mut then) = (self.period, *from);
        for (index, joint) in solver.model().joints().iter().enumerate() {
            let (position, speed) = (from.position[index], from.velocity[index]);
            let aim = (to[index], 0.0);
            let next = chase((position, speed), aim, &joint.limits, (1.0, 1.0), period);
            then.position[index] = position + 0.5 * (speed + next) * period;
            then.velocity[index] = next;
        }
        then
    }

    /// The next setpoint of a stop with limits of jerk.
    pub(super) fn brake(&mut self, solver: &mut Solver) -> Result<Setpoint, SegmentError> {
        let begun = |follower: &Self| {
            let Clock { part, time, .. } = follower.clock;
            let state = |joint| follower.told_state(joint, solver);
            follower.halt_from(part, time, solver.model().joints(), state)
        };
        let mut halt = self.halt.take().unwrap_or_else(|| begun(self));
        halt.periods = halt.periods.saturating_add(1);
        self.halt = Some(halt);
        let time = f64::from(halt.periods) * self.period;
        let mut setpoint;
        match &halt.way {
            Braking::Joints(courses) => {
                setpoint = courses.setpoint(time);
                let then = courses.setpoint(time + self.period);
                for (index, acceleration) in setpoint.acceleration.iter_mut().enumerate() {
                    *acceleration = (then.velocity[index] - setpoint.velocity[index]) / self.period;
                }
            }
            Braking::Back { to, next, .. } => {
                let then = self.back(next, to, solver);
                setpoint = *next;
                for (index, acceleration) in setpoint.acceleration.iter_mut().enumerate() {
                    *acceleration = (then.velocity[index] - next.velocity[index]) / self.period;
                }
                let near = |one: &Joints, other: &Joints| {
                    let mut pairs = one.iter().zip(other);
                    pairs.all(|(one, other)| (one - other).abs() < REACHED)
                };
                let still = Joints::zeros(to.len());
                let rests = near(&next.position, to) && near(&next.velocity, &still);
                if rests {
                    setpoint = Setpoint::at_rest(next.position);
                }
                let way = Braking::Back {
                    to: *to,
                    next: then,
                    rests,
                };
                self.halt = Some(Halt { way, ..halt });
            }
            Braking::Path(course) => {
                let [now, then] = [time, time + self.period].map(|time| course.at(time));
                self.solve_as_far(solver, then.position)?;
                setpoint = Setpoint::at_rest(Joints::zeros(solver.model().dof()));
                for index in 0..setpoint.position.len() {
                    let [now, then] = [now, then].map(|along| self.on_path(index, along));
                    setpoint.position[index] = now.position;
                    setpoint.velocity[index] = now.velocity;
                    setpoint.acceleration[index] = (then.velocity - now.velocity) / self.period;
                }
            }
        }
        Ok(setpoint)
    }

    /// A stop with limits of jerk from some time of a part, where the joints are in these states.
    pub(super) fn halt_from(
        &self,
        part: Part,
        time: f64,
        joints: &[Joint],
        state: impl Fn(usize) -> JointState,
    ) -> Halt {
        let entry = self.queue.get(part.entry);
        let way = match entry.map(|entry| entry.segment.path()) {
            Some(Path::Tool(path)) if !part.is_bridge => {
                let bounds = JointBounds {
                    velocity: f64::INFINITY,
                    acceleration: path.along.braking(time, time),
                    jerk: path.along.jerk(),
                };
                Braking::Path(Course::to_rest(&path.along.at(time), &bounds, 0.0))
            }
            _ => Braking::Joints(Courses::to_rest(joints, state)),
        };
        Halt { way, periods: 0 }
    }

    /// The state of a joint at the last setpoint. Its acceleration is no other than the limit of jerk lets it be after the mean
    /// one of the period before: between two solved poses of a path the cubics have others.
    fn told_state(&self, joint: usize, solver: &Solver) -> JointState {
        let Clock { part, time, .. } = self.clock;
        let mut state = self.state(part, joint, time);
        let limits = solver
            .model()
            .joints()
            .get(joint)
            .map(|joint| &joint.limits);
        let jerk = limits.map_or(0.0, |limits| limits.jerk);
        let mean = self.told[1].get(joint).copied().unwrap_or_default();
        if jerk > 0.0 {
            let more = 0.5 * jerk * self.period;
            state.acceleration = state.acceleration.clamp(mean - more, mean + more);
        }
        state
    }
}

impl Halt {
    /// How long it takes, s.
    pub(super) fn duration(&self) -> f64 {
        match &self.way {
            Braking::Joints(courses) => courses.duration(),
            Braking::Path(course) => course.duration(),
            Braking::Back { .. } => GOING_BACK,
        }
    }

    pub(super) fn rests(&self, period: f64) -> bool {
        match &self.way {
            Braking::Back { rests, .. } => *rests,
            _ => f64::from(self.periods) * period >= self.duration(),
        }
    }
}
