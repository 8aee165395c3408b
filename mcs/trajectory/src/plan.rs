//! The planner: turns a target into a checked segment, or into a refusal that names what is wrong.
//!
//! Everything that could stop a motion half way (a limit, a pose out of reach, a joint that would have
//! to turn too fast near a singularity) is found here, before anything moves.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::course::Course;
use super::interpolate::{Interpolator, Knot};
use super::segment::{Courses, Line, SegmentError};
use super::timing::{JointBounds, JointState};
use super::{Pace, Path, Segment, Solver};
use mcs_model::inverse::{Elbow, IkError};
use mcs_model::{JointKind, Model};
use mcs_model::{Joints, MAX_SLOTS, TooManyJoints};

#[cfg(test)]
mod tests;

/// The least speed fraction accepted; slower motions would take hours.
pub const SLOWEST: f64 = 1e-3;
/// A line shorter than this (m, and rad of turn) is no motion.
const NO_WAY: f64 = 1e-9;
/// Most checks along one line.
const MOST_CHECKS: f64 = 20_000.0;

/// Limits of the tool's motion along a straight line.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CartesianLimits {
    /// Speed, m/s.
    pub linear_speed: f64,
    /// Acceleration, m/s^2.
    pub linear_acceleration: f64,
    /// Turning speed, rad/s.
    pub angular_speed: f64,
    /// Turning acceleration, rad/s^2.
    pub angular_acceleration: f64,
}

impl Default for CartesianLimits {
    /// Speeds that a PUMA's joints can follow over most of its work volume.
    fn default() -> Self {
        Self {
            linear_speed: 0.5,
            linear_acceleration: 1.5,
            angular_speed: 1.0,
            angular_acceleration: 3.0,
        }
    }
}

/// Why a motion is refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The speed is not a usable fraction.
    #[error("speed {given} is not a fraction of full speed; give a value from {SLOWEST} to 1")]
    Speed {
        /// What was given.
        given: f64,
    },
    /// The acceleration is not a usable fraction.
    #[error(
        "acceleration {given} is not a fraction of full acceleration; give a value from {SLOWEST} to 1"
    )]
    Acceleration {
        /// What was given.
        given: f64,
    },
    /// A joint target holds a NaN or an infinity.
    #[error("the target of joint {joint} is not a finite number")]
    NotFinite {
        /// Joint number, from 1.
        joint: usize,
    },
    /// So many joint positions are not those of the arm.
    #[error("the arm has {needed} joints, and the target has {given} positions")]
    Count {
        /// Joints of the arm.
        needed: usize,
        /// Positions given.
        given: usize,
    },
    /// Without limits of speed and acceleration there is no fraction of them.
    #[error(
        "joint {joint} has no largest speed or acceleration above zero in its model; give the servo `velocity` and `acceleration`"
    )]
    NoLimit {
        /// Joint number, from 1.
        joint: usize,
    },
    /// The target itself is out of reach or beyond a joint's limits.
    #[error("{0}; choose another target")]
    Target(IkError),
    /// The line leaves what the arm can reach.
    #[error(
        "the straight line cannot be followed at {percent:.0} % of its length: {reason}; move joint-interpolated or through another pose"
    )]
    Line {
        /// Where on the line, percent of its length.
        percent: f64,
        /// What is wrong there.
        reason: SegmentError,
    },
    /// A joint would have to move too fast to follow the line.
    #[error(
        "joint {joint} would have to move at {value:.3} {unit}/s at {percent:.0} % of the straight line, its limit is {limit:.3} {unit}/s; slow down or move joint-interpolated",
        unit = .kind.unit()
    )]
    JointSpeed {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Speed needed, rad/s or m/s.
        value: f64,
        /// Limit, rad/s or m/s.
        limit: f64,
        /// Where on the line, percent of its length.
        percent: f64,
    },
    /// A joint would have to accelerate (or brake in a protective stop) too hard to stay on the line.
    #[error(
        "joint {joint} would have to accelerate at {value:.3} {unit}/s^2 at {percent:.0} % of the straight line, its limit is {limit:.3} {unit}/s^2; slow down or move joint-interpolated",
        unit = .kind.unit()
    )]
    JointAcceleration {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Acceleration needed, rad/s^2 or m/s^2.
        value: f64,
        /// Limit, rad/s^2 or m/s^2.
        limit: f64,
        /// Where on the line, percent of its length.
        percent: f64,
    },
}

/// Plans segments for one manipulator, whose tool is the tip of its model.
#[derive(Debug, Clone)]
pub struct Planner {
    pub(super) solver: Solver,
    cartesian: CartesianLimits,
    pub(super) check_period: f64,
    pub(super) limits_jerk: bool,
}

impl Planner {
    /// A planner for `model`; lines of its tip are checked every `check_period` seconds of their motion (the time in
    /// which the servo solves one pose is the right one).
    ///
    /// # Errors
    /// [`TooManyJoints`].
    pub fn new(
        model: Arc<Model>,
        cartesian: CartesianLimits,
        check_period: f64,
    ) -> Result<Self, TooManyJoints> {
        Ok(Self {
            solver: Solver::new(model)?,
            cartesian,
            check_period,
            limits_jerk: false,
        })
    }

    /// Whether joint-interpolated motions keep the limits of jerk that the model's joints have. They do not unless this is
    /// set: their accelerations jump. Lines and stops know no limit of jerk.
    #[must_use]
    pub fn limiting_jerk(mut self, limits: bool) -> Self {
        self.limits_jerk = limits;
        self
    }

    /// The arm planned for.
    #[must_use]
    pub fn model(&self) -> &Arc<Model> {
        self.solver.model()
    }

    /// `base_t_tool` at joint positions `q` (rad or m).
    pub fn tool_pose(&mut self, q: &[f64]) -> Isometry3<f64> {
        self.solver.pose(q)
    }

    /// Joint positions (rad or m) that put the tool at `base_t_tool`, near `near`: see [`Solver::nearest`].
    ///
    /// # Errors
    /// [`PlanError::Target`] with the reason.
    pub fn joints_for(
        &mut self,
        base_t_tool: &Isometry3<f64>,
        near: &Joints,
        elbow: Option<Elbow>,
    ) -> Result<Joints, PlanError> {
        let found = self.solver.nearest(base_t_tool, near, elbow);
        found.map_err(PlanError::Target)
    }

    /// A joint target itself, checked against the limits.
    ///
    /// # Errors
    /// [`PlanError::Count`], [`PlanError::NotFinite`] or [`PlanError::Target`].
    pub fn check_joints(&self, q: &[f64]) -> Result<(), PlanError> {
        let model = self.model();
        let (needed, given) = (model.dof(), q.len());
        if needed != given {
            return Err(PlanError::Count { needed, given });
        }
        if let Some(index) = q.iter().position(|value| !value.is_finite()) {
            return Err(PlanError::NotFinite { joint: index + 1 });
        }
        let Some(index) = model.joint_outside(q) else {
            return Ok(());
        };
        let joint = &model.joints()[index];
        Err(PlanError::Target(IkError::JointLimit {
            joint: index + 1,
            kind: joint.kind,
            value: q[index],
            lower: joint.limits.lower,
            upper: joint.limits.upper,
        }))
    }

    /// A joint-interpolated motion: all joints start and stop together. Each is on the quickest course that `pace`
    /// (fractions of full speed and acceleration; one number is both) leaves it, stretched to the time of the slowest.
    ///
    /// # Errors
    /// A pace that is no fraction, a target that is no number or beyond a limit.
    pub fn joint(
        &self,
        start: &Joints,
        end: &Joints,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let pace = pace.into().check()?;
        self.check_joints(end)?;
        let mut courses = [Course::default(); MAX_SLOTS];
        let mut together = 0.0_f64;
        let joints = self.model().joints().iter().zip(&mut courses);
        let ends = start.iter().zip(end);
        for (index, ((joint, course), (from, to))) in joints.zip(ends).enumerate() {
            let limits = &joint.limits;
            let usable = |limit: f64| limit > 0.0 && limit.is_finite();
            if from == to {
                *course = Course::still(*to);
                continue;
            }
            if !usable(limits.velocity) || !usable(limits.acceleration) {
                return Err(PlanError::NoLimit { joint: index + 1 });
            }
            let limits_jerk = self.limits_jerk && usable(limits.jerk);
            let bounds = JointBounds {
                velocity: limits.velocity * pace.speed,
                acceleration: limits.acceleration * pace.acceleration,
                jerk: match limits_jerk {
                    true => limits.jerk * pace.acceleration,
                    false => 0.0,
                },
            };
            *course = Course::rest_to_rest(*from, *to, &bounds);
            together = together.max(course.duration());
        }
        let stretched = |index: usize| {
            let course = &courses[index];
            match course.duration() {
                0.0 => *course,
                least => course.stretched(together / least),
            }
        };
        let courses = Courses::new(end.len(), stretched);
        Ok(Segment::new(Path::Joint(courses)))
    }

    /// A straight line of the tool to `base_t_tool`, turning about one axis. An arm with a closed form keeps its posture;
    /// another moves its joints as little as it can. The line is followed in thought, point by point, before it is
    /// accepted.
    ///
    /// # Errors
    /// The first thing that is wrong on it.
    pub fn line(
        &mut self,
        start: &Joints,
        base_t_tool: &Isometry3<f64>,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let pace = pace.into().check()?;
        let start_pose = self.tool_pose(start);
        let travel = base_t_tool.translation.vector - start_pose.translation.vector;
        let turn = base_t_tool.rotation * start_pose.rotation.inverse();
        let (axis, angle) = turn.axis_angle().unwrap_or((Vector3::z_axis(), 0.0));
        let branch = self.solver.branch_of(start);
        // The end first: a target out of reach is a clearer refusal than a line that leaves the reach.
        let end_joints = match branch {
            Some(_) => self.solver.follow(base_t_tool, branch, start),
            None => self.solver.nearest(base_t_tool, start, None),
        }
        .map_err(PlanError::Target)?;
        let limits = &self.cartesian;
        let scale = |linear: f64, angular: f64| (linear / travel.norm()).min(angular / angle);
        let velocity = scale(limits.linear_speed, limits.angular_speed);
        let acceleration = scale(limits.linear_acceleration, limits.angular_acceleration);
        if travel.norm() < NO_WAY && angle < NO_WAY {
            return Ok(Segment::hold(*start));
        }
        let along = JointBounds {
            velocity: velocity * pace.speed,
            acceleration: acceleration * pace.acceleration,
            jerk: 0.0,
        };
        let mut line = Line {
            start: start_pose,
            travel,
            axis,
            angle,
            branch,
            end_joints,
            progress: Course::rest_to_rest(0.0, 1.0, &along),
            braking: along.acceleration,
        };
        line.end_joints = self.check_line(&line, start)?;
        Ok(Segment::new(Path::Line(line)))
    }

    /// Follows the line in thought, as planned and as braked from every point of it, to the joint positions at its end.
    /// Poses are solved and joined by cubics as the servo does it, whose accelerations are those that count: without a
    /// closed form they are not the least ones of each pose.
    fn check_line(&mut self, line: &Line, start: &Joints) -> Result<Joints, PlanError> {
        let duration = line.progress.duration();
        let step = self.check_period.max(duration / MOST_CHECKS);
        let mut last = self.knot(line, 0.0, start)?;
        let mut time = 0.0;
        while time < duration {
            let progress = line.progress.at(time + step).position;
            let next = self.knot(line, progress, &last.position)?;
            let between = Interpolator::new(last, next);
            let moving = line.progress.ranges(time, time + step);
            for share in [0.0, 0.5, 1.0] {
                let along = line.progress.at(time + share * step);
                let hardest = [
                    moving.acceleration.least,
                    moving.acceleration.most,
                    -line.braking,
                ];
                self.check_joints_on(&between, along, hardest)?;
            }
            self.check_step(&last.position, &next.position, step, 100.0 * last.progress)?;
            last = next;
            time += step;
        }
        Ok(last.position)
    }

    fn knot(&mut self, line: &Line, progress: f64, near: &[f64]) -> Result<Knot, PlanError> {
        let knot = line.knot(&mut self.solver, progress, near);
        knot.map_err(|reason| PlanError::Line {
            percent: 100.0 * progress,
            reason,
        })
    }

    /// Checks what the joints do between two solved poses while the tool is `along` the line, under some accelerations of
    /// the progress, 1/s^2.
    fn check_joints_on(
        &self,
        between: &Interpolator,
        along: JointState,
        accelerations: [f64; 3],
    ) -> Result<(), PlanError> {
        let percent = 100.0 * along.position;
        for (index, joint) in self.model().joints().iter().enumerate() {
            let (kind, limit) = (joint.kind, &joint.limits);
            let [_, slope, bend] = between.at(index, along.position);
            let value = (slope * along.velocity).abs();
            if value > limit.velocity {
                return Err(PlanError::JointSpeed {
                    joint: index + 1,
                    kind,
                    value,
                    limit: limit.velocity,
                    percent,
                });
            }
            for acceleration in accelerations {
                let value = bend * along.velocity * along.velocity + slope * acceleration;
                if value.abs() > limit.acceleration {
                    return Err(PlanError::JointAcceleration {
                        joint: index + 1,
                        kind,
                        value: value.abs(),
                        limit: limit.acceleration,
                        percent,
                    });
                }
            }
        }
        Ok(())
    }

    /// A joint must get from check to check at its speed limit: a whole turn or another posture in
    /// between shows here and not in the speeds at the checks.
    fn check_step(
        &self,
        from: &[f64],
        to: &[f64],
        step: f64,
        percent: f64,
    ) -> Result<(), PlanError> {
        for (index, joint) in self.model().joints().iter().enumerate() {
            let limit = joint.limits.velocity;
            let way = (to[index] - from[index]).abs();
            if way > limit * step + 1e-6 {
                return Err(PlanError::JointSpeed {
                    joint: index + 1,
                    kind: joint.kind,
                    value: way / step,
                    limit,
                    percent,
                });
            }
        }
        Ok(())
    }
}
