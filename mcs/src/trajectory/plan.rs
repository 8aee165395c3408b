//! The planner: turns a target into a checked segment, or into a refusal that names what is wrong.
//!
//! Everything that could stop a motion half way (a limit, a pose out of reach, a joint that would have
//! to turn too fast near a singularity) is found here, before anything moves.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::segment::{Line, SegmentError};
use super::{Pace, Path, Profile, ProfilePoint, Segment, Setpoint};
use crate::arm::{ArmModel, DOF, Elbow, IkError, Joints, inverse};

#[cfg(test)]
mod tests;

/// The least speed fraction accepted; slower motions would take hours.
pub const SLOWEST: f64 = 1e-3;
/// A line shorter than this (m, and rad of turn) is no motion.
const NO_WAY: f64 = 1e-9;
/// Fewest and most checks along one line.
const CHECKS: (f64, f64) = (100.0, 20_000.0);

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
    /// Speeds that the PUMA's joints can follow over most of its work volume.
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
    /// A joint would have to turn too fast to follow the line.
    #[error(
        "joint {joint} would have to turn at {value:.3} rad/s at {percent:.0} % of the straight line, its limit is {limit:.3} rad/s; slow down or move joint-interpolated"
    )]
    JointSpeed {
        /// Joint number, from 1.
        joint: usize,
        /// Speed needed, rad/s.
        value: f64,
        /// Limit, rad/s.
        limit: f64,
        /// Where on the line, percent of its length.
        percent: f64,
    },
    /// A joint would have to accelerate (or brake in a protective stop) too hard to stay on the line.
    #[error(
        "joint {joint} would have to accelerate at {value:.3} rad/s^2 at {percent:.0} % of the straight line, its limit is {limit:.3} rad/s^2; slow down or move joint-interpolated"
    )]
    JointAcceleration {
        /// Joint number, from 1.
        joint: usize,
        /// Acceleration needed, rad/s^2.
        value: f64,
        /// Limit, rad/s^2.
        limit: f64,
        /// Where on the line, percent of its length.
        percent: f64,
    },
}

/// Plans segments for one manipulator.
#[derive(Debug, Clone)]
pub struct Planner {
    model: Arc<ArmModel>,
    tool: Isometry3<f64>,
    cartesian: CartesianLimits,
    check_period: f64,
}

impl Planner {
    /// A planner for `model` with a tool at `frame6_t_tool`; lines are checked every `check_period`
    /// seconds of their motion (the setpoint period is the right one).
    #[must_use]
    pub fn new(
        model: Arc<ArmModel>,
        tool: Isometry3<f64>,
        cartesian: CartesianLimits,
        check_period: f64,
    ) -> Self {
        Self {
            model,
            tool,
            cartesian,
            check_period,
        }
    }

    /// The arm planned for.
    #[must_use]
    pub fn model(&self) -> &Arc<ArmModel> {
        &self.model
    }

    /// `base_t_tool` at joint positions `q` (rad).
    #[must_use]
    pub fn tool_pose(&self, q: &Joints) -> Isometry3<f64> {
        self.model.forward(q) * self.tool
    }

    /// Joint positions (rad) that put the tool at `base_t_tool`, nearest to `near`.
    ///
    /// # Errors
    /// [`PlanError::Target`] with the reason.
    pub fn joints_for(
        &self,
        base_t_tool: &Isometry3<f64>,
        near: &Joints,
        elbow: Option<Elbow>,
    ) -> Result<Joints, PlanError> {
        let base_t_6 = base_t_tool * self.tool.inverse();
        let found = self
            .model
            .inverse(&base_t_6, near)
            .map_err(PlanError::Target)?;
        let best = found
            .nearest(&self.model, near, elbow)
            .map_err(PlanError::Target)?;
        Ok(best.joints)
    }

    /// A joint target itself, checked against the limits.
    ///
    /// # Errors
    /// [`PlanError::NotFinite`] or [`PlanError::Target`].
    pub fn check_joints(&self, q: &Joints) -> Result<(), PlanError> {
        if let Some(index) = q.iter().position(|value| !value.is_finite()) {
            return Err(PlanError::NotFinite { joint: index + 1 });
        }
        match self.model.joint_outside(q) {
            None => Ok(()),
            Some(index) => Err(PlanError::Target(inverse::limit_error(
                &self.model,
                q,
                index,
            ))),
        }
    }

    /// A joint-interpolated motion: all joints start, cruise and stop together, the slowest of
    /// them at `pace` (fractions of full speed and acceleration; one number is both).
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
        let mut velocity = f64::INFINITY;
        let mut acceleration = f64::INFINITY;
        for ((from, to), limit) in start.iter().zip(end).zip(&self.model.limits) {
            let way = (to - from).abs();
            if way > 0.0 {
                velocity = velocity.min(limit.velocity / way);
                acceleration = acceleration.min(limit.acceleration / way);
            }
        }
        if velocity.is_infinite() {
            return Ok(Segment::hold(Arc::clone(&self.model), *end));
        }
        let profile =
            Profile::trapezoid(1.0, velocity * pace.speed, acceleration * pace.acceleration);
        let path = Path::Joint {
            start: *start,
            end: *end,
        };
        Ok(Segment::new(
            Arc::clone(&self.model),
            path,
            profile,
            acceleration,
        ))
    }

    /// A straight line of the tool to `base_t_tool`, turning about one axis on the way, in the
    /// posture of `start`, at `pace` (fractions of the Cartesian limits).
    ///
    /// # Errors
    /// Everything that would stop it on the way, with joint, value and limit.
    pub fn line(
        &self,
        start: &Joints,
        base_t_tool: &Isometry3<f64>,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let pace = pace.into().check()?;
        let start_pose = self.tool_pose(start);
        let travel = base_t_tool.translation.vector - start_pose.translation.vector;
        let turn = base_t_tool.rotation * start_pose.rotation.inverse();
        let (axis, angle) = turn.axis_angle().unwrap_or((Vector3::z_axis(), 0.0));
        let tool_inverse = self.tool.inverse();
        let branch = self.model.branch_of(start);
        let base_t_6 = base_t_tool * tool_inverse;
        // The end first: a target out of reach is a clearer refusal than a line that leaves the reach.
        let reachable = self.model.inverse_branch(&base_t_6, branch, start);
        let end_joints = reachable.map_err(PlanError::Target)?;
        let limits = &self.cartesian;
        let scale = |linear: f64, angular: f64| (linear / travel.norm()).min(angular / angle);
        let velocity = scale(limits.linear_speed, limits.angular_speed);
        let acceleration = scale(limits.linear_acceleration, limits.angular_acceleration);
        if travel.norm() < NO_WAY && angle < NO_WAY {
            return Ok(Segment::hold(Arc::clone(&self.model), *start));
        }
        let line = Line {
            start: start_pose,
            travel,
            axis,
            angle,
            tool: self.tool,
            tool_inverse,
            branch,
            end_joints,
        };
        let braking = acceleration * pace.acceleration;
        let profile = Profile::trapezoid(1.0, velocity * pace.speed, braking);
        self.check_line(&line, &profile, start, braking)?;
        Ok(Segment::new(
            Arc::clone(&self.model),
            Path::Line(line),
            profile,
            braking,
        ))
    }

    /// Follows the line in thought, as planned and as braked from every point of it.
    fn check_line(
        &self,
        line: &Line,
        profile: &Profile,
        start: &Joints,
        braking: f64,
    ) -> Result<(), PlanError> {
        let duration = profile.duration();
        let checks = (duration / self.check_period)
            .ceil()
            .clamp(CHECKS.0, CHECKS.1);
        let step = duration / checks;
        let mut near = *start;
        let mut count = 0.0;
        while count <= checks {
            let along = profile.at(count * step);
            let percent = 100.0 * along.position;
            let evaluate = |along: ProfilePoint| {
                let found = line.evaluate(&self.model, along, &near);
                found.map_err(|reason| PlanError::Line { percent, reason })
            };
            let planned = evaluate(along)?;
            let braked = evaluate(ProfilePoint {
                acceleration: -braking,
                ..along
            })?;
            self.check_setpoint(&planned, percent)?;
            self.check_setpoint(&braked, percent)?;
            self.check_step(&near, &planned.position, step, percent)?;
            near = planned.position;
            count += 1.0;
        }
        Ok(())
    }

    fn check_setpoint(&self, setpoint: &Setpoint, percent: f64) -> Result<(), PlanError> {
        for index in 0..DOF {
            let limit = &self.model.limits[index];
            let value = setpoint.velocity[index].abs();
            if value > limit.velocity {
                return Err(PlanError::JointSpeed {
                    joint: index + 1,
                    value,
                    limit: limit.velocity,
                    percent,
                });
            }
            let value = setpoint.acceleration[index].abs();
            if value > limit.acceleration {
                return Err(PlanError::JointAcceleration {
                    joint: index + 1,
                    value,
                    limit: limit.acceleration,
                    percent,
                });
            }
        }
        Ok(())
    }

    /// A joint must get from check to check at its speed limit: a whole turn or another posture in
    /// between shows here and not in the speeds at the checks.
    fn check_step(
        &self,
        from: &Joints,
        to: &Joints,
        step: f64,
        percent: f64,
    ) -> Result<(), PlanError> {
        for index in 0..DOF {
            let limit = self.model.limits[index].velocity;
            let way = (to[index] - from[index]).abs();
            if way > limit * step + 1e-6 {
                return Err(PlanError::JointSpeed {
                    joint: index + 1,
                    value: way / step,
                    limit,
                    percent,
                });
            }
        }
        Ok(())
    }
}
