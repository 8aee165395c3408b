//! The motion planning layer's mathematics: profiles of speed over time, and segments to follow.
//!
//! A [`Segment`] is planned and checked once, before anything moves; evaluating it allocates nothing.
//! Knows the arm, but no servo, task or hardware.

pub mod interpolate;
pub mod plan;
pub mod profile;
pub mod route;
pub mod segment;

pub use interpolate::Interpolator;
pub use plan::{CartesianLimits, PlanError, Planner};
pub use profile::{Profile, ProfilePoint};
pub use route::{Goal, Pace, PathKind, Route};
pub use segment::{Path, Segment};

use crate::arm::{DOF, Joints};

/// What the motion planning layer asks of the control layer at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Setpoint {
    /// Joint positions, rad.
    pub position: Joints,
    /// Joint velocities, rad/s.
    pub velocity: Joints,
    /// Joint accelerations, rad/s^2.
    pub acceleration: Joints,
}

impl Setpoint {
    /// Standing still at `position` (rad).
    #[must_use]
    pub const fn at_rest(position: Joints) -> Self {
        Self {
            position,
            velocity: [0.0; DOF],
            acceleration: [0.0; DOF],
        }
    }
}
