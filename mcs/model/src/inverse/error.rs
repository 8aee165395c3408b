//! Why a pose has no joint positions.

use crate::features::JointKind;

/// Why a pose has no usable joint positions.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum IkError {
    /// The pose holds a NaN or an infinity.
    #[error("the pose holds a value that is not a finite number")]
    NotFinite,
    /// The wrist centre is too far from the shoulder, or too near it.
    #[error(
        "out of reach: the wrist centre would be {distance:.4} m from the shoulder, the arm spans {nearest:.4} to {farthest:.4} m"
    )]
    OutOfReach {
        /// Distance from shoulder to wrist centre in the plane of the arm, m.
        distance: f64,
        /// Smallest distance possible, m.
        nearest: f64,
        /// Largest distance possible, m.
        farthest: f64,
    },
    /// The wrist centre is nearer to joint 1's axis than the shoulder offset d3.
    #[error(
        "inside the shoulder: the wrist centre would be {radius:.4} m from the axis of joint 1, it cannot come nearer than the shoulder offset of {offset:.4} m"
    )]
    InsideShoulder {
        /// Distance of the wrist centre from the axis of joint 1, m.
        radius: f64,
        /// The shoulder offset |d3|, m.
        offset: f64,
    },
    /// No allowed posture keeps every joint within its limits; the named joint is the one that the
    /// best of them breaks.
    #[error(
        "joint {joint} would have to be at {value:.4} {unit}, its limits are {lower:.4} to {upper:.4} {unit}",
        unit = .kind.unit()
    )]
    JointLimit {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// The position needed, rad or m.
        value: f64,
        /// Lower limit, rad or m.
        lower: f64,
        /// Upper limit, rad or m.
        upper: f64,
    },
    /// An elbow posture was asked of an arm that has none.
    #[error("the arm has no elbow postures: its inverse kinematics have no closed form")]
    NoElbow,
    /// The goal is farther away than all links together are long.
    #[error(
        "out of reach: the goal is {distance:.4} m from the first joint, and the links between them are {farthest:.4} m long in all"
    )]
    TooFar {
        /// Distance of the goal from the first joint, m.
        distance: f64,
        /// The length of all links, m.
        farthest: f64,
    },
    /// A search found nothing that reaches the pose.
    #[error(
        "not found: from {starts} starts the nearest pose within the limits was {distance:.3e} m and {angle:.3e} rad off"
    )]
    NotFound {
        /// How often the search began.
        starts: usize,
        /// Distance from the goal of the nearest pose found, m.
        distance: f64,
        /// Angle between the goal and the nearest pose found, rad.
        angle: f64,
    },
}
