//! Path segments: where each joint is at every time of one motion. Plain values, no allocation.

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3, Vector6};

use super::{Profile, ProfilePoint, Setpoint, Solver};
use mcs_model::Joints;
use mcs_model::inverse::{Branch, IkError};

/// The shape of a segment, over a path parameter from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Path {
    /// All joints in proportion.
    Joint {
        /// Joint positions at the start, rad or m.
        start: Joints,
        /// Joint positions at the end, rad or m.
        end: Joints,
    },
    /// The tool along a straight line while it turns about one fixed axis.
    Line(Line),
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
}

impl Line {
    /// `base_t_tool` at path parameter `s`.
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
        along: ProfilePoint,
        near: &[f64],
    ) -> Result<Setpoint, SegmentError> {
        let position = solver.follow(&self.pose(along.position), self.branch, near)?;
        if along.speed == 0.0 && along.acceleration == 0.0 {
            return Ok(Setpoint::at_rest(position));
        }
        let spin = self.axis.into_inner() * self.angle;
        let direction = Vector6::new(
            self.travel.x,
            self.travel.y,
            self.travel.z,
            spin.x,
            spin.y,
            spin.z,
        );
        let rates = solver.rates(
            &position,
            &(direction * along.speed),
            &(direction * along.acceleration),
        );
        let (velocity, acceleration) = rates.ok_or(SegmentError::Singular)?;
        Ok(Setpoint {
            position,
            velocity,
            acceleration,
        })
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
    profile: Profile,
    /// The hardest braking allowed along this path, 1/s^2.
    braking: f64,
}

impl Segment {
    pub(super) fn new(path: Path, profile: Profile, braking: f64) -> Self {
        Self {
            path,
            profile,
            braking,
        }
    }

    /// Staying at `position` (rad or m) for no time.
    #[must_use]
    pub fn hold(position: Joints) -> Self {
        let path = Path::Joint {
            start: position,
            end: position,
        };
        Self::new(path, Profile::trapezoid(0.0, 1.0, 1.0), 1.0)
    }

    /// Time from start to rest, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.profile.duration()
    }

    /// The path's shape.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Timing along the path.
    #[must_use]
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// The setpoint at `t` seconds after the start; `near` are the joint positions (rad or m) of the
    /// setpoint before, by which whole turns are chosen and from which a search begins.
    ///
    /// # Errors
    /// [`SegmentError`] for a line through a pose that cannot be followed.
    pub fn at(&self, solver: &mut Solver, t: f64, near: &[f64]) -> Result<Setpoint, SegmentError> {
        let along = self.profile.at(t);
        match &self.path {
            Path::Joint { start, end } => Ok(joint_setpoint(start, end, along)),
            Path::Line(line) => line.evaluate(solver, along, near),
        }
    }

    /// Joint positions where the segment comes to rest, rad or m; for a braking segment `near` are the joint
    /// positions to be near to.
    ///
    /// # Errors
    /// [`SegmentError`] as [`Self::at`].
    pub fn end(&self, solver: &mut Solver, near: &[f64]) -> Result<Joints, SegmentError> {
        Ok(self.at(solver, self.duration(), near)?.position)
    }

    /// The same path, braked to rest from where it is at `t` seconds: a protective stop keeps to the
    /// path that was checked and ends no later on it than the segment itself.
    #[must_use]
    pub fn braked_at(&self, t: f64) -> Self {
        let now = self.profile.at(t);
        // What is left of the path is always enough for the braking that it was planned with.
        let left = (self.profile.end() - now.position).max(f64::MIN_POSITIVE);
        let needed = now.speed * now.speed / (2.0 * left);
        let braking = if now.speed > 0.0 {
            self.braking.max(needed)
        } else {
            self.braking
        };
        Self {
            profile: Profile::braking(now.position, now.speed, braking),
            ..*self
        }
    }
}

fn joint_setpoint(start: &Joints, end: &Joints, along: ProfilePoint) -> Setpoint {
    let mut setpoint = Setpoint::at_rest(*end);
    for index in 0..end.len().min(start.len()) {
        let travel = end[index] - start[index];
        // From the nearer end, so that both ends are exact.
        setpoint.position[index] = if along.position < 0.5 {
            start[index] + travel * along.position
        } else {
            end[index] - travel * (1.0 - along.position)
        };
        setpoint.velocity[index] = travel * along.speed;
        setpoint.acceleration[index] = travel * along.acceleration;
    }
    setpoint
}
