//! Joint vectors as they cross the servo's queues: as many numbers as a manipulator has joints, in place, so that
//! copying one neither allocates nor frees. Knows no arm.

use std::ops::{Deref, DerefMut};

use serde::{Deserialize, Serialize};
use tinyvec::ArrayVec;

use crate::JointKind;

/// No manipulator has more joints than this.
pub const MAX_SLOTS: usize = 32;

/// One number for each joint of a manipulator, in the order of its model. A position is in rad of a joint that turns
/// and in m of one that slides; speeds and accelerations are per s and s^2; a torque is in N m, or a force in N.
#[derive(Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Joints(ArrayVec<[f64; MAX_SLOTS]>);

/// More joints than a manipulator may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a manipulator has at most {MAX_SLOTS} joints, not {found}")]
pub struct TooManyJoints {
    /// How many there are.
    pub found: usize,
}

impl TooManyJoints {
    /// # Errors
    /// When `found` joints are too many.
    pub fn check(found: usize) -> Result<(), Self> {
        if found > MAX_SLOTS {
            return Err(Self { found });
        }
        Ok(())
    }
}

impl Joints {
    /// Zeros for `count` joints, at most [`MAX_SLOTS`].
    #[must_use]
    pub fn zeros(count: usize) -> Self {
        Self::from_fn(count, |_| 0.0)
    }

    /// What `number` says of each of `count` joints, at most [`MAX_SLOTS`].
    #[must_use]
    pub fn from_fn(count: usize, number: impl FnMut(usize) -> f64) -> Self {
        Self((0..count.min(MAX_SLOTS)).map(number).collect())
    }
}

impl Deref for Joints {
    type Target = [f64];

    #[inline]
    fn deref(&self) -> &[f64] {
        &self.0
    }
}

impl DerefMut for Joints {
    #[inline]
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.0
    }
}

impl std::fmt::Debug for Joints {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<'a> IntoIterator for &'a Joints {
    type Item = &'a f64;
    type IntoIter = std::slice::Iter<'a, f64>;

    #[inline]
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl TryFrom<&[f64]> for Joints {
    type Error = TooManyJoints;

    fn try_from(numbers: &[f64]) -> Result<Self, TooManyJoints> {
        let found = numbers.len();
        let fits = ArrayVec::try_from(numbers);
        fits.map(Self).map_err(|_| TooManyJoints { found })
    }
}

impl<const N: usize> From<[f64; N]> for Joints {
    fn from(numbers: [f64; N]) -> Self {
        const { assert!(N <= MAX_SLOTS, "a manipulator has fewer joints") };
        Self(numbers.into_iter().collect())
    }
}

impl<const N: usize> PartialEq<[f64; N]> for Joints {
    fn eq(&self, other: &[f64; N]) -> bool {
        **self == other[..]
    }
}

/// One distance (or limit of it) for the joints that turn and one for those that slide, which have no common unit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distances {
    /// Of joints that turn, rad.
    pub turning: f64,
    /// Of joints that slide, m.
    pub sliding: f64,
}

impl Distances {
    /// That of joints of a kind, rad or m.
    #[must_use]
    pub fn of(&self, kind: JointKind) -> f64 {
        match kind {
            JointKind::Revolute => self.turning,
            JointKind::Prismatic => self.sliding,
        }
    }

    /// At least `distance` (rad or m) for joints of a kind.
    #[must_use]
    pub fn with(mut self, kind: JointKind, distance: f64) -> Self {
        let own = match kind {
            JointKind::Revolute => &mut self.turning,
            JointKind::Prismatic => &mut self.sliding,
        };
        *own = own.max(distance);
        self
    }

    /// The larger of both, each on its own.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            turning: self.turning.max(other.turning),
            sliding: self.sliding.max(other.sliding),
        }
    }

    /// The larger number, and of which joints it is.
    #[must_use]
    pub fn largest(&self) -> (JointKind, f64) {
        if self.sliding > self.turning {
            (JointKind::Prismatic, self.sliding)
        } else {
            (JointKind::Revolute, self.turning)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_numbers_than_slots_are_refused_and_never_a_panic() {
        let many = [0.5; MAX_SLOTS + 1];
        let refused = Joints::try_from(&many[..]);
        assert_eq!(refused, Err(TooManyJoints { found: 33 }));
        assert_eq!(Joints::zeros(100).len(), MAX_SLOTS);
        let fits = Joints::try_from(&many[..18]).unwrap();
        assert_eq!(fits, [0.5; 18]);
        let bytes = postcard::to_stdvec(&many.to_vec()).unwrap();
        assert!(postcard::from_bytes::<Joints>(&bytes).is_err());
    }

    #[test]
    fn a_joint_vector_takes_the_room_of_its_joints_in_a_message() {
        let joints = Joints::from([1.0, 2.0, 3.0]);
        let bytes = postcard::to_stdvec(&joints).unwrap();
        assert_eq!(bytes.len(), 1 + 3 * 8);
        assert_eq!(postcard::from_bytes::<Joints>(&bytes).unwrap(), joints);
    }
}
