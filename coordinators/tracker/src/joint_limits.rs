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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PERIOD: f64 = 0.0045;
    const MOST: [Vector3<f64>; 2] = [Vector3::new(1.9, 1.5, 2.4), Vector3::new(10.0, 12.0, 12.0)];

    fn vector() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0..1.0_f64).prop_map(Vector3::from)
    }

    fn limits() -> impl Strategy<Value = JointLimits> {
        prop::array::uniform9(-3.0..3.0_f64)
            .prop_map(|numbers| JointLimits::new(Matrix3::from_row_slice(&numbers), MOST))
    }

    proptest! {
        #[test]
        fn the_part_of_a_change_is_the_largest_that_every_joint_can_take(
            joints in limits(), from in vector(), change in vector(),
        ) {
            let before = joints.speeds(&from);
            let part = joints.part(&before, &from, &change, PERIOD);
            let taken = |part: f64| {
                let changes = joints.speeds(&(change * part)) / PERIOD;
                changes.zip_map(&MOST[1], |change, most| change.abs() / most).max()
            };
            prop_assert!(taken(part) <= USED + 1e-9);
            prop_assert!(part == 1.0 || taken(part) > USED - 1e-9);
        }

        #[test]
        fn joints_that_are_too_fast_already_are_only_brought_back(
            joints in limits(), before in vector(), change in vector(),
        ) {
            let part = joints.part(&(before * 10.0), &Vector3::zeros(), &change, PERIOD);
            let off = |velocity: Vector3<f64>| {
                let changes = (joints.speeds(&velocity) - before * 10.0) / PERIOD;
                changes.zip_map(&MOST[1], |change, most| change.abs() / most).max()
            };
            prop_assert!((0.0..=1.0).contains(&part));
            prop_assert!(off(change * part) <= off(Vector3::zeros()).max(USED) + 1e-6);
        }

        #[test]
        fn a_velocity_is_slowed_along_its_way_until_no_joint_is_too_fast(
            joints in limits(), velocity in vector(),
        ) {
            let slowed = joints.slowed(velocity);
            let speeds = joints.speeds(&slowed).zip_map(&MOST[0], |speed, most| speed.abs() / most);
            prop_assert!(speeds.max() <= USED + 1e-9);
            prop_assert!(slowed.cross(&velocity).norm() < 1e-9 && slowed.dot(&velocity) >= 0.0);
            prop_assert!(slowed == velocity || speeds.max() > USED - 1e-9);
        }
    }

    #[test]
    fn a_hand_whose_joints_allow_everything_brakes_as_it_likes() {
        let x = Vector3::x();
        assert_eq!(JointLimits::NONE.braking(&x), f64::INFINITY);
        assert_eq!(JointLimits::NONE.slowed(x), x);
        assert_eq!(
            JointLimits::NONE.part(&Vector3::zeros(), &x, &x, PERIOD),
            1.0
        );
    }

    #[test]
    fn braking_is_what_the_joint_allows_that_is_the_first_at_its_limit() {
        let joints = JointLimits::new(Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 4.0)), MOST);
        for (direction, most) in [
            (Vector3::x(), 10.0),
            (Vector3::y(), 6.0),
            (Vector3::z(), 3.0),
        ] {
            assert!((joints.braking(&direction) - USED * most).abs() < 1e-12);
        }
    }
}
