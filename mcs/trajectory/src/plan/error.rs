//! Why a motion is refused.

use mcs_model::JointKind;
use mcs_model::inverse::IkError;

use super::SLOWEST;
use crate::Name;
use crate::curve::CurveError;
use crate::segment::SegmentError;

/// A path that would take so many times as long as the tool's limits want it is refused.
pub(super) const MOST_SLOWING: f64 = 20.0;

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
    /// No path planner has this name.
    #[error(
        "there is no path planner `{name}`; register it, or ask for joint, direct, line, arc, about or arch"
    )]
    UnknownPath {
        /// The name.
        name: Name,
    },
    /// A path planner takes another count of numbers.
    #[error("the path takes {needed} numbers, not {given}")]
    Numbers {
        /// How many it takes.
        needed: usize,
        /// How many were given.
        given: usize,
    },
    /// A blend that is no share.
    #[error("a blend is 0 to 1, not {given}")]
    Share {
        /// What was given.
        given: f64,
    },
    /// A blend that is no distance.
    #[error("the radius of a blend is 0 or more, not {given}")]
    Distance {
        /// What was given, rad or m.
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
    /// There is no such path.
    #[error(transparent)]
    Curve(#[from] CurveError),
    /// The path leaves what the arm can reach.
    #[error(
        "the path cannot be followed at {percent:.0} % of its length: {reason}; move joint-interpolated or through another pose"
    )]
    Path {
        /// Where on the path, percent of its length.
        percent: f64,
        /// What is wrong there.
        reason: SegmentError,
    },
    /// The path leads through a singularity, or so near one that joints could follow it only at a crawl.
    #[error(
        "the path leads through a singularity of the arm, or too near it: joints could follow it only in more than {MOST_SLOWING} times its time; the smallest singular value along it is {smallest:.2e}, at {percent:.0} % of its length; move joint-interpolated or through another pose"
    )]
    Singular {
        /// The smallest singular value of the tool's Jacobian.
        smallest: f64,
        /// Where on the path that is, percent of its length.
        percent: f64,
    },
    /// A joint would have to move too fast to follow the path.
    #[error(
        "joint {joint} would have to move at {value:.3} {unit}/s at {percent:.0} % of the path, its limit is {limit:.3} {unit}/s; slow down or move joint-interpolated",
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
        /// Where on the path, percent of its length.
        percent: f64,
    },
    /// A joint's acceleration would have to change too fast.
    #[error(
        "the acceleration of joint {joint} would have to change at {value:.3} {unit}/s^3 at {percent:.0} % of the path, its limit is {limit:.3} {unit}/s^3; slow down or move joint-interpolated",
        unit = .kind.unit()
    )]
    JointJerk {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Jerk needed, rad/s^3 or m/s^3.
        value: f64,
        /// Limit, rad/s^3 or m/s^3.
        limit: f64,
        /// Where on the path, percent of its length.
        percent: f64,
    },
    /// A joint would have to accelerate (or brake in a protective stop) too hard to stay on the path.
    #[error(
        "joint {joint} would have to accelerate at {value:.3} {unit}/s^2 at {percent:.0} % of the path, its limit is {limit:.3} {unit}/s^2; slow down or move joint-interpolated",
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
        /// Where on the path, percent of its length.
        percent: f64,
    },
}
