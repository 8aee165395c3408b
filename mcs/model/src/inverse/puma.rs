//! Inverse kinematics in closed form: all eight postures of a PUMA-like arm, or a named reason.
//!
//! Holds for arms whose DH twists are +90, 0, -90, +90, -90, 0 degrees, whose first axis meets the
//! second and whose last three axes meet (PUMA 560 and its like). Wrist centre first, then the
//! orientation, as R. P. Paul and H. Zhang do (Int. J. Robotics Research 5(2), 1986). No allocation.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::error::IkError;
use crate::features::{JointKind, Limits};

/// How many joints such an arm has.
const DOF: usize = 6;

type Joints = [f64; DOF];

/// Below this sine a posture counts as singular, and lengths (m) this short as zero.
const SINGULAR: f64 = 1e-9;
/// The elbow's angle comes from an arc cosine near one, which keeps only half the digits.
const SINGULAR_ELBOW: f64 = 1e-6;
/// The wrist centre is so near the plane of joint 1's axis, m: both shoulder postures are within a microradian there.
const SINGULAR_SHOULDER: f64 = 1e-7;
/// A joint this little (rad) beyond its limit is rounding and is set onto the limit.
const LIMIT_ROUNDING: f64 = 1e-9;

/// On which side of the shoulder the forearm hangs, seen from behind the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Shoulder {
    /// Wrist centre behind the axis of joint 1 in the plane of the upper arm.
    Left,
    /// Wrist centre before the axis of joint 1: the usual posture.
    Right,
}

/// Whether the elbow is over or under the line from shoulder to wrist.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Elbow {
    /// Elbow above the line.
    Above,
    /// Elbow below the line.
    Below,
}

/// Which of the two wrist postures gives the orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Wrist {
    /// Joint 5 at or above zero.
    NoFlip,
    /// Joint 5 below zero.
    Flip,
}

/// One of the eight postures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Branch {
    /// Shoulder posture.
    pub shoulder: Shoulder,
    /// Elbow posture.
    pub elbow: Elbow,
    /// Wrist posture.
    pub wrist: Wrist,
}

impl Branch {
    /// All eight, in a fixed order.
    pub const ALL: [Self; 8] = {
        let mut all = [Self {
            shoulder: Shoulder::Right,
            elbow: Elbow::Above,
            wrist: Wrist::NoFlip,
        }; 8];
        let mut index = 0;
        while index < 8 {
            if index & 4 != 0 {
                all[index].shoulder = Shoulder::Left;
            }
            if index & 2 != 0 {
                all[index].elbow = Elbow::Below;
            }
            if index & 1 != 0 {
                all[index].wrist = Wrist::Flip;
            }
            index += 1;
        }
        all
    };
}

/// Joint positions for one posture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IkSolution {
    /// The posture.
    pub branch: Branch,
    /// Joint positions, rad, each turned by whole turns to lie within its limits where it can and
    /// otherwise nearest to the positions asked to be near.
    pub joints: Joints,
    /// First joint beyond its limits, by index from 0.
    pub outside: Option<usize>,
}

/// Which of the arm's three singularities a pose lies in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Singular {
    /// Wrist centre at the shoulder offset from joint 1's axis: both shoulder postures coincide.
    pub shoulder: bool,
    /// Arm straight (or folded): both elbow postures coincide.
    pub elbow: bool,
    /// Joint 5 at zero: only the sum of joints 4 and 6 matters; joint 4 is kept near.
    pub wrist: bool,
}

/// All eight postures for one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IkSolutions {
    /// In the order of [`Branch::ALL`]. At a singularity some of them coincide.
    pub all: [IkSolution; 8],
    /// Singularities of the pose.
    pub singular: Singular,
}

impl IkSolutions {
    /// The posture within limits that takes the shortest time from `near` at full joint speeds,
    /// optionally only among those with one elbow posture.
    ///
    /// # Errors
    /// [`IkError::JointLimit`] when none is within limits.
    pub fn nearest_within(
        &self,
        limits: &[Limits; DOF],
        near: &Joints,
        elbow: Option<Elbow>,
    ) -> Result<IkSolution, IkError> {
        let allowed = |found: &&IkSolution| elbow.is_none_or(|elbow| found.branch.elbow == elbow);
        let time = |found: &IkSolution| {
            let per_joint = found.joints.iter().zip(near).zip(limits);
            per_joint.fold(0.0_f64, |longest, ((to, from), limit)| {
                longest.max((to - from).abs() / limit.velocity)
            })
        };
        let inside = self
            .all
            .iter()
            .filter(allowed)
            .filter(|found| found.outside.is_none());
        if let Some(best) = inside.min_by(|a, b| time(a).total_cmp(&time(b))) {
            return Ok(*best);
        }
        let excess = |found: &IkSolution| {
            let per_joint = found.joints.iter().zip(limits);
            per_joint.fold(0.0_f64, |most, (value, limit)| {
                most.max(beyond(*value, limit))
            })
        };
        let least = self
            .all
            .iter()
            .filter(allowed)
            .min_by(|a, b| excess(a).total_cmp(&excess(b)));
        let least = least.unwrap_or(&self.all[0]);
        Err(limit_error(
            limits,
            &least.joints,
            least.outside.unwrap_or(0),
        ))
    }
}

/// How far `value` is beyond its limits, rad; zero within.
fn beyond(value: f64, limit: &Limits) -> f64 {
    (limit.lower - value).max(value - limit.upper).max(0.0)
}

/// The error that names joint `index` of `joints`.
pub(super) fn limit_error(limits: &[Limits; DOF], joints: &Joints, index: usize) -> IkError {
    let index = index.min(DOF - 1);
    IkError::JointLimit {
        joint: index + 1,
        kind: JointKind::Revolute,
        value: joints[index],
        lower: limits[index].lower,
        upper: limits[index].upper,
    }
}

/// The wrist centre in the plane of the arm and what follows from it for every posture.
struct Reach {
    /// Direction of the wrist centre about joint 1's axis, rad.
    bearing: f64,
    /// Coordinates in the plane of the upper arm, m: outward (magnitude) and up from the shoulder.
    outward: f64,
    up: f64,
    /// Angle of the elbow from straight, rad, magnitude.
    bend: f64,
    singular: Singular,
}

/// The lengths of a PUMA-like arm, as in its DH table, m. Its angles are those of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Puma {
    /// Height of the shoulder above the base frame, d1.
    pub height: f64,
    /// Length of the upper arm, a2.
    pub upper_arm: f64,
    /// Offset of the shoulder, d3 (with d2).
    pub offset: f64,
    /// Offset of the elbow, a3.
    pub elbow: f64,
    /// Length of the forearm, d4.
    pub forearm: f64,
}

/// The first joint outside its limits, by index from 0.
pub(super) fn joint_outside(limits: &[Limits; DOF], q: &Joints) -> Option<usize> {
    let mut all = q.iter().zip(limits);
    all.position(|(value, limit)| !(limit.lower..=limit.upper).contains(value))
}

impl Puma {
    /// Length of the forearm from elbow to wrist centre (m) and its angle to the DH x axis (rad).
    fn elbow_to_wrist(&self) -> (f64, f64) {
        let (a3, d4) = (self.elbow, self.forearm);
        (a3.hypot(d4), d4.atan2(a3))
    }

    fn reach(&self, wrist_centre: &Vector3<f64>) -> Result<Reach, IkError> {
        let offset = self.offset;
        let (upper_arm, (forearm, _)) = (self.upper_arm, self.elbow_to_wrist());
        let radius = wrist_centre.x.hypot(wrist_centre.y);
        let clear = (radius - offset.abs()) * (radius + offset.abs());
        if clear < -SINGULAR * SINGULAR {
            return Err(IkError::InsideShoulder {
                radius,
                offset: offset.abs(),
            });
        }
        let outward = clear.max(0.0).sqrt();
        let up = wrist_centre.z - self.height;
        let squared = outward * outward + up * up;
        let cosine =
            (squared - upper_arm * upper_arm - forearm * forearm) / (2.0 * upper_arm * forearm);
        if cosine.abs() > 1.0 + 1e-12 {
            return Err(IkError::OutOfReach {
                distance: squared.sqrt(),
                nearest: (upper_arm - forearm).abs(),
                farthest: upper_arm + forearm,
            });
        }
        let bend = cosine.clamp(-1.0, 1.0).acos();
        Ok(Reach {
            bearing: wrist_centre.y.atan2(wrist_centre.x),
            outward,
            up,
            bend,
            singular: Singular {
                shoulder: outward < SINGULAR_SHOULDER,
                elbow: bend.sin() < SINGULAR_ELBOW,
                wrist: false,
            },
        })
    }

    /// Joints 1 to 3 of one posture, rad, not yet turned into limits.
    fn arm_joints(&self, reach: &Reach, shoulder: Shoulder, elbow: Elbow) -> [f64; 3] {
        let (forearm, forearm_angle) = self.elbow_to_wrist();
        let (outward, above) = match shoulder {
            Shoulder::Right => (reach.outward, -1.0),
            Shoulder::Left => (-reach.outward, 1.0),
        };
        let bend = match elbow {
            Elbow::Above => above * reach.bend,
            Elbow::Below => -above * reach.bend,
        };
        let q1 = reach.bearing - (-self.offset).atan2(outward);
        let (sin, cos) = bend.sin_cos();
        let along = self.upper_arm + forearm * cos;
        let q2 = reach.up.atan2(outward) - (forearm * sin).atan2(along);
        [q1, q2, bend - forearm_angle]
    }

    /// Orientation of frame 3 for joints 1 to 3.
    fn base_r_3(arm: &[f64; 3]) -> Matrix3<f64> {
        let (s1, c1) = arm[0].sin_cos();
        let (s, c) = (arm[1] + arm[2]).sin_cos();
        Matrix3::new(
            c1 * c,
            -s1,
            -c1 * s, //
            s1 * c,
            c1,
            -s1 * s, //
            s,
            0.0,
            c,
        )
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
        limits: &[Limits; DOF],
    ) -> Result<IkSolutions, IkError> {
        let (rotation, origin) = parts(base_t_6)?;
        let reach = self.reach(&origin)?;
        let mut singular = reach.singular;
        let mut all = Branch::ALL.map(|branch| IkSolution {
            branch,
            joints: [0.0; DOF],
            outside: None,
        });
        for pair in all.chunks_exact_mut(2) {
            let branch = pair[0].branch;
            let arm = self.arm_joints(&reach, branch.shoulder, branch.elbow);
            let wrist_rotation = Self::base_r_3(&arm).tr_mul(&rotation);
            for found in pair {
                let (wrist, is_singular) =
                    wrist_joints(&wrist_rotation, found.branch.wrist, near[3]);
                singular.wrist |= is_singular;
                found.joints = turned(&arm, &wrist, near, limits);
                found.outside = joint_outside(limits, &found.joints);
            }
        }
        Ok(IkSolutions { all, singular })
    }

    /// The joint positions of one posture, for following a path without changing posture. They may be beyond limits.
    ///
    /// # Errors
    /// As [`Self::inverse`].
    pub fn inverse_branch(
        &self,
        base_t_6: &Isometry3<f64>,
        branch: Branch,
        near: &Joints,
        limits: &[Limits; DOF],
    ) -> Result<Joints, IkError> {
        let (rotation, origin) = parts(base_t_6)?;
        let reach = self.reach(&origin)?;
        let arm = self.arm_joints(&reach, branch.shoulder, branch.elbow);
        let wrist_rotation = Self::base_r_3(&arm).tr_mul(&rotation);
        let (wrist, _) = wrist_joints(&wrist_rotation, branch.wrist, near[3]);
        Ok(turned(&arm, &wrist, near, limits))
    }

    /// The posture that joint positions `q` (rad) are in.
    #[must_use]
    pub fn branch_of(&self, q: &Joints) -> Branch {
        let (forearm, forearm_angle) = self.elbow_to_wrist();
        let bend = wrapped(q[2] + forearm_angle);
        let outward = self.upper_arm * q[1].cos() + forearm * (q[1] + bend).cos();
        let shoulder = if outward >= 0.0 {
            Shoulder::Right
        } else {
            Shoulder::Left
        };
        let elbow = if (bend <= 0.0) == (shoulder == Shoulder::Right) {
            Elbow::Above
        } else {
            Elbow::Below
        };
        let wrist = if wrapped(q[4]) >= 0.0 {
            Wrist::NoFlip
        } else {
            Wrist::Flip
        };
        Branch {
            shoulder,
            elbow,
            wrist,
        }
    }
}

/// Joins the two halves and turns every joint by whole turns into its limits, near `near`.
fn turned(arm: &[f64; 3], wrist: &[f64; 3], near: &Joints, limits: &[Limits; DOF]) -> Joints {
    let raw = [arm[0], arm[1], arm[2], wrist[0], wrist[1], wrist[2]];
    std::array::from_fn(|index| nearest_turn(raw[index], near[index], &limits[index]))
}

fn parts(pose: &Isometry3<f64>) -> Result<(Matrix3<f64>, Vector3<f64>), IkError> {
    let rotation = *pose.rotation.to_rotation_matrix().matrix();
    let origin = pose.translation.vector;
    let finite = rotation
        .iter()
        .chain(origin.iter())
        .all(|value| value.is_finite());
    if finite {
        Ok((rotation, origin))
    } else {
        Err(IkError::NotFinite)
    }
}

/// Joints 4 to 6 from the orientation of frame 6 in frame 3, `Rz(q4) Ry(-q5) Rz(q6)`, and whether
/// the wrist is singular; then joint 4 stays at `near_4`.
fn wrist_joints(rotation: &Matrix3<f64>, wrist: Wrist, near_4: f64) -> ([f64; 3], bool) {
    let r = |row: usize, column: usize| rotation[(row, column)];
    let sine = r(0, 2).hypot(r(1, 2));
    if sine < SINGULAR {
        let near_4 = if near_4.is_finite() { near_4 } else { 0.0 };
        // At q5 = 0 the orientation is Rz(q4 + q6), at q5 = pi it is Rz(q4 - q6) turned about y.
        let (q5, q6) = if r(2, 2) > 0.0 {
            (0.0, r(1, 0).atan2(r(0, 0)) - near_4)
        } else {
            (PI, near_4 - (-r(1, 0)).atan2(-r(0, 0)))
        };
        return ([near_4, q5, q6], true);
    }
    let sign = match wrist {
        Wrist::NoFlip => 1.0,
        Wrist::Flip => -1.0,
    };
    let q4 = (-sign * r(1, 2)).atan2(-sign * r(0, 2));
    let q5 = (sign * sine).atan2(r(2, 2));
    let q6 = (-sign * r(2, 1)).atan2(sign * r(2, 0));
    ([q4, q5, q6], false)
}

/// An angle in (-pi, pi].
pub(super) fn wrapped(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

/// `angle` plus whole turns: within the limits where possible, then as near `near` as possible.
fn nearest_turn(angle: f64, near: f64, limit: &Limits) -> f64 {
    let base = wrapped(angle);
    let near = if near.is_finite() { near } else { 0.0 };
    let mut best = base;
    let mut best_rank = (f64::INFINITY, f64::INFINITY);
    for candidate in [base - TAU, base, base + TAU] {
        let excess = beyond(candidate, limit);
        let (candidate, excess) = if excess <= LIMIT_ROUNDING {
            (candidate.clamp(limit.lower, limit.upper), 0.0)
        } else {
            (candidate, excess)
        };
        let rank = (excess, (candidate - near).abs());
        if rank < best_rank {
            (best, best_rank) = (candidate, rank);
        }
    }
    best
}
