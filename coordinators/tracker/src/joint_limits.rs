//! What the joints of an arm allow of the velocity of its hand, at one pose. Knows no tasks: a call is a period.
//!
//! A limit of a joint is a pair of planes in the space of the hand's velocities, by the inverse of the Jacobian. Near the end of
//! what the arm reaches they come close to one another: there the hand has to brake earlier.

use nalgebra::{Matrix3, Vector3};

/// The part of the joints' limits that is used; the servo has the rest, to follow with.
const USED: f64 = 0.9;

/// The joints make the hand slower to no less than this part of what is wanted. Near a singularity it would hardly move else, and lose
/// its ball; there they do more than their rated acceleration, for which drives have torque to spare.
const LEAST: f64 = 0.3;

/// The joints that place a hand, at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// How fast they go for a velocity of the hand, rad/s for each m/s.
    inverse: Matrix3<f64>,
    /// Their highest speeds, rad/s.
    velocity: Vector3<f64>,
    /// Their highest accelerations, rad/s^2.
    acceleration: Vector3<f64>,
}

impl JointLimits {
    /// Of a hand whose joints allow everything.
    pub const NONE: Self = Self {
        inverse: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        velocity: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        acceleration: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
    };

    /// Of joints with that Jacobian, m/rad, and such limits of velocity, rad/s, and acceleration, rad/s^2. None where the arm is singular.
    #[must_use]
    pub fn new(
        jacobian: Matrix3<f64>,
        [velocity, acceleration]: [Vector3<f64>; 2],
    ) -> Option<Self> {
        Some(Self {
            inverse: jacobian.try_inverse()?,
            velocity: velocity * USED,
            acceleration: acceleration * USED,
        })
    }

    /// How fast the joints go, rad/s, for a velocity of the hand, m/s.
    #[must_use]
    pub fn speeds(&self, velocity: &Vector3<f64>) -> Vector3<f64> {
        self.inverse * velocity
    }

    /// A velocity of the hand, m/s, as much slower as the joint needs that is the first at its limit.
    #[must_use]
    pub fn slowed(&self, velocity: Vector3<f64>) -> Vector3<f64> {
        velocity * part(&Vector3::zeros(), &self.speeds(&velocity), &self.velocity)
    }

    /// How fast the hand can brake that goes along a direction, m/s^2.
    #[must_use]
    pub fn braking(&self, direction: &Vector3<f64>) -> f64 {
        let accelerations = self.speeds(direction);
        let most = |turns: f64, most: f64| most / turns.abs();
        accelerations.zip_map(&self.acceleration, most).min()
    }

    /// What joints allow of a change of the hand's velocity, m/s, within a period, s. They went so fast `before`, rad/s, and without the
    /// change the hand has the velocity `from`.
    #[must_use]
    pub fn limited(
        &self,
        before: &Vector3<f64>,
        from: &Vector3<f64>,
        change: &Vector3<f64>,
        period: f64,
    ) -> Vector3<f64> {
        let begun = self.speeds(from) - before;
        change * part(&begun, &self.speeds(change), &(self.acceleration * period))
    }
}

/// The largest part of `more` that can be added to what joints do already, `begun`, so that none does more than `most`.
fn part(begun: &Vector3<f64>, more: &Vector3<f64>, most: &Vector3<f64>) -> f64 {
    let left = most - begun.component_mul(&more.map(f64::signum));
    let parts = left.zip_map(more, |left, more| match more == 0.0 {
        true => 1.0,
        false => left / more.abs(),
    });
    parts.min().clamp(LEAST, 1.0)
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
        prop::array::uniform9(-1.0..1.0_f64)
            .prop_map(|numbers| Matrix3::from_row_slice(&numbers))
            .prop_filter_map("singular", |jacobian| {
                let far = jacobian.determinant().abs() > 0.05;
                far.then(|| JointLimits::new(jacobian, MOST)).flatten()
            })
    }

    /// How much the joints accelerate, as parts of their limits.
    fn parts(joints: &JointLimits, before: &Vector3<f64>, velocity: &Vector3<f64>) -> Vector3<f64> {
        let changes = (joints.speeds(velocity) - before) / PERIOD;
        changes.zip_map(&MOST[1], |change, most| change.abs() / most)
    }

    proptest! {
        #[test]
        fn a_change_is_the_largest_along_its_way_that_every_joint_can_take_but_never_hardly_any(
            joints in limits(), from in vector(), change in vector(), begun in vector(),
        ) {
            // They accelerate by up to half of their limits without the change.
            let begun = begun.component_mul(&MOST[1]) * (0.5 * PERIOD);
            let before = joints.speeds(&from) + begun;
            let change = change * 0.1;
            let limited = joints.limited(&before, &from, &change, PERIOD);
            let taken = parts(&joints, &before, &(from + limited)).max();
            let least = change * LEAST;
            prop_assert!(taken <= USED + 1e-6 || (limited - least).norm() < 1e-9);
            prop_assert!(limited == change || taken > USED - 1e-6);
            prop_assert!(limited.cross(&change).norm() < 1e-9 && limited.dot(&change) >= least.dot(&change) - 1e-12);
        }

        #[test]
        fn a_velocity_is_slowed_along_its_way_until_no_joint_is_too_fast_but_never_hardly_any(
            joints in limits(), velocity in vector(),
        ) {
            let slowed = joints.slowed(velocity);
            let speeds = joints.speeds(&slowed).zip_map(&MOST[0], |speed, most| speed.abs() / most).max();
            let least = velocity * LEAST;
            prop_assert!(speeds <= USED + 1e-6 || (slowed - least).norm() < 1e-9);
            prop_assert!(slowed == velocity || speeds > USED - 1e-6);
            prop_assert!(slowed.cross(&velocity).norm() < 1e-9 && slowed.norm() >= least.norm() - 1e-12);
        }
    }

    #[test]
    fn a_hand_whose_joints_allow_everything_brakes_as_it_likes() {
        let x = Vector3::x();
        assert_eq!(JointLimits::NONE.braking(&x), f64::INFINITY);
        assert_eq!(JointLimits::NONE.slowed(x), x);
        let limited = JointLimits::NONE.limited(&Vector3::zeros(), &x, &x, PERIOD);
        assert_eq!(limited, x);
    }

    #[test]
    fn braking_is_what_the_joint_allows_that_is_the_first_at_its_limit() {
        let jacobian = Matrix3::from_diagonal(&Vector3::new(1.0, 0.5, 0.25));
        let joints = JointLimits::new(jacobian, MOST).unwrap();
        for (direction, most) in [
            (Vector3::x(), 10.0),
            (Vector3::y(), 6.0),
            (Vector3::z(), 3.0),
        ] {
            assert!((joints.braking(&direction) - USED * most).abs() < 1e-12);
        }
    }
}
