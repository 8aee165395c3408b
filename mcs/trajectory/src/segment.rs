//! Path segments: where each joint is at every time of one motion. Plain values, no allocation.

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3, Vector6};

use super::course::Course;
use super::interpolate::Knot;
use super::timing::JointState;
use super::{Setpoint, Solver};
use mcs_model::inverse::{Branch, IkError};
use mcs_model::{Joints, MAX_SLOTS};

/// The shape of a segment.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "a path behind a pointer would be freed, and so call the allocator, in the tick"
)]
pub enum Path {
    /// Every joint on a course of its own.
    Joint(Courses),
    /// The tool along a straight line while it turns about one fixed axis.
    Line(Line),
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

/// A straight line of the tool frame in the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// `base_t_tool` at the start.
    pub start: Isometry3<f64>,
    /// From start to end, m, base frame.
    pub travel: Vector3<f64>,
    /// Axis of the turn, base frame.
    pub axis: Unit<Vector3<f64>>,
    /// Angle of the turn, rad.
    pub angle: f64,
    /// The posture kept all along, of an arm with a closed form.
    pub branch: Option<Branch>,
    /// Joint positions at the end, rad or m, as solved when the line was planned.
    pub end_joints: Joints,
    /// The progress along it over time, from 0 to 1.
    pub progress: Course,
    /// The hardest braking allowed along it, 1/s^2.
    pub braking: f64,
}

impl Line {
    /// `base_t_tool` at progress `s`.
    #[must_use]
    pub fn pose(&self, s: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&self.axis, self.angle * s);
        Isometry3::from_parts(
            (self.start.translation.vector + self.travel * s).into(),
            turn * self.start.rotation,
        )
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
        let direction = self.direction();
        let rates = solver.rates(
            &position,
            &(direction * along.velocity),
            &(direction * along.acceleration),
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
        let rates = solver.rates(&position, &self.direction(), &Vector6::zeros());
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

    /// How the tool moves and turns per progress, m and rad, base frame.
    fn direction(&self) -> Vector6<f64> {
        let spin = self.axis.into_inner() * self.angle;
        Vector6::new(
            self.travel.x,
            self.travel.y,
            self.travel.z,
            spin.x,
            spin.y,
            spin.z,
        )
    }
}

/// Why a segment has no setpoint at some time. A planned segment has been checked against this.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SegmentError {
    /// No joint positions for a pose of the line.
    #[error(transparent)]
    Unreachable(#[from] IkError),
    /// The line passes through a singularity, where no joint speeds follow it.
    #[error("the line passes through a singularity of the arm")]
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
            Path::Line(line) => line.progress.duration(),
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

    /// The path's shape.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The setpoint at `t` seconds after the start; `near` are the joint positions (rad or m) of the
    /// setpoint before, by which whole turns are chosen and from which a search begins.
    ///
    /// # Errors
    /// [`SegmentError`] for a line through a pose that cannot be followed.
    pub fn at(&self, solver: &mut Solver, t: f64, near: &[f64]) -> Result<Setpoint, SegmentError> {
        match &self.path {
            Path::Joint(courses) => Ok(courses.setpoint(t)),
            Path::Line(line) => line.evaluate(solver, line.progress.at(t), near),
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
            Path::Line(line) => Ok(self.at(solver, self.duration, &line.end_joints)?.position),
        }
    }
}
