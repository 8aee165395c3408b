//! What the joints of an arm allow of the velocity of its hand, at one pose. Knows no tasks: a call is a period.
//!
//! A limit of a joint is a pair of planes in the space of the hand's velocities, by the inverse of the Jacobian. Near the end of
//! what the arm reaches they come close to one another: there the hand has to brake earlier.

use nalgebra::{Matrix3, Vector3};

/// The part of the joints' limits that is used; the servo has the rest, to follow with.
const USED: f64 = 0.9;

/// What the joints do not allow makes the hand slower along its way, and no more than to this part of what is wanted. Beyond that each
/// joint does what it can: near a singularity one joint would keep all others from their part, and the hand goes aside there.
const ALONG: f64 = 0.3;

/// The joints that place a hand, at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// How fast the hand goes for each of them, m/rad; and back.
    jacobian: Matrix3<f64>,
    inverse: Matrix3<f64>,
    /// Their highest speeds, rad/s.
    velocity: Vector3<f64>,
    /// Their highest accelerations, rad/s^2.
    acceleration: Vector3<f64>,
}

impl JointLimits {
    /// Of a hand whose joints allow everything.
    pub const NONE: Self = Self {
        jacobian: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
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
            jacobian,
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

    /// A velocity of the hand, m/s, with which no joint goes too fast: slower, and then aside.
    #[must_use]
    pub fn slowed(&self, velocity: Vector3<f64>) -> Vector3<f64> {
        self.within(&Vector3::zeros(), velocity, &self.velocity)
    }

    /// How fast the hand can brake that goes along a direction, m/s^2.
    #[must_use]
    pub fn braking(&self, direction: &Vector3<f64>) -> f64 {
        let accelerations = self.speeds(direction);
        let most = |turns: f64, most: f64| most / turns.abs();
        accelerations.zip_map(&self.acceleration, most).min()
    }

    /// What joints allow of a change of the hand's velocity, m/s, within a period, s. They went so fast `before`, rad/s, and without the
    /// change the hand has the velocity `from`. The change becomes shorter, and then goes aside. A joint may accelerate too much even
    /// without it, where the Jacobian changes fast. It is made to do no more.
    #[must_use]
    pub fn limited(
        &self,
        before: &Vector3<f64>,
        from: &Vector3<f64>,
        change: &Vector3<f64>,
        period: f64,
    ) -> Vector3<f64> {
        let begun = self.speeds(from) - before;
        let most = self.acceleration * period;
        let most = most.zip_map(&begun, |most, begun| most.max(begun.abs()));
        self.within(&begun, *change, &most)
    }

    /// What is added to a motion of the hand, so that no joint, which does `begun` without it, does more than `most`.
    fn within(
        &self,
        begun: &Vector3<f64>,
        more: Vector3<f64>,
        most: &Vector3<f64>,
    ) -> Vector3<f64> {
        let wanted = self.speeds(&more);
        let left = most - begun.component_mul(&wanted.map(f64::signum));
        let parts = left.zip_map(&wanted, |left, wanted| match wanted == 0.0 {
            true => 1.0,
            false => left / wanted.abs(),
        });
        let part = parts.min().min(1.0);
        if part >= ALONG {
            return more * part;
        }
        let able = (wanted * ALONG).zip_map(&left, |wanted, left| wanted.clamp(-left, left));
        self.jacobian * able
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
        fn a_change_is_the_largest_along_its_way_that_every_joint_can_take_or_goes_aside(
            joints in limits(), from in vector(), change in vector(), begun in vector(),
        ) {
            // They accelerate by up to half of their limits without the change.
            let begun = begun.component_mul(&MOST[1]) * (0.5 * PERIOD);
            let before = joints.speeds(&from) + begun;
            let change = change * 0.1;
            let limited = joints.limited(&before, &from, &change, PERIOD);
            let taken = parts(&joints, &before, &(from + limited));
            prop_assert!(taken.max() <= USED + 1e-6);
            prop_assert!(limited == change || taken.max() > USED - 1e-6);
            let along = limited.cross(&change).norm() < 1e-9 && limited.dot(&change) >= 0.0;
            // All of that part would be too much for a joint, where it goes aside.
            let all = parts(&joints, &before, &(from + change * ALONG));
            prop_assert!(along || all.max() > USED - 1e-6);
        }

        #[test]
        fn joints_that_accelerate_too_much_are_not_made_to_do_more_and_the_others_go_on(
            joints in limits(), from in vector(), change in vector(), begun in vector(),
        ) {
            let begun = begun.component_mul(&MOST[1]) * (3.0 * PERIOD);
            let before = joints.speeds(&from) + begun;
            let limited = joints.limited(&before, &from, &change, PERIOD);
            let (without, with) = (parts(&joints, &before, &from), parts(&joints, &before, &(from + limited)));
            for (without, with) in without.iter().zip(with.iter()) {
                prop_assert!(*with <= without.max(USED) + 1e-6, "{with} after {without}");
            }
            // Where one joint at least may be changed, the hand's velocity is.
            let speeds = joints.speeds(&change);
            let may = (0..3).any(|joint| {
                let left = USED * MOST[1][joint] * PERIOD + begun[joint] * speeds[joint].signum();
                left > 1e-6 && speeds[joint].abs() > 1e-6
            });
            prop_assert!(!may || limited.norm() > 0.0);
        }

        #[test]
        fn a_velocity_is_slowed_until_no_joint_is_too_fast(
            joints in limits(), velocity in vector(),
        ) {
            let slowed = joints.slowed(velocity);
            let speeds = joints.speeds(&slowed).zip_map(&MOST[0], |speed, most| speed.abs() / most);
            prop_assert!(speeds.max() <= USED + 1e-6);
            prop_assert!(slowed == velocity || speeds.max() > USED - 1e-6);
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
