//! What the joints of an arm allow of the velocity of its hand, at one pose. Knows no tasks: a call is a period.
//!
//! A limit of a joint is a pair of planes in the space of the hand's velocities, by the inverse of the Jacobian. Near the end of
//! what the arm reaches they come close to one another: there the hand has to brake earlier.

use nalgebra::{Matrix3, Vector3};

/// The part of the joints' limits that is used; the servo has the rest, to follow with.
const USED: f64 = 0.9;

/// The joints that place a hand, at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// How fast the joints go for a velocity of the hand, rad/s for each m/s.
    inverse: Matrix3<f64>,
    /// Their highest speeds, rad/s.
    velocity: Vector3<f64>,
    /// Their highest accelerations, rad/s^2.
    acceleration: Vector3<f64>,
}

impl JointLimits {
    /// Of a hand whose joints allow everything.
    pub const NONE: Self = Self {
        inverse: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        velocity: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        acceleration: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
    };

    /// Of joints with such an inverse of their Jacobian, rad/m, and such limits of velocity, rad/s, and acceleration, rad/s^2.
    #[must_use]
    pub fn new(inverse: Matrix3<f64>, [velocity, acceleration]: [Vector3<f64>; 2]) -> Self {
        Self {
            inverse,
            velocity: velocity * USED,
            acceleration: acceleration * USED,
        }
    }

    /// How fast the joints go, rad/s, for a velocity of the hand, m/s.
    #[must_use]
    pub fn speeds(&self, velocity: &Vector3<f64>) -> Vector3<f64> {
        self.inverse * velocity
    }

    /// A velocity of the hand, m/s, as much slower as the joint needs that is the first at its limit.
    #[must_use]
    pub fn slowed(&self, velocity: Vector3<f64>) -> Vector3<f64> {
        let speeds = self.inverse * velocity;
        let parts = speeds.zip_map(&self.velocity, |speed, most| most / speed.abs());
        velocity * parts.min().min(1.0)
    }

    /// How fast the hand can brake that goes along a direction, m/s^2.
    #[must_use]
    pub fn braking(&self, direction: &Vector3<f64>) -> f64 {
        let accelerations = self.inverse * direction;
        let most = |turns: f64, most: f64| most / turns.abs();
        accelerations.zip_map(&self.acceleration, most).min()
    }

    /// The largest part of a change of the hand's velocity, m/s, up to all of it, for which no joint has to accelerate too much
    /// within a period, s. Joints went so fast before, rad/s, and without the change the hand has the velocity `from`.
    #[must_use]
    pub fn part(
        &self,
        before: &Vector3<f64>,
        from: &Vector3<f64>,
        change: &Vector3<f64>,
        period: f64,
    ) -> f64 {
        let (begun, change) = (self.speeds(from) - before, self.speeds(change));
        let left = self.acceleration * period - begun.component_mul(&change.map(f64::signum));
        let parts = left.zip_map(&change, |left, change| match change == 0.0 {
            true => 1.0,
            false => left / change.abs(),
        });
        parts.min().clamp(0.0, 1.0)
    }
}
