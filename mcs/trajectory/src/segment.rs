//! Path segments: where each joint is at every time of one motion. Plain values, no allocation.

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3, Vector6};

use super::along::Along;
use super::course::Course;
use super::curve::Curve;
use super::interpolate::Knot;
use super::timing::{JointBounds, JointState};
use super::{Setpoint, Solver};
use mcs_model::inverse::{Branch, IkError};
use mcs_model::{Joint, Joints, MAX_SLOTS};

/// The shape of a segment.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "a path behind a pointer would be freed, and so call the allocator, in the tick"
)]
pub enum Path {
    /// Every joint on a course of its own.
    Joint(Courses),
    /// The tool along a line, an arc or an arch while it turns about one fixed axis.
    Tool(ToolPath),
}

/// The courses of all joints, which begin and end together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Courses {
    courses: [Course; MAX_SLOTS],
    joints: usize,
}

impl Courses {
    /// Those of `joints` joints.
    pub(super) fn new(joints: usize, course: impl FnMut(usize) -> Course) -> Self {
        let mut courses = [Course::default(); MAX_SLOTS];
        let joints = joints.min(MAX_SLOTS);
        for (own, given) in courses.iter_mut().zip((0..joints).map(course)) {
            *own = given;
        }
        Self { courses, joints }
    }

    /// How joints come to rest from their states, under their limits of acceleration and of jerk: in the time that the slowest
    /// of them needs, so that all keep about the direction in which they go. One that would leave its range by that, where it
    /// need not, brakes harder.
    pub(super) fn to_rest(joints: &[Joint], state: impl Fn(usize) -> JointState) -> Self {
        let course = |index: usize, within: f64| match joints.get(index) {
            Some(joint) => {
                let bounds = JointBounds::of(&joint.limits, (1.0, 1.0), true);
                Course::to_rest(&state(index), &bounds, within)
            }
            None => Course::still(state(index).position),
        };
        let together = (0..joints.len()).map(|index| course(index, 0.0).duration());
        let together = together.fold(0.0, f64::max);
        Self::new(joints.len(), |index| {
            let gentle = course(index, together);
            let end = gentle.at(gentle.duration()).position;
            let limits = joints.get(index).map(|joint| &joint.limits);
            match limits.is_some_and(|limits| end < limits.lower || end > limits.upper) {
                true => course(index, 0.0),
                false => gentle,
            }
        })
    }

    /// One for each joint.
    #[must_use]
    pub fn each(&self) -> &[Course] {
        &self.courses[..self.joints]
    }

    /// How long they take, s.
    pub(super) fn duration(&self) -> f64 {
        let durations = self.each().iter().map(Course::duration);
        durations.fold(0.0, f64::max)
    }

    pub(super) fn setpoint(&self, t: f64) -> Setpoint {
        let mut setpoint = Setpoint::at_rest(Joints::zeros(self.joints));
        for (index, course) in self.each().iter().enumerate() {
            let state = course.at(t);
            setpoint.position[index] = state.position;
            setpoint.velocity[index] = state.velocity;
            setpoint.acceleration[index] = state.acceleration;
        }
        setpoint
    }
}

/// A path of the tool frame in the base frame: its origin goes along a curve while it turns about one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolPath {
    /// Where the origin goes.
    pub curve: Curve,
    /// The tool's orientation at the start.
    pub orientation: UnitQuaternion<f64>,
    /// Axis of the turn, base frame.
    pub axis: Unit<Vector3<f64>>,
    /// Angle of the turn, rad.
    pub angle: f64,
    /// The posture kept all along, of an arm with a closed form.
    pub branch: Option<Branch>,
    /// Joint positions at the start, rad or m, and at the end as solved when the path was planned.
    pub start_joints: Joints,
    /// The end.
    pub end_joints: Joints,
    /// The progress along it over time.
    pub along: Along,
    /// The smallest singular value of the tool's Jacobian on the way, of m and rad per rad or m of the joints.
    pub smallest_singular_value: f64,
    /// How many times as long it takes as the tool's own limits would have it, for the sake of the joints' limits.
    pub slowed: f64,
}

impl ToolPath {
    /// `base_t_tool` at progress `s`.
    #[must_use]
    pub fn pose(&self, s: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&self.axis, self.angle * s);
        let [place, ..] = self.curve.at(s);
        Isometry3::from_parts(place.into(), turn * self.orientation)
    }

    pub(super) fn evaluate(
        &self,
        solver: &mut Solver,
        along: JointState,
        near: &[f64],
    ) -> Result<Setpoint, SegmentError> {
        let position = solver.follow(&self.pose(along.position), self.branch, near)?;
        if along.velocity == 0.0 && along.acceleration == 0.0 {
            return Ok(Setpoint::at_rest(position));
        }
        let [direction, bend] = self.directions(along.position);
        let rates = solver.rates(
            &position,
            &(direction * along.velocity),
            &(direction * along.acceleration + bend * along.velocity.powi(2)),
        );
        let (velocity, acceleration) = rates.ok_or(SegmentError::Singular)?;
        Ok(Setpoint {
            position,
            velocity,
            acceleration,
        })
    }

    /// The solved pose at some progress. At a singular end, where the tool rests, the joints rest too.
    pub(super) fn knot(
        &self,
        solver: &mut Solver,
        progress: f64,
        near: &[f64],
    ) -> Result<Knot, SegmentError> {
        let position = solver.follow(&self.pose(progress), self.branch, near)?;
        let [direction, _] = self.directions(progress);
        let rates = solver.rates(&position, &direction, &Vector6::zeros());
        let slope = match rates {
            Some((slope, _)) => slope,
            None if progress >= 1.0 => Joints::zeros(position.len()),
            None => return Err(SegmentError::Singular),
        };
        Ok(Knot {
            progress,
            position,
            slope,
        })
    }

    /// How the tool moves and turns per progress, m and rad, base frame; and how that changes.
    fn directions(&self, progress: f64) -> [Vector6<f64>; 2] {
        let [_, travel, bend] = self.curve.at(progress);
        let spin = self.axis.into_inner() * self.angle;
        let both = |linear: Vector3<f64>, angular: Vector3<f64>| {
            let (v, w) = (linear, angular);
            Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
        };
        [both(travel, spin), both(bend, Vector3::zeros())]
    }
}

/// Why a segment has no setpoint at some time. A planned segment has been checked against this.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SegmentError {
    /// No joint positions for a pose of the path.
    #[error(transparent)]
    Unreachable(#[from] IkError),
    /// The path passes through a singularity, where no joint speeds follow it.
    #[error("the path passes through a singularity of the arm")]
    Singular,
}

/// One motion from rest to rest, with its timing.
#[derive(Debug, Clone, Copy)]
pub struct Segment {
    path: Path,
    duration: f64,
}

impl Segment {
    pub(super) fn new(path: Path) -> Self {
        let duration = match &path {
            Path::Joint(courses) => courses.duration(),
            Path::Tool(path) => path.along.duration(),
        };
        Self { path, duration }
    }

    /// Staying at `position` (rad or m) for no time.
    #[must_use]
    pub fn hold(position: Joints) -> Self {
        let still = |index: usize| Course::still(position[index]);
        Self::new(Path::Joint(Courses::new(position.len(), still)))
    }

    /// Time from start to rest, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// How many joints it moves.
    #[must_use]
    pub fn joints(&self) -> usize {
        match &self.path {
            Path::Joint(courses) => courses.each().len(),
            Path::Tool(path) => path.start_joints.len(),
        }
    }

    /// The smallest singular value of the tool's Jacobian along a path of the tool, and how many times as long that takes
    /// for the sake of the joints' limits.
    #[must_use]
    pub fn singularity(&self) -> Option<(f64, f64)> {
        match &self.path {
            Path::Joint(_) => None,
            Path::Tool(path) => Some((path.smallest_singular_value, path.slowed)),
        }
    }

    /// The path's shape.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The setpoint at `t` seconds after the start; `near` are the joint positions (rad or m) of the
    /// setpoint before, by which whole turns are chosen and from which a search begins.
    ///
    /// # Errors
    /// [`SegmentError`] for a path through a pose that cannot be followed.
    pub fn at(&self, solver: &mut Solver, t: f64, near: &[f64]) -> Result<Setpoint, SegmentError> {
        match &self.path {
            Path::Joint(courses) => Ok(courses.setpoint(t)),
            Path::Tool(path) => path.evaluate(solver, path.along.at(t), near),
        }
    }

    /// Joint positions where the segment comes to rest, rad or m.
    ///
    /// # Errors
    /// [`SegmentError`] as [`Self::at`].
    pub fn end(&self, solver: &mut Solver) -> Result<Joints, SegmentError> {
        match &self.path {
            Path::Joint(courses) => Ok(courses.setpoint(self.duration).position),
            // Asked for near its planned end, so that whole turns come out the same.
            Path::Tool(path) => Ok(self.at(solver, self.duration, &path.end_joints)?.position),
        }
    }
}
