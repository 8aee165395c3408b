//! The planner: turns a target into a checked segment, or into a refusal that names what is wrong.
//!
//! Everything that could stop a motion half way (a limit, a pose out of reach, a singularity) is found here, before
//! anything moves. A path of the tool goes more slowly where a joint could not follow it otherwise.

mod error;
#[cfg(test)]
mod tests;
mod tool;

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::course::Course;
use super::curve::Curve;
use super::segment::Courses;
use super::timing::JointBounds;
use super::{Pace, Path, PlanningRegistry, Segment, Solver};
pub use error::PlanError;
use mcs_model::Model;
use mcs_model::inverse::{Elbow, IkError};
use mcs_model::{Joints, MAX_SLOTS, TooManyJoints};

/// The least speed fraction accepted; slower motions would take hours.
pub const SLOWEST: f64 = 1e-3;

/// Limits of the tool's motion along a line, an arc or an arch.
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
    /// Jerk along the path, m/s^3, where jerk is limited.
    pub linear_jerk: f64,
    /// Turning jerk, rad/s^3, where jerk is limited.
    pub angular_jerk: f64,
}

impl Default for CartesianLimits {
    /// Speeds that a PUMA's joints can follow over most of its work volume.
    fn default() -> Self {
        Self {
            linear_speed: 0.5,
            linear_acceleration: 1.5,
            angular_speed: 1.0,
            angular_acceleration: 3.0,
            linear_jerk: 15.0,
            angular_jerk: 30.0,
        }
    }
}

/// Plans segments for one manipulator, whose tool is the tip of its model.
#[derive(Debug, Clone)]
pub struct Planner {
    pub(super) solver: Solver,
    cartesian: CartesianLimits,
    pub(super) check_period: f64,
    pub(super) limits_jerk: bool,
    pub(super) planning: Arc<PlanningRegistry>,
}

impl Planner {
    /// A planner for `model`; paths of its tip are checked every `check_period` seconds of their motion (the time in
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
            planning: Arc::default(),
        })
    }

    /// With the path planners of a program.
    #[must_use]
    pub fn offering(mut self, planning: Arc<PlanningRegistry>) -> Self {
        self.planning = planning;
        self
    }

    /// With a way to find joint positions, for the same arm.
    #[must_use]
    pub fn solving_by(mut self, solver: Solver) -> Self {
        self.solver = solver;
        self
    }

    /// How joint positions are found.
    #[must_use]
    pub fn solver(&self) -> &Solver {
        &self.solver
    }

    /// Whether motions keep the limits of jerk that the model's joints have, and those of the tool along its path. They do
    /// not unless this is set: their accelerations jump. A path of the tool is then so slow that a stop anywhere on it keeps
    /// them as well.
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
            let fractions = (pace.speed, pace.acceleration);
            let bounds = JointBounds::of(limits, fractions, self.limits_jerk);
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

    /// A straight line in the space of the joints: all joints in proportion, in the least time that `pace` leaves the one
    /// that needs longest. What is free of obstacles on that line, the arm does not touch.
    ///
    /// # Errors
    /// As [`Self::joint`].
    pub fn direct(
        &self,
        start: &Joints,
        end: &Joints,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let pace = pace.into().check()?;
        self.check_joints(end)?;
        // Of the progress from 0 to 1.
        let mut bounds = JointBounds {
            velocity: f64::INFINITY,
            acceleration: f64::INFINITY,
            jerk: f64::INFINITY,
        };
        let joints = self.model().joints().iter().enumerate();
        for ((index, joint), (from, to)) in joints.zip(start.iter().zip(end)) {
            let (limits, way) = (&joint.limits, (to - from).abs());
            let usable = |limit: f64| limit > 0.0 && limit.is_finite();
            if way == 0.0 {
                continue;
            }
            if !usable(limits.velocity) || !usable(limits.acceleration) {
                return Err(PlanError::NoLimit { joint: index + 1 });
            }
            let speed = limits.velocity * pace.speed / way;
            let acceleration = limits.acceleration * pace.acceleration / way;
            bounds.velocity = bounds.velocity.min(speed);
            bounds.acceleration = bounds.acceleration.min(acceleration);
            if self.limits_jerk && usable(limits.jerk) {
                bounds.jerk = bounds.jerk.min(limits.jerk * pace.acceleration / way);
            }
        }
        if bounds.velocity.is_infinite() {
            return Ok(Segment::new(Path::Joint(Courses::new(
                end.len(),
                |index| Course::still(end[index]),
            ))));
        }
        if bounds.jerk.is_infinite() {
            // None is limited.
            bounds.jerk = 0.0;
        }
        let progress: Course = Course::rest_to_rest(0.0, 1.0, &bounds);
        let courses = Courses::new(end.len(), |index| progress.scaled(start[index], end[index]));
        Ok(Segment::new(Path::Joint(courses)))
    }

    /// A straight line of the tool to `base_t_tool`, turning about one axis. An arm with a closed form keeps its posture;
    /// another moves its joints as little as it can. The path is followed in thought, point by point, before it is
    /// accepted, and is slowed down where a joint could not follow.
    ///
    /// # Errors
    /// The first thing that is wrong on it.
    pub fn line(
        &mut self,
        start: &Joints,
        base_t_tool: &Isometry3<f64>,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::line(from, base_t_tool.translation.vector);
        self.along(start, (curve, base_t_tool), pace.into())
    }

    /// The arc of a circle through a point (base frame, m) to `base_t_tool`, else as [`Self::line`].
    ///
    /// # Errors
    /// [`PlanError::Curve`], and as [`Self::line`].
    pub fn arc_through(
        &mut self,
        start: &Joints,
        (via, base_t_tool): (Vector3<f64>, &Isometry3<f64>),
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::through(from, via, base_t_tool.translation.vector)?;
        self.along(start, (curve, base_t_tool), pace.into())
    }

    /// The arc of a circle about a centre (base frame, m) to `base_t_tool`, the shorter way round or the longer one, else
    /// as [`Self::line`].
    ///
    /// # Errors
    /// [`PlanError::Curve`], and as [`Self::line`].
    pub fn arc_about(
        &mut self,
        start: &Joints,
        (centre, longer, base_t_tool): (Vector3<f64>, bool, &Isometry3<f64>),
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::about(from, centre, base_t_tool.translation.vector, longer)?;
        self.along(start, (curve, base_t_tool), pace.into())
    }

    /// Up, across and down to `base_t_tool`, over an obstacle that the base's z axis points away from: the tool is `height`
    /// (m) above the higher end while it goes across. Corners are rounded with a radius, m, or as wide as there is room.
    /// Else as [`Self::line`].
    ///
    /// # Errors
    /// [`PlanError::Curve`], and as [`Self::line`].
    pub fn arch(
        &mut self,
        start: &Joints,
        (height, corner, base_t_tool): (f64, Option<f64>, &Isometry3<f64>),
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::arch(from, base_t_tool.translation.vector, height, corner)?;
        self.along(start, (curve, base_t_tool), pace.into())
    }
}
