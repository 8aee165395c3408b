//! Kinematics of fingertips: where they are, which joint positions put one where, what a force there asks of the joints.
//!
//! A hand is a model with frames `tip1`, `tip2` and so on. Three joints carry each: one that swings the finger to the side,
//! and two parallel ones, the first where that one is, that bend it. At 0 it is straight. Only places count, for a fingertip
//! is a ball; they have a closed form. Units m, rad, N, N m; the frame is the base frame of the model, of a hand by itself
//! its palm.

use std::sync::Arc;

use mcs::{
    Joints,
    model::{Data, FrameId, Limits, Model},
};
use nalgebra::{Point3, Vector3};

/// Lengths (m) and sines below this are zero.
const EXACT: f64 = 1e-9;

/// Why a finger cannot do what it should.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FingerError {
    /// The model has no fingertips.
    #[error("model `{model}` has no frame `tip1`: it is no hand")]
    NoHand {
        /// Its name.
        model: String,
    },
    /// There is no such finger.
    #[error("there is no finger {finger}; the hand has 1 to {fingers}")]
    NoFinger {
        /// Number from 1.
        finger: usize,
        /// How many there are.
        fingers: usize,
    },
    /// A finger that has no closed form.
    #[error(
        "finger {finger} is not made as a finger here: one joint that swings it, then two parallel ones that bend it, straight at 0"
    )]
    OtherKind {
        /// Number from 1.
        finger: usize,
    },
    /// The place is further away than the finger is long, or nearer to its root than it can bend.
    #[error("finger {finger} cannot reach ({:.4} {:.4} {:.4}) m: that is {:.1} mm from its root, and its tip can be from {:.1} to {:.1} mm away", point[0], point[1], point[2], distance * 1e3, reach[0] * 1e3, reach[1] * 1e3)]
    Unreachable {
        /// Number from 1.
        finger: usize,
        /// The place, m.
        point: [f64; 3],
        /// How far it is from the finger's root, m.
        distance: f64,
        /// The least and the greatest distance of its tip, m.
        reach: [f64; 2],
    },
    /// A joint would have to leave its limits.
    #[error("finger {finger} cannot reach ({:.4} {:.4} {:.4}) m: joint `{joint}` would be at {position:.3} rad, and its limits are {:.3} to {:.3} rad", point[0], point[1], point[2], limits[0], limits[1])]
    Limit {
        /// Number from 1.
        finger: usize,
        /// The place, m.
        point: [f64; 3],
        /// The joint.
        joint: String,
        /// Where it would be, rad.
        position: f64,
        /// Its limits, rad.
        limits: [f64; 2],
    },
}

/// A finger of the model, straight at 0.
#[derive(Debug, Clone)]
struct Finger {
    tip: FrameId,
    /// Its joints, from the palm outwards.
    joints: [usize; 3],
    /// Where its first two joints are, m.
    root: Vector3<f64>,
    /// The axis about which it swings, where it points, and where its tip goes when it bends.
    swing: Vector3<f64>,
    along: Vector3<f64>,
    inwards: Vector3<f64>,
    /// Of its near and its far part, m.
    lengths: [f64; 2],
}

impl Finger {
    /// A finger with its tip there, if it has a closed form.
    fn of(model: &Model, data: &mut Data, tip: FrameId) -> Option<Self> {
        let joints: [usize; 3] = model.chain(tip).try_into().ok()?;
        model.forward(data, &vec![0.0; model.dof()]);
        let end = data.placement(model, tip).origin;
        let jacobian = model.jacobian_there(data, tip, &end);
        let axis = |joint: usize| jacobian.fixed_view::<3, 1>(3, joint).into_owned();
        let lever = |joint: usize| jacobian.fixed_view::<3, 1>(0, joint).into_owned();
        let [swing, near, far] = joints.map(axis);
        // A joint that turns moves the tip by axis x lever; the lever across the axis comes back by another product.
        let [_, to_near, to_far] = joints.map(|joint| -axis(joint).cross(&lever(joint)));
        let lengths = [(to_near - to_far).norm(), to_far.norm()];
        let along = to_near.try_normalize(EXACT)?;
        let root = end - to_near;
        let is_one = (near - far).norm() < EXACT
            && swing.dot(&near).abs() < EXACT
            && swing.dot(&along).abs() < EXACT
            && near.dot(&along).abs() < EXACT
            && (to_far - along * lengths[1]).norm() < EXACT
            && (lever(joints[0]) - swing.cross(&to_near)).norm() < EXACT
            && lengths.iter().all(|length| *length > EXACT);
        is_one.then_some(Self {
            tip,
            joints,
            root,
            swing,
            along,
            inwards: near.cross(&along),
            lengths,
        })
    }

    /// Positions of its joints, rad, that put the tip at `point`: those of a finger that stands up, then of one that is bent
    /// over to behind its root. How far the place is from the root when there are none.
    fn inverse(&self, point: &Point3<f64>) -> Result<[[f64; 3]; 2], f64> {
        let way = point.coords - self.root;
        let [near, far] = self.lengths;
        let distance = way.norm();
        let cosine = (distance * distance - near * near - far * far) / (2.0 * near * far);
        if cosine.is_nan() || cosine.abs() > 1.0 + EXACT {
            return Err(distance);
        }
        let bend = cosine.clamp(-1.0, 1.0).acos();
        let turned = (far * bend.sin()).atan2(near + far * bend.cos());
        Ok([1.0, -1.0].map(|up| {
            let across = (way - self.swing * way.dot(&self.swing)) * up;
            let spread = self.along.cross(&across).dot(&self.swing);
            let spread = spread.atan2(self.along.dot(&across));
            let elevation = way.dot(&self.inwards).atan2(up * across.norm());
            [spread, elevation - turned, bend]
        }))
    }
}

/// The fingers of a hand.
#[derive(Debug, Clone)]
pub struct Fingers {
    model: Arc<Model>,
    data: Data,
    fingers: Vec<Finger>,
}

impl Fingers {
    /// The fingers of a model: those whose tips are its frames `tip1`, `tip2` and so on.
    ///
    /// # Errors
    /// [`FingerError::NoHand`], [`FingerError::OtherKind`].
    pub fn new(model: Arc<Model>) -> Result<Self, FingerError> {
        let named = |number: usize| model.frame(&format!("tip{number}"));
        let tips: Vec<FrameId> = (1..).map_while(named).collect();
        if tips.is_empty() {
            let model = model.name().to_owned();
            return Err(FingerError::NoHand { model });
        }
        let mut data = model.data();
        let mut fingers = Vec::new();
        for (index, tip) in tips.into_iter().enumerate() {
            let finger = Finger::of(&model, &mut data, tip);
            fingers.push(finger.ok_or(FingerError::OtherKind { finger: index + 1 })?);
        }
        Ok(Self {
            data,
            fingers,
            model,
        })
    }

    /// The hand.
    #[must_use]
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// How many fingers there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.fingers.len()
    }

    /// The joints of a finger (from 1), by index from 0, from the palm outwards.
    ///
    /// # Errors
    /// [`FingerError::NoFinger`].
    pub fn joints(&self, finger: usize) -> Result<&[usize], FingerError> {
        self.finger(finger).map(|finger| &finger.joints[..])
    }

    /// Where the fingertips are at joint positions `q`, m.
    pub fn tips(&mut self, q: &[f64]) -> Vec<Point3<f64>> {
        self.model.forward(&mut self.data, q);
        let (model, data) = (&self.model, &self.data);
        let tips = self.fingers.iter();
        tips.map(|finger| data.placement(model, finger.tip).origin.into())
            .collect()
    }

    /// Joint positions that put the tip of a finger (from 1) at `point` (m); the other fingers stay as in `q`.
    ///
    /// # Errors
    /// [`FingerError::NoFinger`], [`FingerError::Unreachable`], [`FingerError::Limit`].
    pub fn reach(
        &self,
        finger: usize,
        point: &Point3<f64>,
        q: &Joints,
    ) -> Result<Joints, FingerError> {
        let own = self.finger(finger)?;
        let place = point.coords.into();
        let found = own.inverse(point).map_err(|distance| {
            let [near, far] = own.lengths;
            FingerError::Unreachable {
                finger,
                point: place,
                distance,
                reach: [(near - far).abs(), near + far],
            }
        })?;
        let limits = own.joints.map(|joint| self.model.joints()[joint].limits);
        let outside = |positions: &[f64; 3]| {
            let mut pairs = positions.iter().zip(&limits);
            pairs.position(|(position, Limits { lower, upper, .. })| {
                !(lower - EXACT..=upper + EXACT).contains(position)
            })
        };
        let [up, over] = found;
        let positions = match (outside(&up), outside(&over)) {
            (None, _) => up,
            (_, None) => over,
            (Some(joint), _) => {
                return Err(FingerError::Limit {
                    finger,
                    point: place,
                    joint: self.model.joints()[own.joints[joint]].name.clone(),
                    position: up[joint],
                    limits: [limits[joint].lower, limits[joint].upper],
                });
            }
        };
        let mut all = *q;
        for (index, (position, limits)) in own.joints.into_iter().zip(positions.iter().zip(&limits))
        {
            if let Some(own) = all.get_mut(index) {
                *own = position.clamp(limits.lower, limits.upper);
            }
        }
        Ok(all)
    }

    /// What a force (N) on the tip of a finger (from 1) asks of that finger's joints at positions `q`, N m, to be met.
    ///
    /// # Errors
    /// [`FingerError::NoFinger`].
    pub fn torques(
        &mut self,
        finger: usize,
        force: &Vector3<f64>,
        q: &[f64],
    ) -> Result<Vec<f64>, FingerError> {
        let Finger { tip, joints, .. } = *self.finger(finger)?;
        let jacobian = self.model.jacobian(&mut self.data, q, tip);
        let torque = |joint: &usize| -jacobian.fixed_view::<3, 1>(0, *joint).dot(force);
        Ok(joints.iter().map(torque).collect())
    }

    fn finger(&self, number: usize) -> Result<&Finger, FingerError> {
        let index = number.checked_sub(1);
        let found = index.and_then(|index| self.fingers.get(index));
        found.ok_or(FingerError::NoFinger {
            finger: number,
            fingers: self.fingers.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use mcs::model::{built_in, file::Inertias};
    use proptest::prelude::*;

    use super::*;

    fn hand() -> Fingers {
        let model = built_in::model("hand", Inertias::Engine).unwrap().unwrap();
        Fingers::new(Arc::new(model)).unwrap()
    }

    /// The tip of a finger in the frame of its root, by plane geometry: x outwards, z along the straight finger.
    fn by_hand([spread, near, far]: [f64; 3]) -> Vector3<f64> {
        let inwards = 0.06 * near.sin() + 0.045 * (near + far).sin();
        let along = 0.06 * near.cos() + 0.045 * (near + far).cos();
        Vector3::new(-inwards, -along * spread.sin(), along * spread.cos())
    }

    #[test]
    fn fingertips_are_where_plane_geometry_puts_them() {
        let mut hand = hand();
        let q = [0.1, 0.4, 0.9, -0.3, -0.2, 0.5, 0.0, 0.0, 0.0];
        for (finger, tip) in hand.tips(&q).iter().enumerate() {
            let angle = [0.0_f64, 120.0, -120.0][finger].to_radians();
            let own = q[3 * finger..3 * finger + 3].try_into().unwrap();
            let there = by_hand(own) + Vector3::new(0.04, 0.0, 0.06);
            let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
            assert!(
                (turn * there - tip.coords).norm() < 1e-12,
                "{finger}: {tip}"
            );
        }
    }

    proptest! {
        #[test]
        fn a_fingertip_goes_back_to_wherever_it_was(
            shares in proptest::collection::vec(0.02..0.98_f64, 9),
            finger in 1..=3_usize,
        ) {
            let mut hand = hand();
            let joints = hand.model().joints().to_vec();
            let q: Vec<f64> = joints.iter().zip(shares)
                .map(|(joint, share)| joint.limits.lower + share * (joint.limits.upper - joint.limits.lower))
                .collect();
            let goal = hand.tips(&q)[finger - 1];
            let start = Joints::from([0.0, 0.2, 0.4, 0.0, 0.2, 0.4, 0.0, 0.2, 0.4]);
            let found = hand.reach(finger, &goal, &start).unwrap();
            prop_assert!((hand.tips(&found)[finger - 1] - goal).norm() < 1e-8);
            prop_assert_eq!(hand.model().joint_outside(&found), None);
            let own = hand.joints(finger).unwrap().to_vec();
            for index in (0..9).filter(|index| !own.contains(index)) {
                prop_assert_eq!(found[index], start[index]);
            }
        }
    }

    #[test]
    fn a_place_out_of_reach_is_refused_with_what_is_in_the_way() {
        let hand = hand();
        let reach = |finger: usize, x: f64, z: f64| {
            let found = hand.reach(finger, &Point3::new(x, 0.0, z), &Joints::zeros(9));
            found.unwrap_err()
        };
        let FingerError::Unreachable { distance, .. } = reach(1, 0.04, 0.06 + 0.125) else {
            panic!("20 mm beyond its end");
        };
        assert!((distance - 0.125).abs() < 1e-12, "{distance}");
        let FingerError::Limit { joint, .. } = reach(1, 0.13, 0.08) else {
            panic!("bent outwards");
        };
        assert_eq!(joint, "near1");
        assert!(matches!(reach(4, 0.0, 0.1), FingerError::NoFinger { .. }));
        assert!(matches!(
            reach(1, f64::NAN, 0.1),
            FingerError::Unreachable { .. }
        ));
    }

    #[test]
    fn torques_meet_a_force_as_its_work_says() {
        let mut hand = hand();
        let q = [0.1, 0.4, 0.9, -0.3, -0.2, 0.5, 0.2, 0.3, 0.7];
        let force = Vector3::new(0.3, -2.0, 1.1);
        let torques = hand.torques(2, &force, &q).unwrap();
        let step = 1e-6;
        for (joint, torque) in (3..6).zip(torques) {
            let mut moved = q;
            moved[joint] += step;
            let way = hand.tips(&moved)[1] - hand.tips(&q)[1];
            assert!((torque * step + force.dot(&way)).abs() < 1e-11);
        }
    }
}
