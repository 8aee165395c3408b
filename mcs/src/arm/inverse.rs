//! Inverse kinematics of the six-joint arm: the closed form of [`Puma`] with this arm's lengths and limits.

use nalgebra::Isometry3;

use super::model::{ArmModel, DOF, Joints};
pub use crate::model::inverse::{
    Branch, Elbow, IkError, IkSolution, IkSolutions, Puma, Shoulder, Singular, Wrist,
};

#[cfg(test)]
mod tests;

impl IkSolutions {
    /// The posture within limits that takes the shortest time from `near` at full joint speeds,
    /// optionally only among those with one elbow posture.
    ///
    /// # Errors
    /// [`IkError::JointLimit`] when none is within limits.
    pub fn nearest(
        &self,
        model: &ArmModel,
        near: &Joints,
        elbow: Option<Elbow>,
    ) -> Result<IkSolution, IkError> {
        self.nearest_within(&model.limits, near, elbow)
    }
}

/// The error that names joint `index` of `joints`.
pub(crate) fn limit_error(model: &ArmModel, joints: &Joints, index: usize) -> IkError {
    crate::model::inverse::limit_error(&model.limits, joints, index.min(DOF - 1))
}

impl ArmModel {
    fn puma(&self) -> Puma {
        Puma {
            height: self.dh[0].d,
            upper_arm: self.dh[1].a,
            offset: self.dh[2].d,
            elbow: self.dh[2].a,
            forearm: self.dh[3].d,
        }
    }

    /// All eight postures that put frame 6 at `base_t_6`, whole turns chosen near `near` (rad).
    ///
    /// # Errors
    /// [`IkError::NotFinite`], [`IkError::OutOfReach`] or [`IkError::InsideShoulder`]. Joint limits
    /// are no error here: each solution says which joint is outside.
    pub fn inverse(
        &self,
        base_t_6: &Isometry3<f64>,
        near: &Joints,
    ) -> Result<IkSolutions, IkError> {
        self.puma().inverse(base_t_6, near, &self.limits)
    }

    /// The joint positions of one posture, for following a path without changing posture.
    ///
    /// # Errors
    /// As [`Self::inverse`], and [`IkError::JointLimit`] for the first joint beyond its limits.
    pub fn inverse_branch(
        &self,
        base_t_6: &Isometry3<f64>,
        branch: Branch,
        near: &Joints,
    ) -> Result<Joints, IkError> {
        self.puma()
            .inverse_branch(base_t_6, branch, near, &self.limits)
    }

    /// The posture that joint positions `q` (rad) are in.
    #[must_use]
    pub fn branch_of(&self, q: &Joints) -> Branch {
        self.puma().branch_of(q)
    }
}
