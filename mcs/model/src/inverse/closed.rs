//! The closed form for any model whose six joints are those of a PUMA, wherever its zero positions and frames are.

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::error::IkError;
use super::puma::{Branch, IkSolutions, Puma, joint_outside, limit_error};
use crate::features::{FrameId, JointKind, Limits, Model};
use crate::placement::Placement;

const DOF: usize = 6;

/// Lengths (m) and sines below this are zero. What is off by more is left to a search, which has no model of its own.
const EXACT: f64 = 1e-9;

/// A PUMA in a model: its lengths, and how the model's positions and frames differ from those of its DH table.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedForm {
    puma: Puma,
    /// The table's base frame in the model's.
    base: Placement,
    /// The model's tip in the table's frame 6.
    tip: Placement,
    /// The table's angle is `sign * q + zero`.
    signs: [f64; DOF],
    zeros: [f64; DOF],
    /// The limits of the model, in its own positions.
    limits: [Limits; DOF],
    /// The same in the table's angles.
    table: [Limits; DOF],
}

/// A joint's axis at position 0.
struct Axis {
    point: Vector3<f64>,
    along: Vector3<f64>,
}

impl Axis {
    /// Where it meets another axis, if it does.
    fn meets(&self, other: &Self) -> Option<Vector3<f64>> {
        let across = self.along.cross(&other.along);
        let square = across.norm_squared();
        if square < EXACT {
            return None;
        }
        let way = other.point - self.point;
        if (way.dot(&across) / square.sqrt()).abs() > EXACT {
            return None;
        }
        Some(self.point + self.along * (way.cross(&other.along).dot(&across) / square))
    }

    fn is_across(&self, other: &Self) -> bool {
        self.along.dot(&other.along).abs() < EXACT
    }
}

/// The angle from one direction to another about an axis, rad.
fn angle(from: &Vector3<f64>, to: &Vector3<f64>, axis: &Vector3<f64>) -> f64 {
    from.cross(to).dot(axis).atan2(from.dot(to))
}

impl ClosedForm {
    /// The closed form between the base of a model and a frame. `None` when the joints between them are not all of
    /// the model's, or not those of a PUMA.
    ///
    /// A PUMA has six joints that turn. The second is across the first and meets it, the third is along the second,
    /// and the fourth across the third. The last three meet in one point, each across the one before it.
    #[must_use]
    pub fn of(model: &Model, frame: FrameId) -> Option<Self> {
        let joints: &[_; DOF] = model.joints().try_into().ok()?;
        if model.chain(frame).len() != DOF
            || joints.iter().any(|joint| joint.kind != JointKind::Revolute)
        {
            return None;
        }
        let mut data = model.data();
        let tip = model.placement(&mut data, &[0.0; DOF], frame);
        let [first, second, third, fourth, fifth, sixth] = std::array::from_fn(|index| {
            let placement = &data.placements[index + 1];
            Axis {
                point: placement.origin,
                along: placement.rotation.column(2).into_owned(),
            }
        });
        let shoulder = first.meets(&second)?;
        let wrist = fourth.meets(&fifth)?;
        let same_wrist = fifth.meets(&sixth)?;
        let parallel = second.along.cross(&third.along).norm() < EXACT;
        let across = first.is_across(&second)
            && third.is_across(&fourth)
            && fourth.is_across(&fifth)
            && fifth.is_across(&sixth);
        if !parallel || !across || (wrist - same_wrist).norm() > EXACT {
            return None;
        }
        // From here on directions are those of the DH table: x1 before joint 1, z2 the axis of joint 3, and so on.
        let (z0, z1) = (first.along, second.along);
        let x1 = z0.cross(&z1);
        let turns_alike =
            |a: &Vector3<f64>, b: &Vector3<f64>| if a.dot(b) < 0.0 { -1.0 } else { 1.0 };
        let across_z1 = |way: Vector3<f64>| way - z1 * way.dot(&z1);
        let upper_arm = across_z1(third.point - shoulder);
        let x2 = upper_arm.try_normalize(EXACT)?;
        let to_wrist = wrist - third.point;
        let z3 = fourth.along * turns_alike(&fourth.along, &to_wrist);
        let x3 = z3.cross(&z1);
        let x4 = z3.cross(&fifth.along);
        let x5 = sixth.along.cross(&fifth.along);
        let puma = Puma {
            height: 0.0,
            upper_arm: upper_arm.norm(),
            offset: (wrist - shoulder).dot(&z1),
            elbow: across_z1(to_wrist).dot(&x3),
            forearm: to_wrist.dot(&z3),
        };
        if puma.elbow.hypot(puma.forearm) < EXACT {
            return None;
        }
        let signs = [
            1.0,
            1.0,
            turns_alike(&third.along, &z1),
            turns_alike(&fourth.along, &z3),
            1.0,
            1.0,
        ];
        let zeros = [
            0.0,
            angle(&x1, &x2, &z1),
            angle(&x2, &x3, &z1),
            angle(&x3, &x4, &z3),
            angle(&x4, &x5, &fifth.along),
            0.0,
        ];
        let base = Placement {
            rotation: Matrix3::from_columns(&[x1, z0.cross(&x1), z0]),
            origin: shoulder,
        };
        let frame_6 = Placement {
            rotation: Matrix3::from_columns(&[x5, sixth.along.cross(&x5), sixth.along]),
            origin: wrist,
        };
        let limits: [Limits; DOF] = std::array::from_fn(|index| joints[index].limits);
        let table = std::array::from_fn(|index| {
            let (limits, sign, zero) = (limits[index], signs[index], zeros[index]);
            let (one, other): (f64, f64) = (sign * limits.lower + zero, sign * limits.upper + zero);
            Limits {
                lower: one.min(other),
                upper: one.max(other),
                ..limits
            }
        });
        Some(Self {
            puma,
            base,
            tip: frame_6.inverse().then(&tip),
            signs,
            zeros,
            limits,
            table,
        })
    }

    /// The limits of the joints.
    #[must_use]
    pub fn limits(&self) -> &[Limits; DOF] {
        &self.limits
    }

    /// All eight postures that put the tip at `base_t_tip`, whole turns chosen near `near` (rad).
    ///
    /// # Errors
    /// [`IkError::NotFinite`], [`IkError::OutOfReach`] or [`IkError::InsideShoulder`]. Joint limits are no error here:
    /// each solution says which joint is outside.
    pub fn inverse(
        &self,
        base_t_tip: &Placement,
        near: &[f64; DOF],
    ) -> Result<IkSolutions, IkError> {
        let (base_t_6, near) = (self.in_table(base_t_tip), self.angles(near));
        let mut found = self.puma.inverse(&base_t_6, &near, &self.table)?;
        for solution in &mut found.all {
            solution.joints = self.positions(&solution.joints);
        }
        Ok(found)
    }

    /// The joint positions (rad) of one posture, whole turns chosen near `near` (rad): for following a path without changing
    /// posture.
    ///
    /// # Errors
    /// As [`Self::inverse`], and [`IkError::JointLimit`] for the first joint beyond its limits.
    pub fn inverse_branch(
        &self,
        base_t_tip: &Placement,
        branch: Branch,
        near: &[f64; DOF],
    ) -> Result<[f64; DOF], IkError> {
        let (base_t_6, near) = (self.in_table(base_t_tip), self.angles(near));
        let found = self
            .puma
            .inverse_branch(&base_t_6, branch, &near, &self.table)?;
        let joints = self.positions(&found);
        match joint_outside(&self.limits, &joints) {
            None => Ok(joints),
            Some(index) => Err(limit_error(&self.limits, &joints, index)),
        }
    }

    /// The posture that joint positions `q` (rad) are in.
    #[must_use]
    pub fn branch_of(&self, q: &[f64; DOF]) -> Branch {
        self.puma.branch_of(&self.angles(q))
    }

    /// `base_t_6` of the table.
    fn in_table(&self, base_t_tip: &Placement) -> Isometry3<f64> {
        let base_t_6 = self.base.inverse().then(base_t_tip);
        base_t_6.then(&self.tip.inverse()).isometry()
    }

    /// The table's angles of the model's positions.
    fn angles(&self, q: &[f64; DOF]) -> [f64; DOF] {
        std::array::from_fn(|index| self.signs[index] * q[index] + self.zeros[index])
    }

    /// The model's positions of the table's angles.
    fn positions(&self, angles: &[f64; DOF]) -> [f64; DOF] {
        std::array::from_fn(|index| {
            let q = self.signs[index] * (angles[index] - self.zeros[index]);
            let limits = &self.limits[index];
            // On a limit of the table it is on the model's, but for rounding.
            let clamped = q.clamp(limits.lower, limits.upper);
            if (q - clamped).abs() < EXACT {
                clamped
            } else {
                q
            }
        })
    }

    /// The sine and cosine of the fifth angle, which is 0 or half a turn where the axes of joints 4 and 6 are one.
    #[must_use]
    pub fn wrist(&self, joints: &[f64; DOF]) -> (f64, f64) {
        (self.signs[4] * joints[4] + self.zeros[4]).sin_cos()
    }

    /// Whether joints 4 and 6 turn alike where the fifth angle is 0.
    #[must_use]
    pub fn wrist_turns_alike(&self) -> bool {
        self.signs[3] * self.signs[5] > 0.0
    }
}
