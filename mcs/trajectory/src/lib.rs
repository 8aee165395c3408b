//! The motion planning layer's mathematics: courses of joints over time, and segments to follow.
//!
//! A [`Segment`] is planned and checked once, before anything moves; evaluating it allocates nothing.
//! Knows the arm, but no servo, task or hardware. Positions are in rad of joints that turn and in m of
//! joints that slide; speeds and accelerations are per s and s^2.

pub mod along;
pub mod bridge;
pub mod chase;
pub mod course;
pub mod curve;
pub mod follow;
pub mod interpolate;
pub mod passage;
pub mod plan;
pub mod pursuit;
pub mod registry;
pub mod route;
pub mod segment;
pub mod solver;
pub mod timing;

pub use bridge::{Blend, Bridge};
pub use course::Course;
pub use curve::{Curve, CurveError};
pub use follow::{Follower, REST_PARTS, Rest, WayToRest, way_to_rest};
pub use passage::Passage;
pub use plan::{CartesianLimits, PlanError, Planner};
pub use pursuit::Pursuit;
pub use registry::{Name, PathRequest, PlanningRegistry};
pub use route::{Goal, Pace, PathKind, Route};
pub use segment::{Path, Segment};
pub use solver::{Inverse, Solver};

use mcs_model::Joints;

/// What the motion planning layer asks of the control layer at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Setpoint {
    /// Joint positions, rad or m.
    pub position: Joints,
    /// Joint velocities, rad/s or m/s.
    pub velocity: Joints,
    /// Joint accelerations, rad/s^2 or m/s^2. Those that a control law gets are the mean of the period to come, for which
    /// its torques are held.
    pub acceleration: Joints,
}

impl Setpoint {
    /// Standing still at `position` (rad or m).
    #[must_use]
    pub fn at_rest(position: Joints) -> Self {
        let still = Joints::zeros(position.len());
        Self {
            position,
            velocity: still,
            acceleration: still,
        }
    }

    /// The speed of a joint after `period` (s) more of its acceleration, where that speeds it up; rad/s or m/s.
    #[must_use]
    pub fn pace(&self, joint: usize, period: f64) -> f64 {
        let (speed, more) = (self.velocity[joint], self.acceleration[joint] * period);
        if speed * more < 0.0 {
            return speed;
        }
        speed + more
    }
}
